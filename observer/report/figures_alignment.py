"""Figures of a prescription: the theoretical image of the absorber over a photo, and how far each mount is to move."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from heliogauge.reporting.canvas import DIVERGING, FAINT, INK, MISSING, WIDTH_IN, add_title, axes_in_inches, new_figure
from heliogauge.validate import FloatArray
from observer.trough.collector import Collector

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MRAD = 1e3
_TALLEST_IN = 7.0
_THEORY, _FOUND = "#f2a11f", "#20b2d6"


def theory_figure(
    image: npt.NDArray[np.uint8],
    name: str,
    edges_px: Sequence[FloatArray],
    found: tuple[FloatArray, FloatArray, FloatArray],
) -> "Figure":
    """Draw the theoretical image of the absorber over a photo (TOP).

    Shapes: image (height, width).
    edges_px (k, 2): Lines along each edge of the image in each panel [px].
    found (ny, nx): Column and row of nodes of the mirror, and by what angle the measured line of sight passes
        beside the tube [px, px, rad].
    """
    from matplotlib.lines import Line2D

    rows, columns = image.shape
    width = 2 * WIDTH_IN - 0.2
    height = width * rows / columns
    if height > _TALLEST_IN:
        width, height = _TALLEST_IN * columns / rows, _TALLEST_IN
    figure = new_figure(height + 0.95, 2 * WIDTH_IN)
    axes = axes_in_inches(figure, (2 * WIDTH_IN - width) / 2, 0.1, width, height)
    axes.imshow(image, cmap="gray", vmin=0, vmax=255, interpolation="antialiased")
    axes.contour(found[0], found[1], np.ma.masked_invalid(found[2]), levels=[0.0], colors=_FOUND, linewidths=1.1)
    for line in edges_px:
        axes.plot(line[:, 0], line[:, 1], color=_THEORY, linewidth=1.4, linestyle="--")
    axes.set_xlim(-0.5, columns - 0.5)
    axes.set_ylim(rows - 0.5, -0.5)
    axes.set(xticks=[], yticks=[])
    legend_axes = axes_in_inches(figure, 0.05, height + 0.08, 2 * WIDTH_IN - 0.1, 0.32)
    legend_axes.set_axis_off()
    legend_axes.patch.set_alpha(0.0)
    lines = [
        Line2D([], [], color=_THEORY, linestyle="--", label="edges as they would be with aligned panels"),
        Line2D([], [], color=_FOUND, label="as measured"),
    ]
    legend_axes.legend(handles=lines, loc="center left", ncols=2, fontsize=8, frameon=False, labelcolor=INK)
    add_title(figure, f"Theoretical image of the absorber in {name}", "where it is, and the mirror as designed")
    return figure


def moves_figure(
    collector: Collector, tilts_rad: FloatArray, mounts_m: FloatArray, moves: tuple[FloatArray, FloatArray]
) -> "Figure":
    """Draw each panel's mean angle to the absorber, and the move of each mount.

    tilts_rad (k,): Mean theta_ra of each panel; NaN where there is no prescription [rad].
    mounts_m (n, 2): x and y of the mounts [m].
    moves (n,): Their moves along the normal, positive towards the absorber, with standard deviations; NaN where
        none [m].
    Returns: x to the right and y up, as seen from the front.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.patches import Rectangle

    left, bottom, top, right = 0.62, 0.5, 0.62, 0.95
    x, y = collector.panel_edges_x_m, collector.panel_edges_y_m
    scale = min((2 * WIDTH_IN - left - right) / np.ptp(x), _TALLEST_IN / np.ptp(y))
    width, height = scale * float(np.ptp(x)), scale * float(np.ptp(y))
    figure = new_figure(bottom + height + top, 2 * WIDTH_IN)
    axes = axes_in_inches(figure, left, bottom, width, height)
    # Half as much again keeps the numbers readable on the strongest colours.
    limit = 1.5 * max(_MRAD * float(np.nanmax(np.abs(tilts_rad), initial=0.0)), 0.1)
    middles = (x[1:] + x[:-1]) / 2
    norm = Normalize(-limit, limit)
    mappable = ScalarMappable(norm=norm, cmap=DIVERGING)
    colors = figure.colorbar(mappable, cax=axes_in_inches(figure, left + width + 0.15, bottom, 0.14, height))
    colors.set_label("mean theta_ra [mrad], + towards +x", fontsize=8, color=INK)
    colors.ax.tick_params(labelsize=8)
    for number, tilt in enumerate(tilts_rad):
        row, column = divmod(number, len(x) - 1)
        corner, size = (x[column], y[row]), (x[column + 1] - x[column], y[row + 1] - y[row])
        color = MISSING if np.isnan(tilt) else mappable.to_rgba(_MRAD * tilt)
        axes.add_patch(Rectangle(corner, *size, facecolor=color, edgecolor=FAINT, linewidth=0.8, alpha=0.75))
        axes.text(
            corner[0] + size[0] / 2,
            corner[1] + size[1] / 2,
            f"{number + 1}",
            fontsize=9,
            color=INK,
            ha="center",
            va="center",
        )
    for (mount_x, mount_y), move in zip(mounts_m, moves[0], strict=True):
        axes.plot(mount_x, mount_y, ".", color=INK, markersize=3)
        if np.isfinite(move):
            is_left = mount_x < middles[np.argmin(np.abs(middles - mount_x))]
            axes.annotate(
                f"{1e3 * move:+.2f}",
                (mount_x, mount_y),
                xytext=(-10 if is_left else 10, 3),
                fontsize=6.5,
                color=INK,
                textcoords="offset points",
                ha="left" if is_left else "right",
            )
    axes.set_xlim(x[0], x[-1])
    axes.set_ylim(y[0], y[-1])
    axes.set_xlabel("x [m]   seen from the front", fontsize=8, color=INK, labelpad=2)
    axes.set_ylabel("y [m]", fontsize=8, color=INK, labelpad=2)
    usual = 1e3 * float(np.nanmedian(moves[1])) if np.isfinite(moves[1]).any() else float("nan")
    note = f"moves of the mounts along the normal [mm], + towards the absorber; sigma {usual:.2f} mm (median)"
    add_title(figure, "What each mount is to be moved", note)
    return figure
