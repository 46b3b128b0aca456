"""Whether a store is as it was written: manifest, files, rows of each result, events, and what else lies there."""

from dataclasses import dataclass
from pathlib import Path

from calibration.survey.files.events import EVENTS_FOLDER, event_files, read_event
from calibration.survey.files.manifest import MANIFEST_FILE, Entry, Manifest, place_of, read_manifest
from calibration.survey.files.parquet_store import (
    connect,
    explain_query,
    fault_of,
    reading,
    strangers,
)
from heliogauge.errors import InputError
from heliogauge.files.parquet import parquet_rows

#: Names of results that one fault lists.
_MOST_NAMES = 3


@dataclass(frozen=True, slots=True)
class StoreCheck:
    """What a store holds, and what is wrong with it.

    entries: Results, with the file of each.
    files: Number of files of rows.
    events: Number of events.
    faults: What is wrong, a sentence each.
    notes: What is no fault but does not count.
    """

    entries: tuple[tuple[str, Entry], ...]
    files: int
    events: int
    faults: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def rows(self) -> int:
        """Number of rows."""
        return sum(entry.rows for _, entry in self.entries)


def check_store(store: Path) -> StoreCheck:
    """Compare a store with its manifest; nothing in it is changed.

    InputError: No store, another process keeps it, or a manifest that cannot be read.
    """
    with reading(store):
        manifest = read_manifest(store)
        faults = _faults_of_files(store, manifest)
        notes = [f"{name}: not in the manifest, does not count; move it away" for name in strangers(store)]
        if manifest.is_torn:
            notes.append(f"{MANIFEST_FILE}: ends with a line that a killed process left; the next one takes it away")
        good = 0
        for file in event_files(store):
            try:
                read_event(file)
                good += 1
            except InputError as error:
                faults.append(f"{EVENTS_FOLDER}/{file.name}: {error}")
    return StoreCheck(tuple(manifest.entries()), len(manifest.files), good, tuple(faults), tuple(notes))


def _faults_of_files(store: Path, manifest: Manifest) -> list[str]:
    faults = []
    for name, change in manifest.files.items():
        fault = fault_of(store, change)
        if not fault:
            fault = _fault_of_rows(place_of(store, name), change.results)
        if fault:
            lost = ", ".join(f"{one.result[:12]} ({one.source})" for one in change.results[:_MOST_NAMES])
            more = f" and {len(change.results) - _MOST_NAMES} more" if len(change.results) > _MOST_NAMES else ""
            faults.append(
                f"{name}: {fault}; it held {len(change.results)} results: {lost}{more}; `heliogauge survey remove "
                f"{store} {name}` takes them out, then add them again"
            )
    names = [entry.result for _, entry in manifest.entries()]
    twice = sorted({one for one in names if names.count(one) > 1}) if len(set(names)) < len(names) else []
    return faults + [f"{MANIFEST_FILE}: result {one} is there twice" for one in twice]


def _fault_of_rows(place: Path, entries: tuple[Entry, ...]) -> str:
    """Return what the rows of a file lack of what the manifest says."""
    try:
        with connect() as connection, explain_query(place):
            found = dict(
                connection.execute(f"SELECT result, count(*) FROM {parquet_rows([place])} GROUP BY result").fetchall()
            )
    except InputError as error:
        return str(error)
    wrong = [one.result[:12] for one in entries if found.get(one.result) != one.rows]
    if wrong:
        return f"rows of {len(wrong)} results differ from the manifest: {', '.join(wrong[:_MOST_NAMES])}"
    return "" if len(found) == len(entries) else f"holds {len(found)} results, the manifest says {len(entries)}"
