"""Maps of a trough in its report: angles, uncertainty and what was not measured."""

from typing import TYPE_CHECKING

import numpy as np

from heliogauge.reporting.canvas import (
    FAINT,
    INK,
    LINE_X,
    LINE_Y,
    MapStyle,
    add_legend,
    chart_figure,
    map_figure,
    robust_limit,
)
from heliogauge.reporting.html import Html, join, show, table
from heliogauge.reporting.uncertainty import uncertainty_shares
from heliogauge.validate import FloatArray
from observer.report.results import TroughResults
from observer.trough.collector import Collector

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MRAD = 1e3


def maps(results: TroughResults) -> Html:
    """Return the maps of the mirror."""
    from heliogauge.reporting.figures import flag_map

    slope_map, angles = results.base.slope_map, results.angles
    if not slope_map.valid.any():
        return join(
            Html("<p>No point of the mirror was measured.</p>"),
            show(with_panels(flag_map(slope_map), results.collector)),
        )
    limit = robust_limit(_MRAD * angles["theta_ra"], _MRAD * angles["theta_r"])
    drawn = [
        _angle_map(results, "theta_ra", "theta_ra (+ to +x): mirror and absorber", limit),
        theta_r_map(results, limit),
        _angle_map(results, "theta_a", "theta_a (+ to +x): absorber alone", None),
        _untilted(results, limit),
        _sigma_map(results, "theta_r"),
        _sigma_map(results, "theta_ra"),
        with_panels(flag_map(slope_map), results.collector),
    ]
    more = [histogram(results), *_along(results), *_height(results)]
    note = (
        'What the sun meets is theta_ra = theta_r + theta_a, all across the trough. "+ towards +x": positive where the '
        "mirror's normal is turned towards +x. "
        "slope_map.nc holds dz/dx, whose sign is the opposite: theta_r = atan(design slope) - atan(measured slope). "
        "Thin lines: edges of the panels; dashed lines: receiver supports."
    )
    return join(show(*drawn, caption=note), show(*more), _shares(results))


def _shares(results: TroughResults) -> Html:
    """Return where the uncertainty of the slopes comes from."""
    shares = uncertainty_shares(results.base.slope_map)
    rows = [(name, f"{_MRAD * across:.4f} mrad") for name, (across, _) in shares.items()]
    return table(("uncertainty of theta_r, RMS over the mirror", "1 sigma"), rows, numbers=(1,))


def theta_r_map(results: TroughResults, limit: float | None = None) -> "Figure":
    """Draw the mirror's slope error.

    limit: Where the colours end [mrad].
    """
    return _angle_map(results, "theta_r", "theta_r (+ to +x): mirror alone", limit)


def _angle_map(results: TroughResults, name: str, title: str, limit: float | None) -> "Figure":
    values = np.where(results.base.slope_map.valid, results.angles[name], np.nan)
    note = f"RMS {_MRAD * _rms(values):.3f}, mean {_MRAD * float(np.nanmean(values)):+.3f} mrad"
    return _panelled(results, values, MapStyle(title, "mrad", _MRAD, limit=limit, note=note))


def _untilted(results: TroughResults, limit: float) -> "Figure":
    theta = np.where(results.base.slope_map.valid, results.angles["theta_r"], np.nan)
    values = theta - np.nanmean(theta)
    note = f"RMS {_MRAD * _rms(values):.3f} mrad"
    title = "theta_r (+ to +x) without its mean"
    return _panelled(results, values, MapStyle(title, "mrad", _MRAD, limit=limit, note=note))


def _sigma_map(results: TroughResults, angle: str) -> "Figure":
    values = np.where(results.base.slope_map.valid, results.angles[f"sigma_{angle}"], np.nan)
    note = f"median {_MRAD * float(np.nanmedian(values)):.3f} mrad"
    style = MapStyle(f"Uncertainty of {angle} (1 sigma)", "mrad", _MRAD, diverging=False, note=note)
    return _panelled(results, values, style)


def histogram(results: TroughResults) -> "Figure":
    """Draw the distributions of theta_ra and theta_r.

    Returns: Two outlines and the normal distribution of the width of theta_r [mrad].
    """
    valid = results.base.slope_map.valid
    both = {name: _MRAD * results.angles[name][valid] for name in ("theta_ra", "theta_r")}
    limit = robust_limit(*both.values())
    mean, width = float(both["theta_r"].mean()), float(both["theta_r"].std())
    figure, axes = chart_figure(
        "Distribution of theta_r and theta_ra",
        f"theta_r: mean {mean:+.3f} mrad, standard deviation {width:.3f} mrad",
        "angle [mrad], + towards +x",
        "share of the nodes per mrad",
    )
    bins = np.linspace(-1.25 * limit, 1.25 * limit, 81)
    for (name, values), (color, filled) in zip(both.items(), ((LINE_Y, False), (LINE_X, True)), strict=True):
        density, _ = np.histogram(values, bins)
        axes.stairs(
            density / max(values.size, 1) / np.diff(bins),
            bins,
            fill=filled,
            color=color,
            alpha=0.6 if filled else 1.0,
            label=name,
            zorder=2 if filled else 3,
        )
    if width > 0:
        fine = np.linspace(bins[0], bins[-1], 200)
        normal = np.exp(-0.5 * ((fine - mean) / width) ** 2) / (width * np.sqrt(2 * np.pi))
        axes.plot(fine, normal, color=INK, linewidth=1, label="normal, as wide as theta_r")
    axes.set_xlim(bins[0], bins[-1])
    axes.set_ylim(top=1.55 * axes.get_ylim()[1])
    add_legend(axes, loc="upper right")
    return figure


def _along(results: TroughResults) -> "list[Figure]":
    """Draw the slope along the trough where it was measured: that takes passes at different places along it."""
    slope_map = results.base.slope_map
    values = np.where(slope_map.valid, slope_map.slope_error_y, np.nan)
    if not np.isfinite(values).any():
        return []
    share = np.isfinite(values).sum() / max(int(slope_map.aperture.sum()), 1)
    note = f"dz/dy, measured minus design   RMS {_MRAD * _rms(values):.3f} mrad, {share:.0%} of the mirror"
    return [_panelled(results, values, MapStyle("Slope error along the trough", "mrad", _MRAD, note=note))]


def _height(results: TroughResults) -> "list[Figure]":
    slope_map = results.base.slope_map
    if not np.isfinite(slope_map.height_m).any():
        return []
    x, y = np.meshgrid(slope_map.x_m, slope_map.y_m)
    values = slope_map.height_m - results.collector.surface.height(x, y)
    note = f"above the design parabola   RMS {1e3 * _rms(values):.3f} mm"
    return [_panelled(results, values, MapStyle("Height of the mirror minus design", "mm", 1e3, note=note))]


def _panelled(results: TroughResults, values: FloatArray, style: MapStyle) -> "Figure":
    return with_panels(map_figure(results.base.slope_map, values, style), results.collector)


def with_panels(figure: "Figure", collector: Collector) -> "Figure":
    """Draw edges between panels, and supports, over a map."""
    axes = figure.axes[0]
    for x in collector.panel_edges_x_m[1:-1]:
        axes.axvline(x, color=FAINT, linewidth=0.5, zorder=5)
    for y in collector.panel_edges_y_m[1:-1]:
        axes.axhline(y, color=FAINT, linewidth=0.5, zorder=5)
    for y in collector.support_y_m:
        if abs(y) < collector.length_m / 2 - 0.01:
            axes.axhline(y, color=FAINT, linewidth=0.8, linestyle=(0, (6, 3)), zorder=5)
    return figure


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))
