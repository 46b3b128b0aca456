"""Level lines of an image window with sub-pixel precision (marching squares)."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliogauge.validate import FloatArray, float_array, freeze


@dataclass(frozen=True, slots=True, eq=False)
class Contour:
    """One closed level line.

    points_px (n, 2): Its crossings with the lines between neighbouring pixel centres, in order; the first is not
        repeated [px].
    length_px: Length of the polygon [px].
    """

    points_px: FloatArray
    length_px: float


def closed_contours(window_dn: npt.ArrayLike, level_dn: float) -> tuple[Contour, ...]:
    """Find the closed lines along which an image has one grey value.

    Shapes: window_dn (h, w).
    Returns: Closed lines; those that run out of the window are left out.
    """
    from skimage.measure import find_contours  # 0.4 s, needed by this estimator only

    window = float_array("window_dn", window_dn, (None, None))
    found = []
    for line in find_contours(window, level_dn):  # type: ignore[no-untyped-call]
        if len(line) > 3 and np.array_equal(line[0], line[-1]):
            points = line[:-1, ::-1]
            length = float(np.hypot(*(line[1:] - line[:-1]).T).sum())
            found.append(Contour(freeze(np.ascontiguousarray(points)), length))
    return tuple(found)
