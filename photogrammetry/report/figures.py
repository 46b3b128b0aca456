"""Figures of a network's report, from the files of its results."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from heliogauge.camera.model import PARAMETER_NAMES
from heliogauge.reporting.canvas import (
    DIVERGING,
    FAINT,
    INK,
    LINE_X,
    LINE_Y,
    SEQUENTIAL,
    WIDTH_IN,
    add_legend,
    add_title,
    axes_in_inches,
    chart_figure,
    new_figure,
    nice_ceiling,
    set_equal_limits,
)
from heliogauge.validate import FloatArray
from photogrammetry.report.network import NetworkResults
from photogrammetry.report.scene import grouped, magnification, pyramid_lines

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: The RMS residual is drawn as this share of the image's diagonal.
_ARROW_SHARE = 0.03
#: Photos on one sheet of small images, and sheets at most: 120 photos, the worst first.
_COLUMNS, _ROWS, _SHEETS = 6, 5, 4
#: Cells of the coverage along the longer side of the image.
_CELLS = 12


def network_figure(results: NetworkResults, first: int, second: int) -> "Figure":
    """Draw points with error ellipses, and cameras, seen along one axis.

    first, second: Axes to the right and up: 0 x, 1 y, 2 z.
    """
    from matplotlib.collections import LineCollection

    points, covariances = results.points.xyz_m[results.known], results.covariances_m2
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    factor = magnification(covariances, extent)
    pyramids = [
        pyramid_lines(results.cameras[p.camera], p.cam_from_world, 0.03 * extent) for p in results.poses.values()
    ]
    labels = f"{'xyz'[first]} [m]", f"{'xyz'[second]} [m]"
    note = f"{len(points)} points with error ellipses (1 sigma, {grouped(factor)} times), {len(pyramids)} cameras"
    figure, axes = chart_figure(f"Network in {'xyz'[first]} and {'xyz'[second]}", note, *labels, height_in=4.2)
    strokes = [lines[:9][:, (first, second)] for lines, _ in pyramids]
    strokes += [lines[9:][:, (first, second)] for lines, _ in pyramids]
    axes.add_collection(LineCollection(strokes, colors=FAINT, linewidths=0.5))
    ellipses = _ellipses(points[:, (first, second)], covariances[:, (first, second)][:, :, (first, second)], factor)
    axes.add_collection(LineCollection(list(ellipses), colors=LINE_Y, linewidths=0.6))
    axes.plot(points[:, first], points[:, second], ".", color=LINE_X, markersize=3, linestyle="none")
    everything = np.concatenate([points[:, (first, second)], *strokes])
    set_equal_limits(axes, everything[:, 0], everything[:, 1])
    return figure


def _ellipses(centers: FloatArray, covariances: FloatArray, factor: float) -> FloatArray:
    """Return ellipses as closed lines, shape (n, 25, 2)."""
    values, vectors = np.linalg.eigh(covariances)
    axes = factor * np.sqrt(np.maximum(values, 0.0))[:, None, :] * vectors
    angle = np.linspace(0, 2 * np.pi, 25)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    return np.asarray(centers[:, None] + np.swapaxes(axes @ circle, 1, 2))


def sigma_figure(results: NetworkResults) -> "Figure":
    """Draw the standard deviation of each point where it is, seen along the network's flattest direction."""
    points = results.points.xyz_m[results.known]
    sigma_mm = 1e3 * np.sqrt((results.points.sigma_m[results.known] ** 2).sum(axis=1))
    flat = int(np.argmin(np.ptp(points, axis=0))) if len(points) else 2
    first, second = (i for i in range(3) if i != flat)
    note = (
        f"square root of the covariance's trace, {sigma_mm.min(initial=np.inf):.3g} to {sigma_mm.max(initial=0):.3g} mm"
    )
    figure, axes = chart_figure(
        "Standard deviation of the points", note, f"{'xyz'[first]} [m]", f"{'xyz'[second]} [m]", height_in=4.0
    )
    order = np.argsort(sigma_mm, kind="stable")
    dots = axes.scatter(points[order, first], points[order, second], c=sigma_mm[order], cmap=SEQUENTIAL, s=14)
    bar = figure.colorbar(dots, ax=axes, shrink=0.8)
    bar.set_label("sigma [mm]", fontsize=8, color=INK)
    bar.ax.tick_params(labelsize=8, colors=INK)
    set_equal_limits(axes, points[:, first], points[:, second])
    return figure


