"""A drone that sees the target's centre in a heliostat's mirror: Gouws (2018), sections 5.1 and 6.4."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.heliostat.kinematic_model import PlaneTarget
from data_synth.heliostats.mechanics import Poses, TrueHeliostat
from heliogauge.errors import InputError
from heliogauge.validate import FloatArray

#: Incidence beyond which a mirror shows too little.
_MOST_INCIDENCE_RAD = np.radians(80.0)


@dataclass(frozen=True, slots=True)
class Flight:
    """Where a drone looks from: random directions of a dome about the heliostat.

    radius_m: Least and greatest distance from the heliostat's reference point, drawn evenly [m].
    points: Sightings.
    center_m: Standard deviation with which the target's centre is brought to the middle of a flat mirror, on the
        mirror [m].
    """

    radius_m: tuple[float, float] = (32.0, 32.0)
    points: int = 60
    center_m: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """Sightings of one heliostat by a drone.

    readings (n, 2): Readings of the drives.
    drone_m, measured_m (n, 3): Where the drone was, and where its RTK-GPS said it was [m].
    poses: True poses of the mirror.
    """

    readings: FloatArray
    drone_m: FloatArray
    measured_m: FloatArray
    poses: Poses

    def __len__(self) -> int:
        return len(self.readings)

    def rows(self, target: PlaneTarget, unit: str, sigma_m: tuple[float, float, float]) -> dict[str, list[Any]]:
        """Return the table of observations without the heliostat's name.

        target: Whose centre was seen.
        sigma_m: Stated sigmas of the drone's position [m].
        """
        columns: dict[str, list[Any]] = {
            "kind": ["drone"] * len(self),
            f"axis_1_{unit}": self.readings[:, 0].round(9).tolist(),
            f"axis_2_{unit}": self.readings[:, 1].round(9).tolist(),
            "target": [target.name] * len(self),
        }
        for axis, name in enumerate("enu"):
            columns[f"drone_{name}_m"] = self.measured_m[:, axis].round(6).tolist()
        for name, sigma in zip("enu", sigma_m, strict=True):
            columns[f"sigma_drone_{name}_mm"] = [round(1e3 * sigma, 4)] * len(self)
        return columns


def fly(
    heliostat: TrueHeliostat,
    target: PlaneTarget,
    flight: Flight,
    sigma_m: tuple[float, float, float],
    rngs: tuple[np.random.Generator, np.random.Generator],
) -> Sightings:
    """Let a drone look for the target in a mirror.

    flight: Distances and number of sightings.
    sigma_m: Noise of the drone's position, east, north, up [m].
    rngs: One draws the places, the other the noise: either can be kept while the other changes.
    Returns: As many as asked for; more of them keep the first ones.
    InputError: Hardly any direction lets the heliostat show the target.
    """
    places, noise = rngs
    aim = target.center_m
    found: list[FloatArray] = []
    readings: list[FloatArray] = []
    for _ in range(40):
        if sum(len(part) for part in found) >= flight.points:
            break
        drone = heliostat.position_m + _dome(flight, 2 * flight.points, places)
        angles = heliostat.aim(drone, np.broadcast_to(aim, drone.shape), at_infinity=False)
        seen = np.isfinite(angles).all(axis=1)
        poses = heliostat.poses(angles[seen])
        ray = drone[seen] - poses.center_m
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        oblique = np.einsum("ni,ni->n", ray, poses.normals) > np.cos(_MOST_INCIDENCE_RAD)
        found.append(drone[seen][oblique])
        readings.append(angles[seen][oblique])
    drone, angles = np.concatenate(found)[: flight.points], np.concatenate(readings)[: flight.points]
    if len(drone) < flight.points:
        raise InputError(f"{heliostat.name}: hardly any direction of the drone lets it show {target.name}")
    poses = heliostat.poses(angles)
    aside = flight.center_m * noise.standard_normal((len(drone), 2))
    stood = drone + _sideways(drone, poses, aim, aside)
    measured = stood + np.asarray(sigma_m) * noise.standard_normal(drone.shape)
    return Sightings(angles, stood, measured, poses)


def rtk_log(
    sigma_m: tuple[float, float, float], rng: np.random.Generator, *, epochs: int = 1500
) -> dict[str, list[Any]]:
    """Draw the log of an RTK-GPS receiver at rest, 3.3 m from its base, ten epochs a second (Gouws, section 3.3).

    sigma_m: White noise, east, north, up [m].
    epochs: Length of the log; the first 3 % are not fixed yet and ten times as noisy.
    Returns: Columns gps_time_s, north_mm, east_mm, down_mm (whole millimetres), fix_mode, n_sat.
    """
    east, north, up = sigma_m
    errors = rng.standard_normal((epochs, 3)) * [north, east, up]
    is_floating = np.arange(epochs) < 0.03 * epochs
    errors[is_floating] *= 10
    places = np.rint(1e3 * errors + [-2108.755, 2531.074, 135.710])
    return {
        "gps_time_s": (0.1 * np.arange(epochs)).round(1).tolist(),
        "north_mm": places[:, 0].tolist(),
        "east_mm": places[:, 1].tolist(),
        "down_mm": places[:, 2].tolist(),
        "fix_mode": ["FLOAT" if one else "FIX" for one in is_floating],
        "n_sat": [8] * epochs,
    }


def _dome(flight: Flight, count: int, rng: np.random.Generator) -> FloatArray:
    # One draw for each coordinate of each place: a longer list begins like a shorter one of the same generator.
    draws = rng.random((count, 3))
    height = draws[:, 0]
    turn = 2 * np.pi * draws[:, 1]
    near, far = flight.radius_m
    flat = np.sqrt(1 - height**2)
    directions = np.stack([flat * np.sin(turn), flat * np.cos(turn), height], axis=1)
    return np.asarray((near + (far - near) * draws[:, 2])[:, None] * directions)


def _sideways(drone: FloatArray, poses: Poses, aim: FloatArray, aside: FloatArray) -> FloatArray:
    """Return how far aside a drone stands that sees the target's centre aside of the mirror's middle, (n, 2) [m]."""
    # A flat mirror: the ray from the target through a point x beside the middle is x (1 + range / distance) aside.
    gain = 1 + np.linalg.norm(drone - poses.center_m, axis=1) / np.linalg.norm(aim - poses.center_m, axis=1)
    return np.asarray(gain[:, None] * np.einsum("nij,nj->ni", poses.rotation[..., :2], aside))
