"""Why nodes of a mirror have no value, as a map with a legend."""

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
    add_title,
    axes_in_inches,
    cover_outside,
    extent_of,
    mirror_axes,
    thinned,
)
from heliogauge.slopes.map import SlopeMap

# Qualitative colours that differ in lightness too; the first flag in the list wins where a node has several.
_FLAG_COLORS = ("#d94f30", "#f0a23c", "#7b5ea7", "#2f8f83", "#b2336e", "#4d7ebf", "#8a6d3b", "#5b8c2a", "#111111")


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
