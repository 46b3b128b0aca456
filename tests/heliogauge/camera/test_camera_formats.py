"""Parameters of other programs: OpenCV, COLMAP, photogrammetry in millimetres, and the change of direction."""

import re

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliogauge.camera.conversion import convert_direction
from heliogauge.camera.distortion import BrownDistortion, DistortionDirection
from heliogauge.camera.formats import COLMAP_MODELS, from_colmap, from_opencv, to_colmap, to_opencv
from heliogauge.camera.millimetres import (
    CAM_FROM_PHOTOGRAMMETRIC,
    SENSOR_NAMES,
    LensForm,
    PrincipalOrigin,
    Sensor,
    SensorParameters,
    sensor_parameters,
)
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform, rotation_from_omega_phi_kappa

MATRIX = np.array([[1510.0, 0, 803.2], [0, 1504.0, 622.9], [0, 0, 1]])
COEFFICIENTS = np.array([-0.21, 0.07, 1.2e-3, -0.8e-3, -0.01])
SIGMA = np.array([0.5, 0.6, 0.8, 0.7, 0, 1e-3, 2e-3, 1e-4, 1e-4, 1e-3])


def image_grid(camera, per_side=12):
    columns = np.linspace(-0.5, camera.width_px - 0.5, per_side)
    rows = np.linspace(-0.5, camera.height_px - 0.5, per_side)
    return np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)


def covariance():
    mixing = np.random.default_rng(3).normal(size=(10, 10)) * 0.2 + np.eye(10)
    return SIGMA[:, None] * (mixing @ mixing.T) * SIGMA


@pytest.mark.parametrize("size", [0, 4, 5, 8, 12, 14])
def test_opencv_parameters_of_every_length(size):
    coefficients = np.zeros(size)
    coefficients[: min(size, 5)] = COEFFICIENTS[: min(size, 5)]
    camera = from_opencv(MATRIX, coefficients, (1624, 1232))
    matrix, again = to_opencv(camera)
    np.testing.assert_array_equal(matrix, MATRIX)
    np.testing.assert_array_equal(again, np.pad(coefficients, (0, 5))[:5])
    assert (camera.width_px, camera.height_px) == (1624, 1232)


def test_opencv_without_distortion_and_as_a_column():
    assert from_opencv(MATRIX, None, (1624, 1232)).distortion.is_zero
    np.testing.assert_array_equal(to_opencv(from_opencv(MATRIX, COEFFICIENTS[:, None], (1624, 1232)))[1], COEFFICIENTS)


@pytest.mark.parametrize(
    ("matrix", "coefficients", "size", "message"),
    [
        (np.eye(4), None, (2, 2), r"OpenCV camera matrix: shape \(3, 3\) is needed"),
        (MATRIX.T, None, (2, 2), r"OpenCV camera matrix: \[\[fx, skew, cx\]"),
        (MATRIX, [0.1, 0.2], (2, 2), "4, 5, 8, 12 or 14 coefficients are needed, not 2"),
        (MATRIX, [0, 0, 0, 0, 0, 0.1, 0, 0], (2, 2), "rational, thin-prism or tilted terms"),
        (MATRIX, [np.nan, 0, 0, 0], (2, 2), "1 of 4 values are not finite"),
        (MATRIX, None, (2, 2, 3), r"image size: width and height are needed, not \(2, 2, 3\)"),
    ],
)
def test_impossible_opencv_parameters_are_refused(matrix, coefficients, size, message):
    with pytest.raises(InputError, match=message):
        from_opencv(matrix, coefficients, size)


def test_what_the_other_program_cannot_hold_is_refused():
    backward = BrownDistortion(k1=0.1, direction=DistortionDirection.MEASURED_TO_IDEAL)
    for write in (to_opencv, to_colmap):
        with pytest.raises(InputError, match="convert_direction first and mind the residual"):
            write(Camera(640, 480, 500.0, 500.0, 320.0, 240.0, distortion=backward))
        with pytest.raises(InputError, match="has no skew, this camera's is 2 px"):
            write(Camera(640, 480, 500.0, 500.0, 320.0, 240.0, skew=2.0))


