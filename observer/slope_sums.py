"""How well weighted sums of slopes are known: with the noise that neighbours share and with what all rows share."""

import numpy as np

from heliogauge.validate import FloatArray
from observer.slope_field import Roughness, RowGrid, TouchingLines, assemble, to_blocks

#: Sums that are carried through the rows at once; ten take 16 MB for 400 rows of 250 nodes.
_AT_ONCE = 10


def covariance_of_sums(
    lines: TouchingLines, grid: RowGrid, prior: Roughness, covariance_common: FloatArray, weights: FloatArray
) -> FloatArray:
    """Return the covariance of weighted sums of the slopes across.

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
    weights : ndarray, shape (k, r, nx)
        Weight of each node's slope across in each sum.

    Returns
    -------
    ndarray, shape (k, k)
        Covariance of the k sums [rad^2].

    Notes
    -----
    With the normal matrix A of the slopes, their coupling C to the common unknowns and the covariance S of these, the
    covariance of all slopes is ``A^-1 + A^-1 C S C^T A^-1``; a sum needs one solution with A, not its inverse.
    """
    system = assemble(lines, grid, prior)
    count, n_common = len(weights), len(covariance_common)
    weight = lines.sigma_rad**-2
    own = np.empty((count, count))
    shared = np.zeros((count, n_common))
    nodes = np.stack([weights, np.zeros_like(weights)], axis=-1)
    for first in range(0, count, _AT_ONCE):
        some = slice(first, min(first + _AT_ONCE, count))
        right = np.concatenate([to_blocks(one) for one in nodes[some]], axis=3)
        solved = system.factor.solve(right)
        # (b, r, 4, k) to (k, r, nx, 2)
        slopes = np.moveaxis(solved, 3, 0).swapaxes(1, 2).reshape(-1, grid.n_rows, grid.x_m.size, 2)
        own[:, some] = np.tensordot(weights, slopes[..., 0], axes=((1, 2), (1, 2)))
        for k, one in enumerate(slopes, start=first):
            beside = np.concatenate([one[lines.row, system.before], one[lines.row, system.before + 1]], axis=1)
            seen = weight * np.einsum("mi,mi->m", system.weights, beside)
            for i in range(lines.common_index.shape[1]):
                shared[k] += np.bincount(lines.common_index[:, i], seen * lines.d_common[:, i], n_common)
    return np.asarray(0.5 * (own + own.T) + shared @ covariance_common @ shared.T)
