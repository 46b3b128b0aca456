"""The manifest of a store: which results it holds, in which file, with which digest; a line for each change."""

import contextlib
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from heliogauge.doubts import Doubt, read_doubt
from heliogauge.errors import InputError
from heliogauge.files.on_disk import put_on_disk
from heliogauge.files.regular import read_regular
from heliogauge.files.texts import parse_json

MANIFEST_FILE, ROWS_FOLDER = "manifest.jsonl", "rows"
_FILE_NAME = re.compile(r"rows/[0-9a-f]{32}\.parquet", re.ASCII)
_HIDDEN = re.compile(r"\.[0-9a-f]{32}\.partial", re.ASCII)
_RESULT_NAME = re.compile(r"[0-9a-f]{32}", re.ASCII)
_DIGEST = re.compile(r"[0-9a-f]{64}", re.ASCII)


@dataclass(frozen=True, slots=True)
class Entry:
    """A result of the store.

    result: What it is known by: hash of its numbers and of the measurement.
    rows: Number of its rows.
    kind, subject, source: Kind of result, what was measured, name of the folder it came from.
    numbers: Hash of its rows.
    measurement: Hash of what was measured (photos and tables, not settings); empty where it says none.
    summary: Hash of its summary.json.
    taken_over: From a store without a manifest, where it may be a part of the result.
    doubts: What makes the result doubtful, without its notes and numbers.
    """

    result: str
    rows: int
    kind: str
    subject: str
    source: str
    numbers: str
    measurement: str
    summary: str
    taken_over: bool = False
    doubts: tuple[Doubt, ...] = ()


@dataclass(frozen=True, slots=True)
class Change:
    """One change of a store: a file of rows that it has now, files that it has no more, or both.

    file: The new file within the store; empty: none.
    sha256: Its digest.
    results: What is in it.
    replaces: Files that it takes the place of.
    """

    file: str = ""
    sha256: str = ""
    results: tuple[Entry, ...] = ()
    replaces: tuple[str, ...] = ()

    @property
    def rows(self) -> int:
        """Number of rows in the file."""
        return sum(one.rows for one in self.results)


@dataclass(slots=True)
class Manifest:
    """What a store holds.

    files: By the name of the file, the change that brought it.
    gone: Files that were replaced.
    whole_bytes: Length of the manifest up to its last whole line.
    is_torn: Behind that stands part of a line, of a change that was interrupted and did not take place.
    """

    files: dict[str, Change] = field(default_factory=dict)
    gone: set[str] = field(default_factory=set)
    whole_bytes: int = 0
    is_torn: bool = False

    def entries(self) -> Iterator[tuple[str, Entry]]:
        """Go through all results with the name of their file."""
        for name, change in self.files.items():
            for entry in change.results:
                yield name, entry

    def take(self, change: Change) -> None:
        """Bring in a change."""
        for name in change.replaces:
            self.files.pop(name, None)
            self.gone.add(name)
        if change.file:
            self.files[change.file] = change
            self.gone.discard(change.file)


def read_manifest(store: Path) -> Manifest:
    """Read the manifest of a store; one that is not there yet is empty.

    InputError: It cannot be read, or a line of it is damaged.
    """
    path, manifest = store / MANIFEST_FILE, Manifest()
    if not os.path.lexists(path):
        return manifest
    content = read_regular(path, "a manifest")
    whole, _, rest = content.rpartition(b"\n")
    manifest.is_torn = bool(rest)
    manifest.whole_bytes = len(content) - len(rest)
    for number, line in enumerate(whole.split(b"\n") if whole else (), start=1):
        where = f"{path}, line {number}"
        try:
            manifest.take(_change(parse_json(line.decode(), where), where))
        except UnicodeDecodeError:
            raise InputError(f"{where}: damaged; {_COPY}") from None
    return manifest


_COPY = "put back the store from its last copy, or make it anew from the folders of results"


