"""Still figures of a calibration: uncertainty over the image, residuals, correlations, the board's shape."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from calibration.camera.files.result import Result
from calibration.camera.judgement.comparison import Comparison
from heliogauge.camera.model import PARAMETER_NAMES, Camera
from heliogauge.reporting.canvas import (
    INK,
    LINE_X,
    LINE_Y,
    SEQUENTIAL,
    WIDTH_IN,
    MapStyle,
    add_color_bar,
    add_title,
    axes_in_inches,
    new_figure,
)
from heliogauge.validate import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Arrows of residuals are drawn so that the RMS one has this share of the image's diagonal.
_ARROW_SHARE = 0.02
_MOST_ARROWS = 5000


class _ImageFigure(NamedTuple):
    """A figure with axes in pixels of the image; the box of the axes in inches."""

    figure: "Figure"
    axes: "Axes"
    box: tuple[float, float, float, float]


def _image_axes(camera: Camera, title: str, note: str) -> _ImageFigure:
    """Return a figure with axes in pixels of the image, y down."""
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
    return _ImageFigure(figure, axes, box)


def _map(camera: Camera, values: FloatArray, title: str, note: str, unit: str) -> "Figure":
    figure, axes, box = _image_axes(camera, title, note)
    extent = (-0.5, camera.width_px - 0.5, camera.height_px - 0.5, -0.5)
    image = axes.imshow(values, cmap=SEQUENTIAL, extent=extent, aspect="auto", vmin=0.0, interpolation="bilinear")
    add_color_bar(figure, image, box, MapStyle(title, unit), values)
    return figure


def sigma_figure(result: Result) -> "Figure":
    """Draw the uncertainty of lines of sight over the image, without a common rotation."""
    sigma = result.sigma
    note = f"1 sigma, best common rotation taken out; RMS {1e3 * sigma.rms_free_rad:.2g} mrad"
    return _map(result.camera, 1e3 * sigma.sigma_free_rad, "Uncertainty of lines of sight", note, "mrad")


def comparison_figure(one: Comparison, camera: Camera) -> "Figure":
    """Draw the angle between the lines of sight of both calibrations, the best rotation taken out."""
    note = f"best rotation taken out; RMS {1e3 * one.rms_rad:.2g} mrad, expected {1e3 * one.expected_rad:.2g} mrad"
    return _map(camera, 1e3 * one.angle_rad, "Difference from the other calibration", note, "mrad")


def residual_figure(result: Result) -> "Figure":
    """Draw the residuals of all photos where they are in the image, with refused points as crosses."""
    camera = result.camera
    diagonal = float(np.hypot(camera.width_px, camera.height_px))
    factor = float(f"{_ARROW_SHARE * diagonal / max(result.quality.rms_px, 1e-12):.1g}")
    note = f"predicted minus measured, {factor:.0f} times enlarged; RMS {result.quality.rms_px:.4f} px"
    figure, axes, _ = _image_axes(camera, "Residuals of all photos, and where the board was", note)
    pixels = np.concatenate([one.pixels_px[one.used] for one in result.photos])
    residuals = np.concatenate([one.residuals_px[one.used] for one in result.photos])
    # Thousands of arrows are one blue area.
    few = slice(None, None, max(1, -(-len(pixels) // _MOST_ARROWS)))
    arrows = (*pixels[few].T, *residuals[few].T)
    axes.quiver(*arrows, angles="xy", scale_units="xy", scale=1 / factor, width=0.0016, color=LINE_X, alpha=0.8)
    for one in result.photos:
        axes.plot(*one.pixels_px[~one.used].T, linestyle="none", marker="x", markersize=4, color=LINE_Y)
    return figure


def correlation_figure(result: Result) -> "Figure":
    """Draw the correlations of the estimated intrinsics."""
    sigma = result.camera.sigma_parameters
    free = np.nonzero(sigma > 0)[0]
    names = [PARAMETER_NAMES[i].removesuffix("_px").replace("_", " ") for i in free]
    matrix = result.camera.covariance[np.ix_(free, free)] / np.outer(sigma[free], sigma[free])
    size = 0.36 * len(free)
    figure = new_figure(size + 1.5)
    axes = axes_in_inches(figure, 0.95, 0.75, size, size)
    axes.imshow(matrix, cmap="RdBu_r", vmin=-1, vmax=1)
    for row, column in np.ndindex(matrix.shape):
        if row != column:
            color = "white" if abs(matrix[row, column]) > 0.6 else INK
            text = f"{matrix[row, column]:.2f}".replace("0.", ".")
            axes.text(column, row, text, ha="center", va="center", fontsize=7, color=color)
    axes.set_xticks(range(len(free)), names, rotation=40, ha="right", fontsize=8, color=INK)
    axes.set_yticks(range(len(free)), names, fontsize=8, color=INK)
    add_title(figure, "Correlation of the intrinsics", "beyond 0.95 two effects are hardly separated")
    return figure


def board_figure(result: Result) -> "Figure":
    """Draw how far the board's points are from where they were drawn; without a drawing, where they are."""
    shape = result.shape
    unit, factor = ("mm", 1e3) if shape.board.is_metric else ("pitches", 1.0)
    places, departure = factor * shape.points_m, factor * shape.departure_m
    if not shape.has_drawing:
        departure = places * [0.0, 0.0, 1.0]
    width = WIDTH_IN - 1.75
    span = np.maximum(np.ptp(places[:, :2], axis=0), 1e-12)
    height = min(max(width * span[1] / span[0], 1.2), 4.5)
    figure = new_figure(height + 1.15)
    box = (0.72, 0.5, width, height)
    axes = axes_in_inches(figure, *box)
    rms = np.sqrt((departure**2).mean(axis=0))
    dots = axes.scatter(places[:, 0], places[:, 1], c=departure[:, 2], s=9, cmap="RdBu_r", linewidths=0)
    size = float(np.sqrt((departure[:, :2] ** 2).sum(axis=1).mean()))
    enlarge = 0.04 * float(np.hypot(*span)) / max(size, 1e-12)
    if size > 0:
        arrows = (*places[:, :2].T, *departure[:, :2].T)
        axes.quiver(*arrows, angles="xy", scale_units="xy", scale=1 / enlarge, width=0.002, color=INK)
    axes.set_xlabel(f"x [{unit}]", fontsize=8.5, color=INK)
    axes.set_ylabel(f"y [{unit}]", fontsize=8.5, color=INK)
    if shape.has_drawing:
        note = f"rms x {rms[0]:.2g}, y {rms[1]:.2g}, z {rms[2]:.2g} {unit}; arrows {enlarge:.0f} times, colour z"
        add_title(figure, "The board's departure from its drawing", note)
    else:
        add_title(
            figure, "Places of the targets", f"colour: z, from {places[:, 2].min():.3g} to {places[:, 2].max():.3g}"
        )
    for set_limits, middle, half in (
        (axes.set_xlim, places[:, 0].mean(), 0.56 * span[0]),
        (axes.set_ylim, places[:, 1].mean(), 0.56 * span[1]),
    ):
        set_limits(middle - half, middle + half)
    bar = figure.colorbar(dots, cax=axes_in_inches(figure, box[0] + box[2] + 0.12, box[1], 0.13, box[3]))
    bar.ax.tick_params(labelsize=7, colors=INK)
    bar.set_label(f"z [{unit}]", fontsize=8, color=INK, labelpad=1)
    return figure


