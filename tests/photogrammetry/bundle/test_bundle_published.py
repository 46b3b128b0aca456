"""The published calibration of DBAT's demonstration, both lens models, from its image points alone."""

import csv

import numpy as np
import pytest

from heliogauge.adjust.least_squares import CovarianceScale
from heliogauge.camera.distortion import BrownDistortion, DistortionDirection
from heliogauge.camera.millimetres import CAM_FROM_PHOTOGRAMMETRIC, SENSOR_NAMES, LensForm, Sensor, sensor_parameters
from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import omega_phi_kappa_from_rotation
from photogrammetry.bundle.adjustment import BundleOptions, adjust
from photogrammetry.bundle.alignment import aligned_to_control
from photogrammetry.bundle.problem import BundleProblem, CameraModel, ResidualSpace
from photogrammetry.bundle.statistics import examine_image_points, examine_intrinsics
from photogrammetry.image_points import ImagePoints
from photogrammetry.start_values.network import build_network

PIXEL_MM = 5.43764 / 1704
SENSOR = Sensor(2272, 1704, PIXEL_MM, principal_origin="corner")
CONTROL = {"1001": [0.0, 1.0, 0.0], "1002": [1.0, 1.0, 0.0], "1003": [0.0, 0.0, 0.0], "1004": [1.0, 0.0, 0.0]}
LENS = ("center_x_px", "center_y_px", "k1", "k2", "k3", "p1", "p2")


@pytest.fixture(scope="module")
def marks(shared_data):
    path = shared_data / "photogrammetry" / "dbat_camcal" / "measurements" / "markpts.txt"
    if not path.is_file():
        pytest.skip("DBAT's demonstration is not on this machine")
    with path.open() as file:
        rows = [row for row in csv.reader(file, skipinitialspace=True) if row and not row[0].startswith("#")]
    pixels = np.array([[float(row[2]), float(row[3])] for row in rows]) - 0.5
    names = [row[0].strip() for row in rows], [row[1].strip() for row in rows]
    return ImagePoints.from_names(*names, pixels, np.broadcast_to(np.eye(2) * 0.01, (len(rows), 2, 2)))


def calibrated(marks, model, direction):
    """Start from a network that knows nothing but a focal length of 7.5 mm."""
    focal = 7.5 / PIXEL_MM
    guess = Camera(2272, 1704, focal, focal, 1135.5, 851.5, distortion=BrownDistortion(direction=direction))
    network = build_network(marks, [guess], models=[model])
    assert not network.photos_left_out
    assert not network.targets_left_out
    # Marks of the fixed points lie up to 0.95 px off; the published adjustment keeps all, so must this one.
    assert (network.observations.photos, network.observations.targets) == (marks.photos, marks.targets)
    state = aligned_to_control(network.state, network.observations.targets, CONTROL)
    problem = BundleProblem(marks, (model,), fixed=tuple(CONTROL))
    result = adjust(problem, state, options=BundleOptions(covariance_scale=CovarianceScale.POSTERIOR))
    assert result.converged, result.reason
    return result


@pytest.fixture(scope="module")
def backward(marks):
    model = CameraModel("c4040z", ("focal_px", "aspect", *LENS), residual=ResidualSpace.CORRECTED)
    return calibrated(marks, model, DistortionDirection.MEASURED_TO_IDEAL)


@pytest.mark.slow
def test_backward_model(backward):
    assert backward.redundancy == 3725
    assert backward.sigma0 / 10 == pytest.approx(0.161480, abs=5e-7)
    found = sensor_parameters(backward.cameras[0], SENSOR)
    value = dict(zip(SENSOR_NAMES[LensForm.BROWN], found.values, strict=True))
    deviation = dict(zip(SENSOR_NAMES[LensForm.BROWN], found.sigma, strict=True))
    # Value and deviation as printed in result/report.txt and result/c4040z.xml.
    printed = {
        "focal_mm": (7.45699532273933752, 0.00105),
        "principal_x_mm": (3.61546239970888994, 0.00082),
        "principal_y_mm": (2.61329279848268081, 0.00098),
        "aspect": (3.89598e-4, 2.08e-5),
        "K1": (0.00458860662755811253, 2.21e-5),
        "K2": (-4.51350997187018702e-05, 2.65e-6),
        "K3": (-2.05253370760761127e-06, 1.01e-7),
        "P1": (-6.12803065099492536e-05, 3.52e-6),
        "P2": (-4.41170561685059337e-05, 3.94e-6),
    }
    for name, (wanted, printed_deviation) in printed.items():
        assert value[name] == pytest.approx(wanted, abs=2e-4 * printed_deviation), name
        assert deviation[name] == pytest.approx(printed_deviation, rel=6e-3), name


