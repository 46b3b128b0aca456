"""Uncertainty over the image, comparison of calibrations, weak networks, start values."""

import numpy as np
import pytest

from calibration.camera.boards import Chessboard
from calibration.camera.corners.detection import BoardPoints
from calibration.camera.files.findings import sigma_of_shape
from calibration.camera.judgement.comparison import compare
from calibration.camera.judgement.network import check_network, coverage
from calibration.camera.judgement.projection_sigma import radial_profile, sigma_map
from calibration.camera.start_values.intrinsics import homography, start_camera, start_pose, tilt_and_roll
from heliogauge.camera.distortion import BrownDistortion
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import FloatArray

BOARD = Chessboard(9, 6, 0.03)
COVARIANCE = np.diag([0.5, 0.5, 0.3, 0.3, 0.0, 1e-4, 1e-3, 1e-5, 1e-5, 0.0]) ** 2


def camera(covariance: FloatArray | None = None) -> Camera:
    lens = BrownDistortion(k1=-0.1, k2=0.05, p1=1e-4)
    known = np.zeros((10, 10)) if covariance is None else covariance
    return Camera(640, 480, 620.0, 618.0, 322.0, 238.0, 0.0, lens, known)


def pose(tilt: float, azimuth: float, roll: float, distance_m: float) -> RigidTransform:
    axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    # Half a turn about x: the board faces the camera.
    turn = RigidTransform.from_rotation_vector(tilt * axis, [0, 0, distance_m])
    upright = RigidTransform.from_rotation_vector([np.pi, 0, 0], np.zeros(3))
    return turn @ RigidTransform.from_rotation_vector([0, 0, roll], np.zeros(3)) @ upright


def seen(one: Camera, at: RigidTransform, name: str = "a.png") -> BoardPoints:
    pixels = one.project(at.apply(BOARD.points_m))
    return BoardPoints(name, np.arange(54), pixels, np.tile(1e-4 * np.eye(2), (54, 1, 1)))


GOOD = [pose(0.6 * (k % 3 > 0), 1.1 * k, 0.8 * (k % 3), 0.4 + 0.1 * (k % 3)) for k in range(9)]


def test_sigma_map_against_random_cameras() -> None:
    one = camera(COVARIANCE)
    found = sigma_map(one, 2.0)
    rng = np.random.default_rng(1)
    pixels = np.stack(np.meshgrid(found.x_px, found.y_px), axis=-1)
    rays = one.cast_rays(pixels)
    moved, shifts = [], []
    for _ in range(300):
        other = one.with_parameters(one.parameters + np.sqrt(np.diag(COVARIANCE)) * rng.standard_normal(10))
        moved.append(((other.cast_rays(pixels) - rays) ** 2).sum(axis=-1))
        shifts.append(((other.project(2.0 * rays) - pixels) ** 2).sum(axis=-1))
    # 300 draws: the standard deviation is known to 4 %.
    assert np.abs(np.sqrt(np.mean(moved, axis=0)) / found.sigma_ray_rad - 1).max() < 0.15
    assert np.abs(np.sqrt(np.mean(shifts, axis=0)) / found.sigma_projection_px - 1).max() < 0.15
    assert (found.sigma_free_rad <= found.sigma_ray_rad * 1.3).all()
    assert found.rms_free_rad < found.rms_ray_rad


def test_principal_point_is_nearly_a_rotation() -> None:
    alone = np.zeros((10, 10))
    alone[2, 2] = 1.0
    found = sigma_map(Camera(640, 480, 2000.0, 2000.0, 319.5, 239.5, covariance=alone))
    # A shift of 1 px is 0.5 mrad; what no rotation explains is second order in the field of 9 deg.
    assert found.rms_ray_rad == pytest.approx(5e-4, rel=0.03)
    assert found.rms_free_rad < 0.02 * found.rms_ray_rad


