"""The chain of rigid steps: published numbers, derivatives, forward and back, and what it refuses."""

import pickle

import numpy as np
import pytest

from calibration.heliostat.kinematic_model.actuators import drive_angle, drive_reading
from calibration.heliostat.kinematic_model.aiming import aim
from calibration.heliostat.kinematic_model.kinematics import mirror_poses, pose_derivatives
from calibration.heliostat.kinematic_model.presets import (
    azimuth_elevation,
    drone_heliostat,
    linear_actuators,
    six_error,
    two_axes,
    with_drive_terms,
)
from heliogauge.errors import InputError
from heliogauge.geometry.rays import intersect_plane, reflect
from heliogauge.geometry.rigid import vector_from_rotation
from tests.calibration.heliostat_models import ACTUATORS, POSITION, all_models, readings_within
from tests.derivatives import central_differences, check_jacobian

MODELS = all_models()
AIM = np.array([0.0, 0.0, 13.0])


def direction(azimuth_deg, elevation_deg):
    azimuth, elevation = np.deg2rad([azimuth_deg, elevation_deg])
    return np.stack(
        [np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)], axis=-1
    )


SUN = direction(50.89712, 33.06455)


# --- Malan (2014): ideal normal, and 1 mrad or 0.1 m of each error on the plane across the line of sight -------------


def offsets_mm(design, readings, sun=SUN, position=POSITION):
    """Beam's place on the plane through the aim point across the nominal line of sight: right, up [mm]."""
    poses = mirror_poses(design, design.parameters.values, readings)
    beam = reflect(-sun, poses.normals(design))
    sight = AIM - position
    right = np.cross(sight, [0, 0, 1])
    up = np.cross(right, sight)
    hit = poses.centre_m + intersect_plane(poses.centre_m, beam, AIM, sight)[:, None] * beam - AIM
    return 1e3 * np.stack([hit @ right / np.linalg.norm(right), hit @ up / np.linalg.norm(up)], axis=-1)


def test_ideal_normal_of_malan():
    design = azimuth_elevation("prototype", POSITION)
    found = aim(design, design.parameters.values, SUN, AIM)
    np.testing.assert_allclose(np.rad2deg(found.readings), [[6.2917, 32.4617]], atol=5e-5)
    np.testing.assert_allclose(found.normals, [[0.09247, 0.83867, 0.53674]], atol=5e-6)
    assert found.miss_rad.max() < 1e-15


@pytest.mark.parametrize(
    ("name", "size", "expected_mm"),
    [
        ("tilt_north", 1e-3, (10.296, -61.094)),
        ("tilt_east", 1e-3, (39.585, 6.934)),
        ("azimuth_offset", 1e-3, (60.072, 21.397)),
        ("elevation_offset", 1e-3, (-14.640, 59.950)),
        ("non_orthogonality", 1e-3, (-38.210, -13.624)),
        ("position_u", 0.1, (0.0, 95.100)),
        ("position_e", 0.1, (84.862, 16.356)),
        ("position_n", 0.1, (52.901, -26.238)),
    ],
)
def test_each_error_of_malan_moves_the_beam_as_published(name, size, expected_mm):
    design = azimuth_elevation("prototype", POSITION)
    readings = aim(design, design.parameters.values, SUN, AIM).readings
    np.testing.assert_allclose(offsets_mm(design, readings), 0, atol=1e-10)
    moved = design.with_value({name: design.parameters.value(name) + size})
    # The published numbers carry three decimals and a sun of five.
    np.testing.assert_allclose(offsets_mm(moved, readings)[0], expected_mm, atol=1.2e-3)


def test_printed_tilts_are_the_toward_tilts_to_first_order():
    toward = azimuth_elevation("t", POSITION).with_value({"tilt_north": 1e-4, "tilt_east": -2e-4})
    printed = azimuth_elevation("p", POSITION, printed_tilts=True).with_value({"tilt_north": 2e-4, "tilt_east": 1e-4})
    normals = [mirror_poses(d, d.parameters.values, [[0.3, 0.6]]).normals(d) for d in (toward, printed)]
    np.testing.assert_allclose(*normals, atol=1e-7)


