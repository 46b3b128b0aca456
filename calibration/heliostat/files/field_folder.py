"""A field's results: a folder that fills heliostat by heliostat and can be taken up again after an interruption."""

import shutil
from collections.abc import Mapping
from types import TracebackType
from typing import Any

from heliogauge.errors import InputError
from heliogauge.files.on_disk import put_on_disk
from heliogauge.results.growing_folder import GrowingFolder

#: What is finished, one line each; it is gone when the whole field is.
JOURNAL_FILE = "field_progress.jsonl"


class FieldFolder(GrowingFolder):
    """A folder of results with one folder for each heliostat; whole results are only replaced, never continued."""

    journal_file = JOURNAL_FILE

    def refuse(self, names: set[str]) -> None:
        """Refuse whole results."""
        if JOURNAL_FILE not in names:
            raise InputError(
                f"{self.path}: holds results that are whole: only an interrupted field is continued, and new "
                "or changed rows are not added to results. Choose another folder, or give force=True (--force) to "
                "calibrate all heliostats again"
            )

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Keep what is finished; the journal of a whole field goes, once the disk has its tables."""
        if kind is None:
            put_on_disk([*(one for one in self.path.iterdir() if one.is_file()), self.path])
            self.close_journal()
            (self.path / JOURNAL_FILE).unlink(missing_ok=True)
        super().__exit__(kind, error, trace)

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
        self.note(name, digest, row)


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
