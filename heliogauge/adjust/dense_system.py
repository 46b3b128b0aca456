"""Linear algebra of small adjustments: orthogonal factorisation, rank, covariance; numpy only."""

from dataclasses import dataclass

import numpy as np

from heliogauge.adjust.gauss_newton import EPSILON
from heliogauge.validate import FloatArray

# Rows factorised at once: 4096 x 10 columns stay in the second-level cache.
_ROWS = 4096


@dataclass(frozen=True, slots=True, eq=False)
class DenseSystem:
    """A linearised least-squares problem ``min |r + J step|`` in scaled coordinates, factorised.

    scale (n,): Column scale.
    basis (n, k): Admissible directions in scaled coordinates (all of them, or those orthogonal to the datum
        constraints).
    left, right (k, k): Singular vectors of the triangular factor: rows of ``right`` are directions in the basis.
    singular (k,): Singular values of the column-scaled Jacobian, largest first.
    projection (k,): Residuals along the left singular vectors.
    rank: Number of singular values that count.
    rounding: Rounding error of the residual vector's length.
    """

    scale: FloatArray
    basis: FloatArray
    right: FloatArray
    singular: FloatArray
    projection: FloatArray
    rank: int
    rounding: float

    @property
    def decrement(self) -> float:
        """Length of the residuals that the undamped step would remove."""
        return float(np.linalg.norm(self.projection[: self.rank]))

    def step(self, damping: float) -> tuple[FloatArray, float]:
        """Return the damped step and the decrease of the cost it promises.

        damping: Relative to the squared column scale; 0 for Gauss-Newton.
        step (n,): Shortest step in scaled coordinates; nothing along the null space.
        promised: Decrease of half the sum of squares.
        """
        singular, projection = self.singular[: self.rank], self.projection[: self.rank]
        along = -projection * singular / (singular**2 + damping)
        seen = singular * along
        promised = -float(seen @ projection) - 0.5 * float(seen @ seen)
        return self.basis @ (along @ self.right[: self.rank]) / self.scale, promised

    def cofactor_root(self) -> FloatArray:
        """Return F, shape (n, rank), with ``F F^T`` the (pseudo-)inverse of the normal matrix."""
        root = self.basis @ (self.right[: self.rank].T / self.singular[: self.rank])
        return np.asarray(root / self.scale[:, None])

    def cofactor(self) -> FloatArray:
        """Return the (pseudo-)inverse of the normal matrix, shape (n, n)."""
        root = self.cofactor_root()
        return np.asarray(root @ root.T)

    def null_space(self) -> FloatArray:
        """Return the directions the observations do not see, shape (n, k - rank), unit length in scaled coordinates."""
        return np.asarray(self.basis @ self.right[self.rank :].T)


def factorise(
    jacobian: FloatArray,
    residuals: FloatArray,
    rank_tolerance: float,
    *,
    values: FloatArray | None = None,
    constraints: FloatArray | None = None,
    scale_floor: FloatArray | None = None,
) -> DenseSystem:
    """Factorise a linearised problem.

    jacobian (m, n): Derivatives of the whitened, weighted residuals.
    residuals (m,): The whitened, weighted residuals.
    rank_tolerance: Share of the largest singular value below which one counts as zero.
    values (n,): Values of the parameters, for the rounding error of the residuals.
    constraints (n, d): Datum: steps obey ``constraints.T @ step = 0``.
    scale_floor (n,): Smallest column scale.
    Returns: QR of ``[J | r]``, then singular values of the small triangle: the condition of J counts, not its
        square.
    """
    norms = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))
    scale = norms if scale_floor is None else np.maximum(norms, scale_floor)
    scale = np.where(scale > 0, scale, 1.0)
    columns = jacobian / scale
    basis = np.eye(columns.shape[1])
    if constraints is not None:
        complete, _ = np.linalg.qr(constraints / scale[:, None], mode="complete")
        basis = complete[:, constraints.shape[1] :]
        columns = columns @ basis
    triangle = _triangle(np.column_stack([columns, residuals]))
    n = columns.shape[1]
    left, singular, right = np.linalg.svd(triangle[:n, :n])
    largest = singular[0] if n else 0.0
    rank = int(np.count_nonzero(singular > rank_tolerance * largest)) if largest > 0 else 0
    rounding = 0.0 if values is None else EPSILON * float(np.linalg.norm(scale * values))
    return DenseSystem(scale, basis, right, singular, triangle[:n, n] @ left, rank, rounding)


def _reduced(matrix: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.qr(matrix, mode="r"), dtype=np.float64)


def _triangle(matrix: FloatArray) -> FloatArray:
    """Triangular factor with at least as many rows as columns less one, by row blocks."""
    columns = matrix.shape[1]
    triangle = matrix[: 2 * _ROWS]
    if matrix.shape[0] > 2 * _ROWS:
        triangle = np.zeros((0, columns))
        for first in range(0, matrix.shape[0], _ROWS):
            triangle = _reduced(np.concatenate([triangle, matrix[first : first + _ROWS]]))
    else:
        triangle = _reduced(triangle)
    missing = columns - triangle.shape[0]
    return np.concatenate([triangle, np.zeros((missing, columns))]) if missing > 0 else triangle
