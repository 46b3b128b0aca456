"""What a store has of one result, against the same result that comes again; and whom it knows."""

from collections import Counter
from pathlib import Path

import numpy as np

from calibration.survey.files.manifest import Manifest, place_of, read_manifest
from calibration.survey.files.parquet_store import connect, explain_query, reading
from calibration.survey.files.result_rows import OWN_COLUMNS, Rows
from heliogauge.files.parquet import parquet_rows


def rows_of(store: Path, manifest: Manifest, result: str) -> Rows:
    """Return the rows of a result of a store that is held.

    InputError: The file cannot be read.
    """
    places = [place_of(store, file) for file, entry in manifest.entries() if entry.result == result]
    with connect() as connection, explain_query(store):
        found = connection.execute(
            f"SELECT {', '.join(OWN_COLUMNS)} FROM {parquet_rows(places)} WHERE result = ?", [result]
        ).fetchnumpy()
    # A sigma that is not known is NaN in a result, and nothing in the file.
    known = {name: np.ma.filled(found[name], np.nan) for name in ("value", "sigma")}
    return Rows({name: np.asarray(known.get(name, found[name])) for name in OWN_COLUMNS})


def same_numbers(one: Rows, other: Rows) -> bool:
    """Return whether rows say the same but for subjects and times."""

    def numbers(rows: Rows) -> Counter[tuple[str, ...]]:
        texts = [rows.columns[name].tolist() for name in ("part", "kind", "quantity")]
        values = [map(float.hex, rows.columns[name].tolist()) for name in ("value", "sigma")]
        return Counter(zip(*texts, *values, strict=True))

    return numbers(one) == numbers(other)


def said_of(rows: Rows) -> str:
    """Return whom rows are of, and of which days."""
    subjects = sorted(set(rows.columns["subject"].tolist()))
    days = np.unique(rows.columns["time"].astype("datetime64[D]")).astype(str).tolist()
    more = f" and {len(subjects) - 1} more" if len(subjects) > 1 else ""
    return f"{subjects[0]}{more}, {days[0] if len(days) == 1 else f'{days[0]} to {days[-1]}'}"


def said_with(store: Path) -> dict[str, tuple[str, str]]:
    """Return subject and time of each result of a store, by the hash of its summary.json.

    InputError: A store that cannot be read.
    """
    with reading(store):
        manifest = read_manifest(store)
        entries = {entry.result: entry for _, entry in manifest.entries() if entry.summary}
        if not entries:
            return {}
        places = [place_of(store, name) for name in manifest.files]
        with connect() as connection, explain_query(store):
            found = connection.execute(
                f"SELECT result, max(time) FROM {parquet_rows(places)} GROUP BY result"
            ).fetchall()
    return {
        entries[result].summary: (entries[result].subject, time.isoformat())
        for result, time in found
        if result in entries
    }


def subjects_of(store: Path, pattern: str) -> tuple[list[str], list[str]]:
    """Return the subjects of a store, and those of them that a text with * stands for, as events are compared.

    InputError: No store, or one that cannot be read.
    """
    with reading(store):
        places = [place_of(store, name) for name in read_manifest(store).files]
        if not places:
            return [], []
        with connect() as connection, explain_query(store):
            found = connection.execute(
                f"SELECT DISTINCT subject, subject GLOB ? FROM {parquet_rows(places)} ORDER BY subject", [pattern]
            ).fetchall()
    return [subject for subject, _ in found], [subject for subject, is_meant in found if is_meant]
