"""Comparison of calibrations, weak networks, files for other programs, and what a report shows."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.camera.corners.detection import BoardPoints
from calibration.camera.files.result_folder import opencv_yaml
from calibration.camera.judgement.comparison import compare
from calibration.camera.judgement.network import check_photos, same_views
from calibration.camera.judgement.projection_sigma import covariance_root
from heliogauge.camera.distortion import BrownDistortion
from heliogauge.camera.formats import from_opencv
from heliogauge.camera.model import Camera
from heliogauge.errors import InputError

#: Correlated as in a real calibration: focal lengths move together, k1 against k2.
SIGMA = np.array([0.3, 0.3, 0.2, 0.2, 0.0, 1e-3, 4e-3, 2e-4, 2e-4, 0.0])


def known_camera() -> Camera:
    correlation = np.eye(10)
    correlation[0, 1] = correlation[1, 0] = 0.9
    correlation[5, 6] = correlation[6, 5] = -0.8
    lens = BrownDistortion(k1=-0.1, k2=0.05, p1=1e-4)
    return Camera(640, 480, 620.0, 618.0, 322.0, 238.0, 0.0, lens, covariance=correlation * SIGMA[:, None] * SIGMA)


def drawn_from(camera: Camera, rng: np.random.Generator) -> Camera:
    return camera.with_parameters(camera.parameters + covariance_root(camera.covariance) @ rng.standard_normal(10))


def test_chi_square_of_comparisons_is_honest() -> None:
    rng = np.random.default_rng(3)
    camera = known_camera()
    found = [compare(drawn_from(camera, rng), drawn_from(camera, rng)) for _ in range(40)]
    assert {one.freedom for one in found} <= {8, 9}
    ratio = sum(one.chi_square for one in found) / sum(one.freedom for one in found)
    # 40 times 8 degrees of freedom: 1 +- 0.08.
    assert 0.75 < ratio < 1.25
    assert sum(one.chance < 0.05 for one in found) <= 6
    scatter = np.sqrt(np.mean([one.angle_rad**2 for one in found], axis=0))
    raw = np.sqrt(np.mean([one.raw_angle_rad**2 for one in found], axis=0))
    assert 0.8 < np.sqrt(np.mean(scatter**2)) / found[0].expected_rad < 1.2
    assert 0.8 < np.sqrt(np.mean(raw**2)) / found[0].raw_expected_rad < 1.2


def test_a_real_difference_is_called_one() -> None:
    camera = known_camera()
    other = camera.with_parameters(camera.parameters + [4.0, 4.0, 0, 0, 0, 0, 0, 0, 0, 0])
    found = compare(camera, other)
    assert found.chance < 1e-6
    # The farthest corner from the principal point: d(tan) = tan df / f, and the angle cos^2 of it.
    tan = np.hypot(322 / 620, 241 / 618)
    expected = tan * 4 / 620 / (1 + tan**2)
    assert found.largest_rad == pytest.approx(expected, rel=0.1)


def test_a_shifted_centre_is_mostly_a_rotation() -> None:
    camera = known_camera()
    shifted = camera.with_parameters(camera.parameters + [0, 0, 1.0, 0, 0, 0, 0, 0, 0, 0])
    found = compare(camera, shifted)
    assert found.raw_rms_rad == pytest.approx(1 / 620, rel=0.25)
    assert found.rms_rad < 0.2 * found.raw_rms_rad
    assert abs(found.rotation_rad[1]) == pytest.approx(1 / 620, rel=0.3)


def test_without_covariance_nothing_is_said_about_chance() -> None:
    camera = known_camera().with_covariance(np.zeros((10, 10)))
    found = compare(camera, camera.with_parameters(camera.parameters + 1e-3))
    assert np.isnan(found.chance)
    assert found.expected_rad == 0


def test_opencv_reads_its_file(tmp_path: Path) -> None:
    camera = known_camera()
    file = tmp_path / "camera_opencv.yaml"
    file.write_text(opencv_yaml(camera), encoding="utf-8")
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_READ)
    matrix, distortion = storage.getNode("camera_matrix").mat(), storage.getNode("distortion_coefficients").mat()
    size = [int(storage.getNode(f"image_{name}").real()) for name in ("width", "height")]
    np.testing.assert_array_equal(from_opencv(matrix, distortion, size).parameters, camera.parameters)
    deviations = storage.getNode("standard_deviations").mat().ravel()
    np.testing.assert_array_equal(deviations, np.delete(camera.sigma_parameters, 4))
    points = np.random.default_rng(0).uniform([-0.4, -0.3, 0.9], [0.4, 0.3, 1.1], (20, 3))
    projected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, distortion)
    np.testing.assert_allclose(projected[:, 0], camera.project(points), atol=1e-9)


def test_a_skewed_camera_is_none_of_opencvs() -> None:
    camera = known_camera()
    with pytest.raises(InputError, match="skew"):
        opencv_yaml(camera.with_parameters(camera.parameters + np.eye(10)[4]))


def board_at(photo: str, shift_px: float, saturated_share: float = 0.0) -> BoardPoints:
    pixels = np.stack(np.meshgrid(np.arange(100, 400, 50.0), np.arange(100, 300, 50.0)), axis=-1).reshape(-1, 2)
    covariance = np.tile(1e-4 * np.eye(2), (len(pixels), 1, 1))
    return BoardPoints(photo, np.arange(len(pixels)), pixels + shift_px, covariance, saturated_share=saturated_share)


def test_photos_from_one_place_are_named() -> None:
    photos = [board_at("a.png", 0.0), board_at("b.png", 60.0), board_at("c.png", 1.0)]
    assert [(one, other) for one, other, _ in same_views(photos, 800.0)] == [("c.png", "a.png")]
    said = list(check_photos(photos, known_camera()))
    assert len(said) == 1
    assert "c.png and a.png (1.4 px apart)" in said[0].text
    assert list(check_photos(photos[:2], known_camera())) == []


def test_saturated_photos_are_named() -> None:
    (doubt,) = check_photos([board_at("a.png", 0.0), board_at("b.png", 60.0, 0.3)], known_camera())
    assert doubt.code == "photos_saturated"
    assert "b.png (30%)" in doubt.text
