"""JSON files that hold one object: readable, UTF-8, never with NaN."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from heliogauge.errors import InputError
from heliogauge.files import texts


def json_text(name: str, content: Mapping[str, Any]) -> str:
    """Return what a JSON file of some name holds, readable, never with NaN.

    InputError: A number is not finite.
    """
    try:
        return _laid_out(content, "\n") + "\n"
    except ValueError as error:
        raise InputError(f"{name}: NaN or infinity cannot be written as JSON; null and a reason are needed") from error


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file, readable, UTF-8, never with NaN.

    InputError: A number is not finite, or the file cannot be written.
    """
    text = json_text(path.name, content)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error})") from error


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON file that holds an object."""
    content = texts.read_json(path)
    if not isinstance(content, dict):
        raise InputError(f"{path}: a JSON object is needed, not a {type(content).__name__}")
    return content


def _laid_out(value: Any, line: str) -> str:
    """Return JSON with one line for each key; lists of numbers and names stay on theirs.

    The standard library's own layout puts each number on a line, and takes ten times as long: it is written in Python.
    """
    deeper = line + " "
    if isinstance(value, Mapping) and value:
        inside = (f"{_CODER.encode(_key(key))}: {_laid_out(one, deeper)}" for key, one in value.items())
        return "{" + deeper + f",{deeper}".join(inside) + line + "}"
    if isinstance(value, list | tuple) and any(issubclass(kind, Mapping) for kind in set(map(type, value))):
        return "[" + deeper + f",{deeper}".join(_laid_out(one, deeper) for one in value) + line + "]"
    return _CODER.encode(dict(value) if isinstance(value, Mapping) else value)


def _key(key: Any) -> str:
    """Return the name of a key as JSON has it."""
    return key if isinstance(key, str) else next(iter(json.loads(_CODER.encode({key: None}))))


def _python_number(value: Any) -> Any:
    # numpy scalars and arrays, without importing numpy here.
    if hasattr(value, "tolist"):
        return value.tolist()
    raise InputError(f"a {type(value).__name__} cannot be written as JSON")


_CODER = json.JSONEncoder(ensure_ascii=False, allow_nan=False, default=_python_number)
