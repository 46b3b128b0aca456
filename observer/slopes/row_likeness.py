"""How far along the trough a mirror's slopes are alike, so that sums over rows do not average out what rows share.

Each row of the map is solved alone. What it errs between its edges follows from the mirror there, and waves that run
along the trough make the same error in all rows: with photos 0.4 m apart it kept its sign over a panel's whole length.
"""

from itertools import pairwise

import numpy as np

from heliogauge.validate import BoolArray, FloatArray
from observer.slopes.row_spline import RowGrid

#: Fewer pairs of nodes do not determine a correlation.
_FEWEST_PAIRS = 200
#: Lengths that are tried, in all rows' extent, and how many: beyond the longest all rows are one.
_LONGEST, _LENGTHS = 30.0, 60
#: Share of the rows' extent up to which the correlation is read; means and bends are taken off over all of it.
_READ_SHARE = 0.5


def row_likeness(slope_rad: FloatArray, good: BoolArray, grid: RowGrid, y_m: FloatArray) -> FloatArray:
    """Estimate the correlation between the rows' slope errors.

    Shapes: y_m (r,).
    slope_rad (r, nx): Slope error across the trough [rad].
    good (r, nx): Nodes that were measured.
    grid: Nodes, and which of them lie on one panel.
    Returns (r, r): ``exp(-distance / length)``; rows are alike entirely where too little was measured to estimate the
        length.

    Autocovariance along the columns, the mean and the bend of each row's piece of panel taken off: they are measured
    well, and neither is what lies between edges. Noise and other errors that rows have apart lower the correlation at
    all distances but zero by the same factor, which is fitted along with the length.
    """
    n_rows = y_m.size
    if n_rows < 2:
        return np.ones((n_rows, n_rows))
    distance = np.abs(y_m[:, None] - y_m)
    left = _beside_lines(np.where(good, slope_rad, 0.0), good, grid)
    lags = np.arange(1, max(2, int(_READ_SHARE * n_rows)))
    pairs = np.array([np.count_nonzero(good[k:] & good[:-k]) for k in lags])
    lags, pairs = lags[pairs >= _FEWEST_PAIRS], pairs[pairs >= _FEWEST_PAIRS]
    if lags.size < 2:
        return np.ones((n_rows, n_rows))
    shared = np.array([np.sum(left[k:] * left[:-k]) for k in lags]) / pairs
    lag_m = lags * float(y_m[1] - y_m[0])
    lengths = np.geomspace(lag_m[0], _LONGEST * float(np.ptp(y_m)), _LENGTHS)
    shapes = np.exp(-lag_m / lengths[:, None])
    # The best amplitude of each length, and what it explains.
    explained = np.maximum(shapes @ (pairs * shared), 0.0) ** 2 / (shapes**2 @ pairs)
    return np.asarray(np.exp(-distance / lengths[int(np.argmax(explained))]))


def likeness_along(y_m: FloatArray, length_m: float) -> FloatArray:
    """Return the correlation between the rows' slopes along the trough, shape (r, r).

    y_m (r,): Rows [m].
    length_m: Length over which such slopes are alike across the trough [m].

    Edges do not tell it: single rows hardly show such slopes. In a sheet that has no direction they are alike over the
    same length along as across, in panels from one mould in all rows: the mean of both, which are equally probable.
    Taken for as alike as slopes across, whose waves ran along the trough in simulated mirrors, they made what rows
    differ by too sure: (error / sigma)^2 whitened together was 4.0 where theirs ran in all directions.
    """
    return np.asarray(0.5 * (1 + np.exp(-np.abs(y_m[:, None] - y_m) / length_m)))


def _beside_lines(slope_rad: FloatArray, good: BoolArray, grid: RowGrid) -> FloatArray:
    """Take the straight line off each row's piece of each panel; zero where nothing was measured."""
    left = np.zeros(slope_rad.shape)
    borders = np.concatenate([[0], np.flatnonzero(~grid.joined) + 1, [grid.x_m.size]])
    for first, last in pairwise(borders):
        own, x = good[:, first:last].astype(np.float64), grid.x_m[first:last]
        count = np.maximum(own.sum(axis=1, keepdims=True), 1.0)
        beside = own * (x - (own @ x)[:, None] / count)
        value = own * (slope_rad[:, first:last] - (own * slope_rad[:, first:last]).sum(axis=1, keepdims=True) / count)
        bend = (beside * value).sum(axis=1, keepdims=True) / np.maximum((beside**2).sum(axis=1, keepdims=True), 1e-12)
        left[:, first:last] = value - bend * beside
    return left