def test_comparison_takes_the_rotation_out() -> None:
    one = camera(COVARIANCE)
    moved = one.with_parameters(one.parameters + [0, 0, 0.5, 0, 0, 0, 0, 0, 0, 0])
    found = compare(one, moved)
    assert found.rms_rad < 0.15 * 0.5 / 620
    assert abs(found.rotation_rad[1]) == pytest.approx(0.5 / 620, rel=0.1)
    longer = compare(one, one.with_parameters(one.parameters * [1.001, 1.001, *np.ones(8)]))
    # At the corner, 33 deg off axis: d angle = 0.001 sin cos.
    assert longer.largest_rad == pytest.approx(0.001 * np.sin(0.57) * np.cos(0.57), rel=0.1)
    with pytest.raises(InputError, match="640 x 480"):
        compare(one, Camera(320, 240, 300.0, 300.0, 160.0, 120.0))
    with pytest.raises(InputError, match="no covariance"):
        sigma_map(camera())


def test_radial_profile() -> None:
    found = radial_profile(camera(COVARIANCE), np.array([[322.0, 38.0]]))
    r = found.radius_px / 619
    np.testing.assert_allclose(found.shift_px, 619 * (-0.1 * r**3 + 0.05 * r**5), atol=1e-9)
    np.testing.assert_allclose(found.sigma_px, 619 * np.hypot(1e-4 * r**3, 1e-3 * r**5), rtol=0.01, atol=1e-12)
    assert found.seen_px == 200.0


def test_doubts_name_what_is_weak() -> None:
    one = camera()
    every = np.stack(np.meshgrid(np.linspace(0, 639, 30), np.linspace(0, 479, 30)), axis=-1).reshape(-1, 2)
    full = coverage(one, every)
    assert (full.share, round(full.radius_share, 3)) == (1.0, 1.0)
    assert list(check_network(GOOD, full)) == []
    cases = {
        "photos_few": (GOOD[1:5], full),
        "network_flat": ([pose(0.1, k, 0.8 * (k % 3), 0.4 + 0.1 * (k % 3)) for k in range(9)], full),
        "network_without_roll": ([pose(0.6 * (k % 3 > 0), 1.1 * k, 0.0, 0.4 + 0.1 * (k % 3)) for k in range(9)], full),
        "network_without_depth": ([pose(0.6 * (k % 3 > 0), 1.1 * k, 0.8 * (k % 3), 0.4) for k in range(9)], full),
        "coverage_poor": (GOOD, coverage(one, 0.3 * every + [220, 170])),
    }
    for code, (poses, covered) in cases.items():
        assert [one.code for one in check_network(poses, covered)] == [code]


def test_start_values() -> None:
    plain = Camera(640, 480, 620.0, 620.0, 319.5, 239.5)
    matrices = [homography(seen(plain, at), BOARD.points_m) for at in GOOD]
    found, doubt = start_camera(matrices, 640, 480)
    assert doubt is None
    assert found.focal_x_px == pytest.approx(620, rel=1e-6)
    start = start_pose(matrices[4], plain)
    np.testing.assert_allclose(start.rotation, GOOD[4].rotation, atol=1e-6)
    np.testing.assert_allclose(start.translation_m, GOOD[4].translation_m, atol=1e-6)
    tilt, _ = tilt_and_roll(GOOD[4])
    assert tilt == pytest.approx(0.6)
    straight = [homography(seen(plain, pose(0.0, 0.0, 0.1 * k, 0.5)), BOARD.points_m) for k in range(4)]
    _, doubt = start_camera(straight, 640, 480)
    assert doubt is not None
    assert doubt.code == "board_never_tilted"


def test_points_that_are_no_view_of_the_board() -> None:
    good = seen(camera(), GOOD[1])
    mixed = good.pixels_px[np.random.default_rng(0).permutation(54)]
    with pytest.raises(EstimationError, match=r"a\.png: .* of 54 points are far from"):
        homography(BoardPoints("a.png", good.index, mixed, good.covariance_px2), BOARD.points_m)
    line = np.arange(54) < 9
    with pytest.raises(EstimationError, match="on one line"):
        homography(good.subset(line), BOARD.points_m)


def test_sigma_of_shape_ignores_the_frame() -> None:
    points = BOARD.points_m + np.random.default_rng(2).normal(0, 1e-3, (54, 3))
    noise = 1e-10 * np.eye(162)
    shift = np.tile(np.eye(3), (54, 1))
    np.testing.assert_allclose(
        sigma_of_shape(points, noise + shift @ shift.T), sigma_of_shape(points, noise), rtol=1e-4
    )
    # Seven of 162 dimensions are gone.
    assert (sigma_of_shape(points, noise) ** 2).sum() == pytest.approx(155e-10, rel=1e-6)
