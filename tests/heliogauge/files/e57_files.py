"""E57 files drawn by the library that reads them, and changed by hand as a stranger would: with right checksums."""

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

PAGE, CHECKED = 1024, 1020
_POLYNOMIAL = 0x82F63B78


def _crc_table() -> list[int]:
    table = []
    for value in range(256):
        for _ in range(8):
            value = value >> 1 ^ (_POLYNOMIAL if value & 1 else 0)
        table.append(value)
    return table


_CRC = _crc_table()


def _crc32c(content: bytes) -> int:
    crc = 0xFFFFFFFF
    for byte in content:
        crc = _CRC[(crc ^ byte) & 0xFF] ^ crc >> 8
    return crc ^ 0xFFFFFFFF


def write_e57(path: Path, points_m: np.ndarray, **fields: np.ndarray) -> None:
    """Write points as one scan."""
    library = pytest.importorskip("pye57")
    columns = {f"cartesian{axis}": points_m[:, k] for k, axis in enumerate("XYZ")} | fields
    writer = library.E57(str(path), mode="w")
    writer.write_scan_raw(columns)
    writer.close()


def change_xml(path: Path, change: Callable[[bytes], bytes]) -> None:
    """Change the XML section of an E57 file, and write lengths and checksums anew."""
    content = path.read_bytes()
    offset, length = struct.unpack_from("<QQ", content, 24)
    logical = b"".join(content[k : k + CHECKED] for k in range(0, len(content), PAGE))
    start = offset // PAGE * CHECKED + offset % PAGE
    xml = change(logical[start : start + length])
    logical = logical[:start] + xml
    logical += bytes(-len(logical) % CHECKED)
    header = struct.pack("<QQQ", len(logical) // CHECKED * PAGE, offset, len(xml))
    logical = logical[:16] + header + logical[40:]
    pages = (logical[k : k + CHECKED] for k in range(0, len(logical), CHECKED))
    path.write_bytes(b"".join(page + struct.pack(">I", _crc32c(page)) for page in pages))
