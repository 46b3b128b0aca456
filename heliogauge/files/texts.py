"""Text files: plain text, JSON, TOML and CSV, in UTF-8."""

import csv
import io
import json
import math
import re
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from heliogauge.errors import InputError
from heliogauge.files.memory import MIB, refuse_large
from heliogauge.files.regular import read_regular

#: Largest files of each kind. A table of residuals of a million observations has 300 MiB, a cameras.json of 10,000
#: photos 20 MiB, a measurement.toml a few KiB (the standard library reads a usual MiB of TOML in a second, the
#: worst legal one in five).
MOST_JSON_BYTES, MOST_CSV_BYTES, MOST_TOML_BYTES, MOST_TEXT_BYTES = 256 * MIB, 2048 * MIB, MIB, 1024 * MIB

# "{}," is three characters and a dict of 64 bytes in a list; "," is one, and an empty cell a pointer of 8.
_JSON_GROWTH, _CSV_GROWTH, _TEXT_GROWTH = 26, 20, 6
# Whole numbers of JSON and TOML are 64 bit wherever a program of ours reads them.
_MOST_DIGITS, _LARGEST_INTEGER = 19, 2**63 - 1
_NO_TEXT = re.compile(r"\\u(?:0000|[dD][89a-fA-F])|\\U00000000|\x00")
_DEEPEST = 200
# The standard library keeps every beginning of a dotted key: 16,000 parts, 32 kB of file, take 1 GB.
_MOST_KEY_PARTS = 16
# Strings and comments, whole or cut off; points; whatever ends a key or a value. Each character is looked at once.
_TOML_MARKS = re.compile(
    r"""\"{3}(?:[^"\\]|\\.|"(?!""))*+(?:"{3})?|'{3}(?:[^']|'(?!''))*+(?:'{3})?"""
    r"""|"(?:[^"\\\n]|\\[^\n])*+"?|'[^'\n]*+'?|\#[^\n]*+|(?P<point>\.)|(?P<end>[\[\]{},=\n])""",
    re.DOTALL,
)


def read_text(path: Path, kind: str = "a text file", most_bytes: int = MOST_TEXT_BYTES) -> str:
    """Read a text file in UTF-8, with or without byte order mark.

    kind: What it should be, for messages.
    most_bytes: Largest size.
    InputError: No such file, no regular file, too large, not UTF-8, or it holds NUL characters.
    """
    return _decoded(path, read_regular(path, kind, most_bytes), kind)


def read_json(path: Path, *, nan: bool = False) -> Any:
    """Read a JSON file.

    nan: Whether NaN and Infinity, which JSON does not have, are taken as numbers.
    InputError: As `read_text`; or not valid JSON.
    """
    text = read_text(path, "a JSON file", MOST_JSON_BYTES)
    refuse_large(str(path), _JSON_GROWTH * _marks(text), "its values")
    return parse_json(text, str(path), nan=nan)


def parse_json(text: str, where: str, *, nan: bool = False) -> Any:
    """Read JSON from a text.

    where: Where it comes from, for messages.
    nan: Whether NaN and Infinity, which JSON does not have, are taken as numbers.
    InputError: Not valid JSON.
    """

    def constant(name: str) -> float:
        if nan:
            return float(name.replace("Infinity", "inf"))
        raise ValueError(f"{name} is no number of JSON; write null")

    try:
        content = json.loads(text, parse_constant=constant, parse_int=_integer, parse_float=None if nan else _finite)
    except RecursionError:
        raise InputError(f"{where}: not valid JSON (nested too deeply); is the file whole?") from None
    except ValueError as error:
        raise InputError(f"{where}: not valid JSON ({error}); is the file whole?") from error
    except MemoryError as error:
        raise InputError(f"{where}: there is not enough memory to read it") from error
    _check_depth(where, "JSON", content if isinstance(content, dict | list) else [])
    if _NO_TEXT.search(text):
        _check_texts(where, content)
    return content


