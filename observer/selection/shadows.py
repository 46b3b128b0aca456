"""Which edges stay where shadows and things on the ground are in the reflection, some as dark as the tube.

Each point of the mirror is passed by both edges of the tube's reflection, in different photos. What has one edge of its
own, such as the collector's shadow, contradicts the tube's other edge or is the only one to speak of a place. And an
edge that a shadow beside it has pulled away contradicts its neighbours along its whole curve, row after row by the same
sign, although by little in each.
"""

from dataclasses import replace

import cv2
import numpy as np

from heliogauge.validate import BoolArray, FloatArray, IntArray
from observer.slopes.joint_solution import solve_jointly
from observer.slopes.row_spline import Roughness, RowGrid, TouchingLines, nodes_of

#: An edge counts where those of the other side know the slope at its place better than this [rad]; at 0.5 mrad photos
#: 0.2 m apart would confirm next to nothing.
_SUPPORT_RAD = 1e-3
#: Both sides contradict each other beyond so many standard deviations of their difference, and beyond this [rad].
_CONTRADICT_TIMES, _SMALLEST_RAD = 4.0, 5e-4
#: Edges of one curve are taken together with this many before and after.
_CURVE_ROWS = 5
#: Where all of them are off by more standard deviations than this on the mean, they are not the tube's: 2 to 4 % of the
#: tube's own are, where the mirror bends more than elsewhere; those beside shadows by 4 to 13.
_CURVE_TIMES = 3.0
#: Edges that are left out leave others alone; after so many rounds next to none do.
_ROUNDS = 4


def confirmed_edges(
    lines: TouchingLines, side: FloatArray, grid: RowGrid, roughness: Roughness
) -> tuple[BoolArray, BoolArray]:
    """Return which edges agree with those of the tube's other side.

    lines: Edges as observations with their noise, what rows have in common taken off their misfits.
    side (m,): +1 or -1 for each.
    roughness: How slopes may vary.
    Returns (m,): Edges at whose place both sides know the slope and agree.
    Returns (r, nx): Nodes of which that holds.
    """
    before, share = nodes_of(grid, lines.x_m)
    nearest = before + (share > 0.5)
    kept = np.ones(side.size, dtype=bool)
    shape = (grid.n_rows, grid.x_m.size)
    agrees = np.zeros(shape, dtype=bool)
    slope, variance = (np.zeros(shape), np.zeros(shape)), (np.full(shape, np.inf), np.full(shape, np.inf))
    # Rows know nothing of each other: only those that have lost an edge are solved again.
    fresh = np.ones(side.size, dtype=bool)
    for _ in range(_ROUNDS):
        for way, s, v in zip((1.0, -1.0), slope, variance, strict=True):
            _update_one_side(lines, kept & (side == way), fresh & (side == way), (s, v), grid, roughness)
        known = (variance[0] < _SUPPORT_RAD**2) & (variance[1] < _SUPPORT_RAD**2)
        allowed = np.maximum(_CONTRADICT_TIMES * np.sqrt(variance[0] + variance[1]), _SMALLEST_RAD)
        agrees = known & (np.abs(slope[0] - slope[1]) < allowed)
        left = kept & agrees[lines.row, nearest]
        if np.array_equal(left, kept):
            break
        fresh = kept & ~left
        kept = left
    return kept, np.asarray(agrees)


def _update_one_side(
    lines: TouchingLines,
    some: BoolArray,
    changed: BoolArray,
    found: tuple[FloatArray, FloatArray],
    grid: RowGrid,
    roughness: Roughness,
) -> None:
    """Find the slope across at all nodes from the edges of one side, and its variance, in rows that have changed.

    some, changed (m,): Edges of this side, and those that have come or gone.
    found: Slopes and variances so far, shape (r, nx) each; changed in place, infinite variance in rows without edges.
    """
    slope, variance = found
    moved = np.bincount(lines.row[changed], minlength=grid.n_rows) > 0
    has_edges = np.bincount(lines.row[some], minlength=grid.n_rows) > 0
    variance[moved & ~has_edges] = np.inf
    rows = np.flatnonzero(moved & has_edges)
    if rows.size == 0:
        return
    number = np.full(grid.n_rows, -1)
    number[rows] = np.arange(rows.size)
    own = lines.chosen(some & (number[lines.row] >= 0))
    own = replace(own, row=number[own.row])
    fewer = RowGrid(grid.x_m, grid.joined, rows.size)
    solved = solve_jointly(own, fewer, roughness, np.zeros((0, 0)), with_shares=None)
    slope[rows], variance[rows] = solved.slopes[..., 0], solved.random[..., 0, 0]


def pulled_curves(curve: IntArray, row: IntArray, normalised: FloatArray, n_rows: int) -> BoolArray:
    """Return which edges are off by the same sign together with those before and after on their curve.

    Shapes: row (m,), result (m,).
    curve (m,): Number of the curve: one for each photo and side.
    normalised (m,): Residual of each over the standard deviation that it has where the other edges alone predict
        it.
    """
    if curve.size == 0:
        return np.zeros(0, dtype=bool)
    shape = (int(curve.max()) + 1, n_rows)
    place = curve * n_rows + row
    window = np.ones(2 * _CURVE_ROWS + 1)
    total, count = (
        cv2.filter2D(
            np.bincount(place, values, shape[0] * n_rows).reshape(shape),
            -1,
            window[None],
            borderType=cv2.BORDER_CONSTANT,
        )
        for values in (normalised, np.ones(normalised.size))
    )
    return np.asarray(np.abs(total / np.maximum(count, 1.0))[curve, row] > _CURVE_TIMES)
