"""Figures that a person changes or saves (``result.plot()``): the one room that needs matplotlib.

Figures are made without pyplot: no global state, no display, and half a second less to import. Views load this room
inside their ``figure``; pictures of reports are stills (`heliogauge.view.stills`).
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.category import StrCategoryFormatter
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FixedFormatter, FuncFormatter

from heliogauge.reporting.look import (
    FAINT,
    INK,
    MISSING,
    MISSING_HATCH,
    MirrorGrid,
    extent_of,
    robust_limit,
    thinned,
)
from heliogauge.validate import FloatArray

DIVERGING = "RdBu_r"
SEQUENTIAL = "viridis"

# 4.8 inch at 120 dpi is 576 px: two figures side by side fill a page of 1160 px without being scaled up.
WIDTH_IN = 4.8
DPI = 120


@dataclass(frozen=True, slots=True, eq=False)
class MapStyle:
    """What stands around a map.

    title: One line.
    unit: Unit of the printed values.
    factor: Printed value for a stored value of one.
    diverging: Colours symmetric about zero; otherwise from `low` upwards.
    limit: Where the colours end, in the printed unit; None: `robust_limit`.
    low: Where sequential colours begin, in the printed unit.
    note: Small line under the title, before the note on clipping.
    """

    title: str
    unit: str
    factor: float = 1.0
    diverging: bool = True
    limit: float | None = None
    low: float = 0.0
    note: str = ""


class ShownFigure(Figure):
    """A figure that notebooks show without pyplot, and whose texts are what they say.

    Names from files are no formulas, whatever signs they hold.
    """

    def _repr_png_(self) -> bytes:
        return png_of(self)

    def draw(self, renderer: Any) -> None:
        """Draw it, with every text plain but the numbers at the axes."""
        for axes in self.axes:
            for axis in (axes.xaxis, axes.yaxis):
                if isinstance(axis.get_major_formatter(), (FixedFormatter, FuncFormatter, StrCategoryFormatter)):
                    make_plain(*axis.get_ticklabels())
            legend = axes.get_legend()
            make_plain(axes.title, axes.xaxis.label, axes.yaxis.label, *axes.texts)
            make_plain(*(legend.get_texts() if legend else ()))
        make_plain(*self.texts, *(text for legend in self.legends for text in legend.get_texts()))
        super().draw(renderer)


def make_plain(*texts: Text) -> None:
    """Let texts stand as they are; "$" begins no formula."""
    for text in texts:
        text.set_parse_math(False)


def new_figure(height_in: float, width_in: float = WIDTH_IN) -> Figure:
    """Return an empty figure with its own canvas."""
    figure = ShownFigure(figsize=(width_in, height_in), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def png_of(figure: Figure) -> bytes:
    """Draw a figure as PNG.

    Returns: The file's content.
    """
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    drawn = np.asarray(canvas.buffer_rgba())[:, :, 2::-1]  # type: ignore[no-untyped-call]
    # OpenCV writes blue, green, red. Without alpha, and half the time that matplotlib's writer takes.
    _, data = cv2.imencode(".png", drawn, [cv2.IMWRITE_PNG_COMPRESSION, 5, cv2.IMWRITE_PNG_STRATEGY, 0])
    return data.tobytes()


def axes_in_inches(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Add axes placed in inches (quicker by 50 ms a figure than a layout engine).

    left, bottom, width, height: Place and size of the axes' box [inch].
    Returns: The axes, with light ticks and frame.
    """
    size_x, size_y = figure.get_size_inches()
    axes = figure.add_axes((left / size_x, bottom / size_y, width / size_x, height / size_y))
    axes.tick_params(labelsize=8, colors=INK, length=3, width=0.6)
    for spine in axes.spines.values():
        spine.set_linewidth(0.6)
        spine.set_color(FAINT)
    return axes


def add_legend(axes: Axes, **options: Any) -> None:
    """Add a small legend that stays readable over lines."""
    legend = axes.legend(fontsize=7, labelcolor=INK, handlelength=1.6, borderpad=0.3, framealpha=0.85, **options)
    legend.get_frame().set(edgecolor="none")
    legend.set_zorder(6)


def add_title(figure: Figure, title: str, note: str = "") -> None:
    """Write the title of a figure, and a smaller line under it.

    title, note: The two lines.
    """
    width, height = figure.get_size_inches()
    figure.text(0.12 / width, 1 - 0.12 / height, title, fontsize=10, fontweight="bold", color=INK, va="top")
    figure.text(0.12 / width, 1 - 0.34 / height, note, fontsize=7.5, color=FAINT, va="top")


