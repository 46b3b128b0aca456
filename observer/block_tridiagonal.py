"""Many symmetric block tridiagonal systems at once: solutions, determinants and the blocks of their inverses."""

from dataclasses import dataclass

import numpy as np

from heliogauge.validate import FloatArray

#: From so many matrices of four rows on they are inverted element by element, all at once.
_QUARTER, _MANY = 4, 40


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

    def solve(self, right: FloatArray, *, overwrite: bool = False) -> FloatArray:
        """Solve the systems.

        Parameters
        ----------
        right : ndarray, shape (b, r, k, n)
            Right sides, n of them.
        overwrite : bool, optional
            Whether the solutions may take their place.

        Returns
        -------
        ndarray, shape (b, r, k, n)
            Solutions.
        """
        reduced = right if overwrite else np.array(right)
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
        pivots_inverse[i], logarithm = _inverted(pivot)
        log_determinant += logarithm
        if i < len(upper):
            gains[i] = pivots_inverse[i] @ upper[i]
    return BlockFactor(pivots_inverse, gains, log_determinant)


def _inverted(matrices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the inverses of symmetric positive definite matrices, shape (r, k, k), and logarithms of determinants."""
    if matrices.shape[1] == _QUARTER and len(matrices) >= _MANY:
        found, determinant = _inverses_of_four(matrices)
        return found, np.log(determinant)
    inverse = np.linalg.inv(matrices)
    return np.asarray(0.5 * (inverse + np.swapaxes(inverse, 1, 2))), np.asarray(np.linalg.slogdet(matrices)[1])


def _inverses_of_four(matrices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return inverses and determinants of matrices of four rows, element by element: a fifth of LAPACK's time.

    With the blocks A, B, D of two rows, W = A^-1 B and S = D - B^T W the inverse is
    [[A^-1 + W S^-1 W^T, -W S^-1], [., S^-1]].
    """
    m = np.ascontiguousarray(matrices.transpose(1, 2, 0))
    (a00, a01, a11), first = _inverses_of_two(m[0, 0], m[0, 1], m[1, 1])
    w00, w01 = a00 * m[0, 2] + a01 * m[1, 2], a00 * m[0, 3] + a01 * m[1, 3]
    w10, w11 = a01 * m[0, 2] + a11 * m[1, 2], a01 * m[0, 3] + a11 * m[1, 3]
    (s00, s01, s11), second = _inverses_of_two(
        m[2, 2] - (m[0, 2] * w00 + m[1, 2] * w10),
        m[2, 3] - (m[0, 2] * w01 + m[1, 2] * w11),
        m[3, 3] - (m[0, 3] * w01 + m[1, 3] * w11),
    )
    u00, u01 = w00 * s00 + w01 * s01, w00 * s01 + w01 * s11
    u10, u11 = w10 * s00 + w11 * s01, w10 * s01 + w11 * s11
    result = np.empty_like(m)
    result[0, 0], result[1, 1] = a00 + u00 * w00 + u01 * w01, a11 + u10 * w10 + u11 * w11
    result[0, 1] = result[1, 0] = a01 + u00 * w10 + u01 * w11
    result[2, 2], result[3, 3] = s00, s11
    result[2, 3] = result[3, 2] = s01
    for i, j, value in ((0, 2, u00), (0, 3, u01), (1, 2, u10), (1, 3, u11)):
        np.negative(value, out=result[i, j])
        result[j, i] = result[i, j]
    return result.transpose(2, 0, 1), first * second


def _inverses_of_two(
    a: FloatArray, b: FloatArray, d: FloatArray
) -> tuple[tuple[FloatArray, FloatArray, FloatArray], FloatArray]:
    """Return the elements of the inverses of [[a, b], [b, d]], and the determinants."""
    determinant = a * d - b * b
    if not (determinant > 0).all():
        raise np.linalg.LinAlgError("a pivot is not positive definite")
    reciprocal = 1 / determinant
    return (d * reciprocal, -b * reciprocal, a * reciprocal), determinant
