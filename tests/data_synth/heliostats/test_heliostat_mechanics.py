"""True heliostats: published vectors, and the estimator's chains of steps, which share no code with them."""

import numpy as np
import pytest

from calibration.heliostat.kinematic_model import mirror_poses, presets
from data_synth.heliostats.mechanics import DriveFlaws, TrueHeliostat
from heliogauge.errors import InputError
from heliogauge.geometry.rays import reflect

POSITION = {"position_e": 0.0, "position_n": 0.0, "position_u": 0.0}
SINES = ("sin", "cos", "sin2", "cos2")
#: Numbers of a unit at Juelich, rounded.
ACTUATORS = (
    presets.ActuatorNumbers(0.0153, 0.0766, 0.3353, 0.3381, 154166.6667, False, (0, 69171)),
    presets.ActuatorNumbers(0.9359, 0.0764, 0.3408, 0.3191, 154166.6667, True, (0, 75641)),
)
PLACE = [3.0, 40.0, 2.0]
DESIGNS = {
    "azimuth-elevation": presets.azimuth_elevation("a", PLACE),
    "drone": presets.drone_heliostat("b", PLACE, (0.43, 0.24)),
    "six-error": presets.six_error("c", PLACE, arm_normal_m=0.2),
    "linear-actuators": presets.linear_actuators("d", PLACE, ACTUATORS, joints_m=((0.01, 0.02, 0.03), (0.1, 0.0, 0.2))),
}
FLAWS = (
    DriveFlaws(30.0, (1e-3, -2e-3, 5e-4, 3e-4), 1e-3, 0.2, 2e-3),
    DriveFlaws(50.0, (-1e-3, 1e-3, 2e-4, -3e-4), 5e-4, -0.1, 1e-3),
)


def direction(azimuth_deg, elevation_deg):
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    return np.array([[np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)]])


def disturbed(kind, rng, with_flaws=False):
    """Return the estimator's design and the true heliostat with the same errors."""
    design = DESIGNS[kind]
    flaws = (DriveFlaws(), DriveFlaws())
    if with_flaws:
        for drive, flaw in enumerate(FLAWS):
            design = presets.with_drive_terms(
                design, drive, ("worm2", "sag", "backlash"), worm_ratio=flaw.worm_ratio, sag_zero_rad=flaw.sag_zero_rad
            )
            waves = {f"worm_{part}_{drive + 1}": v for part, v in zip(SINES, flaw.worm_rad, strict=True)}
            design = design.with_value(
                {**waves, f"sag_{drive + 1}": flaw.sag_rad, f"backlash_{drive + 1}": flaw.backlash_rad}
            )
        flaws = FLAWS
    sizes = {"rad": 0.02, "m": 1e-3, "1/m": 50.0}
    own = [name for name in design.parameters.names if not name.startswith(("worm", "sag", "backlash"))]
    values = {
        name: design.parameters.value(name)
        + sizes[design.parameters.units[design.parameters.index(name)]] * rng.standard_normal()
        for name in own
    }
    limits = tuple((float(low), float(high)) for low, high in design.limits)
    clockwise = (False, True)
    return design.with_value(values), TrueHeliostat(kind, kind, values, flaws, clockwise=clockwise, limits=limits)


@pytest.mark.parametrize("with_flaws", [False, True])
@pytest.mark.parametrize("kind", DESIGNS)
def test_both_kinematics_agree_to_rounding(kind, with_flaws):
    rng = np.random.default_rng(4)
    for _ in range(5):
        design, true = disturbed(kind, rng, with_flaws)
        low, high = design.limits.T
        readings = low + (high - low) * rng.uniform(0.01, 0.99, (40, 2))
        approach = rng.integers(-1, 2, (40, 2)).astype(float)
        poses = true.poses(readings, approach)
        theirs = mirror_poses(design, design.parameters.values, readings, approach)
        np.testing.assert_allclose(theirs.normals(design), poses.normals, atol=1e-12)
        np.testing.assert_allclose(theirs.centre_m, poses.center_m, atol=1e-12)


@pytest.mark.parametrize("kind", DESIGNS)
def test_mirror_axes_are_a_right_handed_frame_that_stands_upright(kind):
    design, true = disturbed(kind, np.random.default_rng(1))
    low, high = design.limits.T
    readings = low + (high - low) * np.array([[0.5, 0.6], [0.45, 0.7]])
    rotation = true.poses(readings).rotation
    np.testing.assert_allclose(rotation @ rotation.swapaxes(1, 2), np.broadcast_to(np.eye(3), (2, 3, 3)), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(rotation), 1, atol=1e-14)
    assert (rotation[:, 2, 1] > 0).all()


