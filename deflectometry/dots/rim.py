"""Where a mirror ends in a photo of dots."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, Float32Array, FloatArray
from photogrammetry.centers import REACH, Ellipse

#: Standard deviations of a blur beyond which there is nothing left of it (a thousandth).
BLURS = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Rim(ShortRepr):
    """Where the mirror ends in a photo.

    photo_dn (h, w): The photo with the ground of the mirror going on beyond its edges [DN].
    inside_px (h, w): How far each pixel is within the outline of its facet; negative beside it [px].
    step_dn (h, w): How much brighter the mirror's ground is than what is beside it [DN].
    blur_px: Blur of the edges, as the standard deviation of a Gaussian, pixel included [px].
    sigma_px: How far the outline may be off the edge [px].
    ground_dn (h, w): The mirror's ground around each pixel, without dots [DN].
    """

    photo_dn: Float32Array
    inside_px: FloatArray
    step_dn: FloatArray
    blur_px: float
    sigma_px: float
    ground_dn: FloatArray

    def cuts(self, ellipse: Ellipse) -> bool:
        """Return whether an outline goes through a dot."""
        inside, outwards = self._at(ellipse.center_px)
        return bool(inside < np.sqrt(outwards @ ellipse.shape_px2 @ outwards))

    def holds(self, place_px: FloatArray) -> bool:
        """Return whether a place is within the outline."""
        return self._at(place_px)[0] > 0.0

    def are_near(self, ellipses: Sequence[Ellipse], blur_px: float) -> BoolArray:
        """Return whether the pixels that each dot is measured with show the edge, shape (n,)."""
        if not ellipses:
            return np.zeros(0, dtype=np.bool_)
        reach = REACH * np.array([one.semi_axes_px[0] for one in ellipses]) + BLURS * blur_px
        # The next pixel is less than one pixel away.
        near = self.inside_at(np.array([one.center_px for one in ellipses])) < reach + 1.0
        for k in np.flatnonzero(near).tolist():
            near[k] = self._at(ellipses[k].center_px)[0] < reach[k]
        return np.asarray(near)

    def inside_at(self, places_px: FloatArray) -> FloatArray:
        """Return how far places (n, 2) are within the outline, to the next pixel [px]."""
        height, width = self.inside_px.shape
        column, row = np.clip(np.rint(places_px), 0, np.array([width, height]) - 1).astype(np.intp).T
        return np.asarray(self.inside_px[row, column])

    def _at(self, place_px: FloatArray) -> tuple[float, FloatArray]:
        """Return how far a place is within the outline, and the direction out of it."""
        height, width = self.inside_px.shape
        column, row = np.clip(np.floor(place_px), 1, np.array([width, height]) - 3).astype(int).tolist()
        around = self.inside_px[row - 1 : row + 3, column - 1 : column + 3]
        down, right = (np.asarray(one) for one in np.gradient(around))
        slope = np.array([right[1:3, 1:3].mean(), down[1:3, 1:3].mean()])
        off = place_px - (column, row)
        weights = np.outer([1 - off[1], off[1]], [1 - off[0], off[0]])
        inside = float(np.sum(weights * around[1:3, 1:3]))
        return inside, -slope / max(float(np.linalg.norm(slope)), 1e-9)
