"""Angles of the normal on steep mirrors, against rotations by another library."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from heliogauge.geometry.surfaces import Quadric, paraboloid, plane, trough
from heliogauge.slopes.map import CommonModes, SlopeMap, no_common_modes
from heliogauge.slopes.normal_angles import d_angles_d_slopes, normal_angles, tangents
from heliogauge.slopes.removal import Removal
from heliogauge.slopes.statistics import canting, statistics

# Focal length 1.71 m and an aperture of 5.472 m: slope 0.8 at the rim, as of an EuroTrough; the dish has it on its rim.
FOCAL_M = 1.71
TROUGH_X, TROUGH_Y = np.linspace(-2.736, 2.736, 31), np.linspace(-2.0, 2.0, 15)
DISH_X = np.linspace(-1.93, 1.93, 26)


def slope_map(x_m, y_m, slopes, design, *, sigma=(0.0, 0.0), common=None):
    full = np.ones((y_m.size, x_m.size))
    return SlopeMap(
        x_m=x_m,
        y_m=y_m,
        slope_x=slopes[0] * full,
        slope_y=slopes[1] * full,
        design_slope_x=design[0] * full,
        design_slope_y=design[1] * full,
        sigma_random_x=sigma[0] * full,
        sigma_random_y=sigma[1] * full,
        noise_correlation=1.0,
        common=common or no_common_modes(),
        height_m=0 * full,
        flags=0 * full,
        aperture=full > 0,
        design="steep",
        frame="mirror",
        removed="nothing",
    )


def turned(design, rotation_vectors):
    """Return slopes whose normals are the design's, each turned by its own rotation vector, shape (..., 3)."""
    normals = np.stack([-design[0], -design[1], np.ones(design[0].shape)], axis=-1)
    moved = (
        Rotation.from_rotvec(np.array(rotation_vectors).reshape(-1, 3))
        .apply(normals.reshape(-1, 3))
        .reshape(normals.shape)
    )
    return -moved[..., 0] / moved[..., 2], -moved[..., 1] / moved[..., 2]


def turned_by(design, angle_x, angle_y):
    """Return slopes that depart from the design by given angles of the normal in x and in y.

    In the map's axes a positive angle in x is a turn about -y, one in y a turn about x; the smallest rotation from z to
    the normal takes these axes to the mirror.
    """
    steepness = np.hypot(*design)
    axis = np.stack([design[1], -design[0], np.zeros(design[0].shape)], axis=-1)
    to_mirror = axis * (np.arctan(steepness) / np.where(steepness > 0, steepness, 1.0))[..., None]
    flat = np.stack(np.broadcast_arrays(angle_y, -angle_x, np.zeros(design[0].shape)), axis=-1)
    vectors = Rotation.from_rotvec(to_mirror.reshape(-1, 3)).apply(flat.reshape(-1, 3))
    return turned(design, vectors.reshape(flat.shape))


def design_slopes(surface: Quadric, x_m, y_m):
    return surface.gradient(*np.meshgrid(x_m, y_m))


@pytest.mark.parametrize("angle_rad", [1e-3, -1e-3])
def test_one_milliradian_on_a_steep_trough_is_one_milliradian(angle_rad):
    design = design_slopes(trough(FOCAL_M), TROUGH_X, TROUGH_Y)
    assert design[0].max() == pytest.approx(0.8)
    # About the trough's axis y: towards +x is the Observer's theta_r, and the slope falls.
    slopes = turned(design, np.broadcast_to([0.0, angle_rad, 0.0], (*design[0].shape, 3)))
    result = statistics(slope_map(TROUGH_X, TROUGH_Y, slopes, design))
    assert (result.sdx_rad, result.sd_rad) == pytest.approx((1e-3, 1e-3), rel=1e-10)
    assert result.sdy_rad < 1e-15
    assert result.mean_x_rad == pytest.approx(-angle_rad, rel=1e-10)
    assert result.focus_deviation_m(50.0) == pytest.approx((0.1, 0.0, 0.1), rel=1e-10, abs=1e-13)
    theta_r = np.arctan(design[0]) - np.arctan(slopes[0])
    np.testing.assert_allclose(-normal_angles(*slopes, *design)[0], theta_r, rtol=1e-10)
    # The same number as dz/dx is 1.64 mrad at the rim.
    assert np.abs(slopes[0] - design[0]).max() == pytest.approx(1.641e-3, rel=2e-3)