def test_inverse_of_malan_in_closed_form():
    """Spec's formula for readings from a wanted normal, by its own route."""
    values = {
        "tilt_north": -13.27e-3,
        "tilt_east": -4.56e-3,
        "non_orthogonality": -1.92e-3,
        "azimuth_offset": -3.79e-3,
        "elevation_offset": 1.12e-3,
    }
    design = azimuth_elevation("prototype", POSITION).with_value(values)
    found = aim(design, design.parameters.values, SUN, AIM)
    north, east, epsilon = values["tilt_north"], values["tilt_east"], values["non_orthogonality"]
    about_east = np.array([[1, 0, 0], [0, np.cos(north), np.sin(north)], [0, -np.sin(north), np.cos(north)]])
    about_north = np.array([[np.cos(east), 0, np.sin(east)], [0, 1, 0], [-np.sin(east), 0, np.cos(east)]])
    bisector = SUN + (AIM - POSITION) / np.linalg.norm(AIM - POSITION)
    e, n, z = (about_east @ about_north).T @ bisector / np.linalg.norm(bisector)
    elevation = np.arcsin(z / np.cos(epsilon))
    azimuth = np.arctan2(e, n) + np.arctan2(np.sin(elevation) * np.sin(epsilon), np.cos(elevation))
    expected = [azimuth - values["azimuth_offset"], elevation - values["elevation_offset"]]
    np.testing.assert_allclose(found.readings[0], expected, atol=1e-14)


# --- Gouws (2018): TV1 to TV6 ----------------------------------------------------------------------------------------


def gouws(target_mm, arm_mm, **angles_deg):
    design = drone_heliostat("drone", -1e-3 * np.array(target_mm), 1e-3 * np.array(arm_mm))
    return design.with_value({name: np.deg2rad(angle) for name, angle in angles_deg.items()})


FIRST = gouws((11000, 27000, 4250), (432.5, 240), elevation_offset=3, azimuth_offset=-3)
CHANGED = gouws(
    (-1000, 7000, 3000), (300, 300), elevation_offset=-0.5, azimuth_offset=1, tilt_about_north=-1, tilt_about_east=1.5
)
DRONE = 32.0 * direction(30.0, 40.0)


@pytest.mark.parametrize(
    ("design", "source", "finite", "elevation_azimuth_deg", "arm_mm"),
    [
        (FIRST, DRONE, True, (23.75543547, 25.58994930), (129.222201, 269.828998, 393.891082)),
        (FIRST, direction(-20, 50), False, (30.39924843, 5.87139678), (25.737113, 250.274782, 425.859583)),
        (CHANGED, direction(-20, 50), False, (33.97537219, -11.84911536), (-50.103183, 29.225257, 417.273710)),
        (CHANGED, DRONE, True, (29.64042997, 9.50754505), (-14.759205, 60.820100, 411.390697)),
    ],
    ids=["TV1", "TV2", "TV3", "TV4"],
)
def test_vectors_of_gouws(design, source, finite, elevation_azimuth_deg, arm_mm):
    source = source + design.position_m if finite else source
    found = aim(design, design.parameters.values, source, np.zeros(3), finite=finite)
    np.testing.assert_allclose(np.rad2deg(found.angles_rad[0, ::-1]), elevation_azimuth_deg, atol=1.5e-8)
    np.testing.assert_allclose(1e3 * (found.centre_m[0] - design.position_m), arm_mm, atol=1.5e-6)
    offsets = design.parameters.values[design.parameters.indices(("azimuth_offset", "elevation_offset"))]
    np.testing.assert_allclose(found.readings, found.angles_rad + offsets, atol=1e-15)


@pytest.mark.parametrize(
    ("turn_deg", "miss_mm"), [((0.0, 0.1), (4.36344, 0, 99.29846)), ((0.1, 0.0), (87.74134, 0, -8.31395))]
)
def test_misses_of_gouws(turn_deg, miss_mm):
    """TV5 and TV6: 0.1 degree of elevation or azimuth, read on the vertical plane through the target."""
    sun = direction(-20, 50)
    readings = aim(FIRST, FIRST.parameters.values, sun, np.zeros(3)).readings + np.deg2rad(turn_deg)
    poses = mirror_poses(FIRST, FIRST.parameters.values, readings)
    beam = reflect(-sun, poses.normals(FIRST))
    hit = poses.centre_m + intersect_plane(poses.centre_m, beam, np.zeros(3), [0, 1, 0])[:, None] * beam
    np.testing.assert_allclose(1e3 * hit[0], miss_mm, atol=1.5e-5)  # angles of the table end at 1e-8 degree


