"""Photos to take next: what they are worth is what a calibration with them states, and others are worth less."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.camera.adjustment.another_photo import gains_of_photos, predict_photo
from calibration.camera.adjustment.mixed_adjustment import adjust_mixed
from calibration.camera.boards import Chessboard
from calibration.camera.corners.detection import BoardPoints
from calibration.camera.files.result import Result, open_calibration
from calibration.camera.judgement.projection_sigma import sigma_map
from calibration.camera.keys import load_camera_calibration
from calibration.camera.pipeline.measure import Options, run
from calibration.camera.planning import plan
from calibration.camera.planning.candidate_views import Lengths, candidate_views, nearer_side, place_in_box, place_words
from calibration.camera.planning.next_photos import Expectation, adjusted_again, choose_photos, importance, with_photo
from calibration.camera.start_values.board_network import BoardNetwork
from calibration.camera.start_values.intrinsics import tilt_and_roll
from data_synth.optics.photo import View
from data_synth.targets.boards import board_scene, board_table
from data_synth.targets.dataset import PhotoOptions, camera_content, write_target_dataset
from data_synth.targets.presets import SMALL_CAMERA, look_at
from data_synth.targets.scene import TargetScene
from heliogauge.camera.distortion import BrownDistortion
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector
from heliogauge.results.folder import read_cameras_json, read_summary, read_table_csv

CAMERA = Camera(1600, 1200, 1500.0, 1500.0, 790.0, 610.0, 0.0, BrownDistortion(-0.1))
BOARD = Chessboard(9, 6, 0.03)
FREE = ("focal_px", "aspect", "center_x_px", "center_y_px", "k1", "k2")
UPRIGHT = np.diag([1.0, -1.0, -1.0])


def weak_pose(k: int) -> RigidTransform:
    """The board tilted by 25 degrees to all sides, from one distance, the camera never turned."""
    around = 1.05 * k + 0.3
    tilt = rotation_from_vector(0.44 * np.array([np.cos(around), np.sin(around), 0.0]))
    return RigidTransform(tilt @ UPRIGHT, np.array([0.0, 0.0, 0.45]))


def photo(name: str, pose: RigidTransform, places: np.ndarray, rng: np.random.Generator) -> BoardPoints:
    pixels = CAMERA.project(pose.apply(places)) + rng.normal(0, 0.02, (len(places), 2))
    return BoardPoints(name, np.arange(len(places)), pixels, np.tile(4e-4 * np.eye(2), (len(places), 1, 1)))


def bent_board() -> np.ndarray:
    """Return the board's points, 0.4 mm higher in the middle of each half, and stretched by 0.1 %."""
    places = BOARD.points_m * np.array([1.001, 1.0, 1.0])
    x, y = (places[:, :2] / np.abs(places[:, :2]).max(axis=0)).T
    return np.asarray(places + np.stack([0 * x, 0 * x, 4e-4 * (x * x - 0.5 * y * y)], axis=1))


def weak_network(seed: int = 0) -> BoardNetwork:
    rng = np.random.default_rng(seed)
    poses = tuple(weak_pose(k) for k in range(6))
    points = tuple(photo(f"{k}", pose, bent_board(), rng) for k, pose in enumerate(poses))
    return BoardNetwork(BOARD, points, FREE, CAMERA, poses)


def with_measured(network: BoardNetwork, poses: Sequence[RigidTransform]) -> float:
    """Calibrate anew with photos more, and return the sigma of lines of sight [rad]."""
    rng = np.random.default_rng(7)
    more = tuple(photo(f"more {k}", pose, bent_board(), rng) for k, pose in enumerate(poses))
    whole = replace(network, points=(*network.points, *more), poses=(*network.poses, *poses))
    return sigma_map(adjust_mixed(whole, whole.observations(), whole.start(), refine_board=True).camera).rms_free_rad


@pytest.fixture(scope="module")
def today() -> Expectation:
    network = weak_network()
    return Expectation((adjust_mixed(network, network.observations(), network.start(), refine_board=True),))


LENGTHS = Lengths(bent_board(), 0.03, 0.3, 0.7)


def test_what_a_photo_adds_is_what_the_normal_equations_say(today: Expectation) -> None:
    """The covariance of an adjustment that has the photo, all sizes of effects held."""
    mixed, pose = today.draws[0], weak_pose(2).moved([0.0, 0.0, 1.2, 0.0, 0.01, 0.05])
    usual = np.tile(np.median(mixed.table.covariance_px2, axis=0), (54, 1, 1))
    points = BoardPoints("more", np.arange(54), np.zeros((54, 2)), usual)
    predicted = predict_photo(mixed, points, pose)
    more = with_photo(mixed, pose, "more", np.random.default_rng(0))
    n = len(FREE)
    expected = np.diag(mixed.posterior.covariance[:n, :n] - predicted.gain)
    # The linearisation moves with the drawn points, by less than a sigma.
    np.testing.assert_allclose(np.sqrt(np.diag(more.posterior.covariance)[:n]), np.sqrt(expected), rtol=0.02)
    # And it adds something: to focal length or principal point a tenth of the variance at least.
    assert (np.diag(predicted.gain) / np.diag(mixed.posterior.covariance)[:n])[[0, 2, 3]].max() > 0.1


