"""Folders of heliostats with known truth, as tables and as files of the PAINT database."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration.heliostat.kinematic_model.aiming import aim
from calibration.heliostat.kinematic_model.design import HeliostatDesign, PlaneTarget
from calibration.heliostat.kinematic_model.presets import (
    ActuatorNumbers,
    azimuth_elevation,
    ideal_actuators,
    linear_actuators,
)
from heliogauge.geometry.geodesy import geodetic_from_enu
from heliogauge.geometry.sun import Site, angles_from_direction, sun_directions
from heliogauge.measurement.writer import dump_toml
from heliogauge.results.tables import write_table_csv

SITE = Site(37.0, -2.0, 500.0)
TARGET = PlaneTarget.facing("north face", np.array([0.0, 0.0, 40.0]), 0.0, 8.0, 6.0)
CONTENT: dict[str, Any] = {
    "kind": "heliostat",
    "name": "Versuchsfeld Süd",
    "site": {"latitude_deg": SITE.latitude_deg, "longitude_deg": SITE.longitude_deg, "altitude_m": SITE.altitude_m},
    "target": [
        {"name": TARGET.name, "center_m": [0.0, 0.0, 40.0], "width_m": 8.0, "height_m": 6.0, "facing_azimuth_deg": 0.0}
    ],
    "kinematics": {"preset": "azimuth-elevation"},
}
ERRORS = {"tilt_north": 2e-3, "tilt_east": -1e-3, "azimuth_offset": 4e-3, "elevation_offset": -3e-3}
ACTUATORS = (
    ActuatorNumbers(0.0137, 0.0757, 0.335308, 0.338095, 154166.6667, False, (0.0, 69001.0)),
    ActuatorNumbers(0.9371, 0.0784, 0.340771, 0.3191, 154166.6667, True, (0.0, 75454.0)),
)
#: Of ideal actuators that turn as far.
LIMITS_RAD = [(-1.6, 0.1), (-1.0, 1.0)]
TILTS = {"tilt_1_n": 3e-3, "tilt_1_u": -2e-3, "tilt_2_e": 4e-3, "tilt_2_n": 1e-3}
SIGMA_M = 0.02


@dataclass(frozen=True)
class Seen:
    """Times, suns, readings and centres of beams of one heliostat."""

    times: np.ndarray
    suns: np.ndarray
    readings: np.ndarray
    xy_m: np.ndarray


def times_of(count: int) -> np.ndarray:
    """Instants over a year, between 9 and 15 UTC."""
    days = (np.arange(count) * 37) % 365
    minutes = 540 + (np.arange(count) * 97) % 360
    start = np.datetime64("2026-01-05T00:00:00", "ms")
    return start + days * np.timedelta64(1, "D") + minutes * np.timedelta64(1, "m")


def sightings(design: HeliostatDesign, count: int, rng: np.random.Generator, sigma_m: float = SIGMA_M) -> Seen:
    """Let a heliostat, as it truly is, send beams around the middle of the target."""
    times = np.sort(times_of(count))
    suns = sun_directions(times, SITE)
    xy = rng.uniform(-1.5, 1.5, (count, 2))
    found = aim(design, design.parameters.values, suns, TARGET.points(xy))
    assert found.converged.all()
    return Seen(times, suns, found.readings, xy + rng.normal(0, sigma_m, (count, 2)))


def write_field(
    folder: Path, *, heliostats: int = 1, observations: int = 40, seed: int = 0
) -> dict[str, HeliostatDesign]:
    """Write a measurement with tables; return the true designs."""
    rng = np.random.default_rng(seed)
    names = [f"H{number + 1}" for number in range(heliostats)]
    positions = np.column_stack(
        [rng.uniform(-60, 60, heliostats), rng.uniform(60, 150, heliostats), np.full(heliostats, 2.0)]
    )
    truths, columns = (
        {},
        {
            name: []
            for name in ("heliostat", "time_utc", "axis_1_rad", "axis_2_rad", "target", "x_m", "y_m", "sigma_mm")
        },
    )
    for name, position in zip(names, positions, strict=True):
        nominal = azimuth_elevation(name, position)
        truths[name] = nominal.with_value({key: value * rng.uniform(0.5, 1.5) for key, value in ERRORS.items()})
        seen = sightings(truths[name], observations, rng)
        columns["heliostat"] += [name] * observations
        columns["time_utc"] += [f"{time}Z" for time in seen.times]
        columns["axis_1_rad"] += seen.readings[:, 0].tolist()
        columns["axis_2_rad"] += seen.readings[:, 1].tolist()
        columns["target"] += [TARGET.name] * observations
        columns["x_m"] += seen.xy_m[:, 0].tolist()
        columns["y_m"] += seen.xy_m[:, 1].tolist()
        columns["sigma_mm"] += [1e3 * SIGMA_M] * observations
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "measurement.toml").write_text(dump_toml(CONTENT), encoding="utf-8")
    write_table_csv(
        folder / "heliostats.csv",
        {"heliostat": names, "e_m": positions[:, 0], "n_m": positions[:, 1], "u_m": positions[:, 2]},
    )
    write_table_csv(folder / "observations.csv", columns)
    return truths


def write_paint(
    folder: Path, *, names: tuple[str, ...] = ("AA11",), observations: int = 40, seed: int = 0, ideal: bool = False
) -> dict[str, HeliostatDesign]:
    """Write a field as the PAINT database has it; return the true designs.

    ideal: Motor positions are the angles of the axes.
    """
    rng = np.random.default_rng(seed)
    origin = (SITE.latitude_deg, SITE.longitude_deg, SITE.altitude_m)
    truths, stamps = {}, {}
    for number, name in enumerate(names):
        position = np.array([10.0 * number - 15.0, 70.0 + 5.0 * number, 2.0])
        plain = ideal_actuators(name, position, LIMITS_RAD) if ideal else linear_actuators(name, position, ACTUATORS)
        truths[name] = plain.with_value({key: value * rng.uniform(0.5, 1.5) for key, value in TILTS.items()})
        seen = sightings(truths[name], observations, rng)
        home = folder / name / "calibration"
        home.mkdir(parents=True)
        write_json(folder / name / f"{name}_properties.json", properties(position))
        spots = np.column_stack(geodetic_from_enu(TARGET.points(seen.xy_m), origin))
        for row in range(observations):
            key = 1000 * (number + 1) + row
            stamps[f"{name}_{key}"] = f"{str(seen.times[row])[:19]}Z"
            write_json(home / f"{key}_calibration_properties.json", record(seen, row, spots[row]))
    corners = TARGET.points([[-4, 3], [4, 3], [4, -3], [-4, -3]])
    places = np.column_stack(geodetic_from_enu(corners, origin)).tolist()
    (folder / "tower").mkdir()
    write_json(
        folder / "tower" / "tower_measurements.json",
        {
            "power_plant_properties": {"ID": "X", "coordinates": list(origin)},
            TARGET.name: {
                "type": "planar",
                "coordinates": dict(
                    zip(("upper_left", "upper_right", "lower_right", "lower_left"), places, strict=True)
                ),
            },
            "receiver": {"type": "convex_cylinder", "coordinates": {}},
        },
    )
    write_json(folder / "timestamps.json", stamps)
    return truths


def properties(position_m: np.ndarray) -> dict[str, Any]:
    """What a properties file says of a heliostat with `ACTUATORS`."""
    place = geodetic_from_enu(position_m, (SITE.latitude_deg, SITE.longitude_deg, SITE.altitude_m))
    actuators = [
        {
            "type_axis": "linear",
            "min_increment": one.count_limits[0],
            "max_increment": one.count_limits[1],
            "increment": one.increment_per_m,
            "initial_stroke_length": one.initial_stroke_m,
            "offset": one.offset_m,
            "pivot_radius": one.pivot_radius_m,
            "clockwise_axis_movement": int(one.clockwise),
            "initial_angle": one.initial_angle_rad,
        }
        for one in ACTUATORS
    ]
    return {
        "heliostat_position": [float(one) for one in place],
        "height": 2.56,
        "width": 3.22,
        "initial_orientation": [0.0, -1.0, 0.0],
        "kinematics_properties": {"actuators": actuators, "concentrator_translation_n": 0.175},
    }


def record(seen: Seen, row: int, spot: np.ndarray) -> dict[str, Any]:
    """One calibration record."""
    azimuth, elevation = (float(np.rad2deg(angle[row])) for angle in angles_from_direction(seen.suns))
    return {
        "motor_position": dict(
            zip(("axis_1_motor_position", "axis_2_motor_position"), seen.readings[row].tolist(), strict=True)
        ),
        "target_name": TARGET.name,
        "sun_elevation": elevation,
        "sun_azimuth": 180.0 - azimuth,
        "focal_spot": {"HeliOS": spot.tolist(), "UTIS": spot.tolist()},
    }


def write_json(file: Path, content: Any) -> None:
    """Write any JSON."""
    file.write_text(json.dumps(content), encoding="utf-8")
