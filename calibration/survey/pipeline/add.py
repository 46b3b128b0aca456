"""Put results into a store: each once."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from calibration.survey.files.parquet_store import append, known_results, open_store
from calibration.survey.files.result_rows import Rows, result_id, rows_of
from heliogauge.errors import InputError
from heliogauge.results.folder import SUMMARY_FILE


@dataclass(frozen=True, slots=True)
class AddOptions:
    """What is said of the results.

    Parameters
    ----------
    date : str or None
        Day of the measurement, where the results do not say it.
    subject : str or None
        What was measured, where it is not the results' name.
    """

    date: str | None = None
    subject: str | None = None


@dataclass(frozen=True, slots=True)
class Added:
    """What came of it.

    results, rows: How many were added.
    known: Results that were in the store already.
    """

    results: int
    rows: int
    known: tuple[Path, ...]


def add(folders: Sequence[Path], store: Path, options: AddOptions | None = None) -> Added:
    """Put results into a store; it is made where there is none.

    Parameters
    ----------
    folders : sequence of Path
        Folders of results, or folders of such folders.
    store : Path
        Folder of the store.
    options : AddOptions, optional
        What is said of the results.

    Returns
    -------
    Added
        How many results and rows were added, and which were there already.

    Raises
    ------
    InputError
        No results, results without a date, or a folder that is no store.

    Notes
    -----
    Of each result its numbers with their sigmas go in, those of facets and modules under their names, and rows of beams
    that have a time. A result is known by the hash of its summary, so that none is counted twice.
    """
    options = options or AddOptions()
    chosen = [one for folder in folders for one in _results_in(folder)]
    if not chosen:
        raise InputError(f"no results in {', '.join(map(str, folders))}: folders with {SUMMARY_FILE} are needed")
    open_store(store, create=True)
    known = known_results(store)
    twice: list[Path] = []
    taken: set[str] = set()

    def rows() -> Iterator[Rows]:
        for folder in chosen:
            identity = result_id(folder)
            if identity in known or identity in taken:
                twice.append(folder)
                continue
            taken.add(identity)
            yield from rows_of(folder, date=options.date, subject=options.subject, identity=identity)

    count = append(store, rows())
    return Added(len(taken), count, tuple(twice))


def _results_in(folder: Path) -> list[Path]:
    if (folder / SUMMARY_FILE).is_file():
        return [folder]
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder")
    return sorted(file.parent for file in folder.glob(f"*/{SUMMARY_FILE}"))
