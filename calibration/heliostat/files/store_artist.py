"""Calibrated heliostats as ARTIST reads them: groups of its scenarios, and properties files of PAINT.

Both hold the numbers that ARTIST's own formulas (as of 2026) turn into the heliostat: its actuators put every length
and the increment through ``softplus(x) + 1e-6``, and its reader of PAINT's files has a map projection of its own.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from calibration.heliostat.files.store_paint import ACTUATOR_KEYS, KINEMATICS, SOUTH, TRANSLATIONS
from calibration.heliostat.kinematic_model.design import HeliostatDesign, LinearActuator
from calibration.heliostat.kinematic_model.parameters import Parameters
from heliogauge.geometry.geodesy import WGS84_FLATTENING, WGS84_RADIUS_M

SCENARIO_FILE = "artist_heliostats.h5"
_DEVIATIONS = {
    "joint_1": "first_joint_translation_{}",
    "joint_2": "second_joint_translation_{}",
    "concentrator": "concentrator_translation_{}",
}
_TILTS = {
    "tilt_1_n": "first_joint_tilt_n",
    "tilt_1_u": "first_joint_tilt_u",
    "tilt_2_e": "second_joint_tilt_e",
    "tilt_2_n": "second_joint_tilt_n",
}
_NUMBERS = ("increment", "initial_stroke", "offset", "pivot_radius", "initial_angle")
# What ARTIST keeps positive, and how (LinearActuators._physics_informed_parameters; torch's softplus is the identity
# from beta x = 20 on).
_BETA, _STRAIGHT, _EPSILON = 100.0, 20.0, 1e-6


def write_scenario_groups(designs: Mapping[str, HeliostatDesign], folder: Path) -> None:
    """Write ``artist_heliostats.h5``: position, kinematics and actuators of each heliostat as ARTIST's scenarios do.

    designs: Heliostats in ARTIST's numbers, by name.
    """
    with h5py.File(folder / SCENARIO_FILE, "w") as file:
        for name, design in designs.items():
            own = design.parameters
            group = file.create_group(f"heliostats/{name}")
            group["position"] = np.append(design.position_m, 1.0)
            kinematics = group.create_group("kinematics")
            kinematics["type"] = "rigid_body"
            kinematics["initial_orientation"] = np.array([*SOUTH, 0.0])
            for joint, key in _DEVIATIONS.items():
                for axis in "enu":
                    kinematics[f"deviations/{key.format(axis)}"] = own.value(f"{joint}_{axis}")
            for tilt, key in _TILTS.items():
                kinematics[f"deviations/{key}"] = own.value(tilt)
            for place, drive in enumerate(design.drives, start=1):
                actuator = group.create_group(f"actuator/actuator_{place}")
                actuator["type"] = "linear"
                actuator["clockwise_axis_movement"] = int(isinstance(drive, LinearActuator) and drive.clockwise)
                actuator["min_max_motor_positions"] = design.limits[place - 1]
                for number in _NUMBERS:
                    actuator[f"parameters/{ACTUATOR_KEYS[number][0]}"] = _written(own, number, place)


def properties_content(content: Mapping[str, Any], design: HeliostatDesign) -> dict[str, Any]:
    """Return a properties file as PAINT has it and ARTIST reads it: no tilts, which ARTIST would set to 0.

    content: ``heliostat.json``; the properties it came from are kept but for the numbers.
    design: The heliostat in ARTIST's numbers, its tilts 0.
    """
    own = design.parameters
    earlier = dict(content.get("paint_properties") or {})
    site = content["site"]
    old: dict[str, Any] = next((earlier.pop(key) for key in KINEMATICS if key in earlier), {})
    actuators = []
    for axis, drive in enumerate(design.drives, start=1):
        actuator = dict((old.get("actuators") or [{}, {}])[axis - 1])
        clockwise = int(isinstance(drive, LinearActuator) and drive.clockwise)
        actuator |= {"type_axis": "linear", "clockwise_axis_movement": clockwise}
        low, high = design.limits[axis - 1].tolist()
        if np.isfinite([low, high]).all():
            actuator |= {"min_increment": low, "max_increment": high}
        for number in _NUMBERS:
            actuator[ACTUATOR_KEYS[number][0]] = _written(own, number, axis)
        actuators.append(actuator)
    kinematics: dict[str, Any] = {"actuators": actuators}
    for joint, (today, _) in TRANSLATIONS.items():
        for axis_name in "enu":
            kinematics[today.format(axis_name)] = own.value(f"{joint}_{axis_name}")
    origin = (site["latitude_deg"], site["longitude_deg"], site["altitude_m"])
    return earlier | {
        "heliostat_position": _position(design.position_m.tolist(), origin),
        "initial_orientation": list(SOUTH),
        "kinematics_properties": kinematics,
    }


def _written(own: Parameters, number: str, axis: int) -> float:
    """Return what must stand in the file so that ARTIST has this number."""
    value = own.value(f"{number}_{axis}")
    if number == "initial_angle":
        return value
    least = value - _EPSILON
    return least if _BETA * least > _STRAIGHT else float(np.log(np.expm1(_BETA * least)) / _BETA)


def _position(place_m: list[float], origin: tuple[float, float, float]) -> list[float]:
    """Return the latitude, longitude [deg] and altitude [m] that ARTIST turns into this place.

    Its map (``convert_wgs84_coordinates_to_local_enu``) takes both radii of curvature at the place itself and no
    curvature of the ground: a few millimetres beside the tangent plane in a field of some hundred metres.
    """
    east, north, up = place_m
    squared = WGS84_FLATTENING * (2 - WGS84_FLATTENING)
    start = np.radians(origin[0])
    latitude = start
    # Each pass shrinks the error by the distance over the earth's radius, 1e-5 or less.
    for _ in range(6):
        inner = 1 - squared * np.sin(latitude) ** 2
        latitude = start + north * inner**1.5 / (WGS84_RADIUS_M * (1 - squared))
    across = WGS84_RADIUS_M / np.sqrt(1 - squared * np.sin(latitude) ** 2) * np.cos(latitude)
    return [float(np.degrees(latitude)), float(origin[1] + np.degrees(east / across)), float(origin[2] + up)]