def board_sigma_figure(result: Result) -> "Figure":
    """Draw how well each point of the board is known: position, rotation and scale of the whole taken out."""
    shape = result.shape
    unit = "mm" if shape.board.is_metric else "1/1000 pitch"
    length = "mm" if shape.board.is_metric else "pitches"
    places = (1e3 if shape.board.is_metric else 1.0) * shape.points_m
    sigma = 1e3 * np.sqrt((shape.sigma_m**2).sum(axis=1))
    note = f"1 sigma, x, y and z in squares [{unit}]; RMS {float(np.sqrt((sigma**2).mean())):.2g}"
    width = WIDTH_IN - 1.6
    span = np.maximum(np.ptp(places[:, :2], axis=0), 1e-12)
    height = min(max(width * span[1] / span[0], 1.2), 4.5)
    figure = new_figure(height + 1.15)
    axes = axes_in_inches(figure, 0.72, 0.5, width, height)
    dots = axes.scatter(places[:, 0], places[:, 1], c=sigma, s=14, cmap=SEQUENTIAL, linewidths=0)
    axes.set_xlabel(f"x [{length}]", fontsize=8.5, color=INK)
    axes.set_ylabel(f"y [{length}]", fontsize=8.5, color=INK)
    add_title(figure, "Uncertainty of the board's shape", note)
    bar = figure.colorbar(dots, cax=axes_in_inches(figure, 0.72 + width + 0.12, 0.5, 0.13, height))
    bar.ax.tick_params(labelsize=7, colors=INK)
    return figure
