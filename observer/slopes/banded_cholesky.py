"""Many symmetric banded systems of one size at once: solutions, determinants and the blocks of their inverses."""

from dataclasses import dataclass

import numpy as np

from heliogauge.validate import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class BandedFactor:
    """Cholesky roots of r banded matrices.

    root (r, n, w + 1): Columns of the lower roots from the diagonal downwards: ``L[j + i, j]`` at ``[:, j, i]``.
    """

    root: FloatArray

    @property
    def log_determinant(self) -> FloatArray:
        """Logarithm of each matrix's determinant, shape (r,)."""
        return np.asarray(2 * np.log(self.root[:, :, 0]).sum(axis=1))

    def solve(self, right: FloatArray) -> FloatArray:
        """Solve the systems.

        Shapes: result (..., r, n).
        right (..., r, n): Right sides of all systems, as often as there are leading axes.
        """
        from scipy.linalg import lapack

        rows, size, bands = self.root.shape
        # The systems one after the other are one banded system; in Fortran's order each right side is a column.
        root, columns = self.root.reshape(-1, bands).T, right.reshape(-1, rows * size).T
        return np.asarray(lapack.dpbtrs(root, columns, lower=1)[0].T).reshape(right.shape)

    def squares(self, right: FloatArray) -> FloatArray:
        """Return ``b^T A^-1 b`` of each system, shape (r,): half the work of a solution.

        right (r, n): Right sides b.
        """
        from scipy.linalg import lapack

        rows, size, bands = self.root.shape
        half, _ = lapack.dtbtrs(self.root.reshape(-1, bands).T, right.reshape(-1, 1), uplo="L")
        return np.asarray(np.square(half.reshape(rows, size)).sum(axis=1))

    def solve_many(self, right: FloatArray) -> FloatArray:
        """Solve systems that each have many right sides of their own: three times as fast as `solve` for hundreds.

        Shapes: result (r, n, k).
        right (r, n, k): Right sides; they are written over.
        """
        turned, below = self._blocks()
        n_blocks, rows, width, _ = turned.shape
        filled = np.zeros((rows, n_blocks * width - right.shape[1], right.shape[2]))
        whole = right if filled.size == 0 else np.concatenate([right, filled], axis=1)
        values = np.swapaxes(whole.reshape(rows, n_blocks, width, -1), 0, 1)
        values[0] = turned[0] @ values[0]
        for i in range(1, len(values)):
            values[i] -= below[i - 1] @ values[i - 1]
            values[i] = turned[i] @ values[i]
        back_turned, back_below = np.swapaxes(turned, 2, 3), np.swapaxes(below, 2, 3)
        values[-1] = back_turned[-1] @ values[-1]
        for i in range(len(values) - 2, -1, -1):
            values[i] -= back_below[i] @ values[i + 1]
            values[i] = back_turned[i] @ values[i]
        return whole[:, : right.shape[1]]

    def inverse_blocks(self) -> FloatArray:
        """Return the blocks of w rows on the diagonals of the inverses.

        Returns (r, b, w, w): Symmetric blocks; what reaches beyond the last row is that of unit rows.

        With the blocks L_i of the root on the diagonal and M_i below them, ``T_i = L_i^-1`` and ``H_i = M_i T_i`` the
        block of the inverse is ``Z_i = T_i^T T_i + H_i^T Z_(i+1) H_i``, from the last one on.
        """
        return np.swapaxes(self._inverse()[0], 0, 1)

    def inverse_bands(self) -> FloatArray:
        """Return the inverses as far from the diagonal as the matrices reach.

        Returns (r, n, w + 1): Columns from the diagonal downwards: ``Z[j + i, j]`` at ``[:, j, i]``.

        Beside the block Z_i on the diagonal stands ``-H_i^T Z_(i+1)``.
        """
        blocks, carried = self._inverse()
        width = blocks.shape[-1]
        beside = np.zeros_like(blocks)
        beside[:-1] = -np.swapaxes(carried, 2, 3) @ blocks[1:]
        both = np.concatenate([blocks, beside], axis=3)
        bands = np.stack([both[:, :, q, q : q + width + 1] for q in range(width)], axis=2)
        rows, size = self.root.shape[:2]
        return np.swapaxes(bands, 0, 1).reshape(rows, -1, width + 1)[:, :size]

    def _inverse(self) -> tuple[FloatArray, FloatArray]:
        """Return the blocks Z_i, shape (b, r, w, w), and H_i, shape (b - 1, r, w, w), of `inverse_blocks`."""
        turned, below = self._blocks()
        carried = below @ turned[:-1]
        blocks = np.swapaxes(turned, 2, 3) @ turned
        for i in range(len(blocks) - 2, -1, -1):
            blocks[i] += np.swapaxes(carried[i], 1, 2) @ (blocks[i + 1] @ carried[i])
        return blocks, carried

    def _blocks(self) -> tuple[FloatArray, FloatArray]:
        """Return the inverses of the roots' blocks on the diagonal, and the blocks below, shape (b, r, w, w)."""
        rows, size, bands = self.root.shape
        width = bands - 1
        count = -(-size // width)
        # Unit rows fill the last block.
        filled = np.broadcast_to(np.arange(bands) == 0, (rows, count * width - size, bands))
        root = self.root if filled.size == 0 else np.concatenate([self.root, filled], axis=1)
        # Places first: each entry of all blocks is then one array without gaps.
        parts = np.ascontiguousarray(root.reshape(rows, count, width, bands).transpose(2, 3, 1, 0))
        turned, below = np.zeros((2, count, rows, width, width))
        for q in range(width):
            column = {q: 1 / parts[q, 0]}
            for p in range(q + 1, width):
                column[p] = -sum(parts[s, p - s] * column[s] for s in range(q, p)) / parts[p, 0]
            for p, one in column.items():
                turned[..., p, q] = one
            for p in range(q + 1):
                # Below the block the root is upper triangular.
                below[..., p, q] = parts[q, width + p - q]
        return turned, below[:-1]


def factorise(bands: FloatArray) -> BandedFactor:
    """Factorise symmetric positive definite banded matrices.

    bands (r, n, w + 1): Columns of r matrices from the diagonal downwards, zero beyond the last row; its memory is
        used for the roots.
    numpy.linalg.LinAlgError: A matrix is not positive definite.
    """
    from scipy.linalg import lapack

    rows, size, count = bands.shape
    root, info = lapack.dpbtrf(np.ascontiguousarray(bands).reshape(-1, count).T, lower=1, overwrite_ab=1)
    if info != 0:
        raise np.linalg.LinAlgError(f"banded matrix {(info - 1) // size} is not positive definite")
    return BandedFactor(np.asarray(root.T).reshape(rows, size, count))
