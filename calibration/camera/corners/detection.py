"""Find a board in a photo: start from OpenCV's detectors, order that is the same in every photo, own sub-pixel fit."""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import numpy.typing as npt

from calibration.camera.boards import LEAST_POINTS, CharucoBoard, Chessboard, CircleGrid
from calibration.camera.corners.corner_fit import CornerStart, fit_corners
from calibration.camera.corners.failures import chessboard_seen, circles_seen, markers_seen
from heliogauge.errors import EstimationError
from heliogauge.validate import FloatArray, IntArray, freeze

#: Half width of the piece of the image a corner is fitted to, in sides of a square.
REACH = 0.42
#: Share of the white between a ChArUco board's edges and its markers that is used: the markers' edges are blurred.
_MARKER_CLEARANCE = 0.8

ByteImage = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class BoardPoints:
    """Points of a board in one photo.

    Parameters
    ----------
    photo : str
        Name of the photo.
    index : ndarray of int, shape (n,)
        Which points of the board these are.
    pixels_px : ndarray, shape (n, 2)
        Their places [px].
    covariance_px2 : ndarray, shape (n, 2, 2)
        Their covariances [px^2].
    blur_px : float
        Median blur of the edges [px].
    saturated_share : float
        Share of the board's pixels at the largest value of the image.
    ellipses_px2 : ndarray, shape (n, 2, 2)
        Shape of each target's ellipse, NaN where there is none; empty for boards without targets [px^2].
    """

    photo: str
    index: IntArray
    pixels_px: FloatArray
    covariance_px2: FloatArray
    blur_px: float = float("nan")
    saturated_share: float = 0.0
    ellipses_px2: FloatArray = field(default_factory=lambda: np.zeros((0, 2, 2)))

    @property
    def n(self) -> int:
        """Number of points."""
        return int(self.index.size)

    def subset(self, keep: npt.NDArray[np.bool_]) -> "BoardPoints":
        """Return some of the points."""
        ellipses = self.ellipses_px2[keep] if len(self.ellipses_px2) else self.ellipses_px2
        return replace(
            self,
            index=self.index[keep],
            pixels_px=self.pixels_px[keep],
            covariance_px2=self.covariance_px2[keep],
            ellipses_px2=ellipses,
        )


def as_bytes(image: npt.NDArray[np.generic]) -> ByteImage:
    """Return an image as 8 bit for detectors that take nothing else; the brightest pixel becomes 255."""
    if image.dtype == np.uint8:
        return np.ascontiguousarray(image, dtype=np.uint8)
    values = np.asarray(image, dtype=np.float32)
    return np.asarray(np.clip(values * (255.0 / max(float(values.max()), 1e-6)), 0, 255), dtype=np.uint8)


def find_chessboard(photo: str, image: npt.NDArray[np.generic], board: Chessboard) -> BoardPoints:
    """Find a chessboard.

    Parameters
    ----------
    photo : str
        Name of the photo.
    image : ndarray, shape (height, width)
        Grey values [DN].
    board : Chessboard
        What to look for.

    Returns
    -------
    BoardPoints
        Its corners; those whose fit failed are left out.

    Raises
    ------
    EstimationError
        The board was not found.
    """
    size = (board.columns, board.rows)
    small = as_bytes(image)
    # The quick detector answers in 20 ms on a board of 18 x 23, the thorough one in a second.
    found, corners = cv2.findChessboardCorners(small, size)
    if not found:
        found, corners = cv2.findChessboardCornersSB(
            small, size, flags=cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_NORMALIZE_IMAGE
        )
    if not found:
        instead = chessboard_seen(small, board)
        raise EstimationError(
            f"{photo}: no chessboard of {board.columns} x {board.rows} inner corners was found"
            + (f"; {instead}" if instead else " (all of it must be in the photo, sharp)")
        )
    grid = np.asarray(corners, dtype=np.float64).reshape(board.rows, board.columns, 2)
    grid = _in_order(small, grid)
    return fitted(photo, image, grid)


def find_charuco(photo: str, image: npt.NDArray[np.generic], board: CharucoBoard) -> BoardPoints:
    """Find what is visible of a ChArUco board.

    image (height, width): Grey values [DN].
    EstimationError: Too few corners were found.
    """
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    layout = cv2.aruco.CharucoBoard((board.columns, board.rows), 1.0, board.marker_share, dictionary)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(layout).detectBoard(as_bytes(image))
    # OpenCV gives None for none, which its stubs do not know.
    count = np.size(ids) if np.size(corners) > 1 else 0
    if count < LEAST_POINTS:
        raise EstimationError(
            f"{photo}: {count} corners of the ChArUco board were found, {LEAST_POINTS} are needed; "
            + markers_seen(as_bytes(image), board)
        )
    grid = np.full(((board.rows - 1) * (board.columns - 1), 2), np.nan)
    index = np.ravel(ids).astype(np.intp)
    grid[index] = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    shape = (board.rows - 1, board.columns - 1)
    clear = 0.5 * (1 - board.marker_share) * _MARKER_CLEARANCE
    return fitted(photo, image, grid.reshape(*shape, 2), clear=clear)


