"""The store: a folder of Parquet files that a manifest lists, and events; queried by DuckDB.

A result is in the store when the line of its file in the manifest is whole. Files are on the disk before that line;
what is not in the manifest does not count. One process writes at a time.
"""

import re
import uuid
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from calibration.survey.files.events import EVENTS_FOLDER, read_events
from calibration.survey.files.manifest import (
    MANIFEST_FILE,
    ROWS_FOLDER,
    Change,
    Entry,
    Manifest,
    hidden,
    place_of,
    read_manifest,
    settle,
    unlisted,
    write_change,
)
from calibration.survey.files.result_rows import OWN_COLUMNS, StoredResult, numbers_digest, result_name
from heliogauge.doubts import Doubt
from heliogauge.errors import InputError
from heliogauge.files.extras import of_extra
from heliogauge.files.locks import held, kept_from_writers
from heliogauge.files.on_disk import put_on_disk
from heliogauge.files.parquet import parquet_rows
from heliogauge.files.regular import open_regular
from heliogauge.results.folder import hash_files, read_json
from heliogauge.results.json_file import json_text

STORE_FILE, LOCK_FILE = "store.json", "store.lock"
#: Version without a manifest, and the one of now.
OLD_SCHEMA, SCHEMA = 1, 2
#: Rows that are written together: 0.2 kB each as texts, 40 MB.
ROWS_AT_ONCE = 200_000
#: Longest time to wait for another process [s]: it writes 200,000 rows in a few; harmless.
WAIT_S = 120.0
_OWN_NAMES = frozenset({STORE_FILE, LOCK_FILE, MANIFEST_FILE, ROWS_FOLDER, EVENTS_FOLDER, f".{STORE_FILE}.partial"})
COLUMNS_SQL = ", ".join((*OWN_COLUMNS, "result"))
_DIGITS = re.compile(r"[0-9a-f]{6,32}", re.ASCII)


def schema_of(store: Path) -> int | None:
    """Return the version of a store; None where a folder is no store.

    InputError: It was made by something else, or by a later version.
    """
    file = store / STORE_FILE
    if not file.exists():
        return None
    content = read_json(file)
    schema = content.get("schema_version")
    if content.get("software") != "heliogauge" or schema not in (OLD_SCHEMA, SCHEMA):
        raise InputError(f"{file}: a store of version {SCHEMA} is needed, not {schema!r}")
    return int(schema)


def open_store(store: Path) -> None:
    """Check that a folder is a store of this version.

    InputError: It is none, or of another version.
    """
    schema = schema_of(store)
    if schema is None:
        raise InputError(f"{store}: no store (its {STORE_FILE} is missing); `heliogauge survey add` makes one")
    if schema == OLD_SCHEMA:
        raise InputError(
            f"{store}: a store of version {OLD_SCHEMA}, which has no manifest; `heliogauge survey add {store} -o NEW` "
            "takes its results and events over into a new one, and it stays as it is"
        )


@contextmanager
def writing(store: Path, say: Any = lambda text: None, *, create: bool = False) -> Iterator[Manifest]:
    """Hold the store for this process alone, with what it holds.

    say: Takes a line for the person who waits for another process.
    create: Make it where there is none.
    InputError: No store, it cannot be written, or another process keeps it.
    """
    if schema_of(store) is not None or not create:
        open_store(store)
    else:
        strangers = {path.name for path in store.iterdir()} - _OWN_NAMES if store.is_dir() else set()
        if strangers or (store.exists() and not store.is_dir()):
            raise InputError(f"{store}: holds files but is no store; choose another folder")
        _make_folders(store)
    with held(store / LOCK_FILE, WAIT_S, say):
        if create and schema_of(store) is None:
            _write_store_file(store)
        open_store(store)
        manifest = read_manifest(store)
        settle(store, manifest)
        yield manifest


def _make_folders(store: Path) -> None:
    try:
        for name in (ROWS_FOLDER, EVENTS_FOLDER):
            (store / name).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{store}: cannot be made ({error.strerror or error})") from error


def _write_store_file(store: Path) -> None:
    partial = store / f".{STORE_FILE}.partial"
    text = json_text(STORE_FILE, {"software": "heliogauge", "schema_version": SCHEMA})
    try:
        partial.write_text(text, encoding="utf-8")
        put_on_disk([partial])
        partial.replace(store / STORE_FILE)
        put_on_disk([store, store.absolute().parent])
    except OSError as error:
        raise InputError(f"{store}: cannot be written ({error.strerror or error})") from error


