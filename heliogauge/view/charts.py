"""Charts with readout: lines with sigma bands, points, bars and steps."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from heliogauge.errors import InputError
from heliogauge.reporting.canvas import add_legend, chart_figure, set_equal_limits
from heliogauge.reporting.html import Html, show
from heliogauge.validate import FloatArray
from heliogauge.view.arrays import PAGE, ArrayStore, reading_step
from heliogauge.view.markup import view_frame


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


@dataclass(frozen=True, eq=False)
class ChartView:
    """A chart whose values are read with the pointer.

    name: What it shows; its title.
    x_label, y_label: Names of the axes with units.
    series: What is drawn, later ones above.
    note: A line under the title.
    equal: One scale for both axes.
    x_log, y_log: Logarithmic axes.
    y_down: y grows downwards, as in images.
    figures: Static figures for notebook and print; empty: the chart, drawn here.
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
    y_down: bool = False
    figures: Sequence[Figure] = field(default=())

    def __post_init__(self) -> None:
        for one in self.series:
            lengths = {len(one.x), len(one.y), *([len(one.labels)] if one.labels else [])}
            lengths |= set() if one.sigma is None else {len(one.sigma)}
            if len(lengths) > 1:
                raise InputError(f"chart {self.name}: series {one.name} has lengths {sorted(lengths)}")

    @cached_property
    def static(self) -> Html:
        """The figures, drawn once."""
        return show(*(self.figures or [self.figure()]))

    def _repr_html_(self) -> str:
        return self.static.text

    def page_html(self, store: ArrayStore = PAGE) -> str:
        """Return the view for a page."""
        axes = {"equal": self.equal, "x_log": self.x_log, "y_log": self.y_log, "y_down": self.y_down}
        labels = {"name": self.name, "note": self.note, "x_label": self.x_label, "y_label": self.y_label}
        spec = {**labels, **axes, "series": [self._series_spec(one, store) for one in self.series]}
        return view_frame("chart", self.name, spec, self.static)

    def _series_spec(self, one: ChartSeries, store: ArrayStore) -> dict[str, Any]:
        def keep(values: FloatArray, log: bool) -> dict[str, Any]:
            array = np.asarray(values, dtype=np.float64)
            step = reading_step(array)
            if log and (array > 0).any():
                # The smallest value of a logarithmic axis is read as closely as the largest.
                step = min(step, reading_step(np.min(array, keepdims=True, initial=np.inf, where=array > 0)))
            return store.numbers(array, step)

        texts = "\n".join(" ".join(text.split()) for text in one.labels)
        return {
            "name": one.name,
            "x": keep(one.x, self.x_log),
            "y": keep(one.y, self.y_log),
            "sigma": None if one.sigma is None else keep(one.sigma, self.y_log),
            "color": one.color,
            "mark": one.mark.value,
            "labels": store.content(texts.encode(), "text/plain") if one.labels else None,
            "dashed": one.dashed,
            "size": one.size_px,
        }

    def figure(self) -> Figure:
        """Draw the chart."""
        figure, axes = chart_figure(self.name, self.note, self.x_label, self.y_label)
        for one in self.series:
            x, y = np.asarray(one.x), np.asarray(one.y)
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
        if len(self.series) > 1:
            add_legend(axes, loc="best")
        return figure
