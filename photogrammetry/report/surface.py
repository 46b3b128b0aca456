"""The surface in a network's report: deviations, slope maps, canting, displacements; empty where none was asked for."""

import html
from typing import TYPE_CHECKING

import numpy as np

from heliogauge.reporting.canvas import (
    DIVERGING,
    FAINT,
    INK,
    LINE_Y,
    chart_figure,
    nice_ceiling,
    robust_limit,
    set_equal_limits,
)
from heliogauge.reporting.html import Html, join, show, table
from heliogauge.reporting.notation import number_text
from heliogauge.results.folder import facet_names, read_slope_map, read_table_csv
from heliogauge.validate import FloatArray
from photogrammetry.report.network import NetworkResults

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: The longest arrow is drawn as this share of the picture.
_ARROW_SHARE = 0.12
_HEIGHT_IN = 4.2

Columns = dict[str, list[str]]


def surface(results: NetworkResults) -> Html:
    """Return the section of the surface with its heading; nothing without one."""
    pieces = [section(results) for section in (_deviations, _slopes, _canting, _comparison)]
    found = [one for one in pieces if one.text]
    return join(Html("<h2>Surface</h2>"), *found) if found else Html("")


def _columns(results: NetworkResults, name: str) -> Columns | None:
    path = results.folder / name
    return read_table_csv(path) if path.is_file() else None


def _numbers(columns: Columns, *names: str) -> FloatArray:
    """Return columns as numbers, shape (n, k)."""
    return np.array([[float(cell) if cell else np.nan for cell in columns[name]] for name in names]).T


def _text(value: float, sigma: float) -> str:
    return number_text(float(value), float(sigma), "")


def _deviations(results: NetworkResults) -> Html:
    columns = _columns(results, "surface.csv")
    if columns is None:
        return Html("")
    rows = [
        (name, f"{1e3 * values[0]:.4f}", f"{1e3 * values[1]:.4f}", reason)
        for name, values, reason in zip(
            columns["id"], _numbers(columns, "deviation_m", "sigma_deviation_m"), columns["reason"], strict=True
        )
        if reason
    ]
    head = ("not used", "deviation [mm]", "sigma [mm]", "why")
    left = table(head, rows, numbers=(1, 2)) if rows else Html("")
    return join(show(deviation_figure(columns)), left)


def deviation_figure(columns: Columns) -> "Figure":
    """Draw the deviation of each point from the surface, seen from the front."""
    xy, deviation = _numbers(columns, "x_m", "y_m"), 1e3 * _numbers(columns, "deviation_m")[:, 0]
    used = _numbers(columns, "used")[:, 0] > 0
    limit = robust_limit(deviation[used])
    sigma = 1e3 * float(np.median(_numbers(columns, "sigma_deviation_m")))
    note = (
        f"along the normal, positive towards the viewer; RMS {np.sqrt(np.mean(deviation[used] ** 2)):.4f} mm, "
        f"median sigma {sigma:.4f} mm"
    )
    figure, axes = chart_figure("Deviation of the points from the surface [mm]", note, "x [m]", "y [m]", _HEIGHT_IN)
    dots = axes.scatter(
        xy[used, 0],
        xy[used, 1],
        s=26,
        c=deviation[used],
        cmap=DIVERGING,
        vmin=-limit,
        vmax=limit,
        zorder=3,
        edgecolors=FAINT,
        linewidths=0.4,
    )
    axes.plot(*xy[~used].T, "x", color=LINE_Y, markersize=6, linestyle="none")
    set_equal_limits(axes, *xy.T)
    figure.colorbar(dots, ax=axes).ax.tick_params(labelsize=8, colors=INK)
    return figure


def _slopes(results: NetworkResults) -> Html:
    path = results.folder / "slope_map.nc"
    if not path.is_file():
        return Html("")
    from heliogauge.reporting import figures
    from heliogauge.view.maps import slope_map_view

    whole = read_slope_map(path)
    still = [figures.slope_error_map(whole, "x"), figures.slope_error_map(whole, "y"), figures.flag_map(whole)]
    names = facet_names(path)
    words = f"<p>Taken out: {html.escape(whole.removed)}.</p>"
    words += f"<p>Maps of {len(names)} facets in one.</p>" if names else ""
    return join(Html("<h3>Slope error</h3>" + words), slope_map_view(whole, results.summary.name, figures=still))


