"""Figures with lines: distributions, cross sections, energy in a circle, and the spot on the target."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from heliogauge.reporting.canvas import (
    FAINT,
    INK,
    LINE_X,
    LINE_Y,
    WIDTH_IN,
    MapStyle,
    add_color_bar,
    add_legend,
    add_title,
    axes_in_inches,
    chart_figure,
    new_figure,
    nice_ceiling,
    robust_limit,
)
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.normal_angles import normal_angles

if TYPE_CHECKING:
    from heliogauge.sunlight.beam import SpotImage

MRAD = 1e3
#: Shares of the energy whose circles are drawn on the spot.
ENERGY_SHARES = (0.5, 0.9, 0.99)


def histogram(slope_map: SlopeMap, axis: str) -> Figure:
    """Draw the distribution of the normal's angles with its mean, SD and the normal distribution of the same width.

    axis: "x" or "y".
    """
    slopes = slope_map.slope_x, slope_map.slope_y, slope_map.design_slope_x, slope_map.design_slope_y
    angles = normal_angles(*(one[slope_map.valid] for one in slopes))
    values = angles["xy".index(axis)] * MRAD
    rms = float(np.sqrt(np.mean(values**2))) if values.size else 0.0
    limit = robust_limit(values)
    color = LINE_X if axis == "x" else LINE_Y
    figure, axes = chart_figure(
        f"Distribution of the normal's angle from the design's in {axis}",
        f"SD{axis} (RMS about zero) {rms:.3f} mrad",
        f"angle of the normal in {axis} [mrad]",
        "share of the nodes per mrad",
    )
    bins = np.linspace(-1.25 * limit, 1.25 * limit, 81)
    density, _ = np.histogram(values, bins)
    axes.stairs(density / max(values.size, 1) / np.diff(bins), bins, fill=True, color=color, alpha=0.75)
    if values.size > 1 and np.std(values) > 0:
        mean, sd = float(np.mean(values)), float(np.std(values))
        fine = np.linspace(bins[0], bins[-1], 200)
        normal = np.exp(-0.5 * ((fine - mean) / sd) ** 2) / (sd * np.sqrt(2 * np.pi))
        axes.plot(fine, normal, color=INK, linewidth=1, label="normal, same mean and width")
        axes.axvline(mean, color=INK, linewidth=0.8, linestyle=":", label=f"mean {mean:+.3f} mrad")
    for side in (-1, 1):
        axes.axvline(
            side * rms, color=color, linewidth=1, linestyle="--", label=f"\u00b1SD{axis}" if side == 1 else None
        )
    axes.set_xlim(bins[0], bins[-1])
    axes.set_ylim(bottom=0)
    axes.set_ylim(top=1.25 * axes.get_ylim()[1])
    add_legend(axes, loc="upper right")
    return figure


def cross_sections(slope_map: SlopeMap, axis: str) -> Figure:
    """Draw the slope errors along the middle row (axis x) or column (axis y) with a band of one sigma.

    axis: "x": along x through the middle of the mirror; "y": along y.
    """
    along, across = (slope_map.x_m, slope_map.y_m) if axis == "x" else (slope_map.y_m, slope_map.x_m)
    counts = np.count_nonzero(slope_map.valid, axis=1 if axis == "x" else 0)
    index = _middle_line(counts)
    cut = (index, slice(None)) if axis == "x" else (slice(None), index)
    other = "y" if axis == "x" else "x"
    figure, axes = chart_figure(
        f"Section along {axis}",
        f"at {other} = {across[index]:.3f} m; bands: \u00b11 sigma",
        f"{axis} [m]",
        "slope error [mrad]",
    )
    here = np.full(along.size, across[index])
    modes = slope_map.common.evaluate(*((along, here) if axis == "x" else (here, along)))
    common = np.sqrt(np.sum(modes**2, axis=0))
    errors = (slope_map.slope_error_x, slope_map.slope_error_y)
    randoms = (slope_map.sigma_random_x, slope_map.sigma_random_y)
    for number, (name, color) in enumerate(zip("xy", (LINE_X, LINE_Y), strict=True)):
        line = np.where(slope_map.valid, errors[number], np.nan)[cut] * MRAD
        band = np.hypot(randoms[number][cut], common[number]) * MRAD
        axes.fill_between(along, line - band, line + band, color=color, alpha=0.25, linewidth=0)
        axes.plot(along, line, color=color, linewidth=0.9, label=f"slope error in {name}")
    axes.axhline(0, color=FAINT, linewidth=0.7)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.18 * (high - low))
    add_legend(axes, loc="upper right", ncols=2)
    return figure


def _middle_line(counts: np.ndarray) -> int:
    """Return the line nearest to the middle of the measured ones that has at least half of the most nodes."""
    full = np.flatnonzero(counts >= 0.5 * counts.max())
    return int(full[np.argmin(np.abs(full - 0.5 * (full[0] + full[-1])))])


def sigma_shares(shares: Mapping[str, tuple[float, float]]) -> Figure:
    """Draw where the uncertainty comes from, as bars for x and y.

    shares: RMS over the map of each source's standard deviation, in x and in y [rad].
    """
    names = list(shares)
    height = 0.42 * len(names) + 1.35
    figure = new_figure(height)
    axes = axes_in_inches(figure, 1.75, 0.55, WIDTH_IN - 2.1, height - 1.2)
    places = np.arange(len(names))[::-1]
    values = np.array([shares[name] for name in names]).reshape(-1, 2) * 1e6
    for column, (axis, color) in enumerate(zip("xy", (LINE_X, LINE_Y), strict=True)):
        offset = 0.19 - 0.38 * column
        axes.barh(places + offset, values[:, column], height=0.34, color=color, label=f"slope {axis}")
        for place, value in zip(places, values[:, column], strict=True):
            axes.text(value, place + offset, f" {value:.3g}", fontsize=7, va="center", color=INK)
    axes.set_yticks(places, names, fontsize=8)
    axes.set_xlim(0, 1.18 * max(float(values.max(initial=0.0)), 1e-9))
    axes.set_xlabel("RMS over the mirror of 1 sigma [\u00b5rad]", fontsize=8.5, color=INK)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    figure.legend(*axes.get_legend_handles_labels(), loc="upper right", fontsize=7.5, frameon=False, labelcolor=INK)
    add_title(figure, "Where the uncertainty comes from", "shares add in quadrature")
    return figure


def spot_image(spot: "SpotImage") -> Figure:
    """Draw the flux on the target with circles of equal energy.

    Returns: Flux for unit power [1/m^2], seen by someone who looks at the target from the mirror.
    """
    half = _spot_half_width(spot)
    box = (0.72, 0.6, WIDTH_IN - 1.75, WIDTH_IN - 1.75)
    figure = new_figure(box[3] + 1.25)
    axes = axes_in_inches(figure, *box)
    image = axes.imshow(
        spot.flux_per_m2,
        cmap="inferno",
        vmin=0,
        extent=(spot.x_m[0], spot.x_m[-1], spot.y_m[0], spot.y_m[-1]),
        origin="lower",
        interpolation="nearest",
    )
    x0, y0 = spot.center_m
    for share, style in zip(ENERGY_SHARES, ("-", "--", ":"), strict=True):
        radius = spot.radius_of_share(share)
        if not np.isfinite(radius):
            continue
        label = f"{share:.0%} of the energy: r = {radius:.3f} m"
        circle = Circle((x0, y0), radius, fill=False, edgecolor="white", linewidth=0.9, linestyle=style, label=label)
        axes.add_patch(circle)
    axes.set_xlim(x0 - half, x0 + half)
    axes.set_ylim(y0 - half, y0 + half)
    axes.locator_params(nbins=5)
    axes.set_xlabel("x on the target [m]", fontsize=8, color=INK, labelpad=2)
    axes.set_ylabel("y on the target [m]", fontsize=8, color=INK, labelpad=2)
    axes.legend(fontsize=6.5, frameon=False, labelcolor="white", loc="upper left", handlelength=1.6)
    add_color_bar(figure, image, box, MapStyle("", "1/m\u00b2", diverging=False), spot.flux_per_m2)
    note = f"{spot.rays:,} rays".replace(",", " ") + f"; RMS width x {spot.sd_x_m:.4f} m, y {spot.sd_y_m:.4f} m"
    add_title(figure, "Sunlight on the target", note)
    return figure


def _spot_half_width(spot: "SpotImage") -> float:
    # Not the last share: the few rays of a bad node would shrink the spot to a dot.
    return nice_ceiling(1.6 * min(spot.radius_of_share(ENERGY_SHARES[1]), float(spot.radius_m[-1])))


def encircled_energy(spots: "Mapping[str, SpotImage]") -> Figure:
    """Draw the share of the energy within a circle about the spot's centre.

    spots: Spots by name, usually the measured and the ideal mirror.
    """
    first = next(iter(spots.values()))
    share = ENERGY_SHARES[1]
    radius = first.radius_of_share(share)
    note = f"{share:.0%} within {radius:.4f} m"
    figure, axes = chart_figure("Energy within a circle", note, "radius [m]", "share of the energy")
    for (name, spot), color in zip(spots.items(), (LINE_X, LINE_Y, FAINT, INK) * len(spots), strict=False):
        axes.plot(spot.radius_m, spot.encircled_share, color=color, linewidth=1.3, label=name)
    if np.isfinite(radius):
        axes.plot([0, radius, radius], [share, share, 0], color=FAINT, linewidth=0.7, linestyle="--")
    axes.set_xlim(0, max(_spot_half_width(spot) for spot in spots.values()))
    axes.set_ylim(0, 1.02)
    add_legend(axes, loc="lower right")
    return figure
