"""Slopes of all rows together with what they have in common: camera positions, absorber and its radius."""

import weakref
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from heliogauge.validate import BoolArray, FloatArray
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

if TYPE_CHECKING:
    from scipy.sparse import csr_array

#: Rows that suffice to estimate the common unknowns; with all of them the solution would cost as much as all else. With
#: many photos fewer rows do, because each mirror point is seen by more of them.
_MOST_ROWS_FOR_COMMON, _FEWEST_ROWS_FOR_COMMON = 48, 12
_ROWS_TIMES_COMMON = 18000
#: Rows that suffice to choose the roughness: it is one number, and each row has some hundred lines.
_ROWS_FOR_ROUGHNESS = 16
#: Photos whose lines suffice for that.
_PHOTOS_FOR_ROUGHNESS = 70
#: Combinations of common unknowns that are kept as modes of the whole map, and the share of the variance they have.
_MODES = 10
_MODES_SHARE = 0.99
_SINGLE: np.dtype[Any] = np.dtype(np.float32)
#: Decimal exponents of the roughness [rad^2 / m^3, rad^2 / m^5] that are searched, by its order: from a mirror that
#: bends by 0.1 mrad within a metre to a crumpled one.
_EXPONENTS = {2: (-8.0, 1.0), 3: (-6.0, 3.0)}
#: Waves of 0.6 m have so many times the roughness in the next order [1/m^2].
_NEXT_ORDER_PER_M2 = 100.0
#: It is told to such a part of the range, by differences of the evidence over twice so many decades.
_INTERVALS, _DIFFERENCE = 32, 0.125


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
    modes_apart : ndarray, shape (l, s, nx)
        The same of those unknowns that are shown apart, with what the others do along with them; `modes` are then what
        the others do besides.
    """

    slopes: FloatArray
    random: FloatArray
    shared: FloatArray
    common: FloatArray
    covariance_common: FloatArray
    mode_rows: IntArray
    modes: FloatArray
    modes_apart: FloatArray


def find_roughness(
    lines: TouchingLines, grid: RowGrid, prior: Roughness, covariance: FloatArray, *, any_order: bool = False
) -> Roughness:
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
    any_order : bool, optional
        Whether the order of the random walk is chosen as well; otherwise it is the prior's.

    Returns
    -------
    Roughness
        With the most probable roughness, to a quarter of a decade.

    Notes
    -----
    Marginal likelihood with slopes and common unknowns integrated out, on a sample of rows and photos. The interval in
    which its slope over the logarithm of the roughness changes sign is enclosed from the prior's own, which is near
    after the first round, and found by bisection.
    """
    rows = sample_rows(grid, _ROWS_FOR_ROUGHNESS)
    some, fewer = _sampled(lines, grid, rows)
    some, own_covariance = _fewer_common(some, covariance)
    nothing = (np.zeros(len(own_covariance)), own_covariance)
    still = np.zeros((fewer.n_rows, grid.x_m.size, 2))

    def evidence(trial: Roughness) -> float:
        return _eliminate(some, fewer, trial, still, nothing).evidence

    best = _most_probable(prior, evidence)
    if not any_order:
        return best
    other = 5 - best.order
    start = best.across * _NEXT_ORDER_PER_M2 ** (other - best.order)
    rival = _most_probable(replace(prior, across=start, order=other), evidence)
    return max(best, rival, key=evidence)


def _most_probable(prior: Roughness, evidence_of: Callable[[Roughness], float]) -> Roughness:
    """Return the roughness of the prior's order that has the largest evidence."""
    low, high = _EXPONENTS[prior.order]
    width = (high - low) / _INTERVALS
    known: dict[int, bool] = {}

    def evidence(exponent: float) -> float:
        return evidence_of(replace(prior, across=10.0**exponent))

    def rises(border: int) -> bool:
        """Return whether the evidence rises at a border between intervals; the first and the last enclose it."""
        if border <= 0 or border >= _INTERVALS:
            return border <= 0
        if border not in known:
            middle = low + border * width
            known[border] = evidence(middle + _DIFFERENCE) > evidence(middle - _DIFFERENCE)
        return known[border]

    first = int(np.clip((np.log10(prior.across) - low) / width, 0, _INTERVALS - 1))
    last, stride = first + 1, 1
    while not rises(first):
        first, last, stride = max(first - stride, 0), first, 2 * stride
    stride = 1
    while rises(last):
        first, last, stride = last, min(last + stride, _INTERVALS), 2 * stride
    while last - first > 1:
        middle = (first + last) // 2
        first, last = (middle, last) if rises(middle) else (first, middle)
    return replace(prior, across=10.0 ** (low + (first + 0.5) * width))


