"""What users do: odd files, photos held out, mirrored and repeated, odd names, a camera used by other commands."""

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from calibration.camera.boards import TargetField
from calibration.camera.cli import app
from calibration.camera.files.result import Result, open_calibration
from calibration.camera.keys import load_camera_calibration
from calibration.camera.pipeline.measure import Options, run
from data_synth.targets.dataset import PhotoOptions, photogrammetry_content, write_target_dataset
from data_synth.targets.presets import target_scene
from deflectometry.pipeline import inputs
from heliogauge.errors import InputError
from heliogauge.reporting.notation import number_text
from photogrammetry.keys.load import load_photogrammetry
from tests.without_plots import without_plots

QUICK = Options(leave_one_out=False)


@pytest.fixture
def folder(board_photos: Callable[[str], Path], tmp_path: Path) -> Path:
    """A folder of photos that may be spoiled."""
    return Path(shutil.copytree(board_photos("chessboard"), tmp_path / "photos"))


@pytest.fixture(scope="module")
def good(board_photos: Callable[[str], Path]) -> Result:
    return run(load_camera_calibration(board_photos("chessboard")), QUICK)


def changed(folder: Path, change: Callable[[np.ndarray], np.ndarray], number: int | None = None) -> None:
    """Change all photos, or one."""
    for file in sorted(folder.glob("photo_*.png")):
        if number is None or file.name == f"photo_{number:03d}.png":
            cv2.imwrite(str(file), change(cv2.imread(str(file), cv2.IMREAD_UNCHANGED)))


def off(result: Result, good: Result) -> float:
    """Largest change of an intrinsic, in its sigma."""
    sigma = np.where(good.camera.sigma_parameters > 0, good.camera.sigma_parameters, np.inf)
    return float(np.abs((result.camera.parameters - good.camera.parameters) / sigma).max())


