"""Figures of a calibration: uncertainty over the image, radial profile, coverage, residuals, the board's shape."""

from typing import TYPE_CHECKING

import numpy as np

from calibration.camera.result import Result
from heliogauge.figures_canvas import (
    FAINT,
    INK,
    LINE_X,
    LINE_Y,
    SEQUENTIAL,
    WIDTH_IN,
    MapStyle,
    add_color_bar,
    add_title,
    axes_in_inches,
    chart_figure,
    new_figure,
)
from heliogauge.validate import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Arrows of residuals are drawn so that the RMS one has this share of the image's diagonal.
_ARROW_SHARE = 0.03


def all_figures(result: Result) -> "dict[str, Figure]":
    """Draw all figures.

    Parameters
    ----------
    result : Result
        A calibration.

    Returns
    -------
    dict of str to Figure
        By the name of the file.
    """
    figures = {
        "sigma_ray": sigma_figure(result),
        "sigma_projection": projection_figure(result),
        "radial_profile": profile_figure(result),
        "coverage": coverage_figure(result),
        "residuals": residual_figure(result),
        "board_shape": board_figure(result),
    }
    if result.comparison is not None:
        figures["comparison"] = comparison_figure(result)
    return figures


def _image_axes(result: Result, title: str, note: str) -> "tuple[Figure, Axes, tuple[float, float, float, float]]":
    """Return a figure with axes in pixels of the image, y down."""
    camera = result.camera
    width = WIDTH_IN - 1.6
    height = min(max(width * camera.height_px / camera.width_px, 1.2), 4.2)
    figure = new_figure(height + 1.15)
    box = (0.72, 0.5, width, height)
    axes = axes_in_inches(figure, *box)
    axes.set_xlim(-0.5, camera.width_px - 0.5)
    axes.set_ylim(camera.height_px - 0.5, -0.5)
    axes.set_xlabel("x [px]", fontsize=8.5, color=INK)
    axes.set_ylabel("y [px]", fontsize=8.5, color=INK)
    add_title(figure, title, note)
    return figure, axes, box


def _map(result: Result, values: FloatArray, title: str, note: str, unit: str) -> "Figure":
    figure, axes, box = _image_axes(result, title, note)
    camera = result.camera
    extent = (-0.5, camera.width_px - 0.5, camera.height_px - 0.5, -0.5)
    image = axes.imshow(values, cmap=SEQUENTIAL, extent=extent, aspect="auto", vmin=0.0, interpolation="bilinear")
    add_color_bar(figure, image, box, MapStyle(title, unit), values)
    return figure


def sigma_figure(result: Result) -> "Figure":
    """Draw the uncertainty of lines of sight over the image, without a common rotation."""
    sigma = result.sigma
    note = f"1 sigma, best common rotation taken out; RMS {1e3 * sigma.rms_free_rad:.2g} mrad"
    return _map(result, 1e3 * sigma.sigma_free_rad, "Uncertainty of lines of sight", note, "mrad")


def projection_figure(result: Result) -> "Figure":
    """Draw the uncertainty of projections over the image."""
    sigma = result.sigma
    unit = "m" if result.shape.board.is_metric else "pitches"
    note = f"1 sigma, pose held, points at {sigma.distance_m:.3g} {unit}; at most {sigma.worst_projection_px:.2g} px"
    return _map(result, sigma.sigma_projection_px, "Uncertainty of projection", note, "px")


def comparison_figure(result: Result) -> "Figure":
    """Draw the angle between the lines of sight of both calibrations."""
    if result.comparison is None:
        return new_figure(1.0)
    one = result.comparison
    note = f"best rotation taken out; RMS {1e3 * one.rms_rad:.2g} mrad, expected {1e3 * one.expected_rad:.2g} mrad"
    return _map(result, 1e3 * one.angle_rad, "Difference from the other calibration", note, "mrad")


