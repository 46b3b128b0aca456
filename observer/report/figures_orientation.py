"""One figure of a trough at several orientations: the absorber's profiles and its sag."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from heliogauge.reporting.canvas import FAINT, WIDTH_IN, add_legend, add_title, axes_in_inches, new_figure
from heliogauge.validate import FloatArray
from observer.product.orientation_study import SpanSags

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLORS = ("#1f6fb2", "#c4511c", "#2b8a4b", "#7a4fa3", "#8a7a1d", "#444b54")
_LEFT_IN, _PLOT_IN, _STEP_IN = 0.72, 1.75, 2.45
#: Legends stand beside the plots, where they hide nothing.
_LEGEND_IN = 2.3
_BESIDE = {"loc": "upper left", "bbox_to_anchor": (1.005, 1.02)}


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """The absorber along the trough at one orientation.

    label: What the lines are called.
    orientation_rad: Turn of the collector from zenith [rad].
    y_m, x_m, z_m, sigma_x_m, sigma_z_m (n,): Stations, places and standard deviations; NaN where not measured [m].
    """

    label: str
    orientation_rad: float
    y_m: FloatArray
    x_m: FloatArray
    z_m: FloatArray
    sigma_x_m: FloatArray
    sigma_z_m: FloatArray


def orientation_figure(profiles: Sequence[Profile], sags: Sequence[SpanSags]) -> "Figure":
    """Draw what turning a trough does to its absorber.

    Returns: X_a and Z_a along the trough, sag against orientation.
    """
    count = 3 if sags else 2
    height = 0.55 + count * _STEP_IN
    figure = new_figure(height, 2 * WIDTH_IN)
    add_title(figure, "The absorber at several orientations", "error bars and bands: 1 sigma")
    places = [height - 0.05 - (k + 1) * _STEP_IN for k in range(count)]
    words = {"x": "across, + towards +x", "z": "along the optical axis, + away from the mirror"}
    for place, axis in zip(places[:2], "xz", strict=True):
        axes = _plot(figure, place, "y along the trough [m]", f"{axis.upper()}_a [mm]")
        _draw_profiles(axes, profiles, axis, words[axis])
    if sags:
        _draw_sags(_plot(figure, places[2], "orientation from zenith [deg]", "sag [mm]"), sags)
    return figure


def _plot(figure: "Figure", bottom_in: float, x_label: str, y_label: str) -> "Axes":
    axes = axes_in_inches(figure, _LEFT_IN, bottom_in, 2 * WIDTH_IN - _LEFT_IN - _LEGEND_IN, _PLOT_IN)
    axes.set_xlabel(x_label, fontsize=8)
    axes.set_ylabel(y_label, fontsize=8)
    axes.grid(visible=True, color="#e4e7ea", linewidth=0.6)
    return axes


def _draw_profiles(axes: "Axes", profiles: Sequence[Profile], axis: str, words: str) -> None:
    reference = 0.0 if axis == "x" else float(np.nanmean(np.concatenate([one.z_m for one in profiles])))
    for one, color in zip(profiles, np.resize(COLORS, len(profiles)), strict=True):
        value, sigma = (one.x_m, one.sigma_x_m) if axis == "x" else (one.z_m, one.sigma_z_m)
        value = 1e3 * (value - reference)
        axes.plot(one.y_m, value, ".-", color=color, linewidth=1.1, markersize=4, label=one.label)
        axes.fill_between(one.y_m, value - 1e3 * sigma, value + 1e3 * sigma, color=color, alpha=0.18, linewidth=0)
    if axis == "z":
        words += f"; from {reference:.4f} m, the mean of all"
    axes.set_title(words, fontsize=8, color=FAINT, loc="left", pad=3)
    add_legend(axes, **_BESIDE)


def _draw_sags(axes: "Axes", sags: Sequence[SpanSags]) -> None:
    for number, (sag, color) in enumerate(zip(sags, np.resize(COLORS, len(sags)), strict=True), start=1):
        turn = np.degrees(sag.orientation_rad)
        for value, sigma, marker, name in (
            (sag.sag_x_m, sag.sigma_x_m, "o", "across"),
            (sag.sag_z_m, sag.sigma_z_m, "^", "along the optical axis"),
        ):
            axes.errorbar(
                turn,
                1e3 * value,
                1e3 * sigma,
                fmt=marker,
                color=color,
                markersize=4,
                linewidth=1,
                capsize=2,
                label=f"span {number}, {name}",
            )
    axes.set_title("of the middle of each span from its supports", fontsize=8, color=FAINT, loc="left", pad=3)
    add_legend(axes, **_BESIDE)