@pytest.mark.slow
def test_depth_and_colour_do_not_matter(folder: Path, good: Result) -> None:
    changed(folder, lambda image: image.astype(np.uint16) * 257)
    assert off(run(load_camera_calibration(folder), QUICK), good) < 0.02
    changed(folder, lambda image: cv2.cvtColor((image // 257).astype(np.uint8), cv2.COLOR_GRAY2BGR))
    assert off(run(load_camera_calibration(folder), QUICK), good) < 1e-6


@pytest.mark.slow
def test_names_with_spaces_and_accents(folder: Path, good: Result) -> None:
    other = folder.rename(folder.parent / "Kalibrierung ü 1")
    for file in sorted(other.glob("photo_*.png")):
        file.rename(other / f"Foto ä {file.name[6:]}")
    text = (other / "measurement.toml").read_text(encoding="utf-8")
    (other / "measurement.toml").write_text(text.replace("photo_*.png", "Foto ä *.png"), encoding="utf-8")
    result = run(load_camera_calibration(other), QUICK)
    assert result.photos[0].name == "Foto ä 001.png"
    assert off(result, good) < 1e-6


def test_a_cut_off_photo_is_named(folder: Path) -> None:
    file = folder / "photo_004.png"
    file.write_bytes(file.read_bytes()[:20000])
    with pytest.raises(InputError, match=r"photo_004\.png"):
        run(load_camera_calibration(folder), QUICK)


def test_no_photos(folder: Path) -> None:
    for file in folder.glob("photo_*.png"):
        file.unlink()
    with pytest.raises(InputError, match=r"photo_\*\.png"):
        load_camera_calibration(folder)


@pytest.mark.slow
def test_a_mirrored_photo_is_noticed_and_left_out(folder: Path, good: Result) -> None:
    changed(folder, lambda image: np.ascontiguousarray(image[:, ::-1]), 3)
    result = run(load_camera_calibration(folder))
    assert set(result.left_out) == {"photo_003.png"}
    assert "mirror image" in result.left_out["photo_003.png"]
    assert off(result, good) < 4


@pytest.mark.slow
def test_repeated_and_saturated_photos_are_warned_of(folder: Path, good: Result) -> None:
    assert not {"photos_repeat", "photos_saturated"} & {one.code for one in good.doubts}
    repeated = cv2.imread(str(folder / "photo_002.png"), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(folder / "photo_003.png"), np.roll(repeated, 1, axis=1))
    changed(folder, lambda image: np.clip(image.astype(float) * 1.6, 0, 255).astype(np.uint8), 5)
    result = run(load_camera_calibration(folder), QUICK)
    texts = {one.code: one.text for one in result.doubts}
    assert "photo_003.png and photo_002.png" in texts["photos_repeat"]
    assert "photo_005.png" in texts["photos_saturated"]


@pytest.mark.slow
def test_photos_held_out_are_predicted(folder: Path) -> None:
    result = run(load_camera_calibration(folder), Options(hold_out="photo_002*, photo_007.png", leave_one_out=False))
    assert [one.name for one in result.held_out] == ["photo_002.png", "photo_007.png"]
    assert len(result.photos) == 6
    assert result.held_out_px < 0.02
    with pytest.raises(InputError, match="hold_out=nothing"):
        run(load_camera_calibration(folder), Options(hold_out="nothing*"))


@pytest.mark.slow
def test_results_are_read_as_they_were_written(good: Result, tmp_path: Path) -> None:
    good.write(tmp_path)
    read = open_calibration(tmp_path)
    np.testing.assert_array_equal(read.camera.covariance, good.camera.covariance)
    np.testing.assert_allclose(read.sigma.sigma_free_rad, good.sigma.sigma_free_rad, rtol=1e-12)
    np.testing.assert_allclose(read.shape.departure_m, good.shape.departure_m, atol=1e-12)
    assert read.quality.rms_px == pytest.approx(good.quality.rms_px)
    for one, other in zip(read.photos, good.photos, strict=True):
        np.testing.assert_array_equal(one.index, other.index)
        np.testing.assert_allclose(one.residuals_px, other.residuals_px, atol=1e-9)
    assert (
        (tmp_path / "cameras_colmap.txt").read_text(encoding="utf-8").splitlines()[-1].startswith("1 FULL_OPENCV 960")
    )


def test_lengths_in_pitches_are_never_called_metres(good: Result, tmp_path: Path) -> None:
    board = TargetField("", good.shape.board.names, good.shape.board.points_m, is_metric=False)
    replace(good, shape=replace(good.shape, board=board)).write(tmp_path)
    for name in ("points.csv", "board.csv", "photos.csv"):
        columns = (tmp_path / name).read_text(encoding="utf-8").splitlines()[0].split(",")
        assert not [one for one in columns if one.endswith(("_m", "_mm"))], name
    assert not re.search(r"\w+_m\b", (tmp_path / "cameras.json").read_text(encoding="utf-8"))
    read = open_calibration(tmp_path)
    assert not read.shape.board.is_metric
    np.testing.assert_array_equal(read.shape.points_m, good.shape.points_m)
    np.testing.assert_array_equal(
        read.photos[0].cam_from_board.translation_m, good.photos[0].cam_from_board.translation_m
    )


@pytest.mark.slow
def test_other_commands_use_the_camera(good: Result, board_photos: Callable[[str], Path], tmp_path: Path) -> None:
    from photogrammetry.pipeline import measure as photogrammetry

    good.write(tmp_path)
    # The scene of targets has the same camera.
    network = tmp_path / "network"
    scene = target_scene("small", 1).scaled(0.6)
    content = photogrammetry_content(scene) | {"camera": {"file": "cameras.json"}}
    write_target_dataset(network, scene, content, PhotoOptions(1, points_sigma_px=0.02))
    shutil.copy(tmp_path / "cameras.json", network)
    result = photogrammetry.run(load_photogrammetry(network))
    np.testing.assert_array_equal(result.camera.parameters, good.camera.parameters)
    # Held at a calibration of 0.01 px it explains points of 0.02 px.
    assert 0.8 < result.solved.bundle.sigma0 < 1.3
    camera = inputs.read_camera_json(tmp_path / "cameras.json")
    np.testing.assert_array_equal(camera.covariance, good.camera.covariance)


@pytest.mark.slow
def test_command_line(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "result"
    words = ["measure", str(folder), "-o", str(out), "--no-report", "--no-leave-one-out", "--jobs", "1", "-q"]
    assert CliRunner().invoke(app, words).exit_code == 0
    written = {path.name for path in out.iterdir()}
    assert {
        "cameras.json",
        "camera_opencv.yaml",
        "cameras_colmap.txt",
        "points.csv",
        "board.csv",
        "photos.csv",
        "intrinsics.csv",
        "summary.json",
    } <= written
    assert "report.html" not in written
    blocked = tmp_path / "file"
    blocked.write_text("", encoding="utf-8")
    words[3] = str(blocked / "result")
    caught = CliRunner().invoke(app, words).exception
    assert isinstance(caught, InputError)


def test_report(good: Result, tmp_path: Path) -> None:
    from heliogauge.reporting.build import build_report

    good.write(tmp_path)
    with without_plots():
        page = build_report(tmp_path).read_text(encoding="utf-8")
    first, _, rest = page.partition("<h2")
    # Verdict, numbers and the map over the image come before everything else.
    assert 'class="verdict doubtful"' in first
    assert "poor coverage" in first
    assert 'data-view="map"' in first
    for words in ("Sigma of lines of sight", "Correlation of the intrinsics", "photo_008.png", 'data-view="photo"'):
        assert words in rest or words in first
    numbers = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["numbers"]
    shown = number_text(numbers["focal_x_px"], numbers["sigma_focal_x_px"], "px")
    assert f"<td>{shown}</td>" in first
    cells = json.loads((tmp_path / "report.ipynb").read_text(encoding="utf-8"))["cells"]
    pictures = [line for cell in cells for one in cell.get("outputs", ()) for line in one["data"]["text/html"]]
    # Each still figure is in the notebook once: two maps, a photo, profile, correlations, the board twice.
    assert "".join(pictures).count("<img ") == 7