def profile_figure(result: Result) -> "Figure":
    """Draw the radial distortion with its band."""
    profile = result.profile
    figure, axes = chart_figure(
        "Radial distortion",
        "band: 2 sigma; dashed: farthest measured point",
        "distance from the principal point [px]",
        "shift outwards [px]",
    )
    low, high = profile.shift_px - 2 * profile.sigma_px, profile.shift_px + 2 * profile.sigma_px
    axes.fill_between(profile.radius_px, low, high, color=LINE_X, alpha=0.25, linewidth=0)
    axes.plot(profile.radius_px, profile.shift_px, color=LINE_X, linewidth=1.1)
    axes.axvline(profile.seen_px, color=FAINT, linewidth=0.8, linestyle="--")
    return figure


def coverage_figure(result: Result) -> "Figure":
    """Draw all measured points in the image."""
    covered = result.coverage
    note = f"{covered.share:.0%} of the image's cells have points, out to {covered.radius_share:.0%} of its corners"
    figure, axes, _ = _image_axes(result, "Where the board was measured", note)
    for photo in result.photos:
        used = photo.used
        axes.plot(*photo.pixels_px[used].T, linestyle="none", marker=".", markersize=1.6, color=LINE_X, alpha=0.6)
        axes.plot(*photo.pixels_px[~used].T, linestyle="none", marker="x", markersize=4, color=LINE_Y)
    return figure


def residual_figure(result: Result) -> "Figure":
    """Draw the residuals of all photos, enlarged."""
    rms = result.quality.rms_px
    camera = result.camera
    factor = _ARROW_SHARE * float(np.hypot(camera.width_px, camera.height_px)) / max(rms, 1e-12)
    note = f"predicted minus measured, {factor:.0f} times enlarged; RMS {rms:.4f} px"
    figure, axes, _ = _image_axes(result, "Residuals", note)
    pixels = np.concatenate([photo.pixels_px[photo.used] for photo in result.photos])
    residuals = np.concatenate([photo.residuals_px[photo.used] for photo in result.photos])
    axes.quiver(
        *pixels.T, *residuals.T, angles="xy", scale_units="xy", scale=1 / factor, width=0.0012, color=LINE_X, alpha=0.7
    )
    return figure


def board_figure(result: Result) -> "Figure":
    """Draw how far the board's points are from where they were drawn."""
    shape = result.shape
    unit, factor = ("mm", 1e3) if shape.board.is_metric else ("pitches", 1.0)
    places, departure = factor * shape.points_m, factor * shape.departure_m
    width = WIDTH_IN - 1.6
    span = np.maximum(np.ptp(places[:, :2], axis=0), 1e-12)
    height = min(max(width * span[1] / span[0], 1.2), 4.5)
    figure = new_figure(height + 1.15)
    box = (0.72, 0.5, width, height)
    axes = axes_in_inches(figure, *box)
    rms = np.sqrt((departure**2).mean(axis=0))
    dots = axes.scatter(places[:, 0], places[:, 1], c=departure[:, 2], s=9, cmap="RdBu_r", linewidths=0)
    size = float(np.sqrt((departure[:, :2] ** 2).sum(axis=1).mean()))
    enlarge = 0.04 * float(np.hypot(*span)) / max(size, 1e-12)
    axes.quiver(
        *places[:, :2].T, *departure[:, :2].T, angles="xy", scale_units="xy", scale=1 / enlarge, width=0.002, color=INK
    )
    axes.set_xlabel(f"x [{unit}]", fontsize=8.5, color=INK)
    axes.set_ylabel(f"y [{unit}]", fontsize=8.5, color=INK)
    note = f"rms x {rms[0]:.2g}, y {rms[1]:.2g}, z {rms[2]:.2g} {unit}; arrows {enlarge:.0f} times, colour z"
    add_title(figure, "The board's departure from its drawing", note)
    bar = figure.colorbar(dots, cax=axes_in_inches(figure, box[0] + box[2] + 0.12, box[1], 0.13, box[3]))
    bar.ax.tick_params(labelsize=8, colors=INK)
    bar.set_label(f"z [{unit}]", fontsize=8, color=INK)
    return figure
