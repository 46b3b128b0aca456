"""Folders of results that fill part by part and can be taken up again: fields of heliostats, batches of folders."""

import contextlib
import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, ClassVar, NamedTuple, Self, TextIO

from heliogauge.errors import InputError
from heliogauge.files.locks import try_lock
from heliogauge.files.on_disk import everything_in, put_on_disk
from heliogauge.files.regular import read_regular
from heliogauge.files.texts import parse_json
from heliogauge.results.folder import SUMMARY_FILE, hash_files
from heliogauge.results.left_over import EARLIER, hidden_beside, sweep

#: Files of a part that `heliogauge report` makes anew at any time; a part is whole without them.
_MADE_AGAIN = frozenset({"report.html", "report.ipynb"})


class Finished(NamedTuple):
    """A part that is finished.

    digest: Of what it was made from.
    row: Its row in the table of all parts.
    files: Length [bytes] and SHA-256 of each of its files, by the name within the part.
    """

    digest: str
    row: dict[str, Any]
    files: dict[str, tuple[int, str]] = {}  # noqa: RUF012


class GrowingFolder:
    """A folder of results with a part for each of many things, and a journal of those that are finished.

    target: Where the results shall stand.
    force: Replace earlier results; without it what is finished in them is taken over.
    InputError: On entering: the folder holds something else, or cannot be written to. On leaving: it became so.

    A part is noted as finished when it is whole and on the disk: its files, its folder and the folder of all, and only
    then the journal's line, with the length and the digest of each file. So what a power cut has emptied is seen by the
    next run. Earlier results that `force` replaces stay until the first part is finished; a folder that this run made,
    and in which nothing is finished, goes.
    """

    #: What is finished, one line each.
    journal_file: ClassVar[str]

    def __init__(self, target: Path, *, force: bool = False) -> None:
        self.path = target.absolute().resolve()
        self._force = force
        self._earlier: Path | None = None
        self._is_new = False
        self._journal: TextIO | None = None
        #: What earlier runs have finished and is there still, by name.
        self.before: dict[str, Finished] = {}
        #: What earlier runs have finished and is no longer as it was: in which way, by name.
        self.spoiled: dict[str, str] = {}
        #: What this run has finished or taken over, by name.
        self.finished: dict[str, Finished] = {}

    def refuse(self, names: set[str]) -> None:
        """Refuse a folder of results that this run must not go on with.

        names: What is in it.
        InputError: Says why, and what to do.
        """

    def is_kept(self, done: Finished) -> bool:
        """Return whether a part that the journal has is one that a later run takes over."""
        return True

    def __enter__(self) -> Self:
        """Check the folder, and read what is finished in it."""
        try:
            sweep(self.path)
            self._check()
            if (self.path / self.journal_file).exists():
                with self._open_journal() as journal:
                    _refuse_second_writer(journal, self.path)
            if self._force and self.path.exists() and any(self.path.iterdir()):
                self._earlier = hidden_beside(self.path, EARLIER)
                self.path.rename(self._earlier)
            self._is_new = not self.path.exists() or not any(self.path.iterdir())
            self.path.mkdir(parents=True, exist_ok=True)
            put_on_disk([self.path.parent])
            for name, one in self._read_journal().items():
                if not self.is_kept(one):
                    continue
                if fault := _fault(self.path / Path(name).name, one):
                    self.spoiled[name] = fault
                else:
                    self.before[name] = one
            self._journal = self._open_journal()
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
        """Note a part as finished, once the disk has it.

        OSError: The disk does not take it; the file is named in it.
        """
        place = self.path / name
        inside = list(everything_in(place))
        put_on_disk([*inside, self.path])
        kept = [path for path in inside if path.name not in _MADE_AGAIN and not path.is_dir()]
        digests = hash_files(kept, place).items()
        files = {key: (file.stat().st_size, digest) for file, (key, digest) in zip(kept, digests, strict=True)}
        self.finished[name] = Finished(digest, dict(row), files)
        self._add_line(name)
        put_on_disk([self.path / self.journal_file])

    def take_over(self, name: str, row: Mapping[str, Any]) -> None:
        """Note a part that an earlier run has finished, and that is as it was.

        row: Its row now.
        """
        self.finished[name] = self.before[name]._replace(row=dict(row))
        self._add_line(name)

    def _open_journal(self) -> TextIO:
        """Open the journal; a pipe would wait for a reader, and a link leads to a file that is no journal.

        InputError: It is no regular file.
        """
        journal = self.path / self.journal_file
        if journal.is_symlink() or (journal.exists() and not journal.is_file()):
            raise InputError(f"{journal}: is no regular file, and no journal; remove it")
        return journal.open("a", encoding="utf-8")

    def _add_line(self, name: str) -> None:
        if self._journal is None:
            return
        try:
            self._journal.write(self.journal_line(name))
            self._journal.flush()
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self.path / self.journal_file)) from error

    def journal_line(self, name: str) -> str:
        """Return the line of the journal of a finished part."""
        return json.dumps({"name": name, **self.finished[name]._asdict()}) + "\n"

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
            with contextlib.suppress(InputError, KeyError, TypeError, ValueError, AttributeError):
                entry = parse_json(line, str(journal))
                files = {str(name): (int(size), str(digest)) for name, (size, digest) in entry["files"].items()}
                finished[str(entry["name"])] = Finished(str(entry["digest"]), dict(entry["row"]), files)
        return finished


def _fault(place: Path, done: Finished) -> str:
    """Return in which way the files of a part are no longer as the journal has them; empty: they are."""
    for name, (size, _) in done.files.items():
        try:
            now = (place / name).stat().st_size
        except OSError:
            return f"{name} is not there"
        if now != size:
            return f"{name} holds {now} of its {size} bytes"
    try:
        digests = hash_files([place / name for name in done.files], place)
    except InputError as error:
        return str(error)
    other = next((name for name, (_, digest) in done.files.items() if digests.get(name) != digest), "")
    return f"{other} has another content" if other else ""


def _refuse_second_writer(journal: TextIO, path: Path) -> None:
    """Lock the journal, as long as it is open; two runs in one folder would write over each other's parts.

    InputError: Another run has it.
    """
    # Drives of a network that have no locks: there nobody is told.
    with contextlib.suppress(OSError):
        if not try_lock(journal):
            raise InputError(f"{path}: another run is writing there; wait until it ends, or choose another --out")