def test_colmap_counts_pixels_from_the_corner():
    # A point on the optical axis of a camera whose COLMAP centre is the middle of a 640 x 480 image falls between the
    # four middle pixels, at (319.5, 239.5) counted from the centre of the first one.
    camera = from_colmap("PINHOLE", [500, 510, 320, 240], 640, 480)
    assert camera.project([0.0, 0.0, 1.0]).tolist() == [319.5, 239.5]
    np.testing.assert_allclose(camera.cast_rays([319.5, 239.5]), [0, 0, 1])


@pytest.mark.parametrize("model", COLMAP_MODELS)
def test_colmap_models_go_round(model):
    values = {
        "f": 500.0,
        "fx": 500.0,
        "fy": 510.0,
        "cx": 321.0,
        "cy": 243.0,
        "k1": -0.2,
        "k2": 0.05,
        "k3": 0.01,
        "p1": 1e-3,
        "p2": 2e-3,
        "k4": 0.0,
        "k5": 0.0,
        "k6": 0.0,
    }
    parameters = [values[name] for name in COLMAP_MODELS[model]]
    found, again = to_colmap(from_colmap(model, parameters, 640, 480))
    assert found == model
    np.testing.assert_array_equal(again, parameters)


def test_colmap_projection_is_opencv_s_shifted_by_half_a_pixel():
    camera = from_colmap("OPENCV", [1510, 1504, 803.7, 623.4, *COEFFICIENTS[:4]], 1624, 1232)
    points = np.random.default_rng(1).uniform([-0.5, -0.4, 0.9], [0.5, 0.4, 1.5], (50, 3))
    reference = cv2.projectPoints(points, np.zeros(3), np.zeros(3), MATRIX, COEFFICIENTS[:4])[0][:, 0]
    np.testing.assert_allclose(camera.project(points), reference, atol=1e-10)


@pytest.mark.parametrize(
    ("model", "parameters", "message"),
    [
        ("OPENCV_FISHEYE", np.zeros(8), "'OPENCV_FISHEYE': not part of Brown's model; use one of SIMPLE_PINHOLE"),
        ("RADIAL", [500, 320, 240], r"RADIAL \(f, cx, cy, k1, k2\): shape \(5\) is needed, not \(3,\)"),
        ("FULL_OPENCV", [500, 500, 320, 240, 0, 0, 0, 0, 0, 0.1, 0, 0], "k4, k5 and k6 must be zero"),
    ],
)
def test_impossible_colmap_parameters_are_refused(model, parameters, message):
    with pytest.raises(InputError, match=message):
        from_colmap(model, parameters, 640, 480)


PRINTED = {
    "focal_mm": 7.457,
    "principal_x_mm": 3.61546,
    "principal_y_mm": 2.61329,
    "K1": 0.00458861,
    "K2": -4.51351e-5,
    "K3": -2.05253e-6,
    "P1": -6.12803e-5,
    "P2": -4.41171e-5,
    "aspect": 0.000389598,
    "shear": 0.0,
}
BROWN = SENSOR_NAMES[LensForm.BROWN]


def photogrammetric(covariance=None, *, sensor=None, **changes):
    """The camera that DBAT prints: in millimetres, from the corner, y up."""
    conventions = {"pixel_mm": 5.43764 / 1704, "principal_origin": "corner", **(sensor or {})}
    values = {**PRINTED, **changes}
    spread = np.zeros((10, 10)) if covariance is None else covariance
    return SensorParameters(Sensor(2272, 1704, **conventions), [values[name] for name in BROWN], spread)


