"""What the camera saw, in a trough's report: slices of the mirror through all photos, one photo with outlines."""

from typing import TYPE_CHECKING, Literal

import numpy as np

from heliogauge.reporting.canvas import (
    FAINT,
    INK,
    WIDTH_IN,
    add_legend,
    add_title,
    axes_in_inches,
    chart_figure,
    new_figure,
)
from heliogauge.reporting.html import Html, show
from heliogauge.validate import BoolArray, FloatArray
from observer.files import OVERLAY, read_overlay
from observer.report.results import TroughResults

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MRAD = 1e3
#: Colours that stay apart from grey brightness and from each other.
_DESIGN, _MEASURED = "#ffb000", "#00b7eb"
_LOWER, _UPPER, _REJECTED = "#00b7eb", "#ffb000", "#e4572e"
_HEIGHT_IN = 4.4
_TALLEST_IN = 6.5


def overlay(results: TroughResults) -> Html:
    """Return one photo with the outline of the tube's reflection, predicted and as measured.

    Returns: A figure; a sentence where the folder holds no photo.
    """
    if not (results.base.folder / OVERLAY).is_file():
        return Html("<p>The folder holds no photo.</p>")
    note = (
        "Dark or bright band: the absorber as the mirror shows it. Where the two outlines part, mirror or absorber "
        "are not as designed; where the solid one leaves the band, the result would be wrong. Gaps in the solid "
        "outline: not measured."
    )
    return show(overlay_figure(results), caption=note)


def overlay_figure(results: TroughResults) -> "Figure":
    """Draw the photo that gave most edges with both outlines."""
    from matplotlib.lines import Line2D

    image, nodes, name = read_overlay(results.base.folder)
    rows, columns = image.shape
    width = 2 * WIDTH_IN - 0.2
    height = width * rows / columns
    if height > _TALLEST_IN:
        width, height = _TALLEST_IN * columns / rows, _TALLEST_IN
    figure = new_figure(height + 0.95, 2 * WIDTH_IN)
    axes = axes_in_inches(figure, (2 * WIDTH_IN - width) / 2, 0.1, width, height)
    axes.imshow(image, cmap="gray", vmin=0, vmax=255, interpolation="antialiased")
    kinds: tuple[tuple[str, str, Literal["--", "-"], str], ...] = (
        ("design", _DESIGN, "--", "mirror and absorber as designed"),
        ("measured", _MEASURED, "-", "mirror and absorber as measured"),
    )
    for kind, color, style, _ in kinds:
        beside = np.ma.masked_invalid(nodes[f"beside_{kind}"])
        axes.contour(nodes["x_px"], nodes["y_px"], beside, levels=[0.0], colors=color, linewidths=1.1, linestyles=style)
    axes.set_xlim(-0.5, columns - 0.5)
    axes.set_ylim(rows - 0.5, -0.5)
    axes.set(xticks=[], yticks=[])
    lines = [Line2D([], [], color=color, linestyle=style, label=label) for _, color, style, label in kinds]
    legend_axes = axes_in_inches(figure, 0.05, height + 0.08, 2 * WIDTH_IN - 0.1, 0.32)
    legend_axes.set_axis_off()
    legend_axes.legend(handles=lines, loc="center left", ncols=2, fontsize=8, frameon=False, labelcolor=INK)
    legend_axes.patch.set_alpha(0.0)
    note = "lines: where the reflected line of sight touches the tube"
    add_title(figure, f"The absorber's reflection in {name}", note)
    return figure


def slices(results: TroughResults) -> Html:
    """Return slices of the mirror through all photos, and what each edge says of the angle there.

    Returns: Two figures for each slice.
    """
    drawn = []
    for number in range(len(results.slices.y_m)):
        drawn += [slice_figure(results, number), angle_figure(results, number)]
    note = (
        "Left: one row of the mirror in every photo, one photo above the other; the band is the absorber's reflection, "
        "which moves across the mirror as the camera moves. Right: every edge alone (dots) and the solution (line with "
        "a band of 1 sigma of its noise). Dots on one line, of both edges alike: the measurement agrees with itself."
    )
    return show(*drawn, caption=note)


