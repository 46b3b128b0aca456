"""The store: a folder of Parquet files, one for each time that results were added, and events; queried by DuckDB."""

import json
import os
import uuid
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from calibration.survey.files.result_rows import COLUMNS, Rows
from heliogauge.errors import InputError
from heliogauge.files.extras import of_extra
from heliogauge.results.folder import read_json, write_json

STORE_FILE, ROWS_FOLDER, EVENTS_FOLDER = "store.json", "rows", "events"
SCHEMA = 1
#: Rows that are written together: 0.2 kB each as texts, 40 MB.
ROWS_AT_ONCE = 200_000


def open_store(store: Path, *, create: bool = False) -> None:
    """Check that a folder is a store, or make it one.

    InputError: It is none, or of a later version.
    """
    file = store / STORE_FILE
    if file.is_file():
        content = read_json(file)
        if content.get("software") != "heliogauge" or content.get("schema_version") != SCHEMA:
            raise InputError(f"{file}: a store of version {SCHEMA} is needed, not {content.get('schema_version')!r}")
        return
    if not create:
        raise InputError(f"{store}: no store (its {STORE_FILE} is missing); `heliogauge survey add` makes one")
    if store.exists() and any(store.iterdir()):
        raise InputError(f"{store}: holds files but is no store; choose another folder")
    try:
        for name in (ROWS_FOLDER, EVENTS_FOLDER):
            (store / name).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{store}: cannot be made ({error.strerror or error})") from error
    write_json(file, {"software": "heliogauge", "schema_version": SCHEMA, "columns": list(COLUMNS)})


@contextmanager
def query(store: Path) -> Iterator[Any]:
    """Give a connection with the views ``rows`` and ``events``.

    InputError: No store, nothing in it, or the library is missing.
    """
    open_store(store)
    duckdb = of_extra("duckdb")
    connection = _connect()
    try:
        files = sorted((store / ROWS_FOLDER).glob("*.parquet"))
        if not files:
            raise InputError(f"{store}: the store is empty; `heliogauge survey add RESULT --to {store}` fills it")
        connection.execute(f"CREATE VIEW rows AS SELECT * FROM read_parquet({_texts(files)})")
        events = read_events(store)
        columns = {
            "subject": np.array([one["subject"] for one in events], dtype=object),
            "what": np.array([one["what"] for one in events], dtype=object),
            "event_time": np.array([one["date"] for one in events], dtype="datetime64[us]"),
        }
        connection.register("drawn_events", columns)
        connection.execute("CREATE TABLE events AS SELECT * FROM drawn_events")
        yield connection
    except duckdb.Error as error:
        raise InputError(f"{store}: cannot be read ({str(error).splitlines()[0]})") from error
    finally:
        connection.close()


def _connect() -> Any:
    """Return a connection that loads nothing from elsewhere and draws no bar on the terminal."""
    connection = of_extra("duckdb").connect()
    connection.execute("SET autoinstall_known_extensions = false")
    connection.execute("SET enable_progress_bar = false")
    return connection


def known_results(store: Path) -> set[str]:
    """Return what the results in the store are known by."""
    if not any((store / ROWS_FOLDER).glob("*.parquet")):
        return set()
    with query(store) as connection:
        return {one for (one,) in connection.execute("SELECT DISTINCT result FROM rows").fetchall()}


def append(store: Path, pieces: Iterable[Rows]) -> int:
    """Write rows into the store, some at a time.

    Returns: How many.
    InputError: The store cannot be written to.
    """
    connection = _connect()
    waiting: list[Rows] = []
    count = written = 0
    try:
        for piece in pieces:
            waiting.append(piece)
            count += len(piece)
            if sum(map(len, waiting)) >= ROWS_AT_ONCE:
                written += _write(connection, store, waiting)
                waiting = []
        if waiting:
            written += _write(connection, store, waiting)
    finally:
        connection.close()
    return written


def _write(connection: Any, store: Path, pieces: list[Rows]) -> int:
    columns = {name: np.concatenate([one.columns[name] for one in pieces]) for name in COLUMNS}
    name = uuid.uuid4().hex
    partial, whole = store / ROWS_FOLDER / f".{name}.partial", store / ROWS_FOLDER / f"{name}.parquet"
    connection.register("new_rows", columns)
    try:
        # Sorted by quantity and subject, a query reads a small part of the file.
        connection.execute(
            f"COPY (SELECT * FROM new_rows ORDER BY quantity, subject, time) TO {_text(partial)} "
            "(FORMAT parquet, COMPRESSION zstd)"
        )
        os.replace(partial, whole)
    except OSError as error:
        raise InputError(f"{store}: cannot be written ({error.strerror or error})") from error
    finally:
        connection.unregister("new_rows")
        partial.unlink(missing_ok=True)
    return len(columns["value"])


def add_event(store: Path, subject: str, date: str, what: str) -> None:
    """Note that something was done: a cleaning, a repair.

    subject: Whom; a text with * stands for all whose names match.
    InputError: No day, or no word.
    """
    open_store(store)
    try:
        np.datetime64(date, "D")
    except ValueError:
        raise InputError(f"date {date!r}: a day such as 2026-06-21 is needed") from None
    if not what.strip() or not subject.strip():
        raise InputError("event: subject and what was done are needed")
    write_json(store / EVENTS_FOLDER / f"{uuid.uuid4().hex}.json", {"subject": subject, "date": date, "what": what})


def read_events(store: Path) -> list[dict[str, str]]:
    """Return what was done, the earliest first."""
    found = []
    for file in sorted((store / EVENTS_FOLDER).glob("*.json")):
        content = read_json(file)
        try:
            found.append({key: str(content[key]) for key in ("subject", "date", "what")})
        except KeyError as error:
            raise InputError(f"{file}: no event (it lacks {error})") from None
    return sorted(found, key=lambda one: (one["date"], one["subject"]))


def _text(path: Path) -> str:
    return "'" + str(path).replace("'", "''") + "'"


def _texts(paths: list[Path]) -> str:
    return json.dumps([]) if not paths else "[" + ", ".join(_text(path) for path in paths) + "]"