def chart_figure(title: str, note: str, x_label: str, y_label: str, height_in: float = 3.3) -> tuple[Figure, Axes]:
    """Return a figure with one chart for lines.

    x_label, y_label: Names of the axes with units.
    """
    figure = new_figure(height_in)
    axes = axes_in_inches(figure, 0.72, 0.55, WIDTH_IN - 0.95, height_in - 1.2)
    axes.set_xlabel(x_label, fontsize=8.5, color=INK)
    axes.set_ylabel(y_label, fontsize=8.5, color=INK)
    axes.grid(visible=True, color="#e4e7ea", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    add_title(figure, title, note)
    return figure, axes


def map_figure(grid: MirrorGrid, values: FloatArray, style: MapStyle) -> Figure:
    """Draw values on the mirror as colours; parts of the mirror without a value are grey and hatched.

    grid: Gives the grid and the aperture.
    values (ny, nx): Values in stored units; NaN where there is none.
    style: Title, unit, colours.
    """
    figure, axes, box = mirror_axes(grid)
    shown = thinned(np.where(grid.aperture, values, np.nan)) * style.factor
    limit = robust_limit(shown) if style.limit is None else style.limit
    image = axes.imshow(
        np.ma.masked_invalid(shown),
        cmap=DIVERGING if style.diverging else SEQUENTIAL,
        vmin=-limit if style.diverging else style.low,
        vmax=limit,
        extent=extent_of(grid),
        origin="lower",
        interpolation="nearest",
        zorder=2,
    )
    cover_outside(axes, grid)
    add_title(figure, style.title, "   ".join(filter(None, (style.note, clipping_words(shown, limit, style)))))
    add_color_bar(figure, image, box, style, shown)
    return figure


def clipping_words(shown: npt.NDArray[np.floating[Any]], limit: float, style: MapStyle) -> str:
    """Say which share of the values lies beyond the colours, and how far they go.

    shown: Values in the printed unit.
    style: Unit and kind of colours.
    """
    values = shown[np.isfinite(shown)]
    if not values.size:
        return "no value anywhere"
    beyond = (np.abs(values) > limit) if style.diverging else ((values > limit) | (values < style.low))
    if not beyond.any():
        return ""
    share = f"{beyond.mean():.1%}" if beyond.mean() >= 0.001 else "<0.1%"
    low = f"{values.min():.3g} to " if (values < -limit if style.diverging else values < style.low).any() else "up to "
    return f"{share} beyond the colours ({low}{values.max():.3g})"


class MirrorAxes(NamedTuple):
    """A figure, its axes, and their box: left, bottom, width, height [inch]."""

    figure: Figure
    axes: Axes
    box_in: tuple[float, float, float, float]


def mirror_axes(grid: MirrorGrid) -> MirrorAxes:
    """Return a figure with axes of the mirror's own proportions, x to the right and y up seen from the front.

    grid: Gives the extent.
    """
    left_m, right_m, low_m, high_m = extent_of(grid)
    left, right, bottom, top = 0.62, 0.95, 0.5, 0.62
    width = WIDTH_IN - left - right
    proportion = (high_m - low_m) / (right_m - left_m)
    height = width * proportion
    if height > 4.4:
        width, height = 4.4 / proportion, 4.4
    # Long troughs: never lower than 1 inch, the axes then leave room above and below.
    box_height = max(height, 1.0)
    figure = new_figure(bottom + box_height + top)
    box = (left + (WIDTH_IN - left - right - width) / 2, bottom + (box_height - height) / 2, width, height)
    axes = axes_in_inches(figure, *box)
    axes.set_xlim(left_m, right_m)
    axes.set_ylim(low_m, high_m)
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]   seen from the front", fontsize=8, color=INK, labelpad=2)
    axes.set_ylabel("y [m]", fontsize=8, color=INK, labelpad=2)
    for spine in axes.spines.values():
        spine.set_visible(False)
    # What shows through where no value covers it.
    axes.patch.set(facecolor=MISSING, hatch="/////", edgecolor=MISSING_HATCH, linewidth=0)
    return MirrorAxes(figure, axes, box)


def cover_outside(axes: Axes, grid: MirrorGrid) -> None:
    """Paint what lies outside the mirror white and draw the mirror's edge.

    grid: Gives the aperture.
    """
    outside = ~thinned(grid.aperture)
    if not outside.any():
        return
    white = np.zeros((*outside.shape, 4), dtype=np.uint8)
    white[outside] = 255
    axes.imshow(white, extent=extent_of(grid), origin="lower", interpolation="nearest", zorder=3)
    if not outside.all():
        rows, columns = outside.shape
        left, right, low, high = extent_of(grid)
        x = left + (np.arange(columns) + 0.5) * (right - left) / columns
        y = low + (np.arange(rows) + 0.5) * (high - low) / rows
        axes.contour(x, y, outside.astype(np.float32), levels=[0.5], colors=FAINT, linewidths=0.7, zorder=4)


def add_color_bar(
    figure: Figure,
    image: ScalarMappable,
    box: tuple[float, float, float, float],
    style: MapStyle,
    shown: npt.NDArray[np.floating[Any]],
) -> None:
    """Add a colour bar to the right of a map, with arrows where values are clipped.

    style: Gives the unit.
    shown: The values, to know which ends are clipped.
    """
    low, high = image.get_clim()
    values = shown[np.isfinite(shown)]
    above, below = bool((values > high).any()), bool((values < low).any())
    extend = {(True, True): "both", (True, False): "max", (False, True): "min", (False, False): "neither"}[above, below]
    left, bottom, width, height = box
    bar_axes = axes_in_inches(figure, left + width + 0.12, bottom, 0.13, height)
    bar = figure.colorbar(image, cax=bar_axes, extend=extend)
    bar.outline.set_linewidth(0.5)
    bar_axes.tick_params(labelsize=8, colors=INK, length=2.5, width=0.6)
    if style.unit:
        bar.set_label(f"[{style.unit}]", fontsize=8, color=INK, labelpad=3)


def set_equal_limits(axes: Axes, x: FloatArray, y: FloatArray, *, spare: float = 0.08) -> None:
    """Set limits around points so that both axes have one scale, whatever the box.

    axes: The axes; their figure has its final size.
    x, y (n,): Points that must be seen.
    spare: Margin on each side as a share of the span.
    """
    figure_width, figure_height = axes.figure.get_size_inches()  # type: ignore[union-attr]
    box = axes.get_position()
    width, height = box.width * figure_width, box.height * figure_height
    scale = (1 + 2 * spare) * max(float(np.ptp(x)) / width, float(np.ptp(y)) / height, 1e-9)
    for limits, values, size in ((axes.set_xlim, x, width), (axes.set_ylim, y, height)):
        middle = 0.5 * float(values.min() + values.max())
        limits(middle - 0.5 * scale * size, middle + 0.5 * scale * size)
