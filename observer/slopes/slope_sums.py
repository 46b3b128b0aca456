"""How well weighted sums of slopes are known: with what neighbours and what all rows share."""

from collections.abc import Callable

import numpy as np

from heliogauge.flags import SampleFlag
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import BoolArray, FloatArray, IntArray
from observer.slopes.common_elimination import derivatives_of
from observer.slopes.row_spline import Roughness, RowGrid, TouchingLines, assemble

#: Sums that are solved for at once; ten take 16 MB for 400 rows of 250 nodes.
_AT_ONCE = 10
#: Panels that suffice to estimate how much neighbouring nodes err together.
_PANELS = 10


def sum_covariance(
    lines: TouchingLines,
    grid: RowGrid,
    prior: Roughness,
    covariance_common: FloatArray,
    free: BoolArray | None = None,
    *,
    alike: FloatArray | None = None,
) -> Callable[[FloatArray], FloatArray]:
    """Return a function for the covariance of weighted sums of the slopes across; the rows are factorised once.

    lines: The observations that the slopes came from.
    prior: How slopes may vary.
    covariance_common (c, c): Covariance of the common unknowns, the slopes eliminated.
    free (c,): Those of them that are not held; by default all.
    alike (r, r): Correlation between the slope errors of the rows' mirror (`observer.slopes.row_likeness`); by
        default none, which lets what lies between edges average out over rows.
    Returns: From weights of all nodes' slopes in k sums, shape (k, r, nx), to the covariance of the sums, shape (k,
        k).

    With the normal matrix A of the slopes, their coupling C to the common unknowns and the covariance S of these, the
    covariance of all slopes is ``A^-1 + A^-1 C S C^T A^-1``; a sum needs one solution with A, not its inverse.

    Rows are solved as if nothing were known of one from the next. What a row errs is ``-A^-1 Q s`` from its own
    slopes s, which have the prior precision Q, and what noise makes. Slopes that two rows share to the correlation R
    share the former: to the covariance ``A^-1`` of a row ``(R - 1) A^-1 Q A^-1`` is added between rows. Exact where
    the prior is the mirror's and the correlation is the same at all places of a row.
    """
    rows = assemble(lines, grid)
    system = rows.under(prior)
    others = None if alike is None else alike - np.eye(grid.n_rows)
    by_slopes, by_common = rows.derivatives(), derivatives_of(lines, len(covariance_common))

    def covariance(weights: FloatArray) -> FloatArray:
        count = len(weights)
        own, shared = np.empty((count, count)), np.empty((count, len(covariance_common)))
        solved = np.empty((count, grid.n_rows, 2 * grid.x_m.size))
        for first in range(0, count, _AT_ONCE):
            some = slice(first, min(first + _AT_ONCE, count))
            nodes = np.stack([weights[some], np.zeros_like(weights[some])], axis=-1)
            solved[some] = system.factor.solve(nodes.reshape(-1, grid.n_rows, 2 * grid.x_m.size))
            own[:, some] = np.tensordot(weights, solved[some, :, 0::2], axes=((1, 2), (1, 2)))
            shared[some] = (by_common.T @ (by_slopes @ solved[some].reshape(some.stop - first, -1).T)).T
        if others is not None:
            for first in range(0, count, _AT_ONCE):
                some = slice(first, first + _AT_ONCE)
                # One after the other: a sum's slopes stay in the processor's cache.
                pulled = np.stack([_pulled(others @ one, system.bands) for one in solved[some]])
                own[:, some] += solved.reshape(count, -1) @ pulled.reshape(len(pulled), -1).T
        if free is not None:
            shared *= free
        return np.asarray(0.5 * (own + own.T) + shared @ covariance_common @ shared.T)

    return covariance


def _pulled(slopes: FloatArray, bands: FloatArray) -> FloatArray:
    """Multiply slopes, shape (r, 2 nx), by the prior's precision of one row, given by its bands (`prior_bands`)."""
    pulled = np.asarray(slopes * bands[0].reshape(-1))
    for reach in range(1, len(bands)):
        far = 2 * reach
        band = bands[reach].reshape(-1)[:-far]
        pulled[:, :-far] += band * slopes[:, far:]
        pulled[:, far:] += band * slopes[:, :-far]
    return pulled


def noise_correlation(covariance: Callable[[FloatArray], FloatArray], slope_map: SlopeMap, panel: IntArray) -> float:
    """Return by how much sums over panels vary more than if the nodes of the map were independent.

    covariance: Of weighted sums of the slopes without their common share, from `sum_covariance`.
    panel (r, nx): Panel of each node, -1 for none.
    Returns: What `SlopeMap.noise_correlation` is: the median over means and bends of some panels, at least 1.
    """
    x = np.broadcast_to(slope_map.x_m, panel.shape)
    number, count = np.unique(panel[slope_map.valid & (panel >= 0)], return_counts=True)
    number = number[2 * count >= count.max(initial=0)]
    weights = []
    for one in number[np.unique(np.linspace(0, number.size - 1, min(number.size, _PANELS)).round().astype(np.intp))]:
        own = (panel == one) & slope_map.valid
        beside = np.where(own, x - x[own].mean(), 0.0)
        # In units of what independent nodes would give, so that sums and their covariance are about one.
        weights += [shape / np.linalg.norm((shape * slope_map.sigma_random_x)[own]) for shape in (1.0 * own, beside)]
    if not weights:
        return 1.0
    return max(1.0, float(np.median(np.diagonal(with_bridged(covariance, slope_map)(np.stack(weights))))))


def with_bridged(
    covariance: Callable[[FloatArray], FloatArray], slope_map: SlopeMap
) -> Callable[[FloatArray], FloatArray]:
    """Let values that were bridged along the trough err as the nearest of their column that were not.

    covariance: Of weighted sums of the slopes, from `sum_covariance`.
    slope_map: The mirror; its flags name the nodes that were bridged.
    Returns: The same for sums over this map.

    The solution of a bridged node's own row is the prior there, some milliradians, which the value in the map is not:
    5 % of such nodes made the sigma of an intercept factor twelve times as large as what comes from cameras and
    edges.
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