@pytest.mark.parametrize(
    ("declination_deg", "azimuth_elevation_mrad_s"),
    [(-22.0, (0.0424, 0.0209)), (-6.6, (0.0403, 0.0193)), (0.0, (0.0387, 0.0183)), (23.0, (0.0317, 0.0146))],
    ids=["January", "October", "equinox", "June"],
)
def test_tracking_rates_of_gouws(declination_deg, azimuth_elevation_mrad_s):
    """V10: rates of both axes at ten o'clock solar time, the sun by hand."""
    declination, latitude = np.deg2rad(declination_deg), np.deg2rad(-33.927)
    hours = np.deg2rad(15 * (np.array([9.9, 10.1]) - 12))
    east = -np.cos(declination) * np.sin(hours)
    north = np.sin(declination) * np.cos(latitude) - np.cos(declination) * np.sin(latitude) * np.cos(hours)
    up = np.sin(declination) * np.sin(latitude) + np.cos(declination) * np.cos(latitude) * np.cos(hours)
    found = aim(FIRST, FIRST.parameters.values, np.stack([east, north, up], axis=-1), np.zeros(3))
    rates = 1e3 * np.abs(np.diff(found.angles_rad, axis=0)[0]) / 720.0
    np.testing.assert_allclose(rates, azimuth_elevation_mrad_s, atol=3e-4)


# --- Sun, Guo et al.: six errors and a pivot offset, with the spec's reconstruction as the other route ---------------


def test_six_errors_against_the_reconstructed_equations():
    angles = {
        "tilt_north": 4e-3,
        "tilt_east": -7e-3,
        "non_orthogonality": 5e-3,
        "canting": -6e-3,
        "azimuth_offset": 3e-3,
        "elevation_offset": -2e-3,
    }
    design = six_error("s", POSITION, arm_normal_m=0.4).with_value(angles)
    found = aim(design, design.parameters.values, SUN, AIM)
    toward = AIM - POSITION
    distance, canting, tau1 = np.linalg.norm(toward), angles["canting"], angles["non_orthogonality"]
    toward = toward / distance
    half = np.arccos(SUN @ toward) / 2
    tau = half
    for _ in range(50):
        tau = half + 0.5 * np.arcsin(0.4 * np.sin(tau) / distance)
    normal = (np.sin(2 * half - tau) * SUN + np.sin(tau) * toward) / np.sin(2 * half)
    bare = six_error("tilts", POSITION).with_value({k: angles[k] for k in ("tilt_north", "tilt_east")})
    tilt = mirror_poses(bare, bare.parameters.values, [[0.0, 0.0]]).rotation[0]
    east, north, up = tilt.T @ normal
    elevation = np.arcsin((up - np.sin(canting) * np.sin(tau1)) / (np.cos(canting) * np.cos(tau1)))
    c1 = np.cos(canting) * np.cos(elevation)
    c2 = np.sin(canting) * np.cos(tau1) - np.cos(canting) * np.sin(elevation) * np.sin(tau1)
    azimuth = np.arctan2(c1 * east - c2 * north, c1 * north + c2 * east)
    np.testing.assert_allclose(found.normals[0], normal, atol=1e-14)
    np.testing.assert_allclose(
        found.readings[0], [azimuth + angles["azimuth_offset"], elevation + angles["elevation_offset"]], atol=1e-13
    )


def test_two_axes_are_azimuth_and_elevation_if_they_say_so():
    """Errors of the general model that are the published ones under other names."""
    same = {"offset_1": 4e-3, "offset_2": 5e-3, "non_orthogonality": 6e-3}
    general = two_axes("g", POSITION, [[0, 0, -1], [1, 0, 0]], (0, 1, 0)).with_value(
        same | {"lean_along": -2e-3, "lean_across": 3e-3}
    )
    # Axis 1 looks down, so what leans toward the second axis (east) or the common perpendicular (south) is its foot.
    named = azimuth_elevation("n", POSITION).with_value(
        {"azimuth_offset": 4e-3, "elevation_offset": 5e-3, "non_orthogonality": 6e-3}
        | {"tilt_north": 3e-3, "tilt_east": 2e-3}
    )
    readings = [[0.4, 0.7], [-1.2, 0.3]]
    normals = [mirror_poses(d, d.parameters.values, readings).normals(d) for d in (general, named)]
    # The order of the two leans is another: their product.
    np.testing.assert_allclose(*normals, atol=1e-5)