@dataclass(slots=True)
class Put:
    """What came of results that were put into a store.

    added: Results with the names that they are known by now.
    known: Results that were in it already, with their names there.
    again: Measurements that were in it, or came in the same call, with other numbers, which stay; with their names.
    replaced: Those of `added` that took the place of an earlier evaluation.
    """

    added: list[tuple[StoredResult, str]] = field(default_factory=list)
    known: list[tuple[StoredResult, str]] = field(default_factory=list)
    again: list[tuple[StoredResult, str]] = field(default_factory=list)
    replaced: list[tuple[StoredResult, str]] = field(default_factory=list)


def put(store: Path, manifest: Manifest, results: Sequence[StoredResult], *, force: bool = False) -> Put:
    """Put results into a store that is held (`writing`), all or none of them, each once.

    force: An evaluation of a measurement that is there takes the place of the earlier one; of several that come
        together the last one stays.
    InputError: The store cannot be written; it is as it was.
    """
    with connect() as connection, explain_query(store):
        book = _Book(store, manifest, connection)
        done, gone, ours = Put(), set[str](), set[str]()
        # Of two evaluations in one call the later one stays with force, the earlier one without.
        for result in reversed(results) if force else results:
            entry = _entry(result)
            earlier, is_same = book.find(entry, result, gone)
            if is_same and earlier:
                done.known.append((result, earlier[0]))
                ours.add(earlier[0])
                continue
            is_whole_now = not entry.taken_over and all(book.entries[one].taken_over for one in earlier)
            if earlier and not is_whole_now and (not force or not ours.isdisjoint(earlier)):
                done.again.append((result, earlier[0]))
                continue
            if earlier:
                done.replaced.append((result, earlier[0]))
                gone |= set(earlier)
            book.add(entry, result)
            ours.add(entry.result)
            done.added.append((result, entry.result))
        # A whole result takes the place of a part that came in the same call.
        done.added = [(result, name) for result, name in done.added if name not in gone]
        if force:
            for some in (done.added, done.known, done.again, done.replaced):
                some.reverse()
        if done.added:
            _change_files(
                connection, store, manifest, [(result, book.entries[name]) for result, name in done.added], gone
            )
    return done


def _entry(result: StoredResult) -> Entry:
    numbers = numbers_digest(result.rows)
    return Entry(
        result_name(numbers, result.measurement),
        len(result.rows),
        result.kind,
        result.subject,
        result.folder.name,
        numbers,
        result.measurement,
        result.summary,
        result.taken_over,
        result.doubts,
    )


class _Book:
    """Results of a store, and those that are about to come into it, by what makes two of them the same."""

    def __init__(self, store: Path, manifest: Manifest, connection: Any) -> None:
        self._store, self._connection = store, connection
        self.entries: dict[str, Entry] = {}
        self._files: dict[str, str] = {}
        self._fresh: dict[str, StoredResult] = {}
        self._by: dict[tuple[str, str], list[str]] = {}
        for file, entry in manifest.entries():
            self._files[entry.result] = file
            self._index(entry)

    def _index(self, entry: Entry) -> None:
        self.entries[entry.result] = entry
        for what in ("numbers", "measurement", "summary"):
            if getattr(entry, what):
                self._by.setdefault((what, getattr(entry, what)), []).append(entry.result)

    def add(self, entry: Entry, result: StoredResult) -> None:
        """Take a result in."""
        self._fresh[entry.result] = result
        self._index(entry)

    def find(self, entry: Entry, result: StoredResult, gone: set[str]) -> tuple[list[str], bool]:
        """Return results of the same measurement, and whether they say the same."""

        def there(what: str) -> list[Entry]:
            names = self._by.get((what, getattr(entry, what)), ()) if getattr(entry, what) else ()
            return [self.entries[name] for name in names if name not in gone]

        for one in there("numbers"):
            if one.measurement == entry.measurement or not one.measurement or not entry.measurement:
                return [one.result], True
        of_summary = [one.result for one in there("summary")]
        if of_summary:
            # What an old store has of a result may be a part; the result itself is not less than it.
            return of_summary, entry.taken_over
        series = result.rows.series()
        return [one.result for one in there("measurement") if series & self._series(one.result)], False

    def _series(self, name: str) -> set[tuple[str, str, str]]:
        if name in self._fresh:
            return self._fresh[name].rows.series()
        place = place_of(self._store, self._files[name])
        found = self._connection.execute(
            f"SELECT DISTINCT subject, part, quantity FROM {parquet_rows([place])} WHERE result = ?", [name]
        )
        return set(found.fetchall())


