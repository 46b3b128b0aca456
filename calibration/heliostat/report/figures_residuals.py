"""Figures of a heliostat's calibration: residuals on the target and against time and sun, correlations, the sky."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from calibration.heliostat.report.results import HeliostatReport, ResidualTable
from heliogauge.reporting.canvas import (
    DIVERGING,
    FAINT,
    INK,
    LINE_X,
    LINE_Y,
    MISSING,
    SEQUENTIAL,
    WIDTH_IN,
    MapStyle,
    add_color_bar,
    add_legend,
    add_title,
    axes_in_inches,
    new_figure,
    nice_ceiling,
)
from heliogauge.validate import BoolArray, FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Median arrow of a residual is drawn this share of the target's width long.
_ARROW_SHARE = 0.06
#: At least this share of a target is shown, however close together the beams are.
_LEAST_REACH = 0.25
#: Share by which arrows may widen the picture.
_MOST_ROOM = 1.5
_TRAIN, _TEST = LINE_X, LINE_Y
#: Colours of a map of uncertainty end at this multiple of its least value or at its largest, whichever is smaller.
_SKY_RANGE = 8.0


def targets_hit(report: HeliostatReport) -> tuple[str, ...]:
    """Return the targets on which a beam's residual can be drawn, in order of their names."""
    rows = report.residuals
    drawn = np.isfinite(rows.numbers["measured_x_m"]) & np.isfinite(rows.numbers["predicted_x_m"])
    known = report.content.get("targets", {})
    return tuple(sorted({name for name, shown in zip(rows.target, drawn, strict=True) if shown and name in known}))


class TargetArrows(NamedTuple):
    """Arrows on a target from measured to predicted places.

    here (n,): Rows of residuals.csv that are on the target.
    dx, dy (n,): Predicted minus measured [m].
    factor: By how much arrows are longer than that.
    reach: What is shown as a share of the target.
    """

    here: BoolArray
    dx: FloatArray
    dy: FloatArray
    factor: float
    reach: float

    @property
    def note(self) -> str:
        """What the arrows are, in words."""
        enlarged = "true to scale" if self.factor == 1 else f"{self.factor:g} times their length"
        return f"arrows from measured to predicted places, {enlarged}; {int(self.here.sum())} beams"


def target_arrows(report: HeliostatReport, name: str) -> TargetArrows:
    """Return the arrows on a target and how much they are enlarged."""
    rows, target = report.residuals, report.content["targets"][name]
    x, y = rows.numbers["measured_x_m"], rows.numbers["measured_y_m"]
    dx, dy = rows.numbers["predicted_x_m"] - x, rows.numbers["predicted_y_m"] - y
    here = np.array([one == name for one in rows.target]) & np.isfinite(dx) & np.isfinite(x)
    half_x, half_y = 0.5 * float(target["width_m"]), 0.5 * float(target["height_m"])
    ends = [np.abs(one[here]) / half for one, half in ((x, half_x), (x + dx, half_x), (y, half_y), (y + dy, half_y))]
    reach = max(_LEAST_REACH, 1.1 * float(np.max(ends))) if here.any() else 1.0
    length = np.hypot(dx, dy)[here & rows.used]
    typical = float(np.median(length)) if length.size and np.median(length) > 0 else 1.0
    factor = max(1.0, _round_down(2 * _ARROW_SHARE * reach * half_x / typical))
    used = here & rows.used
    tips = [np.abs(one[used]) / half for one, half in ((x + factor * dx, half_x), (y + factor * dy, half_y))]
    # Room for the tips, but not for those of blunders: they would make all others small.
    room = min(1.05 * float(np.max(tips)), _MOST_ROOM * reach) if used.any() else reach
    return TargetArrows(here, dx, dy, factor, max(reach, room))