@pytest.mark.parametrize(
    ("axes", "normal", "message"),
    [
        ([[0, 0, 1], [0, 0, 2]], (0, 1, 0), "parallel"),
        ([[0, 0, 1], [1, 0, 0]], (-3, 0, 0), "parallel"),
        ([[0, 0, 0], [1, 0, 0]], (0, 1, 0), "axis 1: a vector of length zero"),
    ],
)
def test_two_axes_that_cannot_point_a_mirror(axes, normal, message):
    with pytest.raises(InputError, match=message):
        two_axes("t", POSITION, axes, normal)


# --- For every model -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MODELS)
def test_derivatives(name):
    design = MODELS[name]
    readings, approach = readings_within(design, 5), np.array([[1, -1], [-1, 0], [0, 1], [1, 1], [-1, -1]])
    values = design.parameters.values
    found = pose_derivatives(design, values, readings, approach)
    steps = np.array([{"rad": 1e-3, "m": 1e-3, "1/m": 20.0, "1": 3e-5}[unit] for unit in design.parameters.units])
    turned = found.poses.rotation

    def motion(state):
        """Rotation vector from here, and the centre."""
        poses = mirror_poses(design, state, readings, approach)
        small = [vector_from_rotation(after @ here.T) for after, here in zip(poses.rotation, turned, strict=True)]
        return np.concatenate([np.array(small), poses.centre_m], axis=1)

    differences = central_differences(motion, values, np.add, steps)
    check_jacobian(np.concatenate([found.omega, found.shift], axis=1), differences, relative=2e-8)
    alone = mirror_poses(design, values, readings, approach)
    np.testing.assert_array_equal(alone.rotation, found.poses.rotation)
    np.testing.assert_array_equal(alone.centre_m, found.poses.centre_m)


@pytest.mark.parametrize("name", MODELS)
def test_some_columns_are_those_columns(name):
    design = MODELS[name]
    readings, columns = readings_within(design, 4), np.arange(len(design.parameters))[::-2]
    everything = pose_derivatives(design, design.parameters.values, readings)
    some = pose_derivatives(design, design.parameters.values, readings, columns=columns)
    np.testing.assert_array_equal(some.columns, columns)
    np.testing.assert_allclose(some.omega, everything.omega[:, :, columns], atol=1e-15)
    np.testing.assert_allclose(some.shift, everything.shift[:, :, columns], atol=1e-15)


@pytest.mark.parametrize("finite", [False, True], ids=["sun", "drone"])
@pytest.mark.parametrize("name", MODELS)
def test_forward_and_back(name, finite):
    """Aim where a reading sends the light: the same reading must come out."""
    design, values = MODELS[name], MODELS[name].parameters.values
    readings, approach = readings_within(design, 200), np.sign(np.random.default_rng(2).normal(size=(200, 2)))
    poses = mirror_poses(design, values, readings, approach)
    normals = poses.normals(design)
    rng = np.random.default_rng(3)
    sun = normals + 0.6 * rng.normal(size=normals.shape)
    sun /= np.linalg.norm(sun, axis=1)[:, None]
    front = (sun * normals).sum(axis=1) > 0.3
    target = poses.centre_m + 40.0 * reflect(-sun, normals)
    source = poses.centre_m + 15.0 * sun if finite else sun
    # The bare pole of azimuth and elevation, where azimuth means nothing, is 1 - |n.z| away.
    usual = front & (np.abs(normals[:, 2]) < 0.999)
    found = aim(design, values, source[usual], target[usual], finite=finite, approach=approach[usual])
    assert found.converged.all()
    assert found.within_limits.all()
    span = np.diff(design.limits, axis=1).T
    np.testing.assert_allclose(found.readings / span, readings[usual] / span, atol=1e-12)
    assert usual.sum() > 60


@pytest.mark.parametrize("name", MODELS)
def test_each_drive_forward_and_back(name):
    design = MODELS[name]
    numbers = dict(zip(design.parameters.names, design.parameters.values, strict=True))
    readings = readings_within(design, 50)
    for axis, drive in enumerate(design.drives):
        for approach in (-np.ones(50), np.ones(50)):
            there = drive_angle(drive, numbers, readings[:, axis], approach)
            back = drive_reading(drive, numbers, there.angle_rad, approach)
            np.testing.assert_allclose(back, readings[:, axis], rtol=1e-12, atol=1e-12 * np.ptp(design.limits[axis]))
            size = 1e-5 * np.ptp(design.limits[axis])
            ends = [drive_angle(drive, numbers, readings[:, axis] + s * size, approach).angle_rad for s in (-1, 1)]
            np.testing.assert_allclose(there.per_reading, (ends[1] - ends[0]) / (2 * size), rtol=1e-5)


