"""What is printed where: ring codes, markers, calibration boards, and the rulers that check the printer."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import pi
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.validate import positive
from photogrammetry.targets.ring_codes import Polarity, RingCode
from photogrammetry.targets.vector_page import Area, Label, Page, Path, disc, rectangle, ring_sector

PAPERS_MM = {"A4": (210.0, 297.0), "A3": (297.0, 420.0), "letter": (215.9, 279.4)}
BOARDS = ("chessboard", "charuco", "circles", "circles-asymmetric")

_MARGIN_MM = 12.0
#: Room for the ruler at the foot and beside, and for the title.
_RULER_MM = 100.0
_FOOT_MM = 12.0
_HEAD_MM = 8.0
_LABEL_MM = 5.0


class Frame(NamedTuple):
    """A rectangle on paper [mm]."""

    left: float
    top: float
    width: float
    height: float


@dataclass(frozen=True, slots=True)
class Paper:
    """A sheet of paper.

    name: ``A4``, ``A3`` or ``letter``.
    landscape: Turned on its side.
    InputError: No such paper.
    """

    name: str = "A4"
    landscape: bool = False

    def __post_init__(self) -> None:
        if self.name not in PAPERS_MM:
            raise InputError(f"paper {self.name!r}: one of {', '.join(PAPERS_MM)} is needed")

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height [mm]."""
        width, height = PAPERS_MM[self.name]
        return (height, width) if self.landscape else (width, height)

    @property
    def frame_mm(self) -> Frame:
        """What may be printed on between title and rulers."""
        width, height = self.size_mm
        left, top = _MARGIN_MM + _FOOT_MM, _MARGIN_MM + _HEAD_MM
        return Frame(left, top, width - left - _MARGIN_MM, height - top - _MARGIN_MM - _FOOT_MM)

    def page(self, title: str, areas: Sequence[Area], labels: Sequence[Label]) -> Page:
        """Return a page with title and rulers around its content."""
        width, height = self.size_mm
        ruler = (*_ruler(_MARGIN_MM + _FOOT_MM, height - _MARGIN_MM - 5), *_upright_ruler(_MARGIN_MM, height - 30))
        text = f"{_RULER_MM:g} mm both ways? If not, print again at 100 % (actual size)."
        about = Label(_MARGIN_MM + _FOOT_MM + _RULER_MM + 4, height - _MARGIN_MM - 2, text, 2.6)
        head = Label(_MARGIN_MM + _FOOT_MM, _MARGIN_MM + 3, title, 3.2)
        return Page(width, height, (*areas, Area(ruler)), (*labels, about, head))


def ring_pages(
    codes: Sequence[RingCode], dot_mm: float, paper: Paper, *, title: str, polarity: Polarity = Polarity.BLACK_ON_WHITE
) -> list[Page]:
    """Lay out ring-coded targets, each with its name and its word.

    dot_mm: Diameter of the dot; the ring's is three times, the quiet zone's four times as large [mm].
    title: What stands at the top, the dictionary's name for instance.
    polarity: Black on white, or white on black.
    InputError: Not one target fits on the paper.
    """
    side = codes[0].radii.quiet * positive("dot_mm", dot_mm, "mm") if codes else 0.0
    dark = polarity is Polarity.WHITE_ON_BLACK
    pages = []
    for number, group in enumerate(_places(len(codes), side, paper), start=1):
        areas, labels = [], []
        for index, (left, top) in group:
            code = codes[index]
            center = (left + side / 2, top + side / 2)
            if dark:
                areas.append(Area((rectangle(left, top, side, side),)))
            areas.append(Area(ring_paths(code, center, dot_mm / 2), 1.0 if dark else 0.0))
            # The number names the target; the word distinguishes dictionaries with other numbers.
            labels.append(Label(left + 0.5, top + side + 3.4, f"{code.name}  (word {code.word})", 3.0))
        text = f"{title}, {polarity}, dot {dot_mm:g} mm, page {number}"
        pages.append(paper.page(text, areas, labels))
    return pages


def ring_paths(code: RingCode, center_mm: tuple[float, float], radius_mm: float) -> tuple[Path, ...]:
    """Return the outlines of a target's ink.

    center_mm: Its centre on the page [mm].
    Returns: The dot and the arcs of the code ring.
    """
    radii = (code.radii.inner * radius_mm, code.radii.outer * radius_mm)
    arcs = code.arcs_rad()
    if arcs == ((0.0, 2 * pi),):
        arcs = ((0.0, pi), (pi, 2 * pi))
    return (disc(*center_mm, radius_mm), *(ring_sector(center_mm, radii, arc) for arc in arcs))


