"""Folders that appear whole or not at all: results, synthetic measurements, imported measurements, patterns."""

import contextlib
import errno
import shutil
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from heliogauge.errors import InputError
from heliogauge.files.on_disk import everything_in, put_on_disk
from heliogauge.results.left_over import EARLIER, PARTIAL, hidden_beside, sweep

#: The disk says no, not the program: full, over quota, read-only, worn out.
_DISK_FAULTS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.EFBIG})


@dataclass(frozen=True, slots=True)
class FolderKind:
    """What a folder holds, and how an earlier one of its kind is recognised.

    content: What it holds, in the plural, for messages: "results".
    mark: A file that every such folder holds. Without it an earlier folder is never replaced.
    strangers: Files that such a folder never holds.
    remedy: How the caller names another folder.
    """

    content: str
    mark: str = ""
    strangers: frozenset[str] = frozenset()
    remedy: str = "choose another folder"


class WholeFolder:
    """A folder that appears whole or not at all.

    target: Where the folder shall stand.
    kind: What it will hold.
    force: Replace an earlier folder. Only one that is empty or an earlier one of the same kind is ever replaced.
    InputError: On entering: the target holds files already, is no place for a folder, or cannot be written to. On
        leaving: it became so meanwhile, or a file in it could not be written.

    ``with WholeFolder(out, kind) as folder:`` gives a temporary folder beside the target. On success it is moved into
    place (one rename); after an error or Ctrl-C it is removed and an earlier folder stays as it was.
    """

    def __init__(self, target: Path, kind: FolderKind, *, force: bool = False) -> None:
        self._target = target.absolute().resolve()
        self._kind = kind
        self._force = force
        self._working = self._target

    def __enter__(self) -> Path:
        """Check the target and make the temporary folder."""
        parent = self._target.parent
        try:
            sweep(self._target)
        except OSError as error:
            raise InputError(f"{parent}: cannot be read ({error.strerror or error})") from error
        self._check_target()
        self._working = hidden_beside(self._target, PARTIAL)
        try:
            parent.mkdir(parents=True, exist_ok=True)
            self._working.mkdir()
        except OSError as error:
            raise InputError(
                f"{self._target}: no folder can be made there ({error.strerror or error}); {self._kind.remedy}"
            ) from error
        return self._working

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Move the folder into place, or remove what there is of it."""
        try:
            if kind is None:
                self._move_into_place()
            elif isinstance(error, OSError) and self._is_disk_fault(error):
                raise InputError(
                    f"{self._target}: cannot be written ({error.strerror or error}); check permissions and space"
                ) from error
            elif isinstance(error, InputError):
                # The temporary folder is gone by the time the message is read.
                message = str(error).replace(str(self._working), str(self._target))
                if message != str(error):
                    raise InputError(message) from error
        finally:
            shutil.rmtree(self._working, ignore_errors=True)

    def _is_disk_fault(self, error: OSError) -> bool:
        """Whether writing this folder failed; any other error of the system is not ours to explain."""
        is_own = isinstance(error.filename, str) and Path(error.filename).is_relative_to(self._working)
        return is_own or error.errno in _DISK_FAULTS

    def _check_target(self) -> None:
        target, kind = self._target, self._kind
        if not target.exists():
            return
        if target.samefile(Path.cwd()):
            # It is moved away or replaced as a whole: whoever stands in it would stand nowhere.
            raise InputError(f"{target}: the folder you are in cannot be replaced; name another, or go one up")
        if not target.is_dir():
            raise InputError(f"{target}: a file stands where the folder of {kind.content} should; {kind.remedy}")
        try:
            names = {path.name for path in target.iterdir()}
        except OSError as error:
            raise InputError(f"{target}: cannot be read ({error.strerror or error})") from error
        if not names:
            return
        if not kind.mark:
            raise InputError(f"{target}: holds files already; {kind.remedy}")
        # It must never cost photographs or a home folder.
        is_own = kind.mark in names and not names & kind.strangers
        if self._force and not is_own:
            raise InputError(
                f"{target}: force=True replaces earlier {kind.content} only, and this folder holds something else"
            )
        if not self._force:
            more = f" or give force=True to replace {kind.content}" if is_own else ""
            raise InputError(f"{target}: holds files already; {kind.remedy}{more}")

    def _move_into_place(self) -> None:
        self._check_target()
        earlier = hidden_beside(self._target, EARLIER)
        try:
            had_earlier = self._target.exists()
            # A power cut must find no name with empty files, nor an earlier folder gone and the new one not there.
            put_on_disk(everything_in(self._working))
            if had_earlier:
                self._target.rename(earlier)
            try:
                self._working.rename(self._target)
                put_on_disk([self._target.parent])
            except BaseException:
                if had_earlier:
                    earlier.rename(self._target)
                raise
        except OSError as error:
            raise InputError(
                f"{self._target}: the {self._kind.content} cannot be moved there ({error.strerror or error}); "
                f"{self._kind.remedy}"
            ) from error
        with contextlib.suppress(OSError):
            shutil.rmtree(earlier) if had_earlier else None
