"""Height from slopes: least squares on a grid with gaps."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.errors import EstimationError
from heliogauge.validate import BoolArray, Float32Array, FloatArray

#: Conjugate gradients stop when the misfit of the slopes that they could still take away is this share of the slopes:
#: it makes 0.1 nm of a height of 1 mm.
TOLERANCE = 1e-7
#: How far single precision takes the misfit in one go: it keeps 6e-8 of each value.
_SINGLE = 1e-4
MAX_ITERATIONS = 400
#: Weights of neighbours: all four, and the one behind minus the one ahead.
_CROSS = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
_BEHIND = np.array([[1.0, 0.0, -1.0]])


def integrate_slopes(slope_x: FloatArray, slope_y: FloatArray, step_m: tuple[float, float]) -> FloatArray:
    """Find the height whose differences between neighbours agree best with the slopes.

    slope_x, slope_y (ny, nx): dz/dx and dz/dy at the nodes; NaN where not known.
    step_m: Grid step in x and in y [m].
    Returns (ny, nx): Height with mean zero over each connected part [m]; NaN where not known.
    EstimationError: No two neighbouring nodes have slopes, or the solution does not settle.

    Southwell (1980): for each pair of neighbours ``(z_j - z_i) / step = (s_i + s_j) / 2``; least squares over all
    pairs. The normal equations are a Poisson problem with gaps, solved by conjugate gradients with the cosine
    transform's exact solution of the gap-free grid as preconditioner. The rule is exact for quadratic surfaces; take
    the design or a fit out of the slopes first, then its error concerns the remainder alone.
    """
    known = np.isfinite(slope_x) & np.isfinite(slope_y)
    mask = known.astype(np.float64)
    if not (_of_neighbours(mask, _CROSS) * mask).any():
        raise EstimationError("height: no two neighbouring nodes have slopes; use a finer grid or check the flags")
    right = np.zeros(known.shape)
    # The transpose of the neighbour differences of both their slopes' means: each node's own and its neighbours' parts.
    for slopes, step, behind in ((slope_x, step_m[0], _BEHIND), (slope_y, step_m[1], _BEHIND.T)):
        half = np.where(known, 0.5 * step * slopes, 0.0)
        right += _of_neighbours(half, behind)
        right += np.multiply(half, _of_neighbours(mask, behind), out=half)
    right *= mask
    return _centred(_solve(right, known), known)


def _solve(right: FloatArray, known: BoolArray) -> FloatArray:
    """Preconditioned conjugate gradients on the normal equations of the neighbour differences.

    The rounds are of single precision, as two arrays of double precision for each would leave the caches; what is left
    is formed in double precision whenever it has fallen by `_SINGLE`.
    """
    gap_free = _GapFree.of(right.shape)
    mask = known.astype(np.float32)
    neighbours = _of_neighbours(mask, _CROSS) * mask
    height, residual, begin, rounds = np.zeros_like(right), right, 0.0, 0
    while rounds < MAX_ITERATIONS:
        scale = float(max(residual.max(), -residual.min())) or 1.0
        left: npt.NDArray[Any] = (residual * (1 / scale)).astype(np.float32)
        change: npt.NDArray[Any] = np.zeros_like(left)
        direction: npt.NDArray[Any] = np.zeros_like(left)
        first = previous = 0.0
        while rounds < MAX_ITERATIONS:
            smooth = gap_free.solve(left)
            smooth *= mask
            # About the sum of the squared differences that are still missing.
            energy = float(np.vdot(left, smooth))
            begin, first = begin or energy * scale**2, first or energy
            if energy <= _SINGLE**2 * first or energy * scale**2 <= TOLERANCE**2 * begin:
                break
            direction = cv2.scaleAdd(direction, energy / previous if previous else 0.0, smooth)
            image = _of_neighbours(direction, _CROSS)
            image *= mask
            np.subtract(np.multiply(neighbours, direction, out=smooth), image, out=image)
            step = energy / float(np.vdot(direction, image))
            change = cv2.scaleAdd(direction, step, change, change)
            left = cv2.scaleAdd(image, -step, left, left)
            previous, rounds = energy, rounds + 1
        height += scale * change
        if energy * scale**2 <= TOLERANCE**2 * begin:
            return height
        residual = right - (neighbours * height - _of_neighbours(height, _CROSS) * mask)
    raise EstimationError(
        f"height: {MAX_ITERATIONS} rounds left {np.sqrt(energy * scale**2 / begin):.1e} of the slopes; the measured "
        "area is too torn to integrate"
    )


def _of_neighbours(values: npt.NDArray[Any], weights: FloatArray) -> npt.NDArray[Any]:
    """Return a weighted sum of the neighbours of each node; what is beyond the edge counts as zero."""
    return np.asarray(cv2.filter2D(values, -1, weights, borderType=cv2.BORDER_CONSTANT))


@dataclass(frozen=True, slots=True, eq=False)
class _GapFree:
    """The exact solution on a grid without gaps by cosine transforms; single precision, as it only steers the rounds.

    A cosine transform is a Fourier transform of the values at even places followed by those at odd places backwards,
    times turns of a quarter at most (Makhoul 1980). The coefficients stay in the order of OpenCV's packed transform of
    real rows, and so do the inverse eigenvalues: nothing is put in order between the two transforms.
    """

    inverse_eigenvalues: Float32Array
    turns_x: npt.NDArray[np.complex64]
    turns_y: npt.NDArray[np.complex64]

    @classmethod
    def of(cls, shape: tuple[int, ...]) -> "_GapFree":
        """Prepare for a grid; it is extended to even sizes whose transform is quick."""
        rows, columns = (2 * cv2.getOptimalDFTSize((size + 1) // 2) for size in shape)
        (along_x, turns_x), (along_y, turns_y) = _frequencies(columns), _frequencies(rows)
        eigenvalues = along_x[:, None] + along_y[None, :]
        eigenvalues[0, 0] = np.inf
        return cls((1 / eigenvalues).astype(np.float32), turns_x, turns_y)

    def solve(self, right: Float32Array) -> Float32Array:
        """Solve the Neumann problem of the extended grid; return its solution on the grid."""
        columns, rows = self.inverse_eigenvalues.shape
        padded = np.zeros((rows, columns), dtype=np.float32)
        places = [
            ((to_row, to_column), (from_row, from_column))
            for to_row, from_row in _places(rows, right.shape[0])
            for to_column, from_column in _places(columns, right.shape[1])
        ]
        for there, here in places:
            padded[there] = right[here]
        seen = _transform(cv2.transpose(_transform(padded, self.turns_x)), self.turns_y)
        seen *= self.inverse_eigenvalues
        found = _transform_back(cv2.transpose(_transform_back(seen, self.turns_y)), self.turns_x)
        height = np.empty_like(right)
        for there, here in places:
            height[here] = found[there]
        return height


def _frequencies(size: int) -> tuple[FloatArray, npt.NDArray[np.complex64]]:
    """Return the eigenvalues of the Neumann Laplacian in the order of the packed transform, and its turns."""
    half = size // 2
    order = np.empty(size)
    order[0], order[-1] = 0, half
    order[1:-1:2], order[2:-1:2] = np.arange(1, half), size - np.arange(1, half)
    turns = np.exp(-0.5j * np.pi * np.arange(1, half) / size).astype(np.complex64)
    return 2.0 - 2.0 * np.cos(np.pi * order / size), turns


def _places(size: int, used: int) -> list[tuple[slice, slice]]:
    """Return where even and odd places of an axis stand in the transform's order, and where they come from."""
    even, odd = (used + 1) // 2, used // 2
    return [(slice(0, even), slice(0, used, 2)), (slice(size - 1, size - 1 - odd, -1), slice(1, used, 2))]