def find_circles(photo: str, image: npt.NDArray[np.generic], board: CircleGrid) -> BoardPoints:
    """Find the rough places of the dots of a grid; the pipeline measures their centres.

    image (height, width): Grey values [DN].
    Returns: All dots, with a covariance of a tenth of a pixel.
    EstimationError: The grid was not found.
    """
    layout = cv2.CALIB_CB_ASYMMETRIC_GRID if board.asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
    parameters = cv2.SimpleBlobDetector.Params()
    parameters.maxArea = 0.02 * image.size
    parameters.minArea = 20
    small, size = as_bytes(image), (board.columns, board.rows)
    detector = cv2.SimpleBlobDetector.create(parameters)
    # Clustering copes with more perspective, the other way with dots around the board; neither finds all.
    for way in (cv2.CALIB_CB_CLUSTERING, 0):
        found, centers = cv2.findCirclesGrid(small, size, flags=layout | way, blobDetector=detector)
        if found:
            break
    if not found:
        raise EstimationError(
            f"{photo}: no {board.describe()} was found (all of it must be in the photo, dark dots on light ground); "
            + circles_seen(small, board, detector)
        )
    grid = np.asarray(centers, dtype=np.float64).reshape(board.rows, board.columns, 2)
    if board.looks_the_same_turned:
        grid = _upright(_handed(grid))
    count = board.columns * board.rows
    covariance = np.tile(0.01 * np.eye(2), (count, 1, 1))
    return BoardPoints(photo, np.arange(count), freeze(grid.reshape(-1, 2)), covariance)


def fitted(photo: str, image: npt.NDArray[np.generic], grid_px: FloatArray, *, clear: float = np.inf) -> BoardPoints:
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
    if np.count_nonzero(result.found) < LEAST_POINTS:
        raise EstimationError(
            f"{photo}: only {np.count_nonzero(result.found)} of {usable.size} corners are sharp enough to be measured"
        )
    # Now that corners are known to a hundredth of a pixel they tell how the edges are bent.
    fine = np.full_like(flat, np.nan)
    fine[usable] = result.pixels_px
    bent = edge_curvatures(fine.reshape(grid_px.shape)).reshape(-1, 2)[usable]
    second = CornerStart(
        np.where(result.found[:, None], fine[usable], flat[usable]), start.along_x, start.along_y, bent
    )
    result = fit_corners(values, second, reach=REACH, clear=clear)
    good = result.found
    return BoardPoints(
        photo,
        usable[good],
        freeze(result.pixels_px[good]),
        freeze(result.covariance_px2[good]),
        float(np.median(result.blur_px[good])),
    )


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


def _handed(grid: FloatArray) -> FloatArray:
    """Reverse the rows where they would run up as seen from the front: a photo is never mirrored."""
    across, down = np.nanmean(_sides(grid, 1), axis=(0, 1)), np.nanmean(_sides(grid, 0), axis=(0, 1))
    return grid if across[0] * down[1] - across[1] * down[0] > 0 else grid[::-1]


def _turns(grid: FloatArray) -> list[FloatArray]:
    """Return the ways a grid of this shape can be numbered: half a turn, quarter turns where it is square."""
    quarters = (0, 1, 2, 3) if grid.shape[0] == grid.shape[1] else (0, 2)
    return [np.rot90(grid, quarter, axes=(0, 1)) for quarter in quarters]


def _upright(grid: FloatArray) -> FloatArray:
    """Choose the numbering whose rows run most to the right in the image, where nothing else tells them apart."""
    return max(_turns(grid), key=lambda one: float(np.mean(np.diff(one, axis=1)[..., 0])))


def _in_order(image: ByteImage, grid: FloatArray) -> FloatArray:
    """Return the grid numbered so that the square left above the first corner is dark; upright where that is open."""
    turns = _turns(_handed(grid))
    dark = [one for one in turns if _first_square_is_dark(image, one)]
    chosen = dark or turns
    return chosen[0] if len(chosen) == 1 else max(chosen, key=lambda one: float(np.mean(np.diff(one, axis=1)[..., 0])))


def _first_square_is_dark(image: ByteImage, grid: FloatArray) -> bool:
    """Compare squares of both colours all over the board: those like the first one against the others."""
    middles = 0.25 * (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:])
    height, width = image.shape
    columns = np.clip(np.rint(middles[..., 0]).astype(int), 0, width - 1)
    rows = np.clip(np.rint(middles[..., 1]).astype(int), 0, height - 1)
    values = image[rows, columns].astype(np.float64)
    # The square right below the first corner touches the first square in that corner: it has the same colour.
    like_first = np.add.outer(np.arange(values.shape[0]), np.arange(values.shape[1])) % 2 == 0
    return bool(np.mean(values[like_first]) < np.mean(values[~like_first]))
