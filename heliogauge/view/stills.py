"""Still pictures of maps and charts: SVG written directly, for print, notebooks and browsers without script.

A still takes 5 ms and is sharp on paper; matplotlib takes 0.1 s for each figure and 0.4 s to load. Figures that a
person changes or saves are matplotlib's (`heliogauge.reporting.figures`, ``result.plot()``).
"""

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.reporting.html import Html
from heliogauge.reporting.look import FAINT, INK, MISSING, MISSING_HATCH
from heliogauge.validate import BoolArray, FloatArray

#: Two stills side by side fill a page of 1160 px.
WIDTH_PX = 576.0

_GRID = "#e4e7ea"
_FONT = "font-family=\"system-ui, 'DejaVu Sans', sans-serif\""
# ColorBrewer's RdBu, from low (blue) to high (red), and viridis: both keep their order for the colour-blind.
_DIVERGING = (
    "#053061 #2166ac #4393c3 #92c5de #d1e5f0 #f7f7f7 #fddbc7 #f4a582 #d6604d #b2182b #67001f".split()  # noqa: SIM905
)
_SEQUENTIAL = (
    "#440154 #482475 #414487 #355f8d #2a788e #21918c #22a884 #44bf70 #7ad151 #bddf26 #fde725".split()  # noqa: SIM905
)


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

    def write(self, x: float, y: float, text: str, **look: Any) -> None:
        """Write a text; underscores in the names of attributes become hyphens."""
        more = "".join(f' {name.replace("_", "-")}="{value}"' for name, value in look.items())
        self.add(f'<text x="{x:.1f}" y="{y:.1f}"{more}>{html.escape(text)}</text>')

    def title(self, title: str, note: str) -> None:
        """Write the title and the smaller line under it."""
        self.write(12, 20, title, font_weight="bold", font_size=14)
        self.write(12, 37, note, font_size=11, fill=FAINT)

    def axes(self, x_label: str, y_label: str, *, grid: bool) -> None:
        """Draw ticks, their numbers and the names of the axes."""
        left, top, right, bottom = self.box
        lines = []
        for value in _ticks(self.x_limits, self.x_log, max(int((right - left) / 62), 2), self.least_x_step):
            x = float(self.place_x(value))
            lines.append(f"M{x:.1f},{bottom:.1f}v4" + (f"M{x:.1f},{top:.1f}V{bottom:.1f}" if grid else ""))
            self.write(x, bottom + 16, _number(value, self.x_limits, self.x_log), text_anchor="middle")
        for value in _ticks(self.y_limits, self.y_log, max(int((bottom - top) / 34), 2)):
            y = float(self.place_y(value))
            lines.append(f"M{left:.1f},{y:.1f}h-4" + (f"M{left:.1f},{y:.1f}H{right:.1f}" if grid else ""))
            self.write(left - 7, y + 4, _number(value, self.y_limits, self.y_log), text_anchor="end")
        self.parts.insert(0, f'<path d="{"".join(lines)}" fill="none" stroke="{_GRID if grid else FAINT}"/>')
        if grid:
            self.add(f'<path d="M{left:.1f},{top:.1f}V{bottom:.1f}H{right:.1f}" fill="none" stroke="{FAINT}"/>')
        middle_x, middle_y = 0.5 * (left + right), 0.5 * (top + bottom)
        self.write(middle_x, bottom + 33, x_label, text_anchor="middle")
        turned = f"rotate(-90 14 {middle_y:.1f})"
        self.write(14, middle_y, y_label, text_anchor="middle", transform=turned)

    def html(self, words: str) -> Html:
        """Return the picture as an image within the page.

        words: What it shows, for those who cannot see it.
        """
        svg = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width:.0f} {self.height:.0f}" '
            f'width="{self.width:.0f}" height="{self.height:.0f}" {_FONT} font-size="11.5" fill="{INK}">'
            f'<rect width="100%" height="100%" fill="#fff"/>{"".join(self.parts)}</svg>'
        )
        data = base64.b64encode(svg.encode()).decode("ascii")
        alt = html.escape(words, quote=True)
        return Html(f'<figure><img alt="{alt}" src="data:image/svg+xml;base64,{data}"></figure>')