def marker_pages(dictionary: str, numbers: Sequence[int], side_mm: float, paper: Paper) -> list[Page]:
    """Lay out ArUco or AprilTag markers, each with its number.

    dictionary: OpenCV's name: ``DICT_4X4_100``, ``DICT_APRILTAG_36h11``...
    side_mm: Side of the black square [mm].
    InputError: No such dictionary or marker, or not one fits on the paper.
    """
    positive("marker side_mm", side_mm, "mm")
    cells = [marker_cells(dictionary, number) for number in numbers]
    quiet = side_mm / cells[0].shape[0] if cells else 0.0
    side = side_mm + 2 * quiet
    pages = []
    for page, group in enumerate(_places(len(cells), side, paper), start=1):
        areas = [Area(tuple(_cell_paths(cells[k], (left + quiet, top + quiet), side_mm))) for k, (left, top) in group]
        labels = [Label(left + quiet, top + side + 3, f"{dictionary} {numbers[k]}") for k, (left, top) in group]
        pages.append(paper.page(f"{dictionary}, {side_mm:g} mm, page {page}", areas, labels))
    return pages


def board_page(
    kind: str, columns: int, rows: int, pitch_mm: float, paper: Paper, *, dictionary: str = "DICT_5X5_100"
) -> Page:
    """Lay out a calibration board in the middle of the paper.

    kind: ``chessboard`` and ``charuco`` (columns and rows of squares, pitch = square, markers 0.7 of it),
        ``circles`` and ``circles-asymmetric`` (circles a row, rows, pitch within a row; diameter half and a third
        of it).
    pitch_mm: Side of a square, or distance of the circles in a row [mm].
    dictionary: Markers of a ChArUco board, OpenCV's name.
    InputError: No such board, or it does not fit on the paper.
    """
    if kind not in BOARDS:
        raise InputError(f"board {kind!r}: one of {', '.join(BOARDS)} is needed")
    positive("pitch_mm", pitch_mm, "mm")
    if min(columns, rows) < 3:
        raise InputError(f"board: at least 3 columns and 3 rows are needed, not {columns} x {rows}")
    wide, high = columns * pitch_mm, rows * pitch_mm
    if kind == "circles-asymmetric":
        wide, high = (columns + 0.5) * pitch_mm, (rows + 1) * pitch_mm / 2
    left, top, width, height = paper.frame_mm
    if wide > width or high > height:
        raise InputError(
            f"board of {wide:g} x {high:g} mm: {paper.name} has room for {width:.0f} x {height:.0f} mm; "
            "take larger paper, turn it (landscape=True) or take fewer squares"
        )
    origin = (left + (width - wide) / 2, top + (height - high) / 2)
    if kind in ("circles", "circles-asymmetric"):
        paths = tuple(_circles(kind == "circles-asymmetric", columns, rows, pitch_mm, origin))
    else:
        paths = tuple(_squares(columns, rows, pitch_mm, origin))
    areas = [Area(paths)]
    if kind == "charuco":
        areas.append(Area(tuple(_charuco_markers(columns, rows, pitch_mm, origin, dictionary))))
    more = f", markers {0.7 * pitch_mm:g} mm, {dictionary}" if kind == "charuco" else ""
    return paper.page(f"{kind} {columns} x {rows}, pitch {pitch_mm:g} mm{more}", areas, [])


def marker_cells(dictionary: str, number: int) -> npt.NDArray[np.bool_]:
    """Return the cells of a square marker, its black border included.

    dictionary: OpenCV's name of the dictionary.
    Returns (n, n): True where it is black, rows from the top.
    InputError: No such dictionary or marker.
    """
    if not dictionary.startswith("DICT_") or not hasattr(cv2.aruco, dictionary):
        raise InputError(f"marker dictionary {dictionary!r}: OpenCV's name is needed, e.g. DICT_4X4_100")
    table = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    if not 0 <= number < len(table.bytesList):
        raise InputError(f"marker {number}: {dictionary} goes from 0 to {len(table.bytesList) - 1}")
    return np.asarray(cv2.aruco.generateImageMarker(table, number, table.markerSize + 2, borderBits=1) == 0)


