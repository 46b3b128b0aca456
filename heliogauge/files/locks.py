"""Locks between processes: an open file that one process at a time holds; the system frees it when the process ends."""

import contextlib
import json
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any

from heliogauge.errors import InputError
from heliogauge.files.texts import read_json

#: Pause between two looks at a lock that another process holds [s]; harmless: waiting is longer by so much at most.
_PAUSE_S = 0.02
#: After this time the person who waits hears for whom [s]; harmless.
_SAY_AFTER_S = 1.0


def try_lock(file: IO[Any], *, shared: bool = False) -> bool:
    """Lock an open file for this process; closing the file, or the end of the process however it comes, frees it.

    shared: Others may hold it so at the same time (not on Windows).
    Returns: False where another process holds it.
    OSError: The drive has no locks.
    """
    if sys.platform == "win32":
        import msvcrt

        # A byte far behind the content, which then stays readable.
        file.seek(1 << 30)
        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True
    import fcntl

    try:
        fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


@contextmanager
def held(path: Path, wait_s: float, say: Callable[[str], None] = lambda text: None) -> Iterator[None]:
    """Hold the lock of a file that stays; what a killed process left of it holds nothing.

    path: The file; made where absent. It says which process took it last.
    wait_s: Longest time to wait for another process [s].
    say: Takes one line for the person who waits.
    InputError: Another process keeps it, the drive has no locks, or the file is special or cannot be written.
    """
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is no regular file, and no lock; remove it")
    try:
        file = path.open("a", encoding="utf-8")
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror or error}); check permissions and space"
        ) from error
    with file:
        try:
            _wait(file, path, wait_s, say)
        except OSError as error:
            raise InputError(
                f"{path}: this drive has no locks ({error.strerror or error}), and two processes would write at once; "
                "choose a folder on another drive"
            ) from error
        # Who holds it is for messages alone: a full disk does not make the lock worth less.
        with contextlib.suppress(OSError):
            file.truncate(0)
            now = datetime.now(UTC).isoformat(timespec="seconds")
            file.write(json.dumps({"process": os.getpid(), "machine": platform.node(), "since": now}) + "\n")
            file.flush()
        yield


@contextmanager
def kept_from_writers(path: Path, wait_s: float, say: Callable[[str], None] = lambda text: None) -> Iterator[None]:
    """Keep processes that write (`held`) waiting while something is read; others may read at the same time.

    path: The file of the lock; it stays as it is. Where it is missing or cannot be read, or the drive has no locks,
        nothing is held: nobody writes to such a copy.
    wait_s, say: As for `held`.
    InputError: Another process keeps it.
    """
    with ExitStack() as stack:
        # The system's refusals alone: that another process writes is said.
        with contextlib.suppress(OSError):
            if path.is_file():
                _wait(stack.enter_context(path.open("rb")), path, wait_s, say, shared=True)
        yield


def _wait(file: IO[Any], path: Path, wait_s: float, say: Callable[[str], None], *, shared: bool = False) -> None:
    begin, said = time.monotonic(), False
    while not try_lock(file, shared=shared):
        waited = time.monotonic() - begin
        if waited > wait_s:
            raise InputError(
                f"{path.parent}: another process keeps it, after {wait_s:.0f} s still (last written by "
                f"{_holder(path)}); let it end"
            )
        if waited > _SAY_AFTER_S and not said:
            say(f"waiting for another process in {path.parent} (last written by {_holder(path)})")
            said = True
        time.sleep(_PAUSE_S)


def _holder(path: Path) -> str:
    """Return who took a lock last to write, as far as its file says it."""
    with contextlib.suppress(InputError, KeyError, TypeError):
        content = read_json(path)
        return f"process {content['process']} on {content['machine']} (since {content['since']})"
    return "an unknown process"