def test_turns_along_a_steep_trough_are_in_y_alone():
    design = design_slopes(trough(FOCAL_M), TROUGH_X, TROUGH_Y)
    # About the tangent across the trough: the normal turns towards -y.
    across = np.stack([np.ones(design[0].shape), np.zeros(design[0].shape), design[0]], axis=-1)
    slopes = turned(design, 1e-3 * across / np.linalg.norm(across, axis=-1, keepdims=True))
    result = statistics(slope_map(TROUGH_X, TROUGH_Y, slopes, design))
    assert (result.sdy_rad, result.mean_y_rad, result.sd_rad) == pytest.approx((1e-3, 1e-3, 1e-3), rel=1e-10)
    assert result.sdx_rad < 1e-15


def test_both_components_on_a_dish():
    design = design_slopes(paraboloid(FOCAL_M), DISH_X, DISH_X)
    assert np.hypot(*design).max() == pytest.approx(0.8, abs=0.01)
    result = statistics(slope_map(DISH_X, DISH_X, turned_by(design, 0.6e-3, -0.8e-3), design))
    found = result.sdx_rad, result.sdy_rad, result.sd_rad, result.mean_x_rad, result.mean_y_rad
    assert found == pytest.approx((0.6e-3, 0.8e-3, 1e-3, 0.6e-3, -0.8e-3), rel=1e-9)
    # Whatever the directions: every normal turned by 1 mrad is an SD of 1 mrad, shared by x and y in squares.
    way = np.random.default_rng(3).uniform(0, 2 * np.pi, design[0].shape)
    mixed = turned_by(design, 1e-3 * np.cos(way), 1e-3 * np.sin(way))
    result = statistics(slope_map(DISH_X, DISH_X, mixed, design))
    assert result.sd_rad == pytest.approx(1e-3, rel=1e-9)
    assert result.sdx_rad == pytest.approx(1e-3 * np.sqrt(np.mean(np.cos(way) ** 2)), rel=1e-9)


def test_a_turn_of_the_whole_dish_is_that_turn_at_its_vertex_and_less_where_it_points_along_the_normal():
    design = design_slopes(paraboloid(FOCAL_M), DISH_X, np.array([0.0]))
    slopes = turned(design, np.broadcast_to([0.0, 1e-3, 0.0], (*design[0].shape, 3)))
    np.testing.assert_allclose(normal_angles(*slopes, *design)[0], -1e-3, rtol=1e-10)
    along = design_slopes(paraboloid(FOCAL_M), np.array([0.0]), DISH_X)
    slopes = turned(along, np.broadcast_to([0.0, 1e-3, 0.0], (*along[0].shape, 3)))
    whole = np.hypot(*normal_angles(*slopes, *along))
    np.testing.assert_allclose(whole, 1e-3 * np.cos(np.arctan(along[1])), rtol=1e-6)


def test_on_a_flat_mirror_the_angles_are_the_slope_errors():
    rng = np.random.default_rng(4)
    error = rng.normal(0, 1e-3, (2, 15, 31))
    result = statistics(slope_map(TROUGH_X, TROUGH_Y, error, design_slopes(plane(), TROUGH_X, TROUGH_Y)))
    assert (result.sdx_rad, result.sdy_rad) == pytest.approx(np.sqrt(np.mean(error**2, axis=(1, 2))), rel=1e-5)


def test_after_removal_the_angles_are_of_the_normals_too():
    design = design_slopes(trough(FOCAL_M), TROUGH_X, TROUGH_Y)
    rng = np.random.default_rng(5)
    wave = rng.normal(0, 1e-3, design[0].shape)
    slopes = design[0] + 2e-3 + wave, design[1]
    left = np.arctan(slopes[0] - np.mean(slopes[0] - design[0])) - np.arctan(design[0])
    result = statistics(slope_map(TROUGH_X, TROUGH_Y, slopes, design), removed=Removal.TILT)
    assert result.sdx_rad == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-9)


