"""Point clouds of the form E57 (ASTM E2807): their XML is read before the library sees the file.

The library's XML parser fetches what a document type or a schema names, from any address and from any file of this
machine, and waits for pipes. It makes room for the points that the XML claims, and leaves what the file does not
hold uninitialised. The XML section is therefore taken from the file first, by the offset and length in its header.
"""

import os
import re
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO
from xml.etree import ElementTree

import numpy as np

from heliogauge.errors import InputError
from heliogauge.files.extras import of_extra
from heliogauge.files.memory import MIB, refuse_large
from heliogauge.files.regular import open_regular
from heliogauge.validate import FloatArray

#: Largest XML section; that of a scan has some 5 KiB.
MOST_XML_BYTES = 64 * MIB
_SIGNATURE, _HEADER = b"ASTM-E57", struct.Struct("<8sIIQQQQ")
# A page ends with its checksum, which is no part of the content.
_PAGE_BYTES, _CHECKED_BYTES = 1024, 1020
_DEEPEST = 64
#: Numbers of 64 bit are those of a field that says no limits.
_LEAST, _MOST = -(2**63), 2**63 - 1
# Places and the pose in float64, and the arrays that they are made into.
_POINT_BYTES = 120
_SYSTEMS = {
    "cartesian": ("cartesianX", "cartesianY", "cartesianZ"),
    "spherical": ("sphericalRange", "sphericalAzimuth", "sphericalElevation"),
}


@dataclass(frozen=True, slots=True)
class _Scan:
    """What the XML claims of a scan: number of points, names of their fields, bits of a point at the least."""

    count: int
    fields: tuple[str, ...]
    bits: int


def read_e57_columns(path: Path) -> dict[str, FloatArray]:
    """Read the points of all scans of an E57 file, each scan at its pose.

    Returns: x, y and z, in the unit of the file; points that the scanner marked as invalid are left out.
    InputError: No regular file, no E57, an XML section that leads to other files, more points claimed than the file
        holds, or more than the memory does.
    """
    scans = _claimed_scans(path)
    total = sum(scan.count for scan in scans)
    refuse_large(str(path), _POINT_BYTES * total, f"{total} points")
    library = of_extra("pye57")
    try:
        # By an absolute name: others may be read as addresses.
        with library.E57(os.path.abspath(path)) as file:
            found = [_points(path, file, number, scan) for number, scan in enumerate(scans)]
    except InputError:
        raise
    except Exception as error:
        # The library raises types of its own, which are no part of its face.
        raise InputError(f"{path}: cannot be read as E57 ({str(error).strip()[:200]})") from error
    return dict(zip("xyz", np.concatenate(found).T, strict=True))


def _points(path: Path, file: Any, number: int, scan: _Scan) -> FloatArray:
    system = next((name for name, fields in _SYSTEMS.items() if set(fields) <= set(scan.fields)), None)
    if system is None:
        raise InputError(f"{path}: its points have the fields {', '.join(scan.fields)}; x, y and z are needed")
    state = f"{system}InvalidState"
    names = [*_SYSTEMS[system], *([state] if state in scan.fields else [])]
    header = file.get_header(number)
    columns, buffers = file.make_buffers(names, scan.count)
    held = header.points.reader(buffers).read() if scan.count else 0
    if held != scan.count:
        raise InputError(f"{path}: claims {scan.count} points, holds {held}; copy it again")
    points = np.column_stack([columns[name] for name in _SYSTEMS[system]])
    if state in columns:
        points = points[columns[state] == 0]
    if system == "spherical":
        reach, azimuth, elevation = points.T
        level = reach * np.cos(elevation)
        points = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), reach * np.sin(elevation)])
    if header.has_pose():
        points = points @ np.asarray(header.rotation_matrix).T + np.asarray(header.translation, dtype=np.float64)
    return np.asarray(points, dtype=np.float64)


