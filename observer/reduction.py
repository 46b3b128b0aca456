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

from heliogauge.validate import FloatArray
from observer.slope_field import IntArray, Roughness, RowGrid, RowSystem, TouchingLines, assemble

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True, slots=True, eq=False)
class Beside:
    """Amounts of patterns of the lines that nothing else explains, found beside the common unknowns.

    Parameters
    ----------
    amount : ndarray, shape (k,)
        How much of each pattern there is.
    covariance : ndarray, shape (k, k)
        Covariance.
    """

    amount: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Reduced:
    """The common unknowns of some rows.

    Parameters
    ----------
    common : ndarray, shape (c,)
        Their estimates.
    root : ndarray, shape (c, c)
        Lower Cholesky root of their normal matrix.
    evidence : float
        Logarithm of how probable the lines are with slopes and common unknowns integrated out, but for a constant.
    carried : ndarray, shape (r, n, 2, c)
        By how much the slopes across and along at chosen nodes change against each common unknown; n is 0 where none
        were asked for.
    beside : Beside
        Amounts of the patterns that were asked for.
    """

    common: FloatArray
    root: FloatArray
    evidence: float
    carried: FloatArray
    beside: Beside

    def covariance(self) -> FloatArray:
        """Return the covariance of the common unknowns, shape (c, c)."""
        return inverse_of(self.root)


