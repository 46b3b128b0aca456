"""Arrays that numpy wrote (``.npz``): numbers only, of sizes that fit."""

import io
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.files.memory import MIB, refuse_large
from heliogauge.files.regular import read_regular

#: Largest file, and largest sum of what it unpacks to.
MOST_NPZ_BYTES, MOST_ARRAYS_BYTES = 1024 * MIB, 4096 * MIB

_FAULTS = (
    OSError,
    ValueError,
    KeyError,
    EOFError,
    OverflowError,
    RuntimeError,
    TypeError,
    SyntaxError,
    TokenError,
    zipfile.BadZipFile,
    zlib.error,
)


def read_arrays(path: Path, names: Sequence[str]) -> dict[str, npt.NDArray[Any]]:
    """Read named arrays from an ``.npz`` file; nothing in it is executed.

    InputError: No such file, damaged, too large when unpacked, or without one of the names.
    """
    content = read_regular(path, "a numpy file", MOST_NPZ_BYTES)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            sizes = {one.filename.removesuffix(".npy"): one.file_size for one in archive.infolist()}
            missing = [name for name in names if name not in sizes]
            if missing:
                raise InputError(f"{path}: lacks {', '.join(missing)}; write it again")
            total = sum(sizes[name] for name in names)
            if total > MOST_ARRAYS_BYTES:
                raise InputError(
                    f"{path}: its arrays unpack to {total / MIB:.0f} MiB; {MOST_ARRAYS_BYTES // MIB} MiB are the most"
                )
            refuse_large(str(path), 2 * total, f"arrays of {total / MIB:.0f} MiB")
            return {name: _read_array(archive, name, sizes[name]) for name in names}
    except InputError:
        raise
    except (*_FAULTS, MemoryError) as error:
        raise InputError(
            f"{path}: cannot be read ({str(error)[:200] or type(error).__name__}); copy it again"
        ) from error


def _read_array(archive: zipfile.ZipFile, name: str, size: int) -> npt.NDArray[Any]:
    # All of it first: the header of an array may claim more than there is, and numpy makes room for what it claims.
    with archive.open(f"{name}.npy") as packed:
        content = packed.read(size + 1)
    begin = io.BytesIO(content)
    version = np.lib.format.read_magic(begin)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read_header(begin)
    needed = dtype.itemsize
    for length in shape:
        needed *= int(length)
    if dtype.hasobject or min(shape, default=0) < 0 or needed > len(content):
        raise ValueError(f"{name}: shape {shape} of {dtype} is not in it")
    begin.seek(0)
    array: npt.NDArray[Any] = np.lib.format.read_array(begin, allow_pickle=False)
    return array
