"""Why a board was not found: what the photo shows instead, so that a wrong number in measurement.toml shows."""

import cv2
import numpy as np
import numpy.typing as npt

from calibration.camera.boards import LEAST_POINTS, CharucoBoard, Chessboard, CircleGrid
from heliogauge.validate import FloatArray, IntArray

#: Boards fill so much of a photo that a thousand pixels show what they are; a large photo would take seconds.
_LONGEST_PX = 1000
_LEAST_MARKERS = 4
#: OpenCV finds the corners of a board whose markers are a quarter smaller or larger than stated; a tenth is the cause
#: of nothing. Middles of markers this far from their places, in squares, are of another board: no size is stated.
_SIZE_DIFFERS, _MISPLACED = 0.1, 0.1

ByteImage = npt.NDArray[np.uint8]


def chessboard_seen(image: ByteImage, board: Chessboard) -> str:
    """Say which chessboard is in a photo instead.

    Shapes: image (height, width).
    board: What was looked for.
    Returns: A sentence; empty where nothing was found.
    """
    small = _reduced(image)
    flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
    found, _, meta = cv2.findChessboardCornersSBWithMeta(small, (3, 3), flags)
    if not found:
        return ""
    rows, columns = np.asarray(meta).shape[:2]
    # A few corners of a board, or of a pattern in the background, say nothing.
    if {rows, columns} == {board.rows, board.columns} or 2 * rows * columns < board.rows * board.columns:
        return ""
    return f"there seems to be one of {max(rows, columns)} x {min(rows, columns)} inner corners"


def circles_seen(image: ByteImage, board: CircleGrid, detector: cv2.SimpleBlobDetector) -> str:
    """Say which grid of dots is in a photo instead.

    Shapes: image (height, width).
    board: What was looked for.
    Returns: A sentence with the size, or with the number of dots; empty where there are hardly any.
    """
    dots = len(detector.detect(image))
    if dots < _LEAST_MARKERS:
        return "hardly any dark round dots were seen"
    layout = cv2.CALIB_CB_ASYMMETRIC_GRID if board.asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
    near = [(board.rows, board.columns)]
    near += [(board.columns + i, board.rows + j) for i, j in ((1, 0), (0, 1), (1, 1), (-1, 0), (0, -1), (-1, -1))]
    for columns, rows in near:
        if min(columns, rows) < 3 or (columns, rows) == (board.columns, board.rows) or columns * rows > dots:
            continue
        flags = layout | cv2.CALIB_CB_CLUSTERING
        if cv2.findCirclesGrid(image, (columns, rows), flags=flags, blobDetector=detector)[0]:
            return f"there seems to be one of {columns} x {rows}"
    return f"{dots} dots were seen, the board has {board.columns * board.rows}"


def markers_seen(image: ByteImage, board: CharucoBoard) -> str:
    """Say which markers are in a photo.

    Shapes: image (height, width).
    board: What was looked for.
    Returns: A sentence: markers of this dictionary with their numbers, of another one, or of this one in a mirror.
    """
    corners, own = _markers(image, board.dictionary)
    if own.size >= _LEAST_MARKERS:
        wanted = board.columns * board.rows // 2
        share = _marker_share(corners, own, board)
        if abs(share - board.marker_share) > _SIZE_DIFFERS * board.marker_share:
            side_mm = 1e3 * board.pitch_m
            stated, square = (
                f"{name}_mm = {one * side_mm:.4g}" for name, one in (("marker", board.marker_share), ("square", 1))
            )
            return (
                f"{stated} is not what it shows: its markers have sides of {share:.2f} of a square, about "
                f"{share * side_mm:.3g} mm with {square}; measure the print and correct it"
            )
        return (
            f"{own.size} markers of {board.dictionary} numbered {own.min()} to {own.max()} were seen, a board of "
            f"{board.columns} x {board.rows} squares has 0 to {wanted - 1}"
        )
    if _markers(np.ascontiguousarray(image[:, ::-1]), board.dictionary)[1].size >= _LEAST_MARKERS:
        return "its markers were seen as mirror images: the photo is the wrong way round"
    for name in (name for name in dir(cv2.aruco) if name.startswith("DICT_") and name != board.dictionary):
        _, other = _markers(image, name)
        if other.size >= _LEAST_MARKERS:
            return f"{other.size} markers of {name} were seen"
    return "hardly any markers were seen"


def _markers(image: ByteImage, dictionary: str) -> tuple[FloatArray, IntArray]:
    """Find markers: their corners, shape (n, 4, 2) [px of the reduced image], and numbers."""
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    corners, ids, _ = cv2.aruco.ArucoDetector(known).detectMarkers(_reduced(image))
    # OpenCV gives None for the numbers of no markers, which its stubs do not know.
    numbers = np.ravel(ids).astype(np.intp) if len(corners) else np.zeros(0, dtype=np.intp)
    return np.reshape(np.asarray(corners, dtype=np.float64), (-1, 4, 2)), numbers


def _marker_share(corners_px: FloatArray, numbers: IntArray, board: CharucoBoard) -> float:
    """Measure the side of the markers over that of the squares; the stated one where their places do not show it.

    The markers' middles have known places whatever their size: the homography from these takes the corners to squares.
    """
    layout = cv2.aruco.CharucoBoard(
        (board.columns, board.rows),
        1.0,
        board.marker_share,
        cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary)),
    )
    places = dict(zip(np.ravel(layout.getIds()).tolist(), layout.getObjPoints(), strict=True))
    listed = np.isin(numbers, list(places))
    if np.count_nonzero(listed) < LEAST_POINTS:
        return board.marker_share
    corners = corners_px[listed]
    middles = np.array([np.mean(places[number], axis=0)[:2] for number in numbers[listed].tolist()])
    if np.linalg.matrix_rank(middles - middles.mean(axis=0)) < 2:
        return board.marker_share
    to_squares, _ = cv2.findHomography(_crossings(corners), middles)
    # OpenCV gives None for none, which its stubs do not know.
    if np.size(to_squares) != 9:
        return board.marker_share
    flat = np.asarray(cv2.perspectiveTransform(corners, to_squares), dtype=np.float64)
    if np.linalg.norm(_crossings(flat) - middles, axis=1).max() > _MISPLACED:
        return board.marker_share
    return float(np.median(np.linalg.norm(flat - np.roll(flat, 1, axis=1), axis=2)))


def _crossings(corners: FloatArray) -> FloatArray:
    """Where the diagonals of quadrangles cross, shape (n, 2): the image of a square's middle."""
    first, second = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
    between = corners[:, 1] - corners[:, 0]
    along = (between[:, 0] * second[:, 1] - between[:, 1] * second[:, 0]) / (
        first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    )
    return np.asarray(corners[:, 0] + along[:, None] * first)


def _reduced(image: ByteImage) -> ByteImage:
    share = _LONGEST_PX / max(image.shape)
    if share >= 1:
        return image
    reduced = cv2.resize(image, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    return np.asarray(reduced, dtype=np.uint8)
