"""What touching lines say of their common unknowns when the slopes of their rows are eliminated.

With the slopes' normal matrix A and derivatives B of the lines, both over the sigmas, and D those with respect to the
common unknowns, the normal matrix of these is ``D^T (1 - B A^-1 B^T) D``. The matrix in the middle belongs to single
rows and to the few hundred lines of each; D has some ten entries in a line. Whole rows of unknowns times all common
unknowns, of which there are a thousand and more, need not be formed.
"""

import weakref
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from heliogauge.validate import FloatArray, IntArray
from observer.slopes.alike_rows import AlikeSystem, alike_system, rows_correlation
from observer.slopes.banded_cholesky import BandedFactor
from observer.slopes.row_spline import Roughness, RowGrid, RowSystem, TouchingLines, assemble

if TYPE_CHECKING:
    from scipy.sparse import csc_array, csr_array


#: Entries of a table of some rows' lines against all unknowns: 16 MB, which the allocator hands out again.
_ENTRIES_AT_ONCE = 2_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Beside:
    """Amounts of patterns of the lines that nothing else explains, found beside the common unknowns.

    amount (k,): How much of each pattern there is.
    covariance (k, k): Covariance.
    """

    amount: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Reduced:
    """The common unknowns of some rows.

    common (c,): Their estimates.
    normal (c, c): Their normal matrix, the slopes eliminated.
    root (c, c): Its lower Cholesky root.
    evidence: Logarithm of how probable the lines are with slopes and common unknowns integrated out, but for a
        constant.
    beside: Amounts of the patterns that were asked for.
    """

    common: FloatArray
    normal: FloatArray
    root: FloatArray
    evidence: float
    beside: Beside


