"""Synthetic measurement folders: complete, readable, repeatable, never half-written, never over something else."""

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from typer.testing import CliRunner

from data_synth.fringes import dataset
from data_synth.fringes.dataset import DatasetOptions, read_truth, write_dataset
from data_synth.fringes.knowledge import Knowledge, screen_table
from data_synth.fringes.presets import PRESETS, facet_scene, preset_scene, rectangle, standard_errors
from data_synth.optics.mirror import Design, SyntheticFacet
from data_synth.optics.pinhole import PinholeCamera
from data_synth.optics.wall import Wall
from deflectometry import load_deflectometry
from deflectometry.setup import make_pattern
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.images.photos import read_frames
from heliogauge.running.cli import app
from heliogauge.running.commands import parse_periods


@pytest.fixture(scope="module")
def scene():
    facet = SyntheticFacet("facet", rectangle(1.2, 1.2), Design("sphere", {"radius_m": 50.0}), standard_errors())
    camera = PinholeCamera(51, 39, 172.0, 171.0, 25.0, 19.0, -0.1)
    return replace(facet_scene("small facet", (facet,), camera=camera), pattern=make_pattern([0.9, 3.9], [0.9, 3.9], 3))


def _hashes(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.iterdir())}


def test_the_folder_is_a_measurement_that_loads(scene, tmp_path):
    written = write_dataset(tmp_path / "set", scene)
    measurement = load_deflectometry(tmp_path / "set")
    frames = read_frames(measurement.fringe_files).images_dn
    assert_array_equal(frames, written.frames)
    model = measurement.model
    assert model.camera.focal_y_px == 171.0
    assert model.mirror.radius_m == 50.0
    assert [one.axis for one in model.pattern.set] == ["y", "y", "x", "x"]
    stated = RigidTransform.from_rotation_vector(model.screen.rotation_vector_rad, model.screen.translation_m)
    assert_allclose(stated.rotation, scene.bench.cam_from_wall.rotation, atol=1e-14)
    true = np.linalg.norm(scene.bench.cam_from_wall.translation_m - scene.bench.cam_from_mirror.translation_m)
    assert abs(model.mirror.distance.distance_m - true) < 4e-3
    assert not list(tmp_path.glob(".*"))


def test_the_truth_comes_back_exactly(scene, tmp_path):
    written = write_dataset(tmp_path / "set", scene, DatasetOptions(seed=3)).truth
    read = read_truth(tmp_path / "set")
    assert read.parameters["seed"] == 3
    for name in ("facet_index", "x_m", "slope_error_y", "v"):
        assert_array_equal(getattr(read.pixels, name), getattr(written.pixels, name))
    x, y = np.random.default_rng(0).uniform(-0.6, 0.6, (2, 50))
    assert_array_equal(read.slopes(x, y), written.slopes(x, y))
    assert_array_equal(read.slope_errors(x, y), written.slope_errors(x, y))


def test_the_seed_decides_every_byte(scene, tmp_path):
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        write_dataset(tmp_path / name, scene, DatasetOptions(seed=seed))
    first, again, other = (_hashes(tmp_path / name) for name in "abc")
    assert first == again
    assert first["fringe_00.png"] != other["fringe_00.png"]


def test_a_known_pose_is_stated_with_errors_of_its_sigma(scene, tmp_path):
    exact = Knowledge(pose_known=True)
    write_dataset(tmp_path / "exact", scene, DatasetOptions(knowledge=exact))
    pose = load_deflectometry(tmp_path / "exact").model.mirror.pose
    assert_allclose(pose.translation_m, scene.bench.cam_from_mirror.translation_m, atol=1e-15)
    vague = Knowledge(pose_known=True, sigma_pose_rotation_mrad=2.0, sigma_pose_translation_mm=5.0)
    steps = []
    for seed in range(3):
        write_dataset(tmp_path / str(seed), scene, DatasetOptions(seed=seed, knowledge=vague))
        pose = load_deflectometry(tmp_path / str(seed)).model.mirror.pose
        steps.append(np.array(pose.translation_m) - scene.bench.cam_from_mirror.translation_m)
        assert pose.sigma_rotation_mrad == (2.0, 2.0, 2.0)
    assert 1e-3 < np.std(steps) < 1e-2


def test_a_curved_screen_comes_as_a_table(scene, tmp_path):
    wall = Wall(8.727, 3.476, 0.1, 0.0, 0.02, 0.0)
    curved = replace(scene, bench=replace(scene.bench, wall=wall))
    write_dataset(tmp_path / "set", curved)
    assert load_deflectometry(tmp_path / "set").model.screen.file == "screen_points.csv"
    table = np.genfromtxt(tmp_path / "set" / "screen_points.csv", delimiter=",", names=True)
    assert_allclose(wall.points_m(table["u"], table["v"])[:, 2], table["z_m"], atol=1e-15)
    # The table's chords follow the wall (its own promise).
    columns = screen_table(Wall(8.0, 3.0, 0.12), 81)
    z = np.array(columns["z_m"]).reshape(81, 81)[0]
    u = np.array(columns["u"])[:81]
    between = 0.5 * (u[:-1] + u[1:])
    bulge = Wall(8.0, 3.0, 0.12).points_m(between, np.zeros(80))[:, 2] - 0.5 * (z[:-1] + z[1:])
    assert np.abs(bulge).max() < 2e-5