def target_figure(report: HeliostatReport, name: str) -> "Figure":
    """Draw each beam's place on a target and, enlarged, by how much the model misses it.

    report: Results of one heliostat.
    Returns: The target as seen from the field; arrows from the measured to the predicted place.
    """
    rows, target = report.residuals, report.content["targets"][name]
    x, y = rows.numbers["measured_x_m"], rows.numbers["measured_y_m"]
    half_x, half_y = 0.5 * float(target["width_m"]), 0.5 * float(target["height_m"])
    arrows = target_arrows(report, name)
    here, dx, dy, factor, reach = arrows
    width = WIDTH_IN - 1.0
    height = min(width * half_y / half_x, 4.6)
    figure = new_figure(height + 1.55)
    axes = axes_in_inches(figure, 0.62, 0.92, width, height)
    for group, color, label in groups(rows, here):
        axes.quiver(
            x[group],
            y[group],
            factor * dx[group],
            factor * dy[group],
            color=color,
            angles="xy",
            scale_units="xy",
            scale=1.0,
            width=0.0028,
            label=label,
        )
        axes.plot(x[group], y[group], ".", color=color, markersize=2.5)
    left_out = here & ~rows.used
    axes.plot(x[left_out], y[left_out], "x", color=FAINT, markersize=5, label=f"left out ({int(left_out.sum())})")
    axes.set_xlim(-reach * half_x, reach * half_x)
    axes.set_ylim(-reach * half_y, reach * half_y)
    axes.add_patch(_frame(half_x, half_y))
    _label(axes, "x, to the right as seen from the field [m]", "y, up [m]")
    add_legend(axes, loc="upper center", bbox_to_anchor=(0.5, -0.48 / height), ncols=3)
    add_title(figure, f"Residuals on {name.replace('_', ' ')}", arrows.note)
    return figure


def series_figures(report: HeliostatReport) -> "dict[str, Figure]":
    """Draw residuals to the right and up against time, the sun's azimuth and its elevation.

    report: Results of one heliostat.
    Returns: Keys "time", "azimuth", "elevation"; without times only the latter two, without suns too only "row".
    """
    rows = report.residuals
    return {name: _series(rows, *one) for name, one in residual_axes(rows).items()}


def residual_axes(rows: ResidualTable) -> dict[str, tuple[str, str, npt.NDArray[Any]]]:
    """Return what residuals are shown against: words, label of the axis, and values, as far as they are known."""
    against: dict[str, tuple[str, str, npt.NDArray[Any]]] = {
        "time": ("time", "time (UTC)", rows.time),
        "azimuth": (
            "the sun's azimuth",
            "azimuth of the sun from north, clockwise [deg]",
            rows.numbers["sun_azimuth_deg"],
        ),
        "elevation": (
            "the sun's elevation",
            "apparent elevation of the sun [deg]",
            rows.numbers["sun_elevation_deg"],
        ),
    }
    known = {name: one for name, one in against.items() if (~_missing(one[2]) & rows.used).any()}
    # Drones, normals and points of the mirror need neither time nor sun.
    return known or {"row": ("their order", "row of residuals.csv", np.arange(1.0, rows.used.size + 1))}


def _series(rows: ResidualTable, title: str, label: str, values: npt.NDArray[Any]) -> "Figure":
    figure = new_figure(4.4)
    upper, lower = (axes_in_inches(figure, 0.72, bottom, WIDTH_IN - 0.95, 1.45) for bottom in (2.25, 0.6))
    names = ("residual_right_mrad", "residual_up_mrad")
    shown = rows.used & ~_missing(values)
    sizes = np.abs(np.concatenate([rows.numbers[name][shown] for name in names]))
    limit = nice_ceiling(1.02 * float(sizes.max())) if sizes.size else 1.0
    for axes, name, word in zip((upper, lower), names, ("to the right", "up"), strict=True):
        for group, color, text in groups(rows, shown):
            axes.plot(values[group], rows.numbers[name][group], ".", color=color, markersize=3.5, label=text)
        axes.axhline(0.0, color=FAINT, linewidth=0.6)
        axes.set_ylim(-limit, limit)
        axes.grid(visible=True, color="#e4e7ea", linewidth=0.6)
        _label(axes, "", f"{word} [mrad]")
    upper.tick_params(labelbottom=False)
    lower.set_xlabel(label, fontsize=8.5, color=INK)
    if np.issubdtype(values.dtype, np.datetime64):
        from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

        locator = AutoDateLocator(maxticks=6)  # type: ignore[no-untyped-call]
        for axes in (upper, lower):
            axes.xaxis.set_major_locator(locator)
            axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    add_legend(upper, loc="upper right", ncols=2)
    add_title(figure, f"Residuals of the beam against {title}", "measured minus predicted, as seen from the mirror")
    return figure


