"""Results of a batch: a folder that fills measurement by measurement and can be taken up again at any time."""

import contextlib
import json
import secrets
import shutil
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, TextIO

from heliogauge.batch.rows import BATCH, INDEX_FILE, MEASURED, Row
from heliogauge.errors import InputError
from heliogauge.files.texts import parse_json, read_text
from heliogauge.results.folder import SUMMARY_FILE, read_json

#: What is finished, one line each: what its results were made from, and its row.
JOURNAL_FILE = "index.jsonl"
#: Where the traces of unexpected failures are.
FAILURES = "failures"
#: Names that no measurement's results can have.
RESERVED = (INDEX_FILE, JOURNAL_FILE, FAILURES, SUMMARY_FILE, "report.html", "report.ipynb", "measurement.toml")


class Finished(NamedTuple):
    """A measurement that is finished: the digest of what it was made from, and its row."""

    digest: str
    row: Row


class BatchFolder:
    """A folder of results with one folder for each measurement.

    target: Where the results shall stand.
    force: Replace earlier results; without it, what is finished and unchanged in them is kept.
    InputError: On entering: the folder holds something else, or cannot be written to.

    A measurement is noted as finished when its own folder of results is whole. Earlier results that `force` replaces
    stay until the first measurement is finished.
    """

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

    def __enter__(self) -> "BatchFolder":
        """Check the folder, and read what is finished in it."""
        self._check()
        try:
            if self._force and self.path.exists() and any(self.path.iterdir()):
                self._earlier = self.path.parent / f".{self.path.name}.{secrets.token_hex(4)}.earlier"
                self.path.rename(self._earlier)
            self._is_new = not self.path.exists() or not any(self.path.iterdir())
            self.path.mkdir(parents=True, exist_ok=True)
            self.before = self._read_journal()
            self._journal = (self.path / JOURNAL_FILE).open("a", encoding="utf-8")
        except OSError as error:
            raise InputError(
                f"{self.path}: no folder of results can be made there ({error.strerror or error}); choose another"
            ) from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Keep what is finished; a new folder in which nothing is finished goes, and earlier results come back."""
        if self._journal is not None:
            self._journal.close()
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

    def keep(self, name: str, digest: str, row: Row) -> None:
        """Note a measurement whose results are whole."""
        self.finished[name] = Finished(digest, row)
        if self._journal is not None:
            self._journal.write(_line(name, self.finished[name]))
            self._journal.flush()

    def remove(self, name: str) -> None:
        """Remove what an earlier run left of a measurement that now failed: its numbers are of other inputs."""
        if name in self.before:
            shutil.rmtree(self.path / name, ignore_errors=True)

    def keep_trace(self, name: str, trace: str) -> str:
        """Write where an unexpected failure happened.

        Returns: The file, relative to the folder.
        """
        (self.path / FAILURES).mkdir(exist_ok=True)
        (self.path / FAILURES / f"{name}.txt").write_text(trace, encoding="utf-8")
        return f"{FAILURES}/{name}.txt"

    def close_journal(self, names: list[str]) -> None:
        """Write the journal anew, without what later lines have replaced.

        names: What stays in it, in this order.
        """
        if self._journal is not None:
            self._journal.close()
            self._journal = None
        partial = self.path / f".{JOURNAL_FILE}.partial"
        partial.write_text("".join(_line(name, self.finished[name]) for name in names), encoding="utf-8")
        partial.replace(self.path / JOURNAL_FILE)

    def _check(self) -> None:
        path = self.path
        if not path.exists():
            return
        if not path.is_dir():
            raise InputError(f"{path}: a file stands where the folder of results should; choose another")
        try:
            names = {one.name for one in path.iterdir()}
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
        if not names:
            return
        if "measurement.toml" in names or not names & {SUMMARY_FILE, JOURNAL_FILE}:
            raise InputError(f"{path}: holds files that are no results; choose another folder")
        is_batch = JOURNAL_FILE in names or read_json(path / SUMMARY_FILE).get("kind") == BATCH
        if not is_batch and not self._force:
            raise InputError(
                f"{path}: holds the results of one measurement; choose another folder or give force=True to replace "
                "results"
            )

    def _read_journal(self) -> dict[str, Finished]:
        """Read what is finished, whose results are there still."""
        finished: dict[str, Finished] = {}
        journal = self.path / JOURNAL_FILE
        if not journal.exists():
            return finished
        for line in read_text(journal).splitlines():
            # The last line may be half: its measurement is then made again.
            with contextlib.suppress(InputError, KeyError, TypeError, ValueError):
                entry = parse_json(line, str(journal))
                row: dict[str, Any] = dict(entry["row"])
                finished[str(entry["name"])] = Finished(str(entry["digest"]), row)
        return {
            name: one
            for name, one in finished.items()
            if one.row.get("status") == MEASURED and (self.path / Path(name).name / SUMMARY_FILE).is_file()
        }


def _line(name: str, one: Finished) -> str:
    return json.dumps({"name": name, "digest": one.digest, "row": one.row}) + "\n"
