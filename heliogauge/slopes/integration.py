"""Height from slopes: least squares on a grid with gaps."""

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.errors import EstimationError
from heliogauge.validate import BoolArray, FloatArray

#: Conjugate gradients stop when the residual has fallen by this factor: 1e-8 of a 1 mm height is 10 pm.
TOLERANCE = 1e-8
MAX_ITERATIONS = 400


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
    pair_x, pair_y = known[:, 1:] & known[:, :-1], known[1:] & known[:-1]
    if not (pair_x.any() or pair_y.any()):
        raise EstimationError("height: no two neighbouring nodes have slopes; use a finer grid or check the flags")
    target_x = np.where(pair_x, 0.5 * step_m[0] * (slope_x[:, 1:] + slope_x[:, :-1]), 0.0)
    target_y = np.where(pair_y, 0.5 * step_m[1] * (slope_y[1:] + slope_y[:-1]), 0.0)
    height = _solve(_divergence(target_x, target_y), pair_x, pair_y)
    return _centred(height, known)


def _divergence(along_x: FloatArray, along_y: FloatArray) -> FloatArray:
    """Apply the transpose of the neighbour differences."""
    total = np.zeros((along_x.shape[0], along_y.shape[1]))
    total[:, 1:] += along_x
    total[:, :-1] -= along_x
    total[1:] += along_y
    total[:-1] -= along_y
    return total


def _solve(right: FloatArray, pair_x: BoolArray, pair_y: BoolArray) -> FloatArray:
    """Preconditioned conjugate gradients on the normal equations of the neighbour differences."""
    eigenvalues = _laplace_eigenvalues(right.shape)
    height = np.zeros_like(right)
    residual = right.copy()
    limit = TOLERANCE * float(np.linalg.norm(right))
    direction, energy = np.zeros_like(right), 1.0
    for iteration in range(MAX_ITERATIONS):
        if float(np.linalg.norm(residual)) <= limit:
            return height
        smooth = _poisson(residual, eigenvalues)
        previous, energy = energy, float(np.vdot(residual, smooth))
        direction = smooth + (energy / previous * direction if iteration else 0.0)
        image = _divergence(np.diff(direction, axis=1) * pair_x, np.diff(direction, axis=0) * pair_y)
        step = energy / float(np.vdot(direction, image))
        height += step * direction
        residual -= step * image
    raise EstimationError(
        f"height: {MAX_ITERATIONS} rounds left {np.linalg.norm(residual) / np.linalg.norm(right):.1e} of the slopes; "
        "the measured area is too torn to integrate"
    )


def _laplace_eigenvalues(shape: tuple[int, int]) -> npt.NDArray[np.float32]:
    """Return the eigenvalues of the Neumann Laplacian on an even grid whose cosine transform is quick."""
    rows, columns = (2 * cv2.getOptimalDFTSize((size + 1) // 2) for size in shape)
    along_y = 2.0 - 2.0 * np.cos(np.pi * np.arange(rows) / rows)
    along_x = 2.0 - 2.0 * np.cos(np.pi * np.arange(columns) / columns)
    eigenvalues = along_y[:, None] + along_x[None, :]
    eigenvalues[0, 0] = np.inf
    return eigenvalues.astype(np.float32)


def _poisson(right: FloatArray, eigenvalues: npt.NDArray[np.float32]) -> FloatArray:
    """Solve the gap-free problem; single precision, as it only steers the rounds."""
    rows, columns = right.shape
    padded = np.zeros(eigenvalues.shape, dtype=np.float32)
    scale = float(np.abs(right).max()) or 1.0
    padded[:rows, :columns] = right / scale
    found = cv2.dct(cv2.dct(padded) / eigenvalues, flags=cv2.DCT_INVERSE)[:rows, :columns]
    return np.asarray(found * scale, dtype=np.float64)


def _centred(height: FloatArray, known: BoolArray) -> FloatArray:
    """Take the mean out of each connected part: between parts the height is not determined."""
    count, labels = cv2.connectedComponents(known.astype(np.uint8), connectivity=4)
    total = np.bincount(labels.ravel(), weights=height.ravel(), minlength=count)
    size = np.bincount(labels.ravel(), minlength=count)
    return np.where(known, height - (total / np.maximum(size, 1))[labels], np.nan)
