"""Scenes of targets and boards: exact image points, conditions, folders."""

import tomllib
from dataclasses import replace

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from data_synth.optics.sensor import Sensor
from data_synth.targets.boards import board_scene
from data_synth.targets.presets import PrintChoice, look_at, target_scene
from data_synth.targets.scene import Conditions, Cover, Glare, image_truth, render_photo
from heliogauge.errors import InputError
from heliogauge.images.photos import read_image
from heliogauge.results.json_file import read_json
from heliogauge.results.tables import read_table_csv
from heliogauge.running.cli import app

QUIET = Sensor(exposure=1.0, read_noise_dn=0.0)


@pytest.mark.slow
def test_points_of_the_panel_are_cheap_and_exact() -> None:
    scene = target_scene("panel")
    assert len(scene.views) == 40
    assert len(scene.points_m()) == 300
    truth = image_truth(scene, scene.views[0])
    pixels = scene.views[0].project(np.array([scene.points_m()[name] for name in truth.names]))
    np.testing.assert_allclose(truth.pixels_px, pixels, atol=1e-9)
    assert len(truth.names) > 250
    assert 6 < np.median(truth.diameter_px) < 15


@pytest.mark.slow
def test_every_target_of_the_panel_is_seen_often_and_from_all_sides() -> None:
    scene = target_scene("panel")
    seen = [name for view in scene.views for name in image_truth(scene, view).names]
    assert min(seen.count(name) for name in scene.points_m()) >= 15
    tilts = [view.tilt_rad(scene.sheets[150].world_from_sheet) for view in scene.views]
    assert np.degrees(max(tilts)) > 40


def test_dark_spots_lie_where_the_truth_says() -> None:
    """Centre of gravity of each dot of a plain photo: an independent look at the whole chain."""
    scene = target_scene("small")
    scene = replace(scene, conditions=Conditions(sensor=QUIET, vignetting=0.0, gradient=(0.0, 0.0)))
    view = scene.views[0]
    truth, image = image_truth(scene, view), render_photo(scene, view, np.random.default_rng(0)).astype(float)
    errors = []
    for (x, y), diameter in zip(truth.pixels_px, truth.diameter_px, strict=True):
        column, row, reach = round(x), round(y), int(0.75 * diameter)
        window = image[row - reach : row + reach + 1, column - reach : column + reach + 1]
        ink = np.clip((window.max() - window) / np.ptp(window), 0, 1)
        # Only the dot: what is farther than 3/4 of its diameter belongs to the code ring.
        v, u = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        ink = np.where(np.hypot(u + column - x, v + row - y) < 0.75 * diameter, ink, 0)
        errors.append([(ink * u).sum() / ink.sum() + column - x, (ink * v).sum() / ink.sum() + row - y])
    assert np.abs(np.median(errors, axis=0)).max() < 0.01
    assert np.sqrt(np.mean(np.square(errors))) < 0.03


def test_look_at_stands_upright_and_looks_there() -> None:
    pose = look_at(np.array([1.0, 0.5, 3.0]), np.array([0.2, 0.1, 0.0]))
    assert pose.apply([0.2, 0.1, 0.0])[:2] == pytest.approx([0, 0], abs=1e-12)
    assert pose.apply([0.2, 0.1, 0.0])[2] > 0
    assert pose.rotate([0.0, 1.0, 0.0])[1] < 0


def test_glare_cover_and_shading_do_what_they_say() -> None:
    scene = target_scene("small").scaled(0.25)
    scene = replace(scene, sheets=scene.sheets[12:28])
    view, rng = scene.views[0], np.random.default_rng(0)
    plain = Conditions(sensor=QUIET, vignetting=0.0, gradient=(0.0, 0.0))
    base = render_photo(replace(scene, conditions=plain), view, rng).astype(int)
    glare = replace(plain, glares=(Glare((0.5, 0.5), 0.05, 2.0),))
    lit = render_photo(replace(scene, conditions=glare), view, rng).astype(int)
    assert lit[150, 200] == 255
    assert np.abs(lit[:40] - base[:40]).max() <= 1
    bar = Cover((0.0, 0.5), (1.0, 0.5), 0.02)
    covered = render_photo(replace(scene, conditions=replace(plain, covers=(bar,))), view, rng)
    assert np.ptp(covered[150]) == 0
    hidden = image_truth(replace(scene, conditions=replace(plain, covers=(bar,))), view)
    assert 0 < np.count_nonzero(hidden.covered) < len(hidden.names)
    shaded = render_photo(replace(scene, conditions=replace(plain, gradient=(0.4, 0.0))), view, rng)
    assert shaded[5, -5] > 1.3 * shaded[5, 5]


def test_bits_keep_the_light() -> None:
    scene = target_scene("small").scaled(0.2)
    scene = replace(scene, sheets=scene.sheets[:4])
    eight, sixteen = (
        render_photo(scene.with_sensor(bits=bits, read_noise_dn=0.0), scene.views[0], np.random.default_rng(0))
        for bits in (8, 16)
    )
    assert (eight.dtype, sixteen.dtype) == (np.uint8, np.uint16)
    assert np.abs(sixteen / 257 - eight).max() < 4


