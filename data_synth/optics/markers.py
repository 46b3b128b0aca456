"""Square markers and calibration boards as lattices of cells; the bits come from OpenCV's tables, the areas do not."""

import cv2
import numpy as np

from data_synth.optics.prints import LatticePrint
from heliogauge.errors import InputError
from heliogauge.validate import BoolArray, positive

#: Corners of a marker in its own order: clockwise from the top left as seen upright.
_CORNERS = ((-0.5, 0.5), (0.5, 0.5), (0.5, -0.5), (-0.5, -0.5))


def marker_cells(dictionary: str, number: int) -> BoolArray:
    """Return the cells of a square marker, its black border included.

    dictionary: OpenCV's name: ``DICT_4X4_50``, ``DICT_APRILTAG_36h11``...
    Returns (n, n): True where it is black, rows from the top.
    InputError: No such dictionary or number.
    """
    if not dictionary.startswith("DICT_") or not hasattr(cv2.aruco, dictionary):
        raise InputError(f"marker dictionary {dictionary!r}: OpenCV's name is needed, e.g. DICT_4X4_100")
    table = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    if not 0 <= number < len(table.bytesList):
        raise InputError(f"marker {number}: {dictionary} goes from 0 to {len(table.bytesList) - 1}")
    image = cv2.aruco.generateImageMarker(table, number, table.markerSize + 2, borderBits=1)
    return np.asarray(image == 0)


def marker_print(dictionary: str, number: int, side_m: float) -> LatticePrint:
    """Return a square marker; its points are ``.0`` to ``.3``, the corners in the marker's own order.

    dictionary: OpenCV's name of the dictionary.
    InputError: No such dictionary or number, or an impossible size.
    """
    cells = marker_cells(dictionary, number)
    edges = np.linspace(-0.5, 0.5, cells.shape[0] + 1) * positive("marker side_m", side_m, "metres")
    corners = {f".{k}": (x * side_m, y * side_m) for k, (x, y) in enumerate(_CORNERS)}
    return LatticePrint(edges, -edges, cells, side_m / 6, corners)


def chessboard_print(columns: int, rows: int, square_m: float) -> LatticePrint:
    """Return a chessboard; its points are the inner corners, row by row from the top left, the first square black."""
    x, y = _square_edges(columns, rows, square_m)
    cells = np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 0
    return LatticePrint(x, y, cells, square_m, _inner_corners(columns, rows, square_m))


def charuco_print(columns: int, rows: int, square_m: float, marker_m: float, dictionary: str) -> LatticePrint:
    """Return a ChArUco board as OpenCV lays it out since 4.6; its points are the inner corners.

    square_m, marker_m: Side of a square and of the marker in each white one [m].
    dictionary: OpenCV's name of the marker dictionary.
    InputError: The markers do not fit into the squares, or the dictionary has too few.
    """
    if not 0 < marker_m < square_m:
        raise InputError(f"ChArUco board: markers of {marker_m} m do not fit into squares of {square_m} m")
    n = marker_cells(dictionary, 0).shape[0]
    inner = (square_m - marker_m) / 2 + np.arange(n + 1) * marker_m / n
    within = np.concatenate([[0.0], inner])
    x = np.concatenate([*(column * square_m + within for column in range(columns)), [columns * square_m]])
    y = np.concatenate([*(row * square_m + within for row in range(rows)), [rows * square_m]])
    cells = np.zeros((rows * (n + 2), columns * (n + 2)), dtype=np.bool_)
    number = 0
    for row in range(rows):
        for column in range(columns):
            square = cells[row * (n + 2) : (row + 1) * (n + 2), column * (n + 2) : (column + 1) * (n + 2)]
            if (row + column) % 2 == 0:
                square[:] = True
            else:
                square[1:-1, 1:-1] = marker_cells(dictionary, number)
                number += 1
    middle = (columns * square_m / 2, rows * square_m / 2)
    corners = _inner_corners(columns, rows, square_m)
    return LatticePrint(x - middle[0], middle[1] - y, cells, square_m / 2, corners)


def _square_edges(columns: int, rows: int, square_m: float) -> tuple[np.ndarray, np.ndarray]:
    if columns < 3 or rows < 3:
        raise InputError(f"board: at least 3 x 3 squares are needed, not {columns} x {rows}")
    positive("board square_m", square_m, "metres")
    return (np.arange(columns + 1) - columns / 2) * square_m, (rows / 2 - np.arange(rows + 1)) * square_m


def _inner_corners(columns: int, rows: int, square_m: float) -> dict[str, tuple[float, float]]:
    x, y = _square_edges(columns, rows, square_m)
    places = [(float(across), float(up)) for up in y[1:-1] for across in x[1:-1]]
    return {str(number): place for number, place in enumerate(places)}
