"""Figures of the shared types: each function returns a matplotlib Figure and shows nothing.

Maps of a mirror are seen from the front, x to the right and y up, in equal proportions. Their colours end at a round
number that 99 % of the values stay below; what lies beyond is noted under the title and by an arrow on the colour bar.
Grey and hatched is mirror without a measured value.
"""

from dataclasses import replace

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from heliogauge.flags import FLAG_TEXTS, SampleFlag, count_flags
from heliogauge.reporting.canvas import (
    FAINT,
    INK,
    MISSING,
    MISSING_HATCH,
    WIDTH_IN,
    MapStyle,
    add_title,
    axes_in_inches,
    cover_outside,
    extent_of,
    map_figure,
    mirror_axes,
    png_of,
    robust_limit,
    thinned,
    thinned_map,
)
from heliogauge.reporting.image_figures import camera_image, outline_residuals, setup_sketch
from heliogauge.reporting.line_figures import cross_sections, encircled_energy, histogram, sigma_shares, spot_image
from heliogauge.slopes.grid import curl, curvature
from heliogauge.slopes.map import SlopeMap, no_common_modes
from heliogauge.slopes.removal import Removal, remove
from heliogauge.validate import FloatArray

__all__ = [
    "camera_image",
    "common_mode_map",
    "cross_sections",
    "curl_map",
    "curvature_map",
    "encircled_energy",
    "flag_map",
    "height_deviation_map",
    "height_map",
    "histogram",
    "map_figure",
    "outline_residuals",
    "png_of",
    "setup_sketch",
    "sigma_map",
    "sigma_shares",
    "slope_error_magnitude_map",
    "slope_error_map",
    "slope_map_figure",
    "spot_image",
]

MRAD = 1e3
# Qualitative colours that differ in lightness too; the first flag in the list wins where a node has several.
_FLAG_COLORS = ("#d94f30", "#f0a23c", "#7b5ea7", "#2f8f83", "#b2336e", "#4d7ebf", "#8a6d3b", "#5b8c2a", "#111111")


def slope_error_map(slope_map: SlopeMap, axis: str, *, removed: Removal = Removal.NOTHING) -> Figure:
    """Draw the slope error in x or y.

    removed: What is taken out first.
    """
    # Without common modes: they do not change what is drawn, and projecting them takes 2 s for a million nodes.
    shown = slope_map if removed == Removal.NOTHING else remove(replace(slope_map, common=no_common_modes()), removed)
    errors = {"x": _measured(shown, shown.slope_error_x), "y": _measured(shown, shown.slope_error_y)}
    limit = robust_limit(thinned(errors["x"]) * MRAD, thinned(errors["y"]) * MRAD)
    title = f"Slope error in {axis}"
    if removed != Removal.NOTHING:
        title += f", {_REMOVAL_WORDS[removed]} removed"
    note = f"RMS {_rms(errors[axis]) * MRAD:.3f} mrad"
    return map_figure(shown, errors[axis], MapStyle(title, "mrad", MRAD, limit=limit, note=note))


_REMOVAL_WORDS = {Removal.TILT: "tilt", Removal.FOCUS: "tilt and focus", Removal.QUADRATIC: "best-fit quadratic"}


def slope_error_magnitude_map(slope_map: SlopeMap) -> Figure:
    """Draw the length of the slope error vector."""
    size = _measured(slope_map, np.hypot(slope_map.slope_error_x, slope_map.slope_error_y))
    note = f"RMS {_rms(size) * MRAD:.3f} mrad"
    return map_figure(slope_map, size, MapStyle("Slope error, magnitude", "mrad", MRAD, diverging=False, note=note))


def slope_map_figure(slope_map: SlopeMap, axis: str) -> Figure:
    """Draw the measured slope in x or y."""
    slope = slope_map.slope_x if axis == "x" else slope_map.slope_y
    return map_figure(slope_map, _measured(slope_map, slope), MapStyle(f"Measured slope dz/d{axis}", "mrad", MRAD))


