"""Find a board in a photo: start from OpenCV's detectors, order that is the same in every photo, own sub-pixel fit."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import numpy.typing as npt

from calibration.camera.boards import LEAST_POINTS, CharucoBoard, Chessboard, CircleGrid
from calibration.camera.corners.failures import chessboard_seen, circles_seen, markers_seen
from heliogauge.errors import EstimationError
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, IntArray, freeze
from photogrammetry.detection import board_corners

ByteImage = npt.NDArray[np.uint8]

#: The smallest board has 3 x 3 squares, which 10 px each show; OpenCV fails below 15 px in all.
_LEAST_SIDE_PX = 30


@dataclass(frozen=True, slots=True, eq=False)
class BoardPoints(ShortRepr):
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


@dataclass(frozen=True, slots=True, eq=False)
class FoundBoards:
    """What all photos show.

    points: The board in each photo that shows it. For an `UnknownField` the points' numbers are those in ``names``.
    failures: Why the others do not, by the photo's name.
    size_px: Width and height of all photos [px].
    names: Names of an `UnknownField`'s targets; empty otherwise.
    thumbnails: Small JPEG of each photo, by its name.
    """

    points: tuple[BoardPoints, ...]
    failures: Mapping[str, str]
    size_px: tuple[int, int]
    names: tuple[str, ...] = ()
    thumbnails: Mapping[str, bytes] = field(default_factory=dict)


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
    small = board_corners.as_bytes(image)
    if min(small.shape) < _LEAST_SIDE_PX:
        raise EstimationError(
            f"{photo}: {small.shape[1]} x {small.shape[0]} px are too few to show a chessboard; is it a thumbnail?"
        )
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
    return _points(photo, board_corners.fit_grid(photo, image, _in_order(small, grid)))


def _points(photo: str, found: board_corners.GridCorners) -> BoardPoints:
    return BoardPoints(photo, found.index, found.pixels_px, found.covariance_px2, found.blur_px)


def find_charuco(photo: str, image: npt.NDArray[np.generic], board: CharucoBoard) -> BoardPoints:
    """Find what is visible of a ChArUco board.

    image (height, width): Grey values [DN].
    EstimationError: Too few corners were found.
    """
    fault = f"{photo}: fewer than {LEAST_POINTS} corners of the ChArUco board were found"
    try:
        found = board_corners.find_charuco(
            photo, image, board.columns, board.rows, board.dictionary, board.marker_share
        )
    except EstimationError as error:
        found, fault = None, str(error)
    if found is None:
        raise EstimationError(f"{fault}; {markers_seen(board_corners.as_bytes(image), board)}")
    return _points(photo, found)


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
    small, size = board_corners.as_bytes(image), (board.columns, board.rows)
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


def _handed(grid: FloatArray) -> FloatArray:
    """Reverse the rows where they would run up as seen from the front: a photo is never mirrored."""
    across, down = np.diff(grid, axis=1).mean(axis=(0, 1)), np.diff(grid, axis=0).mean(axis=(0, 1))
    return grid if across[0] * down[1] - across[1] * down[0] > 0 else grid[::-1]


def _turns(grid: FloatArray) -> list[FloatArray]:
    """Return the ways a grid of this shape can be numbered: half a turn, quarter turns where it is square."""
    quarters = (0, 1, 2, 3) if grid.shape[0] == grid.shape[1] else (0, 2)
    return [np.rot90(grid, quarter, axes=(0, 1)) for quarter in quarters]


def _upright(grid: FloatArray) -> FloatArray:
    """Choose the numbering whose rows run most to the right in the image, where nothing else distinguishes them."""
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
