"""Calibration campaigns of true heliostats: sun days, aims, drive readings, wind, and what is measured of the beams."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from calibration.heliostat.kinematic_model import PlaneTarget
from data_synth.heliostats.mechanics import Poses, TrueHeliostat, rotation_about
from heliogauge.errors import InputError
from heliogauge.geometry.sun import Site, sun_directions
from heliogauge.validate import FloatArray, IntArray, TimeArray

#: RTK-GPS at rest of Gouws (2018), table 3.1, in the order east, north, up [m].
RTK_SIGMA_M = (5.602e-3, 5.781e-3, 8.866e-3)
_MINUTES = 10


@dataclass(frozen=True, slots=True, eq=False)
class Plant:
    """Where heliostats stand and what they are aimed at.

    site: Latitude, longitude, altitude, air.
    targets: Calibration targets.
    """

    site: Site
    targets: tuple[PlaneTarget, ...]


@dataclass(frozen=True, slots=True)
class Schedule:
    """When beams are looked at.

    days: Dates (ISO), in the order in which they come.
    per_day: Observations of each heliostat on each day.
    lowest_sun_rad: No observations with a lower sun [rad].
    whole_day: Spread them evenly over the day instead of drawing their times.
    """

    days: tuple[str, ...]
    per_day: int
    lowest_sun_rad: float = np.radians(10.0)
    whole_day: bool = False

    def at(self, site: Site) -> "Campaign":
        """Return the schedule with the hours at which the sun is up at a place.

        InputError: The sun does not rise high enough on a day.
        """
        minutes = np.arange(-12 * 60, 12 * 60, _MINUTES)
        noons, hours = [], []
        for day in self.days:
            # The longitude's noon in the middle: no day is cut by midnight of UTC.
            noon = np.datetime64(day, "ms") + np.timedelta64(round((12 - site.longitude_deg / 15) * 3600e3), "ms")
            around = noon + (minutes * 60_000).astype("timedelta64[ms]")
            up = np.flatnonzero(sun_directions(around, site)[:, 2] > np.sin(self.lowest_sun_rad))
            if up.size < 2:
                raise InputError(f"{day}: the sun does not rise {np.degrees(self.lowest_sun_rad):.3g} deg high there")
            noons.append(noon)
            hours.append((float(minutes[up[0]]), float(minutes[up[-1]])))
        return Campaign(self, np.array(noons), np.array(hours))


@dataclass(frozen=True, slots=True, eq=False)
class Campaign:
    """A schedule and the hours of its days.

    schedule: Days and number of observations.
    noon (d,): Noon of each day (UTC).
    hours_min (d, 2): First and last minute from noon at which the sun is high enough.
    """

    schedule: Schedule
    noon: TimeArray
    hours_min: FloatArray

    def times(self, rng: np.random.Generator) -> TimeArray:
        """Draw the times of one heliostat, ascending (evenly over each day if so scheduled), shape (n,) (UTC)."""
        chosen = []
        for noon, (first, last) in zip(self.noon, self.hours_min.tolist(), strict=True):
            if self.schedule.whole_day:
                when = np.linspace(first, last, self.schedule.per_day)
            else:
                when = np.sort(rng.uniform(first, last, self.schedule.per_day))
            chosen.append(noon + _milliseconds(60 * when))
        return np.concatenate(chosen)


@dataclass(frozen=True, slots=True)
class Disturbances:
    """What stands between a perfect beam and the number in the table; one standard deviation each, 0 leaves it out.

    spot_m: Of the measured spot, right and up on the target [m].
    wind_rad: Of the normal, about each of the mirror's axes, anew at each observation [rad].
    aim_m: Of the aim point about the target's centre, along each direction [m].
    hold_s: The drives are set for the sun at most this long ago [s].
    clock_s: Of the time that is noted down, anew at each observation [s].
    count: Readings are whole multiples of this; 0 leaves them as they are [readings].
    logged: The log rounds readings to whole multiples of this [readings].
    outliers: Share of observations whose spot is wrong by `outlier_m`.
    outlier_m: Of such an error, along each direction [m].
    rtk_m: Of a drone's position: east, north, up [m].
    stated: Sigmas are stated this many times as large as they are.
    """

    spot_m: tuple[float, float] = (0.02, 0.02)
    wind_rad: float = 0.0
    aim_m: float = 0.4
    hold_s: float = 0.0
    clock_s: float = 0.0
    count: tuple[float, float] = (0.0, 0.0)
    logged: tuple[float, float] = (0.0, 0.0)
    outliers: float = 0.0
    outlier_m: float = 0.5
    rtk_m: tuple[float, float, float] = RTK_SIGMA_M
    stated: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """How a heliostat's numbers change with time.

    jumps: Added to these values from `date` on.
    date: When (ISO).
    per_year: Added to these values in a year, from the first observation on.
    """

    jumps: Mapping[str, float] = field(default_factory=dict)
    date: str = ""
    per_year: Mapping[str, float] = field(default_factory=dict)

    @property
    def none(self) -> bool:
        """Whether nothing changes."""
        return not self.jumps and not self.per_year

    def at(self, heliostat: TrueHeliostat, times: TimeArray) -> list[TrueHeliostat]:
        """Return the heliostat as it is at each of the times, shape (n,)."""
        years = (times - times[0]) / np.timedelta64(1, "s") / (365.25 * 86400)
        later = times >= np.datetime64(self.date, "ms") if self.jumps else np.zeros(len(times), dtype=bool)
        states = []
        for year, is_later in zip(years.tolist(), later.tolist(), strict=True):
            change = {name: rate * year for name, rate in self.per_year.items()}
            for name, jump in self.jumps.items():
                change[name] = change.get(name, 0.0) + jump * is_later
            states.append(heliostat.with_values({name: heliostat.values[name] + v for name, v in change.items()}))
        return states


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """Beams of one heliostat that were looked at.

    times (n,): When each was really looked at (UTC).
    noted (n,): What the clock said.
    sun (n, 3): True unit vectors to the sun.
    target (n,): Index of the target.
    readings, logged (n, 2): Readings of the drives, as they were and as noted down.
    approach (n, 2): Direction of each drive's last move.
    poses: True poses of the mirror.
    spot_m, measured_m (n, 2): Where the beam's middle ray met the target, and what was measured: right, up from the
        centre [m].
    sigma_m (n, 2): Stated sigmas [m].
    outlier (n,): Measured spots that are wrong.
    """

    times: TimeArray
    noted: TimeArray
    sun: FloatArray
    target: IntArray
    readings: FloatArray
    logged: FloatArray
    approach: FloatArray
    poses: Poses
    spot_m: FloatArray
    measured_m: FloatArray
    sigma_m: FloatArray
    outlier: npt.NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.times)

    def rows(self, targets: tuple[PlaneTarget, ...], unit: str) -> dict[str, list[Any]]:
        """Return the table of observations without the heliostat's name.

        Returns: Columns as `observations.csv` has them.
        """
        digits = 1 if unit == "counts" else 9
        return {
            "time_utc": [f"{text}Z" for text in np.datetime_as_string(self.noted, unit="ms")],
            f"axis_1_{unit}": [round(value, digits) for value in self.logged[:, 0].tolist()],
            f"axis_2_{unit}": [round(value, digits) for value in self.logged[:, 1].tolist()],
            "approach_1": self.approach[:, 0].astype(int).tolist(),
            "approach_2": self.approach[:, 1].astype(int).tolist(),
            "target": [targets[index].name for index in self.target.tolist()],
            "x_m": [round(value, 5) for value in self.measured_m[:, 0].tolist()],
            "y_m": [round(value, 5) for value in self.measured_m[:, 1].tolist()],
            "sigma_x_mm": [round(1e3 * value, 4) for value in self.sigma_m[:, 0].tolist()],
            "sigma_y_mm": [round(1e3 * value, 4) for value in self.sigma_m[:, 1].tolist()],
        }


def observe(
    heliostat: TrueHeliostat,
    plant: Plant,
    campaign: Campaign,
    disturbances: Disturbances,
    rng: np.random.Generator,
    *,
    changes: Changes | None = None,
) -> Beams:
    """Aim a heliostat at the targets over a campaign and measure its beams.

    disturbances: What goes wrong.
    Returns: One entry for each observation; sun positions that the heliostat cannot serve are left out.
    InputError: It cannot serve any of them.

    The readings are those that put the beam on the target, as an operator does who sees it there: solved with the
    true numbers, rounded to whole counts, and then everything acts on them. Play is not foreseen.
    """
    times = campaign.times(rng)
    target = rng.integers(0, len(plant.targets), len(times))
    held = rng.uniform(0, 1, len(times)) * disturbances.hold_s
    set_for = sun_directions(times - _milliseconds(held), plant.site)
    aims = np.stack([plant.targets[index].center_m for index in target])
    axes = np.stack([plant.targets[index].axes for index in target])
    aims += np.einsum("nk,nkj->nj", disturbances.aim_m * rng.standard_normal((len(times), 2)), axes)
    states = None if changes is None or changes.none else changes.at(heliostat, times)
    readings = _aimed(heliostat, states, set_for, aims)
    served = np.asarray(np.isfinite(readings).all(axis=1))
    if not served.any():
        raise InputError(f"{heliostat.name}: cannot send the sun to the targets at any of {len(times)} times")
    for axis, count in enumerate(disturbances.count):
        readings[:, axis] = np.rint(readings[:, axis] / count) * count if count else readings[:, axis]
    times, target, readings = times[served], target[served], readings[served]
    states = None if states is None else [state for state, kept in zip(states, served, strict=True) if kept]
    approach = np.sign(np.diff(readings, axis=0, prepend=readings[:1] - 1))
    poses = _moved(heliostat, states, readings, approach)
    gusts = disturbances.wind_rad * rng.standard_normal((len(times), 2))
    poses = shaken(poses, gusts)
    sun = sun_directions(times, plant.site)
    spot = spots(poses, sun, [plant.targets[index] for index in target])
    sigma = np.broadcast_to(disturbances.spot_m, spot.shape)
    outlier = rng.uniform(size=len(times)) < disturbances.outliers
    measured = spot + sigma * rng.standard_normal(spot.shape)
    measured += outlier[:, None] * disturbances.outlier_m * rng.standard_normal(spot.shape)
    noted = times + _milliseconds(disturbances.clock_s * rng.standard_normal(len(times)))
    logged = readings.copy()
    for axis, step in enumerate(disturbances.logged):
        logged[:, axis] = np.rint(logged[:, axis] / step) * step if step else logged[:, axis]
    stated = disturbances.stated * sigma
    return Beams(times, noted, sun, target, readings, logged, approach, poses, spot, measured, stated, outlier)


def spots(poses: Poses, sun: FloatArray, targets: list[PlaneTarget]) -> FloatArray:
    """Return where the ray that leaves the middle of each mirror meets its target.

    sun (n, 3): Unit vectors to the sun.
    Returns (n, 2): Right and up from the target's centre [m].
    """
    normals = poses.normals
    beam = 2 * np.einsum("ni,ni->n", normals, sun)[:, None] * normals - sun
    found = np.empty((len(targets), 2))
    for row, target in enumerate(targets):
        offset = target.center_m - poses.center_m[row]
        travel = (offset @ target.normal) / (beam[row] @ target.normal)
        found[row] = target.axes @ (travel * beam[row] - offset)
    return found


def shaken(poses: Poses, angles_rad: FloatArray) -> Poses:
    """Turn mirrors a little about their own axes.

    angles_rad (n, 2): About the mirror's right and its up [rad].
    """
    rotation = poses.rotation
    for axis in (0, 1):
        rotation = rotation @ rotation_about(np.broadcast_to(np.eye(3)[axis], (len(rotation), 3)), angles_rad[:, axis])
    return replace(poses, rotation=rotation)


def _aimed(
    heliostat: TrueHeliostat, states: list[TrueHeliostat] | None, sun: FloatArray, aims: FloatArray
) -> FloatArray:
    if states is None:
        return heliostat.aim(sun, aims)
    pieces = [state.aim(sun[row : row + 1], aims[row : row + 1]) for row, state in enumerate(states)]
    return np.concatenate(pieces)


def _moved(
    heliostat: TrueHeliostat, states: list[TrueHeliostat] | None, readings: FloatArray, approach: FloatArray
) -> Poses:
    if states is None:
        return heliostat.poses(readings, approach)
    pieces = [state.poses(readings[row : row + 1], approach[row : row + 1]) for row, state in enumerate(states)]
    rotation, center = (np.concatenate([getattr(piece, name) for piece in pieces]) for name in ("rotation", "center_m"))
    return Poses(rotation, center)


def _milliseconds(seconds: FloatArray) -> npt.NDArray[np.timedelta64]:
    return np.rint(1e3 * seconds).astype("timedelta64[ms]")