def test_gamma_comes_with_a_response(scene, tmp_path):
    bent = replace(scene, lighting=replace(scene.lighting, gamma=2.2))
    write_dataset(tmp_path / "set", bent, DatasetOptions(knowledge=Knowledge(response=True)))
    table = np.genfromtxt(tmp_path / "set" / "response.csv", delimiter=",", names=True)
    assert np.all(np.diff(table["camera_dn"]) > 0)
    assert_allclose(table["display_level"][[0, -1]], [0, 1])


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_deep_images_are_written_as_they_are(scene, tmp_path, bits):
    deep = replace(scene, sensor=replace(scene.sensor, bits=bits))
    written = write_dataset(tmp_path / "set", deep)
    measurement = load_deflectometry(tmp_path / "set")
    first = read_frames(measurement.fringe_files[:1]).images_dn[0]
    assert_array_equal(first, written.frames[0])
    assert measurement.model.images.saturation_dn == 2**bits - 1


def test_files_that_are_there_are_not_touched(scene, tmp_path):
    target = tmp_path / "set"
    target.mkdir()
    (target / "photo.jpg").write_text("precious")
    with pytest.raises(InputError, match="holds files already"):
        write_dataset(target, scene)
    with pytest.raises(InputError, match="synthetic measurements only"):
        write_dataset(target, scene, DatasetOptions(force=True))
    assert _hashes(target).keys() == {"photo.jpg"}
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="a file stands"):
        write_dataset(tmp_path / "file", scene)


def test_a_failure_leaves_the_earlier_measurement(scene, tmp_path, monkeypatch):
    target = tmp_path / "set"
    write_dataset(target, scene)
    before = _hashes(target)

    def fail(*_arguments):
        raise OSError("disk full")

    monkeypatch.setattr(dataset, "write_json", fail)
    with pytest.raises(OSError, match="disk full"):
        write_dataset(target, scene, DatasetOptions(seed=9, force=True))
    assert _hashes(target) == before
    assert [path.name for path in tmp_path.iterdir()] == ["set"]


def test_damaged_truth_is_one_clear_error(scene, tmp_path):
    write_dataset(tmp_path / "set", scene)
    (tmp_path / "set" / "truth.npz").write_bytes(b"PK\x03\x04 broken")
    with pytest.raises(InputError, match=r"truth\.npz"):
        read_truth(tmp_path / "set")
    with pytest.raises(InputError, match=r"truth\.json"):
        read_truth(tmp_path)


def test_the_ensemble_states_its_facets(tmp_path):
    facets = preset_scene("ensemble").facets
    assert len(facets) == 24
    few = facet_scene("six", facets[8:10], camera=PinholeCamera(101, 77, 343.0, 343.0, 50.0, 38.0))
    written = write_dataset(tmp_path / "set", replace(few, pattern=make_pattern([0.9], [0.9])))
    model = load_deflectometry(tmp_path / "set").model
    assert [facet.name for facet in model.mirror.facet] == [facet.name for facet in facets[8:10]]
    assert set(np.unique(written.truth.pixels.facet_index)) == {-1, 0, 1}
    canted = [facet.errors.evaluate(np.array(0.0), np.array(0.0))[1] for facet in facets]
    assert 1e-4 < np.std(canted) < 5e-4


def test_command_line(tmp_path):
    out = tmp_path / "set"
    arguments = ["deflectometry", "synth", str(out), "--periods", "0.9,3.9", "--steps", "3", "--noise-dn", "0.5", "-q"]
    result = CliRunner().invoke(app, [*arguments, "--fault", "swapped:2", "--pose-known"])
    assert result.exit_code == 0, result.output
    truth = read_truth(out).parameters
    assert truth["sensor"]["read_noise_dn"] == 0.5
    assert truth["faults"] == [{"kind": "swapped", "amount": 2.0}]
    assert load_deflectometry(out).model.mirror.pose is not None
    again = CliRunner().invoke(app, arguments)
    assert isinstance(again.exception, InputError)


def test_impossible_words_are_refused():
    with pytest.raises(InputError, match="one of small"):
        preset_scene("huge")
    with pytest.raises(InputError, match="with commas"):
        parse_periods("0.9;3.9")


@pytest.mark.parametrize("name", sorted(set(PRESETS) - {"full"}))
def test_surfaces_meet_their_design_at_the_facets_origin(name):
    for facet in preset_scene(name).facets:
        assert abs(facet.errors.evaluate(np.array(0.0), np.array(0.0))[0]) < 1e-18
        assert abs(facet.surface(np.array(0.0), np.array(0.0))[0]) < 1e-15
