"""Still pictures for print, notebooks and browsers without script: SVG written directly.

A still takes 5 ms and is sharp on paper. What has thousands of marks is an image within it, so that 90,000 points stay
small and quick. Figures that a person changes or saves are matplotlib's (``result.plot()``).
"""

import base64
import html
import re
import struct
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple
from urllib.parse import quote

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.reporting.html import Html
from heliogauge.reporting.look import FAINT, INK, MISSING, MISSING_HATCH
from heliogauge.validate import BoolArray, FloatArray

#: Two stills side by side fill a page of 1160 px; one of the other width stands alone.
WIDTH_PX = 576.0
WIDE_PX = 1152.0

_GRID = "#e4e7ea"
_FONT = "font-family=\"system-ui, 'DejaVu Sans', sans-serif\""
# ColorBrewer's RdBu, from low (blue) to high (red), and viridis: both keep their order for the colour-blind.
_DIVERGING = (
    "#053061 #2166ac #4393c3 #92c5de #d1e5f0 #f7f7f7 #fddbc7 #f4a582 #d6604d #b2182b #67001f".split()  # noqa: SIM905
)
_SEQUENTIAL = (
    "#440154 #482475 #414487 #355f8d #2a788e #21918c #22a884 #44bf70 #7ad151 #bddf26 #fde725".split()  # noqa: SIM905
)
#: What has no value.
_HATCH = (
    '<pattern id="h" width="7" height="7" patternUnits="userSpaceOnUse" patternTransform="rotate(45)">'
    f'<rect width="7" height="7" fill="{MISSING}"/><path d="M0,0V7" stroke="{MISSING_HATCH}" '
    'stroke-width="1.6"/></pattern>'
)
#: Steps of an axis of time: unit, number, length [s].
_TIME_STEPS = (
    *(("s", count, count) for count in (1, 5, 15, 30)),
    *(("m", count, 60 * count) for count in (1, 5, 15, 30)),
    *(("h", count, 3600 * count) for count in (1, 3, 6, 12)),
    *(("D", count, 86_400 * count) for count in (1, 2, 5, 10)),
    *(("M", count, 2_629_800 * count) for count in (1, 2, 3, 6)),
    *(("Y", count, 31_557_600 * count) for count in (1, 2, 5, 10)),
)
#: What has a value that is to be doubted.
_STRIPES = (
    '<pattern id="t" width="7" height="7" patternUnits="userSpaceOnUse" patternTransform="rotate(45)">'
    f'<path d="M0,0V7" stroke="{INK}" stroke-width="1.6"/></pattern>'
)
#: Dots and vertices of lines beyond this number are drawn as an image: 4000 take 60 kB as text.
_MOST_DRAWN = 4000
#: Pixels of such an image for each of the page: 250 to the inch on paper.
_FINER = 2.0
#: Beyond this number for each.
_MOST_FINE = 20_000
_JPEG_QUALITY = 75
#: What stands in the address of a picture as it is.
_PLAIN = " !$'()*+,-./:;=?@[]^_`{|}~"
#: ASCII characters that an address does not hold as they are, and what stands for them; the sign that begins these
#: comes first.
_SIGNS = tuple((sign, quote(sign, safe=_PLAIN)) for sign in sorted(map(chr, range(128)), key=lambda one: one != "%"))
_ESCAPED = tuple((sign, escape) for sign, escape in _SIGNS if escape != sign)
#: Characters beyond ASCII.
_OTHERS = re.compile("[^\x00-\x7f]+")
#: Width of a letter as a share of the size of the font, on average.
_LETTER = 0.56


class LegendEntry(NamedTuple):
    """One line of a legend: its words, and how what it stands for is drawn."""

    name: str
    color: str
    mark: Literal["line", "dashed", "dot", "ring", "cross", "box", "hatched"] = "line"


