"""What is printed on calibration boards: names and nominal places of their points. A description, no estimates.

Board frame: x right, y up, z towards the viewer, origin in the middle of the points. Grids are counted row by row from
the top left; of a chessboard the square left above the first inner corner is the black one.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from heliogauge.errors import InputError
from heliogauge.validate import FloatArray, IntArray, float_array, freeze, positive

#: Fewer points than this do not determine a homography with anything to spare.
LEAST_POINTS = 6


class Board(Protocol):
    """What every board describes."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the points, length n."""

    @property
    def points_m(self) -> FloatArray:
        """Nominal places in the board frame, shape (n, 3) [m]; in pitches where the board is not metric."""

    @property
    def is_metric(self) -> bool:
        """Whether the pitch is known in metres; otherwise lengths are in units of the pitch."""

    @property
    def pitch_m(self) -> float:
        """Distance of neighbouring points [m], 1 where the board is not metric."""

    def describe(self) -> str:
        """Say in words what the board is."""


@dataclass(frozen=True, slots=True)
class Chessboard:
    """A chessboard.

    Parameters
    ----------
    columns, rows : int
        Inner corners.
    square_m : float or None, optional
        Side of a square [m]; None: not known, lengths are in squares.

    Raises
    ------
    InputError
        Fewer than 3 corners in a direction, or a side that is not positive.

    Examples
    --------
    >>> Chessboard(9, 6, 0.03).points_m[0]
    array([-0.12 ,  0.075,  0.   ])
    """

    columns: int
    rows: int
    square_m: float | None = None

    def __post_init__(self) -> None:
        _check_grid("chessboard", self.columns, self.rows, "inner corners")
        if self.square_m is not None:
            positive("board square_m", self.square_m, "metres")

    @property
    def names(self) -> tuple[str, ...]:
        """Numbers of the corners, row by row."""
        return tuple(str(number) for number in range(self.columns * self.rows))

    @property
    def points_m(self) -> FloatArray:
        """Nominal places of the corners, shape (n, 3) [m]."""
        return _grid(self.columns, self.rows, self.pitch_m)

    @property
    def is_metric(self) -> bool:
        """Whether the side of a square is known."""
        return self.square_m is not None

    @property
    def pitch_m(self) -> float:
        """Side of a square [m], 1 where it is not known."""
        return 1.0 if self.square_m is None else self.square_m

    @property
    def same_turns(self) -> tuple[int, ...]:
        """Quarter turns after which the print looks the same, 0 first: its corners cannot be distinguished then."""
        if (self.columns + self.rows) % 2:
            return (0,)
        # A quarter turn of an even number of corners swaps the colours.
        return (0, 1, 2, 3) if self.columns == self.rows and self.columns % 2 else (0, 2)

    @property
    def looks_the_same_turned(self) -> bool:
        """Whether the board looks the same turned by half a turn."""
        return len(self.same_turns) > 1

    def describe(self) -> str:
        """Say in words what the board is."""
        return f"chessboard of {self.columns} x {self.rows} inner corners" + _side(self.square_m)


@dataclass(frozen=True, slots=True)
class CharucoBoard:
    """A chessboard with markers in its white squares, as OpenCV lays it out since 4.6.

    dictionary: OpenCV's name of the marker dictionary.
    marker_share: Side of a marker over that of a square.
    square_m: Side of a square [m]; None: not known, lengths are in squares.
    InputError: Fewer than 4 squares in a direction, or markers that do not fit.
    """

    columns: int
    rows: int
    dictionary: str
    marker_share: float
    square_m: float | None = None

    def __post_init__(self) -> None:
        _check_grid("charuco", self.columns - 1, self.rows - 1, "inner corners (one less than squares)")
        if not 0 < self.marker_share < 1:
            raise InputError(
                f"charuco board: the marker's side is {self.marker_share:g} of the square's; it must be smaller"
            )
        if self.square_m is not None:
            positive("board square_m", self.square_m, "metres")

    @property
    def names(self) -> tuple[str, ...]:
        """Numbers of the inner corners, row by row from the top left."""
        return tuple(str(number) for number in range((self.columns - 1) * (self.rows - 1)))

    @property
    def points_m(self) -> FloatArray:
        """Nominal places of the corners, shape (n, 3) [m]."""
        return _grid(self.columns - 1, self.rows - 1, self.pitch_m)

    @property
    def is_metric(self) -> bool:
        """Whether the side of a square is known."""
        return self.square_m is not None

    @property
    def pitch_m(self) -> float:
        """Side of a square [m], 1 where it is not known."""
        return 1.0 if self.square_m is None else self.square_m

    def describe(self) -> str:
        """Say in words what the board is."""
        return f"ChArUco board of {self.columns} x {self.rows} squares, {self.dictionary}" + _side(self.square_m)