def _finite(digits: str) -> float:
    value = float(digits)
    if math.isinf(value):
        raise ValueError(f"{digits[:40]} is beyond the numbers that a program can hold")
    return value


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    InputError: As `read_text`; or not valid TOML.
    """
    text = read_text(path, "a TOML file", MOST_TOML_BYTES)
    _check_keys(str(path), text)
    try:
        content = tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{path}: not valid TOML: nested too deeply; correct the brackets") from None
    except ValueError as error:
        raise InputError(f"{path}: not valid TOML: {error}; correct that line") from None
    _check_depth(str(path), "TOML", content)
    _check_integers(str(path), content)
    if _NO_TEXT.search(text):
        _check_texts(str(path), content)
    return content


def read_csv(path: Path) -> list[tuple[int, list[str]]]:
    """Read all lines of a CSV file that are not empty.

    Returns: Number of the line (where a row of several lines ends) and its cells.
    InputError: As `read_text`; a cell that is too long, or a quotation mark that is never closed.
    """
    text = read_text(path, "a CSV file", MOST_CSV_BYTES)
    refuse_large(str(path), _CSV_GROWTH * (text.count(",") + text.count("\n")) + len(text), "its cells")
    # Only line feeds and carriage returns end a line: a form feed or a separator of paragraphs may stand in a cell.
    return list(csv_rows(io.StringIO(text, newline=""), str(path)))


def csv_rows(lines: Iterable[str], where: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows of lines of CSV that are not empty, with the number of the line.

    where: Where they come from, for messages.
    InputError: A cell that is too long, or a quotation mark that is never closed.
    """
    # Strict: otherwise a quotation mark that is never closed swallows all rows below it.
    rows = csv.reader(lines, strict=True)
    try:
        for row in rows:
            if row:
                yield rows.line_num, row
    except csv.Error as error:
        raise InputError(
            f"{where}, line {rows.line_num}: cannot be read as CSV ({error}); is a quotation mark missing?"
        ) from error


def _decoded(path: Path, content: bytes, kind: str) -> str:
    refuse_large(str(path), _TEXT_GROWTH * len(content), "its text")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: byte {error.start} is not UTF-8; save it as UTF-8 text") from None
    except MemoryError as error:
        raise InputError(f"{path}: there is not enough memory to read it") from error
    if "\0" in text:
        raise InputError(f"{path}: byte {text.index(chr(0))} is NUL, so it is not {kind}; save it as UTF-8 text")
    return text


def _marks(text: str) -> int:
    """Count what makes values of JSON."""
    return sum(map(text.count, ",[{"))


def _integer(digits: str) -> int:
    if len(digits) > _MOST_DIGITS + 1 or abs(value := int(digits)) > _LARGEST_INTEGER:
        raise ValueError(f"the whole number {digits[:30]} is beyond 64 bit")
    return value


def _check_depth(where: str, kind: str, content: Any) -> None:
    """Refuse what is nested so deeply that programs that walk through it fail."""
    level, depth = [content], 0
    while level:
        if depth > _DEEPEST:
            raise InputError(f"{where}: not valid {kind}: nested more than {_DEEPEST} deep; correct the brackets")
        inside = (one.values() if isinstance(one, dict) else one for one in level)
        level = [value for values in inside for value in values if isinstance(value, dict | list)]
        depth += 1


def _check_keys(where: str, text: str) -> None:
    """Refuse dotted keys of more parts than a table is deep, before they are read."""
    points = 0
    for mark in _TOML_MARKS.finditer(text):
        if mark["point"]:
            points += 1
        elif mark["end"]:
            points = 0
        if points >= _MOST_KEY_PARTS:
            line = text.count("\n", 0, mark.start()) + 1
            raise InputError(
                f"{where}: not valid TOML: line {line}: nested too deeply, more than {_MOST_KEY_PARTS} names joined by "
                "points; correct that line"
            )


def _check_integers(where: str, content: Any) -> None:
    """Refuse whole numbers that no array can hold; the standard library reads them from TOML."""
    waiting = [content]
    while waiting:
        one = waiting.pop()
        if isinstance(one, dict | list):
            waiting.extend(one.values() if isinstance(one, dict) else one)
        elif isinstance(one, int) and abs(one) > _LARGEST_INTEGER:
            raise InputError(f"{where}: not valid TOML: a whole number is beyond 64 bit; correct it")


def _check_texts(where: str, content: Any) -> None:
    """Refuse texts that no file name and no page can hold."""
    waiting = [content]
    while waiting:
        one = waiting.pop()
        if isinstance(one, dict):
            waiting.extend([*one, *one.values()])
        elif isinstance(one, list):
            waiting.extend(one)
        elif isinstance(one, str) and ("\0" in one or any("\ud800" <= sign <= "\udfff" for sign in one)):
            raise InputError(f"{where}: the text {one[:60]!r} holds NUL or half a character; correct it")
