"""A user's own ring codes from a file, CSV or TOML, and dictionaries by name or file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from heliogauge.errors import InputError
from heliogauge.files.texts import csv_rows, read_text, read_toml
from photogrammetry.targets.coded_targets import RingDictionary, ring_dictionary
from photogrammetry.targets.ring_codes import RingRadii, Sense

#: Keys of the print, in CSV as comment lines before the table: ``# bits = 12``.
_KEYS = ("name", "bits", "sense", "inner_radius", "outer_radius")
#: A dictionary of 20 bit has 52,487 words at most.
MOST_CODES_BYTES = 8 << 20
_SUFFIXES = (".csv", ".toml")


@dataclass(frozen=True, slots=True)
class CodePrint:
    """What is known of the print beside the dictionary; what is not given stays as in the dictionary.

    sense: Sense in which the bits follow each other, highest bit first.
    inner_radius, outer_radius: Where the code ring begins and ends, in radii of the dot.
    """

    sense: Sense | None = None
    inner_radius: float | None = None
    outer_radius: float | None = None

    def of(self, dictionary: RingDictionary) -> RingDictionary:
        """Return a dictionary as it is printed.

        InputError: Radii that no print has.
        """
        inner, outer = self.inner_radius, self.outer_radius
        known = dictionary.radii
        radii = RingRadii(known.inner if inner is None else inner, known.outer if outer is None else outer)
        return dictionary.as_printed(self.sense, radii)


def load_dictionary(named: str, folder: Path, printed: CodePrint | None = None) -> RingDictionary:
    """Return a vendor's dictionary, or that of a user's file.

    named: ``aicon-12``, ``metashape-14``..., or a file that ends in ``.csv`` or ``.toml``.
    printed: What is known of the print beside it.
    InputError: No such dictionary or file, or a file with faults.
    """
    is_file = Path(named).suffix.lower() in _SUFFIXES
    found = read_ring_codes(folder / named) if is_file else ring_dictionary(named)
    return found if printed is None else printed.of(found)


def read_ring_codes(path: Path) -> RingDictionary:
    """Read a user's own ring codes.

    path: CSV: comment lines ``# bits = 12`` (needed), ``# sense = counterclockwise``, ``# inner_radius = 2.0``, ``#
        outer_radius = 3.0``, then a table with the column ``word`` and, if the words are not the names, ``name``.
        TOML: the same keys, and ``words = [...]`` or a table ``[codes]`` of names and words. A word is a number, or
        a text of its bits, highest first.
    Returns: The dictionary, under the file's name.
    """
    says, names, words = _from_toml(path) if path.suffix.lower() == ".toml" else _from_csv(path)
    bits = _number(path, says, "bits", None)
    if bits != int(bits):
        raise InputError(f"{path}: bits = {bits:g}: a whole number is needed")
    sense = str(says.get("sense", Sense.CLOCKWISE))
    if sense not in tuple(Sense):
        raise InputError(f"{path}: sense = {sense!r}: {' or '.join(Sense)} is needed")
    numbers = [_word(path, name, word, int(bits)) for name, word in zip(names, words, strict=True)]
    try:
        radii = RingRadii(_number(path, says, "inner_radius", 2.0), _number(path, says, "outer_radius", 3.0))
        title = str(says.get("name", path.stem))
        return RingDictionary(title, int(bits), tuple(numbers), tuple(names), Sense(sense), radii)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


Content = tuple[Mapping[str, Any], Sequence[str], Sequence[Any]]


def _from_toml(path: Path) -> Content:
    says = read_toml(path)
    words, codes = says.pop("words", None), says.pop("codes", None)
    _check_keys(path, says, (*_KEYS, "words", "codes"))
    if (words is None) == (codes is None):
        raise InputError(f'{path}: give words = [65, 71] or a table [codes] with lines "name" = word, one of both')
    if codes is None:
        if not isinstance(words, list):
            raise InputError(f"{path}: words = {words!r}: a list is needed")
        return says, [str(word) for word in words], words
    if not isinstance(codes, dict):
        raise InputError(f"{path}: codes: a table [codes] is needed")
    return says, list(codes), list(codes.values())


def _from_csv(path: Path) -> Content:
    says: dict[str, Any] = {}
    lines = []
    for line in read_text(path, "a CSV file", MOST_CODES_BYTES).splitlines():
        if not line.lstrip().startswith("#"):
            lines.append(line)
            continue
        key, equals, value = line.lstrip().lstrip("#").partition("=")
        if equals:
            says[key.strip()] = value.strip().strip('"')
    _check_keys(path, says, _KEYS)
    stripped = ([cell.strip() for cell in row] for _, row in csv_rows(lines, str(path)))
    rows = [row for row in stripped if any(row)]
    if not rows or "word" not in rows[0]:
        raise InputError(f"{path}: a column word is needed (and name, if the words are not the names)")
    strangers = set(rows[0]) - {"name", "word"}
    if strangers:
        raise InputError(f"{path}: unknown column {sorted(strangers)[0]!r}; the columns are name and word")
    short = next((row for row in rows[1:] if len(row) != len(rows[0])), None)
    if short is not None:
        raise InputError(f"{path}: the row {','.join(short)!r} has {len(short)} cells, {len(rows[0])} are needed")
    words = [row[rows[0].index("word")] for row in rows[1:]]
    names = [row[rows[0].index("name")] for row in rows[1:]] if "name" in rows[0] else words
    return says, names, words


def _check_keys(path: Path, says: Mapping[str, Any], known: Sequence[str]) -> None:
    for key in says:
        if key not in known:
            near = get_close_matches(key, known, 1)
            hint = f"; {near[0]} is meant?" if near else f"; the keys are {', '.join(known)}"
            raise InputError(f"{path}: unknown key {key!r}{hint}")


def _number(path: Path, says: Mapping[str, Any], key: str, default: float | None) -> float:
    value = says.get(key, default)
    if value is None:
        raise InputError(f"{path}: {key} is missing: the number of sectors of the code ring, 8 to 20")
    try:
        return float(value)
    except (TypeError, ValueError):
        raise InputError(f"{path}: {key} = {value!r}: a number is needed") from None


def _word(path: Path, name: str, word: Any, bits: int) -> int:
    """Return a word that was given as a number or as its bits."""
    text = str(word).strip()
    is_bits = len(text) == bits and set(text) <= {"0", "1"}
    try:
        number = int(text, 2) if is_bits else int(text, 0)
    except ValueError:
        raise InputError(
            f"{path}: word {text!r} of target {name!r}: a number (65, 0b1000001) or {bits} bits are needed"
        ) from None
    if not 0 < number < 1 << bits:
        raise InputError(f"{path}: word {text} of target {name!r}: words of {bits} bit are 1 to {(1 << bits) - 1}")
    return number