def _change(content: Any, where: str) -> Change:
    try:
        entries = tuple(_entry(one) for one in content["results"])
        change = Change(content["file"], content["sha256"], entries, tuple(content["replaces"]))
        names = [*change.replaces, *([change.file] if change.file else [])]
        is_right = all(_FILE_NAME.fullmatch(name) for name in names) and (
            bool(_DIGEST.fullmatch(change.sha256)) if change.file else not entries
        )
    except (TypeError, KeyError, AttributeError, ValueError):
        is_right = False
    if not is_right:
        raise InputError(f"{where}: damaged or changed by hand; {_COPY}")
    return change


def _entry(content: Mapping[str, Any]) -> Entry:
    own = {one.name: content[one.name] for one in fields(Entry)}
    entry = Entry(**own | {"doubts": tuple(read_doubt(one) for one in own["doubts"])})
    for one in fields(Entry):
        if one.name != "doubts" and type(getattr(entry, one.name)) is not one.type:
            raise TypeError(one.name)
    if not _RESULT_NAME.fullmatch(entry.result) or entry.rows < 1:
        raise ValueError(entry.result)
    return entry


def write_change(store: Path, manifest: Manifest, change: Change) -> None:
    """Add a change to the manifest: with the end of its line it has taken place, on the disk too.

    manifest: As `read_manifest` returned it under the lock that is held still; brought up to date.
    InputError: It cannot be written; the store is as it was.
    """
    path = store / MANIFEST_FILE
    if os.path.lexists(path) and not path.is_file():
        raise InputError(f"{path}: is no regular file, and no manifest")
    line = (json.dumps(asdict(change), ensure_ascii=False, allow_nan=False) + "\n").encode()
    try:
        with path.open("ab") as file:
            file.truncate(manifest.whole_bytes)
            try:
                file.write(line)
                file.flush()
                put_on_disk([path])
            except BaseException:
                with contextlib.suppress(OSError):
                    file.truncate(manifest.whole_bytes)
                raise
        put_on_disk([store])
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror or error}); check permissions and space"
        ) from error
    manifest.whole_bytes += len(line)
    manifest.is_torn = False
    manifest.take(change)


def hidden(name: str) -> str:
    """Return where a file of rows stands until its change has taken place.

    >>> hidden("rows/0a.parquet")
    'rows/.0a.partial'
    """
    return f"{ROWS_FOLDER}/.{Path(name).stem}.partial"


def place_of(store: Path, name: str) -> Path:
    """Return where a file of the manifest stands: a process that was killed behind its change left it hidden."""
    return (
        store / name if os.path.lexists(store / name) or not (store / hidden(name)).is_file() else store / hidden(name)
    )


def settle(store: Path, manifest: Manifest) -> None:
    """Finish what a killed process had begun: files of changes that took place go to their names, all others away.

    InputError: The store cannot be written.
    """
    folder, changed = store / ROWS_FOLDER, False
    try:
        for name in manifest.files:
            place = place_of(store, name)
            if place != store / name:
                place.rename(store / name)
                changed = True
        for path in _left_over(folder, manifest):
            path.unlink()
            changed = True
        if changed:
            put_on_disk([folder])
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be written ({error.strerror or error}); check permissions and space"
        ) from error


def unlisted(store: Path, manifest: Manifest) -> list[str]:
    """Return what stands in the folder of rows and is not of the store."""
    folder = store / ROWS_FOLDER
    own = {store / name for name in manifest.files} | {store / hidden(name) for name in manifest.files}
    own |= set(_left_over(folder, manifest))
    return sorted(path.name for path in _paths(folder) if path not in own)


def _left_over(folder: Path, manifest: Manifest) -> list[Path]:
    """Return files of changes that did not take place, and files that were replaced."""
    return [
        path
        for path in _paths(folder)
        if not path.is_dir() and (_HIDDEN.fullmatch(path.name) or f"{ROWS_FOLDER}/{path.name}" in manifest.gone)
    ]


def _paths(folder: Path) -> Iterable[Path]:
    return folder.iterdir() if folder.is_dir() else ()