def ray_figure(results: NetworkResults) -> "Figure":
    """Draw the standard deviation of each point against the number of photos that see it."""
    sigma_mm = 1e3 * np.sqrt((results.points.sigma_m[results.known] ** 2).mean(axis=1))
    rays = results.points.n_rays[results.known]
    figure, axes = chart_figure(
        "Standard deviation and number of rays",
        "RMS of the three coordinates; one dot for each point",
        "photos that see the point",
        "sigma [mm]",
        height_in=4.0,
    )
    axes.plot(rays, sigma_mm, ".", color=LINE_X, markersize=5, alpha=0.6, linestyle="none")
    if len(rays):
        span = np.linspace(rays.min(), rays.max(), 50)
        middle = float(np.median(sigma_mm * np.sqrt(rays)))
        axes.plot(span, middle / np.sqrt(span), color=FAINT, linewidth=0.9, label="1 / square root of rays")
        add_legend(axes, loc="upper right")
    axes.set_ylim(bottom=0)
    return figure


def length_figure(results: NetworkResults) -> "Figure | None":
    """Draw the errors of known lengths that were not used, with the permissible error; None where there are none."""
    if not results.tables["lengths"]["name"]:
        return None
    known, error, sigma, limit = (
        results.column("lengths", name) for name in ("known_m", "error_m", "sigma_error_m", "permissible_m")
    )
    roles = np.array(results.tables["lengths"]["role"])
    note = "measured minus known; bars: 1 sigma of network and known length together"
    figure, axes = chart_figure("Length measurement error", note, "length [m]", "error [mm]")
    for role, color, marker in (("kept apart", LINE_X, "o"), ("left out", LINE_Y, "s")):
        own = roles == role
        if own.any():
            axes.errorbar(
                known[own],
                1e3 * error[own],
                1e3 * sigma[own],
                fmt=marker,
                color=color,
                markersize=4,
                linewidth=0.9,
                capsize=2,
                label=f"{role} ({int(own.sum())})",
            )
    if np.isfinite(limit).any():
        order = np.argsort(known)
        for sign in (-1, 1):
            axes.plot(
                known[order],
                1e3 * sign * limit[order],
                color=INK,
                linewidth=0.9,
                linestyle="--",
                label="permissible" if sign == 1 else None,
            )
    axes.axhline(0, color=FAINT, linewidth=0.6)
    add_legend(axes, loc="best")
    return figure


def residual_figure(results: NetworkResults) -> "Figure":
    """Draw the residuals of all photos where they are in the image, in one."""
    camera = results.camera
    x, y, dx, dy = _residuals(results)
    rms = float(np.sqrt((dx**2 + dy**2).mean()))
    scale = _ARROW_SHARE * float(np.hypot(camera.width_px, camera.height_px)) / max(rms, 1e-12)
    note = f"predicted minus measured, {scale:.0f} times; RMS {rms:.4f} px, {x.size} image points"
    figure, axes = chart_figure("Residuals of all photos", note, "x [px]", "y [px]", height_in=4.0)
    axes.quiver(x, y, scale * dx, scale * dy, angles="xy", scale_units="xy", scale=1, color=LINE_X, width=0.0015)
    _image_axes(axes, results)
    return figure