def remove(store: Path, manifest: Manifest, names: Iterable[str]) -> list[Entry]:
    """Remove results from a store that is held (`writing`).

    names: Names of results, their beginnings of at least 6 digits, or files of rows, with all that is in them.
    Returns: What was removed.
    InputError: No such result, several that begin so, or a damaged file that holds others too.
    """
    chosen: dict[str, Entry] = {}
    for name in names:
        chosen |= {one.result: one for one in _named(manifest, name)}
    with connect() as connection, explain_query(store):
        _change_files(connection, store, manifest, [], set(chosen))
    return list(chosen.values())


def _named(manifest: Manifest, name: str) -> Sequence[Entry]:
    file = f"{ROWS_FOLDER}/{Path(name).name}"
    if file in manifest.files:
        return manifest.files[file].results
    if not _DIGITS.fullmatch(name):
        raise InputError(
            f"{name!r}: a result as `heliogauge survey check STORE -v` lists it is needed: its name, or the first six "
            "digits or more of it"
        )
    found = [entry for _, entry in manifest.entries() if entry.result.startswith(name)]
    if len(found) != 1:
        raise InputError(f"{name}: {len(found) or 'no'} results of the store begin so")
    return found


def _change_files(
    connection: Any, store: Path, manifest: Manifest, fresh: list[tuple[StoredResult, Entry]], gone: set[str]
) -> None:
    """Write one file with new results and with what stays of files that lose some, and note it in the manifest."""
    touched = {file for file, entry in manifest.entries() if entry.result in gone}
    staying = [entry for file in sorted(touched) for entry in manifest.files[file].results if entry.result not in gone]
    if staying:
        for file in sorted(touched):
            fault = fault_of(store, manifest.files[file])
            if fault:
                raise InputError(
                    f"{store / file}: {fault}; remove all of it: `heliogauge survey remove {store} {file}`"
                )
    if not fresh and not staying:
        if touched:
            write_change(store, manifest, Change(replaces=tuple(sorted(touched))))
            settle(store, manifest)
        return
    name = f"{ROWS_FOLDER}/{uuid.uuid4().hex}.parquet"
    partial = store / hidden(name)
    parts = []
    if fresh:
        columns = {
            column: np.concatenate([result.rows.columns[column] for result, _ in fresh]) for column in OWN_COLUMNS
        }
        columns["result"] = np.concatenate([np.full(entry.rows, entry.result, dtype=object) for _, entry in fresh])
        connection.register("new_rows", columns)
        parts.append(f"SELECT {COLUMNS_SQL} FROM new_rows")
    if staying:
        connection.register("staying", {"result": np.array([one.result for one in staying], dtype=object)})
        places = [place_of(store, file) for file in sorted(touched)]
        parts.append(f"SELECT {COLUMNS_SQL} FROM {parquet_rows(places)} SEMI JOIN staying USING (result)")
    try:
        # Sorted by quantity and subject, a query reads a small part of the file.
        connection.execute(
            f"COPY (SELECT * FROM ({' UNION ALL '.join(parts)}) ORDER BY quantity, subject, time) TO {_text(partial)} "
            "(FORMAT parquet, COMPRESSION zstd)"
        )
        put_on_disk([partial, partial.parent])
        (digest,) = hash_files([partial]).values()
        entries = (*(entry for _, entry in fresh), *staying)
        write_change(store, manifest, Change(name, digest, entries, tuple(sorted(touched))))
    except (OSError, of_extra("duckdb").Error) as error:
        raise InputError(f"{store}: cannot be written ({_first_line(error)}); check permissions and space") from error
    finally:
        # The change has taken place, or its file goes.
        settle(store, manifest)