def evidence_of_rows(lines: TouchingLines, grid: RowGrid, prior: Roughness) -> float:
    """Return how probable lines are under a roughness, with nothing that rows have in common left to find.

    Parameters
    ----------
    lines : TouchingLines
        Observations of slope errors from zero; their common unknowns are not looked at.
    grid : RowGrid
        Nodes.
    prior : Roughness
        How slopes may vary.

    Returns
    -------
    float
        Logarithm of the marginal likelihood, but for a constant.
    """
    still = np.zeros((grid.n_rows, grid.x_m.size, 2))
    return _eliminate(lines, grid, prior, still, (np.zeros(0), np.zeros((0, 0)))).evidence


def _fewer_common(lines: TouchingLines, covariance: FloatArray) -> tuple[TouchingLines, FloatArray]:
    """Keep the lines of some photos, evenly spread, and the common unknowns that move them, numbered anew."""
    if len(covariance) == 0:
        return lines, covariance
    leading = np.unique(lines.common_index[:, 0])
    if leading.size <= _PHOTOS_FOR_ROUGHNESS:
        return lines, covariance
    chosen = leading[np.linspace(0, leading.size - 1, _PHOTOS_FOR_ROUGHNESS).round().astype(np.intp)]
    some = lines.chosen(np.isin(lines.common_index[:, 0], chosen))
    kept, number = np.unique(some.common_index, return_inverse=True)
    index = np.asarray(number.reshape(some.common_index.shape), dtype=np.intp)
    return replace(some, common_index=index), covariance[np.ix_(kept, kept)]


