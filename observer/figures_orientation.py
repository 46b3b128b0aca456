"""One figure of a trough at several orientations: the absorber's profiles, its sag, the mirror's change."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from heliogauge.figures_canvas import WIDTH_IN, add_legend, add_title, axes_in_inches, new_figure
from heliogauge.validate import FloatArray
from observer.orientation_study import SpanSags

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLORS = ("#1f6fb2", "#c4511c", "#2b8a4b", "#7a4fa3", "#8a7a1d", "#444b54")
_LEFT_IN, _PLOT_IN, _STEP_IN = 0.72, 1.75, 2.35


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """The absorber along the trough at one orientation.

    Parameters
    ----------
    label : str
        What the lines are called.
    orientation_rad : float
        Turn of the collector from zenith [rad].
    y_m, x_m, z_m, sigma_x_m, sigma_z_m : ndarray, shape (n,)
        Stations, places and standard deviations; NaN where not measured [m].
    """

    label: str
    orientation_rad: float
    y_m: FloatArray
    x_m: FloatArray
    z_m: FloatArray
    sigma_x_m: FloatArray
    sigma_z_m: FloatArray


def orientation_figure(
    profiles: Sequence[Profile],
    sags: Sequence[SpanSags],
    changes: Sequence[tuple[str, FloatArray, FloatArray, FloatArray]],
) -> "Figure":
    """Draw what turning a trough does.

    Parameters
    ----------
    profiles : sequence of Profile
        The absorber at each orientation.
    sags : sequence of SpanSags
        Sag of each span.
    changes : sequence of (str, ndarray, ndarray, ndarray)
        Label, x, y and change of theta_r against the first orientation [m, rad].

    Returns
    -------
    Figure
        X_a and Z_a along the trough, sag against orientation, maps of the change of theta_r.
    """
    height = 0.55 + (3 + len(changes)) * _STEP_IN
    figure = new_figure(height)
    add_title(figure, "Absorber and mirror at several orientations", "error bars and bands: 1 sigma")
    places = [height - 0.55 - (k + 1) * _STEP_IN + 0.55 for k in range(3 + len(changes))]
    for place, axis in zip(places[:2], "xz", strict=True):
        _draw_profiles(_plot(figure, place, "y along the trough [m]", f"{axis.upper()}_a [mm]"), profiles, axis)
    _draw_sags(_plot(figure, places[2], "orientation from zenith [deg]", "sag [mm]"), sags)
    for place, (label, x_m, y_m, change) in zip(places[3:], changes, strict=True):
        axes = _plot(figure, place, "y along the trough [m]", "x [m]", spare_in=0.6)
        shown = 1e3 * (change - np.nanmean(change))
        limit = max(float(np.nanpercentile(np.abs(shown), 99)), 0.05)
        image = axes.imshow(
            shown.T, origin="lower", extent=(y_m[0], y_m[-1], x_m[0], x_m[-1]), aspect="auto", cmap="RdBu_r",
            vmin=-limit, vmax=limit, interpolation="nearest",
        )  # fmt: skip
        axes.set_title(f"change of theta_r without its mean, {label} [mrad]", fontsize=8, loc="left")
        figure.colorbar(image, ax=axes, fraction=0.03, pad=0.01).ax.tick_params(labelsize=7)
    return figure


def _plot(figure: "Figure", bottom_in: float, x_label: str, y_label: str, *, spare_in: float = 0.25) -> "Axes":
    axes = axes_in_inches(figure, _LEFT_IN, bottom_in, WIDTH_IN - _LEFT_IN - spare_in, _PLOT_IN)
    axes.set_xlabel(x_label, fontsize=8)
    axes.set_ylabel(y_label, fontsize=8)
    axes.grid(visible=True, color="#e4e7ea", linewidth=0.6)
    return axes


def _draw_profiles(axes: "Axes", profiles: Sequence[Profile], axis: str) -> None:
    reference = 0.0 if axis == "x" else float(np.nanmean(np.concatenate([one.z_m for one in profiles])))
    for one, color in zip(profiles, np.resize(_COLORS, len(profiles)), strict=True):
        value, sigma = (one.x_m, one.sigma_x_m) if axis == "x" else (one.z_m, one.sigma_z_m)
        value = 1e3 * (value - reference)
        axes.plot(one.y_m, value, ".-", color=color, linewidth=1.1, markersize=4, label=one.label)
        axes.fill_between(one.y_m, value - 1e3 * sigma, value + 1e3 * sigma, color=color, alpha=0.18, linewidth=0)
    if axis == "z":
        axes.set_title(f"above {reference:.4f} m, the mean of all", fontsize=8, loc="left")
    add_legend(axes, loc="best")


def _draw_sags(axes: "Axes", sags: Sequence[SpanSags]) -> None:
    for number, (sag, color) in enumerate(zip(sags, np.resize(_COLORS, len(sags)), strict=True), start=1):
        turn = np.degrees(sag.orientation_rad)
        for value, sigma, marker, name in (
            (sag.sag_x_m, sag.sigma_x_m, "o", "across"), (sag.sag_z_m, sag.sigma_z_m, "^", "along the optical axis")
        ):  # fmt: skip
            axes.errorbar(turn, 1e3 * value, 1e3 * sigma, fmt=marker, color=color, markersize=4, linewidth=1,
                          capsize=2, label=f"span {number}, {name}")  # fmt: skip
    if sags:
        add_legend(axes, loc="best")
