"""The real heliostats of the solar tower at Juelich as the tests of the fit take them (data beside the project)."""

import json
from pathlib import Path

import numpy as np

from calibration.heliostat.kinematic_model.presets import ActuatorNumbers, linear_actuators
from calibration.heliostat.observations.observations import BeamSpots, Observations, Pointings
from heliogauge.geometry.geodesy import enu_from_geodetic
from heliogauge.geometry.sun import azimuth_from_south_east, direction_from_angles

FOLDER = Path(__file__).resolve().parents[3] / "shared" / "data" / "csp" / "juelich_calibration"
#: One of the seven was delivered with wrong actuator data.
SOUND = ("BE36", "BF55", "BF56", "BG62", "BH35", "BH36")
FAULTY = "BF41"
#: The camera's pixel on the target, and what a beam's outline does in wind [m]: far below the model's misfit.
SIGMA_M = 0.05


def heliostat(name):
    """Return the heliostat as delivered and its observations (UTIS centres), in the order of their numbers."""
    tower = json.loads((FOLDER / "tower" / "tower_measurements.json").read_text(encoding="utf-8"))
    origin = tuple(tower["power_plant_properties"]["coordinates"])
    said = json.loads((FOLDER / name / f"{name}_properties.json").read_text(encoding="utf-8"))
    actuators = tuple(
        ActuatorNumbers(
            one["initial_angle"],
            one["initial_stroke_length"],
            one["offset"],
            one["pivot_radius"],
            one["increment"],
            one["clockwise_axis_movement"] == 1,
            (one["min_increment"], one["max_increment"]),
        )
        for one in said["kinematics_properties"]["actuators"]
    )
    position = enu_from_geodetic(*said["heliostat_position"], origin)
    return linear_actuators(name, np.ravel(position), actuators), _observations(name, origin)


def _observations(name, origin):
    records = []
    for file in (FOLDER / name / "calibration").glob("*.json"):
        one = json.loads(file.read_text(encoding="utf-8"))
        if "UTIS" in one["focal_spot"]:
            records.append((int(file.stem.split("-")[0].split("_")[0]), one))
    records.sort(key=lambda record: record[0])
    motors = np.array([list(one["motor_position"].values()) for _, one in records], dtype=np.float64)
    azimuth = azimuth_from_south_east(np.radians([one["sun_azimuth"] for _, one in records]))
    sun = direction_from_angles(azimuth, np.radians([one["sun_elevation"] for _, one in records]))
    spots = enu_from_geodetic(*np.array([one["focal_spot"]["UTIS"] for _, one in records]).T, origin)
    pointings = Pointings(motors, row=[number for number, _ in records])
    names = tuple(one["target_name"] for _, one in records)
    return Observations((BeamSpots.at_points(pointings, sun, spots, SIGMA_M, names),))
