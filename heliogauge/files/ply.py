"""PLY files: their header, checked against what the file can hold, and the columns of their vertices."""

import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.files.memory import MIB, refuse_large
from heliogauge.files.regular import open_regular
from heliogauge.validate import FloatArray

#: Longest header; one with a hundred properties has 4 KiB.
_MOST_HEADER_BYTES = MIB
#: Text is read in pieces; a piece without the end of a line is no table.
_PIECE_BYTES = MIB
_END = re.compile(rb"^end_header[ \t]*\r?\n", re.MULTILINE)
_TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
# A column in float64 and what it is made of.
_VALUE_BYTES = 24


@dataclass(frozen=True, slots=True)
class _Element:
    """An element of a header: its name, how many there are, and names and types of its properties."""

    name: str
    count: int
    properties: tuple[tuple[str, str], ...]

    def least_bytes(self, is_text: bool) -> int:
        """Return the bytes of one at the least; of text, a digit and what separates it from the next."""
        if is_text:
            return 2 * max(len(self.properties), 1)
        # A list has its length at the least; nothing at all could be there without end.
        return max(sum(int(_TYPES[kind.removeprefix("list ").split()[0]][1]) for _, kind in self.properties), 1)


@dataclass(frozen=True, slots=True)
class _Header:
    """What a header says: form (a key of `_ORDERS`) and elements."""

    form: str
    elements: tuple[_Element, ...]

    def write(self) -> bytes:
        """Return the header as text, with nothing else in it."""
        lines = ["ply", f"format {self.form} 1.0"]
        for element in self.elements:
            lines.append(f"element {element.name} {element.count}")
            lines += [f"property {kind} {name}" for name, kind in element.properties]
        return "\n".join([*lines, "end_header", ""]).encode("latin-1")


def checked_ply(path: Path, content: bytes) -> bytes:
    """Check a PLY file that a library will read, which makes room for what the header claims.

    path: For messages.
    Returns: The file with its header written anew, without comments: readers end words, lines and comments in
        different places, and the library must see the elements that were checked.
    InputError: No PLY, or it claims more than it holds.
    """
    file = io.BytesIO(content)
    return _read_header(path, file).write() + file.read()


def read_ply_columns(path: Path) -> dict[str, FloatArray]:
    """Read what a PLY file says of its vertices.

    Returns: Column of each property that is one number.
    InputError: Not a PLY file, more claimed than it holds, other elements before the vertices, or vertices without
        x, y, z.
    """
    with open_regular(path, "a PLY file") as file:
        header = _read_header(path, file)
        vertex = header.elements[0] if header.elements else None
        if vertex is None or vertex.name != "vertex" or not {"x", "y", "z"} <= {name for name, _ in vertex.properties}:
            raise InputError(f"{path}: vertices with x, y, z are needed, as the first element")
        names = [name for name, _ in vertex.properties]
        if len(set(names)) < len(names) or not all(kind in _TYPES for _, kind in vertex.properties):
            raise InputError(f"{path}: the vertices cannot be read (properties {vertex.properties}): one number each")
        refuse_large(str(path), _VALUE_BYTES * vertex.count * len(names), f"{vertex.count} vertices")
        try:
            order = _ORDERS[header.form]
            return _binary_columns(file, vertex, order) if order else _text_columns(file, vertex)
        except (ValueError, OSError) as error:
            raise InputError(f"{path}: the vertices cannot be read ({error})") from None
        except MemoryError as error:
            raise InputError(f"{path}: there is not enough memory to read it") from error


def _read_header(path: Path, file: BinaryIO) -> _Header:
    """Read and check the header; the file then stands at the content."""
    begin = file.read(_MOST_HEADER_BYTES)
    end = _END.search(begin)
    lines = begin[: end.start()].decode("latin-1").splitlines() if end else []
    words = [line.split() for line in lines]
    form = next((line[1] for line in words if line[:1] == ["format"] and len(line) > 1), "")
    if end is None or words[:1] != [["ply"]] or form not in _ORDERS:
        raise InputError(f"{path}: not a PLY file; its header is not whole")
    elements: list[_Element] = []
    for number, line in enumerate(words, start=1):
        shown = lines[number - 1][:60]
        match line:
            case ["element", name, count]:
                # Nineteen digits: beyond, no file holds as many.
                if not re.fullmatch(r"0*[0-9]{1,19}", count, re.ASCII) or len(count) > 40 or not name.isprintable():
                    raise InputError(f"{path}, line {number}: a name and a whole number are needed, not {shown!r}")
                elements.append(_Element(name, int(count), ()))
            case ["element", *_]:
                raise InputError(f"{path}, line {number}: a name and a whole number are needed, not {shown!r}")
            case ["property", *kinds]:
                name = kinds.pop() if kinds else ""
                if not elements or not _is_property(kinds) or not name.isprintable():
                    raise InputError(f"{path}, line {number}: a type and a name are needed, not {shown!r}")
                last = elements[-1]
                elements[-1] = _Element(last.name, last.count, (*last.properties, (name, " ".join(kinds))))
            case ["ply" | "format" | "comment" | "obj_info", *_] | []:
                pass
            case _:
                raise InputError(f"{path}, line {number}: {shown!r} is nothing that a PLY file says")
    held = file.seek(0, io.SEEK_END) - end.end()
    file.seek(end.end())
    for element in elements:
        # The last line of a text may have no end.
        if element.count * element.least_bytes(not _ORDERS[form]) > held + 1:
            raise InputError(
                f"{path}: claims {element.count} of {element.name}, which {held} bytes cannot hold; copy it again"
            )
    return _Header(form, tuple(elements))


def _is_property(kinds: list[str]) -> bool:
    """Return whether these are the types of a number, or of the length of a list and its numbers."""
    if kinds[:1] == ["list"]:
        return len(kinds) == 3 and all(kind in _TYPES for kind in kinds[1:])
    return len(kinds) == 1 and kinds[0] in _TYPES


def _binary_columns(file: BinaryIO, vertex: _Element, order: str) -> dict[str, FloatArray]:
    kind = np.dtype([(name, order + _TYPES[of]) for name, of in vertex.properties])
    values: npt.NDArray[Any] = np.frombuffer(file.read(kind.itemsize * vertex.count), dtype=kind, count=vertex.count)
    return {name: values[name].astype(np.float64) for name, _ in vertex.properties}


def _text_columns(file: BinaryIO, vertex: _Element) -> dict[str, FloatArray]:
    width = len(vertex.properties)
    table = np.empty((vertex.count, width))
    filled = 0
    for lines in _pieces(file):
        rows = [cells[:width] for cells in map(str.split, lines) if cells][: vertex.count - filled]
        if rows:
            table[filled : filled + len(rows)] = np.array(rows, dtype=np.float64)
        filled += len(rows)
        if filled == vertex.count:
            break
    if filled < vertex.count:
        raise ValueError(f"claims {vertex.count}, holds {filled}")
    return {name: table[:, k] for k, (name, _) in enumerate(vertex.properties)}


def _pieces(file: BinaryIO) -> Iterator[list[str]]:
    """Yield the lines of a text, some at a time."""
    rest = b""
    while content := file.read(_PIECE_BYTES):
        whole, found, rest = (rest + content).rpartition(b"\n")
        if not found and len(rest) > _PIECE_BYTES:
            raise ValueError(f"a line of more than {_PIECE_BYTES} bytes")
        yield whole.decode("latin-1").split("\n")
    yield rest.decode("latin-1").split("\n")
