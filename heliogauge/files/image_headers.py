"""What the header of an image file says of its raster, read without decoding anything."""

import struct
from dataclasses import dataclass
from math import ceil

_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
_PNG_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}
# Start of frame: all coded processes; c4, c8 and cc in between are tables.
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_ALONE = frozenset({0x01, *range(0xD0, 0xD9)})
_JPEG_SCAN, _JPEG_END = 0xDA, 0xD9

_TIFF_FORMS = {1: "B", 3: "H", 4: "I", 16: "Q"}
_WIDTH, _HEIGHT, _BITS, _SAMPLES, _TILE_WIDTH, _TILE_HEIGHT = 256, 257, 258, 277, 322, 323
_MOST_TAGS = 4096

# Bytes of a file that its raster needs at the least. Deflate packs 1032 to 1; a block of 64 JPEG pixels takes a bit in
# each of three colours, fewer where a progressive file skips runs of empty ones.
_PNG_MOST_PACKED, _JPEG_MOST_PACKED = 1032.0, 2048.0


@dataclass(frozen=True, slots=True)
class ImageHeader:
    """What an image file says of itself.

    form: "PNG", "JPEG", "TIFF" or "BMP".
    width_px, height_px: Size of the raster [px].
    channels: Colours, with transparency.
    depth_bytes: Bytes of one value.
    stored_share: Bytes in the file for each that its raster needs at the least; below 1 it cannot hold the raster.
    """

    form: str
    width_px: int
    height_px: int
    channels: int
    depth_bytes: int
    stored_share: float = 1.0

    @property
    def pixels(self) -> int:
        """Number of pixels."""
        return self.width_px * self.height_px


def image_header(content: bytes) -> ImageHeader | None:
    """Read the header of an image file.

    content: The file.
    Returns: What it says; None where it is no PNG, JPEG, TIFF or BMP, or the header is damaged.
    """
    try:
        if content.startswith(_PNG):
            return _png(content)
        if content.startswith(_JPEG):
            return _jpeg(content)
        if content[:4] in {b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"}:
            return _tiff(content)
        return _bmp(content) if content.startswith(b"BM") else None
    except (struct.error, IndexError, OverflowError):
        return None


def _png(content: bytes) -> ImageHeader | None:
    length, name, width, height, depth, colours = struct.unpack_from(">I4sIIBB", content, 8)
    if name != b"IHDR" or length != 13 or colours not in _PNG_CHANNELS:
        return None
    channels = 1 if colours == 3 else _PNG_CHANNELS[colours]
    least = height * ceil(width * channels * depth / 8) / _PNG_MOST_PACKED
    share = len(content) / max(least, 1)
    return ImageHeader("PNG", width, height, _PNG_CHANNELS[colours], 2 if depth == 16 else 1, share)


def _jpeg(content: bytes) -> ImageHeader | None:
    position = 2
    while position + 4 <= len(content):
        if content[position] != 0xFF:
            return None
        marker = content[position + 1]
        if marker == 0xFF:
            position += 1
        elif marker in _JPEG_ALONE:
            position += 2
        elif marker in _JPEG_FRAMES:
            depth, height, width, channels = struct.unpack_from(">BHHB", content, position + 4)
            share = len(content) / max(width * height / _JPEG_MOST_PACKED, 1)
            return ImageHeader("JPEG", width, height, channels, 2 if depth > 8 else 1, share)
        elif marker in {_JPEG_SCAN, _JPEG_END}:
            return None
        else:
            position += 2 + struct.unpack_from(">H", content, position + 2)[0]
    return None


def _tiff(content: bytes) -> ImageHeader | None:
    order = "<" if content.startswith(b"II") else ">"
    is_big = content[2:4] in {b"+\0", b"\0+"}
    (start,) = struct.unpack_from(order + ("Q" if is_big else "I"), content, 8 if is_big else 4)
    (count,) = struct.unpack_from(order + ("Q" if is_big else "H"), content, start)
    first, step = start + (8 if is_big else 2), 20 if is_big else 12
    says: dict[int, int] = {}
    for k in range(min(count, _MOST_TAGS)):
        place = first + k * step
        tag, kind, length = struct.unpack_from(order + ("HHQ" if is_big else "HHI"), content, place)
        if kind not in _TIFF_FORMS or not length:
            continue
        form, inside = _TIFF_FORMS[kind], place + (12 if is_big else 8)
        if length * struct.calcsize(form) > (8 if is_big else 4):
            (inside,) = struct.unpack_from(order + ("Q" if is_big else "I"), content, inside)
        says.setdefault(tag, struct.unpack_from(order + form, content, inside)[0])
    if _WIDTH not in says or _HEIGHT not in says:
        return None
    # Decoders make room for a whole tile, however little of it lies in the raster.
    tile_width, tile_height = says.get(_TILE_WIDTH, 0), says.get(_TILE_HEIGHT, 0)
    width = ceil(says[_WIDTH] / tile_width) * tile_width if tile_width else says[_WIDTH]
    height = ceil(says[_HEIGHT] / tile_height) * tile_height if tile_height else says[_HEIGHT]
    return ImageHeader("TIFF", width, height, says.get(_SAMPLES, 1), max(ceil(says.get(_BITS, 1) / 8), 1))


def _bmp(content: bytes) -> ImageHeader | None:
    (size,) = struct.unpack_from("<I", content, 14)
    if size < 40:
        return None
    width, height, _, bits = struct.unpack_from("<iiHH", content, 18)
    return ImageHeader("BMP", abs(width), abs(height), 4 if bits == 32 else 3, 1)
