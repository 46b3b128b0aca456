"""Cameras from and for OpenCV and COLMAP: round trips, and OpenCV's own projection."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.camera.files.opencv_files import export_camera, import_opencv, read_calibrated, read_opencv_camera
from heliogauge.camera.distortion import BrownDistortion
from heliogauge.camera.formats import from_colmap
from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.results.tables import write_camera_json
from heliogauge.running import cli

CAMERA = Camera(
    1600,
    1200,
    1510.25,
    1508.5,
    806.125,
    592.75,
    distortion=BrownDistortion(k1=-0.08, k2=0.06, k3=0.001, p1=2e-4, p2=-3e-4),
    covariance=np.diag([0.1, 0.1, 0.2, 0.2, 0.0, 1e-4, 1e-4, 1e-5, 1e-5, 1e-4]) ** 2,
)
ROS = "image_width: 8\nimage_height: 8\nK: [9.0, 0.0, 4.0, 0.0, 9.0, 4.0, 0.0, 0.0, 1.0]\n"
POINTS = np.array([[0.2, -0.1, 1.0], [-0.4, 0.3, 1.1], [0.0, 0.0, 2.0]])


def leave(*arguments: str) -> int:
    with pytest.raises(SystemExit) as caught:
        cli.main(arguments)
    return int(caught.value.code or 0)


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    write_camera_json(tmp_path / "camera.json", CAMERA)
    return tmp_path / "camera.json"


def test_there_and_back_by_the_command_line(stored: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert leave("camera", "export", "opencv", str(stored), "-o", str(tmp_path / "c.yaml")) == 0
    assert leave("camera", "import", "opencv", str(tmp_path / "c.yaml"), "-o", str(tmp_path / "in")) == 0
    back = read_calibrated(tmp_path / "in")
    np.testing.assert_allclose(back.parameters, CAMERA.parameters, rtol=1e-15)
    np.testing.assert_allclose(back.covariance, CAMERA.covariance, rtol=1e-12)
    assert leave("camera", "import", "opencv", str(tmp_path / "c.yaml"), "-o", str(tmp_path / "in")) == 2
    assert leave("camera", "import", "opencv", str(tmp_path / "c.yaml"), "-o", str(tmp_path / "in"), "--force") == 0
    capsys.readouterr()
    assert leave("camera", "compare", str(stored), str(tmp_path / "in")) == 0
    assert "no more than chance" in capsys.readouterr().out


@pytest.mark.parametrize("suffix", [".yaml", ".xml", ".json"])
def test_what_opencv_writes_projects_as_opencv_does(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"calibration{suffix}"
    matrix, lens = CAMERA.matrix, np.array([[-0.08, 0.06, 2e-4, -3e-4, 0.001]])
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_WRITE)
    for name, value in (
        ("image_width", 1600),
        ("image_height", 1200),
        ("camera_matrix", matrix),
        ("dist_coeffs", lens),
    ):
        storage.write(name, value)
    storage.release()
    wanted = cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), matrix, lens)[0][:, 0]
    np.testing.assert_allclose(read_opencv_camera(file).project(POINTS), wanted, atol=1e-9)


def test_numbers_of_other_programs(tmp_path: Path) -> None:
    """Lists in JSON, and ROS's YAML without OpenCV's header."""
    plain = {"K": CAMERA.matrix.tolist(), "D": [-0.08, 0.06, 2e-4, -3e-4, 0.001], "image_size": [1600, 1200]}
    (tmp_path / "plain.json").write_text(json.dumps(plain), encoding="utf-8")
    (tmp_path / "ros.yaml").write_text(
        "image_width: 1600\nimage_height: 1200\ncamera_name: narrow\n"
        "camera_matrix:\n  rows: 3\n  cols: 3\n  data: [1510.25, 0.0, 806.125, 0.0, 1508.5, 592.75, 0.0, 0.0, 1.0]\n"
        "distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.08, 0.06, 0.0002, -0.0003, 0.001]\n",
        encoding="utf-8",
    )
    lines = import_opencv([tmp_path / "plain.json", tmp_path / "ros.yaml"], tmp_path / "in")
    assert [line.partition(":")[0] for line in lines] == ["plain", "ros"]
    for name in ("plain", "ros"):
        np.testing.assert_allclose(read_calibrated(tmp_path / "in", name).parameters, CAMERA.parameters, rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "cannot read it|no camera matrix"),
        ("not a calibration", "cannot read it|no camera matrix"),
        ('{"a": 1}', "no camera matrix"),
        ('{"K": [1, 2, 3]}', "no camera matrix"),
        ('{"K": [9, 0, 4, 0, 9, 4, 0, 0, 1]}', "the size of the image is not in the file"),
        ('{"K": [9, 0, 4, 0, 9, 4, 0, 0, 1], "image_size": [8, 8], "fisheye_model": 1}', "fisheye"),
        ('{"K": [9, 0, 4, 0, 9, 4, 0, 0, 1], "image_size": [8, 8], "D": [0, 0, 0, 0, 0, 1, 0, 0]}', "rational"),
        ('{"K": [9, 0, 4, 0, 9, 4, 0, 0, 1], "image_size": [8, 8], "D": [1, 2]}', "coefficients are needed"),
        (
            '{"K": [9, 0, 4, 0, 9, 4, 0, 0, 1], "image_size": [8, 8], "D": ["a", "b"]}',
            "D: something in it is no number",
        ),
        (f"{ROS}distortion_model: equidistant\nD: [0.1, 0.02, 0.003, 0.004]\n", "fisheye"),
        (f"{ROS}D: [0.1, .nan, 0.0, 0.0]\n", "D: something in it is no number"),
        ('<?xml version="1.0"?><opencv_storage><K>', "cannot read it"),
    ],
)
def test_what_is_no_camera_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "c.json").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        import_opencv([tmp_path / "c.json"], tmp_path / "in")
    assert not (tmp_path / "in").exists()


def test_the_size_can_be_given(tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text('{"K": [9, 0, 4, 0, 9, 4, 0, 0, 1]}', encoding="utf-8")
    assert read_opencv_camera(tmp_path / "c.json", (8, 6)).height_px == 6


def test_colmap_reads_what_is_exported(stored: Path, tmp_path: Path) -> None:
    """COLMAP's FULL_OPENCV, with its pixel origin at the corner."""
    export_camera(stored, tmp_path / "cameras.txt", "colmap")
    (line,) = [text for text in (tmp_path / "cameras.txt").read_text().splitlines() if not text.startswith("#")]
    number, model, width, height, *values = line.split()
    assert (number, model, width, height) == ("1", "FULL_OPENCV", "1600", "1200")
    assert [float(value) for value in values[:4]] == [1510.25, 1508.5, 806.625, 593.25]
    np.testing.assert_allclose(
        from_colmap(model, [float(value) for value in values], 1600, 1200).parameters, CAMERA.parameters, rtol=1e-15
    )
