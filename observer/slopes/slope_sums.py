"""How well weighted sums of slopes are known: with what neighbours and what all rows share."""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from heliogauge.flags import SampleFlag
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import BoolArray, FloatArray, IntArray
from observer.slopes.banded_cholesky import BandedFactor
from observer.slopes.common_elimination import derivatives_of
from observer.slopes.row_spline import Roughness, RowGrid, RowSystem, TouchingLines, assemble

if TYPE_CHECKING:
    from scipy.sparse import csr_array

#: Sums that are solved for at once; ten take 16 MB for 400 rows of 250 nodes.
_AT_ONCE = 10
#: Panels that suffice to estimate how much neighbouring nodes err together.
_PANELS = 10


class SlopeSums:
    """How well weighted sums of the slopes across are known; the rows are factorised when they are first asked.

    lines: The observations that the slopes came from.
    prior: How slopes may vary.
    covariance_common (c, c): Covariance of the common unknowns, the slopes eliminated.
    free (c,): Those of them that are not held; by default all.
    alike (r, r): Correlation between the slope errors of the rows' mirror across (`observer.slopes.row_likeness`); by
        default none, which lets what lies between edges average out over rows.
    alike_along (r, r): The same of those along the trough.

    With the normal matrix A of the slopes, their coupling C to the common unknowns and the covariance S of these, the
    covariance of all slopes is ``A^-1 + A^-1 C S C^T A^-1``; a sum needs one solution with A, not its inverse.

    Rows are solved as if nothing were known of one from the next. What a row errs is ``-A^-1 Q s`` from its own
    slopes s, which have the prior precision Q, and what noise makes. Slopes that two rows share to the correlation R
    share the former: to the covariance ``A^-1`` of a row ``(R - 1) A^-1 Q A^-1`` is added between rows. Exact where
    the prior is the mirror's and the correlation is the same at all places of a row.
    """

    def __init__(
        self,
        lines: TouchingLines,
        grid: RowGrid,
        prior: Roughness,
        covariance_common: FloatArray,
        free: BoolArray | None = None,
        *,
        alike: FloatArray | None = None,
        alike_along: FloatArray | None = None,
    ) -> None:
        self._lines, self._grid, self._prior = lines, grid, prior
        self._covariance, self._free = covariance_common, free
        # Across, then along, as the unknowns of a node stand.
        self._others = [None if one is None else one - np.eye(grid.n_rows) for one in (alike, alike_along)]

    def __call__(self, weights: FloatArray) -> FloatArray:
        """Return the covariance of sums.

        weights (k, r, nx): Weights of all nodes' slopes in k sums.
        Returns (k, k): Covariance [rad^2].
        """
        solved, own = self._solved(weights)
        by_slopes, by_common = self._derivatives
        shared = np.empty((len(weights), len(self._covariance)))
        for first in range(0, len(weights), _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            shared[some] = (by_common.T @ (by_slopes @ solved[some].reshape(len(solved[some]), -1).T)).T
        if self._free is not None:
            shared *= self._free
        return np.asarray(own + shared @ self._covariance @ shared.T)

    def without_common(self, weights: FloatArray) -> FloatArray:
        """Return the same with the common unknowns held, shape (k, k) [rad^2]."""
        return self._solved(weights)[1]

    @cached_property
    def _system(self) -> RowSystem:
        return assemble(self._lines, self._grid).under(self._prior)

    @cached_property
    def _derivatives(self) -> "tuple[csr_array, csr_array]":
        rows = assemble(self._lines, self._grid)
        return rows.derivatives(), derivatives_of(self._lines, len(self._covariance))

    def _solved(self, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the solutions of sums, shape (k, r, 2 nx), and their covariance with the common unknowns held.

        Rows in which a sum has no weights are left out: a panel is a fifth of the mirror.
        """
        count, root = len(weights), self._system.factor.root
        solved = np.zeros((count, self._grid.n_rows, 2 * self._grid.x_m.size))
        spans = [_span(one) for one in np.asarray(weights.any(axis=2))]
        for first, last in sorted(set(spans) - {(0, 0)}):
            numbers = [k for k, span in enumerate(spans) if span == (first, last)]
            for start in range(0, len(numbers), _AT_ONCE):
                some = numbers[start : start + _AT_ONCE]
                nodes = np.zeros((len(some), last - first, 2 * self._grid.x_m.size))
                nodes[..., 0::2] = weights[some, first:last]
                solved[some, first:last] = BandedFactor(root[first:last]).solve(nodes)
        own = weights.reshape(count, -1) @ solved[..., 0::2].reshape(count, -1).T
        if any(one is not None for one in self._others):
            flat = solved.reshape(count, -1)
            pulled = np.zeros((min(count, _AT_ONCE), *solved.shape[1:]))
            for start in range(0, count, _AT_ONCE):
                part, bands = spans[start : start + _AT_ONCE], self._system.bands
                for place, (first, last) in enumerate(part):
                    single = _pulled(solved[start + place, first:last], bands)
                    for component, others in enumerate(self._others):
                        if others is not None:
                            pulled[place, :, component::2] = others[:, first:last] @ single[:, component::2]
                # Ten at once: all solutions together are larger than the processor's cache.
                own[:, start : start + len(part)] += flat @ pulled[: len(part)].reshape(len(part), -1).T
        return solved, np.asarray(0.5 * (own + own.T))


class AveragedSums:
    """The same for slopes that are the mean over several models of how they may vary.

    each: Of the models.
    probability (k,): How probable these are.
    apart_rad (k, r, nx): What the slopes are under each, less their mean [rad].
    """

    def __init__(self, each: Sequence[SlopeSums], probability: FloatArray, apart_rad: FloatArray) -> None:
        self._each, self._probability, self._apart = each, probability, apart_rad

    def __call__(self, weights: FloatArray) -> FloatArray:
        """Return the covariance of sums.

        weights (k, r, nx): Weights of all nodes' slopes in k sums.
        Returns (k, k): Covariance [rad^2].
        """
        return self._mean([one(weights) for one in self._each], weights)

    def without_common(self, weights: FloatArray) -> FloatArray:
        """Return the same with the common unknowns held, shape (k, k) [rad^2]."""
        return self._mean([one.without_common(weights) for one in self._each], weights)

    def _mean(self, covariances: Sequence[FloatArray], weights: FloatArray) -> FloatArray:
        apart = weights.reshape(len(weights), -1) @ self._apart.reshape(len(self._apart), -1).T
        within = np.tensordot(self._probability, np.stack(covariances), axes=1)
        return np.asarray(within + (apart * self._probability) @ apart.T)


def _span(has_weight: BoolArray) -> tuple[int, int]:
    """Return the first row that has a weight and the one after the last."""
    rows = np.flatnonzero(has_weight)
    return (int(rows[0]), int(rows[-1]) + 1) if rows.size else (0, 0)


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

    covariance: Of weighted sums of the slopes without their common share (`SlopeSums.without_common`).
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

    covariance: Of weighted sums of the slopes (`SlopeSums`).
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

    place = (rows * own.shape[1] + np.arange(own.shape[1])).reshape(-1)

    def of_map(weights: FloatArray) -> FloatArray:
        moved = [np.bincount(place, one.reshape(-1), place.size) for one in weights]
        return covariance(np.reshape(moved, weights.shape))

    return of_map
