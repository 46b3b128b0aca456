"""A photo with what was found in it: codes that were read, dots without a code, what was refused and why."""

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.images.photos import Image
from heliogauge.results.failure import grey_of
from heliogauge.validate import FloatArray
from photogrammetry.pipeline.photos import OnePhoto

#: Colours as OpenCV has them (blue, green, red): read, a dot without a code, refused.
_READ, _DOT, _REFUSED = (60, 150, 30), (200, 130, 40), (40, 50, 220)
#: Longer side of the picture: up to here a photo is drawn as large as it is, smaller ones are enlarged to `_LEAST`.
_MOST_PX, _LEAST_PX = 3000, 1200
_QUALITY = 85
_SHIFT = 4


def draw_overlay(image_dn: Image, found: OnePhoto) -> bytes:
    """Draw what was found on a photo.

    image_dn (h, w): The photo [DN].
    found: What it shows.
    Returns: A JPEG file.
    """
    longer = max(image_dn.shape)
    scale = float(np.clip(longer, _LEAST_PX, _MOST_PX)) / longer
    grey = grey_of(image_dn, _MOST_PX)
    size = (round(image_dn.shape[1] * scale), round(image_dn.shape[0] * scale))
    if (grey.shape[1], grey.shape[0]) != size:
        grey = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
    # Colours are seen on a paler photo.
    pale = np.asarray(48 + 0.8 * grey, dtype=np.uint8)
    picture = np.ascontiguousarray(np.repeat(pale[:, :, None], 3, axis=2))
    letters = max(size) / 2600
    width = max(round(max(size) / 1200), 1)
    for detections, shapes, color, named in (
        (found.dots, found.dot_ellipses_px2, _DOT, False),
        (found.detections, found.ellipses_px2, _READ, True),
    ):
        for name, place, shape in zip(detections.names, detections.pixels_px, shapes, strict=True):
            _outline(picture, place, shape, scale, color, width)
            if named:
                reach = 8.0 if not np.isfinite(shape).all() else float(np.sqrt(shape[0, 0])) * scale
                _write(picture, name, _at(place, scale) + (reach + 4, -4.0), letters, color)
    for bad in found.refused:
        if bad.place is None:
            continue
        at = _at(np.array([bad.place.x_px, bad.place.y_px]), scale)
        cv2.drawMarker(picture, _whole(at), _REFUSED, cv2.MARKER_TILTED_CROSS, 12 * width, width, cv2.LINE_AA)
        for line, text in enumerate(_lines(bad.name, bad.reason, found.detections.photo)):
            _write(picture, text, at + (10.0 * width, (line - 0.2) * 30 * letters), 0.75 * letters, _REFUSED)
    counts = f"{len(found.detections)} read, {len(found.refused)} refused, {len(found.dots)} dots without a code"
    _write(picture, counts, np.array([10.0, 34 * letters + 4]), 1.3 * letters, (0, 0, 0))
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return data.tobytes()


def _lines(name: str, reason: str, photo: str) -> Sequence[str]:
    """Return name and reason in lines that stay near the mark."""
    words, lines = [name.removesuffix(f" in {photo}") + ":", *reason.split()], [""]
    for word in words:
        if len(lines[-1]) + len(word) > 44:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return lines


def _at(place_px: FloatArray, scale: float) -> FloatArray:
    return np.asarray((place_px + 0.5) * scale - 0.5)


def _whole(place: FloatArray) -> tuple[int, int]:
    x, y = np.rint(place).astype(int).tolist()
    return x, y


def _outline(
    picture: npt.NDArray[np.uint8],
    place_px: FloatArray,
    shape_px2: FloatArray,
    scale: float,
    color: tuple[int, int, int],
    width: int,
) -> None:
    at = _at(place_px, scale)
    if not np.isfinite(shape_px2).all():
        cv2.drawMarker(picture, _whole(at), color, cv2.MARKER_CROSS, 10 * width, width, cv2.LINE_AA)
        return
    values, vectors = np.linalg.eigh(shape_px2)
    turn = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
    axes = np.rint(np.sqrt(values[::-1]) * scale * 2**_SHIFT).astype(int).tolist()
    middle = np.rint(at * 2**_SHIFT).astype(int).tolist()
    cv2.ellipse(picture, middle, axes, turn, 0, 360, color, width, cv2.LINE_AA, _SHIFT)
    cv2.drawMarker(picture, _whole(at), color, cv2.MARKER_CROSS, 6 * width, 1, cv2.LINE_AA)


def _write(
    picture: npt.NDArray[np.uint8], text: str, place: FloatArray, size: float, color: tuple[int, int, int]
) -> None:
    """Write a text with a pale border, so that it can be read on any ground."""
    text = text.encode("ascii", "replace").decode()
    for ink, width in (((255, 255, 255), max(round(6 * size), 3)), (color, max(round(2 * size), 1))):
        cv2.putText(picture, text, _whole(place), cv2.FONT_HERSHEY_SIMPLEX, size, ink, width, cv2.LINE_AA)
