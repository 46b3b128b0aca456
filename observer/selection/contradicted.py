"""Edges that the others of their row contradict, however well the solution follows them.

Where an edge is the only one to speak of a place the slopes follow it wherever it is, and next to nothing is left of
it: a dark patch of ground 19 mrad beside the tube kept a residual of 0.1 mrad. What is left has the variance
``sigma^2 (1 - h)``, h the leverage; over its root it is what the edge is off from where the others alone predict it,
over the sigma of that difference (the deletion residual: Belsley, Kuh and Welsch 1980, section 2.1).
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from heliogauge.validate import BoolArray, FloatArray, IntArray
from observer.slopes.row_spline import Roughness, RowGrid, TouchingLines, assemble, nodes_of, prior_bands

#: What is left of the variance of an edge that nothing else predicts: rounding.
_LEAST_FREEDOM = 1e-9
#: Noise beside the largest variance that is added before inverting, so that digits are left of what is taken off.
_LEAST_NOISE = 1e-11
#: A value that is left out at the limit is not taken back by rounding: without end both would follow each other.
_ROUNDING = 1e-6
#: The false ones are fewer than this share of the edges of a row and panel: a cluster in the middle parts the true
#: ones in two, and either part has to be more than it.
_MOST_REFUSED = 1 / 3


class Contradicted(NamedTuple):
    """Edges that contradict others.

    refused (m,): Few, which all others of their row and panel contradict.
    undecided (m,): All of a row and panel where too many would have to be refused to tell the false ones.
    """

    refused: BoolArray
    undecided: BoolArray


def contradicted_edges(lines: TouchingLines, grid: RowGrid, roughness: Roughness, times: float) -> Contradicted:
    """Tell which edges the others of their row and panel contradict.

    lines: Edges as observations with their noise, what rows have in common taken off their misfits.
    roughness: How slopes may vary along a row.
    times: Standard deviations beyond which an edge is contradicted.

    Where one is, the fewest are refused that leave the others in agreement: chi-square of those that are kept plus
    ``times^2`` for each refused one is least. One by one, the worst first, true edges beside a cluster of false ones
    would go, each after the other: five false ones had 18 of 20 true ones refused. So what is left out is a run of
    neighbours, as long as it takes.
    """
    before, share = nodes_of(grid, lines.x_m)
    panel = np.concatenate([[0], np.cumsum(~grid.joined)])
    place = lines.row * (panel[-1] + 1) + panel[before + (share > 0.5)]
    suspect = np.abs(deletion_residuals(lines, grid, roughness)) > times
    refused, undecided = np.zeros((2, suspect.size), dtype=bool)
    prior = _prior_covariance(grid, roughness) if suspect.any() else None
    for one in np.unique(place[suspect]):
        own = np.flatnonzero(place == one)
        own = own[np.argsort(lines.x_m[own], kind="stable")]
        some = replace(lines.chosen(own), row=np.zeros(own.size, dtype=np.intp))
        by_slopes = assemble(some, RowGrid(grid.x_m, grid.joined, 1)).derivatives()
        covariance = by_slopes @ (by_slopes @ prior).T + np.eye(own.size)
        out = _fewest_refused(some.misfit_rad / some.sigma_rad, np.asarray(covariance), times)
        if np.count_nonzero(out) < _MOST_REFUSED * own.size:
            refused[own] = out
        else:
            undecided[own] = True
    return Contradicted(refused, undecided)


def _fewest_refused(values: FloatArray, covariance: FloatArray, times: float) -> BoolArray:
    """Return which values to leave out, so that chi-square of the others and ``times^2`` for each of them is least.

    Shapes: values (m,), covariance (m, m), result (m,).

    By turns the run is left out that lowers that sum most, and each value is taken back that the kept ones predict:
    the sum only falls, to a minimum. That from runs is one for clusters, that from single values for scattered ones.
    """
    precision = np.linalg.inv(covariance + _LEAST_NOISE * covariance.max() * np.eye(values.size))

    def cost(kept: BoolArray) -> float:
        chi_square = values[kept] @ _precision_of(kept, precision) @ values[kept]
        return float(chi_square + times**2 * np.count_nonzero(~kept))

    longest = max(1, int(_MOST_REFUSED * values.size))
    return ~min((_agreeing(values, precision, times, one) for one in (1, longest)), key=cost)


def _precision_of(kept: BoolArray, precision: FloatArray) -> FloatArray:
    """Return the precision of some values alone, from that of all."""
    beside = precision[np.ix_(~kept, kept)]
    return precision[np.ix_(kept, kept)] - beside.T @ np.linalg.solve(precision[np.ix_(~kept, ~kept)], beside)


def _agreeing(values: FloatArray, precision: FloatArray, times: float, longest: int) -> BoolArray:
    """Return which values agree when runs of at most so many are left out at once.

    precision (m, m): Inverse of the values' covariance.
    """
    kept, left = np.ones(values.size, dtype=bool), precision @ values
    while True:
        some = np.flatnonzero(kept)
        run = _worst_run(values[some], _precision_of(kept, precision), times, longest)
        if run.size == 0:
            return kept
        kept[some[run]] = False
        while not kept.all():
            out = np.flatnonzero(~kept)
            # What the kept ones say of these: by differences of covariances nothing would be left of the digits.
            given = np.linalg.inv(precision[np.ix_(out, out)])
            off = np.abs(given @ left[out]) / np.sqrt(np.diagonal(given))
            if off.min() >= (1 - _ROUNDING) * times:
                break
            kept[out[off.argmin()]] = True


def _worst_run(values: FloatArray, precision: FloatArray, times: float, longest: int) -> IntArray:
    """Return the numbers of neighbours whose absence lowers chi-square by most more than ``times^2`` for each, if any.

    precision (m, m): Inverse of the values' covariance.
    longest: They are at most so many.

    Leaving out K lowers it by ``l' P^-1 l``, with P the block of the precision of K, and l of precision times values;
    never by more than all of it, so that longer runs than its share of ``times^2`` gain nothing.
    """
    left = precision @ values
    chi_square = float(values @ left)
    longest = min(longest, int(chi_square / times**2))
    if longest == 0:
        return np.zeros(0, dtype=np.intp)
    if longest == 1:
        gain = left**2 / np.diagonal(precision) - times**2
        return np.flatnonzero((gain > 0) & (gain == gain.max()))[:1]
    # Beyond the last value stand independent ones of zero, of which leaving out costs and gains nothing.
    size, end = values.size, values.size + longest
    whole, ends = np.eye(end), np.zeros(end)
    whole[:size, :size], ends[:size] = precision, left
    window = np.arange(size)[:, None] + np.arange(longest)
    # Below each block stands l: the last row of the root is then what solving it for l would give.
    blocks = np.zeros((size, longest + 1, longest + 1))
    blocks[:, :longest, :longest] = whole[window[:, :, None], window[:, None, :]]
    blocks[:, longest, :longest], blocks[:, longest, longest] = ends[window], chi_square + 1.0
    gains = np.cumsum(np.square(np.linalg.cholesky(blocks)[:, longest, :longest]) - times**2, axis=1)
    first, last = np.unravel_index(int(gains.argmax()), gains.shape)
    return np.arange(first, first + last + 1) if gains[first, last] > 0 else np.zeros(0, dtype=np.intp)


def _prior_covariance(grid: RowGrid, roughness: Roughness) -> FloatArray:
    """Return the covariance of the slopes of a row before any edge, in the order (s_x, s_y) of its nodes [rad^2]."""
    bands, n = prior_bands(grid, roughness), grid.x_m.size
    covariance = np.zeros((n, 2, n, 2))
    for way in range(2):
        precision = sum(np.diag(band[: n - reach, way], -reach) for reach, band in enumerate(bands))
        covariance[:, way, :, way] = np.linalg.inv(precision + np.tril(precision, -1).T)
    return covariance.reshape(2 * n, 2 * n)


def deletion_residuals(lines: TouchingLines, grid: RowGrid, roughness: Roughness) -> FloatArray:
    """Return how far each line is from what the others of its row predict, over the sigma of that, shape (m,).

    lines: Observations without common unknowns.
    """
    rows = assemble(lines, grid)
    factor = rows.under(roughness).factor
    values = lines.misfit_rad / lines.sigma_rad
    slopes = factor.solve(rows.right_sides(-values)).reshape(-1)
    left = values + (rows.weights * slopes[rows.place[:, None] + np.arange(4)]).sum(axis=1)
    inverse = factor.inverse_bands().reshape(-1, factor.root.shape[2])
    leverage = np.zeros(lines.row.size)
    for i in range(4):
        for j in range(i, 4):
            times = 1.0 if i == j else 2.0
            leverage += times * rows.weights[:, i] * rows.weights[:, j] * inverse[rows.place + i, j - i]
    return np.asarray(left / np.sqrt(np.maximum(1 - leverage, _LEAST_FREEDOM)))