def correlation_figure(correlation: Mapping[str, Any]) -> "Figure":
    """Draw the correlations of the estimated parameters.

    correlation: ``names`` and ``matrix`` of heliostat.json.
    Returns: The matrix, from -1 to 1.
    """
    names, matrix = correlation["names"], np.clip(np.array(correlation["matrix"], dtype=np.float64), -1.0, 1.0)
    size = min(0.32 * len(names) + 0.6, WIDTH_IN - 2.3)
    figure = new_figure(size + 1.75)
    box = (1.35, 1.05, size, size)
    axes = axes_in_inches(figure, *box)
    image = axes.imshow(matrix, cmap=DIVERGING, vmin=-1.0, vmax=1.0)
    labels = [str(name).replace("_", " ") for name in names]
    axes.set_xticks(range(len(names)), labels, rotation=90, fontsize=7)
    axes.set_yticks(range(len(names)), labels, fontsize=7)
    add_color_bar(figure, image, box, MapStyle("", ""), matrix)
    add_title(figure, "Correlation of the parameters", "of the fit to all usable observations; 1 and -1: not separated")
    return figure


def sky_figure(report: HeliostatReport) -> "Figure":
    """Draw the predicted uncertainty of the beam for each place where the sun can stand.

    report: Results of one heliostat, with a sky map.
    Returns: Azimuth and elevation of the sun; dots where it was measured, hatched where the model is extrapolated.
    """
    sky, rows = report.content["sky"], report.residuals
    azimuth, elevation = np.array(sky["azimuth_deg"], float), np.array(sky["elevation_deg"], float)
    sigma = np.array([[np.nan if one is None else one for one in row] for row in sky["sigma_beam_mrad"]], dtype=float)
    beyond = np.array([[bool(one) for one in row] for row in sky["extrapolated"]])
    # A sun in the north wraps round the ends of the axis; in the southern hemisphere the year's suns are centred there.
    turn = 180.0 if report.content["site"]["latitude_deg"] < 0 else 0.0
    shifted = (azimuth + turn) % 360.0
    order = np.argsort(shifted)
    shifted, sigma, beyond = shifted[order], sigma[:, order], beyond[:, order]
    figure = new_figure(3.75)
    box = (0.62, 0.95, WIDTH_IN - 1.45, 1.95)
    axes = axes_in_inches(figure, *box)
    known = sigma[np.isfinite(sigma)]
    high = nice_ceiling(min(float(known.max()), _SKY_RANGE * float(known.min()))) if known.size else 1.0
    axes.set_facecolor(MISSING)
    step_a, step_e = float(np.diff(shifted).min()), float(np.diff(elevation).min())
    edges = _edges(shifted, step_a), _edges(elevation, step_e)
    image = axes.pcolormesh(*edges, sigma, cmap=SEQUENTIAL, vmin=0.0, vmax=high)
    axes.pcolor(*edges, np.ma.masked_where(~(beyond & np.isfinite(sigma)), sigma), hatch="////", alpha=0.0)
    used = rows.used
    suns = (rows.numbers["sun_azimuth_deg"][used] + turn) % 360.0
    axes.plot(
        suns,
        rows.numbers["sun_elevation_deg"][used],
        ".",
        color="white",
        markeredgecolor=INK,
        markeredgewidth=0.3,
        markersize=4,
        label=f"measured ({int(used.sum())})",
    )
    ticks = np.arange(45.0, 360.0, 45.0)
    axes.set_xticks(ticks, [f"{(one - turn) % 360:g}" for one in ticks])
    if np.isfinite(sigma).any():
        seen = np.isfinite(sigma).any(axis=0)
        axes.set_xlim(edges[0][:-1][seen][0], edges[0][1:][seen][-1])
    _label(axes, "azimuth of the sun from north, clockwise [deg]", "elevation [deg]")
    add_legend(axes, loc="upper center", bbox_to_anchor=(0.5, -0.25))
    style = MapStyle("", "mrad")
    add_color_bar(figure, image, box, style, sigma)
    note = f"1 sigma of the beam aimed at {str(sky['target']).replace('_', ' ')}; hatched: extrapolated"
    add_title(figure, "Predicted uncertainty over the sky", note)
    return figure


