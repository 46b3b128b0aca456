"""One mirror in several poses: what is wrong with camera and screen is found, and sigmas say how well."""

import json

import numpy as np
import pytest

from data_synth.fringes.dataset import PoseOptions, read_truth, write_poses
from data_synth.fringes.presets import preset_scene
from deflectometry.keys import load_deflectometry
from deflectometry.pipeline.choices import Options
from deflectometry.pipeline.inputs import build_setup
from deflectometry.poses.keys import load_poses
from deflectometry.poses.pipeline.measure import run
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform

#: Coarse: fast, and enough for what is smooth.
STEP = Options(grid_step_mm=20.0)


def draw(folder, poses, seed, width_error=0.0):
    write_poses(folder, preset_scene("small"), PoseOptions(poses, seed, width_error))
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three poses; the screen is 1 % narrower than stated, 4.4 of its stated sigmas."""
    return draw(tmp_path_factory.mktemp("poses") / "m", 3, 5, 0.01)


@pytest.fixture(scope="module")
def result(folder):
    return run(load_poses(folder), STEP)


def true_parameters(folder):
    """Camera and screen as drawn, by the names of the result's table; turns as steps from the stated pose."""
    truth = json.loads((folder / "truth.json").read_text())
    wall, camera = truth["screen"], truth["camera"]
    pose = RigidTransform.from_rotation_vector(*wall["cam_from_screen"].values())
    middle = pose.apply([0.0, 0.0, (wall["sag_x_m"] + wall["sag_y_m"]) / 3.0])
    stated = build_setup(load_deflectometry(folder / "pose_1")).cam_from_screen
    turn = RigidTransform(pose.rotation @ stated.rotation.T, np.zeros(3)).rotation_vector_rad
    return {
        "screen width": wall["width_m"],
        "screen height": wall["height_m"],
        "screen sag in x": wall["sag_x_m"],
        "screen sag in y": wall["sag_y_m"],
        **{f"screen turned about {axis}": value for axis, value in zip("xyz", turn, strict=True)},
        **{f"screen position {axis}": value for axis, value in zip("xyz", middle, strict=True)},
        **{f"camera focal length in {axis}": camera[f"focal_{axis}_px"] for axis in "xy"},
        **{f"camera principal point in {axis}": camera[f"center_{axis}_px"] for axis in "xy"},
    }


def departures(folder, result):
    """(found - true) / sigma of every parameter of camera and screen."""
    true = true_parameters(folder)
    return np.array([(one.found - true[one.name]) / one.sigma_found for one in result.parameters])


def curvature_departures(folder, result):
    """(measured - true) / sigma of both curvatures, the true ones from the true slopes at the same nodes."""
    slope_map = result.assembled
    valid = slope_map.valid
    x_m, y_m = (values[valid] for values in np.meshgrid(slope_map.x_m, slope_map.y_m))
    true_x, true_y = read_truth(folder / "pose_1").slopes(x_m, y_m)
    found = (
        np.polyfit(x_m, slope_map.slope_x[valid] - true_x, 1)[0],
        np.polyfit(y_m, slope_map.slope_y[valid] - true_y, 1)[0],
    )
    sigma = [result.numbers[f"sigma_curvature_{axis}_per_m"] for axis in "xy"]
    return np.array(found) / sigma


@pytest.mark.slow
def test_a_wrong_width_is_found_and_said(folder, result):
    width = next(one for one in result.parameters if one.name == "screen width")
    assert abs(width.found - 8.727) < 3 * width.sigma_found < 0.02
    assert width.stated - 8.727 == pytest.approx(0.087, abs=0.05)
    assert "stated_setup_contradicts_poses" in {doubt.code for doubt in result.doubts}
    assert "poses_differ" not in {doubt.code for doubt in result.doubts}


@pytest.mark.slow
def test_focal_lengths_are_within_their_sigmas_and_surer(folder, result):
    assert (np.abs(curvature_departures(folder, result)) < 3.0).all()
    # 1 % of width in one pose: 50 to 100 sigma of what the poses leave together.
    alone = result.poses[0].numbers
    assert result.numbers["sigma_curvature_x_per_m"] < 0.2 * alone["sigma_curvature_x_per_m"]
    assert result.poses[1].numbers["curvature_x_per_m"] - result.numbers["curvature_x_per_m"] > (
        10 * result.numbers["sigma_curvature_x_per_m"]
    )