@dataclass(frozen=True, slots=True)
class CircleGrid:
    """A grid of dots, in rows and columns or with every second row shifted by half a pitch.

    asymmetric: Odd rows are shifted by half a pitch to the right, and rows are half a pitch apart (OpenCV's
        layout).
    pitch_known_m: Distance of dots in a row [m]; None: not known, lengths are in pitches.
    diameter_share: Diameter of a dot over the pitch.
    InputError: Fewer than 3 dots in a direction, or dots that touch.
    """

    columns: int
    rows: int
    asymmetric: bool = False
    pitch_known_m: float | None = None
    diameter_share: float = 0.5

    def __post_init__(self) -> None:
        _check_grid("circles", self.columns, self.rows, "dots")
        if not 0 < self.diameter_share < (0.7 if self.asymmetric else 1.0):
            raise InputError(f"circle grid: dots of {self.diameter_share:g} pitches touch each other")
        if self.pitch_known_m is not None:
            positive("board pitch_m", self.pitch_known_m, "metres")

    @property
    def names(self) -> tuple[str, ...]:
        """Numbers of the dots, row by row."""
        return tuple(str(number) for number in range(self.columns * self.rows))

    @property
    def points_m(self) -> FloatArray:
        """Nominal places of the dots, shape (n, 3) [m]."""
        if not self.asymmetric:
            return _grid(self.columns, self.rows, self.pitch_m)
        row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
        places = np.stack([column + 0.5 * (row % 2), -0.5 * row, np.zeros(row.size)], axis=1) * self.pitch_m
        middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
        return freeze(places - middle)

    @property
    def is_metric(self) -> bool:
        """Whether the pitch is known."""
        return self.pitch_known_m is not None

    @property
    def pitch_m(self) -> float:
        """Distance of dots in a row [m], 1 where it is not known."""
        return 1.0 if self.pitch_known_m is None else self.pitch_known_m

    @property
    def same_turns(self) -> tuple[int, ...]:
        """Quarter turns after which the print looks the same, 0 first."""
        if self.asymmetric:
            return (0,) if self.rows % 2 else (0, 2)
        return (0, 1, 2, 3) if self.columns == self.rows else (0, 2)

    @property
    def looks_the_same_turned(self) -> bool:
        """Whether the board looks the same turned by half a turn."""
        return len(self.same_turns) > 1

    def describe(self) -> str:
        """Say in words what the board is."""
        kind = "asymmetric circle grid" if self.asymmetric else "circle grid"
        known = f", pitch {1e3 * self.pitch_m:g} mm" if self.is_metric else ", pitch not known"
        return f"{kind} of {self.columns} x {self.rows} dots{known}"


@dataclass(frozen=True, slots=True, eq=False)
class TargetField:
    """A field of coded targets on a plate, with roughly known places.

    names length n: Codes.
    points_m (n, 3): Rough places, near a plane [m].
    is_metric: Whether these are metres.
    InputError: Too few targets, or not as many names as places.
    """

    dictionary: str
    names: tuple[str, ...]
    points_m: FloatArray
    is_metric: bool = True

    def __post_init__(self) -> None:
        points = float_array("target field points_m", self.points_m, (len(self.names), 3))
        if len(points) < LEAST_POINTS:
            raise InputError(f"target field: {len(points)} targets, at least {LEAST_POINTS} are needed")
        object.__setattr__(self, "points_m", points)

    @property
    def pitch_m(self) -> float:
        """Mean distance to the nearest other target [m]."""
        distances = np.linalg.norm(self.points_m[:, None] - self.points_m, axis=2)
        np.fill_diagonal(distances, np.inf)
        return float(distances.min(axis=1).mean())

    def describe(self) -> str:
        """Say in words what the board is."""
        return f"field of {len(self.names)} coded targets, {self.dictionary}"


@dataclass(frozen=True, slots=True, eq=False)
class UnknownField:
    """A plate or room with coded targets of which nothing is known but the dictionary of their codes."""

    dictionary: str


def renumbering(board: Chessboard | CircleGrid, quarter_turns: int) -> IntArray:
    """Return the new number of each point when the board is counted from another corner.

    Returns (n,): ``points_m[new]`` is ``points_m`` turned by so many quarter turns from x to y.

    >>> renumbering(Chessboard(5, 3), 2)[:3]
    array([14, 13, 12])
    """
    count = board.columns * board.rows
    old = np.rot90(np.arange(count).reshape(board.rows, board.columns), quarter_turns).ravel()
    new = np.empty(count, dtype=np.intp)
    new[old] = np.arange(count)
    return new


def _check_grid(kind: str, columns: int, rows: int, what: str) -> None:
    if min(columns, rows) < 3:
        raise InputError(f"{kind} board: {columns} x {rows} {what}, at least 3 x 3 are needed")


def _grid(columns: int, rows: int, pitch_m: float) -> FloatArray:
    row, column = np.divmod(np.arange(columns * rows), columns)
    places = [column - 0.5 * (columns - 1), 0.5 * (rows - 1) - row, np.zeros(row.size)]
    return freeze(np.stack(places, axis=1) * pitch_m)


def _side(square_m: float | None) -> str:
    return ", size of squares not known" if square_m is None else f", squares of {1e3 * square_m:g} mm"
