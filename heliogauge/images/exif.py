"""What a JPEG file says of lens and time in its EXIF block."""

import struct

_EXIF_MARK = b"Exif\x00\x00"
#: The block is at the beginning: at most one segment of 64 kB after a few short ones.
EXIF_BYTES = 1 << 18
_EXIF_POINTER, _FOCAL_LENGTH_35MM = 0x8769, 0xA405
_SHORT, _LONG = 3, 4
#: When the photo was taken, its fractions of a second, and kind of text (EXIF 2.32, tables 4 and 6).
_TIME_TAKEN, _FRACTION, _TEXT, _TIME_LENGTH = 0x9003, 0x9291, 2, 19


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


def time_taken(content: bytes) -> str | None:
    """Return when a photo was taken, from the beginning of its file.

    content: The first `EXIF_BYTES`, or more.
    Returns: As ``2026:05:04 10:31:07`` in the camera's clock, with fractions of a second where it says them as
        ``2026-05-04 10:31:07.25``; None where the file does not say it, or is no JPEG.
    """
    block = exif_block(content)
    if block is None:
        return None
    tiff, order = block
    try:
        (first,) = struct.unpack_from(order + "I", tiff, 4)
        inner = _entry(tiff, order, first, _EXIF_POINTER)
        if inner is None:
            return None
        taken, fraction = (_text(tiff, order, inner, tag) for tag in (_TIME_TAKEN, _FRACTION))
    except (struct.error, UnicodeDecodeError):
        # A damaged tag block says nothing.
        return None
    if taken is None or len(taken) != _TIME_LENGTH:
        return None
    if not fraction or not fraction.isdigit():
        return taken
    return f"{taken[:10].replace(':', '-')}{taken[10:]}.{fraction[:6]}"


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


def _text(tiff: bytes, order: str, start: int, wanted: int) -> str | None:
    """Return the text of one tag of a directory, without what fills it up."""
    (count,) = struct.unpack_from(order + "H", tiff, start)
    for k in range(count):
        place = start + 2 + 12 * k
        tag, kind, length = struct.unpack_from(order + "HHI", tiff, place)
        if tag == wanted and kind == _TEXT:
            # Four bytes and less stand in the entry itself.
            at = place + 8 if length <= 4 else struct.unpack_from(order + "I", tiff, place + 8)[0]
            return tiff[at : at + length].rstrip(b"\x00 ").decode("ascii")
    return None
