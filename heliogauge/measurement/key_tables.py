"""Every key that a measurement.toml may have, as tables for the documentation, from the models that check the file."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from enum import Enum
from inspect import cleandoc
from types import NoneType
from typing import Any, Literal, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from heliogauge.instruments import Kind, resolve
from heliogauge.measurement.models import MeasurementModel


@dataclass(frozen=True, slots=True)
class KeyRow:
    """A key: its name, which values it takes, its default ("" where it must be given), and what it is."""

    key: str
    values: str
    default: str
    description: str


@dataclass(frozen=True, slots=True)
class KeySection:
    """A section, or one of the forms that it can have: how its head is written, what it is, and its keys."""

    head: str
    summary: str
    rows: tuple[KeyRow, ...]


def key_sections(model: type[BaseModel], path: str = "", head: str = "") -> Iterator[KeySection]:
    """Go through a model and its sections, the top of the file first.

    path: Keys that lead to the model, with dots.
    head: How the section is written: ``[mirror]``, ``[[mirror.facet]]``.
    """
    fields = model.model_fields
    rows = (_row(name, field) for name, field in fields.items() if not list(_models_of(field)))
    yield KeySection(head, cleandoc(model.__doc__ or ""), tuple(rows))
    for name, field in fields.items():
        inner = f"{path}.{name}" if path else name
        origins = {get_origin(part) for part in (field.annotation, *get_args(field.annotation))}
        if dict in origins:
            inner_head = f"[{inner}.NAME]"
        else:
            inner_head = f"[[{inner}]]" if tuple in origins else f"[{inner}]"
        for number, one in enumerate(_models_of(field)):
            own, *below = key_sections(one, inner, inner_head)
            first = f"{field.description}\n\n" if number == 0 and field.description else ""
            yield replace(own, summary=first + own.summary)
            yield from below


def key_pages(kinds: Iterable[Kind]) -> str:
    """Write one chapter for each kind of measurement, with a table for each section (Markdown)."""
    lines = []
    for kind in kinds:
        model: type[MeasurementModel] = resolve(kind.model)
        lines += [
            f'## `kind = "{kind.name}"`',
            "",
            f"`heliogauge {kind.init_command('FOLDER')}` writes a template.",
            "",
        ]
        earlier = ""
        for section in key_sections(model):
            head = f"`{section.head}`" if section.head else "Top of the file"
            lines += [f"### {head}" if section.head != earlier else f"Or {head}:", "", section.summary, ""]
            earlier = section.head
            if section.rows:
                lines += ["| key | values | default | meaning |", "|---|---|---|---|"]
            for row in section.rows:
                cells = (f"`{row.key}`", row.values, row.default or "must be given", row.description)
                lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
            lines.append("")
    return "\n".join(lines)


def _models_of(field: FieldInfo) -> Iterator[type[BaseModel]]:
    yield from dict.fromkeys(_models_within(field.annotation))


def _models_within(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models_within(part)


def _row(name: str, field: FieldInfo) -> KeyRow:
    default = "" if field.is_required() else _text(field.get_default(call_default_factory=True))
    return KeyRow(name, _values(field.annotation, field.metadata), default, field.description or "")


def _text(value: object) -> str:
    if value is None or value in ((), {}, ""):
        return "none"
    if isinstance(value, bool):
        return "`true`" if value else "`false`"
    if isinstance(value, tuple):
        return "`[" + ", ".join(_text(one).strip("`") for one in value) + "]`"
    return f'`"{value}"`' if isinstance(value, str) else f"`{value}`"


_NAMES = {float: "number", int: "whole number", str: "text", bool: "true or false"}
_SIGNS = {Gt: ("gt", "above"), Ge: ("ge", "from"), Lt: ("lt", "below"), Le: ("le", "to")}


def _values(annotation: Any, metadata: list[Any]) -> str:
    """Say which values a key takes: from its type and the bounds that stand with it."""
    parts = get_args(annotation)
    origin = get_origin(annotation)
    if origin is Literal:
        return ", ".join(_text(one.value if isinstance(one, Enum) else one) for one in parts)
    if origin is dict:
        return f"table of {_values(parts[1], [])} by name"
    if origin is tuple:
        inner = _values(parts[0], [])
        return f"list of {inner}" if parts[-1] is Ellipsis else f"list of {len(parts)}: {inner}"
    if hasattr(annotation, "__metadata__"):
        return _values(parts[0], list(annotation.__metadata__))
    if parts:
        return " or ".join(dict.fromkeys(_values(part, []) for part in parts if part is not NoneType))
    bounds = [
        f"{word} {getattr(one, key):g}"
        for one in _flat(metadata)
        for sign, (key, word) in _SIGNS.items()
        if isinstance(one, sign)
    ]
    return " ".join([_NAMES.get(annotation, str(getattr(annotation, "__name__", annotation))), *bounds])


def _flat(metadata: list[Any]) -> Iterator[Any]:
    for one in metadata:
        yield from one.metadata if isinstance(one, FieldInfo) else (one,)