@pytest.mark.slow
def test_all_parameters_are_within_their_sigmas(folder, result):
    assert np.sqrt(np.mean(departures(folder, result) ** 2)) < 1.6
    assert (np.abs(departures(folder, result)) < 4.0).all()
    distances = [json.loads((folder / one.name / "truth.json").read_text())["cam_from_mirror"] for one in result.poses]
    for one, true in zip(result.poses, distances, strict=True):
        assert abs(one.distance_m - np.linalg.norm(true["translation_m"])) < 3 * one.sigma_distance_m
        assert one.sigma_distance_m < one.sigma_outline_distance_m


@pytest.mark.slow
def test_turning_alone_leaves_the_focus_as_stated(tmp_path):
    """Two poses a quarter turn apart: width against height is found, both together are focus of the mirror."""
    found = run(load_poses(draw(tmp_path / "m", 2, 3)), STEP)
    index = [one.source for one in found.steps].index("screen size")
    covariance = found.solution.covariance_common[index : index + 2, index : index + 2]
    # Shares of width and height: 20 mm of 8.7 m and 10 mm of 3.5 m.
    share = np.array([20 / 8727, 10 / 3476])
    apart, together = (float(np.sqrt(one @ covariance @ one)) for one in (share * [1, 1], share * [1, -1]))
    assert min(apart, together) < 0.1 * np.hypot(*share)
    assert max(apart, together) > 4 * min(apart, together)
    assert "not determined, as stated" in found.summarise().texts["setup"]


@pytest.mark.slow
def test_an_exact_width_that_is_wrong_makes_the_poses_differ(folder, tmp_path):
    for file in folder.rglob("*"):
        if file.is_file():
            copy = tmp_path / file.relative_to(folder)
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes(file.read_bytes())
    for file in tmp_path.glob("pose_*/measurement.toml"):
        lines = file.read_text().splitlines()
        file.write_text("\n".join("sigma_width_mm = 0.0" if one.startswith("sigma_width_mm") else one for one in lines))
    found = run(load_poses(tmp_path), STEP)
    assert "poses_differ" in {doubt.code for doubt in found.doubts}
    assert found.solution.noise_factor > 3.0


def test_poses_of_different_screens_are_refused(folder, tmp_path):
    for name in ("measurement.toml", *(f"pose_{number}/measurement.toml" for number in range(1, 4))):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    for file in folder.glob("pose_*/*.png"):
        (tmp_path / file.relative_to(folder)).hardlink_to(file)
    other = tmp_path / "pose_3" / "measurement.toml"
    other.write_text(other.read_text().replace("sigma_sag_mm = 5.0", "sigma_sag_mm = 6.0"))
    with pytest.raises(InputError, match=r"screen\.sigma_sag_mm is not the same in pose_1 and pose_3"):
        load_poses(tmp_path)


@pytest.mark.slow
def test_a_pose_that_cannot_be_measured_is_left_out(folder, tmp_path):
    content = (folder / "measurement.toml").read_text()
    for name in [f"pose_{number}" for number in (1, 2, 3)]:
        (tmp_path / name).mkdir()
        for file in (folder / name).iterdir():
            (tmp_path / name / file.name).write_bytes(file.read_bytes())
    (tmp_path / "measurement.toml").write_text(content)
    dark = (folder / "pose_1" / "dark.png").read_bytes()
    for file in (tmp_path / "pose_2").glob("*.png"):
        file.write_bytes(dark)
    found = run(load_poses(tmp_path), STEP)
    assert [one.name for one in found.poses] == ["pose_1", "pose_3"]
    assert "pose_left_out" in {doubt.code for doubt in found.doubts}


@pytest.mark.slow
@pytest.mark.parametrize("poses", [2, 4])
def test_parameters_and_curvatures_scatter_as_their_sigmas_say(poses, tmp_path):
    """Twelve drawings, each with its own errors of camera and screen and its own noise."""
    of_setup, of_curvature = [], []
    for seed in range(12):
        folder = draw(tmp_path / str(seed), poses, 100 + seed)
        found = run(load_poses(folder), STEP)
        of_setup.append(departures(folder, found))
        of_curvature.append(curvature_departures(folder, found))
    # Parameters of one drawing are correlated: about three independent ones in fourteen.
    assert 0.6 < np.sqrt(np.mean(np.square(of_setup))) < 1.35
    assert 0.5 < np.sqrt(np.mean(np.square(of_curvature))) < 1.5
