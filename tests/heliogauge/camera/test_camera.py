"""The camera model: projection and rays as inverses, derivatives, uncertainty, agreement with OpenCV."""

import math
import tracemalloc

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliogauge.camera.distortion import BrownDistortion, DistortionDirection
from heliogauge.camera.formats import from_opencv
from heliogauge.camera.model import PARAMETER_NAMES, Camera
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform

BOTH = list(DistortionDirection)
# A wide lens (92 degrees across, 115 along the diagonal) that is one-to-one over the whole image.
WIDE_MATRIX = np.array([[1000.0, 0, 811.5], [0, 1000.0, 615.5], [0, 0, 1]])
WIDE_DISTORTION = np.array([-0.2646, 0.065, 0, 0, -0.006])


def camera_of(direction=DistortionDirection.IDEAL_TO_MEASURED, skew=1.7, covariance=None):
    lens = BrownDistortion(k1=-0.21, k2=0.07, k3=-0.01, p1=1.2e-3, p2=-0.8e-3, direction=direction)
    camera = Camera(1624, 1232, 1510.0, 1504.0, 803.2, 622.9, skew=skew, distortion=lens)
    return camera if covariance is None else camera.with_covariance(covariance)


def image_grid(camera, per_side=15):
    columns = np.linspace(-0.5, camera.width_px - 0.5, per_side)
    rows = np.linspace(-0.5, camera.height_px - 0.5, per_side)
    return np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)


cameras = st.builds(
    lambda fx, fy, cx, cy, skew, k, direction: Camera(
        640, 480, fx, fy, cx, cy, skew=skew, distortion=BrownDistortion(*k, direction=direction)
    ),
    st.floats(400, 3000),
    st.floats(400, 3000),
    st.floats(200, 440),
    st.floats(150, 330),
    st.floats(-5, 5),
    st.tuples(
        st.floats(-0.35, 0.35),
        st.floats(-0.1, 0.1),
        st.floats(-0.03, 0.03),
        st.floats(-3e-3, 3e-3),
        st.floats(-3e-3, 3e-3),
    ),
    st.sampled_from(BOTH),
)


@given(cameras, st.floats(0.01, 1000))
def test_project_undoes_cast_rays_to_1e_10_px(camera, distance):
    pixels = image_grid(camera)
    rays = camera.cast_rays(pixels)
    seen = np.isfinite(rays).all(axis=-1)
    assert seen[(np.abs(pixels - [camera.center_x_px, camera.center_y_px]) < 60).all(axis=-1)].all()
    np.testing.assert_allclose(np.linalg.norm(rays[seen], axis=-1), 1, rtol=1e-15)
    np.testing.assert_allclose(camera.project(distance * rays[seen]), pixels[seen], atol=1e-10, rtol=0)


def test_projection_by_hand():
    camera = Camera(640, 480, 500.0, 600.0, 319.5, 239.5, skew=10.0)
    np.testing.assert_allclose(camera.project([[0.2, -0.1, 2.0]]), [[319.5 + 50 - 0.5, 239.5 - 30]], rtol=1e-15)
    assert (camera.project([0.0, 0.0, 1.0]) == [319.5, 239.5]).all()


def test_rays_follow_the_axes_of_the_camera_frame():
    # x right, y down, z forward: a pixel to the right of and below the principal point looks to +x and +y.
    ray = camera_of().cast_rays([1000.0, 900.0])
    assert (ray > 0).all()


@pytest.mark.parametrize("direction", BOTH)
def test_what_is_behind_the_camera_has_no_image(direction):
    camera = camera_of(direction)
    points = np.array([[0.1, 0.1, -1.0], [0.1, 0.1, 0.0], [0, 0, 0], [0.1, 0.1, 1.0], [np.nan, 0, 1]])
    expected = [False, False, False, True, False]
    assert np.isfinite(camera.project(points)).all(axis=1).tolist() == expected
    pixels, d_point, _ = camera.project_with_jacobians(points)
    assert np.isfinite(pixels).all(axis=1).tolist() == expected
    assert np.isfinite(d_point).all(axis=(1, 2)).tolist() == expected