@pytest.mark.parametrize("y_up", [True, False])
def test_the_photogrammetric_equation_in_millimetres(y_up):
    # Owkes (2012) eq. 5.22 and 6.2 written out for one pixel: corner origin, y up or down.
    parameters = photogrammetric(sensor={"y_up": y_up}, aspect=0.0)
    up = 1 if y_up else -1
    pixel = np.array([1800.0, 300.0])
    _, x0, y0, k1, k2, k3, p1, p2, *_ = parameters.values
    x = (pixel[0] + 0.5) * parameters.sensor.pixel_mm - x0
    y = -up * ((pixel[1] + 0.5) * parameters.sensor.pixel_mm - y0)
    rr = x * x + y * y
    radial = k1 * rr + k2 * rr**2 + k3 * rr**3
    ideal_x = x + x * radial + p1 * (rr + 2 * x * x) + 2 * p2 * x * y
    ideal_y = y + y * radial + p2 * (rr + 2 * y * y) + 2 * p1 * x * y
    ray = parameters.camera().cast_rays(pixel)
    np.testing.assert_allclose(ray[:2] / ray[2] * 7.457, [ideal_x, -up * ideal_y], rtol=1e-13)


@pytest.mark.parametrize("y_up", [True, False])
def test_a_principal_point_from_the_centre_is_the_same_point_from_the_corner(y_up):
    corner = photogrammetric(sensor={"y_up": y_up})
    half = np.array([2272, 1704]) / 2 * corner.sensor.pixel_mm
    x0, y0 = (corner.values[1:3] - half) * [1, -1 if y_up else 1]
    from_center = {"y_up": y_up, "principal_origin": "center"}
    center = photogrammetric(sensor=from_center, principal_x_mm=x0, principal_y_mm=y0)
    np.testing.assert_allclose(center.camera().parameters, corner.camera().parameters, rtol=1e-13)


@pytest.mark.parametrize("y_up", [True, False])
@pytest.mark.parametrize("origin", list(PrincipalOrigin))
@pytest.mark.parametrize("shear", [0.0, 2e-4])
def test_photogrammetric_parameters_go_round_with_their_covariance(y_up, origin, shear):
    sigma = np.array([1e-3, 8e-4, 1e-3, 2e-5, 2.6e-6, 1e-7, 3.5e-6, 3.9e-6, 2e-5, 2e-5])
    mixing = np.random.default_rng(4).normal(size=(10, 10)) * 0.3 + np.eye(10)
    given_covariance = sigma[:, None] * (mixing @ mixing.T) * sigma
    conventions = {"y_up": y_up, "principal_origin": origin}
    given_parameters = photogrammetric(given_covariance, sensor=conventions, shear=shear)
    again = sensor_parameters(given_parameters.camera(), given_parameters.sensor)
    np.testing.assert_allclose(again.values[:8], given_parameters.values[:8], rtol=1e-12)
    np.testing.assert_allclose(again.values[8:], given_parameters.values[8:], atol=1e-15)
    scale = np.outer(sigma, sigma)
    np.testing.assert_allclose(again.covariance / scale, given_covariance / scale, atol=1e-9)


@pytest.mark.parametrize("origin", list(PrincipalOrigin))
@pytest.mark.parametrize("name", BROWN)
def test_each_photogrammetric_sigma_moves_the_camera_as_a_difference_does(name, origin):
    index = BROWN.index(name)
    only = np.zeros((10, 10))
    only[index, index] = 1.0
    carried = photogrammetric(only, sensor={"principal_origin": origin}).camera().covariance
    step = np.array([1e-3, 1e-3, 1e-3, 1e-6, 1e-8, 1e-9, 1e-6, 1e-6, 1e-5, 1e-5])[index]

    def moved(amount):
        changed = {name: PRINTED[name] + amount}
        return photogrammetric(sensor={"principal_origin": origin}, **changed).camera().parameters

    column = (moved(step) - moved(-step)) / (2 * step)
    np.testing.assert_allclose(carried, np.outer(column, column), atol=1e-6 * np.abs(column).max() ** 2)
    np.testing.assert_array_equal(carried == 0, np.outer(column, column) == 0)


def published_network(folder):
    """Poses and marks of DBAT's camera calibration example, in our conventions."""
    report = (folder / "result" / "report.txt").read_text()
    poses = []
    for block in re.split(r"Photo \d+: P\d+\.JPG", report)[1:22]:
        values = re.findall(r"(?:Omega|Phi|Kappa|Xc|Yc|Zc):\s+Value:\s+(\S+)", block)[:6]
        omega, phi, kappa, *center = map(float, values)
        rotation = CAM_FROM_PHOTOGRAMMETRIC @ rotation_from_omega_phi_kappa(*np.radians([omega, phi, kappa]))
        poses.append(RigidTransform(rotation, -rotation @ np.array(center)))
    lines = (folder / "measurements" / "markpts.txt").read_text().splitlines()
    marks = np.array([line.split(",") for line in lines if line.strip() and not line.startswith("#")], dtype=float)
    return poses, marks


