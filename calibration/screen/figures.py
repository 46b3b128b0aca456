"""Figure of the response of camera and display."""

from typing import TYPE_CHECKING

import numpy as np

from calibration.screen.files import Result, nonlinearity
from heliogauge.reporting.canvas import (
    FAINT,
    INK,
    LINE_X,
    LINE_Y,
    WIDTH_IN,
    add_legend,
    add_title,
    axes_in_inches,
    new_figure,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LEVEL = "display level [share of the range]"


def response_figure(result: Result) -> "Figure":
    """Draw what the camera reads for each level, and how far that is from a straight line.

    result: What `calibration.screen.pipeline.run` returned.
    Returns: Two charts: readings [DN], departure from the line between the ends [% of the range].
    """
    figure = new_figure(5.4)
    width = WIDTH_IN - 0.95
    upper = axes_in_inches(figure, 0.72, 2.5, width, 2.25)
    lower = axes_in_inches(figure, 0.72, 0.5, width, 1.45)
    for axes in (upper, lower):
        axes.grid(visible=True, color="#e4e7ea", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.set_xlim(-0.03, 1.03)
        axes.set_xlabel(_LEVEL, fontsize=8.5, color=INK)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    _draw_readings(upper, result)
    _draw_departure(lower, result)
    response, readings = result.response, result.readings
    sigma = 0.0 if response.sigma_camera_dn is None else float(response.sigma_camera_dn.max())
    note = (
        f"{response.camera_dn.size} of {readings.level.size} levels used, means of {readings.pixels} pixels, "
        f"sigma at most {sigma:.2g} DN"
    )
    add_title(figure, "Response of camera and display", note)
    return figure


def _draw_readings(axes: "Axes", result: Result) -> None:
    response, readings = result.response, result.readings
    joined = ~readings.is_saturated & ~np.isin(readings.level, response.display_level)
    ends = [0, -1]
    axes.plot(
        response.display_level[ends], response.camera_dn[ends], color=FAINT, linewidth=0.8, linestyle="--", label="line"
    )
    axes.plot(
        response.display_level, response.camera_dn, color=LINE_X, linewidth=1.1, marker="o", markersize=3, label="used"
    )
    for chosen, marker, label in (
        (joined, "s", "joined with the one below"),
        (readings.is_saturated, "x", "saturated"),
    ):
        if chosen.any():
            axes.plot(
                readings.level[chosen],
                readings.mean_dn[chosen],
                color=LINE_Y,
                linestyle="none",
                marker=marker,
                markersize=4,
                fillstyle="none",
                label=label,
            )
    axes.set_ylabel("camera reading [DN]", fontsize=8.5, color=INK)
    add_legend(axes, loc="upper left")


def _draw_departure(axes: "Axes", result: Result) -> None:
    departure, sigma = nonlinearity(result.response)
    axes.axhline(0, color=FAINT, linewidth=0.8, linestyle="--")
    axes.errorbar(
        result.response.display_level,
        100 * departure,
        100 * sigma,
        color=LINE_X,
        linewidth=1.1,
        marker="o",
        markersize=3,
        elinewidth=0.8,
        capsize=2,
    )
    axes.set_ylabel("departure from the line\n[% of the readings]", fontsize=8.5, color=INK)
