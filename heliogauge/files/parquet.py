"""Parquet files, as DuckDB reads them: each checked, none found by a pattern, nothing learnt from names of folders."""

import os
import re
import struct
from collections.abc import Iterable
from pathlib import Path

from heliogauge.errors import InputError
from heliogauge.files.memory import MIB
from heliogauge.files.regular import open_regular

#: Largest description at the end of a file; of a million groups of rows it has some 100 MiB.
MOST_FOOTER_BYTES = 128 * MIB
_MAGIC = b"PAR1"
# The description's length and the magic end a file; the magic begins it, too.
_END = struct.Struct("<I4s")


def parquet_rows(files: Iterable[Path]) -> str:
    """Return the table function of DuckDB that reads the rows of Parquet files.

    files: At least one; they have the same columns.
    Returns: SQL, such as ``read_parquet(['/store/rows/a.parquet'], hive_partitioning = false)``.
    InputError: No regular file, no whole Parquet file, or a name that DuckDB cannot be given.

    Without `hive_partitioning = false` a folder that is called ``value=9`` gives every row this value.
    """
    names = []
    for file in files:
        _check(file)
        names.append(_name(os.path.abspath(file)))
    if not names:
        raise InputError("no Parquet file was given")
    return f"read_parquet([{', '.join(names)}], hive_partitioning = false, union_by_name = false)"


def _check(path: Path) -> None:
    with open_regular(path, "a Parquet file") as file:
        size = os.fstat(file.fileno()).st_size
        begin = file.read(len(_MAGIC))
        file.seek(max(size - _END.size, 0))
        end = file.read()
    length, magic = _END.unpack(end) if len(end) == _END.size else (0, b"")
    if begin != _MAGIC or magic != _MAGIC or not 0 < length <= size - _END.size - len(_MAGIC):
        raise InputError(f"{path}: no whole Parquet file ({size} bytes); copy it again")
    if length > MOST_FOOTER_BYTES:
        raise InputError(f"{path}: its description has {length / MIB:.0f} MiB; {MOST_FOOTER_BYTES // MIB} are the most")


def _name(path: str) -> str:
    """Return a path as a text of SQL that is no pattern."""
    return "'" + re.sub(r"[*?\[]", r"[\g<0>]", path).replace("'", "''") + "'"