def sum_of_squares_of_one_point(camera, poses, marks, fixed):
    """Adjust one point to its marks at fixed cameras and return the squares left over in the ideal image."""
    seen_by = [poses[int(photo) - 1] for photo in marks[:, 0]]
    rays = camera.cast_rays(marks[:, 2:4] - 0.5)
    point = fixed
    if point is None:
        turned = [pose.rotation.T @ ray for pose, ray in zip(seen_by, rays, strict=True)]
        across = [np.eye(3) - np.outer(ray, ray) for ray in turned]
        centers = [pose.inverse().translation_m for pose in seen_by]
        right_side = sum(matrix @ center for matrix, center in zip(across, centers, strict=True))
        point = np.linalg.solve(sum(across), right_side)
    perfect = Camera(
        camera.width_px, camera.height_px, camera.focal_y_px, camera.focal_y_px, camera.center_x_px, camera.center_y_px
    )
    ideal = perfect.project(rays)
    for _ in range(0 if fixed is not None else 4):
        projections = [perfect.project_posed(point, pose) for pose in seen_by]
        residual = np.concatenate([i - p.pixels_px for i, p in zip(ideal, projections, strict=True)])
        point = point + np.linalg.lstsq(np.concatenate([p.d_pixel_d_point for p in projections]), residual)[0]
    residual = ideal - np.array([perfect.project(pose.apply(point)) for pose in seen_by])
    return float((residual**2).sum())


def published_sigma0(folder, y_up):
    camera = photogrammetric(sensor={"y_up": y_up}).camera()
    poses, marks = published_network(folder)
    control = {1001: [0, 1, 0], 1002: [1, 1, 0], 1003: [0, 0, 0], 1004: [1, 0, 0]}
    total = 0.0
    for number in np.unique(marks[:, 1]).astype(int):
        fixed = np.array(control[number], dtype=float) if number in control else None
        total += sum_of_squares_of_one_point(camera, poses, marks[marks[:, 1] == number], fixed)
    assert len(marks) == 2074
    return float(np.sqrt(total / 3725))


@pytest.mark.slow
def test_a_published_calibration_gives_back_its_sigma0(shared_data):
    # DBAT prints 0.16148 px with a redundancy of 3725; its printed digits leave 1e-5 px.
    folder = shared_data / "photogrammetry" / "dbat_camcal"
    assert published_sigma0(folder, y_up=True) == pytest.approx(0.16148, abs=1.5e-5)
    # Negative control: the other sign of y in the tangential terms does not fit.
    assert published_sigma0(folder, y_up=False) > 0.24


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sensor": {"pixel_mm": 0.0}}, "pixel_mm: a positive number of mm is needed, not 0.0"),
        ({"focal_mm": 0.0}, "focal_mm: a positive number of mm is needed, not 0.0"),
        ({"K1": [1.0, 2.0]}, "sensor parameters"),
        ({"aspect": -1.0}, r"1 \+ aspect \(C1\): a positive number"),
        ({"sensor": {"principal_origin": "middle"}}, "principal_origin: one of corner, center is needed, not 'middle'"),
        (
            {"sensor": {"direction": "up"}},
            "direction: one of ideal_to_measured, measured_to_ideal is needed, not 'up'",
        ),
        ({"sensor": {"form": "fisheye"}}, "form: one of brown, aicon is needed, not 'fisheye'"),
    ],
)
def test_impossible_photogrammetric_parameters_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        photogrammetric(**changes).camera()


