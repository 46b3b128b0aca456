"""Many symmetric block tridiagonal systems at once: solutions, determinants and the blocks of their inverses."""

from dataclasses import dataclass

import numpy as np

from heliogauge.validate import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class BlockFactor:
    """Factorised systems, one for each row of a stack.

    Parameters
    ----------
    pivots_inverse : ndarray, shape (b, r, k, k)
        Inverses of the pivots ``S_i = D_i - C_i^T S_{i-1}^-1 C_i``.
    gains : ndarray, shape (b - 1, r, k, k)
        ``S_i^-1 C_{i+1}``.
    log_determinant : ndarray, shape (r,)
        Logarithm of each system's determinant.
    """

    pivots_inverse: FloatArray
    gains: FloatArray
    log_determinant: FloatArray

    def solve(self, right: FloatArray) -> FloatArray:
        """Solve the systems.

        Parameters
        ----------
        right : ndarray, shape (b, r, k, n)
            Right sides, n of them.

        Returns
        -------
        ndarray, shape (b, r, k, n)
            Solutions.
        """
        reduced = np.array(right)
        for i in range(1, len(reduced)):
            reduced[i] -= np.swapaxes(self.gains[i - 1], 1, 2) @ reduced[i - 1]
        for i in range(len(reduced)):
            reduced[i] = self.pivots_inverse[i] @ reduced[i]
        for i in range(len(reduced) - 2, -1, -1):
            reduced[i] -= self.gains[i] @ reduced[i + 1]
        return reduced

    def inverse_blocks(self) -> FloatArray:
        """Return the diagonal blocks of the inverses, shape (b, r, k, k)."""
        blocks = np.array(self.pivots_inverse)
        for i in range(len(blocks) - 2, -1, -1):
            blocks[i] += self.gains[i] @ blocks[i + 1] @ np.swapaxes(self.gains[i], 1, 2)
        return blocks


def factorise(diagonal: FloatArray, upper: FloatArray) -> BlockFactor:
    """Factorise symmetric positive definite block tridiagonal matrices.

    Parameters
    ----------
    diagonal : ndarray, shape (b, r, k, k)
        Diagonal blocks D_i of r matrices.
    upper : ndarray, shape (b - 1, r, k, k)
        Blocks C_{i+1} right of the diagonal, from block row i to block column i + 1.

    Returns
    -------
    BlockFactor
        The factors.

    Raises
    ------
    numpy.linalg.LinAlgError
        A pivot is singular.

    Notes
    -----
    Block Gauss elimination without pivoting, which is stable for positive definite matrices. The loop runs over the
    blocks; the stack of matrices is handled by batched products of small matrices.
    """
    pivots_inverse, gains = np.empty_like(diagonal), np.empty_like(upper)
    log_determinant = np.zeros(diagonal.shape[1])
    pivot = diagonal[0]
    for i in range(len(diagonal)):
        if i:
            pivot = diagonal[i] - np.swapaxes(upper[i - 1], 1, 2) @ gains[i - 1]
        log_determinant += np.linalg.slogdet(pivot)[1]
        inverse = np.linalg.inv(pivot)
        pivots_inverse[i] = 0.5 * (inverse + np.swapaxes(inverse, 1, 2))
        if i < len(upper):
            gains[i] = pivots_inverse[i] @ upper[i]
    return BlockFactor(pivots_inverse, gains, log_determinant)
