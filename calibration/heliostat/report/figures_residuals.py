"""What the pictures of a heliostat's calibration show: residuals on targets, correlations, the sky."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from calibration.heliostat.report.results import HeliostatReport, ResidualTable
from heliogauge.reporting.html import Html
from heliogauge.reporting.look import INK, LINE_X, LINE_Y, MISSING, nice_ceiling
from heliogauge.validate import BoolArray, FloatArray
from heliogauge.view.still_maps import correlation_still
from heliogauge.view.stills import WIDTH_PX, LegendEntry, Sheet, color_table

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
        return f"dots: measured places; lines lead to the predicted ones, {enlarged}; {int(self.here.sum())} beams"


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


def correlation_picture(correlation: Mapping[str, Any]) -> Html:
    """Draw the correlations of the estimated parameters, from -1 to 1.

    correlation: ``names`` and ``matrix`` of heliostat.json.
    """
    matrix = np.clip(np.array(correlation["matrix"], dtype=np.float64), -1.0, 1.0)
    names = [str(name).replace("_", " ") for name in correlation["names"]]
    note = "of the fit to all usable observations; 1 and -1: not separated"
    return correlation_still(names, matrix, "Correlation of the parameters", note)


class Sky(NamedTuple):
    """Predicted uncertainty of the beam where the sun can stand.

    azimuth_deg (nx,): From north, clockwise; ascending, in the southern hemisphere from -180 (a sun in the north would
        wrap round the ends of the axis).
    elevation_deg (ny,): Ascending.
    sigma_mrad (ny, nx): NaN where the sun never stands.
    extrapolated (ny, nx): Where the model is extrapolated.
    suns_deg (n, 2): Azimuth and elevation of the suns of the observations that were used.
    high_mrad: Where colours end.
    note: What the uncertainty is of.
    """

    azimuth_deg: FloatArray
    elevation_deg: FloatArray
    sigma_mrad: FloatArray
    extrapolated: BoolArray
    suns_deg: FloatArray
    high_mrad: float
    note: str

    @property
    def halves_deg(self) -> tuple[float, float]:
        """Half the size of a cell along azimuth and elevation."""
        return 0.5 * float(np.diff(self.azimuth_deg).min()), 0.5 * float(np.diff(self.elevation_deg).min())


def sky_of(report: HeliostatReport) -> Sky:
    """Return the sky map of one heliostat."""
    sky, rows = report.content["sky"], report.residuals
    azimuth, elevation = np.array(sky["azimuth_deg"], float), np.array(sky["elevation_deg"], float)
    sigma = np.array([[np.nan if one is None else one for one in row] for row in sky["sigma_beam_mrad"]], dtype=float)
    beyond = np.array([[bool(one) for one in row] for row in sky["extrapolated"]])
    turn = 180.0 if report.content["site"]["latitude_deg"] < 0 else 0.0

    def turned(values: FloatArray) -> FloatArray:
        return np.asarray((values + turn) % 360.0 - turn)

    order = np.argsort(turned(azimuth))
    azimuth, sigma, beyond = turned(azimuth)[order], sigma[:, order], beyond[:, order]
    known = sigma[np.isfinite(sigma)]
    high = nice_ceiling(min(float(known.max()), _SKY_RANGE * float(known.min()))) if known.size else 1.0
    # All azimuths between the first and the last one of the sun, at equal steps.
    seen = np.flatnonzero(np.isfinite(sigma).any(axis=0)) if known.size else np.arange(azimuth.size)
    shown = slice(int(seen[0]), int(seen[-1]) + 1)
    suns = turned(rows.numbers["sun_azimuth_deg"][rows.used]), rows.numbers["sun_elevation_deg"][rows.used]
    note = f"1 sigma of the beam aimed at {str(sky['target']).replace('_', ' ')}"
    return Sky(azimuth[shown], elevation, sigma[:, shown], beyond[:, shown], np.stack(suns, axis=1), high, note)


def sky_sheet(report: HeliostatReport) -> Sheet:
    """Draw the predicted uncertainty of the beam for each place where the sun can stand.

    report: Results of one heliostat, with a sky map.
    Returns: Azimuth and elevation of the sun; dots where it was measured, hatched where the model is extrapolated.
    """
    azimuth, elevation, sigma, beyond, suns, high, note = sky = sky_of(report)
    half_a, half_e = sky.halves_deg
    x_limits = float(azimuth[0] - half_a), float(azimuth[-1] + half_a)
    y_limits = float(elevation[0] - half_e), float(elevation[-1] + half_e)
    sheet = Sheet(WIDTH_PX, 380.0, (64.0, 50.0, WIDTH_PX - 92, 322.0), x_limits, y_limits)
    sheet.title("Predicted uncertainty over the sky", f"{note}; hatched: extrapolated")
    left, top, right, bottom = sheet.box
    sheet.add(f'<path d="M{left},{top}H{right}V{bottom}H{left}Z" fill="{MISSING}"/>')
    index = np.clip(np.nan_to_num(sigma / high) * 255 + 0.5, 0, 255).astype(np.uint8)
    cells = np.dstack([color_table(diverging=False)[index], np.where(np.isfinite(sigma), 255, 0).astype(np.uint8)])
    sheet.cells(cells[::-1], (*x_limits, *y_limits))
    sheet.hatch(beyond & np.isfinite(sigma))
    sheet.dots(suns[:, 0], suns[:, 1], [INK], size_px=5.0)
    sheet.dots(suns[:, 0], suns[:, 1], ["#ffffff"], size_px=3.6)
    eighths = np.arange(-180.0, 361.0, 45.0)
    inside = eighths[(eighths >= x_limits[0]) & (eighths <= x_limits[1])].tolist()
    ticks = [(one, f"{one % 360:g}") for one in inside]
    sheet.axes("azimuth of the sun from north, clockwise [deg]", "elevation [deg]", grid=False, x_ticks=ticks)
    sheet.color_bar(0.0, high, "mrad", diverging=False)
    sheet.legend([LegendEntry(f"measured ({len(suns)})", INK, "dot")])
    return sheet


def groups(rows: ResidualTable, among: BoolArray) -> list[tuple[BoolArray, str, str]]:
    """Return fitted and predicted rows with colour and words for the legend."""
    fitted, predicted = among & rows.used & ~rows.is_test, among & rows.used & rows.is_test
    words = f"fitted ({int(fitted.sum())})", f"predicted ({int(predicted.sum())})"
    return [one for one in ((fitted, _TRAIN, words[0]), (predicted, _TEST, words[1])) if one[0].any()]


def _missing(values: npt.NDArray[Any]) -> BoolArray:
    return np.asarray(np.isnat(values) if np.issubdtype(values.dtype, np.datetime64) else np.isnan(values))


def _round_down(value: float) -> float:
    """Return 1, 2 or 5 times a power of ten, at most the value."""
    power = 10.0 ** np.floor(np.log10(max(value, 1e-9)))
    steps: Sequence[float] = (5.0, 2.0, 1.0)
    return float(next((step * power for step in steps if step * power <= value), power))


def robust_end(values: FloatArray) -> float:
    """Return where a scale ends: at 95 % of the values, but not beyond four times their median."""
    if not values.size:
        return 1.0
    middle, high = np.percentile(values, [50, 95])
    return nice_ceiling(float(min(high, 4 * middle)))
