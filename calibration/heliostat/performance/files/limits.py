"""Limits of a data sheet: what each entry must keep, from limits.toml."""

from dataclasses import dataclass, field
from math import pi
from pathlib import Path
from typing import Any

from calibration.heliostat.performance.entries import CONFIDENCE, Limit
from heliogauge.errors import InputError
from heliogauge.files.texts import read_toml
from heliogauge.instruments import near_match
from heliogauge.results.folder import unit_of

#: Ends of names in a user's files that stand for another unit than an entry's: its end, and the factor.
_UNITS = {
    "_mrad": ("_rad", 1e-3),
    "_urad": ("_rad", 1e-6),
    "_deg": ("_rad", pi / 180),
    "_mm": ("_m", 1e-3),
    "_percent": ("_share", 1e-2),
}
_KEYS = ("least", "most", "source")


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits by the names of entries (`Entry.name`), in the entries' units.

    confidence: Probability at which passing or failing counts as proven.
    source: The file's name.
    """

    by_name: dict[str, Limit] = field(default_factory=dict)
    confidence: float = CONFIDENCE
    source: str = ""


def read_limits(path: Path) -> Limits:
    """Read limits.toml.

    InputError: Not TOML, a key that is not known, a limit without an end, or a name without a unit.
    """
    content = read_toml(path)
    confidence = content.pop("confidence", CONFIDENCE)
    if not isinstance(confidence, float) or not 0.5 < confidence < 1:
        raise InputError(f"{path}: confidence = {confidence!r}: a number above 0.5 and below 1 is needed")
    found: dict[str, Limit] = {}
    for name, table in content.items():
        entry, factor = _entry_name(path, name)
        if entry in found:
            raise InputError(f"{path}: [{name}]: {entry} has a limit already, in another unit; keep one")
        found[entry] = _limit(path, name, table, factor)
    return Limits(found, confidence, path.name)


def in_entry_unit(name: str) -> tuple[str, float]:
    """Return a name with its unit as entries have it, and the factor that numbers of the named unit take.

    InputError: A name that does not end with a unit.

    >>> in_entry_unit("day_beam_rms_mrad")
    ('day_beam_rms_rad', 0.001)
    """
    for end, (unit, factor) in _UNITS.items():
        if name.endswith(end):
            return name.removesuffix(end) + unit, factor
    unit_of(name)
    return name, 1.0


def _entry_name(path: Path, name: str) -> tuple[str, float]:
    try:
        return in_entry_unit(name)
    except InputError:
        raise InputError(
            f"{path}: [{name}]: the name of an entry with its unit is needed, such as day_beam_rms_mrad"
        ) from None


def _limit(path: Path, name: str, table: Any, factor: float) -> Limit:
    if not isinstance(table, dict):
        raise InputError(f"{path}: {name} = {table!r:.40}: a section [{name}] with least or most is needed")
    for key in table:
        if key not in _KEYS:
            raise InputError(f"{path}: [{name}] {key}: not known; {near_match(key, _KEYS)}")
    ends: dict[str, float | None] = {"least": None, "most": None}
    for key in ends:
        value = table.get(key)
        if value is not None:
            if not isinstance(value, int | float) or isinstance(value, bool):
                raise InputError(f"{path}: [{name}] {key} = {value!r:.40}: a number is needed")
            ends[key] = factor * float(value)
    try:
        return Limit(ends["least"], ends["most"], str(table.get("source", "")))
    except InputError as error:
        raise InputError(f"{path}: [{name}]: {error}") from None