def slice_figure(results: TroughResults, number: int) -> "Figure":
    """Draw one row of the mirror in all photos with the edges that were found.

    Returns: Brightness over place across the mirror and place of the camera.
    """
    stored = results.slices
    order = np.argsort(stored.eyes_m[:, 0], kind="stable")
    camera = stored.eyes_m[order, 0]
    brightness = np.ma.masked_equal(stored.brightness[number][order], 0)
    figure, axes = chart_figure(
        f"The absorber's reflection at y = {stored.y_m[number]:.2f} m",
        f"{camera.size} photos; brightness, and edges that were found",
        "x on the mirror [m]",
        "camera, x [m]",
        _HEIGHT_IN,
    )
    axes.grid(visible=False)
    axes.set_facecolor("#c9cdd2")
    high = float(np.percentile(brightness.compressed(), 99.5)) if brightness.count() else 255.0
    axes.pcolormesh(_borders(stored.x_m), _borders(camera), brightness, cmap="gray", vmin=0, vmax=high, rasterized=True)
    edges = results.edges
    here = _in_row(results, float(stored.y_m[number]))
    place = results.eyes_m[edges.photo, 0]
    kinds = (
        ("lower edge", edges.used & (edges.side < 0), _LOWER, "."),
        ("upper edge", edges.used & (edges.side > 0), _UPPER, "."),
        ("not used", ~edges.used, _REJECTED, "x"),
    )
    for label, chosen, color, marker in kinds:
        own = here & chosen
        axes.plot(
            edges.x_m[own],
            place[own],
            marker,
            color=color,
            markersize=2.2,
            linestyle="none",
            label=f"{label} ({int(own.sum())})",
            markeredgewidth=0.6,
        )
    axes.set_xlim(stored.x_m[0], stored.x_m[-1])
    # The reflection runs from the lower left to the upper right, whatever the mirror.
    add_legend(axes, loc="lower right", markerscale=3)
    return figure


def angle_figure(results: TroughResults, number: int) -> "Figure":
    """Draw what each edge of one slice says of the reflector-absorber angle, and the solution.

    Returns: theta_ra over the place across the mirror [mrad].
    """
    y = float(results.slices.y_m[number])
    slope_map, edges = results.base.slope_map, results.edges
    row = int(np.argmin(np.abs(slope_map.y_m - y)))
    theta = np.where(slope_map.valid[row], results.angles["theta_ra"][row], np.nan)
    band = slope_map.sigma_random_x[row]
    here = edges.used & _in_row(results, y)
    alone = np.interp(edges.x_m, slope_map.x_m, theta) - 0.5 * edges.residual_rad
    rms = float(np.sqrt(np.mean(edges.residual_rad[here] ** 2))) if here.any() else float("nan")
    figure, axes = chart_figure(
        f"Reflector-absorber angle at y = {y:.2f} m",
        f"dots: each edge alone, RMS {0.5 * _MRAD * rms:.3f} mrad about the line; +: normal turned towards +x",
        "x on the mirror [m]",
        "theta_ra [mrad]",
        _HEIGHT_IN,
    )
    for sign, color, label in ((-1, _LOWER, "lower edge"), (1, _UPPER, "upper edge")):
        own = here & (edges.side == sign)
        axes.plot(edges.x_m[own], _MRAD * alone[own], ".", color=color, markersize=3, linestyle="none", label=label)
    axes.fill_between(
        slope_map.x_m, _MRAD * (theta - band), _MRAD * (theta + band), color=FAINT, alpha=0.35, linewidth=0
    )
    axes.plot(slope_map.x_m, _MRAD * theta, color=INK, linewidth=0.9, label="solution")
    for edge in results.collector.panel_edges_x_m[1:-1]:
        axes.axvline(edge, color=FAINT, linewidth=0.5)
    axes.set_xlim(results.slices.x_m[0], results.slices.x_m[-1])
    _leave_room_for_legend(axes, _MRAD * theta)
    add_legend(axes, loc="upper center", ncols=3, markerscale=2)
    return figure


def _in_row(results: TroughResults, y_m: float) -> BoolArray:
    """Return which edges belong to a row of the map; poses that were adjusted later move them a little."""
    rows = results.base.slope_map.y_m
    half = 0.5 * float(rows[1] - rows[0]) if rows.size > 1 else np.inf
    return np.asarray(np.abs(results.edges.y_m - y_m) < half)


def _borders(middles: FloatArray) -> FloatArray:
    """Return the borders of cells around their middles, shape (n + 1,); cells of no width stay invisible."""
    if middles.size < 2:
        return np.array([middles[0] - 0.5, middles[0] + 0.5])
    inner = 0.5 * (middles[1:] + middles[:-1])
    # A pass with a pause has a wide gap: cells reach no further than half the usual step beyond the last photo.
    return np.concatenate([[2 * middles[0] - inner[0]], inner, [2 * middles[-1] - inner[-1]]])


def _leave_room_for_legend(axes: "Axes", values: FloatArray) -> None:
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (-1.0, 1.0)
    span = max(high - low, 1e-3)
    axes.set_ylim(low - 0.08 * span, high + 0.2 * span)