# --- What each optional term does -----------------------------------------------------------------------------------


def test_backlash_is_by_direction_of_the_last_move():
    design = MODELS["azimuth_elevation_terms"].with_value({"backlash_1": 2e-3})
    numbers = dict(zip(design.parameters.names, design.parameters.values, strict=True))
    angles = [drive_angle(design.drives[0], numbers, np.array([0.3]), np.array([a])).angle_rad[0] for a in (-1, 0, 1)]
    np.testing.assert_allclose(np.diff(angles), [1e-3, 1e-3], atol=1e-15)


def test_worm_repeats_every_twelve_degrees_at_thirty_to_one():
    """Malan's V-14: one cycle per 360/30 degrees of the output shaft, wherever the offset puts it."""
    design = azimuth_elevation("w", POSITION)
    worm = MODELS["azimuth_elevation_terms"].drives[1]
    numbers = dict.fromkeys(MODELS["azimuth_elevation_terms"].parameters.names, 0.0)
    numbers |= {"scale_2": 1.0, "worm_sin_2": 1.5e-3}
    worm = type(worm)(worm.offset, scale=worm.scale, terms=MODELS["azimuth_elevation_terms"].drives[0].terms)
    assert design.limits[1, 1] == np.pi / 2
    readings = np.deg2rad(np.arange(0.0, 24.0, 1.0))
    numbers |= {"worm_sin_1": 1.5e-3}
    error = drive_angle(worm, numbers, readings).angle_rad - readings
    np.testing.assert_allclose(error, 1.5e-3 * np.sin(30 * readings), atol=1e-16)
    np.testing.assert_allclose(error[:12], error[12:], atol=1e-15)


def test_sag_bends_most_when_the_mirror_stands_upright():
    numbers = dict.fromkeys(MODELS["azimuth_elevation_terms"].parameters.names, 0.0) | {"scale_2": 1.0, "sag_2": -1e-3}
    drive = MODELS["azimuth_elevation_terms"].drives[1]
    error = drive_angle(drive, numbers, np.array([0.1, 0.1 + np.pi / 2])).angle_rad - [0.1, 0.1 + np.pi / 2]
    np.testing.assert_allclose(error, [-1e-3, 0.0], atol=1e-15)


# --- Refusals and limits --------------------------------------------------------------------------------------------


def test_readings_outside_the_triangle_are_named():
    design = linear_actuators("BE36", POSITION, ACTUATORS)
    values, readings = design.parameters.values, np.array([[30000.0, 30000.0], [30000.0, 95000.0]])
    with pytest.raises(InputError, match=r"BE36: row 1: reading 95000 of axis 2 .*offset_2.*acos\(-1\.2162"):
        mirror_poses(design, values, readings)
    poses = mirror_poses(design, values, readings, outside="nan")
    assert np.isfinite(poses.rotation[0]).all()
    assert np.isnan(poses.rotation[1]).all()
    with pytest.raises(InputError, match="reading 0 of axis 1"):
        mirror_poses(
            design.with_value({"offset_1": 0.1}),
            design.with_value({"offset_1": 0.1}).parameters.values,
            [[40000.0, 30000.0]],
        )
    with pytest.raises(InputError, match="row 1: the reading of axis 1 is not a number"):
        mirror_poses(design, values, [[30000.0, 1.0], [np.nan, 1.0]])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"readings": np.zeros((3, 3))}, r"readings: shape \(n, 2\)"),
        ({"values": np.zeros(3)}, r"values: shape \(8,\)"),
        ({"approach": np.zeros((4, 2))}, r"approach: shape \(3, 2\)"),
    ],
)
def test_shapes_that_do_not_fit(change, message):
    design = azimuth_elevation("a", POSITION)
    given = {"values": design.parameters.values, "readings": np.zeros((3, 2)), "approach": None} | change
    with pytest.raises(InputError, match=message):
        mirror_poses(design, given["values"], given["readings"], given["approach"])
    with pytest.raises(InputError, match="do not go together"):
        aim(design, design.parameters.values, np.ones((3, 3)), np.ones((2, 3)))