def sigma_map(slope_map: SlopeMap, axis: str, share: str = "total") -> Figure:
    """Draw the standard deviation of the slope in x or y, or of one of its shares.

    share: "total", "random" or "common".
    """
    slope_map = thinned_map(slope_map)
    index = "xy".index(axis)
    if share == "total":
        field = slope_map.sigma_slope()[index]
    elif share == "random":
        field = (slope_map.sigma_random_x, slope_map.sigma_random_y)[index]
    else:
        field = np.sqrt(slope_map.common_variance()[index])
    words = {
        "total": f"Uncertainty of slope {axis} (1 sigma)",
        "random": f"Random share of the uncertainty, {axis}",
        "common": f"Common share of the uncertainty, {axis}",
    }
    sigma = _measured(slope_map, field)
    note = f"RMS {_rms(sigma) * 1e6:.3g} \u00b5rad"
    return map_figure(slope_map, sigma, MapStyle(words[share], "\u00b5rad", 1e6, diverging=False, note=note))


def curl_map(slope_map: SlopeMap) -> Figure:
    """Draw the curl of the slopes over its sigma: a real surface has none, so this shows errors of the measurement."""
    result = curl(slope_map)
    ratio = np.divide(
        result.value_per_m, result.sigma_per_m, out=np.full(slope_map.shape, np.nan), where=result.sigma_per_m > 0
    )
    note = f"RMS {_rms(ratio):.2f}, expected 1; RMS curl {_rms(result.value_per_m) * MRAD:.3g} mrad/m"
    return map_figure(slope_map, ratio, MapStyle("Self-check: curl / sigma", "sigma", limit=4.0, note=note))


def curvature_map(slope_map: SlopeMap, axis: str) -> Figure:
    """Draw the curvature of the measured surface beyond its mean.

    axis: "x" or "y".
    """
    value = curvature(replace(slope_map, common=no_common_modes()))["xy".index(axis)].value_per_m
    finite = value[np.isfinite(value)]
    mean = float(np.mean(finite)) if finite.size else float("nan")
    focus = f" (f = {0.5 / mean:.4g} m)" if np.isfinite(mean) and mean != 0 else ""
    style = MapStyle(
        f"Curvature in {axis} minus its mean", "mrad/m", MRAD, note=f"mean {mean * MRAD:.4g} mrad/m{focus}"
    )
    return map_figure(slope_map, value - mean, style)


def height_map(slope_map: SlopeMap) -> Figure:
    """Draw the integrated height."""
    height = slope_map.height_m * MRAD
    low = float(np.nanmin(height)) if np.isfinite(height).any() else 0.0
    high = float(np.nanmax(height)) if np.isfinite(height).any() else 1.0
    style = MapStyle("Height of the surface", "mm", MRAD, diverging=False, limit=high, low=low, note="over z = 0")
    return map_figure(slope_map, slope_map.height_m, style)


def height_deviation_map(slope_map: SlopeMap) -> Figure:
    """Draw the integrated height minus its best-fit quadratic."""
    x, y = np.meshgrid(*(axis / max(float(np.abs(axis).max()), 1e-9) for axis in (slope_map.x_m, slope_map.y_m)))
    known = np.isfinite(slope_map.height_m)
    terms = np.stack([np.ones_like(x), x, y, x**2, x * y, y**2], axis=-1)
    deviation = np.full(slope_map.shape, np.nan)
    if np.count_nonzero(known) > terms.shape[-1]:
        # Normal equations: 1 s quicker for a million nodes, and 6 terms of scaled coordinates are harmless.
        chosen, heights = terms[known], slope_map.height_m[known]
        deviation[known] = heights - chosen @ np.linalg.lstsq(chosen.T @ chosen, chosen.T @ heights, rcond=None)[0]
    style = MapStyle("Height minus best-fit quadratic", "\u00b5m", 1e6, note=f"RMS {_rms(deviation) * 1e6:.3g} \u00b5m")
    return map_figure(slope_map, deviation, style)