def test_what_several_photos_add_is_what_no_pose_explains(today: Expectation) -> None:
    """From the points' covariance in the complement of the poses' derivatives, one photo after the other."""
    mixed, poses = today.draws[0], [weak_pose(k).moved([0.0, 0.1 * k, 0.3, 0.0, 0.01, 0.05]) for k in range(3)]
    usual = np.tile(np.median(mixed.table.covariance_px2, axis=0), (20, 1, 1))
    points = BoardPoints("more", np.arange(3, 43, 2), np.zeros((20, 2)), usual)
    found = gains_of_photos(mixed, points, poses)
    for gain, pose in zip(found, poses, strict=True):
        one = predict_photo(mixed, points, pose)
        free = np.linalg.qr(one.d_pose, mode="complete")[0][:, 6:]
        seen = one.with_intrinsics @ free
        expected = seen @ np.linalg.solve(free.T @ one.covariance_px2 @ free, seen.T)
        np.testing.assert_allclose(gain, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.slow
def test_a_planned_photo_is_worth_what_was_planned_and_more_than_others(today: Expectation) -> None:
    (first,) = choose_photos(today, LENGTHS, (), 1)
    network, before = weak_network(), sigma_map(today.camera).rms_free_rad
    planned, reached = sigma_map(first.expected.camera).rms_free_rad, with_measured(network, [first.cam_from_board])
    assert planned < 0.5 * before
    # One calibration of the four draws that were averaged: they scatter by a third, the effects' sizes by more.
    assert 0.4 < reached / planned < 2.5
    views = list(candidate_views(CAMERA, LENGTHS))
    chosen = np.random.default_rng(1).choice(len(views), 4, replace=False)
    others = [with_measured(network, [views[i]]) for i in chosen]
    assert np.median(others) > 1.2 * reached
    # A photo like those there are adds next to nothing.
    assert with_measured(network, [weak_pose(1).moved([0.0, 0.0, 0.0, 0.0, 0.0, 0.01])]) > 2 * reached


def test_named_intrinsics_count_alone(today: Expectation) -> None:
    covariance = today.covariance_intrinsics
    weight = importance(today.camera, FREE, covariance, ("focal_px", "k1"))
    # The mean of both variances over today's: 1 today.
    assert float((weight * covariance).sum()) == pytest.approx(1.0)
    assert np.count_nonzero(weight) == 2
    sight = importance(today.camera, FREE, covariance, ())
    assert float((sight * covariance).sum()) == pytest.approx(sigma_map(today.camera).rms_free_rad ** 2, rel=1e-6)


def test_views_show_the_whole_board() -> None:
    views = list(candidate_views(CAMERA, LENGTHS))
    angles = np.array([tilt_and_roll(view) for view in views])
    assert len(views) > 100
    # Tilts of 0, 30 and 45 deg of the lens's axis, in all four turns.
    assert set(np.degrees(angles[:, 0]).round().tolist()) == {0.0, 30.0, 45.0}
    assert {round(turn / (np.pi / 2)) % 4 for turn in angles[:, 1]} == {0, 1, 2, 3}
    for view in views:
        pixels = CAMERA.project(view.apply(LENGTHS.outline_m))
        assert (pixels > 0).all()
        assert (pixels < [1599, 1199]).all()
        assert 0.3 <= np.linalg.norm(view.translation_m) <= 0.7
    near = replace(LENGTHS, nearest_m=0.01, farthest_m=0.05)
    assert not list(candidate_views(CAMERA, near))


def test_places_and_sides_in_words() -> None:
    wide = replace(LENGTHS, nearest_m=0.1, farthest_m=2.0)
    tilted = rotation_from_vector(np.array([0.0, 0.6, 0.0])) @ UPRIGHT
    pose = place_in_box(CAMERA, wide, tilted, 0.4, (0.0, 1.0))
    assert pose is not None
    assert place_words(CAMERA, CAMERA.project(pose.apply(wide.outline_m))) == "bottom left"
    # Turned about y (down), what lies right goes away from z: towards the camera.
    depth = pose.apply(np.array([[0.1, 0.0, 0.0], [-0.1, 0.0, 0.0]]))[:, 2]
    assert nearer_side(pose) == ("right" if depth[0] < depth[1] else "left")
    straight = place_in_box(CAMERA, wide, UPRIGHT, 0.6, (0.5, 0.5))
    assert straight is not None
    assert nearer_side(straight) == ""
    assert place_words(CAMERA, CAMERA.project(straight.apply(wide.outline_m))) == "middle"


def weak_scene(seed: int) -> TargetScene:
    """Six photos of a bent and stretched chessboard from one distance, upright."""
    views, rng = [], np.random.default_rng(seed)
    for k in range(6):
        around, tilt = 1.05 * k + 0.3, np.radians(25)
        toward = np.array([np.sin(tilt) * np.cos(around), np.sin(tilt) * np.sin(around), np.cos(tilt)])
        views.append(View(f"photo_{k:03d}", SMALL_CAMERA, look_at(0.5 * toward, np.zeros(3), rng.uniform(-0.1, 0.1))))
    return replace(board_scene("chessboard", seed), views=tuple(views)).scaled(0.45)


def calibrated(folder: Path, scene: TargetScene) -> Result:
    content = camera_content(scene, board_table("chessboard"))
    write_target_dataset(folder, scene, content, PhotoOptions(3))
    return run(load_camera_calibration(folder), Options(leave_one_out=False, jobs=1))


@pytest.fixture(scope="module")
def weak_result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("weak")
    result = calibrated(folder / "photos", weak_scene(0))
    (folder / "result").mkdir()
    result.write(folder / "result")
    return folder / "result"


@pytest.mark.slow
def test_drawn_photos_of_a_plan(weak_result: Path, tmp_path: Path) -> None:
    """Photos of the proposed view, and of one like those there are, drawn and measured with the others."""
    found = plan.run(weak_result, plan.PlanOptions(photos=1))
    planned = sigma_map(found.photos[0].expected.camera).rms_free_rad
    scene, pose = weak_scene(0), found.photos[0].cam_from_board
    like = scene.views[1].cam_from_world.moved([0.0, 0.0, 0.0, 0.01, 0.0, 0.0])
    sigmas = []
    for name, one in (("planned", pose), ("like", like)):
        more = View("photo_100", scene.views[0].camera, one)
        sigmas.append(
            sigma_map(calibrated(tmp_path / name, replace(scene, views=(*scene.views, more))).camera).rms_free_rad
        )
    assert 0.4 < sigmas[0] / planned < 2.5
    assert sigmas[1] > 2 * sigmas[0]


@pytest.mark.slow
def test_files_of_a_plan(weak_result: Path, tmp_path: Path) -> None:
    result = open_calibration(weak_result)
    assert {"network_without_roll", "network_without_depth"} <= {one.code for one in result.doubts}
    assert "heliogauge camera plan" in " ".join(one.text for one in result.doubts)
    # What is read again is the adjustment that was written.
    again = adjusted_again(result).camera
    np.testing.assert_allclose(again.sigma_parameters, result.camera.sigma_parameters, rtol=0.02)
    found = plan.run(weak_result / "cameras.json", plan.PlanOptions(photos=2, parameters=("focal_px",)))
    found.write(tmp_path)
    table = read_table_csv(tmp_path / "next_photos.csv")
    assert table["photo"] == ["next_01", "next_02"]
    sigmas = [result.intrinsics[0].sigma, *map(float, table["sigma_focal_px"])]
    assert sigmas[0] > sigmas[1] > sigmas[2]
    cameras, poses = read_cameras_json(tmp_path / "cameras.json")
    assert list(poses) == table["photo"]
    assert 0 < cameras["camera"].sigma_parameters[0] < result.camera.sigma_parameters[0]
    summary = read_summary(tmp_path / "summary.json")
    assert summary.numbers["planned_sigma_focal_px"] == pytest.approx(sigmas[2])
    assert (tmp_path / "next_photos.svg").read_text(encoding="utf-8").count("next_0") == 2
    assert "focal_px" in found.headline()


@pytest.mark.slow
def test_impossible_wishes_are_named(weak_result: Path, tmp_path: Path) -> None:
    for options, words in (
        (plan.PlanOptions(parameters=("p9",)), "'p9': not estimated"),
        (plan.PlanOptions(photos=0), "at least one photo"),
        (plan.PlanOptions(wanted_rad=-1.0), "wanted_rad"),
        (plan.PlanOptions(nearest=2.0, farthest=1.0), "in this order"),
    ):
        with pytest.raises(InputError, match=words):
            plan.run(weak_result, options)
    with pytest.raises(EstimationError, match="no view shows the whole board"):
        plan.run(weak_result, plan.PlanOptions(nearest=0.001, farthest=0.002))
    changed = Path(shutil.copytree(weak_result, tmp_path / "changed"))
    text = (changed / "cameras.json").read_text(encoding="utf-8")
    focal = json.loads(text)["cameras"]["camera"]["focal_x_px"]
    (changed / "cameras.json").write_text(text.replace(repr(focal), repr(1.1 * focal)), encoding="utf-8")
    with pytest.raises(InputError, match="not of one calibration"):
        plan.run(changed)
    (changed / "common_errors.csv").write_text("what,sigma,unit\nlow,0.01,px\n", encoding="utf-8")
    with pytest.raises(InputError, match="point x, point y, point z is missing"):
        plan.run(changed)
    summary = json.loads((weak_result / "summary.json").read_text(encoding="utf-8"))
    (tmp_path / "summary.json").write_text(json.dumps(summary | {"kind": "observer"}), encoding="utf-8")
    with pytest.raises(InputError, match="kind 'observer'"):
        plan.run(tmp_path, plan.PlanOptions())
