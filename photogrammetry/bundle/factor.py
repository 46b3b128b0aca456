"""Poses, intrinsics and linked targets of a bundle adjustment: their normal matrix, factorised whole or by its blocks.

Before targets are eliminated each pose touches itself and the few intrinsics and linked targets only. What eliminated
targets add has the rank of their coordinates. With many photos of few targets, as when a drone passes twelve of them,
this rank is small, and nothing of the size of all poses by all poses need ever be formed.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from heliogauge.validate import FloatArray, IntArray

#: Eigenvalues of the scaled normal matrix below this count as zero: 1e-6 in the Jacobian's singular values.
EIGENVALUE_TOLERANCE = 1e-12
#: The factor by blocks is left to the whole matrix, which shows lost directions, well before that.
_LEAST_EIGENVALUE = 1e-10
#: Of the unknowns at most this share may be the rank of what ties the blocks together, or the whole matrix is cheaper.
_LARGEST_RANK_SHARE = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class BorderedBlocks:
    """A symmetric matrix: a block for each pose, a border, and the corner of all other unknowns.

    poses (p, 6, 6): Blocks of the poses.
    border (6 p, r): Poses with other unknowns.
    corner (r, r): Other unknowns.
    """

    poses: FloatArray
    border: FloatArray
    corner: FloatArray

    @classmethod
    def zeros(cls, n_poses: int, n_others: int) -> "BorderedBlocks":
        """Return a matrix of zeros, to add to."""
        return cls(np.zeros((n_poses, 6, 6)), np.zeros((6 * n_poses, n_others)), np.zeros((n_others, n_others)))

    @property
    def size(self) -> int:
        """Number of rows."""
        return len(self.border) + len(self.corner)

    @property
    def diagonal(self) -> FloatArray:
        """The diagonal, shape (g,)."""
        return np.concatenate([np.einsum("pii->pi", self.poses).ravel(), np.diagonal(self.corner)])

    def whole(self) -> FloatArray:
        """Return the matrix written out, shape (g, g)."""
        n_poses, first = len(self.poses), len(self.border)
        matrix = np.zeros((self.size, self.size))
        blocks = matrix[:first, :first].reshape(n_poses, 6, n_poses, 6)
        place = np.arange(n_poses)
        blocks[place, :, place] = self.poses
        matrix[:first, first:], matrix[first:, :first] = self.border, self.border.T
        matrix[first:, first:] = self.corner
        return matrix

    def scaled(self, scale: FloatArray, damping: float) -> "BorderedBlocks":
        """Return the matrix over scales of rows and columns, shape (g,), with a damping on its diagonal."""
        first = len(self.border)
        own, others = scale[:first].reshape(-1, 6), scale[first:]
        return BorderedBlocks(
            self.poses / own[:, :, None] / own[:, None, :] + damping * np.eye(6),
            self.border / scale[:first, None] / others,
            self.corner / others[:, None] / others + damping * np.eye(others.size),
        )


class Factor(Protocol):
    """F with ``F^T F`` the (pseudo-)inverse of a symmetric matrix."""

    @property
    def lost(self) -> FloatArray:
        """Directions that nothing holds, shape (g, k)."""
        ...

    def half(self, right: FloatArray) -> FloatArray:
        """Return F b, shape (g - k, c)."""
        ...

    def back(self, half: FloatArray) -> FloatArray:
        """Return ``F^T`` times the result of `half`."""
        ...

    def solve(self, right: FloatArray) -> FloatArray:
        """Return the (pseudo-)inverse times a right-hand side."""
        ...

    def inverse(self, columns: IntArray) -> FloatArray:
        """Return rows and columns of the inverse, shape (k, k)."""
        ...

    @property
    def whole_inverse(self) -> FloatArray:
        """The whole inverse, shape (g, g)."""
        ...

    def inverse_blocks(self, columns: IntArray) -> FloatArray:
        """Return blocks of the inverse, columns of shape (b, k), shape (b, k, k)."""
        ...


class DenseFactor:
    """Factorised whole matrix: Cholesky, or eigenvectors where it is singular.

    matrix (g, g): The scaled matrix; overwritten.
    """

    def __init__(self, matrix: FloatArray) -> None:
        from scipy.linalg import lapack

        #: Directions that nothing holds, shape (g, k).
        self.lost: FloatArray = np.zeros((matrix.shape[0], 0))
        self._size = matrix.shape[0]
        self._vectors: FloatArray | None = None
        norm = float(np.abs(matrix).sum(axis=0).max(initial=0.0))
        lower, info = lapack.dpotrf(matrix, lower=1, clean=1)
        condition = lapack.dpocon(lower, norm, uplo="L")[0] if info == 0 and matrix.size else 1.0
        # The estimate is for another norm: look closely well before the limit.
        if info == 0 and condition > 10 * EIGENVALUE_TOLERANCE:
            self._lower: FloatArray = lower
            return
        values, vectors = np.linalg.eigh(matrix)
        held = values > EIGENVALUE_TOLERANCE * max(float(values[-1]), 0.0)
        self.lost = vectors[:, ~held]
        self._vectors = vectors[:, held] / np.sqrt(values[held])

    def half(self, right: FloatArray) -> FloatArray:
        """Return F b with ``F^T F`` the (pseudo-)inverse of the matrix, shape (k, c)."""
        if self._vectors is not None:
            return np.asarray(self._vectors.T @ right)
        from scipy.linalg import solve_triangular

        return np.asarray(solve_triangular(self._lower, right, lower=True, check_finite=False))

    def back(self, half: FloatArray) -> FloatArray:
        """Return ``F^T`` times the result of `half`."""
        if self._vectors is not None:
            return np.asarray(self._vectors @ half)
        from scipy.linalg import solve_triangular

        return np.asarray(solve_triangular(self._lower, half, lower=True, trans="T", check_finite=False))

    def solve(self, right: FloatArray) -> FloatArray:
        """Return the (pseudo-)inverse times a right-hand side."""
        return self.back(self.half(right))

    def inverse(self, columns: IntArray) -> FloatArray:
        """Return rows and columns of the inverse, shape (k, k)."""
        unit = np.zeros((self._size, columns.size))
        unit[columns, np.arange(columns.size)] = 1.0
        half = self.half(unit)
        return np.asarray(half.T @ half)

    @cached_property
    def whole_inverse(self) -> FloatArray:
        """The whole inverse, shape (g, g)."""
        return self.inverse(np.arange(self._size))

    def inverse_blocks(self, columns: IntArray) -> FloatArray:
        """Return blocks of the inverse, columns of shape (b, k), shape (b, k, k)."""
        return np.asarray(self.whole_inverse[columns[:, :, None], columns[:, None, :]])


class BlockFactor:
    """Factorised blocks with what ties them together: ``D - U U^T + V V^T``, D with a border.

    blocks: D, with positive definite blocks of poses and corner.
    minus, plus (g, k): U and V, few columns each.
    numpy.linalg.LinAlgError: A block is not positive definite, or the matrix so near to singular that the whole
        must be looked at.

    With L the root of the blocks without border, the matrix is ``L (I + Z diag(m) Z^T) L^T``; Z has orthonormal
    columns in the span of ``L^-1 [U, V, border]``, and m are the eigenvalues there. So ``F = (I + Z diag((1 + m)^-1/2
    - 1) Z^T) L^-1``, exactly, at a cost that grows with the number of blocks.
    """

    def __init__(self, blocks: BorderedBlocks, minus: FloatArray, plus: FloatArray) -> None:
        n_others = len(blocks.corner)
        self._first = len(blocks.border)
        #: Directions that nothing holds: none, or this class is not used.
        self.lost: FloatArray = np.zeros((blocks.size, 0))
        lower = np.linalg.cholesky(blocks.poses)
        # A photo of two targets: whether its root exists at all is a matter of rounding, and nothing below sees it.
        if (np.einsum("pii->pi", lower) ** 2 < _LEAST_EIGENVALUE).any():
            raise np.linalg.LinAlgError("nearly singular")
        self._roots: FloatArray = np.linalg.inv(lower)
        corner = np.linalg.inv(np.linalg.cholesky(blocks.corner)) if n_others else np.zeros((0, 0))
        self._corner_root: FloatArray = np.asarray(corner)
        tie = np.zeros((blocks.size, 2 * n_others))
        tie[: self._first, :n_others] = blocks.border
        tie[self._first :, n_others:] = np.eye(n_others)
        orthonormal, right = np.linalg.qr(self._whitened(np.concatenate([minus, plus, tie], axis=1)))
        counts = (minus.shape[1], plus.shape[1], n_others, n_others)
        less, more, here, there = np.split(right, np.cumsum(counts)[:-1], axis=1)
        crossed = here @ there.T
        values, vectors = np.linalg.eigh(more @ more.T - less @ less.T + crossed + crossed.T)
        if values.size and 1 + float(values[0]) < _LEAST_EIGENVALUE:
            raise np.linalg.LinAlgError("nearly singular")
        self._directions: FloatArray = orthonormal @ vectors
        self._change: FloatArray = 1 / np.sqrt(1 + values) - 1
        self._inverse_change: FloatArray = 1 / (1 + values) - 1

    @staticmethod
    def pays(n_unknowns: int, rank: int) -> bool:
        """Return whether ties of a rank are few enough for this."""
        return rank < _LARGEST_RANK_SHARE * n_unknowns

    def _whitened(self, right: FloatArray) -> FloatArray:
        """Return ``L^-1 b``."""
        width = right.shape[1]
        poses = self._roots @ right[: self._first].reshape(len(self._roots), 6, width)
        return np.concatenate([poses.reshape(self._first, width), self._corner_root @ right[self._first :]])

    def _unwhitened(self, right: FloatArray) -> FloatArray:
        """Return ``L^-T b``."""
        width = right.shape[1]
        poses = np.swapaxes(self._roots, 1, 2) @ right[: self._first].reshape(len(self._roots), 6, width)
        return np.concatenate([poses.reshape(self._first, width), self._corner_root.T @ right[self._first :]])

    def _turned(self, right: FloatArray) -> FloatArray:
        return right + self._directions @ (self._change[:, None] * (self._directions.T @ right))

    def half(self, right: FloatArray) -> FloatArray:
        """Return F b with ``F^T F`` the inverse of the matrix, shape (g, c) or (g,)."""
        columns = right.reshape(len(right), -1)
        return self._turned(self._whitened(columns)).reshape(right.shape)

    def back(self, half: FloatArray) -> FloatArray:
        """Return ``F^T`` times the result of `half`."""
        columns = half.reshape(len(half), -1)
        return self._unwhitened(self._turned(columns)).reshape(half.shape)

    def solve(self, right: FloatArray) -> FloatArray:
        """Return the inverse times a right-hand side."""
        return self.back(self.half(right))

    @cached_property
    def _ties(self) -> FloatArray:
        return self._unwhitened(self._directions)

    @cached_property
    def _own(self) -> tuple[FloatArray, FloatArray]:
        """Inverses of the blocks of the poses, shape (p, 6, 6), and of the corner."""
        poses = np.swapaxes(self._roots, 1, 2) @ self._roots
        return poses, np.asarray(self._corner_root.T @ self._corner_root)

    def inverse(self, columns: IntArray) -> FloatArray:
        """Return rows and columns of the inverse, shape (k, k)."""
        ties = self._ties[columns]
        result = np.asarray((ties * self._inverse_change) @ ties.T)
        block = self._block(columns)
        order = np.argsort(block, kind="stable")
        begin, end = (np.searchsorted(block[order], block[order], side=side) for side in ("left", "right"))
        # All pairs of one block: each place with every place of its run.
        first = np.repeat(np.arange(columns.size), end - begin)
        before = np.cumsum(end - begin) - (end - begin)
        second = np.repeat(begin - before, end - begin) + np.arange(first.size)
        first, second = order[first], order[second]
        result[first, second] += self._own_values(columns[first], columns[second])
        return result

    @property
    def whole_inverse(self) -> FloatArray:
        """The whole inverse, shape (g, g), formed anew at each call."""
        return self.inverse(np.arange(self._first + len(self._corner_root)))

    def inverse_blocks(self, columns: IntArray) -> FloatArray:
        """Return blocks of the inverse, columns of shape (b, k), shape (b, k, k)."""
        ties = self._ties[columns]
        result = np.asarray((ties * self._inverse_change) @ np.swapaxes(ties, 1, 2))
        block = self._block(columns)
        which, i, j = np.nonzero(block[:, :, None] == block[:, None, :])
        result[which, i, j] += self._own_values(columns[which, i], columns[which, j])
        return result

    def _block(self, columns: IntArray) -> IntArray:
        """Return the photo of each column, and one number more for the corner."""
        return np.minimum(columns // 6, self._first // 6)

    def _own_values(self, rows: IntArray, columns: IntArray) -> FloatArray:
        """Return elements of the inverse of the blocks by themselves, each row in the block of its column."""
        poses, corner = self._own
        values = np.empty(rows.size)
        is_pose = rows < self._first
        own, beside = rows[is_pose], columns[is_pose]
        values[is_pose] = poses[own // 6, own % 6, beside % 6]
        values[~is_pose] = corner[rows[~is_pose] - self._first, columns[~is_pose] - self._first]
        return values
