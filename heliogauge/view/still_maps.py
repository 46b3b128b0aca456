"""Still pictures of grids: maps on a mirror or an image, why nodes have no value, correlations."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from heliogauge.flags import FLAG_TEXTS, SampleFlag, count_flags
from heliogauge.reporting.html import Html
from heliogauge.reporting.look import FAINT, INK, extent_of, thinned
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import BoolArray, FloatArray
from heliogauge.view.stills import WIDTH_PX, LegendEntry, Sheet, color_table, fitted_sheet

# Qualitative colours that differ in lightness too; with 13 no two reasons of one kind of map share one.
_FLAG_COLORS = (
    *("#d94f30", "#f0a23c", "#7b5ea7", "#2f8f83", "#b2336e", "#4d7ebf", "#8a6d3b", "#5b8c2a", "#111111"),
    *("#d9a5c7", "#66788a", "#c7b942", "#0b5563"),
)
_MEASURED = "#e9f1ea"
_SIDE = ", seen from the front"
#: Words this far above each other do not touch [px].
_LINE_PX = 10.0
#: Narrower maps stand beside each other under one title, which says it.
_LEAST_SAID_PX = 180.0


@dataclass(frozen=True, slots=True, eq=False)
class MapPicture:
    """A quantity on a grid.

    title, note: Lines over it.
    unit: Unit of the values.
    values (ny, nx): Values in the printed unit; NaN where there is none: grey and hatched.
    aperture (ny, nx): Outside of it nothing is drawn.
    extent: Left, right, bottom and top edge of the grid's cells.
    axis_unit: Unit of the axes.
    low, high: Where the colours end.
    diverging: Colours from blue over white to red; otherwise from dark to light.
    y_down: y grows downwards.
    lines: Vertices of thin lines over the map, shape (n, 2) each.
    axis_names: What columns and rows are.
    arrows (n, 2, 2): Foot and tip of arrows over the map.
    marks: x, y and a few signs beside a dot.
    """

    title: str
    note: str
    unit: str
    values: FloatArray
    aperture: BoolArray
    extent: tuple[float, float, float, float]
    axis_unit: str
    low: float
    high: float
    diverging: bool
    y_down: bool
    lines: Sequence[FloatArray] = ()
    axis_names: tuple[str, str] = ("x", "y")
    arrows: FloatArray = field(default_factory=lambda: np.zeros((0, 2, 2)))
    marks: Sequence[tuple[float, float, str]] = ()

    def still(self, *, tallest_px: float = 480.0) -> Html:
        """Draw the map in its own proportions."""
        return self.sheet(tallest_px=tallest_px).html(f"{self.title}. {self.note}")

    def sheet(self, *, width: float = WIDTH_PX, tallest_px: float = 480.0, bar: bool = True) -> Sheet:
        """Draw the map in its own proportions, for more to be drawn over it."""
        left, right, bottom, top = self.extent
        sheet = fitted_sheet(
            (left, right), (top, bottom) if self.y_down else (bottom, top), width=width, tallest_px=tallest_px, bar=bar
        )
        sheet.title(self.title, self.note)
        missing = self.aperture & ~np.isfinite(self.values)
        share = (self.values - self.low) / max(self.high - self.low, 1e-300)
        index = np.clip(np.nan_to_num(share, nan=0.0) * 255 + 0.5, 0, 255).astype(np.uint8)
        _paint(sheet, color_table(diverging=self.diverging)[index], missing, self.aperture)
        for line in self.lines:
            sheet.line(line[:, 0], line[:, 1], FAINT, width=0.7)
        if len(self.arrows):
            (x, y), (dx, dy) = self.arrows[:, 0].T, (self.arrows[:, 1] - self.arrows[:, 0]).T
            # A light edge keeps them apart from dark colours.
            sheet.arrows(x, y, dx, dy, "#ffffff", width=3.6)
            sheet.arrows(x, y, dx, dy, INK, width=1.8)
        self._draw_marks(sheet)
        is_mirror = self.axis_unit == "m" and sheet.box[2] - sheet.box[0] > _LEAST_SAID_PX
        x_label, y_label = (f"{name} [{self.axis_unit}]" for name in self.axis_names)
        sheet.axes(x_label + (_SIDE if is_mirror else ""), y_label, grid=False)
        if bar:
            sheet.color_bar(self.low, self.high, self.unit, diverging=self.diverging)
        return sheet

    def _draw_marks(self, sheet: Sheet) -> None:
        """Draw dots with their words, each on the side where its neighbours are farthest."""
        if not self.marks:
            return
        places = np.array([mark[:2] for mark in self.marks], dtype=np.float64)
        sheet.dots(places[:, 0], places[:, 1], [INK], size_px=3.5)
        x, y = sheet.place_x(places[:, 0]), sheet.place_y(places[:, 1])
        for number, (_, _, text) in enumerate(self.marks):
            beside = np.abs(y - y[number]) < _LINE_PX
            # Words share the room to the next dot with that one's; they need not share the edge.
            right = np.min((x - x[number])[beside & (x > x[number] + 1)], initial=2 * (sheet.box[2] - x[number]))
            left = np.min((x[number] - x)[beside & (x < x[number] - 1)], initial=2 * (x[number] - sheet.box[0]))
            to_left = left > right
            edge = {"stroke": "#ffffff", "stroke_width": 2.4, "paint_order": "stroke"}
            look = {"text_anchor": "end" if to_left else "start", "font_size": 9, **edge}
            sheet.write(float(x[number]) + (-4 if to_left else 4), float(y[number]) + 3, text, **look)


def flag_still(slope_map: SlopeMap, lines: Sequence[FloatArray] = (), *, planned: bool = False) -> Html:
    """Draw why nodes of the mirror have no value or a doubtful one, with a legend.

    lines: Vertices of thin lines over the map, shape (n, 2) each [m].
    planned: The map says what will be measured.
    """
    counts = count_flags(slope_map.flags, slope_map.aperture)
    counts.pop(SampleFlag.OUTSIDE_MIRROR, None)
    order = sorted(counts, key=lambda flag: counts[flag], reverse=True)[: len(_FLAG_COLORS)]
    own_colors = _colors_of_flags(order)
    flags, aperture = thinned(slope_map.flags), thinned(slope_map.aperture)
    codes = np.where(thinned(slope_map.valid), 0, -1)
    # Rare reasons are painted last, over the common ones.
    for number, flag in enumerate(order, start=1):
        codes[(flags & np.uint32(flag)) != 0] = number
    colors = [_MEASURED, *own_colors]
    table = np.array([[int(one[place : place + 2], 16) for place in (1, 3, 5)] for one in colors], dtype=np.uint8)
    left, right, bottom, top = extent_of(slope_map)
    sheet = fitted_sheet((left, right), (bottom, top))
    title = f"What {'will be' if planned else 'was'} measured, and why not the rest"
    note = f"{slope_map.measured_share:.2%} of the mirror measured"
    sheet.title(title, note)
    _paint(sheet, table[codes], aperture & (codes < 0), aperture)
    for line in lines:
        sheet.line(line[:, 0], line[:, 1], FAINT, width=0.7)
    sheet.axes(f"x [m]{_SIDE}", "y [m]", grid=False)
    total = int(np.count_nonzero(slope_map.aperture))
    reasons = [f"{FLAG_TEXTS[flag]}: {counts[flag] / total:.2%}" for flag in order]
    names = ["measured, no remark", *reasons]
    entries = [LegendEntry(name, color, "box") for name, color in zip(names, colors, strict=True)]
    sheet.legend([*entries, LegendEntry("no value, no flag", FAINT, "hatched")])
    return sheet.html(f"{title}. {note}: {'; '.join(names)}")


def _colors_of_flags(flags: Sequence[int]) -> list[str]:
    """Return one colour for each flag: its own in every picture, another one only where two flags share it.

    flags: The most frequent one first; it keeps its colour.
    """
    chosen: list[str] = []
    for flag in flags:
        own = int(flag).bit_length() % len(_FLAG_COLORS)
        turns = (_FLAG_COLORS[(own + step) % len(_FLAG_COLORS)] for step in range(len(_FLAG_COLORS)))
        chosen.append(next(color for color in turns if color not in chosen))
    return chosen


def correlation_still(names: Sequence[str], matrix: FloatArray, title: str, note: str) -> Html:
    """Draw the correlations of parameters, from -1 to 1, with their numbers.

    names: Of the parameters.
    Shapes: matrix (n, n).
    title, note: Lines over it.
    """
    count = len(names)
    longest = 6.2 * max(len(name) for name in names)
    left, cell = longest + 20.0, min((WIDTH_PX - longest - 112.0) / count, 40.0)
    size = cell * count
    box = (left, 50.0, left + size, 50.0 + size)
    sheet = Sheet(WIDTH_PX, 62.0 + size + 0.8 * longest, box, (-0.5, count - 0.5), (count - 0.5, -0.5))
    sheet.title(title, note)
    index = np.clip(np.nan_to_num(0.5 * (matrix + 1)) * 255 + 0.5, 0, 255).astype(np.uint8)
    _paint(sheet, color_table(diverging=True)[index], ~np.isfinite(matrix), np.ones(matrix.shape, dtype=bool))
    font = f"{min(11.0, cell / 2.6):.3g}"
    for row, column in np.ndindex(matrix.shape):
        value = float(matrix[row, column])
        # Numbers that nobody could read are left out.
        if row == column or cell < 16 or not np.isfinite(value):
            continue
        text = f"{value:.2f}".replace("0.", ".").replace("-", "\u2212")
        x, y = float(sheet.place_x(column)), float(sheet.place_y(row))
        color = "#fff" if abs(value) > 0.6 else INK
        sheet.write(x, y + 0.13 * cell, text, text_anchor="middle", font_size=font, fill=color)
    small = f"{min(11.5, 0.9 * cell):.3g}"
    for place, name in enumerate(names):
        x, y = float(sheet.place_x(place)), float(sheet.place_y(place))
        sheet.write(left - 6, y + 4, name, text_anchor="end", font_size=small)
        below = box[3] + 12
        sheet.write(
            x + 4, below, name, text_anchor="end", font_size=small, transform=f"rotate(-50 {x:.1f} {below:.1f})"
        )
    sheet.color_bar(-1.0, 1.0, "", diverging=True)
    return sheet.html(f"{title}. {note}")


def _paint(sheet: Sheet, colors: npt.NDArray[np.uint8], missing: BoolArray, inside: BoolArray) -> None:
    """Fill the box with the cells of a grid: what has no value is hatched, what does not belong to it white.

    Shapes: colors (ny, nx, 3), missing (ny, nx), inside (ny, nx).
    """
    if missing.any():
        sheet.hatched()
    picture = np.full((*missing.shape, 4), 255, dtype=np.uint8)
    picture[..., :3] = np.where(inside[..., None], colors, 255)
    picture[..., 3] = np.where(missing, 0, 255)
    # Images begin at the top.
    is_up = sheet.y_limits[1] > sheet.y_limits[0]
    sheet.cells(picture[::-1] if is_up else picture, (*sheet.x_limits, *sheet.y_limits))