def _transform(values: npt.NDArray[Any], turns: npt.NDArray[np.complex64]) -> Float32Array:
    """Transform rows; packed, the coefficient of each cosine beside that of its complement with the opposite sign."""
    packed = np.asarray(cv2.dft(values, flags=cv2.DFT_ROWS), dtype=np.float32)
    packed[:, 1:-1].view(np.complex64)[...] *= turns
    packed[:, -1] *= np.float32(np.sqrt(0.5))
    return packed


def _transform_back(packed: npt.NDArray[Any], turns: npt.NDArray[np.complex64]) -> Float32Array:
    """Undo `_transform`; the coefficients are changed."""
    packed[:, 1:-1].view(np.complex64)[...] *= turns.conj()
    packed[:, -1] *= np.float32(np.sqrt(2.0))
    flags = cv2.DFT_ROWS | cv2.DFT_INVERSE | cv2.DFT_SCALE
    return np.asarray(cv2.dft(packed, flags=flags), dtype=np.float32)


def _centred(height: FloatArray, known: BoolArray) -> FloatArray:
    """Take the mean out of each connected part: between parts the height is not determined."""
    count, labels = cv2.connectedComponents(known.astype(np.uint8), connectivity=4)
    total = np.bincount(labels.ravel(), weights=height.ravel(), minlength=count)
    size = np.bincount(labels.ravel(), minlength=count)
    return np.where(known, height - (total / np.maximum(size, 1))[labels], np.nan)