def test_projection_agrees_with_opencv():
    matrix = np.array([[1510.0, 0, 803.2], [0, 1504.0, 622.9], [0, 0, 1]])
    coefficients = np.array([-0.21, 0.07, 1.2e-3, -0.8e-3, -0.01])
    camera = from_opencv(matrix, coefficients, (1624, 1232))
    points = np.random.default_rng(1).uniform([-0.5, -0.4, 0.9], [0.5, 0.4, 1.5], (500, 3))
    reference = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, coefficients)[0][:, 0]
    np.testing.assert_allclose(camera.project(points), reference, atol=1e-11)


def test_jacobians_agree_with_opencv():
    matrix = np.array([[1510.0, 0, 803.2], [0, 1504.0, 622.9], [0, 0, 1]])
    coefficients = np.array([-0.21, 0.07, 1.2e-3, -0.8e-3, -0.01])
    camera = from_opencv(matrix, coefficients, (1624, 1232))
    points = np.random.default_rng(1).uniform([-0.5, -0.4, 0.9], [0.5, 0.4, 1.5], (50, 3))
    reference = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, coefficients)[1].reshape(50, 2, -1)
    posed = camera.project_posed(points, RigidTransform.identity())
    # OpenCV's order: rotation vector, translation, fx, fy, cx, cy, k1, k2, p1, p2, k3. At zero rotation its derivative
    # with respect to the rotation vector is that of a small turn.
    np.testing.assert_allclose(posed.d_pixel_d_pose, reference[..., :6], atol=1e-9)
    without_skew = np.delete(posed.d_pixel_d_parameters, 4, axis=-1)
    np.testing.assert_allclose(without_skew, reference[..., 6:15], atol=1e-9)


def wide_border_and_opencv_result(criteria):
    camera = from_opencv(WIDE_MATRIX, WIDE_DISTORTION, (1624, 1232))
    columns, rows = np.arange(1624.0), np.arange(1232.0)
    border = np.concatenate(
        [np.stack(np.broadcast_arrays(columns, r), -1) for r in (0.0, 1231.0)]
        + [np.stack(np.broadcast_arrays(c, rows), -1) for c in (0.0, 1623.0)]
    )
    arguments = () if criteria is None else (None, None, None, criteria)
    ideal = cv2.undistortPoints(border[:, None], WIDE_MATRIX, WIDE_DISTORTION, *arguments)[:, 0]
    points = np.concatenate((ideal, np.ones((ideal.shape[0], 1))), axis=1)
    return camera, border, points


def test_negative_control_opencv_default_undistortion_is_3_8_px_wrong_on_a_wide_lens():
    camera, border, points = wide_border_and_opencv_result(None)
    assert camera.invertible_region().whole_image
    error = np.hypot(*(camera.project(points) - border).T)
    assert error.max() == pytest.approx(3.8, abs=0.05)
    own = np.hypot(*(camera.project(camera.cast_rays(border)) - border).T)
    assert own.max() < 1e-11


def test_rays_of_the_wide_lens_agree_with_opencv_run_to_its_limit():
    camera, border, points = wide_border_and_opencv_result((3, 10000, 1e-15))
    rays = points / np.linalg.norm(points, axis=1)[:, None]
    np.testing.assert_allclose(camera.cast_rays(border), rays, atol=1e-13)


@pytest.mark.parametrize("direction", BOTH)
@pytest.mark.parametrize("step", [1, 7])
def test_the_ray_grid_is_the_rays_of_the_pixel_centres(direction, step):
    camera = Camera(320, 241, 300.0, 301.0, 150.0, 122.0, distortion=camera_of(direction).distortion)
    columns, rows = np.meshgrid(np.arange(0.0, 320, step), np.arange(0.0, 241, step))
    expected = camera.cast_rays(np.stack((columns, rows), axis=-1))
    assert camera.ray_grid(step).shape == (*columns.shape, 3)
    np.testing.assert_allclose(camera.ray_grid(step), expected, atol=2e-16)


