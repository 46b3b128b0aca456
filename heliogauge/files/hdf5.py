"""HDF5 and NetCDF-4 files that hold their own data, of sizes that fit."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from heliogauge.errors import InputError
from heliogauge.files.extras import of_extra
from heliogauge.files.memory import MIB, refuse_large
from heliogauge.files.regular import open_regular

if TYPE_CHECKING:
    import xarray

#: Largest single array; a map of 4096 x 4096 nodes with nine common modes has 1.2 GiB.
MOST_ARRAY_BYTES = 4096 * MIB
#: A chunk is unpacked as a whole, however small the part of it that is read.
MOST_CHUNK_BYTES = 256 * MIB
#: Groups and arrays that a file may hold: a field of facets has some 100 groups of 30 arrays.
MOST_OBJECTS = 100_000
_DEEPEST = 50

# What h5py raises on damaged files, and what reading raises where the file holds something else than it should.
_FAULTS = (OSError, RuntimeError, KeyError, ValueError, TypeError, IndexError, AttributeError, OverflowError)


@contextmanager
def open_hdf5(path: Path) -> Iterator[h5py.File]:
    """Open an HDF5 file for reading; whatever goes wrong while it is read is the file's fault.

    path: The file. It must hold its data itself: no link or array leads into another file.
    InputError: No regular file, no HDF5, damaged, links, arrays elsewhere or too large, or a fault in the ``with``.
    """
    open_regular(path, "an HDF5 file").close()
    try:
        with h5py.File(path, "r") as file:
            _check(path, file)
            yield file
    except InputError:
        raise
    except MemoryError as error:
        raise InputError(f"{path}: there is not enough memory to read it") from error
    except UnicodeError as error:
        raise InputError(f"{path}: damaged: a text in it is not UTF-8 ({error}); copy the file again") from error
    except _FAULTS as error:
        text = str(error).strip("'\"") or type(error).__name__
        raise InputError(
            f"{path}: not a readable HDF5 (NetCDF-4) file, or damaged ({text[:300]}); copy it again"
        ) from error


def is_hdf5(path: Path) -> bool:
    """Return whether a file begins as HDF5 files do, wherever its user block ends.

    InputError: No regular file.
    """
    open_regular(path).close()
    return bool(h5py.is_hdf5(path))


def read_netcdf(path: Path) -> "xarray.Dataset":
    """Read the root group of a NetCDF-4 file as a whole.

    InputError: As `open_hdf5`.
    """
    with open_hdf5(path) as file:
        total = sum(item.nbytes for item in file.values() if isinstance(item, h5py.Dataset))
        refuse_large(str(path), 2 * total, f"arrays of {total / MIB:.0f} MiB")
    library = of_extra("xarray")
    of_extra("h5netcdf")
    try:
        data: xarray.Dataset = library.load_dataset(path, engine="h5netcdf")
        return data
    except Exception as error:  # decoding what an attribute claims can raise anything
        raise InputError(f"{path}: not a readable NetCDF-4 file ({str(error)[:300]}); copy it again") from error


def _check(path: Path, file: h5py.File) -> None:
    """Walk through all links of a file, each object once, and read nothing but headers."""
    seen: set[int] = set()
    waiting: list[tuple[h5py.Group, int]] = [(file["/"], 0)]
    while waiting:
        group, depth = waiting.pop()
        for name in group:
            link = group.get(name, getlink=True)
            where = f"{path}: {group.name.rstrip('/')}/{name}"
            if not isinstance(link, h5py.HardLink):
                raise InputError(f"{where} leads elsewhere ({_target(link)}); write a file that holds its data itself")
            item = group[name]
            address = int(h5py.h5o.get_info(item.id).addr)
            if address in seen:
                continue
            seen.add(address)
            if len(seen) > MOST_OBJECTS or depth > _DEEPEST:
                raise InputError(f"{path}: more than {MOST_OBJECTS} arrays, or {_DEEPEST} levels; is it damaged?")
            if isinstance(item, h5py.Group):
                waiting.append((item, depth + 1))
            elif isinstance(item, h5py.Dataset):
                _check_array(where, item)


def _target(link: Any) -> str:
    file = getattr(link, "filename", "")
    return f"link to {link.path!r}" + (f" in {file!r}" if file else "")


def _check_array(where: str, item: h5py.Dataset) -> None:
    plan = item.id.get_create_plist()
    if plan.get_external_count() or item.is_virtual:
        raise InputError(f"{where}: its values are in another file; write a file that holds its data itself")
    # With Python's whole numbers: those of numpy wrap around.
    size = item.dtype.itemsize
    for length in item.shape or ():
        size *= int(length)
    if size > MOST_ARRAY_BYTES:
        raise InputError(
            f"{where}: shape {item.shape} of {item.dtype} is {size / MIB:.0f} MiB; arrays of at most "
            f"{MOST_ARRAY_BYTES // MIB} MiB are read: is the file damaged? Otherwise cut it into parts"
        )
    refuse_large(where, 2 * size, f"values of shape {item.shape}")
    if item.chunks is not None:
        chunk = item.dtype.itemsize * int(np.prod([float(length) for length in item.chunks]))
        if chunk > max(MOST_CHUNK_BYTES, size):
            raise InputError(
                f"{where}: is stored in chunks of {chunk / MIB:.0f} MiB; at most {MOST_CHUNK_BYTES // MIB} MiB can be "
                "unpacked: is the file damaged?"
            )