def side_by_side(pictures: Sequence[Html]) -> Html:
    """Put pictures beside each other, as many as the page has room for."""
    return Html(f'<div class="figures">{"".join(picture.text for picture in pictures)}</div>')


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

    def still(self, *, tallest_px: float = 480.0) -> Html:
        """Draw the map in its own proportions."""
        left, right, bottom, top = self.extent
        room = WIDTH_PX - 58 - 92
        share = (top - bottom) / max(right - left, 1e-300)
        width = min(room, tallest_px / max(share, 1e-9))
        height = max(width * share, 24.0)
        x0 = 58 + 0.5 * (room - width)
        box = (x0, 48.0, x0 + width, 48.0 + height)
        limits = (top, bottom) if self.y_down else (bottom, top)
        sheet = Sheet(WIDTH_PX, height + 96, box, (left, right), limits)
        sheet.title(self.title, self.note)
        place = f'x="{x0:.1f}" y="48" width="{width:.1f}" height="{height:.1f}"'
        hatched = self.aperture & ~np.isfinite(self.values)
        if hatched.any():
            sheet.add(
                '<pattern id="h" width="7" height="7" patternUnits="userSpaceOnUse" patternTransform="rotate(45)">'
                f'<rect width="7" height="7" fill="{MISSING}"/><path d="M0,0V7" stroke="{MISSING_HATCH}" '
                f'stroke-width="1.6"/></pattern><rect {place} fill="url(#h)"/>'
            )
        sheet.add(
            f'<image {place} preserveAspectRatio="none" image-rendering="pixelated" style="image-rendering:pixelated" '
            f'href="data:image/png;base64,{self._image()}"/>'
        )
        sheet.axes(f"x [{self.axis_unit}]", f"y [{self.axis_unit}]", grid=False)
        self._color_bar(sheet)
        return sheet.html(f"{self.title}. {self.note}")

    def _image(self) -> str:
        share = (self.values - self.low) / max(self.high - self.low, 1e-300)
        table = _color_table(_DIVERGING if self.diverging else _SEQUENTIAL)
        index = np.clip(np.nan_to_num(share, nan=0.0) * 255 + 0.5, 0, 255).astype(np.uint8)
        picture = np.empty((*index.shape, 4), dtype=np.uint8)
        picture[..., :3] = table[index][..., ::-1]
        picture[..., 3] = np.where(self.aperture & ~np.isfinite(self.values), 0, 255)
        picture[~self.aperture] = 255
        drawn = picture if self.y_down else picture[::-1]
        options = [cv2.IMWRITE_PNG_COMPRESSION, 4, cv2.IMWRITE_PNG_STRATEGY, 0]
        _, data = cv2.imencode(".png", np.ascontiguousarray(drawn), options)
        return base64.b64encode(data.tobytes()).decode("ascii")

    def _color_bar(self, sheet: Sheet) -> None:
        _, top, right, bottom = sheet.box
        colors = _DIVERGING if self.diverging else _SEQUENTIAL
        stops = "".join(
            f'<stop offset="{index / (len(colors) - 1):.2f}" stop-color="{color}"/>'
            for index, color in enumerate(colors)
        )
        x = right + 12
        sheet.add(
            f'<linearGradient id="c" x1="0" y1="1" x2="0" y2="0">{stops}</linearGradient><rect x="{x:.1f}" '
            f'y="{top:.1f}" width="13" height="{bottom - top:.1f}" fill="url(#c)" stroke="{FAINT}" stroke-width=".5"/>'
        )
        limits = (self.low, self.high)
        for value in _ticks(limits, log=False, most=max(int((bottom - top) / 40), 2)):
            y = float(_places(value, limits, bottom, top, log=False))
            sheet.write(x + 18, y + 4, _number(value, limits, log=False))
        if self.unit:
            sheet.write(x - 2, bottom + 17, f"[{self.unit}]")


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


def _color_table(colors: Sequence[str]) -> npt.NDArray[np.uint8]:
    anchors = np.array([[int(color[place : place + 2], 16) for place in (1, 3, 5)] for color in colors], np.float64)
    at = np.linspace(0, len(colors) - 1, 256)
    columns = [np.interp(at, np.arange(len(colors)), anchors[:, channel]) for channel in range(3)]
    return np.rint(np.stack(columns, axis=1)).astype(np.uint8)
