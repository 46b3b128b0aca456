"""Contours of a beam's flux at shares of its peak."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calibration.beam.light.beam_size import LightPicture
from heliogauge.validate import FloatArray, IntArray

__all__ = ["Contour", "beam_contours"]


@dataclass(frozen=True, slots=True, eq=False)
class Contour:
    """Where a beam has a share of its peak.

    share: Of the peak.
    lines_m: Closed lines on the target, shape (n, 2) each [m].
    area_m2: Area above the share [m^2].
    """

    share: float
    lines_m: tuple[FloatArray, ...]
    area_m2: float


def beam_contours(picture: LightPicture, smoothing_px: float, shares: Sequence[float]) -> tuple[Contour, ...]:
    """Return contours of the smoothed light.

    smoothing_px: Standard deviation of the Gaussian that smooths it [px].
    shares: Of its peak.
    """
    light = np.where(picture.region, picture.values_dn, 0.0)
    smooth = np.asarray(cv2.GaussianBlur(light, (0, 0), max(smoothing_px, 0.3)), dtype=np.float64)
    peak = float(smooth[picture.inside].max()) if picture.inside.any() else 0.0
    found = []
    for share in shares:
        above = smooth >= share * peak
        area = float(np.count_nonzero(above)) * picture.pixel_m2
        outlines, _ = cv2.findContours(above.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        lines = tuple(
            _refined(np.asarray(outline[:, 0, :], dtype=np.intp), smooth, share * peak, picture)
            for outline in outlines
            if len(outline) > 5
        )
        found.append(Contour(share, lines, area))
    return tuple(found)


def _refined(pixels: IntArray, smooth: FloatArray, level: float, picture: LightPicture) -> FloatArray:
    """Move the pixels of an outline along the gradient to the level itself, by at most one pixel; every third one."""
    column, row = pixels[::3, 0], pixels[::3, 1]
    down, across = (np.gradient(smooth, axis=axis)[row, column] for axis in (0, 1))
    steep = across**2 + down**2
    step = (level - smooth[row, column]) / np.where(steep > 1e-12, steep, np.inf)
    length = np.abs(step) * np.sqrt(steep)
    step = step / np.maximum(length, 1.0)
    x = picture.x_m[0] + (column + step * across) * (picture.x_m[1] - picture.x_m[0])
    y = picture.y_m[0] + (row + step * down) * (picture.y_m[1] - picture.y_m[0])
    return np.stack([x, y], axis=1).round(4)
