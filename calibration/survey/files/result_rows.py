"""What of a result goes into the store: its numbers with their sigmas, facet by facet, and rows of beams by time."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from heliogauge.errors import InputError
from heliogauge.files.regular import read_regular
from heliogauge.geometry.sun import utc_times
from heliogauge.results.folder import SUMMARY_FILE, Summary, hash_files, read_summary, read_table_csv

#: Columns of the store, in order.
COLUMNS = ("subject", "part", "kind", "quantity", "value", "sigma", "time", "source", "result")
#: Tables whose rows are results of their own: by name of file, the column of the subject and the quantities.
_ROW_TABLES: Mapping[str, tuple[str, ...]] = {
    "beams.csv": ("x_m", "y_m", "d90_m", "width_major_m", "width_minor_m"),
    "day_rows.csv": ("beam_right_rad", "beam_up_rad"),
    "wind_rows.csv": ("beam_right_rad", "beam_up_rad"),
}
_SIGMA_NAMES = {"beam_right_rad": "sigma_right_rad", "beam_up_rad": "sigma_up_rad"}
#: Words of a summary that say when was measured.
_DATE_KEYS = ("date", "time", "measured")


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Rows for the store, columns by name: texts as lists, numbers as arrays."""

    columns: dict[str, np.ndarray[tuple[int, ...], np.dtype[np.generic]]]

    def __len__(self) -> int:
        return len(self.columns["value"])


def result_id(folder: Path) -> str:
    """Return what a result is known by: the hash of its summary."""
    return next(iter(hash_files([folder / SUMMARY_FILE]).values()))


def rows_of(folder: Path, *, date: str | None = None, subject: str | None = None, identity: str = "") -> Iterator[Rows]:
    """Yield what of a result goes into the store.

    date: Day of the measurement, YYYY-MM-DD; None: as the result says.
    subject: What was measured; None: the result's name.
    identity: What the result is known by.
    InputError: No results, or no date.
    """
    read_regular(folder / SUMMARY_FILE, "a summary of results")
    summary = read_summary(folder / SUMMARY_FILE)
    name = subject or summary.name
    entries = _of_entries(folder, name, summary, date, identity)
    if entries is not None:
        yield entries
    else:
        when = _moment(folder, summary, date)
        yield _of_numbers(summary, name, when, folder.name, identity)
    for file, quantities in _ROW_TABLES.items():
        if (folder / file).is_file():
            rows = _of_table(folder / file, quantities, name, summary.kind, folder.name, identity)
            if rows is not None:
                yield rows


def _moment(folder: Path, summary: Summary, date: str | None) -> np.datetime64:
    text = date or next((summary.texts[key] for key in _DATE_KEYS if summary.texts.get(key)), None)
    if text is None:
        raise InputError(f"{folder}: the result says no date; give it: --date 2026-06-21")
    # Of a span of days its end counts.
    last = text.split(" to ")[-1].strip()
    try:
        return np.datetime64(last.removesuffix("Z"), "us")
    except ValueError:
        raise InputError(f"{folder}: date {last!r}: a day such as 2026-06-21 is needed") from None


def _of_entries(folder: Path, name: str, summary: Summary, date: str | None, identity: str) -> Rows | None:
    file = folder / "entries.csv"
    if not file.is_file():
        return None
    table = read_table_csv(file, ("heliostat", "test", "key", "value", "sigma", "date"))
    others = sorted({one for one in table["heliostat"] if one != summary.name})
    if others:
        raise InputError(
            f"{file}: entries of {', '.join(others)}, summary.json of {summary.name!r}: another heliostat's"
        )
    keep = [row for row, value in enumerate(table["value"]) if value]
    times = [_entry_moment(folder, table["date"][row], summary, date) for row in keep]
    return _rows(
        subject=[name] * len(keep),
        part=[""] * len(keep),
        kind=summary.kind,
        quantity=[f"{table['test'][row]}_{table['key'][row]}" for row in keep],
        value=[float(table["value"][row]) for row in keep],
        sigma=[float(table["sigma"][row] or "nan") for row in keep],
        time=np.array(times, dtype="datetime64[us]"),
        source=folder.name,
        identity=identity,
    )


def _entry_moment(folder: Path, text: str, summary: Summary, date: str | None) -> np.datetime64:
    if date is None and text:
        try:
            return np.datetime64(text.rsplit(" to ", maxsplit=1)[-1].strip(), "us")
        except ValueError:
            raise InputError(f"{folder / 'entries.csv'}: date {text!r}: a day such as 2026-06-21 is needed") from None
    return _moment(folder, summary, date)


def _of_numbers(summary: Summary, name: str, when: np.datetime64, source: str, identity: str) -> Rows:
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
        identity=identity,
    )


def _of_table(file: Path, quantities: tuple[str, ...], name: str, kind: str, source: str, identity: str) -> Rows | None:
    """Return the rows of a table of beams that have a time; None where none has."""
    table = read_table_csv(file)
    if "time_utc" not in table:
        return None
    known = [row for row, cell in enumerate(table["time_utc"]) if cell]
    if not known:
        return None
    moments = utc_times([table["time_utc"][row] for row in known]).astype("datetime64[us]")
    subjects = np.array(
        [(table["heliostat"][row] if "heliostat" in table else "") or name for row in known], dtype=object
    )
    pieces = []
    for quantity in quantities:
        if quantity not in table:
            continue
        values = np.array([float(table[quantity][row] or "nan") for row in known])
        sigma_name = _SIGMA_NAMES.get(quantity, f"sigma_{quantity}")
        sigmas = np.full(len(known), np.nan)
        if sigma_name in table:
            sigmas = np.array([float(table[sigma_name][row] or "nan") for row in known])
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
        identity=identity,
    )


def _rows(*, subject, part, kind, quantity, value, sigma, time, source, identity) -> Rows:  # type: ignore[no-untyped-def]  # noqa: ANN001
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
            "result": texts(identity),
        }
    )