@pytest.mark.parametrize("kind", DESIGNS)
def test_aim_sends_the_beam_to_the_point(kind):
    rng = np.random.default_rng(8)
    _, true = disturbed(kind, rng, with_flaws=True)
    sun = np.concatenate([direction(azimuth, 40) for azimuth in (120, 150, 180, 210, 240)])
    aim = np.array([[0.0, 0.0, 35.0]]) + rng.normal(0, 1, (5, 3)) * [1, 0, 1]
    readings = true.aim(sun, aim)
    poses = true.poses(readings)
    beam = reflect(-sun, poses.normals)
    wanted = aim - poses.center_m
    wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
    np.testing.assert_allclose(beam, wanted, atol=1e-11)


def test_a_point_behind_the_heliostat_is_out_of_reach():
    _, true = disturbed("linear-actuators", np.random.default_rng(3))
    assert np.isnan(true.aim(direction(0, 20), np.array([[3.0, 90.0, 5.0]]))).all()


# Gouws (2018): test vectors TV1 to TV4 recomputed from eqs. 5.1 to 5.49, lengths in m.
GOUWS_1 = {
    **POSITION,
    "arm_normal": 0.4325,
    "arm_up": 0.24,
    "pylon_length": 1.5,
    "tilt_about_east": 0.0,
    "tilt_about_north": 0.0,
    "azimuth_offset": 0.0,
    "elevation_offset": 0.0,
}
GOUWS_11 = {
    **GOUWS_1,
    "arm_normal": 0.3,
    "arm_up": 0.3,
    "tilt_about_north": np.radians(-1.0),
    "tilt_about_east": np.radians(1.5),
}
DRONE = np.array([[12.256711, 21.229246, 20.569204]])


@pytest.mark.parametrize(
    ("values", "aim", "source", "degrees", "center_mm"),
    [
        (GOUWS_1, (11, 27, 4.25), DRONE, (25.58994930, 23.75543547), (129.222201, 269.828998, 393.891082)),
        (GOUWS_1, (11, 27, 4.25), direction(340, 50), (5.87139678, 30.39924843), (25.737113, 250.274782, 425.859583)),
        (GOUWS_11, (-1, 7, 3), direction(340, 50), (-11.84911536, 33.97537219), (-50.103183, 29.225257, 417.273710)),
        (GOUWS_11, (-1, 7, 3), DRONE, (9.50754505, 29.64042997), (-14.759205, 60.820100, 411.390697)),
    ],
)
def test_published_pointing_of_the_drone_heliostat(values, aim, source, degrees, center_mm):
    true = TrueHeliostat("1", "drone", values)
    readings = true.aim(source, np.array([aim], dtype=float), at_infinity=bool(np.linalg.norm(source) < 2))
    # The printed drone stands to 1 um: 2e-6 deg.
    np.testing.assert_allclose(np.degrees(readings[0]), degrees, atol=2e-6)
    np.testing.assert_allclose(1e3 * true.poses(readings).center_m[0], center_mm, atol=1e-5)


# Malan (2014), section 4.2 at lat -33.9281, 2012-09-02 08:00 UTC: 1 mrad or 0.1 m each, offsets right and up [mm].
MALAN = {
    "tilt_north": (10.296, -61.094),
    "tilt_east": (39.585, 6.934),
    "azimuth_offset": (60.072, 21.397),
    "elevation_offset": (-14.640, 59.950),
    "non_orthogonality": (-38.210, -13.624),
    "position_u": (0.0, 95.100),
    "position_e": (84.862, 16.356),
    "position_n": (52.901, -26.238),
}


@pytest.mark.parametrize("name", MALAN)
def test_published_offsets_of_the_azimuth_elevation_heliostat(name):
    values = {
        "position_e": 19.2,
        "position_n": -30.8,
        "position_u": 1.2,
        **{key: 0.0 for key in MALAN if "pos" not in key},
    }
    true, sun = TrueHeliostat("2", "azimuth-elevation", values), direction(50.89712, 33.06455)
    aim = np.array([[0.0, 0.0, 13.0]])
    readings = true.aim(sun, aim)
    np.testing.assert_allclose(np.degrees(readings), [[6.2917, 32.4617]], atol=1e-4)
    changed = true.with_values({name: values[name] + (0.1 if "position" in name else 1e-3)})
    poses = changed.poses(readings)
    sight = (aim - true.position_m)[0] / np.linalg.norm(aim - true.position_m)
    right = np.cross(sight, [0, 0, 1]) / np.linalg.norm(np.cross(sight, [0, 0, 1]))
    beam = reflect(-sun, poses.normals)[0]
    start = poses.center_m[0] - aim[0]
    hit = start - beam * (start @ sight) / (beam @ sight)
    found = 1e3 * np.array([hit @ right, hit @ np.cross(right, sight)])
    np.testing.assert_allclose(found, MALAN[name], atol=2e-3)


def test_unknown_kinds_and_values_are_named():
    with pytest.raises(InputError, match="linear-actuators"):
        TrueHeliostat("x", "hexapod", {})
    with pytest.raises(InputError, match="tilt_up"):
        TrueHeliostat("x", "drone", GOUWS_1).with_values({"tilt_up": 1.0})
