"""Lamps seen by a camera on the structure, calibrated or not (STAGE-STE Deliverable 12.6, section 4.2.2)."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from calibration.heliostat.fitting.fit_result import FitOptions
from calibration.heliostat.fitting.robust_fit import fit
from calibration.heliostat.kinematic_model.kinematics import mirror_poses
from calibration.heliostat.kinematic_model.presets import azimuth_elevation
from calibration.heliostat.observations.observations import LampSightings, MountedCamera, Observations, Pointings
from heliogauge.geometry.rigid import rotation_from_vector

#: The tower 1 km away and three lamps on poles among the heliostats, at different elevations.
LAMPS = {
    "tower": [0.0, 1000.0, 120.0],
    "west": [-450.0, 120.0, 20.0],
    "east": [380.0, 250.0, 5.0],
    "south": [90.0, -410.0, 60.0],
}
#: Image positions: the middle and four corners of a camera of 20 degrees.
PIXELS = {"c": (0.0, 0.0), "ul": (-0.17, 0.13), "ur": (0.17, 0.13), "ll": (-0.17, -0.13), "lr": (0.17, -0.13)}
CAMERA_M = np.array([0.4, -0.1, 0.3])
#: The camera looks along the mirror's normal (y in its frame), right is x.
MIRROR_FROM_CAMERA = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
TRUTH = {"tilt_north": 0.05, "tilt_east": -0.08, "position_e": 0.4, "position_n": -0.3, "position_u": 0.2}


def nominal(sigma_position=0.5):
    design = azimuth_elevation("h", [0.0, 0.0, 2.0])
    free = dict.fromkeys(("tilt_north", "tilt_east"), np.inf)
    place = dict.fromkeys(("position_e", "position_n", "position_u"), sigma_position)
    return design.with_parameters(design.parameters.with_sigmas(free | place))


def direction(pixel):
    ray = MIRROR_FROM_CAMERA @ np.array([*PIXELS[pixel], 1.0])
    return ray / np.linalg.norm(ray)


def true_design():
    design = nominal()
    moved = {name: design.parameters.value(name) + value for name, value in TRUTH.items()}
    return design.with_value(moved)


def driven(lamp, pixel):
    """Return the readings at which a lamp stands at an image position."""
    truth, line = true_design(), direction(pixel)

    def miss(readings):
        poses = mirror_poses(truth, truth.parameters.values, readings[None])
        seen = poses.rotation[0].T @ (np.array(LAMPS[lamp]) - poses.points(CAMERA_M)[0])
        return np.cross(seen / np.linalg.norm(seen), line)

    start = np.arctan2(LAMPS[lamp][0], LAMPS[lamp][1])
    return least_squares(miss, [start, 0.1], xtol=1e-15, ftol=1e-15, gtol=1e-15).x


_READINGS = {(lamp, pixel): driven(lamp, pixel) for lamp in LAMPS for pixel in PIXELS}


def sightings(rng, *, axes_rad=0.0, lamps_m=0.0, calibrated=False, sigma_rad=1e-4):
    pairs = list(_READINGS)
    readings = np.array([_READINGS[pair] for pair in pairs])
    readings = readings + rng.uniform(-1, 1, readings.shape) * axes_rad
    shift = {lamp: rng.uniform(-1, 1, 3) * lamps_m for lamp in LAMPS}
    places = np.array([LAMPS[lamp] + shift[lamp] for lamp, _ in pairs])
    known = {"position": tuple(pixel for _, pixel in pairs)}
    mounted = MountedCamera(CAMERA_M, 0.0, MIRROR_FROM_CAMERA, 0.2)
    if calibrated:
        twist = rotation_from_vector([0.03, -0.02, 0.04])
        lines = np.array([direction(pixel) for _, pixel in pairs]) @ twist @ MIRROR_FROM_CAMERA
        known = {"direction_camera": lines}
    return LampSightings(
        Pointings(readings), places, tuple(lamp for lamp, _ in pairs), sigma_rad, camera=mounted, **known
    )


def pointing_error_rad(found):
    """Return how far the fitted lines of sight of the image positions miss the true ones, over the sky, RMS."""
    truth = true_design()
    readings = np.array([[azimuth, elevation] for azimuth in np.arange(-3, 3, 0.7) for elevation in (0.1, 0.5, 0.9)])
    errors = []
    for pixel in PIXELS:
        a, b = (found.design.parameters.value(f"direction_{pixel}_{letter}") for letter in "ab")
        axis, right, up = np.array([0, 1.0, 0]), np.array([1.0, 0, 0]), np.array([0, 0, 1.0])
        square = (a * a + b * b) / 4
        line = (axis * (1 - square) + right * a + up * b) / (1 + square)
        one = mirror_poses(found.design, found.values, readings).rotation @ line
        other = mirror_poses(truth, truth.parameters.values, readings).rotation @ direction(pixel)
        errors.append(np.linalg.norm(np.cross(one, other), axis=1))
    return float(np.sqrt(np.mean(np.square(errors))))


def test_perfect_data_give_machine_precision():
    found = fit(nominal(np.inf), Observations((sightings(np.random.default_rng(0)),)))
    assert found.n_free == 5 + 10
    assert found.rank == 15
    assert pointing_error_rad(found) < 1e-9
    position = [found.design.parameters.value(f"position_{axis}") for axis in "enu"]
    np.testing.assert_allclose(position, [0.4, -0.3, 2.2], atol=1e-6)


def test_calibrated_camera_finds_its_rotation():
    found = fit(nominal(np.inf), Observations((sightings(np.random.default_rng(0), calibrated=True),)))
    turn = [found.design.parameters.value(f"mounted_turn_{axis}") for axis in "xyz"]
    back = rotation_from_vector(turn) @ rotation_from_vector([0.03, -0.02, 0.04]).T
    # Directions were turned back by the twist, so the mount must turn them forth.
    np.testing.assert_allclose(back, np.eye(3), atol=1e-8)
    np.testing.assert_allclose(found.design.parameters.value("tilt_north"), 0.05, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("axes_rad", "lamps_m", "published_mrad"),
    [(1e-4, 0.0, 0.2), (2e-4, 0.0, 0.45), (3e-4, 0.0, 0.7), (0.0, 0.1, 0.26), (1e-4, 0.1, 0.36)],
)
def test_noise_gives_the_published_magnitudes(axes_rad, lamps_m, published_mrad):
    rng = np.random.default_rng(1)
    sigma = max(axes_rad, lamps_m / 450) / np.sqrt(3)
    errors, squares = [], []
    for _ in range(40):
        found = fit(
            nominal(),
            Observations((sightings(rng, axes_rad=axes_rad, lamps_m=lamps_m, sigma_rad=sigma),)),
            FitOptions(sigma="stated"),
        )
        errors.append(pointing_error_rad(found))
        tilt = found.design.parameters.value("tilt_north") - 0.05
        squares.append(tilt**2 / found.sigma[found.names.index("tilt_north")] ** 2)
    mean = 1e3 * np.sqrt(np.mean(np.square(errors)))
    # The report does not print its layout: others give 0.3 to 2.3 times its numbers.
    assert published_mrad / 4 < mean < 2.3 * published_mrad
    if lamps_m == 0:
        assert 0.6 < np.sqrt(np.mean(squares)) < 1.4


def test_some_of_the_sightings_keep_the_one_camera():
    seen = sightings(np.random.default_rng(1), calibrated=True)
    some = seen.select(np.arange(len(seen)) % 2 == 0)
    assert some.camera is seen.camera
    assert some.lamp == seen.lamp[::2]
    np.testing.assert_array_equal(some.lamp_m, seen.lamp_m[::2])
