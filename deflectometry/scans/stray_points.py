"""Points of a scan that are not of the surface: left out before neighbours are fitted, which they would draw."""

from statistics import NormalDist

import numpy as np

from deflectometry.scans.patch_slopes import Deviations
from heliogauge.adjust.robust_scale import robust_scale_of_rows
from heliogauge.validate import BoolArray

#: Neighbours that tell where the surface is: their median stands while fewer than half of them are stray.
_NEIGHBOURS = 24
#: At the corner of a tilted mirror a point is so many scatters of its neighbours from their median: one end of
#: x + y over a square, against the median absolute deviation of that sum as a standard deviation, 1 / 0.434.
_AT_CORNER = 2.3
#: One good point in twenty scans, as for points beside the surface of their neighbours.
_FAMILY = 0.05
#: Neighbours that scatter by more than half of how far apart they are lie on no surface: 27 degrees off the design.
_NO_SURFACE = 0.5
_ROUNDS = 8


def stray_points(deviations: Deviations) -> BoolArray:
    """Return which points are far from the median of their neighbours, shape (n,), or whose neighbours tell no surface.

    Strays that are gone are no neighbours in the next round: where there were more of them than good points, these
    are left.
    """
    from scipy.spatial import cKDTree

    total = len(deviations.places_m)
    kept = np.ones(total, dtype=np.bool_)
    critical = _AT_CORNER + NormalDist().inv_cdf(1 - _FAMILY / (2 * max(total, 1)))
    for _ in range(_ROUNDS):
        good = deviations.chosen(kept)
        if len(good.places_m) <= 2 * _NEIGHBOURS:
            break
        distance, near = cKDTree(good.places_m).query(good.places_m, k=_NEIGHBOURS + 1)
        heights = good.deviation_m[near[:, 1:]]
        middle = np.median(heights, axis=1)
        scatter = robust_scale_of_rows(heights - middle[:, None])
        off = np.abs(good.deviation_m - middle) > critical * np.maximum(scatter, np.median(scatter))
        lost = scatter > _NO_SURFACE * np.sqrt(np.mean(distance**2, axis=1))
        if not (off | lost).any():
            break
        kept[np.flatnonzero(kept)[off | lost]] = False
    return ~kept