def residual_sheets(results: NetworkResults) -> list["Figure"]:
    """Draw the residuals of every photo in small images of one scale, the worst photos first."""
    camera = results.camera
    x, y, dx, dy = _residuals(results)
    scale = 1.3 * _ARROW_SHARE * float(np.hypot(camera.width_px, camera.height_px))
    scale /= max(float(np.sqrt((dx**2 + dy**2).mean())), 1e-12)
    names = sorted(results.poses, key=lambda name: -(results.poses[name].residual_rms_px or 0.0))
    on_sheet, rows = _COLUMNS * _ROWS, results.photo_rows
    sheets = []
    for first in range(0, min(len(names), on_sheet * _SHEETS), on_sheet):
        chosen = names[first : first + on_sheet]
        width = (2 * WIDTH_IN - 0.2) / _COLUMNS
        height = (width - 0.1) * camera.height_px / camera.width_px
        lines = -(-len(chosen) // _COLUMNS)
        figure = new_figure(0.75 + lines * (height + 0.28), 2 * WIDTH_IN)
        for place, name in enumerate(chosen):
            column, line = place % _COLUMNS, place // _COLUMNS
            axes = axes_in_inches(
                figure, 0.1 + column * width, 0.12 + (lines - 1 - line) * (height + 0.28), width - 0.1, height
            )
            own = rows[name]
            axes.quiver(
                x[own],
                y[own],
                scale * dx[own],
                scale * dy[own],
                angles="xy",
                scale_units="xy",
                scale=1,
                color=LINE_X,
                width=0.006,
            )
            _image_axes(axes, results)
            axes.set(xticks=[], yticks=[])
            label = name if len(name) <= 22 else f"...{name[-19:]}"
            axes.set_title(
                f"{label}  {results.poses[name].residual_rms_px or 0:.3f} px", fontsize=6.5, color=INK, pad=2
            )
        key = nice_ceiling(0.12 * camera.width_px / scale)
        left = (
            f"; {len(names) - on_sheet * _SHEETS} better photos are not drawn"
            if len(names) > on_sheet * _SHEETS
            else ""
        )
        add_title(
            figure,
            f"Residuals, photos {first + 1} to {first + len(chosen)} of {len(names)}, worst first",
            f"predicted minus measured, all {scale:.0f} times: {key:g} px is {key * scale / camera.width_px:.0%} of "
            f"the image's width; RMS of each photo above it{left}",
        )
        sheets.append(figure)
    return sheets


def coverage_figure(results: NetworkResults) -> "Figure":
    """Draw how many image points fell on each part of the image; parts without any are where the lens is a guess."""
    camera = results.camera
    x, y, _, _ = _residuals(results)
    longer = max(camera.width_px, camera.height_px)
    cells = [max(1, round(_CELLS * size / longer)) for size in (camera.width_px, camera.height_px)]
    edges = [
        np.linspace(-0.5, size - 0.5, n + 1) for size, n in zip((camera.width_px, camera.height_px), cells, strict=True)
    ]
    counts, _, _ = np.histogram2d(x, y, edges)
    empty = float((counts == 0).mean())
    half = 0.5 * np.array([camera.width_px, camera.height_px])
    reach = np.hypot(x - half[0] + 0.5, y - half[1] + 0.5).max(initial=0.0) / float(np.hypot(*half))
    note = f"{empty:.0%} of the cells are empty (grey); image points reach {reach:.0%} of the way to the corners"
    figure, axes = chart_figure("Coverage of the image, all photos", note, "x [px]", "y [px]", height_in=4.0)
    axes.set_facecolor("#c9cdd2")
    image = axes.pcolormesh(*edges, np.ma.masked_equal(counts.T, 0), cmap=SEQUENTIAL, vmin=0)
    bar = figure.colorbar(image, ax=axes, shrink=0.75)
    bar.set_label("image points in a cell", fontsize=8, color=INK)
    bar.ax.tick_params(labelsize=8, colors=INK)
    _image_axes(axes, results)
    return figure


def radius_figure(results: NetworkResults) -> "Figure":
    """Draw residuals along and across the radius from the principal point; a lens that does not fit shows here."""
    camera = results.camera
    x, y, dx, dy = _residuals(results)
    arm = np.stack([x - camera.center_x_px, y - camera.center_y_px])
    radius = np.maximum(np.hypot(*arm), 1e-9)
    radial, across = (arm[0] * dx + arm[1] * dy) / radius, (arm[0] * dy - arm[1] * dx) / radius
    note = "lines: mean of a tenth of the image points each, with its sigma"
    figure, axes = chart_figure(
        "Residuals against the radius", note, "distance from the principal point [px]", "residual [px]", height_in=4.0
    )
    parts = np.array_split(np.argsort(radius, kind="stable"), 10)
    parts = [part for part in parts if part.size > 1]
    for values, color, name in ((radial, LINE_X, "along the radius"), (across, LINE_Y, "across it")):
        axes.plot(radius, values, ".", color=color, markersize=1.5, alpha=0.25, linestyle="none")
        means = [values[part].mean() for part in parts]
        sigmas = [values[part].std(ddof=1) / np.sqrt(part.size) for part in parts]
        middles = [radius[part].mean() for part in parts]
        axes.errorbar(middles, means, sigmas, color=color, linewidth=1.2, capsize=2, label=name)
    limit = nice_ceiling(4 * float(np.sqrt((dx**2 + dy**2).mean() / 2)))
    axes.set_ylim(-limit, limit)
    beyond = int((np.abs(np.concatenate([radial, across])) > limit).sum())
    if beyond:
        axes.text(0.99, 0.01, f"{beyond} beyond", transform=axes.transAxes, ha="right", fontsize=7, color=FAINT)
    add_legend(axes, loc="upper left")
    return figure


def histogram_figure(results: NetworkResults) -> "Figure":
    """Draw the residuals over their own sigma against the normal distribution."""
    values = np.concatenate(
        [
            results.column("residuals", f"residual_{axis}_px")
            / (
                results.column("residuals", f"sigma_{axis}_px")
                * np.sqrt(np.maximum(results.column("residuals", f"redundancy_{axis}"), np.finfo(float).tiny))
            )
            for axis in "xy"
        ]
    )
    values = values[np.isfinite(values) & (np.abs(values) < 1e6)]
    beyond = float((np.abs(values) > 3).mean()) if values.size else 0.0
    note = f"RMS {np.sqrt((values**2).mean()):.3f} (1 expected); {beyond:.2%} beyond 3 (0.27 % expected)"
    figure, axes = chart_figure(
        "Residuals over their own sigma",
        note,
        "residual / (sigma x square root of redundancy)",
        "density",
        height_in=4.0,
    )
    bins = np.linspace(-5, 5, 51)
    counts, _ = np.histogram(values, bins)
    axes.stairs(counts / max(values.size, 1) / np.diff(bins), bins, fill=True, color=LINE_X, alpha=0.75)
    fine = np.linspace(-5, 5, 201)
    axes.plot(fine, np.exp(-0.5 * fine**2) / np.sqrt(2 * np.pi), color=INK, linewidth=1, label="normal, sigma 1")
    add_legend(axes, loc="upper right")
    axes.set_xlim(-5, 5)
    return figure


def correlation_figure(results: NetworkResults) -> "Figure | None":
    """Draw the correlations of the camera's parameters; None where fewer than two were estimated."""
    covariance = results.camera.covariance
    free = np.nonzero(np.diag(covariance) > 0)[0]
    if free.size < 2:
        return None
    names = [PARAMETER_NAMES[i] for i in free]
    sigma = np.sqrt(np.diag(covariance)[free])
    matrix = covariance[np.ix_(free, free)] / np.outer(sigma, sigma)
    figure = new_figure(4.4)
    axes = axes_in_inches(figure, 1.05, 0.95, 2.75, 2.75)
    image = axes.imshow(matrix, cmap=DIVERGING, vmin=-1, vmax=1)
    axes.set_xticks(range(free.size), names, rotation=60, ha="right", fontsize=7)
    axes.set_yticks(range(free.size), names, fontsize=7)
    for i in range(free.size):
        for j in range(free.size):
            dark = abs(matrix[i, j]) > 0.6
            axes.text(
                j, i, f"{matrix[i, j]:.2f}", ha="center", va="center", fontsize=5.5, color="white" if dark else INK
            )
    bar_axes = axes_in_inches(figure, 3.95, 0.95, 0.13, 2.75)
    figure.colorbar(image, cax=bar_axes)
    add_title(figure, "Correlations of the camera's parameters", "near 1 or -1: the photos do not separate the two")
    return figure


class _Residuals(NamedTuple):
    """Image points and their residuals [px]."""

    x: FloatArray
    y: FloatArray
    dx: FloatArray
    dy: FloatArray


def _residuals(results: NetworkResults) -> _Residuals:
    """Read the residuals of all image points."""
    return _Residuals(*(results.column("residuals", n) for n in ("x_px", "y_px", "residual_x_px", "residual_y_px")))


def _image_axes(axes: "Axes", results: NetworkResults) -> None:
    """Let axes be an image: y down, both scales the same."""
    camera = results.camera
    axes.set_xlim(-0.5, camera.width_px - 0.5)
    axes.set_ylim(camera.height_px - 0.5, -0.5)
    axes.set_aspect("equal")