def _claimed_scans(path: Path) -> list[_Scan]:
    with open_regular(path, "an E57 file") as file:
        size = os.fstat(file.fileno()).st_size
        try:
            root = _tree(path, _xml(path, file, size))
        except (struct.error, ElementTree.ParseError) as error:
            raise InputError(f"{path}: cannot be read as E57 ({error}); copy it again") from error
    space = root.tag.rpartition("}")[0]
    space = f"{space}}}" if space else ""
    try:
        scans = [_scan(node, space) for node in root.findall(f"{space}data3D/{space}vectorChild")]
    except (KeyError, ValueError, TypeError, OverflowError) as error:
        raise InputError(f"{path}: cannot be read as E57 (what it says of its points: {error})") from error
    if not scans:
        raise InputError(f"{path}: holds no scan")
    needed = sum(scan.count * scan.bits for scan in scans) // 8
    if needed > size:
        claimed = sum(scan.count for scan in scans)
        raise InputError(
            f"{path}: claims {claimed} points, which need {needed} bytes; it has {size}: is it copied completely?"
        )
    return scans


def _xml(path: Path, file: BinaryIO, size: int) -> bytes:
    signature, _, _, physical, offset, length, page = _HEADER.unpack(file.read(_HEADER.size))
    if signature != _SIGNATURE or page != _PAGE_BYTES:
        raise InputError(f"{path}: cannot be read as E57 (it begins with {signature!r}, pages of {page} bytes)")
    first, skipped = divmod(offset, _PAGE_BYTES)
    pages = -(-(skipped + length) // _CHECKED_BYTES)
    if physical > size or length > MOST_XML_BYTES or (first + pages) * _PAGE_BYTES > size:
        raise InputError(
            f"{path}: claims {physical} bytes with {length} bytes of XML from byte {offset}; it has {size}: is it "
            "copied completely?"
        )
    file.seek(first * _PAGE_BYTES)
    content = file.read(pages * _PAGE_BYTES)
    logical = b"".join(content[k : k + _CHECKED_BYTES] for k in range(0, len(content), _PAGE_BYTES))
    return logical[skipped : skipped + length]


def _tree(path: Path, xml: bytes) -> ElementTree.Element:
    # In another encoding (UTF-16, EBCDIC) the words below stand in other bytes.
    try:
        text = xml.decode("utf-8").removeprefix("\ufeff")
    except UnicodeDecodeError:
        text = ""
    declared = re.match(r"<\?xml[^>]*?encoding\s*=\s*[\"']([^\"']*)", text)
    if not text.startswith("<") or "\0" in text or (declared and declared[1].casefold() != "utf-8"):
        raise InputError(f"{path}: cannot be read as E57 (its XML is not UTF-8, which the format demands)")
    led = re.search(r"<!DOCTYPE|<!ENTITY|\w*schemaLocation", text, re.IGNORECASE)
    if led:
        raise InputError(
            f"{path}: its XML names other files ({led[0]}), which E57 does not need; they are not opened: export "
            "the points again"
        )
    root = ElementTree.fromstring(text)
    level, depth = [root], 0
    while level:
        level, depth = [child for node in level for child in node], depth + 1
        if depth > _DEEPEST:
            raise InputError(f"{path}: cannot be read as E57 (XML nested more than {_DEEPEST} deep)")
    return root


def _scan(node: ElementTree.Element, space: str) -> _Scan:
    points = node.find(f"{space}points")
    prototype = None if points is None else points.find(f"{space}prototype")
    if points is None or prototype is None:
        raise ValueError("a scan without points or without a prototype")
    count = int(points.attrib["recordCount"])
    names = tuple(field.tag.removeprefix(space) for field in prototype)
    bits = sum(_field_bits(field) for field in prototype)
    if count < 0 or (count > 1 and bits == 0):
        raise ValueError(f"{count} points of {bits} bits")
    return _Scan(count, names, bits)


def _field_bits(field: ElementTree.Element) -> int:
    """Return the bits of one value: those that count from the least to the most of whole numbers."""
    kind = field.attrib["type"]
    if kind == "Float":
        return 32 if field.get("precision") == "single" else 64
    if kind in ("Integer", "ScaledInteger"):
        least, most = int(field.get("minimum", _LEAST)), int(field.get("maximum", _MOST))
        return max(most - least, 0).bit_length()
    return 8 if kind == "String" else 0
