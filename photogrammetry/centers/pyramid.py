"""A photo in 8 bit with its halvings, sampled at many places at once: what search and reading look at."""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.validate import Float32Array, FloatArray, IntArray

Bytes = npt.NDArray[np.uint8]

#: Smaller semi-axis, in pixels of its level, from which an ellipse is looked at one level higher. Half as many, and the
#: steps of a sharp edge from pixel to pixel shift it by 0.03 px of the level [px].
_ENOUGH_PX = 24.0
#: Rows that OpenCV samples at once; its coordinates are 16 bit.
_ROWS = 16384


@dataclass(frozen=True, slots=True, eq=False)
class Pyramid:
    """A photo and its halvings.

    levels: The photo, and means over 2 x 2, 4 x 4... of its pixels [DN].
    """

    levels: tuple[Bytes, ...]

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the photo [px]."""
        height, width = self.levels[0].shape
        return width, height

    def level_for(self, shapes_px2: FloatArray) -> IntArray:
        """Return on which level ellipses are looked at: with 12 to 24 px from centre to edge, or as fine as the photo.

        Shapes: shapes_px2 (n, 2, 2), result (n,).
        """
        middle = 0.5 * (shapes_px2[:, 0, 0] + shapes_px2[:, 1, 1])
        reach = np.hypot(0.5 * (shapes_px2[:, 0, 0] - shapes_px2[:, 1, 1]), shapes_px2[:, 0, 1])
        smaller = np.sqrt(np.maximum(middle - reach, 1e-6))
        level = np.ceil(np.log2(smaller / _ENOUGH_PX)).astype(np.intp)
        return np.asarray(np.clip(level, 0, len(self.levels) - 1))

    def sample(self, x_px: Float32Array, y_px: Float32Array, level: IntArray) -> Float32Array:
        """Return grey values between the pixels, by linear interpolation.

        Shapes: result (n, m).
        x_px, y_px (n, m): Places in the photo; beyond its border its last pixels go on [px].
        level (n,): On which level each row is sampled.
        """
        values = np.empty(x_px.shape, dtype=np.float32)
        for k in np.flatnonzero(np.bincount(level)).tolist():
            rows = np.flatnonzero(level == k)
            for first in range(0, len(rows), _ROWS):
                # Mostly all are on one level: no need to pick them out.
                part = slice(first, first + _ROWS) if len(rows) == len(level) else rows[first : first + _ROWS]
                at_x, at_y = x_px[part], y_px[part]
                if k:
                    scale, shift = np.float32(0.5**k), np.float32(0.5 ** (k + 1) - 0.5)
                    at_x, at_y = at_x * scale + shift, at_y * scale + shift
                values[part] = cv2.remap(self.levels[k], at_x, at_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return values

    def around(self, centers_px: FloatArray, shapes_px2: FloatArray, unit: FloatArray) -> Float32Array:
        """Return grey values at the same places of many ellipses, each on its level.

        Shapes: result (n, m).
        centers_px (n, 2): Centres in the photo [px].
        shapes_px2 (n, 2, 2): Shape matrices in the photo [px^2].
        unit (2, m): Places; the unit circle is the ellipse.
        """
        # One product of two matrices for each axis: numpy's of many small ones take ten times as long.
        maps = np.concatenate([ellipse_frames(shapes_px2), centers_px[..., None]], axis=2).astype(np.float32)
        places = np.vstack([unit, np.ones(unit.shape[1])]).astype(np.float32)
        return self.sample(maps[:, 0] @ places, maps[:, 1] @ places, self.level_for(shapes_px2))


def make_pyramid(image_dn: npt.NDArray[np.generic], levels: int = 8) -> Pyramid:
    """Halve a photo again and again.

    image_dn (h, w): Grey values: uint8, uint16, or float on the scale of one of them [DN].
    levels: At most so many levels; none is smaller than 16 px.
    Returns: The photo in 8 bit and its halvings.
    InputError: Not an image of one colour.
    """
    if image_dn.ndim != 2 or min(image_dn.shape) < 16:
        raise InputError(f"image: a grey image of at least 16 x 16 px is needed, not shape {image_dn.shape}")
    found = [_bytes(image_dn)]
    while len(found) < levels and min(found[-1].shape) >= 32:
        height, width = (size // 2 for size in found[-1].shape)
        # An odd last row or column is left out, so that a pixel of one level is exactly four of the one before.
        even = found[-1][: 2 * height, : 2 * width]
        found.append(np.asarray(cv2.resize(even, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8))
    return Pyramid(tuple(found))


def _bytes(image_dn: npt.NDArray[np.generic]) -> Bytes:
    """Return the photo in 8 bit, for search and reading only."""
    if image_dn.dtype == np.uint8:
        return np.ascontiguousarray(image_dn, dtype=np.uint8)
    values = np.ascontiguousarray(image_dn, dtype=image_dn.dtype if image_dn.dtype == np.uint16 else np.float32)
    highest = float(values.max(initial=0))
    # Files of 16 bit may hold 12: what counts is the contrast against the brightest pixel.
    alpha = 255.0 / max(highest, 1.0) if image_dn.dtype == np.uint16 or highest > 255.5 else 1.0
    return np.asarray(cv2.convertScaleAbs(values, alpha=alpha), dtype=np.uint8)


def ellipse_frames(shapes_px2: FloatArray) -> FloatArray:
    """Return the symmetric roots R of shape matrices: c + R (cos t, sin t) runs along the ellipse.

    Shapes: shapes_px2 (n, 2, 2), result (n, 2, 2).
    """
    determinant = shapes_px2[:, 0, 0] * shapes_px2[:, 1, 1] - shapes_px2[:, 0, 1] ** 2
    root = np.sqrt(np.maximum(determinant, 1e-9))
    trace = shapes_px2[:, 0, 0] + shapes_px2[:, 1, 1]
    frames = (shapes_px2 + root[:, None, None] * np.eye(2)) / np.sqrt(trace + 2 * root)[:, None, None]
    return np.asarray(frames)
