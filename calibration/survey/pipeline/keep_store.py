"""What keeps a store right: check it, take results out, note events."""

from collections.abc import Sequence
from pathlib import Path

from calibration.survey.files import parquet_store, store_check
from calibration.survey.files.events import write_event
from calibration.survey.files.manifest import Entry
from calibration.survey.files.parquet_store import explain_disk, open_store, writing
from calibration.survey.files.store_check import StoreCheck
from calibration.survey.files.stored_rows import subjects_of
from heliogauge.running.progress import Progress, SilentProgress


def check(store: Path) -> StoreCheck:
    """Compare a store with its manifest: files, rows of each result, events; nothing is changed but the lock.

    Parameters
    ----------
    store : Path
        Folder of the store.

    Returns
    -------
    StoreCheck
        What it holds, what is wrong with it, and what lies there without counting.

    Raises
    ------
    InputError
        No store, or a manifest that cannot be read.
    """
    with explain_disk(store):
        return store_check.check_store(store)


def remove(store: Path, results: Sequence[str], progress: Progress | None = None) -> list[Entry]:
    """Take results out of a store.

    Parameters
    ----------
    store : Path
        Folder of the store.
    results : sequence of str
        Names of results as `check` lists them, their first six digits or more, or files of rows with all in them.
    progress : Progress, optional
        Listener: hears when another process keeps the store.

    Returns
    -------
    list of Entry
        What was taken out.

    Raises
    ------
    InputError
        No such result, several that begin so, or a store that cannot be written.
    """
    with explain_disk(store), writing(store, (progress or SilentProgress()).say) as manifest:
        return parquet_store.remove(store, manifest, results)


def add_event(store: Path, subject: str, date: str, what: str) -> bool:
    """Note that something was done: a cleaning, a repair.

    subject: Whom; a text with * stands for all whose names match.
    date: Day, YYYY-MM-DD.
    what: Words.
    Returns: Whether it was new; the same event is noted once.
    InputError: No store, no day, no word, or the store cannot be written.
    """
    with explain_disk(store):
        open_store(store)
        return write_event(store, subject, date, what)


def subjects_meant(store: Path, subject: str) -> tuple[list[str], list[str]]:
    """Return the subjects of a store, and those of them that an event is about.

    subject: Whom; a text with * stands for all whose names match.
    InputError: No store, or one that cannot be read.
    """
    with explain_disk(store):
        return subjects_of(store, subject)
