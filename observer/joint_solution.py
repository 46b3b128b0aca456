"""Slopes of all rows together with what they have in common: camera positions, absorber and its radius."""

from dataclasses import dataclass, replace

import numpy as np

from heliogauge.validate import FloatArray
from observer.slope_field import (
    IntArray,
    Roughness,
    RowGrid,
    RowSystem,
    TouchingLines,
    assemble,
    from_blocks,
    prior_pull,
    right_sides,
)

#: Rows that suffice to estimate the common unknowns; with all of them the solution would cost as much as all else.
_ROWS_FOR_COMMON = 48
#: Rows that suffice to choose the roughness: it is one number, and each row has some hundred lines.
_ROWS_FOR_ROUGHNESS = 16
#: Combinations of common unknowns that are kept as modes of the whole map, and the share of the variance they have.
_MODES = 10
_MODES_SHARE = 0.99
#: Decimal exponents of the roughness [rad^2 / m^3] that are searched: from a mirror that bends by 0.1 mrad within a
#: metre to a crumpled one.
_EXPONENTS = (-8.0, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class SlopeErrors:
    """Solution for the rows and for what they share.

    Parameters
    ----------
    slopes : ndarray, shape (r, nx, 2)
        Errors of dz/dx and dz/dy of the mirror at the nodes [rad].
    random : ndarray, shape (r, nx, 2, 2)
        Covariance of both at each node from noise and from what lies between samples [rad^2].
    shared : ndarray, shape (r, nx, 2)
        Variance from the common unknowns [rad^2].
    common : ndarray, shape (c,)
        Estimates of the common unknowns.
    covariance_common : ndarray, shape (c, c)
        Their covariance.
    mode_rows : ndarray of int, shape (s,)
        Rows at which the modes are given.
    modes : ndarray, shape (k, s, nx)
        Change of dz/dx for one standard deviation of each of the strongest independent combinations of the common
        unknowns [rad].
    """

    slopes: FloatArray
    random: FloatArray
    shared: FloatArray
    common: FloatArray
    covariance_common: FloatArray
    mode_rows: IntArray
    modes: FloatArray


def find_roughness(lines: TouchingLines, grid: RowGrid, prior: Roughness, covariance: FloatArray) -> Roughness:
    """Choose the roughness across the trough under which the lines are most probable.

    Parameters
    ----------
    lines : TouchingLines
        Observations, misfits with zero slope error and zero common unknowns.
    grid : RowGrid
        Nodes.
    prior : Roughness
        The slope along the trough, which is kept.
    covariance : ndarray, shape (c, c)
        Prior covariance of the common unknowns.

    Returns
    -------
    Roughness
        With the most probable roughness, to a quarter of a decade.

    Notes
    -----
    Marginal likelihood with slopes and common unknowns integrated out, on a sample of the rows, by bisection of its
    slope over the logarithm of the roughness.
    """
    rows = sample_rows(grid, _ROWS_FOR_ROUGHNESS)
    some, fewer = _sampled(lines, grid, rows)
    known: dict[float, float] = {}

    def evidence(exponent: float) -> float:
        if exponent not in known:
            trial = Roughness(10.0**exponent, prior.along_rad, prior.along_length_m)
            still = np.zeros((fewer.n_rows, grid.x_m.size, 2))
            known[exponent] = _eliminate(some, fewer, trial, still, (np.zeros(len(covariance)), covariance)).evidence
        return known[exponent]

    low, high = _EXPONENTS
    while high - low > 0.5:
        middle = 0.5 * (low + high)
        if evidence(middle + 0.125) > evidence(middle - 0.125):
            low = middle
        else:
            high = middle
    return Roughness(10.0 ** (0.5 * (low + high)), prior.along_rad, prior.along_length_m)


def solve_jointly(
    lines: TouchingLines, grid: RowGrid, prior: Roughness, start: FloatArray, common: tuple[FloatArray, FloatArray]
) -> SlopeErrors:
    """Solve for slopes and common unknowns by one Gauss-Newton step, which is exact for linear observations.

    Parameters
    ----------
    lines : TouchingLines
        Observations, linearised at the start.
    grid : RowGrid
        Nodes.
    prior : Roughness
        How slopes may vary.
    start : ndarray, shape (r, nx, 2)
        Slope errors where the lines were linearised [rad].
    common : (ndarray, ndarray), shapes (c,) and (c, c)
        Values of the common unknowns where the lines were linearised, and their prior covariance about zero.

    Returns
    -------
    SlopeErrors
        The solution.
    """
    rows = sample_rows(grid, _ROWS_FOR_COMMON)
    shared = _eliminate(*_sampled(lines, grid, rows), prior, start[rows], common)
    step = shared.step
    system = assemble(lines, grid, prior)
    moved = lines.misfit_rad + np.einsum("mc,mc->m", lines.d_common, step[lines.common_index])
    right = right_sides(system, lines, grid, -moved) - prior_pull(system.bands, start)
    slopes = start + from_blocks(system.factor.solve(right)[..., 0])
    blocks = system.factor.inverse_blocks()
    n_blocks, n_rows = blocks.shape[:2]
    random = np.empty((n_rows, 2 * n_blocks, 2, 2))
    random[:, 0::2] = np.swapaxes(blocks[..., :2, :2], 0, 1)
    random[:, 1::2] = np.swapaxes(blocks[..., 2:, 2:], 0, 1)
    between = _between_rows(shared.variance(), rows, grid.n_rows)
    return SlopeErrors(slopes, random, between, common[0] + step, shared.covariance, rows, shared.modes())


def sample_rows(grid: RowGrid, most: int) -> IntArray:
    """Return rows spread over the mirror, shape (s,).

    Parameters
    ----------
    grid : RowGrid
        All rows.
    most : int
        How many at most.

    Returns
    -------
    ndarray of int, shape (s,)
        Ascending numbers of rows.
    """
    return np.unique(np.linspace(0, grid.n_rows - 1, min(grid.n_rows, most)).round().astype(np.intp))


def _sampled(lines: TouchingLines, grid: RowGrid, rows: IntArray) -> tuple[TouchingLines, RowGrid]:
    """Keep some rows, numbered anew."""
    number = np.full(grid.n_rows, -1)
    number[rows] = np.arange(rows.size)
    some = lines.chosen(number[lines.row] >= 0)
    return replace(some, row=number[some.row]), RowGrid(grid.x_m, grid.joined, rows.size)


@dataclass(frozen=True, slots=True, eq=False)
class _Eliminated:
    """What remains after the slopes are eliminated: the common unknowns."""

    step: FloatArray
    covariance: FloatArray
    carried: FloatArray
    evidence: float

    def variance(self) -> FloatArray:
        """Return the variance that the slopes have from the common unknowns, shape (r, nx, 2)."""
        flat = self.carried.reshape(-1, len(self.covariance))
        sums = np.einsum("kc,kc->k", flat @ self.covariance, flat)
        return from_blocks(sums.reshape(self.carried.shape[:3]))

    def modes(self) -> FloatArray:
        """Return the strongest independent changes of dz/dx by the common unknowns, shape (k, r, nx)."""
        n_blocks, n_rows, _, count = self.carried.shape
        across = np.ascontiguousarray(self.carried[:, :, 0::2])
        if count == 0:
            return np.zeros((0, n_rows, 2 * n_blocks))
        flat = across.reshape(-1, count) @ np.linalg.cholesky(self.covariance)
        values, vectors = np.linalg.eigh(flat.T @ flat)
        enough = np.cumsum(values[::-1]) < _MODES_SHARE * values.sum()
        kept = min(_MODES, int(np.count_nonzero(enough)) + 1)
        strongest = (flat @ vectors[:, ::-1][:, :kept]).reshape(n_blocks, n_rows, 2, kept)
        return np.asarray(strongest.transpose(3, 1, 0, 2).reshape(kept, n_rows, 2 * n_blocks))


def _eliminate(
    lines: TouchingLines, grid: RowGrid, prior: Roughness, start: FloatArray, common: tuple[FloatArray, FloatArray]
) -> _Eliminated:
    """Eliminate the slopes of all rows; estimate the common unknowns and what of the slopes hangs on them."""
    value, covariance = common
    count = value.size
    system = assemble(lines, grid, prior)
    pull = right_sides(system, lines, grid, lines.misfit_rad) + prior_pull(system.bands, start)
    known = float((pull * system.factor.solve(pull)).sum())
    evidence = 0.5 * (system.log_determinant + known)
    if count == 0:
        nothing = np.zeros((grid.x_m.size // 2, grid.n_rows, 4, 0))
        return _Eliminated(value, covariance, nothing, evidence)
    coupling = _coupling(system, lines, grid, count)
    carried = system.factor.solve(coupling)
    normal = np.linalg.inv(covariance)
    gradient = normal @ value
    weighted = lines.sigma_rad**-2
    width = lines.common_index.shape[1]
    for i in range(width):
        own = weighted * lines.d_common[:, i]
        gradient += np.bincount(lines.common_index[:, i], own * lines.misfit_rad, count)
        for j in range(width):
            place = lines.common_index[:, i] * count + lines.common_index[:, j]
            normal += np.bincount(place, own * lines.d_common[:, j], count**2).reshape(count, count)
    flat = (-1, count)
    normal -= coupling.reshape(flat).T @ carried.reshape(flat)
    gradient -= carried.reshape(flat).T @ pull.reshape(-1)
    posterior = np.linalg.inv(0.5 * (normal + normal.T))
    posterior = 0.5 * (posterior + posterior.T)
    step = -posterior @ gradient
    change = np.linalg.slogdet(posterior)[1] - np.linalg.slogdet(covariance)[1]
    evidence += 0.5 * (change - float(gradient @ step))
    return _Eliminated(step, posterior, carried, evidence)


def _coupling(system: RowSystem, lines: TouchingLines, grid: RowGrid, count: int) -> FloatArray:
    """Return the coupling of slopes and common unknowns, shape (b, r, 4, c)."""
    n_nodes = grid.x_m.size
    flat = np.zeros(grid.n_rows * n_nodes * 2 * count)
    weighted = lines.sigma_rad[:, None] ** -2 * system.weights
    node = lines.row * n_nodes + system.before
    for i in range(lines.common_index.shape[1]):
        for k in range(4):
            place = ((node + k // 2) * 2 + k % 2) * count + lines.common_index[:, i]
            flat += np.bincount(place, weighted[:, k] * lines.d_common[:, i], flat.size)
    return np.ascontiguousarray(np.swapaxes(flat.reshape(grid.n_rows, n_nodes // 2, 4, count), 0, 1))


def _between_rows(values: FloatArray, rows: IntArray, n_rows: int) -> FloatArray:
    """Interpolate values of sampled rows, shape (s, nx, 2), to all rows."""
    if rows.size == 1:
        return np.repeat(values, n_rows, axis=0)
    place = np.arange(n_rows)
    before = np.clip(np.searchsorted(rows, place, side="right") - 1, 0, rows.size - 2)
    share = ((place - rows[before]) / (rows[before + 1] - rows[before]))[:, None, None]
    return np.asarray((1 - share) * values[before] + share * values[before + 1])
