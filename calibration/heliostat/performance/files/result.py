"""Results of the tests of a heliostat: summary, entries.csv, tables of rows, lines for the terminal."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf, isfinite
from pathlib import Path
from typing import Any, ClassVar

from calibration.heliostat.performance.entries import Entry
from heliogauge.errors import InputError
from heliogauge.reporting.notation import quantity_text
from heliogauge.results.folder import Summary, read_table_csv, unit_of, write_table_csv
from heliogauge.results.frame import InstrumentResult

ENTRIES_FILE = "entries.csv"
KIND = "heliostat-tests"
_TEXTS = ("test", "key", "label", "method", "date", "conditions", "note")


@dataclass(frozen=True, slots=True, eq=False)
class Result(InstrumentResult):
    """What the tests of one heliostat gave.

    entries: Lines of the data sheet.
    tables: Rows of the tests by name of their file, columns by name.
    about: What the data sheet says of heliostat, laboratory and place.
    """

    kind: ClassVar[str] = KIND
    entries: tuple[Entry, ...]
    tables: Mapping[str, Mapping[str, Sequence[Any]]] = field(default_factory=dict)
    about: Mapping[str, str] = field(default_factory=dict)

    def summarise(self) -> Summary:
        """Collect the headline numbers with their sigmas, doubts and provenance."""
        numbers: dict[str, float | int | None] = {}
        reasons = {}
        for one in self.entries:
            numbers[one.name] = one.value
            if one.value is None:
                said = value_text(one)
                reasons[one.name] = (one.note or said) if one.below is None else said
            elif one.sigma is not None:
                numbers[f"sigma_{one.name}"] = one.sigma
        return self._summary(numbers, dict(self.about), reasons)

    def write_files(self, folder: Path) -> None:
        """Write entries.csv and the rows of the tests into an existing folder."""
        write_entries(folder / ENTRIES_FILE, self.name, self.entries)
        for name, columns in self.tables.items():
            write_table_csv(folder / f"{name}.csv", columns)

    def headline(self) -> str:
        """Return the first entries of each test."""
        tests = len({one.test for one in self.entries})
        lines = [f"{self.name}: {len(self.entries)} entries of {tests} test{'s' if tests != 1 else ''}"]
        shown: dict[str, int] = {}
        for one in self.entries:
            shown[one.test] = shown.get(one.test, 0) + 1
            if shown[one.test] <= 2:
                lines.append(f"  {one.test}: {one.label}: {value_text(one)}")
        return "\n".join(lines)


def value_text(entry: Entry) -> str:
    """Return the value of an entry with its sigma as people read it."""
    if entry.value is None:
        return (
            "not measured" if entry.below is None else f"none seen, below {quantity_text(entry.key, entry.below, None)}"
        )
    return quantity_text(entry.key, entry.value, entry.sigma)


def write_entries(path: Path, heliostat: str, entries: Sequence[Entry]) -> None:
    """Write entries.csv; an unknown sigma or value is an empty cell, as are infinite degrees of freedom."""
    columns: dict[str, list[Any]] = {"heliostat": [heliostat] * len(entries)}
    for name in ("test", "key", "label"):
        columns[name] = [getattr(one, name) for one in entries]
    columns["value"] = [float("nan") if one.value is None else one.value for one in entries]
    columns["sigma"] = [float("nan") if one.sigma is None else one.sigma for one in entries]
    columns["below"] = [float("nan") if one.below is None else one.below for one in entries]
    columns["degrees"] = [one.degrees if isfinite(one.degrees) else float("nan") for one in entries]
    for name in ("method", "date", "conditions", "note"):
        columns[name] = [getattr(one, name) for one in entries]
    write_table_csv(path, columns)


def read_entries(path: Path) -> tuple[str, tuple[Entry, ...]]:
    """Read entries.csv: the heliostat, and its entries.

    InputError: Columns that are missing, cells that are no numbers, or rows of several heliostats.
    """
    table = read_table_csv(path, ("heliostat", *_TEXTS, "value", "sigma", "degrees"))
    names = sorted(set(table["heliostat"]))
    if len(names) != 1:
        raise InputError(f"{path}: entries of one heliostat are needed, not of {', '.join(names) or 'none'}")

    def number(name: str, row: int, missing: float | None) -> float | None:
        cell = table[name][row]
        if not cell:
            return missing
        try:
            return float(cell)
        except ValueError:
            raise InputError(f"{path}, row {row + 1}: {name} = {cell!r} is no number") from None

    entries = []
    for row in range(len(table["key"])):
        texts = {name: table[name][row] for name in _TEXTS}
        below = number("below", row, None) if "below" in table else None
        degrees = number("degrees", row, inf)
        unit_of(texts["key"])
        entries.append(
            Entry(
                value=number("value", row, None),
                sigma=number("sigma", row, None),
                degrees=degrees or inf,
                below=below,
                **texts,
            )
        )
    return names[0], tuple(entries)
