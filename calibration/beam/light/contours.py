"""Contours of a beam's flux at shares of its peak."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calibration.beam.light.beam_size import LightPicture
from heliogauge.validate import FloatArray

__all__ = ["Contour", "beam_contours"]

#: A line has a vertex where it crosses a side between pixels, one or two for each pixel of way: every third is kept.
_EVERY = 3
#: Vertices of a line around five pixels and fewer: a speck of noise.
_LEAST_VERTICES = 13


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
    from skimage.measure import find_contours

    light = np.where(picture.region, picture.values_dn, 0.0)
    smooth = np.asarray(cv2.GaussianBlur(light, (0, 0), max(smoothing_px, 0.3)), dtype=np.float64)
    peak = float(smooth[picture.inside].max()) if picture.inside.any() else 0.0
    found = []
    # A beam may reach the picture's edge: its line is closed there.
    bordered = np.pad(smooth, 1)
    for share in shares:
        area = float(np.count_nonzero(smooth >= share * peak)) * picture.pixel_m2
        lines = find_contours(bordered, share * peak) if peak > 0 else []
        thinned = (line[:-1:_EVERY] - 1.0 for line in lines if len(line) > _LEAST_VERTICES)
        found.append(Contour(share, tuple(_on_target(line, picture) for line in thinned), area))
    return tuple(found)


def _on_target(line: FloatArray, picture: LightPicture) -> FloatArray:
    """Return where vertices (n, 2), by row and column, lie on the target [m]."""
    x = picture.x_m[0] + line[:, 1] * (picture.x_m[1] - picture.x_m[0])
    y = picture.y_m[0] + line[:, 0] * (picture.y_m[1] - picture.y_m[0])
    return np.stack([x, y], axis=1).round(4)
