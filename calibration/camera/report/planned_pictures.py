"""Pictures of how the board should look in the photos to take."""

from collections.abc import Sequence

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.reporting.look import FAINT, INK, LINE_X, LINE_Y
from heliogauge.validate import FloatArray
from heliogauge.view.stills import WIDE_PX, WIDTH_PX, LegendEntry, Sheet

#: Pictures beside each other, and the room around each [px].
_COLUMNS, _GAP, _HEAD = 3, 18.0, 44.0
#: Letters of a line of words under the name of a photo.
_LETTERS = 62
#: What the marks in the pictures are.
_LEGEND = (
    LegendEntry("points of the board", LINE_X, "dot"),
    LegendEntry("upper edge of the board as drawn, its left end with a dot", LINE_Y),
)


def board_pictures(
    camera: Camera, outlines: Sequence[FloatArray], points: Sequence[FloatArray], words: Sequence[tuple[str, str]]
) -> Sheet:
    """Draw the image with the board in it, one picture for each photo, on one sheet.

    outlines, points, words: Of each photo, as `board_picture` takes them.
    """
    across = (WIDE_PX - (_COLUMNS + 1) * _GAP) / _COLUMNS
    ones = [board_picture(camera, *one, across=across) for one in zip(outlines, points, words, strict=True)]
    rows = -(-len(ones) // _COLUMNS)
    height = rows * (ones[0].height + _GAP)
    whole = Sheet(WIDE_PX, height, (0.0, 0.0, WIDE_PX, height), (0.0, 1.0), (0.0, 1.0))
    for place, one in enumerate(ones):
        row, column = divmod(place, _COLUMNS)
        whole.inset(one, _GAP + column * (across + _GAP), row * (one.height + _GAP))
    whole.legend(_LEGEND)
    return whole


def board_picture(
    camera: Camera, outline: FloatArray, points: FloatArray, words: tuple[str, str], *, across: float = WIDTH_PX
) -> Sheet:
    """Draw the image with the board in it, as one photo should be.

    outline, points: Corners of the board, the upper left one of its drawing first and clockwise (4, 2), and its
        points (k, 2) in the photo [px].
    words: Name of the photo, and what to do.
    across: Width of the picture [px].
    """
    name, what = words
    down = across * camera.height_px / camera.width_px
    limits = (-0.5, camera.width_px - 0.5), (camera.height_px - 0.5, -0.5)
    one = Sheet(across, down + _HEAD, (0.0, _HEAD, across, _HEAD + down), *limits)
    one.write(0, 12, name, font_size=13, font_weight="bold")
    for line, text in enumerate(_lines(what)):
        one.write(0, 26 + 13 * line, text, font_size=10, fill=FAINT)
    frame = np.array([[-0.5, -0.5], [1, -0.5], [1, 1], [-0.5, 1]])
    frame = np.where(frame == 1, [camera.width_px - 0.5, camera.height_px - 0.5], frame)
    one.area(frame[:, 0], frame[:, 1], "#f4f5f6", edge=FAINT)
    one.area(outline[:, 0], outline[:, 1], "#ffffff", edge=INK)
    one.dots(points[:, 0], points[:, 1], [LINE_X], size_px=2.5)
    one.line(outline[:2, 0], outline[:2, 1], LINE_Y, width=3.0)
    one.dots(outline[:1, 0], outline[:1, 1], [LINE_Y], size_px=9.0)
    return one


def _lines(text: str) -> list[str]:
    """Break a text at a comma into two lines where it is long."""
    if len(text) <= _LETTERS:
        return [text]
    parts = text.split(", ")
    middle = next((k for k in range(len(parts), 0, -1) if len(", ".join(parts[:k])) <= _LETTERS), 1)
    return [", ".join(parts[:middle]) + ",", ", ".join(parts[middle:])]