def test_casting_all_rays_needs_little_memory_beyond_the_result():
    camera = camera_of()
    camera.ray_grid(200)
    tracemalloc.start()
    rays = camera.ray_grid()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak - rays.nbytes < 4 * 2**20


@pytest.mark.parametrize("direction", BOTH)
def test_projection_jacobians_against_central_differences(direction):
    camera = camera_of(direction)
    points = camera.cast_rays(image_grid(camera, 6)) * np.linspace(0.5, 5, 36)[:, None]
    pose = RigidTransform.from_rotation_vector([0.3, -0.2, 0.5], [0.1, 0.2, -0.4])
    in_frame = pose.inverse().apply(points)
    posed = camera.project_posed(in_frame, pose)
    np.testing.assert_allclose(posed.pixels_px, camera.project(points), atol=1e-10)

    def check(jacobian, function, size, step):
        for column in range(size):
            move = np.zeros(size)
            move[column] = step[column]
            numeric = (function(move) - function(-move)) / (2 * step[column])
            scale = np.abs(numeric).max()
            np.testing.assert_allclose(jacobian[..., column], numeric, atol=1e-7 * scale)

    small = np.full(6, 1e-5)
    check(camera.project_with_jacobians(points)[1], lambda d: camera.project(points + d), 3, small)
    check(posed.d_pixel_d_point, lambda d: camera.project(pose.apply(in_frame + d)), 3, small)
    check(posed.d_pixel_d_pose, lambda d: camera.project(pose.moved(d).apply(in_frame)), 6, small)
    steps = np.array([0.1, 0.1, 0.1, 0.1, 0.1, 1e-4, 1e-4, 1e-5, 1e-5, 1e-4])
    check(
        posed.d_pixel_d_parameters,
        lambda d: camera.with_parameters(camera.parameters + d).project(points),
        10,
        steps,
    )


@pytest.mark.parametrize("direction", BOTH)
def test_ray_jacobians_against_central_differences(direction):
    camera = camera_of(direction)
    pixels = image_grid(camera, 6)
    rays, d_pixel, d_parameters = camera.cast_rays_with_jacobians(pixels)
    np.testing.assert_allclose(rays, camera.cast_rays(pixels), atol=4e-16)
    for column in range(2):
        move = 0.05 * np.eye(2)[column]
        numeric = (camera.cast_rays(pixels + move) - camera.cast_rays(pixels - move)) / 0.1
        np.testing.assert_allclose(d_pixel[..., column], numeric, atol=1e-7 * np.abs(numeric).max())
    steps = np.array([0.1, 0.1, 0.1, 0.1, 0.1, 1e-4, 1e-4, 1e-5, 1e-5, 1e-4])
    for column in range(10):
        move = steps[column] * np.eye(10)[column]
        plus = camera.with_parameters(camera.parameters + move).cast_rays(pixels)
        minus = camera.with_parameters(camera.parameters - move).cast_rays(pixels)
        numeric = (plus - minus) / (2 * steps[column])
        np.testing.assert_allclose(d_parameters[..., column], numeric, atol=2e-7 * np.abs(numeric).max())


@pytest.mark.parametrize("direction", BOTH)
def test_structural_zeros_are_true_zeros(direction):
    camera = camera_of(direction)
    points = camera.cast_rays(image_grid(camera, 5))
    d_parameters = camera.project_with_jacobians(points)[2]
    zero = [(0, "focal_y_px"), (0, "center_y_px"), (1, "focal_x_px"), (1, "center_x_px"), (1, "skew")]
    for row, name in zero:
        assert (d_parameters[:, row, PARAMETER_NAMES.index(name)] == 0).all(), name
    assert (d_parameters[:, 0, 2] == 1).all()
    assert (d_parameters[:, 1, 3] == 1).all()
    # Without lens and skew, columns know nothing of y and rows nothing of x.
    perfect = Camera(640, 480, 500.0, 510.0, 320.0, 240.0)
    d_point = perfect.project_with_jacobians(points)[1]
    assert (d_point[:, 0, 1] == 0).all()
    assert (d_point[:, 1, 0] == 0).all()


