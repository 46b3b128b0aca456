"""Readings that put the beam of a calibrated heliostat on a point, and back: where the beam of given readings goes."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from calibration.heliostat.exports.forecast import SkyForecast
from calibration.heliostat.kinematic_model.aiming import aim
from calibration.heliostat.kinematic_model.design import HeliostatDesign, PlaneTarget
from calibration.heliostat.kinematic_model.kinematics import mirror_poses
from calibration.heliostat.kinematic_model.store_design import design_from
from heliogauge.errors import InputError
from heliogauge.geometry.rays import intersect_plane, reflect
from heliogauge.geometry.sun import angles_from_direction
from heliogauge.validate import BoolArray, FloatArray

#: What can be said of a row.
GOOD, EXTRAPOLATED, OUTSIDE, NEVER, AWAY, BESIDE, MISSING = (
    "good",
    "extrapolated",
    "outside the range of the drives",
    "no position does it",
    "away from the target",
    "beside the target",
    "no readings",
)


class Calibrated(NamedTuple):
    """A calibrated heliostat as its results on disk have it.

    forecast: Uncertainty over the sky; None where there is none.
    """

    design: HeliostatDesign
    targets: dict[str, PlaneTarget]
    forecast: SkyForecast | None

    @classmethod
    def from_content(cls, content: Mapping[str, Any]) -> "Calibrated":
        """Take it from the content of ``heliostat.json``."""
        targets = {
            name: PlaneTarget(
                name,
                np.array(one["center_m"]),
                np.array(one["right"]),
                np.array(one["up"]),
                one["width_m"],
                one["height_m"],
            )
            for name, one in content["targets"].items()
        }
        sky = content.get("sky")
        design = design_from(content["design"], content["parameters"], key="value")
        return cls(design, targets, None if sky is None else SkyForecast.from_content(sky))

    def target(self, name: str | None) -> PlaneTarget:
        """Return the target of a name, the first one without.

        InputError: There is none.
        """
        if name is None and self.targets:
            return next(iter(self.targets.values()))
        if name not in self.targets:
            known = ", ".join(self.targets) or "none"
            raise InputError(f"target={name}: no such target; there are {known}")
        return self.targets[name]

    def sigma(self, suns: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return the sigma of the beam [rad], NaN where nothing is known of it, and whether it is extrapolated."""
        if self.forecast is None:
            return np.full(len(suns), np.nan), np.zeros(len(suns), dtype=np.bool_)
        return self.forecast.at(suns)


def aim_columns(
    known: Calibrated, suns: FloatArray, target: PlaneTarget, offsets_m: FloatArray | None = None
) -> dict[str, Any]:
    """Return the readings that put the beam on the centre of a target, or beside it.

    Shapes: suns (n, 3).
    offsets_m (n, 2): Of the aim from the centre, right and up [m].
    Returns: Columns of the table, n rows each; readings are empty where the drives cannot go there.
    """
    aims = target.center_m if offsets_m is None else target.points(offsets_m)
    found = aim(known.design, known.design.parameters.values, suns, aims)
    sigma_rad, beyond = known.sigma(suns)
    status = _status(len(suns), {NEVER: ~found.converged, OUTSIDE: ~found.within_limits, EXTRAPOLATED: beyond})
    there = found.converged & found.within_limits
    return {
        "heliostat": [known.design.name] * len(suns),
        "target": [target.name] * len(suns),
        **_sun_columns(suns),
        "reading_1": _cells(np.where(there, found.readings[:, 0], np.nan)),
        "reading_2": _cells(np.where(there, found.readings[:, 1], np.nan)),
        "reading_unit": [known.design.reading_unit] * len(suns),
        "sigma_beam_mrad": _cells(np.where(there, 1e3 * sigma_rad, np.nan).round(4)),
        "status": status,
    }


def beam_columns(known: Calibrated, readings: FloatArray, suns: FloatArray, target: PlaneTarget) -> dict[str, Any]:
    """Return where the beams of given readings meet the plane of a target.

    Shapes: readings (n, 2), suns (n, 3).
    Returns: Columns of the table, n rows each: place on the target as seen from the field (x right, y up, from its
        centre), its distance from the centre as an angle at the mirror, sigmas.
    """
    design = known.design
    given = np.asarray(np.isfinite(readings).all(axis=1))
    somewhere = np.where(given[:, None], readings, design.limits.mean(axis=1))
    poses = mirror_poses(design, design.parameters.values, somewhere, outside="nan")
    beams = reflect(-suns, poses.normals(design))
    travel = intersect_plane(poses.centre_m, beams, target.center_m, target.normal)
    there = np.asarray(given & np.isfinite(travel) & (travel > 0))
    places = target.coordinates(poses.centre_m + np.where(there, travel, np.nan)[:, None] * beams)
    wanted = target.center_m - poses.centre_m
    wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
    off_rad = 2 * np.arcsin(np.minimum(np.linalg.norm(beams - wanted, axis=1) / 2, 1.0))
    off_rad = np.where(given, off_rad, np.nan)
    inside = np.asarray(((readings >= design.limits[:, 0]) & (readings <= design.limits[:, 1])).all(axis=1))
    sigma_rad, beyond = known.sigma(suns)
    sigma_rad = np.where(given, sigma_rad, np.nan)
    on_target = np.asarray((np.abs(places) <= [target.width_m / 2, target.height_m / 2]).all(axis=1))
    verdicts = {MISSING: ~given, NEVER: np.isnan(travel), AWAY: ~there, OUTSIDE: ~inside, BESIDE: ~on_target}
    status = _status(len(suns), verdicts | {EXTRAPOLATED: beyond})
    return {
        "heliostat": [design.name] * len(suns),
        "target": [target.name] * len(suns),
        **_sun_columns(suns),
        "reading_1": _cells(readings[:, 0]),
        "reading_2": _cells(readings[:, 1]),
        "x_m": _cells(places[:, 0].round(5)),
        "y_m": _cells(places[:, 1].round(5)),
        # The beam's sigma is the root of both axes' variances; across the line of sight each has half of it.
        "sigma_across_m": _cells((np.where(there, travel, np.nan) * sigma_rad / np.sqrt(2)).round(5)),
        "off_centre_mrad": _cells((1e3 * off_rad).round(5)),
        "sigma_beam_mrad": _cells((1e3 * sigma_rad).round(4)),
        "status": status,
    }


def _status(count: int, verdicts: Mapping[str, BoolArray]) -> list[str]:
    """Return the first verdict that is true of each row."""
    return [next((name for name, rows in verdicts.items() if rows[row]), GOOD) for row in range(count)]


def _sun_columns(suns: FloatArray) -> dict[str, Any]:
    azimuth, elevation = angles_from_direction(suns)
    return {
        "sun_azimuth_deg": np.rad2deg(azimuth).round(5).tolist(),
        "sun_elevation_deg": np.rad2deg(elevation).round(5).tolist(),
    }


def _cells(values: FloatArray) -> list[Any]:
    return ["" if not np.isfinite(value) else value for value in values.tolist()]
