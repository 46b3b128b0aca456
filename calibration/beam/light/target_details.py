"""Whether a target's seams and marks are where the frames without a beam show them."""

from typing import NamedTuple

import cv2
import numpy as np

from calibration.beam.light.beam_centroids import block_sums
from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.validate import BoolArray, FloatArray

__all__ = ["Details", "compare_details"]

#: Width of what counts as a detail [share of the longer side]: seams, marks, edges of panels, not daylight.
_DETAIL = 0.01
#: Least share of details in the scatter of an empty target's picture: below, noise is all that there is.
_LEAST_SHARE = 0.15
#: Grey values of 8 bits that the target must be bright: a seam that is a quarter darker than it is then one darker.
_LEAST_LEVEL = 4.0


class Details(NamedTuple):
    """How much of an empty target's details a photo shows in their places.

    strength: 1 where it shows them, 0 where it does not; NaN where the target has none.
    sigma: Its standard deviation.
    """

    strength: float
    sigma: float


_UNKNOWN = Details(float("nan"), float("nan"))


def compare_details(
    values_dn: FloatArray, empty_dn: FloatArray, free: BoolArray, full_scale_dn: float = 255.0
) -> tuple[Details, Details]:
    """Compare a photo with a frame of the empty target around the beam.

    values_dn (h, w): The photo on the target's plane [DN].
    empty_dn (h, w): The target without a beam [DN].
    free (h, w): Pixels without a beam.
    full_scale_dn: End of the grey scale [DN].
    Returns: What changes along rows, and along columns: a camera that moved along a seam leaves that one in its place.
    """
    side = _DETAIL * max(values_dn.shape)
    inner = cv2.erode(free.astype(np.uint8), np.ones((3, 3), np.uint8), iterations=max(1, round(2 * side))) > 0
    level = float(min(np.median(empty_dn[inner]), np.median(values_dn[inner]))) if inner.any() else 0.0
    if np.count_nonzero(inner) < 500 or level < _LEAST_LEVEL * full_scale_dn / 255:
        return _UNKNOWN, _UNKNOWN
    along_rows, along_columns = (
        _compared(_details(values_dn, widths) * inner, _details(empty_dn, widths) * inner, inner)
        for widths in ((2 * side, 1e-3), (1e-3, 2 * side))
    )
    return along_rows, along_columns


def _compared(seen: FloatArray, expected: FloatArray, inner: BoolArray) -> Details:
    power = float(np.vdot(expected, expected))
    # Seams, marks and edges are few: what most pixels have is noise.
    share = 1 - np.count_nonzero(inner) * robust_scale(expected[inner]) ** 2 / max(power, 1e-300)
    if not share > _LEAST_SHARE:
        return _UNKNOWN
    strength = float(np.vdot(expected, seen)) / power
    # Neighbours share their errors: what blocks of the target scatter by.
    scores = block_sums(expected * (seen - strength * expected))
    sigma = max(float(np.sqrt(np.sum(one**2))) for one in scores) / power
    return Details(strength / share, sigma / share)


def _details(values_dn: FloatArray, widths_px: tuple[float, float]) -> FloatArray:
    """Return by how much each pixel is brighter than its surroundings along rows or columns, as a share of them."""
    around = cv2.GaussianBlur(values_dn, (0, 0), widths_px[0], sigmaY=widths_px[1])
    return np.asarray(values_dn / np.maximum(around, 1e-3 * max(float(around.max()), 1e-9)) - 1)
