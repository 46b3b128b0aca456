"""How values show themselves: a few lines with names, sizes and ranges, never whole arrays."""

import html
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from itertools import islice
from typing import Any

#: Longest text of one value, longest line that stands alone, fields and members that are shown.
_LONGEST_VALUE, _LONGEST_LINE, _MOST_FIELDS, _MOST_MEMBERS = 76, 110, 22, 4
#: Arrays of so many numbers are shown whole: a vector, a rotation.
_WHOLE_ARRAY = 9


class ShortRepr:
    """Base of dataclasses that hold arrays or many members: a ``repr`` that one can read, and a table in notebooks.

    >>> from dataclasses import dataclass
    >>> import numpy as np
    >>> @dataclass
    ... class Ramp(ShortRepr):
    ...     name: str
    ...     values_m: object
    >>> Ramp("short", np.arange(3.0))
    Ramp(name='short', values_m=[0 1 2])
    >>> Ramp("long", np.arange(1e6))
    Ramp(name='long', values_m=(1000000,) float64, 0 to 999999)
    """

    __slots__ = ()

    def __init_subclass__(cls) -> None:
        """Set the short repr before a dataclass writes one that prints all arrays."""
        super().__init_subclass__()
        cls.__repr__ = ShortRepr.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        """Show the fields in a line, or one in each line where they are many."""
        return fields_text(type(self).__name__, _fields_of(self))

    def _repr_html_(self) -> str:
        return fields_html(type(self).__name__, _fields_of(self))


def fields_text(title: str, shown: Mapping[str, str]) -> str:
    """Put names and texts of values into one line, or below each other where they are long.

    >>> fields_text("Options", {"jobs": "2", "remove": "'tilt'"})
    "Options(jobs=2, remove='tilt')"
    """
    line = f"{title}({', '.join(f'{name}={text}' for name, text in shown.items())})"
    if len(line) <= _LONGEST_LINE:
        return line
    width = min(max(map(len, shown)), 24)
    return "\n".join([f"<{title}>", *(f"  {name:{width}}  {text}" for name, text in shown.items())])


def fields_html(title: str, shown: Mapping[str, str]) -> str:
    """Put names and texts of values into a table."""
    cell = 'style="text-align: left"'
    rows = "".join(
        f"<tr><th {cell}>{html.escape(name)}</th><td {cell}>{html.escape(text)}</td></tr>"
        for name, text in shown.items()
    )
    return f"<table><caption {cell}><b>{html.escape(title)}</b></caption><tbody>{rows}</tbody></table>"


def short_text(value: Any) -> str:
    """Return a value in at most some 80 characters: arrays as shape and range, collections as their first members.

    >>> short_text({"a": 1, "b": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]})
    "{'a': 1, 'b': [1.0, 2.0, 3.0, 4.0, ... 2 more]}"
    >>> import numpy as np
    >>> short_text(np.array([[True, False], [True, True]] * 20))
    '(40, 2) bool, 75 % true'
    """
    return shortened(_text(value, 0), _LONGEST_VALUE)


def shortened(text: str, longest: int) -> str:
    """Cut a text to a length, saying so by three dots.

    >>> shortened("abcdefghij", 8)
    'abcde...'
    """
    line = " ".join(text.split())
    return line if len(line) <= longest else line[: longest - 3] + "..."


def _fields_of(value: Any) -> dict[str, str]:
    names = [one.name for one in fields(value) if one.repr]
    shown = {name: short_text(getattr(value, name)) for name in names[:_MOST_FIELDS]}
    if len(names) > _MOST_FIELDS:
        shown["..."] = f"{len(names) - _MOST_FIELDS} more: {shortened(', '.join(names[_MOST_FIELDS:]), 60)}"
    return shown


def _text(value: Any, depth: int) -> str:
    if hasattr(value, "dtype") and hasattr(value, "shape"):
        return _array_text(value)
    if isinstance(value, Enum):
        return str(value.value)
    if hasattr(value, "__fspath__"):
        return str(value)
    if isinstance(value, float):
        return f"{value:.8g}" if abs(value) >= 1e16 or value != round(value, 6) else str(value)
    if isinstance(value, str | bytes):
        return repr(value[: 2 * _LONGEST_VALUE])
    if isinstance(value, type) or (callable(value) and hasattr(value, "__qualname__")):
        return str(value.__qualname__)
    if depth > 2:
        return type(value).__name__
    if isinstance(value, Mapping):
        members = (f"{_text(key, depth + 1)}: {_text(one, depth + 1)}" for key, one in value.items())
        return "{" + _members(members, len(value)) + "}"
    if isinstance(value, list | tuple | set | frozenset) and not hasattr(value, "_fields"):
        members = (_text(one, depth + 1) for one in value)
        opening, closing = ("[", "]") if isinstance(value, list) else ("(", ")") if isinstance(value, tuple) else "{}"
        return opening + _members(members, len(value)) + closing
    return _object_text(value, depth)


def _object_text(value: Any, depth: int) -> str:
    if is_dataclass(value) and not isinstance(value, type):
        names: Iterable[str] = [one.name for one in fields(value) if one.repr]
    elif hasattr(value, "_fields"):
        names = value._fields
    elif hasattr(type(value), "model_fields"):
        names = type(value).model_fields
    else:
        return repr(value)
    names = list(names)
    members = (f"{name}={_text(getattr(value, name), depth + 1)}" for name in names)
    return f"{type(value).__name__}({_members(members, len(names))})"


def _members(members: Iterable[str], count: int) -> str:
    shown = list(islice(members, _MOST_MEMBERS))
    return ", ".join(shown + ([f"... {count - _MOST_MEMBERS} more"] if count > _MOST_MEMBERS else []))


def _array_text(array: Any) -> str:
    import numpy as np

    array = np.asarray(array)
    kind = array.dtype.kind
    if array.size <= _WHOLE_ARRAY and kind in "biuf":
        numbers = np.array2string(
            array, max_line_width=10_000, formatter={"float_kind": lambda number: f"{number:.6g}"}
        )
        return " ".join(numbers.split()).replace("[ ", "[")
    head = f"{array.shape} {array.dtype}" if kind in "biufc" else f"{array.shape} values"
    if kind == "b":
        return f"{head}, {100 * float(array.mean()):.3g} % true"
    if kind not in "iuf":
        return head
    known = array[np.isfinite(array)] if kind == "f" else array
    missing = f", {array.size - known.size} missing" if known.size < array.size else ""
    return f"{head}, {known.min():.6g} to {known.max():.6g}{missing}" if known.size else f"{head}, all missing"