@given(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(-0.02, 0.02), st.floats(-0.02, 0.02))
def test_the_components_make_the_whole_angle(p, q, dp, dq):
    measured, design = np.array([-p - dp, -q - dq, 1.0]), np.array([-p, -q, 1.0])
    whole = np.arctan2(np.linalg.norm(np.cross(design, measured)), design @ measured)
    components = normal_angles(*np.array([p + dp, q + dq, p, q]))
    assert np.hypot(*components) == pytest.approx(whole, rel=1e-9, abs=1e-15)
    # e_x and e_y are of unit length, square to each other and to the normal.
    frame = np.vstack([tangents(np.array(p), np.array(q)), design / np.linalg.norm(design)])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-14)


@pytest.mark.parametrize(("p", "q"), [(0.0, 0.0), (0.8, 0.0), (0.0, -0.8), (0.6, 0.5)])
def test_the_derivative_is_that_of_the_angles(p, q):
    step, at = 1e-6, np.array([p, q])
    central = [
        (normal_angles(*(at + move), *at) - normal_angles(*(at - move), *at)) / (2 * step) for move in step * np.eye(2)
    ]
    np.testing.assert_allclose(d_angles_d_slopes(*at), np.stack(central, axis=1), atol=1e-9)
    if q == 0:
        assert d_angles_d_slopes(*at)[0, 0] == pytest.approx(1 / (1 + p**2), rel=1e-12)


def test_canting_of_a_steep_facet_is_the_turn_of_its_normals():
    design = tuple(np.full((15, 31), value) for value in (0.6, 0.5))
    sigma, pose = (1e-4, 3e-4), np.zeros((1, 2, 1))
    pose[0, 0, 0] = 2e-4
    common = CommonModes(("mirror pose",), pose, [0.0, 0.0], 1.0)
    result = canting(slope_map(TROUGH_X, TROUGH_Y, turned_by(design, 3e-3, -4e-3), design, sigma=sigma, common=common))
    np.testing.assert_allclose(result.components_rad, [3e-3, -4e-3], rtol=1e-9)
    assert result.angle_rad == pytest.approx(5e-3, rel=1e-9)
    by_slope = d_angles_d_slopes(*np.array([0.6, 0.5]))
    expected = by_slope @ np.diag([1e-8 / 465 + 4e-8, 9e-8 / 465]) @ by_slope.T
    np.testing.assert_allclose(result.covariance_components_rad2, expected, rtol=2e-2)


@pytest.mark.parametrize("surface", [trough(FOCAL_M), paraboloid(FOCAL_M)], ids=["trough", "dish"])
@pytest.mark.parametrize("removal", [Removal.NOTHING, Removal.FOCUS])
def test_errors_of_the_statistics_of_steep_mirrors_are_as_large_as_their_sigma(surface, removal):
    """Forty measurements with noise and common errors: whitened, they have a variance of one."""
    rng = np.random.default_rng(7)
    design = design_slopes(surface, DISH_X, DISH_X)
    x, y = np.meshgrid(DISH_X, DISH_X)
    slopes = turned_by(design, 1e-3 * np.sin(2 * x + y), 1e-3 * np.cos(3 * y - x))
    common = CommonModes(("pose", "camera"), rng.normal(0, 3e-5, (2, 2, 6)), [0.0, 0.0], 1.93)
    shapes, sigma = common.evaluate(x, y), (6e-5, 1.2e-4)
    true = statistics(slope_map(DISH_X, DISH_X, slopes, design), removed=removal)
    whitened = []
    for _ in range(40):
        shared = np.tensordot(rng.normal(size=2), shapes, axes=1)
        noise = rng.normal(size=(2, *x.shape)) * np.array(sigma)[:, None, None]
        measured = slope_map(DISH_X, DISH_X, np.stack(slopes) + shared + noise, design, sigma=sigma, common=common)
        one = statistics(measured, removed=removal)
        noise_rms = one.noise_rms_x_rad, one.noise_rms_y_rad, np.hypot(one.noise_rms_x_rad, one.noise_rms_y_rad)
        whitened.append(
            [
                (np.sqrt(getattr(one, f"{name}_rad") ** 2 - rms**2) - getattr(true, f"{name}_rad"))
                / getattr(one, f"sigma_{name}_rad")
                for name, rms in zip(("sdx", "sdy", "sd"), noise_rms, strict=True)
            ]
        )
    # Chi-square of 40: 22.2 to 63.7 holds 98 %.
    squares = np.sum(np.square(whitened), axis=0)
    assert ((squares > 22.2) & (squares < 63.7)).all(), squares