def random_covariance(seed=0):
    sigma = np.array([0.5, 0.6, 0.8, 0.7, 0.05, 1e-3, 2e-3, 1e-4, 1e-4, 1e-3])
    mixing = np.random.default_rng(seed).normal(size=(10, 10)) * 0.2 + np.eye(10)
    return sigma[:, None] * (mixing @ mixing.T) * sigma


@pytest.mark.slow
@pytest.mark.parametrize("direction", BOTH)
def test_carried_uncertainty_agrees_with_drawn_cameras(direction):
    camera = camera_of(direction, covariance=random_covariance())
    pixels = np.array([[100.0, 50.0], [800.0, 600.0], [1600.0, 1200.0]])
    points = 3.0 * camera.cast_rays(pixels)
    rng = np.random.default_rng(5)
    drawn = [
        camera.with_parameters(camera.parameters + d)
        for d in rng.multivariate_normal(np.zeros(10), camera.covariance, 1500, method="cholesky")
    ]
    for values, covariance in (
        (np.array([c.project(points) for c in drawn]), camera.projection_covariance_px2(points)),
        (np.array([c.cast_rays(pixels) for c in drawn]), camera.ray_covariance(pixels)),
    ):
        centred = values - values.mean(axis=0)
        sampled = np.einsum("nki,nkj->kij", centred, centred) / (len(drawn) - 1)
        # 1500 draws know a variance to 3.7 %: five of those.
        scale = np.trace(covariance, axis1=1, axis2=2)[:, None, None]
        np.testing.assert_allclose(sampled / scale, covariance / scale, atol=0.18)
    expected = np.sqrt(np.trace(camera.ray_covariance(pixels), axis1=1, axis2=2))
    np.testing.assert_array_equal(camera.sigma_ray_rad(pixels), expected)


def test_uncertainty_of_a_ray_is_across_it_and_includes_the_image_point():
    camera = camera_of(covariance=random_covariance())
    pixels = image_grid(camera, 4)
    along = np.einsum("nij,nj->ni", camera.ray_covariance(pixels, 0.3), camera.cast_rays(pixels))
    assert np.abs(along).max() < 1e-15 * np.abs(camera.ray_covariance(pixels, 0.3)).max() * 10
    # An exact camera at its principal point: an image point of sigma s px turns the ray by sqrt(2) s / f.
    exact = Camera(640, 480, 500.0, 500.0, 320.0, 240.0)
    assert exact.sigma_ray_rad([320.0, 240.0], 0.1) == pytest.approx(math.sqrt(2) * 0.1 / 500)
    assert (exact.ray_covariance(pixels) == 0).all()


def test_parameters_go_round():
    camera = camera_of(DistortionDirection.MEASURED_TO_IDEAL, covariance=random_covariance())
    again = camera.with_parameters(camera.parameters)
    assert (again.parameters == camera.parameters).all()
    assert (again.covariance == camera.covariance).all()
    assert again.distortion.direction is DistortionDirection.MEASURED_TO_IDEAL
    assert [getattr(camera, name) for name in PARAMETER_NAMES[:5]] == camera.parameters[:5].tolist()
    assert [getattr(camera.distortion, name) for name in PARAMETER_NAMES[5:]] == camera.parameters[5:].tolist()
    np.testing.assert_allclose(camera.sigma_parameters**2, np.diag(camera.covariance))


