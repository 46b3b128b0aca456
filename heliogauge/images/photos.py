"""Read and write photographs: the only place that decodes image files.

What is kept as it is: the sensor's raster (an orientation tag is not applied, because the camera model refers to the
raster; a mixture of orientations is warned of), the depth (uint8 or uint16), and the values. A colour photograph
becomes its luminance as float32.

OpenCV decodes a truncated JPEG to a picture with a grey lower half and says nothing. Files are therefore checked for
wholeness before they are decoded.
"""

import os
import re
import struct
import zlib
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.doubts import Doubt
from heliogauge.errors import InputError
from heliogauge.files.image_headers import ImageHeader, image_header
from heliogauge.files.memory import refuse_large
from heliogauge.files.regular import MOST_IMAGE_BYTES, read_regular
from heliogauge.images.camera_raw import decode_raw, is_camera_raw, raw_header
from heliogauge.images.video import read_frame
from heliogauge.images.video_names import video_of
from heliogauge.running.progress import Progress, SilentProgress

Image = npt.NDArray[np.uint8] | npt.NDArray[np.uint16] | npt.NDArray[np.float32]

#: Weights of red, green and blue in the luminance (ITU-R BT.709); they add up to 1, so grey keeps its value.
LUMINANCE_WEIGHTS = (0.2126, 0.7152, 0.0722)

#: Largest raster that is read: nearly twice the largest sensor of a camera that is sold (151 million).
MOST_PIXELS = 268_000_000

