"""ARTIST's equations written apart, from its source of 2026: rigid-body kinematics, linear actuators, map projection.

Homogeneous 4 x 4 matrices as in ``kinematics_rigid_body.py`` and ``transforms.py``, positive lengths and clamped
triangles as in ``actuators_linear.py``, one heliostat at a time and in double precision.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def turn(axis: str, angle: float) -> Array:
    """Return ``rotate_e``, ``rotate_n`` or ``rotate_u``; north is the one that is left-handed."""
    c, s = np.cos(angle), np.sin(angle)
    rows = {
        "e": [[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]],
        "n": [[c, 0, -s, 0], [0, 1, 0, 0], [s, 0, c, 0], [0, 0, 0, 1]],
        "u": [[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
    }
    return np.array(rows[axis], dtype=np.float64)


def shift(east: float, north: float, up: float) -> Array:
    """Return ``translate_enu``."""
    matrix = np.eye(4)
    matrix[:3, 3] = east, north, up
    return matrix


def positive(value: float) -> float:
    """Return ``softplus(value, beta=100) + 1e-6``; torch's softplus is the identity from beta x = 20 on."""
    return (value if 100 * value > 20 else float(np.log1p(np.exp(100 * value)) / 100)) + 1e-6


@dataclass(frozen=True)
class Actuator:
    """A linear actuator by its parameters in the file."""

    clockwise: bool
    numbers: Mapping[str, float]
    #: The first axis is counted from the mirror that looks up (``linear_actuators`` of ``h5_scenario_parser.py``).
    zero: float

    def absolute(self, motor: float) -> float:
        lengths = {name: positive(value) for name, value in self.numbers.items() if name != "initial_angle"}
        offset, radius = lengths["offset"], lengths["pivot_radius"]
        stroke = motor / lengths["increment"] + lengths["initial_stroke_length"]
        stroke = float(np.clip(stroke, abs(offset - radius) + 1e-6, offset + radius - 1e-6))
        cosine = (offset**2 + radius**2 - stroke**2) / (2 * offset * radius)
        return float(np.arccos(np.clip(cosine, -1 + 1e-6, 1 - 1e-6)))

    def angle(self, motor: float) -> float:
        moved = self.absolute(0.0) - self.absolute(motor)
        return self.numbers["initial_angle"] + self.zero + (moved if self.clockwise else -moved)


@dataclass(frozen=True)
class IdealActuator:
    """An ideal actuator: ``actuators_ideal.py`` returns the motor position as the angle."""

    def angle(self, motor: float) -> float:
        return motor


@dataclass(frozen=True)
class Artist:
    """A heliostat as ARTIST has it.

    position: East, north, up [m].
    deviations: Translations [m] and tilts [rad] by ARTIST's names.
    """

    position: Array
    deviations: Mapping[str, float]
    actuators: tuple[Actuator | IdealActuator, Actuator | IdealActuator]

    def orientation(self, motors: Array) -> Array:
        """Return ``motor_positions_to_orientations`` without the turn of the flat surface model, 4 x 4."""
        known = self.deviations
        first, second = (actuator.angle(motor) for actuator, motor in zip(self.actuators, motors, strict=True))

        def moved(joint: str) -> Array:
            return shift(*(known[f"{joint}_translation_{axis}"] for axis in "enu"))

        return (
            shift(*self.position[:3])
            @ turn("n", known["first_joint_tilt_n"])
            @ turn("u", known["first_joint_tilt_u"])
            @ moved("first_joint")
            @ turn("e", first)
            @ turn("e", known["second_joint_tilt_e"])
            @ turn("n", known["second_joint_tilt_n"])
            @ moved("second_joint")
            @ turn("u", second)
            @ moved("concentrator")
        )

    def mirror(self, readings: Array) -> tuple[Array, Array]:
        """Return normals and centres (n, 3) at motor positions (n, 2)."""
        poses = np.stack([self.orientation(one) for one in readings])
        return (poses @ [0.0, -1.0, 0.0, 0.0])[:, :3], (poses @ [0.0, 0.0, 0.0, 1.0])[:, :3]


def from_scenario(file: h5py.File, name: str) -> Artist:
    """Read a heliostat's groups as ``h5_scenario_parser.py`` does."""
    group = file[f"heliostats/{name}"]
    assert group["kinematics/type"][()].decode() == "rigid_body"
    actuators = []
    for key in sorted(group["actuator"]):
        one = group["actuator"][key]
        assert one["type"][()].decode() == "linear"
        numbers = {name: float(value[()]) for name, value in one["parameters"].items()}
        actuators.append(Actuator(bool(one["clockwise_axis_movement"][()]), numbers, 0.0 if actuators else -np.pi / 2))
    deviations = {name: float(value[()]) for name, value in group["kinematics/deviations"].items()}
    return Artist(group["position"][()], deviations, (actuators[0], actuators[1]))


def from_properties(content: Mapping[str, Any], plant: tuple[float, float, float]) -> Artist:
    """Read a properties file as ``paint_scenario_parser.py`` does: every tilt becomes 0."""
    kinematics = content["kinematics_properties"]
    deviations = dict.fromkeys(
        ("first_joint_tilt_n", "first_joint_tilt_u", "second_joint_tilt_e", "second_joint_tilt_n"), 0.0
    )
    for axis in "enu":
        deviations[f"first_joint_translation_{axis}"] = kinematics[f"joint_translation_{axis}_1"]
        deviations[f"second_joint_translation_{axis}"] = kinematics[f"joint_translation_{axis}_2"]
        deviations[f"concentrator_translation_{axis}"] = kinematics[f"concentrator_translation_{axis}"]
    names = ("increment", "initial_stroke_length", "offset", "pivot_radius", "initial_angle")
    first, second = (
        Actuator(one["clockwise_axis_movement"] == 1, {name: one[name] for name in names}, zero)
        for one, zero in zip(kinematics["actuators"], (-np.pi / 2, 0.0), strict=True)
    )
    return Artist(to_enu(content["heliostat_position"], plant), deviations, (first, second))


def to_enu(place: list[float], plant: tuple[float, float, float]) -> Array:
    """Return ``convert_wgs84_coordinates_to_local_enu``."""
    major, minor = 6378137.0, 6356752.314245
    squared = (major**2 - minor**2) / major**2
    latitude, longitude = np.deg2rad(place[:2])
    inner = 1 - squared * np.sin(latitude) ** 2
    across, along = major / np.sqrt(inner), major * (1 - squared) / inner**1.5
    east = (longitude - np.deg2rad(plant[1])) * across * np.cos(latitude)
    return np.array([east, (latitude - np.deg2rad(plant[0])) * along, place[2] - plant[2]])
