"""Residuals of every kind of observation: derivatives, orientation, zero at the truth, selection of rows."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.heliostat.kinematic_model.aiming import aim
from calibration.heliostat.kinematic_model.design import PlaneTarget
from calibration.heliostat.kinematic_model.kinematics import mirror_poses
from calibration.heliostat.kinematic_model.presets import (
    ActuatorNumbers,
    azimuth_elevation,
    drone_heliostat,
    linear_actuators,
)
from calibration.heliostat.observations.observations import (
    BeamSpots,
    DroneSightings,
    LampSightings,
    MirrorNormals,
    MirrorPoints,
    MountedCamera,
    Observations,
    Place,
    Pointings,
    SunInCamera,
)
from calibration.heliostat.observations.residuals import evaluate, predicted_spots
from heliogauge.errors import InputError
from heliogauge.geometry.rays import reflect
from heliogauge.geometry.rigid import rotation_from_vector
from tests.derivatives import central_differences, check_jacobian

TARGET = PlaneTarget.facing("lower", [0.0, 0.0, 35.0], 0.3, 5.0, 7.0)
AXIS_1 = ActuatorNumbers(0.01366, 0.0757, 0.3353, 0.3381, 154166.7, False, (0.0, 69001.0))
AXIS_2 = ActuatorNumbers(0.93709, 0.0784, 0.3408, 0.3191, 154166.7, True, (0.0, 75454.0))


def designs():
    return {
        "azimuth-elevation": azimuth_elevation("a", [20.0, 70.0, 1.5]),
        "drone": drone_heliostat("d", [20.0, 70.0, 1.5], (0.43, 0.24)),
        "actuators": linear_actuators("l", [20.0, 120.0, 1.5], (AXIS_1, AXIS_2)),
    }


def suns(rng, count):
    azimuth, elevation = rng.uniform(2.0, 4.3, count), rng.uniform(0.3, 1.0, count)
    return np.stack(
        [np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)], axis=1
    )


def groups(design, rng, count=6):
    """Return one group of each kind, a few mrad off the design's own prediction."""
    sun = suns(rng, count)
    found = aim(design, design.parameters.values, sun, TARGET.center_m)
    pointings = Pointings(found.readings, row=np.arange(count) + 10)
    poses = mirror_poses(design, design.parameters.values, found.readings)
    beams = reflect(-sun, poses.normals(design))
    distance = np.linalg.norm(TARGET.center_m - poses.centre_m, axis=1)
    noise = lambda: rng.normal(0, 0.1, (count, 3))  # noqa: E731
    camera = Place("tower", TARGET.center_m + 1.0, np.inf)
    mounted = MountedCamera(np.array([0.3, 0.2, -0.1]), 0.1, rotation_from_vector([0.2, -0.3, 0.5]), np.inf)
    lines = np.einsum("nji,nj->ni", poses.rotation, rng.normal(0, 20, (count, 3)) + [0, 0, 200.0] - poses.centre_m)
    lamp = LampSightings(
        pointings,
        TARGET.center_m + rng.normal(0, 20, (count, 3)),
        ("L",) * count,
        1e-4,
        position=("p", "q", "p", "q", "p", "q")[:count],
        camera=replace(mounted, mirror_from_camera=np.eye(3)),
    )
    calibrated = LampSightings(
        pointings, lamp.lamp_m, lamp.lamp, 1e-4, direction_camera=lines @ mounted.mirror_from_camera, camera=mounted
    )
    covariance = np.array([[4e-4, 1e-4, 0], [1e-4, 9e-4, 0], [0, 0, 1e-3]]) * np.ones((count, 1, 1))
    return {
        "beam": BeamSpots.on_targets(
            pointings, sun, {"lower": TARGET}, ("lower",) * count, rng.normal(0, 0.2, (count, 2)), (0.02, 0.03)
        ),
        "camera": SunInCamera(pointings, sun, ("tower",) * count, (camera,), 1e-3),
        "drone": DroneSightings(
            pointings,
            poses.centre_m + 50 * beams + noise(),
            covariance,
            ("sun",) * count,
            (Place("sun", poses.centre_m[0] + distance[0] * sun[0] + noise()[0], 0.05),),
            0.006,
        ),
        "lamp shared": lamp,
        "lamp calibrated": calibrated,
        "normal": MirrorNormals(pointings, poses.normals(design) + rng.normal(0, 1e-3, (count, 3)), 1e-3),
        "point": MirrorPoints(
            pointings, rng.normal(0, 1, (count, 3)), poses.centre_m + noise(), covariance, ("P",) * count
        ),
    }


def extended(design, observations):
    return design.with_parameters(design.parameters.extended(observations.extra_parameters(design)))


@pytest.mark.parametrize("kind", list(designs()))
@pytest.mark.parametrize("group", ["beam", "camera", "drone", "lamp shared", "lamp calibrated", "normal", "point"])
def test_derivatives(kind, group):
    rng = np.random.default_rng(3)
    design = designs()[kind]
    observations = Observations((groups(design, rng)[group],))
    design = extended(design, observations)
    start = design.parameters.values + np.where(np.array(design.parameters.units) == "rad", 2e-3, 0.0)
    steps = np.where(np.abs(start) > 1e3, 10.0, 1e-4)
    residuals = evaluate(design, start, observations)
    differences = central_differences(
        lambda x: evaluate(design, x, observations).whitened, start, lambda x, d: x + d, steps
    )
    check_jacobian(residuals.jacobian, differences, relative=3e-7, structural_zeros=False)
    chosen = [5, 1, len(start) - 1]
    np.testing.assert_allclose(
        evaluate(design, start, observations, columns=chosen).jacobian,
        residuals.jacobian[:, chosen],
        rtol=1e-9,
        atol=1e-9,
    )