def fault_of(store: Path, change: Change) -> str:
    """Return what is wrong with a file of the manifest; empty: it is as it was written."""
    place = place_of(store, change.file)
    try:
        with open_regular(place, "a file of rows") as file:
            size = file.seek(0, 2)
        if size == 0:
            return "emptied"
        (digest,) = hash_files([place]).values()
    except InputError as error:
        return "missing" if not place.exists() else f"cannot be read ({error})"
    return "" if digest == change.sha256 else "changed since it was written"


@contextmanager
def reading(store: Path, say: Any = lambda text: None) -> Iterator[None]:
    """Keep a store as it is while it is read: processes that write wait, others read at the same time.

    say: Takes a line for the person who waits for another process.
    InputError: No store, or another process keeps it.
    """
    open_store(store)
    with kept_from_writers(store / LOCK_FILE, WAIT_S, say):
        yield


@contextmanager
def query(store: Path) -> Iterator[Any]:
    """Give a connection with the views ``rows`` and ``events`` of a store that is kept as it is (`reading`).

    InputError: Nothing in it, a file that is not as it was written, or the library is missing.
    """
    manifest = read_manifest(store)
    if not manifest.files:
        raise InputError(f"{store}: the store is empty; `heliogauge survey add RESULT -o {store}` fills it")
    faults = [f"{name}: {fault}" for name, change in manifest.files.items() if (fault := fault_of(store, change))]
    if faults:
        more = f", and {len(faults) - 3} more" if len(faults) > 3 else ""
        raise InputError(
            f"{store}: {'; '.join(faults[:3])}{more}; `heliogauge survey check {store}` says what was in there, "
            "`heliogauge survey remove` takes it out, and the results can be added again"
        )
    with connect() as connection, explain_query(store):
        places = [place_of(store, name) for name in manifest.files]
        connection.execute(f"CREATE VIEW rows AS SELECT {COLUMNS_SQL} FROM {parquet_rows(places)}")
        events = read_events(store)
        columns = {
            "subject": np.array([one["subject"] for one in events], dtype=object),
            "what": np.array([one["what"] for one in events], dtype=object),
            "event_time": np.array([one["date"] for one in events], dtype="datetime64[us]"),
        }
        connection.register("drawn_events", columns)
        connection.execute("CREATE TABLE events AS SELECT * FROM drawn_events")
        yield connection


@contextmanager
def explain_disk(store: Path) -> Iterator[None]:
    """Turn what the system raises on folders that cannot be entered, or a drive that is gone, into a message.

    InputError: The system refused something in the ``with``.
    """
    try:
        yield
    except OSError as error:
        raise InputError(
            f"{error.filename or store}: {error.strerror or error}; check permissions and space"
        ) from error


@contextmanager
def explain_query(store: Path) -> Iterator[None]:
    """Turn what DuckDB raises into a message that names the store.

    InputError: A query in the ``with`` failed.
    """
    try:
        yield
    except of_extra("duckdb").Error as error:
        raise InputError(f"{store}: cannot be read ({_first_line(error)})") from error


def doubts_of_results(store: Path, results: Iterable[str]) -> dict[str, tuple[Doubt, ...]]:
    """Return what makes results of a store doubtful, by the names of their folders.

    results: Names of the results.
    """
    chosen, found = set(results), dict[str, tuple[Doubt, ...]]()
    for _, entry in read_manifest(store).entries():
        if entry.result in chosen:
            found[entry.source if entry.source not in found else f"{entry.source} ({entry.result[:6]})"] = entry.doubts
    return found


def strangers(store: Path) -> list[str]:
    """Return files in the folder of rows that are not of the store, and do not count."""
    return [f"{ROWS_FOLDER}/{name}" for name in unlisted(store, read_manifest(store))]


@contextmanager
def connect() -> Iterator[Any]:
    """Give a connection that loads nothing from elsewhere and draws no bar on the terminal."""
    connection = of_extra("duckdb").connect()
    try:
        connection.execute("SET autoinstall_known_extensions = false")
        connection.execute("SET enable_progress_bar = false")
        yield connection
    finally:
        connection.close()


def _text(path: Path) -> str:
    return "'" + str(path.absolute()).replace("'", "''") + "'"


def _first_line(error: Exception) -> str:
    return str(getattr(error, "strerror", None) or error).splitlines()[0]