def test_same_seed_same_scene_and_names_are_unique() -> None:
    one, other = target_scene("small", 3), target_scene("small", 3)
    assert all(np.array_equal(one.points_m()[name], other.points_m()[name]) for name in one.points_m())
    twice = replace(one, sheets=(*one.sheets, one.sheets[0]))
    with pytest.raises(InputError, match="two points are called 1"):
        twice.points_m()
    with pytest.raises(InputError, match="13 codes, 40 targets"):
        target_scene("small", prints=PrintChoice("aicon-8"))


@pytest.mark.parametrize("kind", ["chessboard", "charuco", "circles", "circles-asymmetric"])
def test_boards_are_in_the_image_and_cover_it(kind: str) -> None:
    scene = board_scene(kind)
    points = [image_truth(scene, view).pixels_px for view in scene.views]
    assert min(map(len, points)) >= 0.95 * len(scene.points_m())
    width, height = np.ptp(np.concatenate(points), axis=0)
    assert width > 1000
    assert height > 800


@pytest.mark.slow
def test_opencv_finds_the_corners_of_the_bent_board() -> None:
    scene = board_scene("charuco", n_photos=1).with_sensor(read_noise_dn=0.0).scaled(0.6)
    image, truth = render_photo(scene, scene.views[0], np.random.default_rng(0)), image_truth(scene, scene.views[0])
    table = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    corners, numbers, *_ = cv2.aruco.CharucoDetector(cv2.aruco.CharucoBoard((10, 7), 0.03, 0.022, table)).detectBoard(
        image
    )
    found = dict(zip(np.ravel(numbers).tolist(), np.reshape(corners, (-1, 2)), strict=True))
    errors = [found[int(n)] - p for n, p in zip(truth.names, truth.pixels_px, strict=True) if int(n) in found]
    assert len(errors) >= 50
    assert np.sqrt(np.mean(np.square(errors))) < 0.07
    # A flat and square board would lie elsewhere: its bending shows.
    flat = image_truth(board_scene("charuco", n_photos=1, flat=True).scaled(0.6), scene.views[0])
    assert np.abs(flat.pixels_px - truth.pixels_px).max() > 0.5


def test_folder_of_photos(tmp_path) -> None:
    out = tmp_path / "m"
    arguments = [
        "photogrammetry",
        "synth",
        str(out),
        "--scale",
        "0.25",
        "--photos",
        "1",
        "--jpeg-quality",
        "90",
        "--quiet",
        "--dictionary",
        "metashape-12",
    ]
    answer = CliRunner().invoke(app, arguments)
    assert answer.exit_code == 0, answer.output
    content = tomllib.loads((out / "measurement.toml").read_text())
    assert content["kind"] == "photogrammetry"
    assert content["targets"] == {"dictionary": "metashape-12", "diameter_mm": 14.0, "polarity": "black-on-white"}
    truth = read_json(out / "truth.json")
    bar = content["scale_bar"][0]
    a, b = (np.array(truth["points_m"][bar[end]]) for end in ("a", "b"))
    assert np.linalg.norm(a - b) == pytest.approx(bar["length_m"], abs=5e-5)
    photos = sorted(path.name for path in out.glob("photo_*.jpg"))
    assert len(photos) == 1
    assert read_image(out / photos[0]).shape == (300, 400)
    points = read_table_csv(out / "image_points_true.csv")
    assert set(points["image"]) == set(photos) == set(truth["photos"])
    assert len(points["x_px"]) == 52


def test_folder_of_points(tmp_path) -> None:
    out = tmp_path / "m"
    answer = CliRunner().invoke(
        app, ["photogrammetry", "synth", str(out), "--points-only", "--sigma-px", "0.05", "--quiet"]
    )
    assert answer.exit_code == 0, answer.output
    content = tomllib.loads((out / "measurement.toml").read_text())
    assert content["image_points"] == {"file": "image_points.csv", "pixel_origin": "center"}
    measured, true = (read_table_csv(out / name) for name in ("image_points.csv", "image_points_true.csv"))
    error = np.array([np.array(measured[c], float) - np.array(true[c], float) for c in ("x_px", "y_px")])
    assert error.std() == pytest.approx(0.05, rel=0.1)
    assert measured["target"] == true["target"]
    assert not list(out.glob("photo_*"))


@pytest.mark.slow
def test_folder_of_a_board(tmp_path) -> None:
    out = tmp_path / "m"
    answer = CliRunner().invoke(app, ["camera", "synth", str(out), "--photos", "2", "--scale", "0.25", "--quiet"])
    assert answer.exit_code == 0, answer.output
    content = tomllib.loads((out / "measurement.toml").read_text())
    assert content["kind"] == "camera"
    assert content["board"] == {"type": "chessboard", "columns": 9, "rows": 6, "square_mm": 30.0}
    assert len(list(out.glob("photo_*.png"))) == 2
    assert len(read_json(out / "truth.json")["points_m"]) == 54


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--dictionary", "aicon-13"], "an even number of 8 to 20 bit"),
        (["--bits", "12", "--jpeg-quality", "90", "--scale", "0.1"], "JPEG holds 8 bit"),
    ],
)
def test_impossible_wishes_leave_nothing(tmp_path, arguments: list[str], message: str) -> None:
    answer = CliRunner().invoke(app, ["photogrammetry", "synth", str(tmp_path / "m"), *arguments, "--quiet"])
    assert isinstance(answer.exception, InputError)
    assert message in str(answer.exception)
    assert not list(tmp_path.iterdir())
