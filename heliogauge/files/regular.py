"""Bytes of regular files, read without waiting for what never answers."""

import errno
import io
import os
import stat
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from heliogauge.errors import InputError
from heliogauge.files.memory import MIB, refuse_large

#: A drive that was asleep needs some 10 s; one that was pulled out, or a server that is gone, never answers.
ANSWER_S = 30.0
#: Largest file of each kind that is read as a whole; beyond it the file is not what its name says.
MOST_IMAGE_BYTES = 2048 * MIB

_CHUNK_BYTES = 8 * MIB
_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe (FIFO)"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)
_ResultT = TypeVar("_ResultT")


class _Asking(threading.Thread):
    """Work that may wait for a drive: the thread that asked stays free for signals."""

    def __init__(self, work: Callable[["_Asking"], _ResultT]) -> None:
        super().__init__(daemon=True, name="heliogauge-file")
        self._work = work
        self.steps = 0
        self.result: object = None
        self.error: BaseException | None = None

    def run(self) -> None:
        try:
            self.result = self._work(self)
        except BaseException as error:  # raised again where it was asked for
            self.error = error


def _answered(path: Path, work: Callable[[_Asking], _ResultT]) -> _ResultT:
    """Do work on a file in a thread of its own; the time counts from its latest step.

    InputError: The drive does not answer.
    """
    asking = _Asking(work)
    asking.start()
    steps = -1
    while asking.is_alive() and steps != asking.steps:
        steps = asking.steps
        asking.join(ANSWER_S)
    if asking.is_alive():
        raise InputError(
            f"{path}: the drive has not answered for {ANSWER_S:.0f} s; is it connected, and the server running?"
        )
    if asking.error is not None:
        raise asking.error
    result: _ResultT = asking.result  # type: ignore[assignment]
    return result


def refuse_silent(path: Path) -> None:
    """Check that the drive of a path answers, whether there is anything or not.

    InputError: It does not answer.
    """

    def look(_: _Asking) -> None:
        os.path.lexists(path)

    _answered(path, look)


def open_regular(path: Path, kind: str = "a file", most_bytes: int | None = None) -> io.BufferedReader:
    """Open a regular file for reading.

    path: The file; to be closed by the caller.
    kind: What it should be, for messages: "a JSON file".
    most_bytes: Largest size; any size without it.
    InputError: There is none, it is no regular file, cannot be read, is too large, or the drive does not answer.
    """
    return _explained(path, kind, lambda: _answered(path, lambda _: _opened(path, kind, most_bytes)))


def read_regular(path: Path, kind: str = "a file", most_bytes: int = MOST_IMAGE_BYTES) -> bytes:
    """Read a regular file as a whole.

    kind: What it should be, for messages: "a JSON file".
    most_bytes: Largest size.
    InputError: As `open_regular`; or the memory that is free does not hold it.
    """

    def read(asking: _Asking) -> bytes:
        with _opened(path, kind, most_bytes) as file:
            size = os.fstat(file.fileno()).st_size
            refuse_large(f"{path}", size, f"{size / MIB:.0f} MiB")
            parts: list[bytes] = []
            # Beyond its size when it was opened a file is growing: somebody writes it.
            while sum(len(part) for part in parts) <= most_bytes and (part := file.read(_CHUNK_BYTES)):
                parts.append(part)
                asking.steps += 1
            return parts[0] if len(parts) == 1 else b"".join(parts)

    return _explained(path, kind, lambda: _answered(path, read))


def _opened(path: Path, kind: str, most_bytes: int | None) -> io.BufferedReader:
    # Without waiting for a writer of a pipe; on a regular file it changes nothing.
    number = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    try:
        status = os.fstat(number)
        if not stat.S_ISREG(status.st_mode):
            found = next((name for is_it, name in _KINDS if is_it(status.st_mode)), "no regular file")
            raise InputError(f"{path}: is {found} and cannot be read; {kind} is needed")
        if most_bytes is not None and status.st_size > most_bytes:
            raise InputError(
                f"{path}: {status.st_size / MIB:.1f} MiB; {kind} of at most {most_bytes / MIB:g} MiB is read: is it "
                "the file that is meant?"
            )
        return io.BufferedReader(io.FileIO(number, "rb"))
    except BaseException:
        os.close(number)
        raise


def _explained(path: Path, kind: str, work: Callable[[], _ResultT]) -> _ResultT:
    try:
        return work()
    except FileNotFoundError:
        raise InputError(
            f"{path}: there is no such {kind.rsplit(maxsplit=1)[-1]}; check the name and the folder"
        ) from None
    except OSError as error:
        if error.errno == errno.EISDIR:
            raise InputError(f"{path}: is a folder and cannot be read; {kind} is needed") from None
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); {kind} is needed") from error
    except ValueError as error:
        # A name with a NUL, or with half a character.
        raise InputError(f"{str(path)!r}: no file can have this name ({error})") from error
    except MemoryError as error:
        raise InputError(f"{path}: there is not enough memory to read it") from error
