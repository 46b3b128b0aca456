"""Photos on disk to a table of places: every way to find the target, and photos that cannot be measured."""

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.beam.images.target_frames import (
    ArucoMarkers,
    CornerPixels,
    DarkMarks,
    MarkerTemplates,
    TargetFrame,
    WholeImage,
)
from calibration.beam.light.beam_flags import BeamFlag
from calibration.beam.pipeline.beams import measure_beams, target_image, write_beams
from calibration.beam.target.marks import CORNERS
from calibration.beam.target.view import view_from_points
from heliogauge.errors import InputError
from tests.calibration.beam_pictures import CORNERS_M, gaussian, sky_light

CENTERS = [(0.0, 0.0), (0.7, -0.4), (-0.9, 0.5)]


def _saved(path: Path, values: np.ndarray) -> Path:
    assert cv2.imwrite(str(path), np.clip(np.rint(values), 0, 255).astype(np.uint8))
    return path


def _beam(center: tuple[float, float]) -> np.ndarray:
    return sky_light() + 90 * gaussian(center) + np.random.default_rng(1).normal(0, 1, (224, 256))


def test_crops_of_two_targets(tmp_path: Path) -> None:
    files = [_saved(tmp_path / f"{k}.png", _beam(center)) for k, center in enumerate(CENTERS)]
    frames = {"a": TargetFrame(CORNERS_M), "b": TargetFrame(CORNERS_M / 2)}
    beams = measure_beams(files, ["a", "b", "a"], frames, jobs=2)
    expected = np.array(CENTERS) * [[1], [0.5], [1]]
    assert np.stack([beams.x_m, beams.y_m], axis=1) == pytest.approx(expected, abs=0.01)
    assert (beams.sigma_m < 0.01).all()
    assert beams.reasons == ("", "", "")
    assert not beams.rejected.any()
    # Alone or among others, in one thread or in two: the same numbers.
    alone = measure_beams(files[1:2], ["b"], frames, jobs=1)
    assert alone.x_m[0] == beams.x_m[1]
    write_beams(tmp_path / "beams.csv", beams)
    with (tmp_path / "beams.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    assert [row["image"] for row in rows] == ["0.png", "1.png", "2.png"]
    assert float(rows[2]["x_m"]) == pytest.approx(-0.9, abs=0.01)
    assert rows[0]["reason"] == ""


def test_what_cannot_be_measured_is_said(tmp_path: Path) -> None:
    files = [_saved(tmp_path / "good.png", _beam((0.2, 0.1))), tmp_path / "absent.png", tmp_path / "broken.png"]
    files[2].write_bytes(files[0].read_bytes()[:2000])
    files.append(_saved(tmp_path / "dark.png", np.zeros((224, 256))))
    files.append(_saved(tmp_path / "cut.png", _beam((3.7, 0.0))))
    beams = measure_beams(files, ["a"] * 5, {"a": TargetFrame(CORNERS_M)})
    assert beams.rejected.tolist() == [False, True, True, True, True]
    flags = [0, BeamFlag.UNREADABLE, BeamFlag.UNREADABLE, BeamFlag.NO_BEAM]
    assert beams.flags[:4].tolist() == flags
    assert beams.flags[4] & BeamFlag.CUT_BY_EDGE
    assert "absent.png" in beams.reasons[1]
    assert "cut off" in beams.reasons[2]
    assert np.isnan(beams.x_m[1:4]).all()
    write_beams(tmp_path / "beams.csv", beams)


def test_colour_and_depth(tmp_path: Path) -> None:
    """Green is measured unless another colour is asked for: red is at the end of its scale here."""
    green = _beam((0.5, 0.2))
    photo = np.stack([0.5 * green, green, np.where(green > 120, 255, green)], axis=-1)
    file = _saved(tmp_path / "colour.png", photo)
    one = measure_beams([file], ["a"], {"a": TargetFrame(CORNERS_M)})
    assert one.flags[0] == 0
    red = measure_beams([file], ["a"], {"a": TargetFrame(CORNERS_M, channel="red")})
    assert red.flags[0] & BeamFlag.SATURATED
    deep = tmp_path / "deep.png"
    assert cv2.imwrite(str(deep), np.rint(200 * green).astype(np.uint16))
    sixteen = measure_beams([deep], ["a"], {"a": TargetFrame(CORNERS_M)})
    assert sixteen.x_m == pytest.approx(one.x_m, abs=0.002)
    with pytest.raises(InputError, match="channel"):
        measure_beams([file], ["a"], {"a": TargetFrame(CORNERS_M, channel="pink", empty_files=(file,))})


def _frame_with_markers(center: tuple[float, float], kind: str, shift: tuple[float, float] = (0, 0)) -> np.ndarray:
    """A photo of 700 x 600 px, 60 px/m, the target's centre at (340, 310) px."""
    x, y = (np.arange(700) - 340 - shift[0]) / 60, (310 + shift[1] - np.arange(600)) / 60
    x, y = np.meshgrid(x, y)
    values = 110 + 100 * np.exp(-((x - center[0]) ** 2 + (y - center[1]) ** 2) / (2 * 0.6**2))
    values = np.where((np.abs(x) < 5.2) & (np.abs(y) < 4.6), values, 60)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    for k, (corner_x, corner_y) in enumerate(CORNERS_M):
        column, row = round(340 + 60 * corner_x), round(310 - 60 * corner_y)
        if kind == "aruco":
            # 61 px: the middle of the marker is the middle of a pixel.
            marker = cv2.aruco.generateImageMarker(dictionary, 10 + k, 54)
            marker = cv2.resize(marker, (61, 61), interpolation=cv2.INTER_NEAREST).astype(float) * 0.6 + 20
            values[row - 30 : row + 31, column - 30 : column + 31] = marker
        else:
            inwards_x, inwards_y = (corner_x - x) * np.sign(corner_x), (corner_y - y) * np.sign(corner_y)
            for a, b in ((inwards_x, inwards_y), (inwards_y, inwards_x)):
                values[(a > 0) & (a < 0.7) & (b > 0) & (b < 0.2)] = 15
    return cv2.GaussianBlur(values, (0, 0), 0.7) + np.random.default_rng(2).normal(0, 0.7, values.shape)


def test_aruco_markers(tmp_path: Path) -> None:
    files = [_saved(tmp_path / f"{k}.png", _frame_with_markers(c, "aruco")) for k, c in enumerate(CENTERS)]
    frame = TargetFrame(CORNERS_M, ArucoMarkers((10, 11, 12, 13)))
    beams = measure_beams(files, ["a"] * 3, {"a": frame})
    assert np.stack([beams.x_m, beams.y_m], axis=1) == pytest.approx(np.array(CENTERS), abs=0.015)
    missing = measure_beams(files[:1], ["a"], {"a": TargetFrame(CORNERS_M, ArucoMarkers((10, 11, 12, 14)))})
    assert missing.flags[0] == BeamFlag.TARGET_NOT_FOUND
    assert "marker 14 is not found" in missing.reasons[0]


def test_corner_pixels_and_dark_marks(tmp_path: Path) -> None:
    file = _saved(tmp_path / "a.png", _frame_with_markers((0.7, -0.4), "angles"))
    pixels = np.array([340, 310]) + CORNERS_M * [60, -60]
    given = measure_beams([file], ["a"], {"a": TargetFrame(CORNERS_M, CornerPixels(pixels, sigma_px=1.0))})
    assert [given.x_m[0], given.y_m[0]] == pytest.approx([0.7, -0.4], abs=0.01)
    exact = measure_beams([file], ["a"], {"a": TargetFrame(CORNERS_M, CornerPixels(pixels))})
    # The homography's covariance times the point, where the beam is: off the middle it is another than there.
    view = view_from_points(pixels, CORNERS_M, sigma_px=1.0)
    place = view.covariance_m2([given.x_m[0], given.y_m[0]])
    assert not np.allclose(place, view.covariance_m2([0.0, 0.0]), rtol=0.01)
    assert given.covariance_m2[0] - exact.covariance_m2[0] == pytest.approx(place, rel=0.02, abs=1e-7)
    marks = measure_beams([file], ["a"], {"a": TargetFrame(CORNERS_M, DarkMarks("outer"))})
    assert [marks.x_m[0], marks.y_m[0]] == pytest.approx([0.7, -0.4], abs=0.01)
    image = target_image(file, TargetFrame(CORNERS_M, DarkMarks("outer")))
    assert image.points_m(image.pixels_px([1.0, 2.0])) == pytest.approx([1.0, 2.0])


def test_templates_follow_a_camera_that_sways(tmp_path: Path) -> None:
    first = _frame_with_markers((0.0, 0.0), "angles")
    templates = []
    for name, corner in zip(CORNERS, CORNERS_M, strict=True):
        column, row = np.rint(np.array([340, 310]) + corner * [60, -60] - np.sign(corner) * [15, -15]).astype(int)
        templates.append(_saved(tmp_path / f"{name}.png", first[row - 40 : row + 40, column - 40 : column + 40]))
    shifts = [(0, 0), (6, -3), (-4, 5)]
    files = [
        _saved(tmp_path / f"{k}.png", _frame_with_markers(center, "angles", shift))
        for k, (center, shift) in enumerate(zip(CENTERS, shifts, strict=True))
    ]
    beams = measure_beams(files, ["a"] * 3, {"a": TargetFrame(CORNERS_M, MarkerTemplates(tuple(templates)))})
    assert np.stack([beams.x_m, beams.y_m], axis=1) == pytest.approx(np.array(CENTERS), abs=0.015)


def test_photos_without_a_beam(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    pattern = cv2.resize(rng.uniform(0.7, 1.2, (9, 11)), (256, 224), interpolation=cv2.INTER_NEAREST)
    empty = tuple(_saved(tmp_path / f"e{k}.png", sky_light() * pattern) for k in range(2))
    file = _saved(tmp_path / "beam.png", 1.2 * sky_light() * pattern + 40 * gaussian((0.4, 0.2)))
    beams = measure_beams([file], ["a"], {"a": TargetFrame(CORNERS_M, WholeImage(), empty_files=empty)})
    assert [beams.x_m[0], beams.y_m[0]] == pytest.approx([0.4, 0.2], abs=0.01)
    small = _saved(tmp_path / "small.png", sky_light((112, 128)))
    other = measure_beams([small], ["a"], {"a": TargetFrame(CORNERS_M, empty_files=empty)})
    assert other.flags[0] == BeamFlag.TARGET_NOT_FOUND


def test_bad_calls(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="one target for each"):
        measure_beams([tmp_path / "a.png"], [], {})
    with pytest.raises(InputError, match="target 'b' has no corners; known are a"):
        measure_beams([tmp_path / "a.png"], ["b"], {"a": TargetFrame(CORNERS_M)})
    with pytest.raises(InputError, match="four pictures"):
        measure_beams([tmp_path / "a.png"], ["a"], {"a": TargetFrame(CORNERS_M, MarkerTemplates(()))})
