"""How well weighted sums of slopes are known: with the noise that neighbours share and with what all rows share."""

from collections.abc import Callable

import numpy as np

from heliogauge.flags import SampleFlag
from heliogauge.slope_map import SlopeMap
from heliogauge.validate import BoolArray, FloatArray
from observer.reduction import derivatives_of
from observer.slope_field import Roughness, RowGrid, TouchingLines, assemble

#: Sums that are carried through the rows at once; ten take 16 MB for 400 rows of 250 nodes.
_AT_ONCE = 10


def sum_covariance(
    lines: TouchingLines, grid: RowGrid, prior: Roughness, covariance_common: FloatArray, free: BoolArray | None = None
) -> Callable[[FloatArray], FloatArray]:
    """Return a function for the covariance of weighted sums of the slopes across; the rows are factorised once.

    Parameters
    ----------
    lines : TouchingLines
        The observations that the slopes came from.
    grid : RowGrid
        Nodes.
    prior : Roughness
        How slopes may vary.
    covariance_common : ndarray, shape (c, c)
        Covariance of the common unknowns, the slopes eliminated.
    free : ndarray of bool, shape (c,), optional
        Those of them that are not held; by default all.

    Returns
    -------
    callable
        From weights of all nodes' slopes in k sums, shape (k, r, nx), to the covariance of the sums, shape (k, k).

    Notes
    -----
    With the normal matrix A of the slopes, their coupling C to the common unknowns and the covariance S of these, the
    covariance of all slopes is ``A^-1 + A^-1 C S C^T A^-1``; a sum needs one solution with A, not its inverse.
    """
    rows = assemble(lines, grid)
    system = rows.under(prior)
    by_slopes, by_common = rows.derivatives(), derivatives_of(lines, len(covariance_common))

    def covariance(weights: FloatArray) -> FloatArray:
        count = len(weights)
        own, shared = np.empty((count, count)), np.empty((count, len(covariance_common)))
        nodes = np.stack([weights, np.zeros_like(weights)], axis=-1)
        for first in range(0, count, _AT_ONCE):
            some = slice(first, min(first + _AT_ONCE, count))
            solved = system.factor.solve(nodes[some].reshape(-1, grid.n_rows, 2 * grid.x_m.size))
            own[:, some] = np.tensordot(weights, solved[..., 0::2], axes=((1, 2), (1, 2)))
            shared[some] = (by_common.T @ (by_slopes @ solved.reshape(len(solved), -1).T)).T
        if free is not None:
            shared *= free
        return np.asarray(0.5 * (own + own.T) + shared @ covariance_common @ shared.T)

    return covariance


def with_bridged(
    covariance: Callable[[FloatArray], FloatArray], slope_map: SlopeMap
) -> Callable[[FloatArray], FloatArray]:
    """Let values that were bridged along the trough err as the nearest of their column that were not.

    Parameters
    ----------
    covariance : callable
        Of weighted sums of the slopes, from `sum_covariance`.
    slope_map : SlopeMap
        The mirror; its flags name the nodes that were bridged.

    Returns
    -------
    callable
        The same for sums over this map.

    Notes
    -----
    The solution of a bridged node's own row is the prior there, some milliradians, which the value in the map is not:
    5 % of such nodes made the sigma of an intercept factor twelve times as large as what is told by cameras and edges.
    """
    bridged = (slope_map.flags & np.uint32(SampleFlag.SMOOTHED_GAP)) > 0
    own = slope_map.valid & ~bridged
    rows = np.tile(np.arange(own.shape[0])[:, None], (1, own.shape[1]))
    for column in np.flatnonzero(bridged.any(axis=0) & own.any(axis=0)):
        have, lack = np.flatnonzero(own[:, column]), np.flatnonzero(bridged[:, column])
        rows[lack, column] = have[np.abs(lack[:, None] - have).argmin(axis=1)]
    columns = np.broadcast_to(np.arange(own.shape[1]), own.shape)

    def of_map(weights: FloatArray) -> FloatArray:
        moved = np.zeros_like(weights)
        for given, to in zip(weights, moved, strict=True):
            np.add.at(to, (rows, columns), given)
        return covariance(moved)

    return of_map
