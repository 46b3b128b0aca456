"""Slopes along the trough as far as those across tell them: a surface twists alike in both directions.

Of a surface with heights h, ``d (dh/dy) / dx = d (dh/dx) / dy``. How slopes across change from row to row therefore
says how the slope along the trough changes across, within a panel; what remains is one slope for each row's piece of a
panel.
"""

from itertools import pairwise

import numpy as np

from heliogauge.validate import BoolArray, FloatArray
from observer.slopes.row_spline import RowGrid

#: Rows count by how far they are, as a Gaussian. Of waves of 1 m it leaves 0.9, of 0.5 m 0.6; from rows 20 mm apart
#: that err by 0.04 mrad, each for itself, a twist is known to 0.1 mrad/m, and to 0.35 where they err together over as
#: much: over half a panel 0.2 mrad of slopes along that are 0.5 to 1 mrad.
_ALONG_M = 0.08
#: Slopes across that are less certain are not counted. Up to 0.2 mrad of that are what slopes along may be, alike in
#: the rows around; errors of 0.3 mrad besides, each row for itself, make a twist of 0.7 mrad/m, and 0.4 mrad of slope
#: along over half a panel, of 0.5 to 1 mrad that there are [rad].
_KNOWN_RAD = 0.5e-3
#: A line is drawn through rows that scatter by this, as five rows 20 mm apart do: their own errors of 0.04 mrad make a
#: twist of 0.6 mrad/m, as much as the least certain slopes that are counted [m].
_LEAST_SCATTER_M = 0.025


def slopes_by_twist(
    across_rad: FloatArray,
    sigma_rad: FloatArray,
    measured: BoolArray,
    grid: RowGrid,
    y_m: FloatArray,
    edges_y_m: FloatArray,
) -> FloatArray:
    """Return slope errors along the trough whose mean over each row's piece of a panel is zero.

    Shapes: y_m (r,), edges_y_m (k,).
    across_rad, sigma_rad (r, nx): Slope errors across and their standard deviation [rad].
    measured (r, nx): Nodes near an edge.
    grid: Nodes, and which of them lie on one panel.
    y_m: Rows [m].
    edges_y_m: Ascending edges of the panels along the trough [m].
    Returns (r, nx): Zero where nothing is known [rad].

    The twist is the slope of a line through the rows around, of the same panel, by weighted least squares.
    """
    known = (measured & (sigma_rad < _KNOWN_RAD)).astype(np.float64)
    panel = np.searchsorted(edges_y_m, y_m)
    apart = y_m[:, None] - y_m
    weight = np.where(panel[:, None] == panel, np.exp(-0.5 * (apart / _ALONG_M) ** 2), 0.0)
    # From each row on.
    lever = -weight * apart
    count, first, second = weight @ known, lever @ known, (lever * -apart) @ known
    spread = count * second - first**2
    twist = count * (lever @ (known * across_rad)) - first * (weight @ (known * across_rad))
    enough = (known > 0) & (spread > (count * _LEAST_SCATTER_M) ** 2)
    twist = np.where(enough, twist / np.where(enough, spread, 1.0), 0.0)
    along = np.zeros(across_rad.shape)
    for begin, end in pairwise([0, *(np.flatnonzero(~grid.joined) + 1).tolist(), grid.x_m.size]):
        own, weights = twist[:, begin:end], known[:, begin:end]
        total = (np.cumsum(own, axis=1) - 0.5 * own) * grid.step_m
        mean = (weights * total).sum(axis=1, keepdims=True) / np.maximum(weights.sum(axis=1, keepdims=True), 1.0)
        along[:, begin:end] = np.where(weights.any(axis=1, keepdims=True), total - mean, 0.0)
    return along