class Reduction:
    """Lines of some rows, gathered once for any roughness of these.

    lines: Observations, their misfits with zero slope error and zero common unknowns.
    grid: Nodes.
    covariance (c, c): Prior covariance of the common unknowns about zero.
    """

    def __init__(self, lines: TouchingLines, grid: RowGrid, covariance: FloatArray) -> None:
        order = np.argsort(lines.row, kind="stable")
        self._order = order
        lines = lines.chosen(order)
        self._first = np.searchsorted(lines.row, np.arange(grid.n_rows + 1))
        self._rows = assemble(lines, grid)
        self._sigma = lines.sigma_rad
        self._values = lines.misfit_rad / lines.sigma_rad
        self._pull = self._rows.right_sides(self._values)
        self._covariance = covariance
        self._lines = lines

    @cached_property
    def _derivatives(self) -> "csr_array":
        return derivatives_of(self._lines, len(self._covariance))

    @cached_property
    def _by_slopes(self) -> "csr_array":
        return self._rows.derivatives()

    @cached_property
    def _by_row(self) -> "list[tuple[csr_array, csc_array]]":
        """Derivatives of each row's lines with respect to its slopes, and those to the common unknowns, transposed."""
        by_slopes, size = self._by_slopes, 2 * self._rows.grid.x_m.size
        return [
            (by_slopes[first:last, size * i : size * (i + 1)], self._derivatives[first:last].T)
            for i, (first, last) in enumerate(pairwise(self._first))
        ]

    def under(self, prior: Roughness, *, beside: tuple[FloatArray, FloatArray] | None = None) -> Reduced:
        """Eliminate the slopes and estimate the common unknowns.

        prior: How slopes may vary.
        beside: Changes of the lines' misfits by patterns whose amounts are wanted [rad], and the prior standard
            deviations of these. They have no influence on the common unknowns.
        numpy.linalg.LinAlgError: They are not determined.
        """
        correlation = rows_correlation(self._rows.grid, prior)
        if correlation is None:
            system: RowSystem | AlikeSystem = self._rows.under(prior)
        else:
            system = alike_system(self._rows, prior, correlation)
        solved = system.factor.solve(self._pull)
        evidence = 0.5 * (system.log_determinant + float((self._pull * solved).sum()))
        count, nothing = len(self._covariance), np.zeros((0, 0))
        if count == 0 and beside is None:
            return Reduced(np.zeros(0), nothing, nothing, evidence, Beside(np.zeros(0), nothing))
        by_slopes = self._by_slopes
        left = self._values - by_slopes @ solved.reshape(-1)
        if count == 0:
            normal, root, common = nothing, nothing, np.zeros(0)
        else:
            normal = self._projected_alike(system) if isinstance(system, AlikeSystem) else self._projected(system)
            precision, spread = _precision(self._covariance)
            normal += precision
            root, narrowed = root_of(normal)
            gradient = self._derivatives.T @ left
            common = -solve_with(root, gradient)
            evidence -= 0.5 * (narrowed + spread + float(gradient @ common))
        if beside is None:
            return Reduced(common, normal, root, evidence, Beside(np.zeros(0), nothing))
        patterns = beside[0][self._order] / self._sigma[:, None]
        pulls = np.stack([self._rows.right_sides(one) for one in patterns.T])
        seen = patterns - (by_slopes @ system.factor.solve(pulls).reshape(len(pulls), -1).T)
        coupling = self._derivatives.T @ seen
        of_amounts = patterns.T @ seen + np.diag(beside[1] ** -2.0) - coupling.T @ solve_with(root, coupling)
        spread_beside = np.linalg.inv(of_amounts)
        amount = -spread_beside @ (patterns.T @ left + coupling.T @ common)
        return Reduced(common, normal, root, evidence, Beside(amount, spread_beside))

    def carried(self, prior: Roughness, columns: IntArray) -> FloatArray:
        """Return by how much the slopes across and along change against each common unknown, each row by itself.

        Shapes: result (r, n, 2, c).
        columns (n,): Nodes at which it is wanted.
        """
        count, grid, system = len(self._covariance), self._rows.grid, self._rows.under(prior)
        carried = np.zeros((grid.n_rows, columns.size, 2, count))
        for first, last in self._some_rows():
            solved = self._solved(system, first, last)
            for i in range(first, last):
                by_common = self._by_row[i][1]
                lines = by_common.shape[1]
                chosen = solved[i - first, :, :lines].reshape(-1, 2, lines)[columns].reshape(-1, lines)
                carried[i] = (by_common @ chosen.T).T.reshape(columns.size, 2, count)
        return carried

    def _some_rows(self) -> list[tuple[int, int]]:
        """Return rows, from the first to before the last, that the processor's caches and the allocator keep.

        As many at least as make a table of the size of the normal matrix, to which each table is added.
        """
        count = len(self._covariance)
        n_rows, width = self._rows.grid.n_rows, max(count, 2 * self._rows.grid.x_m.size)
        most = max(1, max(_ENTRIES_AT_ONCE, count**2) // (int(np.diff(self._first).max(initial=1)) * width))
        return [(first, min(first + most, n_rows)) for first in range(0, n_rows, most)]

    def _projected(self, system: RowSystem) -> FloatArray:
        """Return the normal matrix of the common unknowns by the lines, the slopes following along, shape (c, c)."""
        count = len(self._covariance)
        normal = np.zeros((count, count))
        few, many = self._split_derivatives
        split = few.shape[1]
        for first, last in self._some_rows():
            solved = self._solved(system, first, last)
            some = slice(self._first[first], self._first[last])
            projected = np.empty((some.stop - some.start, count))
            done = 0
            for i in range(first, last):
                by_slopes, by_common = self._by_row[i]
                lines = by_slopes.shape[0]
                own = -(by_slopes @ solved[i - first, :, :lines])
                own.flat[:: lines + 1] += 1.0
                projected[done : done + lines] = (by_common @ own).T
                done += lines
            normal[:split] += few[some].T @ projected
            normal[split:, split:] += many[some].T @ projected[:, split:]
        normal[split:, :split] = normal[:split, split:].T
        return normal

    @cached_property
    def _split_derivatives(self) -> "tuple[csr_array, csr_array]":
        """Derivatives with respect to the first common unknowns, and to the others: as few products as can be.

        Those of photos come first and move few lines each; a block of the symmetric normal matrix needs the
        derivatives of one half only.
        """
        count = len(self._covariance)
        entries = np.concatenate([[0], np.cumsum(np.bincount(self._lines.common_index.ravel(), minlength=count))])
        products = entries * count + (entries[-1] - entries) * (count - np.arange(count + 1))
        split = int(np.argmin(products))
        return self._derivatives[:, :split], self._derivatives[:, split:]

    @cached_property
    def _of_all_rows(self) -> "tuple[csr_array, FloatArray]":
        """Products of the derivatives: of slopes by common unknowns, and of these by themselves."""
        return self._by_slopes.T @ self._derivatives, (self._derivatives.T @ self._derivatives).toarray()

    def _projected_alike(self, system: AlikeSystem) -> FloatArray:
        """Return the normal matrix where all rows are one system, shape (c, c)."""
        pulls, own = self._of_all_rows
        return np.asarray(own - system.factor.explained(pulls.tocsr()))

    def _solved(self, system: RowSystem, first: int, last: int) -> FloatArray:
        """Return by how much the slopes of some rows change with each of their lines, shape (r, 2 nx, k)."""
        lines = np.diff(self._first)[first:last]
        some = slice(self._first[first], self._first[last])
        size = system.factor.root.shape[1]
        # One right side for each line, as it stands in the normal equations.
        right = np.zeros((last - first, size, int(lines.max(initial=0))))
        number = np.arange(some.start, some.stop) - np.repeat(self._first[first:last], lines)
        place = self._rows.place[some, None] - first * size + np.arange(4)
        right.reshape((last - first) * size, -1)[place, number[:, None]] = self._rows.weights[some]
        return BandedFactor(system.factor.root[first:last]).solve_many(right)


def derivatives_of(lines: TouchingLines, count: int) -> "csr_array":
    """Return the derivatives of all lines over their sigmas with respect to the common unknowns.

    Shapes: result (m, c).
    """
    from scipy.sparse import csr_array

    width = lines.common_index.shape[1]
    first = np.arange(lines.row.size + 1) * width
    table = ((lines.d_common / lines.sigma_rad[:, None]).ravel(), lines.common_index.ravel(), first)
    return csr_array(table, shape=(lines.row.size, count))


def _precision(covariance: FloatArray) -> tuple[FloatArray, float]:
    """Return the inverse of a prior covariance and the logarithm of its determinant; the last two are remembered.

    All rounds of a solution have the same prior, and inverting a thousand unknowns takes as long as half the rest.
    """
    for known, found in _last_priors:
        if known() is covariance:
            return found
    # Most unknowns besides the poses are known apart from all others: a third of the time for 400 photos.
    joint = np.count_nonzero(covariance, axis=0) > 1
    own = np.diagonal(covariance)
    precision = np.diag(1 / own)
    root, determinant = root_of(covariance[np.ix_(joint, joint)])
    precision[np.ix_(joint, joint)] = inverse_of(root)
    determinant += float(np.log(own[~joint]).sum())
    _last_priors[:] = [(weakref.ref(covariance), (precision, determinant)), *_last_priors[:1]]
    return _last_priors[0][1]


_last_priors: list[tuple[weakref.ref[FloatArray], tuple[FloatArray, float]]] = []


def root_of(matrix: FloatArray) -> tuple[FloatArray, float]:
    """Return the Cholesky root of a positive definite matrix.

    Shapes: root (c, c).
    matrix (c, c): The matrix; its lower half is read.
    numpy.linalg.LinAlgError: It is not positive definite.
    """
    from scipy.linalg import lapack

    # The upper half in C's order is the lower one in Fortran's.
    root, info = lapack.dpotrf(matrix.T, lower=1)
    if info != 0:
        raise np.linalg.LinAlgError("the common unknowns are not determined")
    return np.asarray(root), 2 * float(np.log(np.diagonal(root)).sum())


def solve_with(root: FloatArray, right: FloatArray) -> FloatArray:
    """Solve for a matrix that has a root.

    Shapes: right (c,) or (c, k).
    root (c, c): Lower Cholesky root.
    """
    from scipy.linalg import lapack

    return np.asarray(lapack.dpotrs(root, right, lower=1)[0]) if len(root) else np.array(right)


def inverse_of(root: FloatArray) -> FloatArray:
    """Return the inverse of the matrix that has a root.

    Shapes: result (c, c).
    root (c, c): Lower Cholesky root, zero above the diagonal.
    """
    from scipy.linalg import lapack

    if len(root) == 0:
        return np.zeros((0, 0))
    # Above the diagonal both are zero.
    inverse, _ = lapack.dpotri(root, lower=1)
    whole = inverse + inverse.T
    whole.flat[:: len(whole) + 1] *= 0.5
    return np.asarray(whole)