#: Where OpenCV puts each colour.
_CHANNELS = {"red": 2, "green": 1, "blue": 0}
_PNG_SIGNATURE, _JPEG_SIGNATURE = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
# A picture whose colours differ does so in every so manyth row already.
_SOME_ROWS = 61
# A marker in JPEG's entropy-coded data: ff that is not stuffed (00), not a restart (d0-d7), not fill (ff).
_JPEG_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")
_JPEG_LAST = b"\xff\xd9"
_JPEG_END, _JPEG_SCAN, _JPEG_EXIF = 0xD9, 0xDA, 0xE1


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Photographs of one size.

    images_dn (n, height, width): Grey values; uint8, uint16, or float32 where at least one photograph is in colour
        [DN].
    full_scale_dn: Largest value the files can hold: 255 or 65535 [DN].
    files: Where each photograph comes from.
    doubts: Whether the camera was turned between them, or a program turned some of them.
    """

    images_dn: Image
    full_scale_dn: int
    files: tuple[Path, ...]
    doubts: tuple[Doubt, ...] = ()


def read_image(path: Path) -> Image:
    """Read one photograph as grey values.

    path: JPEG, PNG, TIFF or BMP; 8 or 16 bit, mono or colour. Or a camera raw file (`heliogauge.images.camera_raw`), or
        a frame of a video, such as ``pass.mp4#00012`` (`heliogauge.images.video`).
    Returns (height, width): Grey values in the file's depth; float32 luminance of a photograph in colour [DN].
        Luminance of a frame is rounded to uint8: a video holds no more.

    Luminance is the weighted sum of `LUMINANCE_WEIGHTS` of the file's values as they are (no gamma is undone). Where
    one colour is at full scale, the luminance is set to full scale, so that a pixel with one saturated colour counts
    as saturated. A colour file whose three colours are equal is read as mono, with its integers. An alpha channel is
    ignored.
    """
    if video_of(path) != path:
        return np.asarray(np.rint(_grey(read_frame(path))), dtype=np.uint8)
    return _grey(_decode(path, _read_bytes(path)))


def read_channel(path: Path, channel: str) -> Image:
    """Read one colour of a photograph, or of a frame of a video.

    channel: "red", "green" or "blue"; "luminance" is what `read_image` gives.
    Returns (height, width): Values of that colour, or of a photograph without colours, in the file's depth [DN].
    InputError: No such channel; or as `read_image`.
    """
    if channel == "luminance":
        return read_image(path)
    if channel not in _CHANNELS:
        raise InputError(f"channel: one of luminance, {', '.join(_CHANNELS)} is needed, not {channel!r}")
    image = read_frame(path) if video_of(path) != path else _decode(path, _read_bytes(path))
    if image.ndim == 2 or image.shape[2] < 3:
        return _grey(image)
    return np.ascontiguousarray(image[..., _CHANNELS[channel]])


@contextmanager
def naming_all_unreadable(files: Sequence[Path]) -> Iterator[None]:
    """Name all photographs that cannot be read where one of them ends the work, not the first alone.

    files: The photographs that the work reads.
    Returns: While they are read.
    InputError: What was raised; for a photograph that cannot be read with the others like it.
    """
    try:
        yield
    except InputError as error:
        faults = []
        for file in files:
            try:
                read_luma(file)
            except InputError as own:
                faults.append(str(own))
        if str(error) not in faults:
            raise
        count = f"{len(faults)} of {len(files)} photos cannot be read"
        raise InputError("; ".join([*faults, f"{count}: mend or remove them, the others may do without"])) from error


def read_luma(path: Path) -> Image:
    """Read one photograph as grey values for measuring edges: of a JPEG in colour its own luma, without the colours.

    Returns (height, width): Luma of a JPEG (weights 0.299, 0.587, 0.114 of red, green and blue, ITU-R BT.601),
        which has the full resolution and is decoded in less time than the colours; of other files what `read_image`
        gives [DN].
    InputError: As `read_image`.

    A pixel counts as saturated only where all colours are.
    """
    if video_of(path) == path:
        content = _read_bytes(path)
        if content.startswith(_JPEG_SIGNATURE):
            luma: Image = _decode(path, content, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
            return luma
        return _grey(_decode(path, content))
    return read_image(path)


def read_frames(
    paths: Sequence[Path], *, jobs: int | None = None, progress: Progress | None = None, stage: str = "read images"
) -> Frames:
    """Read photographs of one size into one array, several at a time.

    paths: The files, in the order wanted.
    jobs: Threads that decode; as many as there are processors (at most 8) if absent.
    stage: Name of this work for the progress.
    InputError: No paths, a photograph cannot be read, or sizes or depths differ; the odd ones are named.
    """
    if not paths:
        raise InputError("images: at least one file is needed")
    threads = jobs or min(os.cpu_count() or 1, 8)
    _check_sum(paths)
    stack = _Stack(len(paths))
    orientations: list[int] = []
    with (progress or SilentProgress()).stage(stage, len(paths)) as running, ThreadPoolExecutor(threads) as pool:
        try:
            # No more of them side by side as they are decoded than the threads need.
            rest = iter(paths)
            waiting = deque(pool.submit(_read_with_orientation, path) for path in islice(rest, 2 * threads))
            while waiting:
                image, orientation = waiting.popleft().result()
                waiting.extend(pool.submit(_read_with_orientation, path) for path in islice(rest, 1))
                stack.add(image)
                orientations.append(orientation)
                running.advance()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    _refuse_mixture(paths, stack.sizes, "size")
    _refuse_mixture(paths, [f"{depth.bit_length()} bit" for depth in stack.depths_dn], "depth")
    return Frames(stack.images_dn, stack.depths_dn[0], tuple(paths), tuple(_orientation_doubts(paths, orientations)))


def _check_sum(paths: Sequence[Path]) -> None:
    """Check that all photographs have room side by side, judged by the first: they are of one size."""
    if video_of(paths[0]) != paths[0]:
        return
    content = _read_bytes(paths[0])
    header = raw_header(paths[0], content) if is_camera_raw(paths[0]) else image_header(content)
    if header is not None:
        # In one array, and a few as they are decoded.
        each = header.pixels * (header.depth_bytes if header.channels == 1 else 4)
        what = f"{len(paths)} images of {header.width_px} x {header.height_px} px"
        refuse_large(str(paths[0].parent), len(paths) * each + 4 * header.pixels * _bytes_per_pixel(header), what)


def _orientation_doubts(paths: Sequence[Path], orientations: Sequence[int]) -> Iterator[Doubt]:
    tags = set(orientations)
    if len(tags) > 1:
        odd = _odd_ones(paths, [str(tag) for tag in orientations])
        yield Doubt(
            "orientation_tags_differ",
            f"photographs with different orientation tags ({odd}); they are used as the sensor took them, "
            "so check that no program has turned them",
            {"tags_count": len(tags), "photos_count": len(paths)},
        )


def write_image(path: Path, image: npt.NDArray[np.uint8] | npt.NDArray[np.uint16]) -> None:
    """Write a picture without loss; the file is whole or not there.

    path: Name that ends in .png, .tif or .tiff.
    image (height, width) or (height, width, 3): Grey values, or red, green, blue [DN].
    InputError: Another name, type or shape, or the file cannot be written.
    """
    suffix = path.suffix.lower()
    if suffix not in {".png", ".tif", ".tiff"}:
        raise InputError(f"{path}: images are written as .png, .tif or .tiff, not {suffix or 'without a suffix'!r}")
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{path}: uint8 or uint16 values are needed, not {image.dtype}")
    if image.size == 0 or not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)):
        raise InputError(f"{path}: shape (height, width) or (height, width, 3) is needed, not {image.shape}")
    values = image if image.ndim == 2 else image[..., ::-1]
    # Level 1: fringe images shrink nearly as far as with the default level, in a third of the time.
    options = [cv2.IMWRITE_PNG_COMPRESSION, 1] if suffix == ".png" else []
    _, encoded = cv2.imencode(suffix, np.ascontiguousarray(values), options)
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        beside.write_bytes(encoded.tobytes())
        beside.replace(path)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise InputError(f"{path}: cannot be written ({error.strerror}); check folder, permissions, space") from error


# --- from bytes to values -------------------------------------------------------------------------------------------


def _read_bytes(path: Path) -> bytes:
    content = read_regular(path, "an image", MOST_IMAGE_BYTES)
    if not content:
        raise InputError(f"{path}: the file is empty (0 bytes); copy it again from the camera")
    return content


def _read_with_orientation(path: Path) -> tuple[npt.NDArray[Any], int]:
    if video_of(path) != path:
        return read_image(path), 1
    content = _read_bytes(path)
    return _decode(path, content), orientation_tag(content)


def _decode(path: Path, content: bytes, how: int = cv2.IMREAD_UNCHANGED) -> npt.NDArray[Any]:
    """Return the file's values as they are, shape (height, width) or (height, width, colours in OpenCV's order)."""
    if is_camera_raw(path):
        _check_size(path, content)
        return decode_raw(path, content)
    fault = _fault(content)
    if fault:
        raise InputError(f"{path}: {fault}; copy the file again from the camera")
    _check_size(path, content)
    # Unchanged: depth and values as in the file, no rotation by an orientation tag.
    try:
        image = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), how)
    except (cv2.error, MemoryError) as error:
        text = getattr(error, "err", "") or "not enough memory"
        raise InputError(f"{path}: cannot be decoded ({text}); JPEG, PNG or TIFF is needed") from None
    if image is None:
        raise InputError(f"{path}: cannot be decoded ({len(content)} bytes); an undamaged JPEG, PNG or TIFF is needed")
    _full_scale(path, image)
    return np.asarray(image)


def _check_size(path: Path, content: bytes) -> ImageHeader:
    """Check what the header says before anything is decoded: a file of 5 MB can hold a raster of 10 GB."""
    header = raw_header(path, content) if is_camera_raw(path) else image_header(content)
    if header is None:
        raise InputError(f"{path}: cannot be decoded ({len(content)} bytes); an undamaged JPEG, PNG or TIFF is needed")
    size = f"{header.width_px} x {header.height_px} px"
    if not header.pixels or header.stored_share < 1:
        raise InputError(f"{path}: says {size}, which {len(content)} bytes cannot hold; copy it again from the camera")
    if header.pixels > MOST_PIXELS:
        raise InputError(
            f"{path}: {size} are {header.pixels / 1e6:.0f} million; at most {MOST_PIXELS / 1e6:.0f} million are read: "
            "reduce the image, or cut it into parts"
        )
    refuse_large(str(path), header.pixels * _bytes_per_pixel(header), size)
    return header


def _bytes_per_pixel(header: ImageHeader) -> int:
    """Return the memory that decoding and the luminance take at their peak: colours twice, and two of float32."""
    decoded = header.channels * header.depth_bytes
    return decoded if header.channels == 1 else 2 * decoded + 9


def _full_scale(path: Path, image: npt.NDArray[Any]) -> int:
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{path}: values are {image.dtype}; 8 or 16 bit unsigned integers are needed")
    return int(np.iinfo(image.dtype).max)


def _grey(image: npt.NDArray[Any]) -> Image:
    if image.ndim == 2:
        return image
    if image.shape[2] < 3:
        return np.ascontiguousarray(image[..., 0])
    blue, green, red = cv2.split(image)[:3]
    some = slice(None, None, _SOME_ROWS)
    if np.array_equal(red[some], green[some]) and np.array_equal(red, green) and np.array_equal(green, blue):
        grey: Image = green  # type: ignore[assignment]
        return grey
    full_scale = np.iinfo(image.dtype).max
    of_red, of_green, of_blue = LUMINANCE_WEIGHTS
    luminance = cv2.addWeighted(red, of_red, green, of_green, 0.0, dtype=cv2.CV_32F)
    luminance = cv2.scaleAdd(blue.astype(np.float32), of_blue, luminance, luminance)
    highest = np.asarray(cv2.max(cv2.max(red, green), blue))
    if highest.max() == full_scale:
        luminance[highest == full_scale] = full_scale
    return np.asarray(luminance, dtype=np.float32)


class _Stack:
    """Grey values of photographs in one array, put there one after the other.

    images_dn (count, height, width): What was added, as long as it is of one size and depth [DN].
    sizes, depths_dn: Size in words and largest value of each photograph.
    """

    __slots__ = ("_count", "depths_dn", "images_dn", "sizes")

    def __init__(self, count: int) -> None:
        self._count = count
        self.images_dn: Image = np.empty((0, 0, 0), dtype=np.uint8)
        self.sizes: list[str] = []
        self.depths_dn: list[int] = []

    def add(self, image: npt.NDArray[Any]) -> None:
        """Add a photograph as it was decoded."""
        place = len(self.sizes)
        self.sizes.append(_size_text(image))
        self.depths_dn.append(int(np.iinfo(image.dtype).max))
        if self.sizes[-1] != self.sizes[0] or self.depths_dn[-1] != self.depths_dn[0]:
            return
        grey = _grey(image)
        if not place:
            self.images_dn = np.empty((self._count, *grey.shape), dtype=grey.dtype)
        elif grey.dtype == np.float32 != self.images_dn.dtype:
            self.images_dn = self.images_dn.astype(np.float32)
        self.images_dn[place] = grey


# --- what does not belong together ----------------------------------------------------------------------------------


def _size_text(image: npt.NDArray[Any]) -> str:
    return f"{image.shape[1]} x {image.shape[0]}"


def _odd_ones(paths: Sequence[Path], properties: Sequence[str]) -> str:
    usual, count = Counter(properties).most_common(1)[0]
    odd = [f"{path.name}: {own}" for path, own in zip(paths, properties, strict=True) if own != usual]
    more = f" and {len(odd) - 3} more" if len(odd) > 3 else ""
    return f"{count} of {len(paths)} are {usual}, but {', '.join(odd[:3])}{more}"


def _refuse_mixture(paths: Sequence[Path], properties: Sequence[str], what: str) -> None:
    if len(set(properties)) > 1:
        raise InputError(
            f"{paths[0].parent}: images of one {what} are needed; {_odd_ones(paths, properties)}; "
            "leave out what does not belong to the measurement"
        )


# --- is the file whole? ---------------------------------------------------------------------------------------------


def _fault(content: bytes) -> str:
    if content.startswith(_JPEG_SIGNATURE):
        # In coded data ff is followed by 00 or a restart: a file that was cut off in them does not end like this.
        if content.endswith(_JPEG_LAST):
            return ""
        return "" if _jpeg_segments(content).get(_JPEG_END) else "the JPEG file is cut off (its end marker is missing)"
    if content.startswith(_PNG_SIGNATURE):
        return _png_fault(content)
    return ""


def _jpeg_segments(content: bytes) -> dict[int, list[int]]:
    """Walk through a JPEG file; return where each kind of marker stands, up to the end marker."""
    found: dict[int, list[int]] = {}
    position = 2
    while position + 4 <= len(content) or content[position : position + 2] == b"\xff\xd9":
        if content[position] != 0xFF:
            break
        marker = content[position + 1]
        if marker == 0xFF:
            position += 1
            continue
        found.setdefault(marker, []).append(position)
        if marker == _JPEG_END:
            break
        position += 2 + int.from_bytes(content[position + 2 : position + 4], "big")
        if marker == _JPEG_SCAN:
            # Coded data follow, of unknown length; a thumbnail's end marker lies in a segment that was skipped.
            following = _JPEG_MARKER.search(content, position)
            position = following.start() if following else len(content)
    return found


def _png_fault(content: bytes) -> str:
    position = len(_PNG_SIGNATURE)
    while position + 12 <= len(content):
        length = int.from_bytes(content[position : position + 4], "big")
        kind = content[position + 4 : position + 8]
        end = position + 8 + length
        if end + 4 > len(content):
            break
        if zlib.crc32(content[position + 4 : end]) != int.from_bytes(content[end : end + 4], "big"):
            return f"the PNG file is damaged (checksum of its {kind.decode('latin-1')} part)"
        if kind == b"IEND":
            return ""
        position = end + 4
    return "the PNG file is cut off (its end is missing)"


def orientation_tag(content: bytes) -> int:
    """Return the EXIF orientation of a JPEG file.

    Returns: 1 (as the sensor took it) to 8; 1 where there is no tag.
    """
    if not content.startswith(b"\xff\xd8"):
        return 1
    for position in _jpeg_segments(content).get(_JPEG_EXIF, []):
        length = int.from_bytes(content[position + 2 : position + 4], "big")
        segment = content[position + 4 : position + 2 + length]
        if segment.startswith(b"Exif\x00\x00"):
            return _orientation_of_tiff(segment[6:])
    return 1


def _orientation_of_tiff(tiff: bytes) -> int:
    order = {b"II*\x00": "<", b"MM\x00*": ">"}.get(tiff[:4])
    if order is None:
        return 1
    try:
        (start,) = struct.unpack_from(order + "I", tiff, 4)
        (count,) = struct.unpack_from(order + "H", tiff, start)
        for k in range(count):
            tag, kind, _, value = struct.unpack_from(order + "HHIH", tiff, start + 2 + 12 * k)
            if (tag, kind) == (0x0112, 3):
                return int(value) if 1 <= value <= 8 else 1
    except struct.error:
        # A damaged tag block says nothing about the picture.
        return 1
    return 1