def common_mode_map(slope_map: SlopeMap, source: str, axis: str) -> Figure:
    """Draw how far one common source of uncertainty moves the slope, 1 sigma of all its modes together.

    source: One of ``slope_map.common.sources``.
    axis: "x" or "y".
    """
    slope_map = thinned_map(slope_map)
    modes = slope_map.common.evaluate(*np.meshgrid(slope_map.x_m, slope_map.y_m))
    chosen = [index for index, name in enumerate(slope_map.common.sources) if name == source]
    sigma = np.sqrt(np.sum(modes[chosen, "xy".index(axis)] ** 2, axis=0))
    style = MapStyle(
        f"Uncertainty from {source}, slope {axis}", "\u00b5rad", 1e6, diverging=False, note=f"{len(chosen)} modes"
    )
    return map_figure(slope_map, _measured(slope_map, sigma), style)


def flag_map(slope_map: SlopeMap) -> Figure:
    """Draw why nodes of the mirror have no value or a doubtful one."""
    counts = count_flags(slope_map.flags, slope_map.aperture)
    counts.pop(SampleFlag.OUTSIDE_MIRROR, None)
    order = sorted(counts, key=lambda flag: counts[flag], reverse=True)[: len(_FLAG_COLORS)]
    flags = thinned(slope_map.flags)
    codes = np.where(thinned(slope_map.valid), 0.0, np.nan)
    # Rare reasons are painted last, over the common ones.
    for number, flag in enumerate(order, start=1):
        codes[(flags & np.uint32(flag)) != 0] = number
    figure, axes, _ = mirror_axes(slope_map)
    colors = ["#e9f1ea", *_FLAG_COLORS[: len(order)]]
    axes.imshow(
        np.ma.masked_invalid(codes),
        cmap=ListedColormap(colors),
        norm=BoundaryNorm(np.arange(len(colors) + 1) - 0.5, len(colors)),
        extent=extent_of(slope_map),
        origin="lower",
        interpolation="nearest",
        zorder=2,
    )
    cover_outside(axes, slope_map)
    add_title(
        figure, "What was measured, and why not the rest", f"{slope_map.measured_share:.2%} of the mirror measured"
    )
    total = int(np.count_nonzero(slope_map.aperture))
    patches = [Patch(facecolor=colors[0], edgecolor=FAINT, linewidth=0.5, label="measured, no remark")]
    for number, flag in enumerate(order, start=1):
        label = f"{FLAG_TEXTS[flag]}: {counts[flag] / total:.2%}"
        patches.append(Patch(facecolor=colors[number], edgecolor=FAINT, linewidth=0.5, label=label))
    patches.append(
        Patch(facecolor=MISSING, edgecolor=MISSING_HATCH, hatch="/////", linewidth=0, label="no value, no flag")
    )
    _legend_below(figure, patches)
    return figure


def _legend_below(figure: Figure, patches: list[Patch]) -> None:
    # The page grows downwards by the lines of the legend; everything above keeps its place in inches.
    extra = 0.17 * len(patches) + 0.1
    width, height = figure.get_size_inches()
    for axes in figure.axes:
        left, low, wide, high = axes.get_position().bounds
        axes.set_position((left, (low * height + extra) / (height + extra), wide, high * height / (height + extra)))
    for text in figure.texts:
        x, y = text.get_position()
        text.set_position((x, (y * height + extra) / (height + extra)))
    figure.set_size_inches(width, height + extra)
    legend_axes = axes_in_inches(figure, 0.15, 0.02, WIDTH_IN - 0.2, extra)
    legend_axes.set_axis_off()
    legend_axes.legend(handles=patches, loc="upper left", fontsize=7.5, frameon=False, labelcolor=INK, borderaxespad=0)


def _measured(slope_map: SlopeMap, field: FloatArray) -> FloatArray:
    return np.where(slope_map.valid, field, np.nan)


def _rms(field: FloatArray) -> float:
    finite = field[np.isfinite(field)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")