def test_mixture_is_the_sum_of_its_parts_and_rows_keep_their_identity():
    rng = np.random.default_rng(5)
    design = designs()["actuators"]
    parts = groups(design, rng)
    observations = Observations((parts["beam"], parts["point"], parts["normal"]))
    design = extended(design, observations)
    together = evaluate(design, design.parameters.values, observations)
    alone = [evaluate(design, design.parameters.values, Observations((g,))) for g in observations.groups]
    np.testing.assert_allclose(together.whitened, np.concatenate([one.whitened for one in alone]), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(together.jacobian, np.concatenate([one.jacobian for one in alone]), rtol=1e-9, atol=1e-9)
    mask = np.arange(len(observations)) % 2 == 0
    chosen = observations.select(mask)
    np.testing.assert_array_equal(chosen.row, observations.row[mask])
    assert chosen.kind == ("beam",) * 3 + ("point",) * 3 + ("normal",) * 3
    np.testing.assert_allclose(
        evaluate(design, design.parameters.values, chosen).beam_rad, together.beam_rad[mask], atol=1e-12
    )
    assert np.isnan(together.beam_rad[6:]).all()
    assert np.isfinite(together.normal_rad[12:]).all()


def test_spot_right_of_the_prediction_is_positive_and_normals_are_half():
    design = designs()["azimuth-elevation"]
    sun = np.array([[0.0, -np.cos(0.5), np.sin(0.5)]])
    found = aim(design, design.parameters.values, sun, TARGET.center_m)
    centre = mirror_poses(design, design.parameters.values, found.readings).centre_m[0]
    line = TARGET.center_m - centre
    right = np.cross(line, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    spot = TARGET.center_m + 1e-3 * np.linalg.norm(line) * right
    seen = BeamSpots.at_points(Pointings(found.readings), sun, spot[None], 0.01, ("t",))
    residuals = evaluate(design, design.parameters.values, Observations((seen,)))
    np.testing.assert_allclose(residuals.beam_rad, [[1e-3, 0.0]], atol=1e-6)
    np.testing.assert_allclose(residuals.sigma_beam_rad, 0.01 / np.linalg.norm(line), rtol=1e-6)
    # One milliradian of beam across the plane of incidence is 1 / (2 cos incidence) of the normal.
    normal = mirror_poses(design, design.parameters.values, found.readings).normals(design)
    across = np.cross(normal, [0, 0, 1.0]) / np.linalg.norm(np.cross(normal, [0, 0, 1.0]))
    tilt = residuals.normal_rad[0, 0] * across + residuals.normal_rad[0, 1] * np.cross(across, normal)
    turned = reflect(-sun, normal + tilt)
    np.testing.assert_allclose(turned[0], (spot - centre) / np.linalg.norm(spot - centre), atol=1e-5)


def test_predicted_spot_is_where_the_beam_was_aimed():
    rng = np.random.default_rng(1)
    design = designs()["actuators"]
    xy = rng.normal(0, 1, (8, 2))
    sun = suns(rng, 8)
    found = aim(design, design.parameters.values, sun, TARGET.points(xy))
    seen = BeamSpots.on_targets(Pointings(found.readings), sun, {"lower": TARGET}, ("lower",) * 8, xy * 0, 0.02)
    np.testing.assert_allclose(
        predicted_spots(design, design.parameters.values, seen, {"lower": TARGET}), xy, atol=1e-9
    )
    with pytest.raises(InputError, match="no such target"):
        predicted_spots(design, design.parameters.values, seen, {"upper": TARGET})


def test_readings_outside_the_actuator_are_named_not_computed():
    design = designs()["actuators"]
    sun = suns(np.random.default_rng(0), 2)
    seen = BeamSpots.at_points(Pointings([[30000.0, 30000.0], [9e5, 30000.0]]), sun, np.zeros((2, 3)), 0.01, ("t",) * 2)
    residuals = evaluate(design, design.parameters.values, Observations((seen,)))
    assert residuals.computable.tolist() == [True, False]
    assert np.isfinite(residuals.whitened).all()
    assert np.isnan(residuals.beam_rad[1]).all()


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda p: BeamSpots.on_targets(p, np.ones((2, 3)), {"a": TARGET}, ("b",) * 2, np.zeros((2, 2)), 0.1), "b: no"),
        (lambda p: BeamSpots.on_targets(p, np.ones((2, 3)), {"a": TARGET}, ("a",) * 2, np.zeros((2, 2)), 0.0), "posit"),
        (lambda p: BeamSpots.at_points(p, np.zeros((2, 3)), np.zeros((2, 3)), 0.1, ("b",) * 2), "length zero"),
        (lambda p: SunInCamera(p, np.ones((2, 3)), ("c", "d"), (Place("c", np.zeros(3)),), 1e-3), "d: each"),
        (lambda p: LampSightings(p, np.ones((2, 3)), ("a",) * 2, 1e-3), "one of both"),
        (lambda p: MirrorNormals(p, np.ones((3, 3)), 1e-3), "shape"),
        (lambda p: Observations(()), "at least one"),
        (lambda p: Pointings(np.ones((2, 2)), row=[1]), "as many rows"),
        (lambda p: Place("c", np.zeros(3), -1.0), "sigma_m"),
    ],
)
def test_impossible_observations_are_refused(build, message):
    with pytest.raises(InputError, match=message):
        build(Pointings(np.ones((2, 2))))
