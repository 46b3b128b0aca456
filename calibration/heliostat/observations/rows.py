"""Rows of observations as they were read: numbers, texts and times by column, and why a row cannot be used.

No row is ever dropped. A row that cannot be used keeps its place with a flag and a sentence, and comes out again in
``residuals.csv``.
"""

import csv
import datetime
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.formula_cells import plain_cell
from heliogauge.validate import BoolArray, FloatArray, TimeArray, freeze

#: Why a row of observations has no part in the fit; "" and "outlier" come from the fit itself.
ROW_FLAGS: dict[str, str] = {
    "": "used",
    "unreadable": "the row or file cannot be read",
    "not_finite": "a number that is needed is missing or not finite",
    "time": "the time cannot be placed: no zone, or no time at all",
    "target": "no such target",
    "camera": "no such camera",
    "sun": "the sun was below the horizon, or not where the time puts it",
    "units": "the number is too large for its unit",
    "reading": "the drives cannot have stood there",
    "duplicate": "repeats an earlier row",
    "label": "the centre by the chosen method is missing",
    "off_target": "the beam's centre is off its target",
    "image": "the photo gave no centre",
    "outlier": "contradicts the others",
}

TEXT_COLUMNS = ("heliostat", "time_utc", "kind", "target", "camera", "lamp", "position", "point", "image", "split")
NUMBER_COLUMNS = (
    *(f"axis_{axis}_{unit}" for unit in ("counts", "deg", "rad") for axis in (1, 2)),
    *("x_m", "y_m", "e_m", "n_m", "u_m"),
    *("sigma_mm", "sigma_x_mm", "sigma_y_mm", "sigma_mrad"),
    *("drone_e_m", "drone_n_m", "drone_u_m", "sigma_drone_e_mm", "sigma_drone_n_mm", "sigma_drone_u_mm"),
    *("normal_e", "normal_n", "normal_u", "point_x_m", "point_y_m", "point_z_m"),
    *("lamp_e_m", "lamp_n_m", "lamp_u_m", "direction_x", "direction_y", "direction_z"),
    *("sun_azimuth_deg", "sun_elevation_deg", "approach_1", "approach_2"),
)
NO_TIME = np.datetime64("NaT", "ms")


