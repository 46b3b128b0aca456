"""A single name stands for a list of one, in the measurement files of all kinds."""

from typing import get_args, get_origin

import pytest
from pydantic import TypeAdapter, ValidationError

from heliogauge.instruments import every_kind, resolve
from heliogauge.measurement.models import Section, SomeNames


def _sections() -> dict[str, type[Section]]:
    found: dict[str, type[Section]] = {}

    def add(kind: type) -> None:
        for one in kind.__subclasses__():
            found[f"{one.__module__}.{one.__name__}"] = one
            add(one)

    for one in every_kind().values():
        resolve(one.load)
    add(Section)
    return found


def _takes_texts(annotation: object) -> bool:
    """Return whether a type or a part of it is a tuple of texts of any number."""
    arguments = get_args(annotation)
    if get_origin(annotation) is tuple and len(arguments) == 2 and arguments[1] is Ellipsis:
        return arguments[0] is str or (bool(get_args(arguments[0])) and get_args(arguments[0])[0] is str)
    return any(_takes_texts(one) for one in arguments)


def _keys() -> list[tuple[str, str]]:
    return [
        (name, key)
        for name, section in sorted(_sections().items())
        for key, field in section.model_fields.items()
        if _takes_texts(field.annotation)
    ]


@pytest.mark.parametrize(("section", "key"), _keys())
def test_a_single_name_is_a_list_of_one(section: str, key: str) -> None:
    model = _sections()[section]
    with pytest.raises(ValidationError) as caught:
        # Other keys are missing, or another is unknown: what is said of this one counts.
        model.model_validate({key: "one", "no such key": 1})
    said = [one for one in caught.value.errors() if one["loc"][0] == key]
    # Of markers, say, there must be four.
    assert [one for one in said if one["type"] != "too_short" or one["ctx"]["min_length"] < 2] == []


def test_there_are_such_keys_of_many_kinds() -> None:
    assert len({section.split(".")[0] for section, _ in _keys()}) >= 4
    assert len(_keys()) >= 12


def test_what_is_no_name_is_refused() -> None:
    names = TypeAdapter(SomeNames)
    assert names.validate_python("a.png") == ("a.png",)
    for wrong in ("", [], 3, [""]):
        with pytest.raises(ValidationError):
            names.validate_python(wrong)
