"""Why a board was not found: what the photo shows instead, so that a wrong number in measurement.toml shows."""

import cv2
import numpy as np
import numpy.typing as npt

from calibration.camera.boards import CharucoBoard, Chessboard, CircleGrid
from heliogauge.validate import IntArray

#: Boards fill so much of a photo that a thousand pixels show what they are; a large photo would take seconds.
_LONGEST_PX = 1000
_LEAST_MARKERS = 4

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
    own = _marker_numbers(image, board.dictionary)
    if own.size >= _LEAST_MARKERS:
        wanted = board.columns * board.rows // 2
        return (
            f"{own.size} markers of {board.dictionary} numbered {own.min()} to {own.max()} were seen, a board of "
            f"{board.columns} x {board.rows} squares has 0 to {wanted - 1}"
        )
    if _marker_numbers(np.ascontiguousarray(image[:, ::-1]), board.dictionary).size >= _LEAST_MARKERS:
        return "its markers were seen as mirror images: the photo is the wrong way round"
    for name in (name for name in dir(cv2.aruco) if name.startswith("DICT_") and name != board.dictionary):
        other = _marker_numbers(image, name)
        if other.size >= _LEAST_MARKERS:
            return f"{other.size} markers of {name} were seen"
    return "hardly any markers were seen"


def _marker_numbers(image: ByteImage, dictionary: str) -> IntArray:
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    corners, ids, _ = cv2.aruco.ArucoDetector(known).detectMarkers(_reduced(image))
    # OpenCV gives None for the numbers of no markers, which its stubs do not know.
    return np.ravel(ids).astype(np.intp) if len(corners) else np.zeros(0, dtype=np.intp)


def _reduced(image: ByteImage) -> ByteImage:
    share = _LONGEST_PX / max(image.shape)
    if share >= 1:
        return image
    reduced = cv2.resize(image, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    return np.asarray(reduced, dtype=np.uint8)
