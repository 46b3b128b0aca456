"""Figures of beams on the target: the picture with centroid, ellipse and aim point, in metres."""

from typing import TYPE_CHECKING

import numpy as np

from calibration.heliostat.beam_photos.light.beam_image import Beam
from calibration.heliostat.beam_photos.target.view import TargetImage
from heliogauge.reporting.canvas import INK, WIDTH_IN, add_legend, add_title, axes_in_inches, new_figure
from heliogauge.validate import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_METHOD_TEXTS = {
    "intensity": "centroid of the light",
    "threshold": "light above half the peak",
    "gaussian": "Gaussian",
    "super_gaussian": "super-Gaussian",
}
_MARKS = {"intensity": "+", "threshold": "1", "gaussian": "2", "super_gaussian": "3"}
_SPOT, _AIM, _OTHER = "#c8102e", "#0b6fb8", "#2c8c5a"
#: Colours from the dark end to the bright one cover these quantiles of the picture: marks do not decide.
_LOW, _HIGH = 0.01, 0.999


def beam_image_figure(
    image: TargetImage,
    beam: Beam,
    *,
    aim_m: FloatArray | None = None,
    aim_name: str = "aim point",
    title: str = "",
    methods: bool = True,
) -> "Figure":
    """Draw a beam on its target as seen from the field: x to the right, y up.

    beam: What was measured in it.
    aim_m (2,): Where the beam should have been [m].
    aim_name: What that place is called.
    title: First line above the picture.
    methods: Whether the places of the other methods are drawn.
    Returns: The picture with centroid, ellipse of twice the widths (D4 sigma), circle of 90 % of the light, aim
        point.
    """
    rows, columns = image.values_dn.shape
    edges = image.points_m([[-0.5, rows - 0.5], [columns - 0.5, -0.5]])
    (left, low), (right, high) = edges
    width = min(WIDTH_IN - 2.75, 4.0 * (right - left) / (high - low))
    height = width * (high - low) / (right - left)
    content = max(height, 2.5)
    figure = new_figure(content + 1.1)
    axes = axes_in_inches(figure, 0.65, 0.55 + content - height, width, height)
    known = image.values_dn[np.isfinite(image.values_dn)]
    darkest, brightest = np.quantile(known, (_LOW, _HIGH)) if known.size else (0.0, 1.0)
    axes.imshow(
        np.ma.masked_invalid(image.values_dn),
        cmap="gray",
        vmin=darkest,
        vmax=max(brightest, darkest + 1e-9),
        extent=(left, right, low, high),
        interpolation="nearest",
        aspect="auto",
    )
    axes.set_xlabel("x, right as seen from the field [m]", fontsize=8, color=INK, labelpad=2)
    axes.set_ylabel("y, up [m]", fontsize=8, color=INK, labelpad=2)
    if np.isfinite(beam.spot.position_m).all():
        _draw_shape(axes, beam)
        _draw_places(axes, beam, methods=methods)
    if aim_m is not None:
        axes.plot(*np.asarray(aim_m), marker="x", color=_AIM, markersize=8, linestyle="none", label=aim_name)
    axes.set_xlim(left, right)
    axes.set_ylim(low, high)
    if axes.get_legend_handles_labels()[0]:
        add_legend(axes, loc="upper left", bbox_to_anchor=(1.02, 1.0), borderaxespad=0.0)
    add_title(figure, title or "Beam on the target", beam.reason)
    size_x, size_y = figure.get_size_inches()
    texts = "\n".join(_numbers(beam, aim_m, aim_name))
    figure.text((0.75 + width) / size_x, 0.55 / size_y, texts, fontsize=7, color=INK, va="bottom", linespacing=1.35)
    return figure


def _draw_shape(axes: "Axes", beam: Beam) -> None:
    from matplotlib.patches import Circle, Ellipse

    major, minor = beam.moments.d4sigma_m
    place = (float(beam.moments.centroid_m[0]), float(beam.moments.centroid_m[1]))
    angle = float(np.degrees(beam.moments.direction_rad))
    shape = Ellipse(
        place, major, minor, angle=angle, fill=False, color=_SPOT, linewidth=1.2, label="ellipse of D4-sigma"
    )
    axes.add_patch(shape)
    ring = Circle(
        place, beam.d90_m / 2, fill=False, color=_SPOT, linewidth=0.7, linestyle=":", label="90 % of the light"
    )
    axes.add_patch(ring)


def _draw_places(axes: "Axes", beam: Beam, *, methods: bool) -> None:
    for name, estimate in beam.estimates.items():
        chosen = np.array_equal(estimate.position_m, beam.spot.position_m)
        if chosen or methods:
            axes.plot(
                *estimate.position_m,
                marker=_MARKS[name],
                color=_SPOT if chosen else _OTHER,
                linestyle="none",
                markersize=11 if chosen else 8,
                markeredgewidth=1.4 if chosen else 1.0,
                label=_METHOD_TEXTS[name],
            )


def _numbers(beam: Beam, aim_m: FloatArray | None, aim_name: str) -> list[str]:
    if not np.isfinite(beam.spot.position_m).all():
        return []
    (x, y), (sigma_x, sigma_y) = beam.spot.position_m, beam.spot.sigma_m
    major, minor = beam.moments.widths_m
    lines = [f"x {x:+.3f} ± {sigma_x:.3f} m", f"y {y:+.3f} ± {sigma_y:.3f} m"]
    if aim_m is not None:
        offset = beam.spot.position_m - np.asarray(aim_m)
        lines += [f"from {aim_name}", f"{offset[0]:+.3f} m, {offset[1]:+.3f} m"]
    lines += [f"widths (sigma) {major:.2f} m, {minor:.2f} m"]
    return [*lines, f"peak {beam.peak_dn:.0f} DN above {beam.background_dn:.0f} DN"]
