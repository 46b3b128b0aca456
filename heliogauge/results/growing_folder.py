"""Folders of results that fill part by part and can be taken up again: fields of heliostats, batches of folders."""

import contextlib
import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, ClassVar, NamedTuple, Self, TextIO

from heliogauge.errors import InputError
from heliogauge.files.regular import read_regular
from heliogauge.files.texts import parse_json
from heliogauge.results.folder import SUMMARY_FILE
from heliogauge.results.left_over import EARLIER, hidden_beside, sweep


class Finished(NamedTuple):
    """A part that is finished.

    digest: Of what it was made from.
    row: Its row in the table of all parts.
    """

    digest: str
    row: dict[str, Any]


class GrowingFolder:
    """A folder of results with a part for each of many things, and a journal of those that are finished.

    target: Where the results shall stand.
    force: Replace earlier results; without it what is finished in them is taken over.
    InputError: On entering: the folder holds something else, or cannot be written to. On leaving: it became so.

    A part is noted as finished when it is whole. Earlier results that `force` replaces stay until the first part is
    finished; a folder that this run made, and in which nothing is finished, goes.
    """

    #: What is finished, one line each.
    journal_file: ClassVar[str]

    def __init__(self, target: Path, *, force: bool = False) -> None:
        self.path = target.absolute().resolve()
        self._force = force
        self._earlier: Path | None = None
        self._is_new = False
        self._journal: TextIO | None = None
        #: What earlier runs have finished, by name.
        self.before: dict[str, Finished] = {}
        #: What this run has finished or taken over, by name.
        self.finished: dict[str, Finished] = {}

    def refuse(self, names: set[str]) -> None:
        """Refuse a folder of results that this run must not go on with.

        names: What is in it.
        InputError: Says why, and what to do.
        """

    def is_whole(self, name: str, done: Finished) -> bool:
        """Return whether a part that the journal has is there still."""
        return True

    def __enter__(self) -> Self:
        """Check the folder, and read what is finished in it."""
        try:
            sweep(self.path)
            self._check()
            if (self.path / self.journal_file).exists():
                with (self.path / self.journal_file).open("a", encoding="utf-8") as journal:
                    _refuse_second_writer(journal, self.path)
            if self._force and self.path.exists() and any(self.path.iterdir()):
                self._earlier = hidden_beside(self.path, EARLIER)
                self.path.rename(self._earlier)
            self._is_new = not self.path.exists() or not any(self.path.iterdir())
            self.path.mkdir(parents=True, exist_ok=True)
            self.before = {name: one for name, one in self._read_journal().items() if self.is_whole(name, one)}
            self._journal = (self.path / self.journal_file).open("a", encoding="utf-8")
            _refuse_second_writer(self._journal, self.path)
        except OSError as error:
            raise InputError(
                f"{self.path}: no folder of results can be made there ({error.strerror or error}); choose another with "
                "--out"
            ) from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Keep what is finished; a new folder in which nothing is finished goes, and earlier results come back."""
        self.close_journal()
        if kind is not None and self._is_new and not self.finished:
            shutil.rmtree(self.path, ignore_errors=True)
            if self._earlier is not None:
                with contextlib.suppress(OSError):
                    self._earlier.rename(self.path)
        if self._earlier is not None and self._earlier.exists():
            shutil.rmtree(self._earlier, ignore_errors=True)
        if isinstance(error, OSError) and isinstance(error.filename, str) and error.filename.startswith(str(self.path)):
            raise InputError(
                f"{self.path}: cannot be written ({error.strerror or error}); check permissions and space; what is "
                "finished is kept"
            ) from error

    def note(self, name: str, digest: str, row: Mapping[str, Any]) -> None:
        """Note a part as finished."""
        self.finished[name] = Finished(digest, dict(row))
        if self._journal is not None:
            self._journal.write(self.journal_line(name))
            self._journal.flush()

    def journal_line(self, name: str) -> str:
        """Return the line of the journal of a finished part."""
        digest, row = self.finished[name]
        return json.dumps({"name": name, "digest": digest, "row": row}) + "\n"

    def close_journal(self) -> None:
        """Close the journal."""
        if self._journal is not None:
            self._journal.close()
            self._journal = None

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
        if "measurement.toml" in names or not names & {SUMMARY_FILE, self.journal_file}:
            raise InputError(f"{path}: holds files that are no results; choose another folder")
        if not self._force:
            self.refuse(names)

    def _read_journal(self) -> dict[str, Finished]:
        journal = self.path / self.journal_file
        finished: dict[str, Finished] = {}
        if not journal.exists():
            return finished
        for line in read_regular(journal).decode("utf-8", "replace").splitlines():
            # The last line may be half: its part is then made again.
            with contextlib.suppress(InputError, KeyError, TypeError, ValueError):
                entry = parse_json(line, str(journal))
                finished[str(entry["name"])] = Finished(str(entry["digest"]), dict(entry["row"]))
        return finished


def _refuse_second_writer(journal: TextIO, path: Path) -> None:
    """Lock the journal, as long as it is open; two runs in one folder would write over each other's parts.

    InputError: Another run has it.
    """
    try:
        import fcntl
    except ImportError:
        # Windows keeps a file that is open from being replaced, which the second run then says.
        return
    try:
        fcntl.flock(journal, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(f"{path}: another run is writing there; wait until it ends, or choose another --out") from None
    except OSError:
        # Drives of a network that have no locks: there nobody is told.
        return