@dataclass(slots=True, eq=False)
class Sheet:
    """A picture with one box of axes, in pixels: x to the right, y down.

    width, height: Size of the sheet.
    box: Left, top, right and bottom edge of the axes' box.
    x_limits, y_limits: Values at its left and right edge, and at its bottom and top edge.
    x_log, y_log: Logarithmic axes.
    least_x_step: Ticks along x are at least so far apart.
    """

    width: float
    height: float
    box: tuple[float, float, float, float]
    x_limits: tuple[float, float]
    y_limits: tuple[float, float]
    x_log: bool = False
    y_log: bool = False
    least_x_step: float = 0.0
    parts: list[str] = field(default_factory=list)

    def place_x(self, values: npt.ArrayLike) -> FloatArray:
        """Return the places of values along x [px]."""
        return _places(values, self.x_limits, self.box[0], self.box[2], self.x_log)

    def place_y(self, values: npt.ArrayLike) -> FloatArray:
        """Return the places of values along y [px]."""
        return _places(values, self.y_limits, self.box[3], self.box[1], self.y_log)

    def add(self, markup: str) -> None:
        """Add a piece of SVG."""
        self.parts.append(markup)

    def inside(self, markup: str) -> None:
        """Add a piece of SVG that ends at the edges of the axes' box."""
        left, top, right, bottom = self.box
        sizes = f"{left:.1f} {top:.1f} {right - left:.1f} {bottom - top:.1f}"
        x, y, width, height = sizes.split()
        self.add(f'<svg x="{x}" y="{y}" width="{width}" height="{height}" viewBox="{sizes}">{markup}</svg>')

    def write(self, x: float, y: float, text: str, **look: Any) -> None:
        """Write a text; underscores in the names of attributes become hyphens."""
        more = "".join(f' {name.replace("_", "-")}="{value}"' for name, value in look.items())
        self.add(f'<text x="{x:.1f}" y="{y:.1f}"{more}>{html.escape(text)}</text>')

    def title(self, title: str, note: str) -> None:
        """Write the title and the smaller line under it; long ones in smaller letters."""
        for y, text, size, look in ((20, title, 14.0, {"font_weight": "bold"}), (37, note, 11.0, {"fill": FAINT})):
            fitting = (self.width - 20) / (_LETTER * max(len(text), 1))
            self.write(12, y, text, font_size=f"{max(min(size, fitting), 7.5):.3g}", **look)

    def axes(
        self, x_label: str, y_label: str, *, grid: bool, x_ticks: Sequence[tuple[float, str]] | None = None
    ) -> None:
        """Draw ticks, their numbers and the names of the axes.

        x_ticks: Values and words along x; None: round numbers.
        """
        left, top, right, bottom = self.box
        lines = []
        if x_ticks is None:
            most = max(int((right - left) / 62), 2)
            values = _ticks(self.x_limits, self.x_log, most, self.least_x_step)
            x_ticks = [(value, _number(value, self.x_limits, self.x_log)) for value in values]
        for value, words in x_ticks:
            x = float(self.place_x(value))
            lines.append(f"M{x:.1f},{bottom:.1f}v4" + (f"M{x:.1f},{top:.1f}V{bottom:.1f}" if grid else ""))
            self.write(x, bottom + 16, words, text_anchor="middle")
        for value in _ticks(self.y_limits, self.y_log, max(int((bottom - top) / 34), 2)):
            y = float(self.place_y(value))
            lines.append(f"M{left:.1f},{y:.1f}h-4" + (f"M{left:.1f},{y:.1f}H{right:.1f}" if grid else ""))
            self.write(left - 7, y + 4, _number(value, self.y_limits, self.y_log), text_anchor="end")
        self.parts.insert(0, f'<path d="{"".join(lines)}" fill="none" stroke="{_GRID if grid else FAINT}"/>')
        if grid:
            self.add(f'<path d="M{left:.1f},{top:.1f}V{bottom:.1f}H{right:.1f}" fill="none" stroke="{FAINT}"/>')
        middle_x, middle_y = 0.5 * (left + right), 0.5 * (top + bottom)
        self.write(middle_x, bottom + 33, x_label, text_anchor="middle")
        at = max(left - 58, 14.0)
        self.write(at, middle_y, y_label, text_anchor="middle", transform=f"rotate(-90 {at:.1f} {middle_y:.1f})")

    def line(
        self,
        x: npt.ArrayLike,
        y: npt.ArrayLike,
        color: str,
        *,
        width: float = 1.5,
        dashed: bool = False,
        opacity: float = 1.0,
    ) -> None:
        """Draw a line through values, broken where one is not finite.

        x, y (n,): Values along the axes.
        width: In pixels.
        """
        self._stroke(self.place_x(x), self.place_y(y), color, width, dashed, opacity)

    def dots(self, x: npt.ArrayLike, y: npt.ArrayLike, colors: Sequence[str], *, size_px: float = 4.0) -> None:
        """Draw dots, later ones above.

        x, y (n,): Values along the axes; where one is not finite there is no dot.
        colors: One for all, or one for each.
        """
        across, down = self.place_x(x), self.place_y(y)
        known = np.flatnonzero(np.isfinite(across) & np.isfinite(down))
        if known.size > _MOST_DRAWN:
            self.inside(self._dotted_image(across[known], down[known], _each(colors, known), size_px))
            return
        paths: dict[str, list[str]] = {}
        places = zip(_each(colors, known), across[known].tolist(), down[known].tolist(), strict=True)
        for color, a, b in places:
            paths.setdefault(color, []).append(f"M{a:.1f},{b:.1f}h0")
        drawn = [f'<path d="{"".join(path)}" stroke="{_safe(color)}"/>' for color, path in paths.items()]
        if drawn:
            self.inside(f'<g stroke-width="{size_px:.3g}" stroke-linecap="round">{"".join(drawn)}</g>')

    def crosses(self, x: npt.ArrayLike, y: npt.ArrayLike, color: str, *, size_px: float = 6.0) -> None:
        """Draw crosses for what was refused or left out.

        x, y (n,): Values along the axes.
        """
        half = 0.5 * size_px
        across, down = self.place_x(x)[:, None], self.place_y(y)[:, None]
        shape = np.array([[-half, -half], [half, half], [np.nan, np.nan], [-half, half], [half, -half], [np.nan] * 2])
        self._stroke((across + shape[:, 0]).ravel(), (down + shape[:, 1]).ravel(), color, 1.2)

    def rings(self, x: npt.ArrayLike, y: npt.ArrayLike, color: str, *, size_px: float = 6.0) -> None:
        """Draw small circles that let through what is under them.

        x, y (n,): Values along the axes.
        """
        half = 0.5 * size_px
        turn = np.append(np.linspace(0, 2 * np.pi, 13), np.nan)
        across, down = self.place_x(x)[:, None], self.place_y(y)[:, None]
        self._stroke((across + half * np.cos(turn)).ravel(), (down + half * np.sin(turn)).ravel(), color, 1.0)

    def arrows(
        self,
        x: npt.ArrayLike,
        y: npt.ArrayLike,
        dx: npt.ArrayLike,
        dy: npt.ArrayLike,
        color: str,
        *,
        width: float = 1.1,
    ) -> None:
        """Draw arrows.

        x, y (n,): Where they begin.
        dx, dy (n,): How far they go along the axes, in their units.
        """
        x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        foot = np.stack([self.place_x(x), self.place_y(y)], axis=-1)
        tip = np.stack([self.place_x(x + np.asarray(dx)), self.place_y(y + np.asarray(dy))], axis=-1)
        along = tip - foot
        length = np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-9)
        back = along / length * np.minimum(0.35 * length, 5.0)
        side = 0.5 * np.stack([-back[:, 1], back[:, 0]], axis=-1)
        gap = np.full_like(tip, np.nan)
        path = np.stack([foot, tip, gap, tip - back + side, tip, tip - back - side, gap], axis=1).reshape(-1, 2)
        self._stroke(path[:, 0], path[:, 1], color, width)

    def area(self, x: npt.ArrayLike, y: npt.ArrayLike, color: str, *, edge: str = "none", opacity: float = 1.0) -> None:
        """Fill an area.

        x, y (n,): Its corners along the axes.
        """
        path = f"{path_of(self.place_x(x), self.place_y(y))}Z"
        self.inside(f'<path d="{path}" fill="{_safe(color)}" stroke="{_safe(edge)}" fill-opacity="{opacity:.3g}"/>')

    def photo(self, image: npt.NDArray[np.uint8], extent: tuple[float, float, float, float]) -> None:
        """Draw a photo.

        image (rows, columns) or (rows, columns, 3): Grey or RGB, from the top.
        extent: Values at its left, right, bottom and top edge.
        """
        self.inside(self._image("jpeg", jpeg_of(image), extent))

    def cells(self, rgba: npt.NDArray[np.uint8], extent: tuple[float, float, float, float]) -> None:
        """Draw coloured cells with sharp edges.

        rgba (rows, columns, 4): Red, green, blue and opacity of each, from the top.
        extent: Values at the left, right, bottom and top edge.
        """
        self.inside(self._image("png", _png(rgba), extent, "image-rendering:pixelated"))

    def hatched(self) -> None:
        """Fill the box as what has no value: grey and hatched."""
        left, top, right, bottom = self.box
        self.add(
            f'{_HATCH}<rect x="{left:.1f}" y="{top:.1f}" width="{right - left:.1f}" height="{bottom - top:.1f}" '
            'fill="url(#h)"/>'
        )

    def hatch(self, cells: BoolArray) -> None:
        """Draw stripes over some cells of a grid that fills the box, whatever lies under them.

        cells (rows, columns): Which; the first row is the lowest where y grows upwards.
        """
        rows, columns = cells.shape
        left, top, right, bottom = self.box
        wide, tall = (right - left) / columns, (bottom - top) / rows
        drawn = cells[::-1] if self.y_limits[1] > self.y_limits[0] else cells
        areas = []
        for row, line in enumerate(drawn):
            # One area for neighbours in a row.
            ends = np.flatnonzero(np.diff(np.concatenate([[0], line.astype(np.int8), [0]])))
            for first, end in ends.reshape(-1, 2).tolist():
                x, y = left + first * wide, top + row * tall
                areas.append(f"M{x:.1f},{y:.1f}h{(end - first) * wide:.1f}v{tall:.1f}h{-(end - first) * wide:.1f}Z")
        if areas:
            self.add(f'{_STRIPES}<path d="{"".join(areas)}" fill="url(#t)"/>')

    def color_bar(self, low: float, high: float, unit: str, *, diverging: bool) -> None:
        """Draw the colours beside the box, with their values.

        low, high: Values at the ends.
        unit: Written under it; empty: none.
        """
        _, top, right, bottom = self.box
        colors = _DIVERGING if diverging else _SEQUENTIAL
        stops = "".join(
            f'<stop offset="{index / (len(colors) - 1):.2f}" stop-color="{color}"/>'
            for index, color in enumerate(colors)
        )
        x = right + 12
        name = "d" if diverging else "s"
        self.add(
            f'<linearGradient id="{name}" x1="0" y1="1" x2="0" y2="0">{stops}</linearGradient><rect x="{x:.1f}" '
            f'y="{top:.1f}" width="13" height="{bottom - top:.1f}" fill="url(#{name})" stroke="{FAINT}" '
            'stroke-width=".5"/>'
        )
        limits = (low, high)
        for value in _ticks(limits, log=False, most=max(int((bottom - top) / 40), 2)):
            y = float(_places(value, limits, bottom, top, log=False))
            self.write(x + 18, y + 4, _number(value, limits, log=False))
        if unit:
            text = f"[{unit}]"
            most = self.width - 4 - 11.5 * _LETTER * len(text)
            # A long one ends at the sheet's edge, below the numbers of the axis.
            self.write(min(x - 2, most), bottom + (17 if x - 2 <= most else 34), text)

    def legend(self, entries: Iterable[LegendEntry]) -> None:
        """Write a legend below everything; the sheet grows by its lines."""
        x, y = 14.0, self.height + 6.0
        for entry in entries:
            needed = 44 + 11.5 * _LETTER * len(entry.name)
            if x > 14 and x + needed > self.width:
                x, y = 14.0, y + 17
            self.add(_legend_mark(entry, x, y))
            self.write(x + 25, y + 4, entry.name)
            x += needed
        self.height = y + 12

    def inset(self, other: "Sheet", x: float, y: float) -> None:
        """Put another sheet on this one, its upper left corner at a place [px]."""
        self.add(f'<g transform="translate({x:.1f} {y:.1f})">{"".join(other.parts)}</g>')

    def svg(self) -> str:
        """Return the picture as a file's content."""
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width:.0f} {self.height:.0f}" '
            f'width="{self.width:.0f}" height="{self.height:.0f}" {_FONT} font-size="11.5" fill="{INK}">'
            f'<rect width="100%" height="100%" fill="#fff"/>{"".join(self.parts)}</svg>'
        )

    def html(self, words: str) -> Html:
        """Return the picture as an image within the page.

        words: What it shows, for those who cannot see it.
        """
        # A quarter less than as base64.
        data = _quoted(self.svg().replace("'", "&apos;").replace('"', "'"))
        alt = html.escape(words, quote=True)
        kind = ' class="wide"' if self.width > 1.5 * WIDTH_PX else ""
        return Html(f'<figure{kind}><img alt="{alt}" src="data:image/svg+xml,{data}"></figure>')

    def _stroke(
        self,
        across: FloatArray,
        down: FloatArray,
        color: str,
        width: float,
        dashed: bool = False,
        opacity: float = 1.0,
    ) -> None:
        """Draw a line through places on the sheet."""
        if across.size > _MOST_DRAWN and not dashed:
            self.inside(self._stroked_image(across, down, color, width, opacity))
            return
        dashes = ' stroke-dasharray="6 4"' if dashed else ""
        see = "" if opacity == 1.0 else f' opacity="{opacity:.3g}"'
        look = f'fill="none" stroke="{_safe(color)}" stroke-width="{width:.3g}" stroke-linejoin="round"{dashes}{see}'
        self.inside(f'<path d="{path_of(across, down)}" {look}/>')

    def _dotted_image(self, across: FloatArray, down: FloatArray, colors: Sequence[str], size_px: float) -> str:
        left, top, right, bottom = self.box
        finer = _FINER if across.size < _MOST_FINE else 1.0
        shape = round(finer * (bottom - top)), round(finer * (right - left))
        radius = 0.5 * finer * size_px
        reach = np.arange(-np.floor(radius), np.floor(radius) + 1)
        disc = np.stack([one.ravel() for one in np.meshgrid(reach, reach)], axis=-1)
        disc = disc[np.hypot(*disc.T) <= radius].astype(np.intp)
        column = np.rint(finer * (across - left)).astype(np.intp)[:, None] + disc[:, 0]
        row = np.rint(finer * (down - top)).astype(np.intp)[:, None] + disc[:, 1]
        # Beyond 255 the last colours are one.
        kinds = list(dict.fromkeys(colors))[:255]
        place = {color: index for index, color in enumerate(kinds, start=1)}
        table = [[0, 0, 0, 0], *([*_rgb(color), 255] for color in kinds)]
        painted = np.array([place.get(color, len(kinds)) for color in colors], dtype=np.uint8)[:, None]
        seen = (column >= 0) & (column < shape[1]) & (row >= 0) & (row < shape[0])
        picture = np.zeros(shape, dtype=np.uint8)
        # Of those at one place the last one stays.
        picture[row[seen], column[seen]] = np.broadcast_to(painted, seen.shape)[seen]
        return self._image("png", _indexed_png(picture, np.array(table)), self._extent())

    def _stroked_image(self, across: FloatArray, down: FloatArray, color: str, width: float, opacity: float) -> str:
        left, top, right, bottom = self.box
        finer = _FINER if across.size < _MOST_FINE else 1.0
        shape = round(finer * (bottom - top)), round(finer * (right - left))
        known = np.isfinite(across) & np.isfinite(down)
        # Sixteenths of a pixel; far beyond the box is far enough.
        places = np.clip(np.stack([across - left, down - top], axis=-1), -1e4, 1e4) * (16 * finer)
        ends = np.flatnonzero(np.diff(known.astype(np.int8))) + 1
        pieces = [piece for piece in np.split(np.arange(across.size), ends) if known[piece[0]]]
        mask = np.zeros(shape, dtype=np.uint8)
        lines = [np.rint(places[piece]).astype(np.int32) for piece in pieces]
        cv2.polylines(
            mask, lines, isClosed=False, color=255, thickness=max(round(finer * width), 1), lineType=16, shift=4
        )
        # Four steps of opacity make a small file, and look the same.
        table = np.array([[*_rgb(color), round(85 * step * opacity)] for step in range(4)])
        return self._image("png", _indexed_png(np.rint(mask / 85).astype(np.uint8), table), self._extent())

    def _extent(self) -> tuple[float, float, float, float]:
        return (*self.x_limits, *self.y_limits)

    def _image(self, kind: str, data: bytes, extent: tuple[float, float, float, float], style: str = "") -> str:
        (left, right), (bottom, top) = self.place_x(extent[:2]).tolist(), self.place_y(extent[2:]).tolist()
        look = f' style="{style}"' if style else ""
        coded = base64.b64encode(data).decode("ascii")
        return (
            f'<image x="{left:.1f}" y="{top:.1f}" width="{right - left:.1f}" height="{bottom - top:.1f}" '
            f'preserveAspectRatio="none"{look} href="data:image/{kind};base64,{coded}"/>'
        )


