"""A field's results: a folder that fills heliostat by heliostat and can be taken up again after an interruption."""

import contextlib
import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO

from heliogauge.errors import InputError
from heliogauge.files.regular import read_regular
from heliogauge.files.texts import parse_json
from heliogauge.results.folder import SUMMARY_FILE
from heliogauge.results.left_over import EARLIER, hidden_beside, sweep

#: What is finished, one line each; it is gone when the whole field is.
JOURNAL_FILE = "field_progress.jsonl"


class FieldFolder:
    """A folder of results with one folder for each heliostat.

    target: Where the results shall stand.
    force: Replace earlier results, whole or interrupted; without it an interrupted field is continued.
    InputError: On entering: whole results are there already, the folder holds something else, or it cannot be
        written to.

    Each heliostat's folder appears whole or not at all, and only then is it noted as finished. Earlier results that
    `force` replaces stay until the first heliostat is finished.
    """

    def __init__(self, target: Path, *, force: bool = False) -> None:
        self.path = target.absolute().resolve()
        self._force = force
        self._earlier: Path | None = None
        self._journal: TextIO | None = None
        #: Rows of heliostats by name, with the hash of what they were made from: finished by an interrupted run before.
        self.before: dict[str, tuple[str, dict[str, Any]]] = {}
        #: The same, finished (or taken over) by this run.
        self.finished: dict[str, tuple[str, dict[str, Any]]] = {}

    def __enter__(self) -> "FieldFolder":
        """Check the folder, and read what is finished in it."""
        try:
            sweep(self.path)
            self._check()
            if self._force and self.path.exists() and any(self.path.iterdir()):
                self._earlier = hidden_beside(self.path, EARLIER)
                self.path.rename(self._earlier)
            self.path.mkdir(parents=True, exist_ok=True)
            self.before = _read_journal(self.path)
            self._journal = (self.path / JOURNAL_FILE).open("a", encoding="utf-8")
        except OSError as error:
            raise InputError(
                f"{self.path}: no folder of results can be made there ({error.strerror or error}); choose another with "
                "--out"
            ) from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Keep what is finished; a folder in which nothing is finished goes, and earlier results come back."""
        if self._journal is not None:
            self._journal.close()
        if kind is None:
            (self.path / JOURNAL_FILE).unlink(missing_ok=True)
        elif not self.finished and not self.before:
            shutil.rmtree(self.path, ignore_errors=True)
            if self._earlier is not None:
                with contextlib.suppress(OSError):
                    self._earlier.rename(self.path)
        self._drop_earlier()
        if isinstance(error, OSError) and isinstance(error.filename, str) and error.filename.startswith(str(self.path)):
            raise InputError(
                f"{self.path}: cannot be written ({error.strerror or error}); check permissions and space; what is "
                "finished is kept"
            ) from error

    def keep(self, name: str, digest: str, row: Mapping[str, Any], files: Mapping[str, bytes]) -> None:
        """Write a finished heliostat's files into a folder of its own, whole or not at all.

        digest: Hash of what its result was made from.
        row: Its row in the table of the field.
        files: Content of each file by its path within the folder; none for a heliostat that failed.
        """
        working, place = self.path / f".{name}.partial", self.path / name
        shutil.rmtree(working, ignore_errors=True)
        if place.exists():
            shutil.rmtree(place)
        if files:
            working.mkdir()
            for file, content in files.items():
                (working / file).parent.mkdir(parents=True, exist_ok=True)
                (working / file).write_bytes(content)
            working.rename(place)
        self.finished[name] = (digest, dict(row))
        if self._journal is not None:
            self._journal.write(json.dumps({"name": name, "digest": digest, "row": dict(row)}) + "\n")
            self._journal.flush()

    def _drop_earlier(self) -> None:
        if self._earlier is not None and self._earlier.exists():
            shutil.rmtree(self._earlier, ignore_errors=True)

    def _check(self) -> None:
        path = self.path
        if not path.exists():
            return
        if not path.is_dir():
            raise InputError(f"{path}: a file stands where the folder of results should; choose another folder")
        try:
            names = {one.name for one in path.iterdir()}
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
        if not names:
            return
        is_ours = bool(names & {SUMMARY_FILE, JOURNAL_FILE}) and "measurement.toml" not in names
        if not is_ours:
            raise InputError(f"{path}: holds files that are no results; choose another folder")
        if JOURNAL_FILE not in names and not self._force:
            raise InputError(f"{path}: holds results already; choose another folder or give force=True to replace them")


def _read_journal(folder: Path) -> dict[str, tuple[str, dict[str, Any]]]:
    finished: dict[str, tuple[str, dict[str, Any]]] = {}
    try:
        lines = read_regular(folder / JOURNAL_FILE).decode("utf-8", "replace").splitlines()
    except InputError:
        # None: nothing is finished.
        return finished
    for line in lines:
        # The last line may be half: its heliostat is then done again.
        with contextlib.suppress(InputError, KeyError, TypeError):
            entry = parse_json(line, JOURNAL_FILE)
            finished[entry["name"]] = (entry["digest"], entry["row"])
    return finished


def check_names(names: tuple[str, ...]) -> None:
    """Refuse names of heliostats that cannot be names of folders.

    InputError: Names the first that cannot be.
    """
    for name in names:
        if not name or name.startswith(".") or any(sign in name for sign in '/\\\0:*?"<>|') or name != name.strip():
            raise InputError(
                f"heliostat {name!r}: its results need a folder of that name; use letters, digits, - and _"
            )
    folded: dict[str, str] = {}
    for name in names:
        other = folded.setdefault(name.casefold(), name)
        if other != name:
            raise InputError(f"heliostats {other!r} and {name!r} differ in capitals only; give them different names")
