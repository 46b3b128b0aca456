"""What is wrong with a measurement.toml, in sentences: from pydantic's faults to key, value and remedy."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

#: More than this many faults at once say that the file is of another kind; the first ones are enough to see that.
_MOST_FAULTS = 5


def fault_lines(error: ValidationError, model: type[BaseModel], init: str) -> list[str]:
    """Say what is wrong with the content of a file.

    error: Pydantic's faults.
    init: Command that writes a template of such a file.
    """
    faults = error.errors(include_url=False)
    places = [fault["loc"] for fault in faults]
    # A list with one wrong entry is also "too short": the fault of the entry is enough.
    causes = [fault for fault in faults if not any(_is_inside(place, fault["loc"]) for place in places)]
    texts = list(dict.fromkeys(_fault_text(fault, model, init) for fault in causes))
    rest = len(texts) - _MOST_FAULTS
    return [*texts[:_MOST_FAULTS], *([f"... and {rest} more"] if rest > 0 else [])]


def _models_within(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models_within(part)


def _keys_by_section(models: Sequence[type[BaseModel]], section: str = "") -> dict[str, set[str]]:
    """Map each section ("mirror.pose") to the keys that any of its forms knows."""
    found: dict[str, set[str]] = {section: set()}
    for model in models:
        for key, field in model.model_fields.items():
            found[section].add(key)
            inner = list(_models_within(field.annotation)) + [
                m for part in field.metadata for m in _models_within(part)
            ]
            if inner:
                path = f"{section}.{key}" if section else key
                for name, keys in _keys_by_section(inner, path).items():
                    found.setdefault(name, set()).update(keys)
    return found


def _is_inside(place: Sequence[int | str], other: Sequence[int | str]) -> bool:
    return len(place) > len(other) and tuple(place[: len(other)]) == tuple(other)


@dataclass(frozen=True, slots=True)
class _Place:
    """Where a fault is: section, last key, the path to show, and which form of a section was taken ("table")."""

    section: str
    key: str
    shown: str
    form: str


def _place(location: Sequence[int | str], sections: dict[str, set[str]], *, is_unknown: bool) -> _Place:
    section, shown, key, form = "", "", "", ""
    for position, part in enumerate(location):
        path = f"{section}.{part}" if section else str(part)
        if isinstance(part, int):
            shown += f"[{part + 1}]"
        elif part in sections.get(section, ()) or (is_unknown and position == len(location) - 1):
            shown += f".{part}" if shown else part
            section, key = (path, part) if path in sections else (section, part)
        else:
            # Not a key: the name of the form that pydantic chose.
            form = part
    return _Place(section, key, shown, form)


def _unknown_key_text(place: _Place, sections: dict[str, set[str]]) -> str:
    known = sections.get(place.section, set())
    if place.key in known:
        section = place.shown.rpartition(".")[0]
        return f"{section}: keys of two forms are mixed, {place.form!r} and another; leave out the keys of one"
    said = f"{place.shown} is not a key here"
    near = get_close_matches(place.key, sorted(known), n=1, cutoff=0.6)
    if near:
        return f"{said}; did you mean {near[0]!r}?"
    homes = [name for name, keys in sections.items() if place.key in keys]
    if homes:
        return f"{said}; it belongs to {f'[{homes[0]}]' if homes[0] else 'the top of the file'}"
    return f"{said}; known are {', '.join(sorted(known))}"


def _fault_text(fault: Any, model: type[BaseModel], init: str) -> str:
    sections = _keys_by_section([model])
    kind, value, context = fault["type"], fault["input"], fault.get("ctx", {})
    place = _place(fault["loc"], sections, is_unknown=kind == "extra_forbidden")
    if kind == "extra_forbidden":
        return _unknown_key_text(place, sections)
    if kind == "missing":
        return f"{place.shown} is missing; `{init}` writes a template that explains it"
    if kind == "union_tag_not_found":
        key = str(context["discriminator"]).strip("'")
        said = 'say "rectangle" or "table"' if key == "shape" else f"`{init}` writes a template with it"
        return f"{place.shown}.{key} is missing; {said}"
    if kind == "union_tag_invalid":
        key = str(context["discriminator"]).strip("'")
        return f"{place.shown}.{key} = {context['tag']!r} is not known; say {context['expected_tags']}"
    if kind == "value_error":
        return f"{place.shown}: {context['error']}"
    return f"{place.shown} = {_short(value)}: {_need(kind, context, fault)}"


def _need(kind: str, context: dict[str, Any], fault: Any) -> str:
    if kind == "finite_number":
        return "a finite number is needed (not nan, not inf)"
    if kind in {"float_type", "int_type"}:
        return f"{'a number' if kind == 'float_type' else 'a whole number'} is needed, without quotes"
    if kind == "greater_than":
        return f"a value above {context['gt']:g} is needed"
    if kind == "greater_than_equal":
        return f"a value not below {context['ge']:g} is needed"
    if kind == "literal_error":
        return f"say {context['expected']}"
    if kind in {"too_short", "too_long"}:
        wanted = f"at least {context['min_length']}" if kind == "too_short" else f"at most {context['max_length']}"
        return f"{wanted} entries are needed, there are {context['actual_length']}"
    if kind == "tuple_type":
        is_table = isinstance(fault["input"], dict)
        return "a list of tables is needed; write its name in double brackets" if is_table else "a list is needed"
    if kind in {"model_type", "dict_type", "model_attributes_type"}:
        return "a table is needed"
    return str(fault["msg"][:1].lower() + fault["msg"][1:])


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
