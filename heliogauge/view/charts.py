"""Charts with readout: lines with sigma bands, points, bars and steps."""

import html
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.files.extras import of_extra
from heliogauge.reporting.html import Html
from heliogauge.validate import FloatArray
from heliogauge.view.arrays import PAGE, ArrayStore, reading_step
from heliogauge.view.markup import view_frame
from heliogauge.view.stills import (
    WIDTH_PX,
    Sheet,
    chart_limits,
    equal_limits,
    jpeg_of,
    path_of,
    side_by_side,
    time_ticks,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Mark(StrEnum):
    """How a series is drawn."""

    LINE = "line"
    POINTS = "points"
    BARS = "bars"
    STEPS = "steps"


@dataclass(frozen=True, slots=True, eq=False)
class ChartSeries:
    """One series of a chart, in printed units.

    name: What the legend shows.
    x, y (n,): Places; NaN leaves a gap.
    color: As ``#rrggbb``.
    mark: Line, points, bars (x are their middles) or steps.
    sigma (n,): Standard deviation of y: a band about a line, bars at points; None: none.
    labels: What is shown beside the values of a point when the pointer is at it.
    names: What is written beside each point, as far as there is room; empty: nothing.
    dashed: Whether the line is dashed.
    size_px: Diameter of points, width of lines.
    """

    name: str
    x: FloatArray
    y: FloatArray
    color: str
    mark: Mark = Mark.LINE
    sigma: FloatArray | None = None
    labels: Sequence[str] = ()
    dashed: bool = False
    size_px: float = 1.5
    names: Sequence[str] = ()


@dataclass(frozen=True, slots=True, eq=False)
class ChartImage:
    """A grey picture behind the series of a chart.

    image (rows, columns): Grey values, from the top.
    extent: x at its left and right edge, y at its bottom and top edge.
    """

    image: npt.NDArray[np.uint8]
    extent: tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class ChartView:
    """A chart whose values are read with the pointer.

    name: What it shows; its title.
    x_label, y_label: Names of the axes with units.
    series: What is drawn, later ones above.
    note: A line under the title.
    equal: One scale for both axes.
    x_log, y_log: Logarithmic axes.
    x_counts: x numbers things from 1 on: whole ticks, and half a step of room on each side.
    x_time: x are seconds since 1970, UTC: ticks and readout are dates.
    y_down: y grows downwards, as in images.
    background: A picture behind the series; None: paper.
    stills: Still pictures that stand for it in notebook and print; empty: drawn here.
    InputError: Lengths of a series do not fit.
    """

    name: str
    x_label: str
    y_label: str
    series: tuple[ChartSeries, ...]
    note: str = ""
    equal: bool = False
    x_log: bool = False
    y_log: bool = False
    x_counts: bool = False
    x_time: bool = False
    y_down: bool = False
    background: ChartImage | None = None
    stills: Sequence[Html] = ()

    def __post_init__(self) -> None:
        for one in self.series:
            lengths = {len(one.x), len(one.y), *(len(texts) for texts in (one.labels, one.names) if texts)}
            lengths |= set() if one.sigma is None else {len(one.sigma)}
            if len(lengths) > 1:
                raise InputError(f"chart {self.name}: series {one.name} has lengths {sorted(lengths)}")

    @cached_property
    def static(self) -> Html:
        """The still picture, drawn once."""
        return side_by_side(self.stills or [self.still()])

    def _repr_html_(self) -> str:
        return self.static.text

    def page_html(self, store: ArrayStore = PAGE) -> str:
        """Return the view for a page."""
        axes = {"equal": self.equal, "x_log": self.x_log, "y_log": self.y_log, "y_down": self.y_down}
        axes["x_counts"] = self.x_counts
        labels = {"name": self.name, "note": self.note, "x_label": self.x_label, "y_label": self.y_label}
        start = self._start_s() if self.x_time else None
        series = [self._series_spec(one, store, start or 0.0) for one in self.series]
        spec: dict[str, Any] = {**labels, **axes, "x_from": start, "series": series}
        if self.background is not None:
            data = jpeg_of(self.background.image)
            picture = {"image": store.content(data, "image/jpeg"), "extent": list(self.background.extent)}
            spec["background"] = picture
        return view_frame("chart", self.name, spec, self.static)

    def _start_s(self) -> float:
        """Return the first time; from there on seconds need few digits."""
        return float(min((np.nanmin(one.x) for one in self.series if np.isfinite(one.x).any()), default=0.0))

    def _series_spec(self, one: ChartSeries, store: ArrayStore, start: float) -> dict[str, Any]:
        def keep(values: FloatArray, log: bool) -> dict[str, Any]:
            array = np.asarray(values, dtype=np.float64)
            step = reading_step(array)
            if np.isfinite(array).any():
                # Values far from zero that lie close together are told apart.
                step = min(step, reading_step(array - np.nanmean(array)))
            if log and (array > 0).any():
                # The smallest value of a logarithmic axis is read as closely as the largest.
                step = min(step, reading_step(np.min(array, keepdims=True, initial=np.inf, where=array > 0)))
            return store.numbers(array, step)

        x = np.asarray(one.x, dtype=np.float64)
        texts, names = ("\n".join(" ".join(text.split()) for text in lines) for lines in (one.labels, one.names))
        return {
            "name": one.name,
            "x": store.numbers(x - start, 1.0) if self.x_time else keep(x, self.x_log),
            "y": keep(one.y, self.y_log),
            "sigma": None if one.sigma is None else keep(one.sigma, self.y_log),
            "color": one.color,
            "mark": one.mark.value,
            "labels": store.content(texts.encode(), "text/plain") if one.labels else None,
            "names": store.content(names.encode(), "text/plain") if one.names else None,
            "dashed": one.dashed,
            "size": one.size_px,
        }

    def figure(self) -> "Figure":
        """Draw the chart.

        InputError: matplotlib is not installed.
        """
        of_extra("matplotlib")
        from matplotlib.ticker import MaxNLocator

        from heliogauge.reporting.canvas import add_legend, chart_figure, set_equal_limits

        figure, axes = chart_figure(self.name, self.note, self.x_label, self.y_label)
        for one in self.series:
            x, y = np.asarray(one.x), np.asarray(one.y)
            if self.x_time:
                x = np.where(np.isfinite(x), 1e3 * x, np.iinfo(np.int64).min).astype("datetime64[ms]")
            if one.mark is Mark.BARS:
                width = float(np.min(np.diff(np.sort(x)))) if x.size > 1 else 1.0
                axes.bar(x, y, width=0.95 * width, color=one.color, label=one.name)
                continue
            if one.sigma is not None and one.mark is Mark.POINTS:
                axes.errorbar(x, y, one.sigma, fmt="none", ecolor=one.color, elinewidth=0.6)
            elif one.sigma is not None:
                axes.fill_between(x, y - one.sigma, y + one.sigma, color=one.color, alpha=0.25, linewidth=0)
            points = one.mark is Mark.POINTS
            axes.plot(
                x,
                y,
                color=one.color,
                label=one.name,
                linestyle="none" if points else "--" if one.dashed else "-",
                linewidth=0.8 * one.size_px,
                marker="o" if points else None,
                markersize=0.8 * one.size_px,
                markeredgewidth=0,
                drawstyle="steps-mid" if one.mark is Mark.STEPS else "default",
            )
            for name, a, b in zip(one.names, x, y, strict=bool(one.names)):
                axes.annotate(name, (a, b), (3, 0), textcoords="offset points", fontsize=6, va="center")
        if self.equal and self.series:
            places = [np.concatenate([np.asarray(getattr(one, axis)) for one in self.series]) for axis in "xy"]
            known = np.isfinite(places[0]) & np.isfinite(places[1])
            if known.any():
                set_equal_limits(axes, places[0][known], places[1][known])
        if self.x_log:
            axes.set_xscale("log")
        if self.y_log:
            axes.set_yscale("log")
        if self.y_down:
            axes.invert_yaxis()
        if self.x_counts:
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        if len(self.series) > 1:
            add_legend(axes, loc="best")
        return figure

    def still(self, *, width: float = WIDTH_PX) -> Html:
        """Draw the chart for notebook and print; letters keep their size in a narrower one."""
        return self.sheet(width=width).html(f"{self.name}. {self.note}")

    def sheet(self, *, width: float = WIDTH_PX) -> Sheet:
        """Draw the chart as a picture."""
        height = 380.0 * width / WIDTH_PX
        box = (70.0, 50.0, width - 16, height - 46)
        reach = [(np.asarray(one.y, dtype=np.float64), one.sigma) for one in self.series]
        spans = [part for y, sigma in reach for part in ((y,) if sigma is None else (y - sigma, y + sigma))]
        based = [np.zeros(1)] if any(one.mark in (Mark.BARS, Mark.STEPS) for one in self.series) else []
        x_limits = chart_limits([one.x for one in self.series], log=self.x_log, spare=0.02)
        if self.x_counts:
            numbers = np.concatenate([np.asarray(one.x, dtype=np.float64) for one in self.series])
            x_limits = float(numbers.min()) - 0.5, float(numbers.max()) + 0.5
        y_limits = chart_limits([*spans, *based], log=self.y_log)
        if self.background is not None:
            x_limits, y_limits = self.background.extent[:2], self.background.extent[2:]
        if self.equal:
            x_limits, y_limits = equal_limits(x_limits, y_limits, box)
        sheet = Sheet(
            width,
            height,
            box,
            x_limits,
            y_limits[::-1] if self.y_down else y_limits,
            self.x_log,
            self.y_log,
            least_x_step=1.0 if self.x_counts else 0.0,
        )
        sheet.title(self.name, self.note)
        if self.background is not None:
            sheet.photo(self.background.image, self.background.extent)
        ticks = time_ticks(x_limits, most=max(int(width / 110), 2)) if self.x_time else None
        sheet.axes(self.x_label, self.y_label, grid=True, x_ticks=ticks)
        left, top, right, bottom = box
        sheet.add(
            f'<clipPath id="b"><rect x="{left}" y="{top}" width="{right - left}" height="{bottom - top}"/></clipPath>'
        )
        sheet.add(f'<g clip-path="url(#b)">{"".join(_drawn(one, sheet) for one in self.series)}</g>')
        _write_names(self.series, sheet)
        if len(self.series) > 1:
            _legend(self.series, sheet)
        return sheet


def _drawn(one: ChartSeries, sheet: Sheet) -> str:
    """Return a series as SVG."""
    x, y = sheet.place_x(one.x), sheet.place_y(one.y)
    color = html.escape(one.color, quote=True)
    known = np.isfinite(x) & np.isfinite(y)
    if not known.any():
        return ""
    drawn = "" if one.sigma is None else _drawn_sigma(one, sheet, color)
    if one.mark is Mark.POINTS:
        path = "".join(f"M{a:.1f},{b:.1f}h0" for a, b in zip(x[known].tolist(), y[known].tolist(), strict=True))
        look = f'stroke="{color}" stroke-width="{max(one.size_px, 1.0):.1f}" stroke-linecap="round"'
        return f'{drawn}<path d="{path}" {look}/>'
    look = f'fill="none" stroke="{color}" stroke-width="{one.size_px:.1f}" stroke-linejoin="round"'
    if one.mark is Mark.LINE:
        dashes = ' stroke-dasharray="5 3"' if one.dashed else ""
        return f'{drawn}<path d="{path_of(x, y)}" {look}{dashes}/>'
    # Half of the smallest distance between neighbours: bars touch, steps lie in the middle.
    half = 0.5 * float(np.min(np.diff(np.sort(x[known])))) if np.count_nonzero(known) > 1 else 10.0
    if one.mark is Mark.STEPS:
        middles = np.repeat(x, 2) + np.tile([-half, half], x.size)
        return f'{drawn}<path d="{path_of(middles, np.repeat(y, 2))}" {look}/>'
    base = float(sheet.place_y(max(0.0, min(sheet.y_limits))))
    bars = zip((x[known] - 0.95 * half).tolist(), y[known].tolist(), strict=True)
    path = "".join(f"M{a:.1f},{base:.1f}V{b:.1f}h{1.9 * half:.1f}V{base:.1f}Z" for a, b in bars)
    return f'{drawn}<path d="{path}" fill="{color}"/>'


def _drawn_sigma(one: ChartSeries, sheet: Sheet, color: str) -> str:
    """Return the sigma of a series as SVG: bars at points, a band about a line."""
    x, y, sigma = sheet.place_x(one.x), np.asarray(one.y, dtype=np.float64), np.asarray(one.sigma, dtype=np.float64)
    low, high = sheet.place_y(y - sigma), sheet.place_y(y + sigma)
    known = np.isfinite(x) & np.isfinite(low) & np.isfinite(high)
    if one.mark is Mark.POINTS:
        ends = zip(x[known].tolist(), low[known].tolist(), high[known].tolist(), strict=True)
        path = "".join(f"M{a:.1f},{b:.1f}V{c:.1f}" for a, b, c in ends)
        return f'<path d="{path}" stroke="{color}" stroke-width=".7"/>'
    breaks = np.flatnonzero(np.diff(known.astype(np.int8))) + 1
    bands = []
    for piece in np.split(np.arange(x.size), breaks):
        if known[piece[0]]:
            around = np.concatenate([x[piece], x[piece[::-1]]]), np.concatenate([low[piece], high[piece[::-1]]])
            bands.append(f"{path_of(*around)}Z")
    return f'<path d="{"".join(bands)}" fill="{color}" opacity=".22"/>'


def _write_names(series: Sequence[ChartSeries], sheet: Sheet) -> None:
    """Write names beside points where they cover neither each other nor a point."""
    points = [one for one in series if one.mark is Mark.POINTS]
    if not any(one.names for one in points):
        return
    left, top, right, bottom = sheet.box
    taken = np.concatenate(
        [
            np.stack([sheet.place_x(one.x), sheet.place_y(one.y), *np.full((2, len(one.x)), one.size_px)], axis=1)
            for one in points
        ]
    )
    for one in points:
        away = one.size_px / 2 + 3
        for name, x, y in zip(one.names, sheet.place_x(one.x).tolist(), sheet.place_y(one.y).tolist(), strict=False):
            wide, high = 6.4 * len(name), 11.0
            near, level = away + high / 2, float(np.clip(x, left + wide / 2 + 1, right - wide / 2 - 1)) - x
            beside = [(away + wide / 2, 0.0), (-away - wide / 2, 0.0), (level, -near), (level, near)]
            beside += [(level, -near - high), (level, near + high)]
            for across, along in beside if name else []:
                a, b = x + across, y + along
                apart = np.abs(taken[:, :2] - [a, b]) * 2 >= taken[:, 2:] + [wide, high]
                inside = left < a - wide / 2 and a + wide / 2 < right and top < b - high / 2 and b + high / 2 < bottom
                if inside and apart.any(axis=1).all():
                    taken = np.vstack([taken, [a, b, wide, high]])
                    place = f'x="{a:.1f}" y="{b + 3.5:.1f}" font-size="10" text-anchor="middle"'
                    sheet.add(f"<text {place}>{html.escape(name)}</text>")
                    break


def _legend(series: Sequence[ChartSeries], sheet: Sheet) -> None:
    """Write the names in the corner of the box that fewest points are near."""
    left, top, right, bottom = sheet.box
    wide, tall = 32 + 6.4 * max(len(one.name) for one in series), 17.0 * len(series) + 6
    x = np.concatenate([sheet.place_x(one.x) for one in series])
    y = np.concatenate([sheet.place_y(one.y) for one in series])
    corners = [(a, b) for b in (top + 4, bottom - tall - 4) for a in (right - wide - 4, left + 4)]
    inside = [np.count_nonzero((x > a) & (x < a + wide) & (y > b) & (y < b + tall)) for a, b in corners]
    a, b = corners[int(np.argmin(inside))]
    sheet.add(f'<rect x="{a:.1f}" y="{b:.1f}" width="{wide:.1f}" height="{tall:.1f}" fill="#fff" opacity=".85"/>')
    for number, one in enumerate(series):
        middle = b + 12 + 17 * number
        color, dashes = html.escape(one.color, quote=True), ' stroke-dasharray="5 3"' if one.dashed else ""
        if one.mark is Mark.POINTS:
            look = f'd="M{a + 12:.1f},{middle:.1f}h0" stroke-width="7" stroke-linecap="round"'
        else:
            look = f'd="M{a + 4:.1f},{middle:.1f}h16" stroke-width="2.5"{dashes}'
        sheet.add(f'<path {look} stroke="{color}"/>')
        sheet.write(a + 25, middle + 4, one.name)
