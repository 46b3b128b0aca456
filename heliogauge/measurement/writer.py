"""Write measurement.toml: the little of TOML that a measurement needs, checked before it is written."""

import datetime
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from heliogauge.errors import InputError
from heliogauge.measurement.load import MEASUREMENT_FILE, parse_measurement
from heliogauge.measurement.models import MeasurementModel


def write_measurement(folder: Path, content: MeasurementModel | Mapping[str, Any], *, comment: str = "") -> Path:
    """Write a measurement.toml that `heliogauge.measurement.load` accepts.

    folder: The measurement's folder; made if absent. An existing measurement.toml is replaced.
    content: What the file shall say; arrays and numbers of numpy are taken, None leaves a key out.
    comment: Lines to put at the top.
    InputError: The content is not a measurement.

    The file is written beside and moved into place: it is whole or not there.
    """
    file = folder / MEASUREMENT_FILE
    if isinstance(content, MeasurementModel):
        content = content.model_dump(exclude_none=True, exclude_defaults=True)
    tables = _plain(content)
    parse_measurement(tables, file)
    head = "".join(f"# {line}".rstrip() + "\n" for line in comment.splitlines())
    folder.mkdir(parents=True, exist_ok=True)
    return write_text(file, (head + "\n" if head else "") + dump_toml(tables))


def write_text(file: Path, text: str) -> Path:
    """Write a text file so that it is whole or not there.

    file: The file; replaced if it exists.
    InputError: The folder cannot be written to.
    """
    beside = file.with_name(f".{file.name}.{os.getpid()}")
    try:
        beside.write_text(text, encoding="utf-8")
        beside.replace(file)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise InputError(f"{file}: cannot be written ({error.strerror}); check permissions and space") from error
    return file


def dump_toml(content: Mapping[str, Any]) -> str:
    """Format tables as TOML: values first, then sub-tables, then lists of tables.

    content: Text, numbers, dates, lists and tables of them; arrays and numbers of numpy too; None leaves a key out.
    Returns: TOML that `tomllib` reads back to the same values.
    InputError: A number is not finite, or a value is of a type TOML does not know.

    >>> print(dump_toml({"name": "A", "camera": {"focal_px": 1e3}}))
    name = "A"
    <BLANKLINE>
    [camera]
    focal_px = 1000.0
    <BLANKLINE>
    """
    import tomlkit

    return tomlkit.dumps(_plain(content))


def _plain(value: Any) -> Any:
    """Turn tuples, paths and numpy's types into what TOML has; leave out what is None.

    InputError: A number is not finite, or a value is of a type TOML does not know.
    """
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items() if item is not None}
    if isinstance(value, os.PathLike):
        return Path(value).as_posix()
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return [_plain(item) for item in value]
    if isinstance(value, str):
        # An enumeration's member is a text too: keep the text.
        return str(value)
    if isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"a measurement file cannot hold the number {value}")
    if not isinstance(value, float | int | datetime.date):
        raise InputError(f"a measurement file cannot hold a value of type {type(value).__name__}: {value!r:.60}")
    return value