@pytest.mark.parametrize("direction", BOTH)
def test_a_lens_that_folds_inside_the_image_is_named_with_its_radius(direction):
    # 1 + 3 k1 r^2 = 0 at r = 1: ideal radius 1 is measured at 2/3 (OpenCV's way); the other way, measured radius is 1.
    lens = BrownDistortion(k1=-1 / 3, direction=direction)
    camera = Camera(1600, 1200, 500.0, 500.0, 799.5, 599.5, distortion=lens)
    region = camera.invertible_region()
    assert not region.whole_image
    expected = 500 * 2 / 3 if direction is DistortionDirection.IDEAL_TO_MEASURED else 500.0
    assert region.radius == pytest.approx(1.0)
    assert region.radius_px == pytest.approx(expected)
    assert region.farthest_corner_px == pytest.approx(1000.0)
    assert f"{expected:.1f} px" in region.message
    assert "leaves out part of the image" in region.message
    pixels = image_grid(camera, 38)
    distance = np.hypot(*(pixels - [799.5, 599.5]).T)
    assert np.abs(distance - expected).min() > 1e-3, "a pixel on the edge itself proves nothing"
    np.testing.assert_array_equal(np.isfinite(camera.cast_rays(pixels)[:, 2]), distance < expected)
    # The region ends at an ideal radius of 1 one way and 2/3 the other.
    reach = 1.0 if direction is DistortionDirection.IDEAL_TO_MEASURED else 2 / 3
    assert np.isfinite(camera.project([[0.999 * reach, 0, 1.0]])).all()
    assert np.isnan(camera.project([[1.001 * reach, 0, 1.0], [3.0, 0, 1.0]])).all()


def test_a_lens_that_covers_the_image_says_so():
    assert camera_of().invertible_region().whole_image
    region = Camera(640, 480, 500.0, 500.0, 320.0, 240.0).invertible_region()
    assert region.whole_image
    assert "everywhere" in region.message
    assert math.isinf(region.radius_px)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"width_px": 0}, "width_px: a positive number of pixels is needed, not 0"),
        ({"height_px": 480.5}, "height_px: a whole number of pixels is needed, not 480.5"),
        ({"focal_x_px": -500.0}, "focal_x_px: a positive number of pixels is needed, not -500.0"),
        ({"center_x_px": math.nan}, "center_x_px: 1 of 1 values are not finite"),
        ({"skew": math.inf}, "skew: 1 of 1 values are not finite"),
        ({"covariance": np.eye(9)}, r"camera covariance: shape \(10, 10\) is needed, not \(9, 9\)"),
        ({"covariance": -np.eye(10)}, "camera covariance: .* negative variance"),
    ],
)
def test_impossible_cameras_are_refused(changes, message):
    arguments = {
        "width_px": 640,
        "height_px": 480,
        "focal_x_px": 500.0,
        "focal_y_px": 500.0,
        "center_x_px": 320.0,
        "center_y_px": 240.0,
    }
    with pytest.raises(InputError, match=message):
        Camera(**{**arguments, **changes})


def test_impossible_points_are_refused():
    camera = camera_of()
    with pytest.raises(InputError, match=r"points_m: shape \(\.\.\., 3\) is needed, not \(4, 2\)"):
        camera.project(np.zeros((4, 2)))
    with pytest.raises(InputError, match=r"pixels_px: shape \(\.\.\., 2\) is needed, not \(3,\)"):
        camera.cast_rays(np.zeros(3))
    with pytest.raises(InputError, match="step: a positive whole number of pixels is needed, not 0"):
        camera.ray_grid(0)
    with pytest.raises(InputError, match=r"camera parameters: shape \(10\) is needed, not \(9,\)"):
        camera.with_parameters(np.zeros(9))


@pytest.mark.parametrize("direction", BOTH)
def test_no_points_give_no_pixels(direction):
    camera = camera_of(direction)
    assert camera.project(np.zeros((0, 3))).shape == (0, 2)
    assert camera.cast_rays(np.zeros((0, 2))).shape == (0, 3)
    assert camera.project_with_jacobians(np.zeros((0, 3)))[2].shape == (0, 2, 10)