def solve_jointly(
    lines: TouchingLines,
    grid: RowGrid,
    prior: Roughness,
    start: FloatArray,
    common: tuple[FloatArray, FloatArray],
    *,
    with_shares: bool | BoolArray | None = True,
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
    with_shares : bool, ndarray of bool, shape (c,), or None, optional
        Whether the share of the common unknowns in the slopes' variance is wanted; without it that share is zero and
        there are no modes, which takes half the time. With an array the unknowns that are not chosen are shown apart.
        With None not even the covariance of the common unknowns is computed; it is empty.

    Returns
    -------
    SlopeErrors
        The solution.
    """
    wanted = _ROWS_TIMES_COMMON // max(common[0].size, 1)
    rows = sample_rows(grid, min(max(wanted, _FEWEST_ROWS_FOR_COMMON), _MOST_ROWS_FOR_COMMON))
    some, fewer = _sampled(lines, grid, rows)
    shared = _eliminate(some, fewer, prior, start[rows], common, with_covariance=with_shares is not None)
    step = shared.step
    system = assemble(lines, grid, prior)
    moved = lines.misfit_rad + np.einsum("mc,mc->m", lines.d_common, step[lines.common_index])
    right = right_sides(system, lines, grid, -moved) - prior_pull(system.bands, start)
    slopes = start + from_blocks(system.factor.solve(right)[..., 0], grid.x_m.size)
    random = _of_nodes(system.factor.inverse_blocks(), grid.x_m.size)
    nothing = np.zeros((0, rows.size, grid.x_m.size))
    found = (common[0] + step, shared.covariance, rows)
    if with_shares is None or with_shares is False:
        return SlopeErrors(slopes, random, np.zeros_like(slopes), *found, nothing, nothing)
    if with_shares is True or with_shares.all():
        (variance, modes), apart = shared.shares(), nothing
    else:
        (variance, modes), (more, apart) = (part.shares() for part in shared.split(np.asarray(with_shares)))
        variance = variance + more
    between = _between_rows(variance, rows, grid.n_rows)
    return SlopeErrors(slopes, random, between, *found, modes, apart)


def _of_nodes(blocks: FloatArray, n_nodes: int) -> FloatArray:
    """Return the covariance of both slopes of each node, shape (r, nx, 2, 2), from blocks, (b, r, 2 w, 2 w)."""
    n_blocks, n_rows, size = blocks.shape[:3]
    width = size // 2
    found = np.empty((n_rows, n_blocks * width, 2, 2))
    for i in range(width):
        own = slice(2 * i, 2 * i + 2)
        found[:, i::width] = np.swapaxes(blocks[..., own, own], 0, 1)
    return found[:, :n_nodes]


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
    n_nodes: int

    def split(self, first: BoolArray) -> tuple["_Eliminated", "_Eliminated"]:
        """Return what some unknowns do with the others held, and what the others do, the first following along."""
        own, both = self.covariance[np.ix_(~first, ~first)], self.covariance[np.ix_(first, ~first)]
        following = np.linalg.solve(own, both.T).T
        rest = self.covariance[np.ix_(first, first)] - following @ both.T
        # A little variance keeps the matrix positive definite where rounding took it.
        rest += 1e-12 * np.diag(np.diagonal(self.covariance)[first])
        carried = self.carried[..., ~first] + self.carried[..., first] @ following
        return replace(self, covariance=rest, carried=self.carried[..., first]), replace(
            self, covariance=own, carried=carried
        )

    def shares(self) -> tuple[FloatArray, FloatArray]:
        """Return what the slopes have from the common unknowns: variance, shape (r, nx, 2), and modes, (k, r, nx).

        Modes are the strongest independent changes of dz/dx.
        """
        from scipy.linalg import eigh

        n_blocks, n_rows, size, count = self.carried.shape
        n_nodes = self.n_nodes
        if count == 0:
            return np.zeros((n_rows, n_nodes, 2)), np.zeros((0, n_rows, n_nodes))
        # In single precision, which is a millionth of a variance; the products are the most expensive of all.
        root = np.asarray(np.linalg.cholesky(self.covariance), dtype=_SINGLE)
        flat = self.carried.reshape(-1, count).astype(_SINGLE) @ root
        of_each = np.einsum("kc,kc->k", flat, flat).astype(np.float64)
        variance = from_blocks(of_each.reshape(n_blocks, n_rows, size), n_nodes)
        across = np.ascontiguousarray(flat.reshape(-1, size, count)[:, 0::2]).reshape(-1, count)
        products = np.asarray(across.T @ across, dtype=np.float64)
        some = min(_MODES, count)
        values, vectors = eigh(products, subset_by_index=(count - some, count - 1), check_finite=False)
        enough = np.cumsum(values[::-1]) < _MODES_SHARE * np.trace(products)
        kept = min(some, int(np.count_nonzero(enough)) + 1)
        strongest = (across @ vectors[:, ::-1][:, :kept].astype(_SINGLE)).astype(np.float64)
        by_node = strongest.reshape(n_blocks, n_rows, size // 2, kept).transpose(3, 1, 0, 2)
        return variance, np.asarray(by_node.reshape(kept, n_rows, -1)[..., :n_nodes])


def _eliminate(
    lines: TouchingLines,
    grid: RowGrid,
    prior: Roughness,
    start: FloatArray,
    common: tuple[FloatArray, FloatArray],
    *,
    with_covariance: bool = False,
) -> _Eliminated:
    """Eliminate the slopes of all rows; estimate the common unknowns and what of the slopes hangs on them."""
    from scipy.linalg import lapack

    value, covariance = common
    count = value.size
    system = assemble(lines, grid, prior)
    pull = right_sides(system, lines, grid, lines.misfit_rad) + prior_pull(system.bands, start)
    known = float((pull * system.factor.solve(pull)).sum())
    evidence = 0.5 * (system.log_determinant + known)
    if count == 0:
        nothing = np.zeros((1, grid.n_rows, 4, 0))
        return _Eliminated(value, covariance, nothing, evidence, grid.x_m.size)
    weighted = lines.sigma_rad**-2
    derivatives = derivatives_of(lines, count)
    coupling = (slope_derivatives(system, lines, grid).T @ derivatives.multiply(weighted[:, None]).tocsr()).tocsr()
    carried = system.factor.solve(coupling.toarray().reshape(-1, grid.n_rows, 2 * system.width, count), overwrite=True)
    precision, spread = _precision(covariance)
    normal, gradient = precision.copy(), precision @ value
    gradient += derivatives.T @ (weighted * lines.misfit_rad)
    normal += (derivatives.T @ derivatives.multiply(weighted[:, None]).tocsr()).toarray()
    flat = (-1, count)
    # Each common unknown touches a few nodes of a row only: with dense factors this product would cost the most of all.
    normal -= coupling.T @ carried.reshape(flat)
    gradient -= carried.reshape(flat).T @ pull.reshape(-1)
    root, narrowed = _root(normal)
    step = -np.asarray(lapack.dpotrs(root, gradient, lower=1)[0])
    posterior = _inverse_of(root) if with_covariance else np.zeros((0, 0))
    evidence -= 0.5 * (narrowed + spread + float(gradient @ step))
    return _Eliminated(step, posterior, carried, evidence, grid.x_m.size)


def _precision(covariance: FloatArray) -> tuple[FloatArray, float]:
    """Return the inverse of a prior covariance and the logarithm of its determinant; the last two are remembered.

    All rounds of a solution have the same prior, and inverting a thousand unknowns takes as long as half the rest.
    """
    for known, found in _last_priors:
        if known() is covariance:
            return found
    root, determinant = _root(covariance)
    _last_priors[:] = [(weakref.ref(covariance), (_inverse_of(root), determinant)), *_last_priors[:1]]
    return _last_priors[0][1]


_last_priors: list[tuple[weakref.ref[FloatArray], tuple[FloatArray, float]]] = []


def _root(matrix: FloatArray) -> tuple[FloatArray, float]:
    """Return the lower Cholesky root of a positive definite matrix and the logarithm of the determinant."""
    from scipy.linalg import lapack

    root, info = lapack.dpotrf(0.5 * (matrix + matrix.T), lower=1)
    if info != 0:
        raise np.linalg.LinAlgError("the common unknowns are not determined")
    return np.asarray(root), 2 * float(np.log(np.diagonal(root)).sum())


def _inverse_of(root: FloatArray) -> FloatArray:
    """Return the inverse of the matrix that has a root."""
    from scipy.linalg import lapack

    # Above the diagonal both are zero.
    inverse, _ = lapack.dpotri(root, lower=1)
    whole = inverse + inverse.T
    whole.flat[:: len(whole) + 1] *= 0.5
    return np.asarray(whole)


def derivatives_of(lines: TouchingLines, count: int) -> "csr_array":
    """Return the derivatives of all lines with respect to the common unknowns.

    Parameters
    ----------
    lines : TouchingLines
        Observations.
    count : int
        Number of common unknowns.

    Returns
    -------
    csr_array, shape (m, c)
        Derivatives.
    """
    from scipy.sparse import csr_array

    width = lines.common_index.shape[1]
    first = np.arange(lines.row.size + 1) * width
    table = (lines.d_common.ravel(), lines.common_index.ravel(), first)
    return csr_array(table, shape=(lines.row.size, count))


def slope_derivatives(system: RowSystem, lines: TouchingLines, grid: RowGrid) -> "csr_array":
    """Return the derivatives of all lines with respect to the slopes.

    Parameters
    ----------
    system : RowSystem
        The rows.
    lines : TouchingLines
        Observations.
    grid : RowGrid
        Nodes.

    Returns
    -------
    csr_array, shape (m, b r 2 w)
        Derivatives, columns in the order of the blocks.
    """
    from scipy.sparse import csr_array

    # Node before and node after, each with two slopes.
    node = system.before[:, None] + np.array([0, 0, 1, 1])
    width = system.width
    block = (node // width) * grid.n_rows + lines.row[:, None]
    place = 2 * (block * width + node % width) + np.array([0, 1, 0, 1])
    table = (system.weights.ravel(), place.ravel(), np.arange(lines.row.size + 1) * place.shape[1])
    return csr_array(table, shape=(lines.row.size, 2 * width * -(-grid.x_m.size // width) * grid.n_rows))


def _between_rows(values: FloatArray, rows: IntArray, n_rows: int) -> FloatArray:
    """Interpolate values of sampled rows, shape (s, nx, 2), to all rows."""
    if rows.size == 1:
        return np.repeat(values, n_rows, axis=0)
    place = np.arange(n_rows)
    before = np.clip(np.searchsorted(rows, place, side="right") - 1, 0, rows.size - 2)
    share = ((place - rows[before]) / (rows[before + 1] - rows[before]))[:, None, None]
    return np.asarray((1 - share) * values[before] + share * values[before + 1])