def fitted_sheet(
    x_limits: tuple[float, float],
    y_limits: tuple[float, float],
    *,
    width: float = WIDTH_PX,
    tallest_px: float = 480.0,
    bar: bool = True,
    lowest_px: float = 24.0,
) -> Sheet:
    """Return a sheet whose axes have one scale and the box the proportions of the limits.

    x_limits, y_limits: Values at the left and right edge, and at the bottom and top edge.
    bar: Whether there is room for a colour bar at the right.
    lowest_px: The box is at least so high.
    """
    room = width - 58 - (92 if bar else 20)
    share = abs(y_limits[1] - y_limits[0]) / max(abs(x_limits[1] - x_limits[0]), 1e-300)
    across = min(room, tallest_px / max(share, 1e-9))
    height = max(across * share, lowest_px)
    left = 58 + 0.5 * (room - across)
    return Sheet(width, height + 96, (left, 48.0, left + across, 48.0 + height), x_limits, y_limits)


def jpeg_of(image: npt.NDArray[np.uint8]) -> bytes:
    """Return a grey or RGB picture as a JPEG file.

    image (rows, columns) or (rows, columns, 3): From the top.
    """
    # OpenCV writes blue, green, red.
    ordered = image if image.ndim == 2 else np.ascontiguousarray(image[:, :, ::-1])
    _, data = cv2.imencode(".jpg", ordered, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return data.tobytes()


def side_by_side(pictures: Sequence[Html], *, caption: str = "") -> Html:
    """Put pictures beside each other, as many as the page has room for.

    caption: A line under them.
    """
    below = f'<p class="caption">{html.escape(caption)}</p>' if caption else ""
    return Html(f'<div class="figures">{"".join(picture.text for picture in pictures)}</div>{below}')


def color_table(*, diverging: bool) -> npt.NDArray[np.uint8]:
    """Return 256 colours from low to high, shape (256, 3), red, green, blue.

    diverging: From blue over white to red; otherwise from dark to yellow.
    """
    anchors = np.array([_rgb(color) for color in (_DIVERGING if diverging else _SEQUENTIAL)], np.float64)
    at = np.linspace(0, len(anchors) - 1, 256)
    columns = [np.interp(at, np.arange(len(anchors)), anchors[:, channel]) for channel in range(3)]
    return np.rint(np.stack(columns, axis=1)).astype(np.uint8)


def colors_of(values: FloatArray, low: float, high: float, *, diverging: bool) -> list[str]:
    """Return the colours of values, shape (n,); of 64 steps. Those without a value are grey.

    low, high: Where the colours end.
    diverging: From blue over white to red; otherwise from dark to yellow.
    """
    steps = color_table(diverging=diverging)[np.rint(np.linspace(0, 255, 64)).astype(np.intp)]
    names = [f"#{red:02x}{green:02x}{blue:02x}" for red, green, blue in steps.tolist()]
    shares = (np.asarray(values, dtype=np.float64) - low) / max(high - low, 1e-300)
    index = np.rint(63 * np.clip(np.nan_to_num(shares), 0, 1)).astype(np.intp).tolist()
    known = np.isfinite(shares).tolist()
    return [names[place] if one else MISSING for place, one in zip(index, known, strict=True)]


def chart_limits(values: Sequence[FloatArray], *, log: bool, spare: float = 0.05) -> tuple[float, float]:
    """Return limits around all finite values, with a margin; around positive ones on a logarithmic axis."""
    every = np.concatenate([np.asarray(one, dtype=np.float64).ravel() for one in values] or [np.zeros(0)])
    every = every[np.isfinite(every) & ((every > 0) | (not log))]
    if not every.size:
        return (0.1, 1.0) if log else (0.0, 1.0)
    low, high = float(every.min()), float(every.max())
    if log:
        return (low / 1.15, high * 1.15)
    margin = spare * (high - low) or 0.5 * abs(high) or 1.0
    return low - margin, high + margin


def time_ticks(limits: tuple[float, float], most: int) -> list[tuple[float, str]]:
    """Return round times between limits and their words.

    limits: Seconds since 1970, UTC.
    """
    low, high = limits
    unit, count = next(
        ((unit, count) for unit, count, length in _TIME_STEPS if (high - low) / length <= most), ("Y", 20)
    )
    first, last = (int(np.datetime64(int(np.floor(one)), "s").astype(f"M8[{unit}]").astype(np.int64)) for one in limits)
    times = np.arange(first - first % count, last + count, count).astype(f"M8[{unit}]").astype("M8[s]")
    places = times.astype(np.int64).tolist()
    part = {"Y": slice(4), "M": slice(7), "D": slice(10), "h": slice(5, 16), "m": slice(5, 16), "s": slice(11, 19)}[
        unit
    ]
    words = [str(time)[part].replace("T", " ") for time in times]
    return [(float(place), word) for place, word in zip(places, words, strict=True) if low <= place <= high]


def equal_limits(
    x: tuple[float, float], y: tuple[float, float], box: tuple[float, float, float, float]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Widen limits so that both axes have one scale in a box."""
    width, height = box[2] - box[0], box[3] - box[1]
    scale = max((x[1] - x[0]) / width, (y[1] - y[0]) / height)
    middles = 0.5 * (x[0] + x[1]), 0.5 * (y[0] + y[1])
    halves = 0.5 * scale * width, 0.5 * scale * height
    return (middles[0] - halves[0], middles[0] + halves[0]), (middles[1] - halves[1], middles[1] + halves[1])


def path_of(x: FloatArray, y: FloatArray) -> str:
    """Return a line through places, broken where one is not finite."""
    parts, moving = [], True
    for one, other in zip(x.tolist(), y.tolist(), strict=True):
        if one != one or other != other:
            moving = True
            continue
        parts.append(f"{'M' if moving else 'L'}{one:.1f},{other:.1f}")
        moving = False
    return "".join(parts)


def _places(values: npt.ArrayLike, limits: tuple[float, float], start: float, end: float, log: bool) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    low, high = limits
    if log:
        with np.errstate(divide="ignore", invalid="ignore"):
            array = np.where(array > 0, np.log10(np.where(array > 0, array, 1.0)), np.nan)
        low, high = np.log10(low), np.log10(high)
    return start + (array - low) / ((high - low) or 1.0) * (end - start)


def _ticks(limits: tuple[float, float], log: bool, most: int, least_step: float = 0.0) -> list[float]:
    low, high = min(limits), max(limits)
    if log:
        powers = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
        steps = (1,) if np.log10(high / low) > 2.5 else (1, 2, 5)
        every = [float(step * 10.0**power) for power in powers for step in steps]
        return [value for value in every if low <= value <= high][:: max(1, len(every) // (2 * most))]
    raw = (high - low) / most
    if not np.isfinite(raw) or raw <= 0:
        return [low]
    power = 10.0 ** np.floor(np.log10(raw))
    step = max(power * next(one for one in (1, 2, 5, 10) if one * power >= raw * (1 - 1e-9)), least_step)
    first = int(np.ceil(low / step - 1e-9))
    return [number * float(step) for number in range(first, int(np.floor(high / step + 1e-9)) + 1)]


def _number(value: float, limits: tuple[float, float], log: bool) -> str:
    """Return a number at an axis: no float noise, a true minus sign."""
    if not log and abs(value) < 1e-9 * max(abs(limits[0]), abs(limits[1])):
        value = 0.0
    return f"{value:.5g}".replace("-", "\u2212")


def _each(colors: Sequence[str], chosen: npt.NDArray[np.intp]) -> list[str]:
    return [colors[0]] * chosen.size if len(colors) == 1 else [colors[place] for place in chosen.tolist()]


def _legend_mark(entry: LegendEntry, x: float, y: float) -> str:
    color = _safe(entry.color)
    if entry.mark == "dot":
        return f'<path d="M{x + 10:.1f},{y:.1f}h0" stroke="{color}" stroke-width="7" stroke-linecap="round"/>'
    if entry.mark == "ring":
        return f'<circle cx="{x + 10:.1f}" cy="{y:.1f}" r="3.5" fill="none" stroke="{color}"/>'
    if entry.mark == "cross":
        return f'<path d="M{x + 7:.1f},{y - 3:.1f}l6,6m0,-6l-6,6" stroke="{color}" stroke-width="1.4"/>'
    if entry.mark in ("box", "hatched"):
        before, fill = (_HATCH, "url(#h)") if entry.mark == "hatched" else ("", color)
        place = f'x="{x + 2:.1f}" y="{y - 5:.1f}" width="16" height="10"'
        return f'{before}<rect {place} fill="{fill}" stroke="{FAINT}" stroke-width=".5"/>'
    dashes = ' stroke-dasharray="5 3"' if entry.mark == "dashed" else ""
    return f'<path d="M{x + 2:.1f},{y:.1f}h16" stroke="{color}" stroke-width="2.5"{dashes}/>'


def _png(rgba: npt.NDArray[np.uint8]) -> bytes:
    # OpenCV writes blue, green, red, opacity.
    options = [cv2.IMWRITE_PNG_COMPRESSION, 4, cv2.IMWRITE_PNG_STRATEGY, 0]
    _, data = cv2.imencode(".png", np.ascontiguousarray(rgba[..., [2, 1, 0, 3]]), options)
    return data.tobytes()


def _indexed_png(picture: npt.NDArray[np.uint8], table: npt.NDArray[np.integer[Any]]) -> bytes:
    """Return a picture of few colours as a PNG file of a byte for each pixel, which OpenCV cannot write.

    picture (rows, columns): Places in the table.
    Shapes: table (n, 4), red, green, blue, opacity.
    """
    rows, columns = picture.shape
    # Each row begins with its filter: none.
    lines = np.insert(picture, 0, 0, axis=1).tobytes()
    colors = table.astype(np.uint8)
    pieces = (
        (b"IHDR", struct.pack(">IIBBBBB", columns, rows, 8, 3, 0, 0, 0)),
        (b"PLTE", colors[:, :3].tobytes()),
        (b"tRNS", colors[:, 3].tobytes()),
        (b"IDAT", zlib.compress(lines, 6)),
        (b"IEND", b""),
    )
    content = b"\x89PNG\r\n\x1a\n"
    for name, data in pieces:
        content += struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
    return content


def _rgb(color: str) -> list[int]:
    return [int(color[place : place + 2], 16) for place in (1, 3, 5)]


def _safe(color: str) -> str:
    return html.escape(color, quote=True)


def _quoted(picture: str) -> str:
    """Return a text as an address holds it, as `quote` does: a hundred times as fast for a picture of 200 KB."""
    for sign, escape in _ESCAPED:
        picture = picture.replace(sign, escape)
    return picture if picture.isascii() else _OTHERS.sub(lambda found: quote(found[0]), picture)
