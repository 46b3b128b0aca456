"""Charts of a trough at several orientations: the absorber's profiles and its sag."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliogauge.validate import FloatArray
from heliogauge.view.charts import ChartSeries, ChartView, Mark
from heliogauge.view.stills import Sheet
from observer.product.orientation_study import SpanSags

_COLORS = ("#1f6fb2", "#c4511c", "#2b8a4b", "#7a4fa3", "#8a7a1d", "#444b54")
_MM = 1e3


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """The absorber along the trough at one orientation.

    label: What the lines are called.
    orientation_rad: Turn of the collector from zenith [rad].
    y_m, x_m, z_m, sigma_x_m, sigma_z_m (n,): Stations, places and standard deviations; NaN where not measured [m].
    """

    label: str
    orientation_rad: float
    y_m: FloatArray
    x_m: FloatArray
    z_m: FloatArray
    sigma_x_m: FloatArray
    sigma_z_m: FloatArray


def profile_view(profiles: Sequence[Profile], axis: str) -> ChartView:
    """Return where the absorber runs at all orientations.

    axis: "x", or "z", which is shown from the mean of all.
    """
    mean = 0.0 if axis == "x" else float(np.nanmean(np.concatenate([one.z_m for one in profiles])))
    series = []
    for one, color in zip(profiles, np.resize(_COLORS, len(profiles)).tolist(), strict=True):
        value, sigma = (one.x_m, one.sigma_x_m) if axis == "x" else (one.z_m, one.sigma_z_m)
        band = _MM * np.nan_to_num(sigma)
        series.append(ChartSeries(one.label, one.y_m, _MM * (value - mean), color, sigma=band, size_px=1.8))
    title, words = {
        "x": ("Absorber across the trough", "from the plane of symmetry, + towards +x; bands: 1 sigma"),
        "z": (
            "Absorber along the optical axis",
            f"from {mean:.4f} m, the mean of all; + away from the mirror; bands: 1 sigma",
        ),
    }[axis]
    return ChartView(title, "y along the trough [m]", f"{axis.upper()}_a [mm]", tuple(series), words)


def sag_view(sags: Sequence[SpanSags]) -> ChartView:
    """Return the sag of each span against the orientation."""
    series = []
    for number, sag in enumerate(sags, start=1):
        for k, (value, sigma, words) in enumerate(
            ((sag.sag_x_m, sag.sigma_x_m, "across"), (sag.sag_z_m, sag.sigma_z_m, "along the optical axis"))
        ):
            color = _COLORS[(2 * number - 2 + k) % len(_COLORS)]
            turn = np.degrees(sag.orientation_rad)
            name = f"span {number}, {words}"
            series.append(ChartSeries(name, turn, _MM * value, color, Mark.POINTS, _MM * sigma, size_px=6.0))
    note = "of the middle of each span from its supports; error bars: 1 sigma"
    return ChartView("Sag of the absorber", "orientation from zenith [deg]", "sag [mm]", tuple(series), note)


def orientation_views(profiles: Sequence[Profile], sags: Sequence[SpanSags]) -> list[ChartView]:
    """Return what turning a trough does to its absorber: X_a and Z_a along the trough, sag against orientation."""
    views = [profile_view(profiles, axis) for axis in "xz"]
    return [*views, sag_view(sags)] if sags else views


def orientation_sheet(profiles: Sequence[Profile], sags: Sequence[SpanSags]) -> Sheet:
    """Draw these charts below each other as one picture."""
    parts = [view.sheet() for view in orientation_views(profiles, sags)]
    first = parts[0]
    whole = Sheet(first.width, 0.0, first.box, first.x_limits, first.y_limits)
    for part in parts:
        whole.inset(part, 0.0, whole.height)
        whole.height += part.height
    return whole