def groups(rows: ResidualTable, among: BoolArray) -> list[tuple[BoolArray, str, str]]:
    """Return fitted and predicted rows with colour and words for the legend."""
    fitted, predicted = among & rows.used & ~rows.is_test, among & rows.used & rows.is_test
    words = f"fitted ({int(fitted.sum())})", f"predicted ({int(predicted.sum())})"
    return [one for one in ((fitted, _TRAIN, words[0]), (predicted, _TEST, words[1])) if one[0].any()]


def _missing(values: npt.NDArray[Any]) -> BoolArray:
    return np.asarray(np.isnat(values) if np.issubdtype(values.dtype, np.datetime64) else np.isnan(values))


def _edges(centers: FloatArray, step: float) -> FloatArray:
    return np.append(centers - 0.5 * step, centers[-1] + 0.5 * step)


def _round_down(value: float) -> float:
    """Return 1, 2 or 5 times a power of ten, at most the value."""
    power = 10.0 ** np.floor(np.log10(max(value, 1e-9)))
    steps: Sequence[float] = (5.0, 2.0, 1.0)
    return float(next((step * power for step in steps if step * power <= value), power))


def _frame(half_x: float, half_y: float) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((-half_x, -half_y), 2 * half_x, 2 * half_y, fill=False, edgecolor=INK, linewidth=0.9)


def _label(axes: "Axes", x: str, y: str) -> None:
    axes.set_xlabel(x, fontsize=8.5, color=INK)
    axes.set_ylabel(y, fontsize=8.5, color=INK)
    axes.tick_params(labelsize=8, colors=INK)


def field_map_figure(east_m: FloatArray, north_m: FloatArray, beam_mrad: FloatArray) -> "Figure":
    """Draw a field with the error of each heliostat's beam.

    Shapes: east_m, north_m (n,).
    beam_mrad (n,): RMS of the beam on test positions [mrad]; NaN for a heliostat without a model.
    Returns: The field from above, north up.
    """
    figure = new_figure(4.6)
    box = (0.72, 0.62, WIDTH_IN - 1.6, 3.2)
    axes = axes_in_inches(figure, *box)
    known = np.isfinite(beam_mrad)
    high = robust_end(beam_mrad[known])
    size = float(np.clip(4000 / max(len(east_m), 1), 4, 60))
    axes.plot(east_m[~known], north_m[~known], "x", color=LINE_Y, markersize=5, label="no model")
    image = axes.scatter(
        east_m[known],
        north_m[known],
        c=beam_mrad[known],
        s=size,
        cmap=SEQUENTIAL,
        vmin=0.0,
        vmax=high,
        edgecolors=INK,
        linewidths=0.2,
    )
    axes.plot([0.0], [0.0], "s", color=INK, markersize=6)
    axes.annotate("origin", (0.0, 0.0), textcoords="offset points", xytext=(6, -3), fontsize=7.5, color=INK)
    axes.set_aspect("equal", adjustable="datalim")
    _label(axes, "east [m]", "north [m]")
    if (~known).any():
        add_legend(axes, loc="upper right")
    add_color_bar(figure, image, box, MapStyle("", "mrad"), beam_mrad[known])
    beyond = int((beam_mrad[known] > high).sum())
    note = "RMS on positions that were not fitted" + (f"; {beyond} beyond the colours" if beyond else "")
    add_title(figure, "Beam error of each heliostat", note)
    return figure


def robust_end(values: FloatArray) -> float:
    """Return where a scale ends: at 95 % of the values, but not beyond four times their median."""
    if not values.size:
        return 1.0
    middle, high = np.percentile(values, [50, 95])
    return nice_ceiling(float(min(high, 4 * middle)))
