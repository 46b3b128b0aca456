"""Figures of several modules side by side: their maps with one scale of colours."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from heliogauge.reporting.canvas import (
    DIVERGING,
    INK,
    MISSING,
    MISSING_HATCH,
    WIDTH_IN,
    add_title,
    axes_in_inches,
    new_figure,
    robust_limit,
)
from heliogauge.validate import FloatArray
from observer.files import ModuleMap

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CHANGES_TITLE = "Change of theta_r against the first orientation, without its mean"
_MRAD = 1e3
_WIDE_IN = 2 * WIDTH_IN
_LEFT_IN, _RIGHT_IN, _TOP_IN, _BOTTOM_IN = 0.62, 0.95, 0.62, 0.5
#: Between maps: room for a title and for the axis below it [inch].
_BESIDE_IN, _BELOW_IN = 0.3, 0.55
#: Maps are not drawn higher, and not more of them in a row.
_HIGHEST_IN, _MOST_IN_ROW = 3.6, 6
#: Room for the title of a map that is narrow [inch].
_NAME_IN = 1.9


@dataclass(frozen=True, slots=True, eq=False)
class OneMap:
    """One map of angles beside others.

    name: What it is called.
    x_m, y_m (nx,): Nodes [m].
    angle_rad (ny, nx): The angle; NaN where not measured [rad].
    sigma_rad (ny, nx): Its standard deviation; None where not known [rad].
    """

    name: str
    x_m: FloatArray
    y_m: FloatArray
    angle_rad: FloatArray
    sigma_rad: FloatArray | None = None


def modules_figure(maps: Sequence[ModuleMap], angle: str) -> "Figure":
    """Draw one angle of all modules with one scale of colours, all at the same scale of length.

    angle: "theta_ra", or "theta_r", which is drawn without each module's mean.
    Returns: x to the right and y up, as seen from the front.
    """
    titles = {
        "theta_ra": "theta_ra: mirror and absorber, what the sun meets",
        "theta_r": "theta_r without its mean: mirror alone",
    }
    return maps_figure([OneMap(one.name, one.x_m, one.y_m, _shown(one, angle)) for one in maps], titles[angle])


def maps_figure(maps: Sequence[OneMap], title: str) -> "Figure":
    """Draw maps of angles beside each other with one scale of colours and one of length.

    Returns: x to the right and y up, as seen from the front.
    """
    fields = [_MRAD * one.angle_rad for one in maps]
    limit = robust_limit(*fields)
    width_m = max(float(np.ptp(one.x_m)) for one in maps)
    height_m = max(float(np.ptp(one.y_m)) for one in maps)
    columns = min(len(maps), _MOST_IN_ROW)
    # One scale at the left will do where all maps are as long.
    is_alike = bool(np.allclose([one.y_m[[0, -1]] for one in maps], maps[0].y_m[[0, -1]], atol=0.02))
    beside = _BESIDE_IN if is_alike else 2 * _BESIDE_IN
    rows = -(-len(maps) // columns)
    room = (_WIDE_IN - _LEFT_IN - _RIGHT_IN - (columns - 1) * beside) / columns
    inch_per_m = min(room / width_m, _HIGHEST_IN / height_m)
    # A title of a map needs some width.
    across, up = width_m * inch_per_m, height_m * inch_per_m
    step = max(across, min(room, _NAME_IN)) + beside
    figure = new_figure(_TOP_IN + rows * (up + _BELOW_IN) + _BOTTOM_IN - 0.2, _WIDE_IN)
    for number, (one, shown) in enumerate(zip(maps, fields, strict=True)):
        row, column = divmod(number, columns)
        bottom = _BOTTOM_IN + (rows - 1 - row) * (up + _BELOW_IN)
        axes = axes_in_inches(figure, _LEFT_IN + column * step, bottom, across, up)
        axes.patch.set(facecolor=MISSING, hatch="/////", edgecolor=MISSING_HATCH, linewidth=0)
        ends = (one.x_m[0], one.x_m[-1], one.y_m[0], one.y_m[-1])
        image = axes.imshow(
            np.ma.masked_invalid(shown),
            cmap=DIVERGING,
            vmin=-limit,
            vmax=limit,
            extent=ends,
            origin="lower",
            interpolation="nearest",
            zorder=2,
        )
        rms = f"{float(np.sqrt(np.nanmean(shown**2))):.2f} mrad RMS" if np.isfinite(shown).any() else "not measured"
        axes.set_title(f"{one.name}: {rms}", fontsize=8, color=INK, loc="left", pad=3)
        axes.set_xlabel("x [m]", fontsize=8, color=INK, labelpad=2)
        if column > 0 and is_alike:
            axes.tick_params(labelleft=False)
        if column == 0:
            axes.set_ylabel("y [m]", fontsize=8, color=INK, labelpad=2)
    add_title(figure, title, "+ towards +x; seen from the front")
    end = _LEFT_IN + (columns - 1) * step + across
    bar = figure.colorbar(image, cax=axes_in_inches(figure, end + 0.12, _BOTTOM_IN, 0.12, up))
    bar.set_label("mrad", fontsize=8, color=INK)
    bar.ax.tick_params(labelsize=8)
    return figure


def _shown(one: ModuleMap, angle: str) -> FloatArray:
    if angle == "theta_ra":
        return one.theta_ra_rad
    if not np.isfinite(one.theta_r_rad).any():
        return one.theta_r_rad
    return np.asarray(one.theta_r_rad - np.nanmean(one.theta_r_rad))
