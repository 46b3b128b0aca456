"""Every key has a line in the documentation, and templates show keys that there are."""

import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Literal

import pytest
from pydantic import Field

from heliogauge.instruments import Kind, every_kind, read_resource, resolve
from heliogauge.measurement.key_tables import KeySection, key_pages, key_sections
from heliogauge.measurement.models import MeasurementModel, Section

KINDS = every_kind()


def undescribed(sections: Iterable[KeySection]) -> list[str]:
    return [f"{one.head} {row.key}" for one in sections for row in one.rows if not row.description.endswith(".")]


def known_keys(sections: Iterable[KeySection]) -> dict[str, set[str]]:
    """Map each section ("mirror.facet") to the keys of all its forms, and to those of its sub-sections."""
    found: dict[str, set[str]] = {}
    for one in sections:
        path = one.head.strip("[]")
        found.setdefault(path, set()).update(row.key for row in one.rows)
        while path:
            path, _, last = path.rpartition(".")
            found.setdefault(path, set()).add(last)
    return found


def strangers(tables: Mapping[str, Any], known: Mapping[str, set[str]], path: str = "") -> Iterator[str]:
    """Yield keys of a file that its model does not have."""
    for key, value in tables.items():
        inner = f"{path}.{key}" if path else key
        names = known.get(path, set())
        if key not in names:
            if "NAME" in names:
                inner = f"{path}.NAME"
            else:
                yield inner
                continue
        for table in [value] if isinstance(value, Mapping) else value if isinstance(value, list) else []:
            if isinstance(table, Mapping) and inner in known:
                yield from strangers(table, known, inner)


def shown_tables(template: str) -> list[dict[str, Any]]:
    """Return the tables of a template with the keys one may want (``#:``): each line with the head it stands under.

    One by one, because a template also shows keys that exclude each other.
    """
    head, found = "", []
    for line in re.sub(r"^#: ?", "", template, flags=re.MULTILINE).splitlines():
        if re.match(r"\[.*\]", line):
            head = line
        elif re.match(r"\w+ =", line):
            found.append(tomllib.loads(f"{head}\n{line}"))
    return found


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_every_key_has_a_line(kind: Kind) -> None:
    missing = undescribed(key_sections(resolve(kind.model)))
    assert not missing, f"give them Field(description=...): {missing}"


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_every_key_stands_on_the_page(kind: Kind) -> None:
    """By another route: the fields of every model of the kind, gathered from the JSON schema that pydantic makes."""
    page = key_pages([kind])
    schema = resolve(kind.model).model_json_schema()
    sections = [schema, *schema.get("$defs", {}).values()]
    keys = {key for one in sections for key in one.get("properties", {})}
    assert len(keys) > 5
    missing = [key for key in keys if f"`{key}`" not in page and f".{key}" not in page and f"[{key}" not in page]
    assert not missing


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_a_template_shows_keys_that_there_are(kind: Kind) -> None:
    known = known_keys(key_sections(resolve(kind.model)))
    shown = shown_tables(read_resource(kind.template))
    assert len(shown) > 5
    wrong = [stranger for tables in shown for stranger in strangers(tables, known)]
    assert not wrong, f"keys that the model does not have: {wrong}"


class Part(Section):
    """A part."""

    depth_m: float
    width_m: float = Field(1.0, description="Width [m].")


class Example(MeasurementModel):
    """An example."""

    kind: Literal["example"] = Field(description="An example.")
    part: tuple[Part, ...] = Field((), description="Parts.")


def test_the_checks_themselves() -> None:
    """Negative controls: a key without a line, and a template with a mistyped key."""
    sections = list(key_sections(Example))
    assert undescribed(sections) == ["[[part]] depth_m"]
    assert sections[1].rows[1].default == "`1.0`"
    tables = shown_tables('name = "a"\n#: [[part]]\n#: depth_m = 1.0\n#: widht_m = 1.0\n')
    assert [one for table in tables for one in strangers(table, known_keys(sections))] == ["part.widht_m"]
