"""Figures of the measurement itself: where things stood, what the camera saw, how well the outline fits."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from heliogauge.reporting.canvas import (
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
    clipping_words,
    new_figure,
    robust_limit,
    set_equal_limits,
)
from heliogauge.validate import FloatArray


def camera_image(values: npt.NDArray[Any], style: MapStyle, *, origin_px: tuple[int, int] = (0, 0)) -> Figure:
    """Draw a quantity of each camera pixel as the camera saw it: row 0 at the top.

    values (n_rows, n_columns): Values; NaN (drawn grey) where there is none.
    style: Title, unit, colours.
    origin_px: Column and row of the first value in the whole image.
    """
    rows, columns = values.shape
    width = WIDTH_IN - 1.62
    height = min(width * rows / columns, 4.2)
    width = height * columns / rows
    figure = new_figure(height + 1.2)
    box = (0.65 + (WIDTH_IN - 1.62 - width) / 2, 0.55, width, height)
    axes = axes_in_inches(figure, *box)
    # Plain: what lies around the mirror in the image is not missing.
    axes.patch.set_facecolor("#e3e6e9")
    step = max(1, -(-max(rows, columns) // 500))
    shown = np.asarray(values[step // 2 :: step, step // 2 :: step], dtype=np.float64) * style.factor
    limit = robust_limit(shown) if style.limit is None else style.limit
    left, top = origin_px
    image = axes.imshow(
        np.ma.masked_invalid(shown),
        cmap=SEQUENTIAL,
        vmin=style.low,
        vmax=limit,
        extent=(left - 0.5, left + columns - 0.5, top + rows - 0.5, top - 0.5),
        interpolation="nearest",
    )
    axes.set_xlabel("column [px]", fontsize=8, color=INK, labelpad=2)
    axes.set_ylabel("row [px]", fontsize=8, color=INK, labelpad=2)
    add_title(figure, style.title, "   ".join(filter(None, (style.note, clipping_words(shown, limit, style)))))
    add_color_bar(figure, image, box, style, shown)
    return figure


def setup_sketch(geometry_m: Mapping[str, Any]) -> Figure:
    """Draw camera, screen and mirror from the side and from above, to scale.

    geometry_m: Points in the mirror's frame [m]: ``camera`` (3,), ``camera_axis`` (3,) viewing direction,
        ``screen`` (n, 3) and ``mirror`` (n, 3) outlines.
    Returns: Side view (z to the right, y up) and top view (z to the right, x up).
    """
    names = ("camera", "screen", "mirror")
    points = {name: np.atleast_2d(np.asarray(geometry_m[name], dtype=np.float64)) for name in names}
    every = np.concatenate(list(points.values()))
    figure = new_figure(4.0, 2 * WIDTH_IN)
    for number, (name, across) in enumerate((("from the side", 1), ("from above", 0))):
        axes = axes_in_inches(figure, 0.65 + number * (WIDTH_IN + 0.05), 0.85, WIDTH_IN - 0.95, 2.45)
        set_equal_limits(axes, every[:, 2], every[:, across])
        axes.grid(visible=True, color="#edf0f2", linewidth=0.6)
        _draw_view(axes, points, np.asarray(geometry_m["camera_axis"], dtype=np.float64), across)
        axes.set_xlabel(f"z [m]   {name}", fontsize=8.5, color=INK)
        axes.set_ylabel(f"{'xy'[across]} [m]", fontsize=8.5, color=INK)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=4, fontsize=8, frameon=False, labelcolor=INK)
    distance = float(np.linalg.norm(points["camera"][0] - points["mirror"].mean(axis=0)))
    reach = float(np.linalg.norm(points["screen"].mean(axis=0) - points["mirror"].mean(axis=0)))
    note = f"mirror frame, to scale; mirror to camera {distance:.3f} m, mirror to screen {reach:.3f} m (centres)"
    add_title(figure, "Where camera, screen and mirror stood", note)
    return figure


def _draw_view(axes: Axes, points: Mapping[str, FloatArray], camera_axis: FloatArray, across: int) -> None:
    mirror, screen, camera = points["mirror"], points["screen"], points["camera"][0]
    middle = mirror.mean(axis=0)
    for edge in (screen[np.argmin(screen[:, across])], screen[np.argmax(screen[:, across])]):
        axes.plot([edge[2], middle[2]], [edge[across], middle[across]], color=LINE_Y, linewidth=0.5, linestyle=":")
    for edge in (mirror[np.argmin(mirror[:, across])], mirror[np.argmax(mirror[:, across])]):
        axes.plot([camera[2], edge[2]], [camera[across], edge[across]], color=LINE_X, linewidth=0.5, linestyle=":")
    for name, outline, color in (("mirror", mirror, INK), ("screen", screen, LINE_Y)):
        closed = np.vstack([outline, outline[:1]])
        axes.plot(closed[:, 2], closed[:, across], color=color, linewidth=2.2, label=name, solid_capstyle="round")
    axes.plot(camera[2], camera[across], marker="o", color=LINE_X, markersize=6, linestyle="none", label="camera")
    # The viewing direction, as long as a sixth of the way to the mirror.
    reach = float(np.linalg.norm(camera - middle)) / 6
    tip = camera + camera_axis / np.linalg.norm(camera_axis) * reach
    axes.plot([camera[2], tip[2]], [camera[across], tip[across]], color=LINE_X, linewidth=2, label="viewing direction")


def outline_residuals(points_px: FloatArray, residuals_px: FloatArray) -> Figure:
    """Draw the mirror's edge points on the image with their residuals, enlarged.

    points_px (n, 2): Measured edge points (column, row) [px].
    residuals_px (n, 2): Measured minus adjusted [px].
    Returns: Arrows on the outline; row 0 at the top.
    """
    figure = new_figure(4.2)
    axes = axes_in_inches(figure, 0.65, 0.55, WIDTH_IN - 0.85, 3.0)
    size = np.hypot(*residuals_px.T)
    rms = float(np.sqrt(np.mean(size**2)))
    extent = float(np.ptp(points_px, axis=0).max())
    # A residual of three times the RMS is drawn as a tenth of the mirror.
    enlarged = 0.1 * extent / max(3 * rms, 1e-6)
    axes.plot(*points_px.T, linestyle="none", marker=".", markersize=2, color=FAINT)
    axes.quiver(
        points_px[:, 0],
        points_px[:, 1],
        residuals_px[:, 0] * enlarged,
        residuals_px[:, 1] * enlarged,
        color=LINE_Y,
        angles="xy",
        scale_units="xy",
        scale=1,
        width=0.003,
    )
    set_equal_limits(axes, points_px[:, 0], points_px[:, 1], spare=0.12)
    axes.invert_yaxis()
    axes.set_xlabel("column [px]", fontsize=8, color=INK, labelpad=2)
    axes.set_ylabel("row [px]", fontsize=8, color=INK, labelpad=2)
    note = f"RMS {rms:.3f} px, largest {size.max():.3f} px; arrows enlarged {enlarged:.0f} times"
    add_title(figure, "How well the outline fits", note)
    return figure
