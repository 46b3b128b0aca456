"""What of a result goes into the store: its numbers with their sigmas, facet by facet, and rows of beams by time."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calibration.survey.files.moments import read_moment, refuse_impossible
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import InputError
from heliogauge.files.regular import read_regular
from heliogauge.geometry.sun import utc_times
from heliogauge.results.folder import SUMMARY_FILE, Summary, read_summary, read_table_csv
from heliogauge.validate import FloatArray, TimeArray

#: Columns of the store, in order; those of a result before it is known by a name.
COLUMNS = ("subject", "part", "kind", "quantity", "value", "sigma", "time", "source", "result")
OWN_COLUMNS = COLUMNS[:-1]
#: Tables whose rows are results of their own: by name of file, the column of the subject and the quantities.
_ROW_TABLES: Mapping[str, tuple[str, ...]] = {
    "beams.csv": ("x_m", "y_m", "d90_m", "width_major_m", "width_minor_m"),
    "day_rows.csv": ("beam_right_rad", "beam_up_rad"),
    "wind_rows.csv": ("beam_right_rad", "beam_up_rad"),
}
_SIGMA_NAMES = {"beam_right_rad": "sigma_right_rad", "beam_up_rad": "sigma_up_rad"}
#: Words of a summary that say when was measured.
_DATE_KEYS = ("date", "time", "measured")
#: Tables that say when was measured where the summary does not.
_TIMED_TABLES = ("residuals.csv", *_ROW_TABLES)


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Rows for the store, columns by name: texts as lists, numbers as arrays."""

    columns: dict[str, np.ndarray[tuple[int, ...], np.dtype[np.generic]]]

    def __len__(self) -> int:
        return len(self.columns["value"])

    def series(self) -> set[tuple[str, str, str]]:
        """Return which series the rows belong to: subject, part, quantity."""
        return set(zip(*(self.columns[name].tolist() for name in ("subject", "part", "quantity")), strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class StoredResult:
    """A result as it goes into a store.

    folder: Where it comes from.
    kind, subject: Kind of result, what was measured.
    rows: Its rows, all of them.
    measurement: Hash of what was measured (photos and tables, not settings); empty where the result says none.
    summary: Hash of its summary.json.
    taken_over: From a store without a manifest, where it may be a part of the result.
    doubts: What makes the result doubtful, without its notes and numbers.
    """

    folder: Path
    kind: str
    subject: str
    rows: Rows
    measurement: str
    summary: str
    taken_over: bool = False
    doubts: tuple[Doubt, ...] = ()


def read_result(folder: Path, *, date: str | None = None, subject: str | None = None) -> StoredResult:
    """Read what of a result goes into the store.

    date: Day of the measurement where the result does not say it, YYYY-MM-DD.
    subject: What was measured; None: the result's name.
    InputError: No results, no date, no numbers, or a table that cannot be read.
    """
    digest = hashlib.sha256(read_regular(folder / SUMMARY_FILE, "a summary of results")).hexdigest()
    summary = read_summary(folder / SUMMARY_FILE)
    name = subject or summary.name
    first = _of_entries(folder, name, summary, date)
    if first is None:
        first = _of_numbers(summary, name, _moment(folder, summary, date), folder.name)
    tables = [
        _of_table(folder / file, quantities, name, summary.kind, folder.name)
        for file, quantities in _ROW_TABLES.items()
        if (folder / file).is_file()
    ]
    pieces = [piece for piece in (first, *tables) if piece is not None and len(piece)]
    if not pieces:
        raise InputError(f"{folder}: the result holds no numbers")
    rows = Rows({column: np.concatenate([piece.columns[column] for piece in pieces]) for column in OWN_COLUMNS})
    doubts = tuple(replace(one, numbers={}) for one in summary.doubts if one.severity is not Severity.NOTE)
    return StoredResult(folder, summary.kind, name, rows, _measurement(summary), digest, doubts=doubts)


def _measurement(summary: Summary) -> str:
    """Return the hash of what was measured: of photos and tables, whatever their names, not of settings.

    The same photos with a measurement.toml or a camera.json that was corrected are the same measurement. Heliostats
    come with tables of what is known of them: their results say the hash of the observations alone.
    """
    observations = summary.input_sha256.get("observations")
    if observations:
        return _digest([summary.kind, observations])
    data = {digest for file, digest in summary.input_sha256.items() if not file.endswith((".toml", ".json"))}
    data = data or set(summary.input_sha256.values())
    return _digest([summary.kind, *sorted(data)]) if data else ""


def numbers_digest(rows: Rows) -> str:
    """Return the hash of what rows say, in whatever order they stand."""
    columns = rows.columns
    texts = [columns[name].tolist() for name in ("subject", "part", "kind", "quantity")]
    numbers = [map(float.hex, columns[name].tolist()) for name in ("value", "sigma")]
    times = columns["time"].astype("datetime64[us]").astype(np.int64).tolist()
    return _digest(
        sorted("\x1f".join((*words, str(time))) for *words, time in zip(*texts, *numbers, times, strict=True))
    )


def result_name(numbers: str, measurement: str) -> str:
    """Return what a result is known by: neither how long it took to evaluate, nor when, nor the folder counts."""
    return _digest([numbers, measurement])[:32]


def _digest(texts: Sequence[str]) -> str:
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()


def _moment(folder: Path, summary: Summary, date: str | None) -> np.datetime64:
    """Return when was measured: as the summary says, else the latest row of its tables, else as the user says."""
    text = next((summary.texts[key] for key in _DATE_KEYS if summary.texts.get(key)), None)
    if text is not None:
        return read_moment(text, f"{folder / SUMMARY_FILE}")
    # A field is as late as its heliostats.
    times = [_latest(file) for name in _TIMED_TABLES for file in (folder / name, *folder.glob(f"*/{name}"))]
    known = [time for time in times if time is not None]
    if known:
        return max(known)
    if date is not None:
        return read_moment(date, f"{folder}")
    raise InputError(f"{folder}: the result says no date; give it: --date 2026-06-21")


def _latest(file: Path) -> np.datetime64 | None:
    """Return the time of the latest row of a table, of those that were used where it has others; None without any."""
    if not file.is_file():
        return None
    table = read_table_csv(file)
    cells = table.get("time_utc", [])
    reasons = table.get("reason", [""] * len(cells))
    used = [cell for cell, reason in zip(cells, reasons, strict=True) if cell and not reason]
    used = used or [cell for cell in cells if cell]
    return _times(file, used).max() if used else None


def _times(file: Path, cells: Sequence[str]) -> TimeArray:
    try:
        times = utc_times(cells).astype("datetime64[us]")
    except InputError as error:
        raise InputError(f"{file}: time_utc: {error}") from None
    refuse_impossible(times, f"{file}: time_utc")
    return times


def _numbers(file: Path, name: str, cells: Sequence[str]) -> FloatArray:
    """Return a column of numbers, NaN where a cell is empty."""
    try:
        return np.array([float(cell) if cell else np.nan for cell in cells], dtype=np.float64)
    except ValueError as error:
        raise InputError(f"{file}: column {name} must hold numbers ({error})") from None


def _of_entries(folder: Path, name: str, summary: Summary, date: str | None) -> Rows | None:
    file = folder / "entries.csv"
    if not file.is_file():
        return None
    table = read_table_csv(file, ("heliostat", "test", "key", "value", "sigma", "date"))
    others = sorted({one for one in table["heliostat"] if one != summary.name})
    if others:
        raise InputError(
            f"{file}: entries of {', '.join(others)}, summary.json of {summary.name!r}: another heliostat's"
        )
    values, sigmas = (_numbers(file, column, table[column]) for column in ("value", "sigma"))
    keep = np.flatnonzero(np.isfinite(values)).tolist()
    times = [
        read_moment(table["date"][row], f"{file}") if table["date"][row] else _moment(folder, summary, date)
        for row in keep
    ]
    return _rows(
        subject=[name] * len(keep),
        part=[""] * len(keep),
        kind=summary.kind,
        quantity=[f"{table['test'][row]}_{table['key'][row]}" for row in keep],
        value=values[keep],
        sigma=sigmas[keep],
        time=np.array(times, dtype="datetime64[us]"),
        source=folder.name,
    )


def _of_numbers(summary: Summary, name: str, when: np.datetime64, source: str) -> Rows:
    parts: list[tuple[str, Mapping[str, float | int | None]]] = [("", summary.numbers), *summary.facets.items()]
    found = [
        (part, key, float(value), float(table.get(f"sigma_{key}") or "nan"))
        for part, table in parts
        for key, value in table.items()
        if value is not None and not (key.startswith("sigma_") and key.removeprefix("sigma_") in table)
    ]
    return _rows(
        subject=[name] * len(found),
        part=[part for part, _, _, _ in found],
        kind=summary.kind,
        quantity=[key for _, key, _, _ in found],
        value=[value for _, _, value, _ in found],
        sigma=[sigma for _, _, _, sigma in found],
        time=np.full(len(found), when),
        source=source,
    )


def _of_table(file: Path, quantities: tuple[str, ...], name: str, kind: str, source: str) -> Rows | None:
    """Return the rows of a table of beams that have a time; None where none has."""
    table = read_table_csv(file)
    if "time_utc" not in table:
        return None
    known = [row for row, cell in enumerate(table["time_utc"]) if cell]
    if not known:
        return None
    moments = _times(file, [table["time_utc"][row] for row in known])
    subjects = np.array(
        [(table["heliostat"][row] if "heliostat" in table else "") or name for row in known], dtype=object
    )
    pieces = []
    for quantity in quantities:
        if quantity not in table:
            continue
        values = _numbers(file, quantity, [table[quantity][row] for row in known])
        sigma_name = _SIGMA_NAMES.get(quantity, f"sigma_{quantity}")
        sigmas = np.full(len(known), np.nan)
        if sigma_name in table:
            sigmas = _numbers(file, sigma_name, [table[sigma_name][row] for row in known])
        keep = np.isfinite(values)
        pieces.append((f"{file.stem}_{quantity}", values[keep], sigmas[keep], moments[keep], subjects[keep]))
    if not pieces:
        return None
    return _rows(
        subject=np.concatenate([subject for *_, subject in pieces]),
        part=[""] * sum(len(values) for _, values, *_ in pieces),
        kind=f"{kind}-row",
        quantity=[quantity for quantity, values, *_ in pieces for _ in range(len(values))],
        value=np.concatenate([values for _, values, *_ in pieces]),
        sigma=np.concatenate([sigmas for _, _, sigmas, _, _ in pieces]),
        time=np.concatenate([times for *_, times, _ in pieces]),
        source=source,
    )


def _rows(*, subject, part, kind, quantity, value, sigma, time, source) -> Rows:  # type: ignore[no-untyped-def]  # noqa: ANN001
    count = len(quantity)

    def texts(values: object) -> np.ndarray[tuple[int, ...], np.dtype[np.generic]]:
        column = np.empty(count, dtype=object)
        column[:] = values
        return column

    return Rows(
        {
            "subject": texts(subject),
            "part": texts(part),
            "kind": texts(kind),
            "quantity": texts(quantity),
            "value": np.asarray(value, dtype=np.float64),
            "sigma": np.asarray(sigma, dtype=np.float64),
            "time": np.asarray(time, dtype="datetime64[us]"),
            "source": texts(source),
        }
    )