def _canting(results: NetworkResults) -> Html:
    columns = _columns(results, "canting.csv")
    points = _columns(results, "surface.csv")
    if columns is None or points is None:
        return Html("")
    values = _numbers(
        columns,
        "canting_x_rad",
        "canting_y_rad",
        "sigma_canting_x_rad",
        "sigma_canting_y_rad",
        "piston_m",
        "sigma_piston_m",
        "length_m",
        "sigma_length_m",
    )
    rows = [
        (
            name,
            count,
            _text(1e3 * one[0], 1e3 * one[2]),
            _text(1e3 * one[1], 1e3 * one[3]),
            _text(1e3 * one[4], 1e3 * one[5]),
            _text(one[6], one[7]) if np.isfinite(one[6]) else "",
        )
        for name, count, one in zip(columns["facet"], columns["n_points"], values, strict=True)
    ]
    head = ("facet", "points", "canting x [mrad]", "canting y [mrad]", "piston [mm]", "focal length or radius [m]")
    words = "<h3>Canting</h3><p>Of the normal: slope of the facet beyond the design's, in x and y.</p>"
    return join(Html(words), show(canting_figure(columns, points)), table(head, rows, numbers=range(1, 6)))


def canting_figure(columns: Columns, points: Columns) -> "Figure":
    """Draw the canting of each facet as an arrow where the facet is.

    columns, points: ``canting.csv`` and ``surface.csv``.
    Returns: The figure; an arrow to the right is a surface that rises to the right.
    """
    xy, owner = _numbers(points, "x_m", "y_m"), np.array(points["facet"])
    centers = np.array([xy[owner == name].mean(axis=0) for name in columns["facet"]])
    turns = 1e3 * _numbers(columns, "canting_x_rad", "canting_y_rad")
    longest = nice_ceiling(max(float(np.linalg.norm(turns, axis=1).max()), 1e-6))
    scale = _ARROW_SHARE * float(np.ptp(xy, axis=0).max()) / longest
    note = f"arrows point where a facet rises more than its design; {longest:g} mrad is {_ARROW_SHARE:.0%} of the width"
    figure, axes = chart_figure("Canting of the facets", note, "x [m]", "y [m]", _HEIGHT_IN)
    axes.plot(*xy.T, ".", color=FAINT, markersize=2, linestyle="none")
    axes.quiver(*centers.T, *(scale * turns).T, angles="xy", scale_units="xy", scale=1, color=LINE_Y, width=0.004)
    for name, center in zip(columns["facet"], centers, strict=True):
        axes.annotate(
            name, center, fontsize=7, color=INK, ha="center", va="top", xytext=(0, -4), textcoords="offset points"
        )
    set_equal_limits(axes, *xy.T)
    return figure


def _comparison(results: NetworkResults) -> Html:
    columns = _columns(results, "comparison.csv")
    if columns is None:
        return Html("")
    values = 1e3 * _numbers(columns, "dx_m", "dy_m", "dz_m", "sigma_dx_m", "sigma_dy_m", "sigma_dz_m")
    moved = _numbers(columns, "moved")[:, 0] > 0
    order = [int(i) for i in np.argsort(-np.linalg.norm(values[:, :3], axis=1)) if moved[i]]
    rows = [
        (
            columns["id"][i],
            *(_text(values[i, k], values[i, 3 + k]) for k in range(3)),
            f"{float(columns['probability'][i]):.2g}",
        )
        for i in order
    ]
    head = ("moved", "dx [mm]", "dy [mm]", "dz [mm]", "by chance")
    found = table(head, rows, numbers=range(1, 5)) if rows else Html("<p>No target moved significantly.</p>")
    drawn = show(displacement_figure(results, columns, 0, 1), displacement_figure(results, columns, 0, 2))
    return join(Html("<h3>Since the other date</h3>"), drawn, found)


def displacement_figure(results: NetworkResults, columns: Columns, first: int, second: int) -> "Figure":
    """Draw how targets moved, seen along one axis.

    results: The results; its points are where the arrows end.
    columns: ``comparison.csv``.
    first, second: Axes to the right and up: 0 x, 1 y, 2 z.
    """
    place = {name: i for i, name in enumerate(results.points.ids)}
    points = results.points.xyz_m[[place[name] for name in columns["id"]]][:, [first, second]]
    steps = 1e3 * _numbers(columns, *(f"d{'xyz'[axis]}_m" for axis in (first, second)))
    moved = _numbers(columns, "moved")[:, 0] > 0
    longest = nice_ceiling(max(float(np.linalg.norm(steps, axis=1).max()), 1e-9))
    scale = _ARROW_SHARE * float(np.ptp(points, axis=0).max()) / longest
    note = f"now minus before, {1e3 * scale:.0f} times enlarged; {int(moved.sum())} of {moved.size} moved significantly"
    title = f"Displacements in {'xyz'[first]} and {'xyz'[second]}"
    labels = f"{'xyz'[first]} [m]", f"{'xyz'[second]} [m]"
    figure, axes = chart_figure(title, note, *labels, _HEIGHT_IN)
    for which, color in ((~moved, FAINT), (moved, LINE_Y)):
        axes.quiver(
            *points[which].T,
            *(scale * steps[which]).T,
            angles="xy",
            scale_units="xy",
            scale=1,
            color=color,
            width=0.003,
        )
        axes.plot(*points[which].T, ".", color=color, markersize=4, linestyle="none")
    set_equal_limits(axes, *points.T)
    return figure
