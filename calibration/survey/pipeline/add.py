"""Put results into a store: each once, whole or not at all."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from calibration.survey.files.events import event_files, read_event, write_event
from calibration.survey.files.old_store import old_results
from calibration.survey.files.parquet_store import (
    OLD_SCHEMA,
    ROWS_AT_ONCE,
    SCHEMA,
    explain_disk,
    put,
    schema_of,
    writing,
)
from calibration.survey.files.result_rows import StoredResult, read_result
from calibration.survey.files.stored_rows import rows_of, said_of, said_with, same_numbers
from heliogauge.errors import InputError
from heliogauge.results.folder import SUMMARY_FILE, hash_files
from heliogauge.running.progress import Progress, SilentProgress


@dataclass(frozen=True, slots=True)
class AddOptions:
    """What is said of the results.

    Parameters
    ----------
    date : str or None
        Day of the measurement, where the results do not say it.
    subject : str or None
        What was measured, where it is not the results' name.
    force : bool
        Whether an evaluation of a measurement that is in the store takes the place of the earlier one.
    """

    date: str | None = None
    subject: str | None = None
    force: bool = False


@dataclass(frozen=True, slots=True)
class Added:
    """What came of it.

    results, rows: How many were added.
    added: Folders that were added, with the name that the store knows each result by.
    replaced: Those of them that took the place of an earlier evaluation, with its name.
    known: Folders of results that were in the store already.
    again: Folders of measurements that are in the store with other numbers, with the name of the result there.
    elsewhere: Folders of results that are in the store with the same numbers under another subject or date, with the
        name of the result there and what it is of.
    left_out: Folders that could not be taken, with the reason.
    """

    results: int
    rows: int
    added: tuple[tuple[Path, str], ...]
    replaced: tuple[tuple[Path, str], ...]
    known: tuple[Path, ...]
    again: tuple[tuple[Path, str], ...]
    elsewhere: tuple[tuple[Path, str, str], ...]
    left_out: tuple[tuple[Path, str], ...]


def add(
    folders: Sequence[Path], store: Path, options: AddOptions | None = None, progress: Progress | None = None
) -> Added:
    """Put results into a store; it is made where there is none.

    Parameters
    ----------
    folders : sequence of Path
        Folders of results, or folders of such folders; a store of an earlier version.
    store : Path
        Folder of the store.
    options : AddOptions, optional
        What is said of the results.
    progress : Progress, optional
        Listener: hears when another process keeps the store.

    Returns
    -------
    Added
        How many results and rows were added, which were there already, and which could not be taken.

    Raises
    ------
    InputError
        No results, none that can be taken, a folder that is no store, or a store that cannot be written.

    Notes
    -----
    Of each result its numbers with their sigmas go in, those of facets and modules under their names, and rows of beams
    that have a time. A result is known by its numbers and by the hashes of what was measured: evaluated again with the
    same numbers it is known, with other numbers it is the same measurement still, and does not count twice.
    """
    options, progress = options or AddOptions(), progress or SilentProgress()
    added: list[tuple[Path, str]] = []
    rows = 0
    replaced: list[tuple[Path, str]] = []
    known: list[Path] = []
    again: list[tuple[Path, str]] = []
    elsewhere: list[tuple[Path, str, str]] = []
    left_out: list[tuple[Path, str]] = []
    for some in _together(_results(folders, store, options, left_out)):
        with explain_disk(store), writing(store, progress.say, create=True) as manifest:
            done = put(store, manifest, some, force=options.force)
            for one, name in done.again:
                there = rows_of(store, manifest, name)
                if same_numbers(one.rows, there):
                    elsewhere.append((one.folder, name, said_of(there)))
                else:
                    again.append((one.folder, name))
        # Folders alone are kept: rows of a plant's year take 300 MB.
        added += [(one.folder, name) for one, name in done.added]
        rows += sum(len(one.rows) for one, _ in done.added)
        replaced += [(one.folder, name) for one, name in done.replaced]
        known += [one.folder for one, _ in done.known]
    if left_out and not (added or known or again or elsewhere):
        more = f" ({len(left_out) - 1} more could not be taken)" if len(left_out) > 1 else ""
        raise InputError(f"{left_out[0][1]}{more}")
    for folder in folders:
        _take_over_events(folder, store, left_out)
    return Added(
        len(added),
        rows,
        tuple(added),
        tuple(replaced),
        tuple(known),
        tuple(again),
        tuple(elsewhere),
        tuple(left_out),
    )


def _together(results: Iterator[StoredResult]) -> Iterator[list[StoredResult]]:
    """Yield results that are written together: as many as one file should hold."""
    waiting: list[StoredResult] = []
    rows = 0
    for one in results:
        waiting.append(one)
        rows += len(one.rows)
        if rows >= ROWS_AT_ONCE:
            yield waiting
            waiting, rows = [], 0
    if waiting:
        yield waiting


def _results(
    folders: Sequence[Path], store: Path, options: AddOptions, left_out: list[tuple[Path, str]]
) -> Iterator[StoredResult]:
    """Yield the results of folders; those that cannot be taken go into `left_out`."""
    chosen = []
    earlier: dict[str, tuple[str, str]] | None = None
    for folder in folders:
        with explain_disk(folder):
            chosen += _results_in(folder)
    if not chosen:
        raise InputError(f"no results in {', '.join(map(str, folders))}: folders with {SUMMARY_FILE} are needed")
    for folder in chosen:
        if not (folder / SUMMARY_FILE).is_file():
            for one in old_results(folder):
                if isinstance(one, StoredResult):
                    yield one
                else:
                    left_out.append((folder, str(one)))
            continue
        try:
            with explain_disk(folder):
                try:
                    result = read_result(folder, date=options.date, subject=options.subject)
                except InputError:
                    # Without a date it may be in the store, which knows the date and the subject given with it.
                    if options.date is not None or schema_of(store) != SCHEMA:
                        raise
                    earlier = said_with(store) if earlier is None else earlier
                    (digest,) = hash_files([folder / SUMMARY_FILE]).values()
                    if digest not in earlier:
                        raise
                    subject, date = earlier[digest]
                    result = read_result(folder, date=date, subject=options.subject or subject)
        except InputError as error:
            left_out.append((folder, str(error)))
        else:
            yield result


def _results_in(folder: Path) -> list[Path]:
    """Return the folders of results in a folder: itself, and its parts, such as the heliostats of a field."""
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder")
    if (folder / SUMMARY_FILE).is_file():
        return [folder, *(one for part in _parts(folder) for one in _results_in(part))]
    schema = schema_of(folder)
    if schema == OLD_SCHEMA:
        return [folder]
    if schema is not None:
        raise InputError(f"{folder}: is a store; folders of results are needed, or a store of an earlier version")
    return [one for part in _parts(folder) for one in _results_in(part)]


def _parts(folder: Path) -> list[Path]:
    return sorted(file.parent for file in folder.glob(f"*/{SUMMARY_FILE}") if not file.parent.is_symlink())


def _take_over_events(folder: Path, store: Path, left_out: list[tuple[Path, str]]) -> None:
    if schema_of(folder) != OLD_SCHEMA:
        return
    for file in event_files(folder):
        try:
            event = read_event(file)
            write_event(store, event["subject"], event["date"], event["what"])
        except InputError as error:
            left_out.append((file, str(error)))