def test_backward_model_residuals_and_points(backward):
    length = np.linalg.norm(backward.residuals_px, axis=1)
    worst = int(np.argmax(length))
    assert length[worst] == pytest.approx(0.955, abs=5e-4)
    assert backward.problem.observations.label(worst) == "target 1003 in photo 5"
    np.testing.assert_allclose(backward.sigma_points_m.max(axis=0), [5.0e-5, 5.3e-5, 8.5e-5], atol=0.5e-6)
    total = np.linalg.norm(backward.sigma_points_m, axis=1)
    assert total.max() == pytest.approx(0.00011, abs=5e-6)
    assert total[total > 0].min() == pytest.approx(8.2e-5, abs=5e-7)
    tests = {one.name: one for one in examine_intrinsics(backward)}
    assert tests["k2"].rival == "k3"
    joint = sensor_parameters(backward.cameras[0], SENSOR).covariance
    assert joint[4, 5] / np.sqrt(joint[4, 4] * joint[5, 5]) == pytest.approx(-0.979, abs=5e-4)
    assert all(tests[name].significance > 0.995 for name in ("k1", "k2", "k3", "p1", "p2", "aspect"))
    # The redundancy numbers add up to the redundancy: every image point counts once.
    numbers = examine_image_points(backward).redundancy
    assert np.einsum("mii->", numbers) == pytest.approx(3725, abs=1e-6)


def test_backward_model_stations(backward, shared_data):
    path = shared_data / "photogrammetry" / "dbat_camcal" / "result" / "camera_stations.txt"
    rows = [line.split(",") for line in path.read_text().splitlines() if line.strip() and not line.startswith("#")]
    photos = backward.problem.observations.photos
    for row in rows:
        photo = photos.index(row[1].strip())
        center, angles = np.array(row[2:5], float), np.array(row[5:8], float)
        np.testing.assert_allclose(backward.state.centers_m[photo], center, atol=2e-7)
        own = omega_phi_kappa_from_rotation(CAM_FROM_PHOTOGRAMMETRIC.T @ backward.state.rotations[photo])
        turn = (np.array(own) - angles + np.pi) % (2 * np.pi) - np.pi
        np.testing.assert_allclose(turn, 0, atol=2e-7)
        # Centre C = -R^T t: a turn w moves it by R^T (t x ... ) that cancels, a shift s by -R^T s.
        pose, covariance = backward.state.cam_from_world(photo), backward.covariance.poses[photo]
        cross = np.cross(np.eye(3), pose.translation_m)
        jacobian = np.hstack([-pose.rotation.T @ cross, -pose.rotation.T])
        sigma = np.sqrt(np.diag(jacobian @ covariance @ jacobian.T))
        printed = PRINTED_CENTER_SIGMA.get(photo_number(row))
        if printed is not None:
            np.testing.assert_allclose(sigma, printed, rtol=4e-3)


#: Photos 1 to 3 of result/report.txt [m].
PRINTED_CENTER_SIGMA = {
    1: [0.000155, 0.000179, 0.000207],
    2: [0.000186, 0.000219, 0.000232],
    3: [0.000188, 0.000179, 0.000243],
}


def photo_number(row):
    return int(row[0])


@pytest.mark.slow
def test_forward_model(marks):
    model = CameraModel("c4040z", ("focal_px", *LENS))
    result = calibrated(marks, model, DistortionDirection.IDEAL_TO_MEASURED)
    assert result.redundancy == 3726
    assert result.sigma0 / 10 == pytest.approx(0.162168, abs=5e-7)