def test_what_cannot_be_reached_is_said():
    design = linear_actuators("l", (0.0, 50.0, 2.0), ACTUATORS)
    aims = np.tile(AIM, (3, 1))
    # Sun in the south, in the north (the mirror would have to look at the ground behind it), and straight opposite.
    opposite = (np.array([0.0, 50.0, 2.0]) - AIM) / np.linalg.norm([0.0, 50.0, -11.0])
    found = aim(design, design.parameters.values, np.stack([direction(170, 40), direction(0, -30), opposite]), aims)
    assert found.within_limits.tolist() == [True, False, False]
    assert found.converged[0]
    assert not found.converged[2]


def test_a_worm_that_runs_backwards_is_not_called_solved():
    """Forty times what a worm may do: whatever Newton's method ends with is judged by where the beam goes."""
    design = with_drive_terms(azimuth_elevation("w", POSITION), 1, ("worm",), worm_ratio=180.0)
    design = design.with_value({"worm_sin_2": 0.2})
    suns = direction(np.linspace(20, 80, 50), np.linspace(20, 60, 50))
    found = aim(design, design.parameters.values, suns, AIM)
    poses = mirror_poses(design, design.parameters.values, found.readings)
    toward = AIM - poses.centre_m
    miss = np.linalg.norm(
        reflect(-suns, poses.normals(design)) - toward / np.linalg.norm(toward, axis=1)[:, None], axis=1
    )
    np.testing.assert_array_equal(found.converged, miss < 1e-9)
    np.testing.assert_allclose(found.miss_rad, miss, atol=1e-12, rtol=1e-3)


@pytest.mark.parametrize("away", [1e-2, 1e-6, 1e-10, 0.0])
def test_straight_up_is_a_direction_too(away):
    """At the pole any azimuth will do; the beam still has to arrive."""
    design = azimuth_elevation("z", np.zeros(3))
    toward = np.array([0.6, 0.0, 0.8])
    sun = reflect(-toward, [away, 0.0, 1.0])
    found = aim(design, design.parameters.values, sun, 50 * toward)
    assert found.converged.all()
    leaning = design.with_value({"non_orthogonality": 1e-3})
    unreachable = aim(leaning, leaning.parameters.values, reflect(-toward, [0.0, 0.0, 1.0]), 50 * toward)
    assert not unreachable.converged[0]
    assert np.isnan(unreachable.readings).all()


def test_a_drone_may_come_near():
    """At 3 m a mirror on an arm of half a metre sees the drone move as it turns."""
    directions = np.abs(np.random.default_rng(4).normal(size=(200, 3)))
    drone = FIRST.position_m + 3.0 * directions / np.linalg.norm(directions, axis=1)[:, None]
    found = aim(FIRST, FIRST.parameters.values, drone, np.array([0.0, 0.0, 2.0]), finite=True)
    assert found.converged.all()
    assert found.miss_rad.max() < 1e-13


def test_the_first_initial_angle_is_a_tilt_under_another_name():
    """Which is why the fit with 15 parameters of two linear actuators has one combination too many."""
    design = linear_actuators("l", POSITION, ACTUATORS)
    columns = design.parameters.indices(("initial_angle_1", "tilt_2_e"))
    found = pose_derivatives(design, design.parameters.values, readings_within(design, 9), columns=columns)
    np.testing.assert_allclose(found.omega[:, :, 0], found.omega[:, :, 1], atol=1e-15)
    np.testing.assert_allclose(found.shift[:, :, 0], found.shift[:, :, 1], atol=1e-15)


@pytest.mark.parametrize("name", MODELS)
def test_designs_go_to_other_processes(name):
    design = MODELS[name]
    copy = pickle.loads(pickle.dumps(design))
    readings = readings_within(design, 3)
    here, there = (mirror_poses(d, d.parameters.values, readings).rotation for d in (design, copy))
    np.testing.assert_array_equal(here, there)


def test_no_number_of_rows_is_too_small():
    design = azimuth_elevation("a", POSITION)
    assert mirror_poses(design, design.parameters.values, np.zeros((0, 2))).rotation.shape == (0, 3, 3)
    assert pose_derivatives(design, design.parameters.values, np.zeros((0, 2))).omega.shape == (0, 3, 8)
