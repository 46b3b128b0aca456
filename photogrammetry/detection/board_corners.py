"""Corners of the squares of a board: found by OpenCV on a ChArUco board, fitted to a hundredth of a pixel on any."""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.errors import EstimationError
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, IntArray, freeze
from photogrammetry.detection.corner_fit import CornerStart, FittedCorners, fit_corners

#: Half width of the piece of the image a corner is fitted to, in sides of a square.
REACH = 0.42
#: Corners that a board must show to be used.
LEAST_CORNERS = 6
#: Share of the white between a ChArUco board's edges and its markers that is used: the markers' edges are blurred.
_MARKER_CLEARANCE = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class GridCorners(ShortRepr):
    """Measured corners of a grid.

    index (n,): Which corners these are, counted row by row.
    pixels_px (n, 2): Their places [px].
    covariance_px2 (n, 2, 2): Their covariances [px^2].
    blur_px: Median blur of the edges [px].
    """

    index: IntArray
    pixels_px: FloatArray
    covariance_px2: FloatArray
    blur_px: float


def as_bytes(image: npt.NDArray[np.generic]) -> npt.NDArray[np.uint8]:
    """Return an image as 8 bit for detectors that take nothing else; the brightest pixel becomes 255."""
    if image.dtype == np.uint8:
        return np.ascontiguousarray(image, dtype=np.uint8)
    values = np.asarray(image, dtype=np.float32)
    return np.asarray(np.clip(values * (255.0 / max(float(values.max()), 1e-6)), 0, 255), dtype=np.uint8)


def find_charuco(
    photo: str, image: npt.NDArray[np.generic], columns: int, rows: int, dictionary: str, marker_share: float
) -> GridCorners | None:
    """Measure what is visible of the inner corners of a ChArUco board.

    image (height, width): Grey values [DN].
    columns, rows: Squares of the board, as OpenCV lays it out since 4.6.
    dictionary: OpenCV's name of the marker dictionary.
    marker_share: Side of a marker over that of a square.
    Returns: None where fewer than six corners were found.
    EstimationError: Fewer are sharp.
    """
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    layout = cv2.aruco.CharucoBoard((columns, rows), 1.0, marker_share, known)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(layout).detectBoard(as_bytes(image))
    # OpenCV gives None for none, which its stubs do not know.
    if np.size(corners) <= 1 or np.size(ids) < LEAST_CORNERS:
        return None
    grid = np.full(((rows - 1) * (columns - 1), 2), np.nan)
    grid[np.ravel(ids).astype(np.intp)] = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    clear = 0.5 * (1 - marker_share) * _MARKER_CLEARANCE
    return fit_grid(photo, image, grid.reshape(rows - 1, columns - 1, 2), clear=clear)


def fit_grid(photo: str, image: npt.NDArray[np.generic], grid_px: FloatArray, *, clear: float = np.inf) -> GridCorners:
    """Fit all corners of a grid.

    image (height, width): Grey values [DN].
    grid_px (rows, columns, 2): Rough corners, row by row as the board counts them, NaN where there is none [px].
    EstimationError: Too few.
    """
    along_x, along_y = (_sides(grid_px, axis).reshape(-1, 2) for axis in (1, 0))
    flat = grid_px.reshape(-1, 2)
    usable = np.nonzero(np.isfinite(np.hstack([flat, along_x, along_y])).all(axis=1))[0]
    values = np.asarray(image, dtype=np.float64)
    start = CornerStart(flat[usable], along_x[usable], along_y[usable], np.zeros((usable.size, 2)))
    result = fit_corners(values, start, reach=REACH, clear=clear, rough=True)
    _require_sharp(photo, result)
    # Now that corners are known to a hundredth of a pixel they show how the edges are bent.
    fine = np.full_like(flat, np.nan)
    fine[usable] = result.pixels_px
    bent = edge_curvatures(fine.reshape(grid_px.shape)).reshape(-1, 2)[usable]
    second = CornerStart(
        np.where(result.found[:, None], fine[usable], flat[usable]), start.along_x, start.along_y, bent
    )
    result = fit_corners(values, second, reach=REACH, clear=clear)
    _require_sharp(photo, result)
    good = result.found
    return GridCorners(
        usable[good],
        freeze(result.pixels_px[good]),
        freeze(result.covariance_px2[good]),
        float(np.median(result.blur_px[good])),
    )


def _require_sharp(photo: str, fitted: FittedCorners) -> None:
    sharp = np.count_nonzero(fitted.found)
    if sharp < LEAST_CORNERS:
        raise EstimationError(f"{photo}: only {sharp} of {fitted.found.size} corners are sharp enough to be measured")


def edge_curvatures(grid_px: FloatArray) -> FloatArray:
    """Estimate how lens and board bend the edges, from corners.

    grid_px (rows, columns, 2): Corners, NaN where there is none [px].
    Returns (rows, columns, 2): Curvature of the edges along rows and along columns, positive towards the direction
        of the edge turned from x to y by a right angle [1/px].

    A view of a straight line is straight whatever the perspective, so the second difference of three corners across
    the line is bending. What varies from corner to corner is the print (0.1 px on a real board): a quadratic over the
    board is fitted and only that is used.
    """
    rows, columns = np.indices(grid_px.shape[:2])
    r, c = (2 * index / max(index.max(), 1) - 1 for index in (rows, columns))
    terms = np.stack([np.ones(r.shape), r, c, r * r, r * c, c * c], axis=-1)
    found = np.zeros(grid_px.shape)
    for place, axis in enumerate((1, 0)):
        low, middle, high = (_shifted(grid_px, axis, step) for step in (-1, 0, 1))
        chord = 0.5 * (high - low)
        length = np.linalg.norm(chord, axis=-1)
        second = high - 2 * middle + low
        across = (chord[..., 0] * second[..., 1] - chord[..., 1] * second[..., 0]) / length**3
        good = np.isfinite(across)
        if np.count_nonzero(good) >= 2 * terms.shape[-1]:
            found[..., place] = terms @ np.linalg.lstsq(terms[good], across[good], rcond=None)[0]
    return found


def _shifted(grid: FloatArray, axis: int, step: int) -> FloatArray:
    """Return each corner's neighbour along an axis, NaN beyond the border."""
    moved = np.full_like(grid, np.nan)
    count = grid.shape[axis]
    target, source = [slice(None)] * 3, [slice(None)] * 3
    target[axis], source[axis] = slice(max(-step, 0), count - max(step, 0)), slice(max(step, 0), count - max(-step, 0))
    moved[tuple(target)] = grid[tuple(source)]
    return moved


def _sides(grid: FloatArray, axis: int) -> FloatArray:
    """Mean step to both neighbours along an axis, or to the one that is there, shape (rows, columns, 2)."""
    steps = np.diff(grid, axis=axis)
    pad = [(0, 0)] * 3
    pad[axis] = (1, 1)
    padded = np.pad(steps, pad, constant_values=np.nan)
    before, after = (np.take(padded, range(k, k + grid.shape[axis]), axis=axis) for k in (0, 1))
    both = 0.5 * (before + after)
    return np.where(np.isfinite(both), both, np.where(np.isfinite(before), before, after))