class ColumnError(InputError):
    """A whole column is wrong in one way, so that no number that comes of it would be true.

    kind: Which way, by the names of a diagnosis: "units", "sun_convention", "time_offset", "constant_column".
    text: What, where, and the remedy.
    """

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind = kind


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Observations of one heliostat as they were read.

    ids length n: What a person calls each row: its line, or the number of its file.
    numbers (n,): Columns of numbers; NaN where the cell is empty.
    texts length n: Columns of texts.
    times (n,): Time of each row (UTC); NaT where there is none.
    flags, reasons length n: Why a row cannot be used (a key of `ROW_FLAGS`), and the sentence; empty where it can.
    """

    ids: tuple[str, ...]
    numbers: Mapping[str, FloatArray]
    texts: Mapping[str, tuple[str, ...]]
    times: TimeArray
    flags: tuple[str, ...]
    reasons: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.ids)

    def number(self, name: str) -> FloatArray:
        """Return a column of numbers, NaN where the table has none; shape (n,)."""
        return self.numbers.get(name, np.full(len(self), np.nan))

    def vector(self, *names: str) -> FloatArray:
        """Return several columns side by side, shape (n, number of names)."""
        return np.column_stack([self.number(name) for name in names])

    def text(self, name: str, default: str = "") -> tuple[str, ...]:
        """Return a column of texts; the default where a cell is empty."""
        column = self.texts.get(name, ("",) * len(self))
        return tuple(cell or default for cell in column)


class Verdicts:
    """Collects why rows cannot be used; the first reason of a row stays.

    rows: The rows, with what was found wrong on reading.
    """

    def __init__(self, rows: Rows) -> None:
        self.flags = list(rows.flags)
        self.reasons = list(rows.reasons)

    @property
    def usable(self) -> BoolArray:
        """Whether each row can still be used, shape (n,)."""
        return np.array([not flag for flag in self.flags], dtype=np.bool_)

    def refuse(self, where: npt.ArrayLike, flag: str, reason: str | Callable[[int], str]) -> None:
        """Refuse the rows of a mask (n,); the reason may depend on the row."""
        for row in np.nonzero(np.asarray(where))[0].tolist():
            if not self.flags[row]:
                self.flags[row] = flag
                self.reasons[row] = reason if isinstance(reason, str) else reason(row)

    def judged(self, rows: Rows) -> Rows:
        """Return the rows with the verdicts."""
        return Rows(rows.ids, rows.numbers, rows.texts, rows.times, tuple(self.flags), tuple(self.reasons))


def check_header(header: Sequence[str], where: str, known: Iterable[str]) -> None:
    """Refuse columns that nobody knows and columns that are there twice.

    where: The file, for messages.
    known: Names that may be there.
    InputError: Names the column and the near match.
    """
    names = list(known)
    for name in header:
        if header.count(name) > 1:
            raise InputError(f"{where}: the column {name!r} is there {header.count(name)} times; keep one")
        if name not in names:
            near = get_close_matches(name, names, n=1, cutoff=0.6)
            hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(names)}"
            raise InputError(f"{where}: {name!r} is not a column here; {hint}")


def parse_rows(header: Sequence[str], lines: Mapping[int, str]) -> Rows:
    """Read lines of a table of observations.

    header: Names of the columns.
    lines: Text of each line by its number.
    Returns: The rows; cells that cannot be read are flagged.
    """
    cells, flags, reasons = [], [], []
    for text, row in zip(lines.values(), _cells(list(lines.values())), strict=True):
        fits = len(row) == len(header)
        flags.append("" if fits else "unreadable")
        reasons.append("" if fits else f"{len(row)} cells, the header has {len(header)}: {text.strip()[:60]}")
        cells.append(row if fits else [""] * len(header))
    columns = dict(zip(header, zip(*cells, strict=True), strict=True)) if cells else dict.fromkeys(header, ())
    texts = {name: tuple(cell.strip() for cell in columns[name]) for name in TEXT_COLUMNS if name in columns}
    blank = Rows(
        tuple(f"line {line}" for line in lines), {}, texts, np.full(len(cells), NO_TIME), tuple(flags), tuple(reasons)
    )
    verdicts = Verdicts(blank)
    numbers = {name: _numbers(name, columns[name], verdicts) for name in header if name not in TEXT_COLUMNS}
    times = parse_times(texts["time_utc"], verdicts) if "time_utc" in texts else blank.times
    return verdicts.judged(Rows(blank.ids, numbers, texts, times, blank.flags, blank.reasons))


def _cells(lines: Sequence[str]) -> list[list[str]]:
    """Split each line by itself: a quotation mark that is never closed must not swallow the rows below it."""
    whole = [line.rstrip("\r\n").replace("\r", " ") for line in lines]
    if any('"' in line for line in whole):
        rows = [split_line(line) for line in whole]
    else:
        rows = [line.split(",") if line else [] for line in whole]
    return [list(map(plain_cell, row)) for row in rows] if any("'" in line for line in whole) else rows


def split_line(line: str) -> list[str]:
    """Split one line of CSV by itself; no cells where it cannot be split."""
    try:
        return next(csv.reader([line]), [])
    except csv.Error:
        return []


def _numbers(name: str, cells: Sequence[str], verdicts: Verdicts) -> FloatArray:
    try:
        values = np.array([float(cell) if cell else np.nan for cell in cells])
    except ValueError:
        values = np.array([_number(cell) for cell in cells])
        for row, cell in enumerate(cells):
            if cell.strip() and np.isnan(values[row]):
                mask = np.arange(len(cells)) == row
                hint = "; the decimal sign must be a point" if "," in cell else ""
                verdicts.refuse(mask, "unreadable", f"{name} = {cell.strip()!r} is no number{hint}")
    return np.asarray(freeze(values))


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def parse_times(texts: Sequence[str], verdicts: Verdicts) -> TimeArray:
    """Read times in ISO 8601 with a zone, as UTC.

    Shapes: result (n,).
    texts: Such as ``2026-06-21T10:00:00Z`` or ``2026-06-21 12:00:00+02:00``; empty for none.
    verdicts: Takes the rows whose time cannot be placed.
    """
    times = np.full(len(texts), NO_TIME)
    for row, text in enumerate(texts):
        if not text:
            continue
        try:
            times[row] = parse_time(text)
        except InputError as error:
            verdicts.refuse(np.arange(len(texts)) == row, "time", str(error))
    return np.asarray(freeze(times))


def parse_time(text: str) -> np.datetime64:
    """Read a time in ISO 8601 with a zone, as UTC.

    InputError: No time, or one without a zone.
    """
    try:
        moment = datetime.datetime.fromisoformat(text)
    except ValueError:
        raise InputError(f"time_utc = {text!r} is no time; write 2026-06-21T10:00:00Z") from None
    if moment.tzinfo is None:
        raise InputError(f"time_utc = {text!r} has no zone; write {text.replace(' ', 'T')}Z if it is UTC")
    return np.datetime64(moment.astimezone(datetime.UTC).replace(tzinfo=None), "ms")


def rows_of(
    ids: Sequence[str], columns: Mapping[str, Sequence[Any]], times: TimeArray, verdicts: Sequence[tuple[str, str]]
) -> Rows:
    """Build rows from columns that are read already.

    Shapes: times (n,).
    ids length n: What a person calls each row.
    columns length n: Columns by the names of the table.
    verdicts length n: Flag and reason of each row.
    """
    numbers = {
        name: np.asarray(freeze(np.array(column, dtype=np.float64)))
        for name, column in columns.items()
        if name not in TEXT_COLUMNS
    }
    texts = {name: tuple(column) for name, column in columns.items() if name in TEXT_COLUMNS}
    flags, reasons = tuple(flag for flag, _ in verdicts), tuple(reason for _, reason in verdicts)
    return Rows(tuple(ids), numbers, texts, times, flags, reasons)