def _places(count: int, side_mm: float, paper: Paper) -> Iterator[list[tuple[int, tuple[float, float]]]]:
    """Yield, page by page, the number of each item and its top left corner; a label has room below."""
    left, top, width, height = paper.frame_mm
    gap = 2.0
    columns = int((width + gap) // (side_mm + gap))
    rows = int(height // (side_mm + _LABEL_MM))
    if columns < 1 or rows < 1:
        raise InputError(
            f"targets of {side_mm:g} mm with their quiet zone: {paper.name} has room for {width:.0f} x {height:.0f} "
            "mm; take larger paper or smaller dots"
        )
    if count < 1:
        raise InputError("target sheets: at least one target is needed")
    # What is left over goes between the targets: they are cut out more easily.
    across = side_mm if columns == 1 else (width - side_mm) / (columns - 1)
    down = height / rows
    for first in range(0, count, columns * rows):
        numbers = range(first, min(first + columns * rows, count))
        yield [(k, (left + (k - first) % columns * across, top + (k - first) // columns * down)) for k in numbers]


def _ruler(x_mm: float, y_mm: float) -> tuple[Path, ...]:
    """Return a ruler of 100 mm: its outer edges are what is measured."""
    line = rectangle(x_mm, y_mm, _RULER_MM, 0.2)
    ticks = []
    for k in range(11):
        # The first and the last tick lie inside, so that the outer edges are 100 mm apart.
        offset = 0.0 if k == 0 else -0.2 if k == 10 else -0.1
        ticks.append(rectangle(x_mm + 10 * k + offset, y_mm + 0.2, 0.2, 3.8 if k % 5 == 0 else 1.8))
    return (line, *ticks)


def _upright_ruler(x_mm: float, bottom_mm: float) -> tuple[Path, ...]:
    return tuple(_turned(path, x_mm, bottom_mm) for path in _ruler(0.0, 0.0))


def _turned(path: Path, x_mm: float, y_mm: float) -> Path:
    """Return a path turned by a quarter: right becomes up, down becomes right."""
    points = [(x_mm + y, y_mm - x) for x, y in (path.start, *path.pieces)]
    return Path(points[0], tuple(points[1:]))


def _cell_paths(cells: npt.NDArray[np.bool_], corner_mm: tuple[float, float], side_mm: float) -> Iterator[Path]:
    """Yield the black cells of a marker, neighbours in a row joined."""
    step = side_mm / cells.shape[0]
    for row, line in enumerate(cells):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]]).astype(np.int8)))
        for start, end in edges.reshape(-1, 2):
            yield rectangle(corner_mm[0] + start * step, corner_mm[1] + row * step, (end - start) * step, step)


def _squares(columns: int, rows: int, side_mm: float, corner_mm: tuple[float, float]) -> Iterator[Path]:
    for row in range(rows):
        for column in range(row % 2, columns, 2):
            yield rectangle(corner_mm[0] + column * side_mm, corner_mm[1] + row * side_mm, side_mm, side_mm)


def _charuco_markers(
    columns: int, rows: int, side_mm: float, corner_mm: tuple[float, float], dictionary: str
) -> Iterator[Path]:
    """Yield the markers in the white squares, numbered row by row (OpenCV 4.6 and later)."""
    places = [(row, column) for row in range(rows) for column in range(1 - row % 2, columns, 2)]
    margin = 0.15 * side_mm
    for number, (row, column) in enumerate(places):
        corner = (corner_mm[0] + column * side_mm + margin, corner_mm[1] + row * side_mm + margin)
        yield from _cell_paths(marker_cells(dictionary, number), corner, 0.7 * side_mm)


def _circles(
    asymmetric: bool, columns: int, rows: int, pitch_mm: float, corner_mm: tuple[float, float]
) -> Iterator[Path]:
    down, radius = (pitch_mm / 2, pitch_mm / 6) if asymmetric else (pitch_mm, pitch_mm / 4)
    for row in range(rows):
        shift = 0.5 * (row % 2) if asymmetric else 0.0
        for column in range(columns):
            x = corner_mm[0] + (column + shift + 0.5) * pitch_mm
            yield disc(x, corner_mm[1] + (row + (1.0 if asymmetric else 0.5)) * down, radius)