@given(
    st.floats(-0.2, 0.2),
    st.floats(-0.02, 0.02),
    st.floats(-1e-3, 1e-3),
    st.floats(-1e-3, 1e-3),
    st.sampled_from(list(DistortionDirection)),
)
def test_the_converted_lens_has_the_residual_it_states(k1, k2, p1, p2, direction):
    lens = BrownDistortion(k1=k1, k2=k2, p1=p1, p2=p2, direction=direction)
    camera = Camera(1624, 1232, 2200.0, 2210.0, 803.2, 622.9, skew=0.5, distortion=lens)
    other = next(d for d in DistortionDirection if d is not direction)
    fit = convert_direction(camera, other)
    assert fit.camera.distortion.direction is other
    assert fit.covered_share == 1.0
    pixels = image_grid(camera, 37)
    residual = np.hypot(*(fit.camera.project(camera.cast_rays(pixels)) - pixels).T)
    # The corners are nodes of the fit, so the largest residual is among them or between nodes at the rim.
    assert residual.max() <= 1.05 * fit.largest_residual_px + 1e-9
    assert fit.rms_residual_px <= fit.largest_residual_px
    assert fit.largest_residual_px < 0.5


def test_conversion_there_and_back_returns_the_lens():
    camera = from_opencv(MATRIX, COEFFICIENTS, (1624, 1232))
    there = convert_direction(camera, DistortionDirection.MEASURED_TO_IDEAL)
    back = convert_direction(there.camera, DistortionDirection.IDEAL_TO_MEASURED)
    np.testing.assert_allclose(back.camera.distortion.coefficients, COEFFICIENTS, atol=2e-3)
    same = convert_direction(camera, DistortionDirection.IDEAL_TO_MEASURED)
    assert same.camera is camera
    assert same.largest_residual_px == 0


def test_the_coefficients_are_those_of_least_squares():
    camera = from_opencv(MATRIX, COEFFICIENTS, (1624, 1232))
    fit = convert_direction(camera, DistortionDirection.MEASURED_TO_IDEAL)
    for index in range(5):
        for sign in (-1, 1):
            parameters = fit.camera.parameters.copy()
            parameters[5 + index] += sign * 1e-3 * np.abs(parameters[5 + index])
            pixels = np.stack(
                np.meshgrid(np.linspace(-0.5, 1623.5, 41), np.linspace(-0.5, 1231.5, 31)), axis=-1
            ).reshape(-1, 2)
            residual = fit.camera.with_parameters(parameters).project(camera.cast_rays(pixels)) - pixels
            assert np.sqrt((residual**2).sum(axis=1).mean()) > fit.rms_residual_px


def test_conversion_carries_the_uncertainty_of_image_points():
    camera = from_opencv(MATRIX, COEFFICIENTS, (1624, 1232)).with_covariance(covariance())
    fit = convert_direction(camera, DistortionDirection.MEASURED_TO_IDEAL)
    points = camera.cast_rays(image_grid(camera, 8))
    given_px2, fitted_px2 = (c.projection_covariance_px2(points) for c in (camera, fit.camera))
    scale = np.trace(given_px2, axis1=1, axis2=2)[:, None, None]
    np.testing.assert_allclose(fitted_px2 / scale, given_px2 / scale, atol=0.05)
    # And the derivative is that of the fit itself, but for residual times curvature (8 % of k2 here): convert a moved
    # camera.
    moved = camera.with_parameters(camera.parameters + 1e-2 * SIGMA)
    step = convert_direction(moved, DistortionDirection.MEASURED_TO_IDEAL).camera.parameters - fit.camera.parameters
    single = camera.with_covariance(np.outer(SIGMA, SIGMA))
    carried = convert_direction(single, DistortionDirection.MEASURED_TO_IDEAL).camera.sigma_parameters
    np.testing.assert_allclose(np.abs(step) * 100, carried, rtol=0.1, atol=1e-6)


def test_a_lens_that_leaves_out_part_of_the_image_says_how_much():
    lens = BrownDistortion(k1=-1 / 3)
    camera = Camera(1600, 1200, 1200.0, 1200.0, 799.5, 599.5, distortion=lens)
    try:
        share = convert_direction(camera, DistortionDirection.MEASURED_TO_IDEAL).covered_share
    except EstimationError as error:
        assert "fold; keep its own direction" in str(error)  # noqa: PT017
    else:
        assert 0.7 < share < 1.0