class Reduction:
    """Lines of some rows, gathered once for any roughness of these.

    Parameters
    ----------
    lines : TouchingLines
        Observations, their misfits with zero slope error and zero common unknowns.
    grid : RowGrid
        Nodes.
    covariance : ndarray, shape (c, c)
        Prior covariance of the common unknowns about zero.
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
    def _by_row(self) -> "list[tuple[csr_array, csr_array]]":
        """Derivatives of each row's lines with respect to its slopes and to the common unknowns."""
        by_slopes, size = self._rows.derivatives(), 2 * self._rows.grid.x_m.size
        return [
            (by_slopes[first:last, size * i : size * (i + 1)], self._derivatives[first:last])
            for i, (first, last) in enumerate(pairwise(self._first))
        ]

    def under(
        self, prior: Roughness, *, columns: IntArray | None = None, beside: tuple[FloatArray, FloatArray] | None = None
    ) -> Reduced:
        """Eliminate the slopes and estimate the common unknowns.

        Parameters
        ----------
        prior : Roughness
            How slopes may vary.
        columns : ndarray of int, shape (n,), optional
            Nodes at which it is wanted what the slopes have from the common unknowns.
        beside : (ndarray, ndarray), shapes (m, k) and (k,), optional
            Changes of the lines' misfits by patterns whose amounts are wanted [rad], and the prior standard deviations
            of these. They have no influence on the common unknowns.

        Returns
        -------
        Reduced
            The common unknowns.

        Raises
        ------
        numpy.linalg.LinAlgError
            They are not determined.
        """
        system = self._rows.under(prior)
        solved = system.factor.solve(self._pull)
        evidence = 0.5 * (system.log_determinant + float((self._pull * solved).sum()))
        count, by_slopes = len(self._covariance), self._rows.derivatives()
        left = self._values - by_slopes @ solved.reshape(-1)
        if count == 0:
            root, common, carried = np.zeros((0, 0)), np.zeros(0), np.zeros((self._rows.grid.n_rows, 0, 2, 0))
        else:
            projected, carried = self._projected(system, np.zeros(0, dtype=np.intp) if columns is None else columns)
            precision, spread = _precision(self._covariance)
            root, narrowed = root_of(precision + self._derivatives.T @ projected)
            gradient = self._derivatives.T @ left
            common = -solve_with(root, gradient)
            evidence -= 0.5 * (narrowed + spread + float(gradient @ common))
        if beside is None:
            return Reduced(common, root, evidence, carried, Beside(np.zeros(0), np.zeros((0, 0))))
        patterns = beside[0][self._order] / self._sigma[:, None]
        pulls = np.stack([self._rows.right_sides(one) for one in patterns.T])
        seen = patterns - (by_slopes @ system.factor.solve(pulls).reshape(len(pulls), -1).T)
        coupling = self._derivatives.T @ seen
        normal = patterns.T @ seen + np.diag(beside[1] ** -2.0) - coupling.T @ solve_with(root, coupling)
        spread_beside = np.linalg.inv(normal)
        amount = -spread_beside @ (patterns.T @ left + coupling.T @ common)
        return Reduced(common, root, evidence, carried, Beside(amount, spread_beside))

    def _projected(self, system: RowSystem, columns: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the lines' derivatives against common unknowns, the slopes following along, and what these do.

        Shapes (m, c) and (r, n, 2, c).
        """
        count, (n_rows, size, _) = len(self._covariance), system.factor.root.shape
        number = np.diff(self._first)
        # One right side for each line, as it stands in the normal equations.
        right = np.zeros((n_rows, size, int(number.max(initial=0))))
        place = np.arange(self._values.size) - np.repeat(self._first[:-1], number)
        right.reshape(n_rows * size, -1)[self._rows.place[:, None] + np.arange(4), place[:, None]] = self._rows.weights
        solved = system.factor.solve_many(right)
        projected = np.empty((self._values.size, count))
        carried = np.zeros((n_rows, 2 * columns.size, count))
        chosen = (2 * columns[:, None] + np.arange(2)).ravel()
        for i, (by_slopes, by_common) in enumerate(self._by_row):
            own = -(by_slopes @ solved[i, :, : number[i]])
            own.flat[:: number[i] + 1] += 1.0
            projected[self._first[i] : self._first[i + 1]] = (by_common.T @ own).T
            carried[i] = (by_common.T @ solved[i, chosen, : number[i]].T).T
        return projected, carried.reshape(n_rows, columns.size, 2, count)


def derivatives_of(lines: TouchingLines, count: int) -> "csr_array":
    """Return the derivatives of all lines over their sigmas with respect to the common unknowns.

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
    table = ((lines.d_common / lines.sigma_rad[:, None]).ravel(), lines.common_index.ravel(), first)
    return csr_array(table, shape=(lines.row.size, count))


def _precision(covariance: FloatArray) -> tuple[FloatArray, float]:
    """Return the inverse of a prior covariance and the logarithm of its determinant; the last two are remembered.

    All rounds of a solution have the same prior, and inverting a thousand unknowns takes as long as half the rest.
    """
    for known, found in _last_priors:
        if known() is covariance:
            return found
    root, determinant = root_of(covariance)
    _last_priors[:] = [(weakref.ref(covariance), (inverse_of(root), determinant)), *_last_priors[:1]]
    return _last_priors[0][1]


_last_priors: list[tuple[weakref.ref[FloatArray], tuple[FloatArray, float]]] = []


def root_of(matrix: FloatArray) -> tuple[FloatArray, float]:
    """Return the Cholesky root of a positive definite matrix.

    Parameters
    ----------
    matrix : ndarray, shape (c, c)
        The matrix; its lower half is read.

    Returns
    -------
    root : ndarray, shape (c, c)
        Lower root.
    log_determinant : float
        Logarithm of the matrix's determinant.

    Raises
    ------
    numpy.linalg.LinAlgError
        It is not positive definite.
    """
    from scipy.linalg import lapack

    # The upper half in C's order is the lower one in Fortran's.
    root, info = lapack.dpotrf(matrix.T, lower=1)
    if info != 0:
        raise np.linalg.LinAlgError("the common unknowns are not determined")
    return np.asarray(root), 2 * float(np.log(np.diagonal(root)).sum())


def solve_with(root: FloatArray, right: FloatArray) -> FloatArray:
    """Solve for a matrix that has a root.

    Parameters
    ----------
    root : ndarray, shape (c, c)
        Lower Cholesky root.
    right : ndarray, shape (c,) or (c, k)
        Right sides.

    Returns
    -------
    ndarray, shape as right
        Solutions.
    """
    from scipy.linalg import lapack

    return np.asarray(lapack.dpotrs(root, right, lower=1)[0]) if len(root) else np.array(right)


def inverse_of(root: FloatArray) -> FloatArray:
    """Return the inverse of the matrix that has a root.

    Parameters
    ----------
    root : ndarray, shape (c, c)
        Lower Cholesky root, zero above the diagonal.

    Returns
    -------
    ndarray, shape (c, c)
        Symmetric inverse.
    """
    from scipy.linalg import lapack

    if len(root) == 0:
        return np.zeros((0, 0))
    # Above the diagonal both are zero.
    inverse, _ = lapack.dpotri(root, lower=1)
    whole = inverse + inverse.T
    whole.flat[:: len(whole) + 1] *= 0.5
    return np.asarray(whole)
