"""What a JPEG file says of the lens in its EXIF block."""

import struct

_EXIF_MARK = b"Exif\x00\x00"
#: The block is at the beginning: at most one segment of 64 kB after a few short ones.
EXIF_BYTES = 1 << 18
_EXIF_POINTER, _FOCAL_LENGTH_35MM = 0x8769, 0xA405
_SHORT, _LONG = 3, 4


def focal_length_35mm(content: bytes) -> float | None:
    """Return the focal length for a film of 36 mm x 24 mm from the beginning of a file.

    content: The first `EXIF_BYTES`, or more.
    Returns: The focal length [mm]; None where the file does not say it, or is no JPEG.
    """
    block = exif_block(content)
    if block is None:
        return None
    tiff, order = block
    try:
        (first,) = struct.unpack_from(order + "I", tiff, 4)
        inner = _entry(tiff, order, first, _EXIF_POINTER)
        value = None if inner is None else _entry(tiff, order, inner, _FOCAL_LENGTH_35MM)
    except struct.error:
        # A damaged tag block says nothing.
        return None
    return float(value) if value else None


def exif_block(content: bytes) -> tuple[bytes, str] | None:
    """Return the TIFF block of EXIF and its byte order as `struct` writes it; None without one.

    content: The first `EXIF_BYTES`, or more.
    """
    start = content.find(_EXIF_MARK)
    if not content.startswith(b"\xff\xd8") or start < 0:
        return None
    tiff = content[start + len(_EXIF_MARK) :]
    order = {b"II*\x00": "<", b"MM\x00*": ">"}.get(tiff[:4])
    return None if order is None else (tiff, order)


def _entry(tiff: bytes, order: str, start: int, wanted: int) -> int | None:
    """Return the whole number of one tag of a directory."""
    (count,) = struct.unpack_from(order + "H", tiff, start)
    for k in range(count):
        place = start + 2 + 12 * k
        tag, kind = struct.unpack_from(order + "HH", tiff, place)
        if tag == wanted and kind in {_SHORT, _LONG}:
            return int(struct.unpack_from(order + ("H" if kind == _SHORT else "I"), tiff, place + 8)[0])
    return None
