"""What is known, from tables and measurement.toml to the result: control, bars, start values, collector, datums."""

import numpy as np
import pytest

from heliogauge.results.tables import read_cameras_json, write_table_csv
from photogrammetry.bundle.state import BundleState
from tests.photogrammetry.bundle_networks import network, observe
from tests.photogrammetry.network_jobs import (
    command,
    fitted,
    length,
    points_of,
    sigmas_of,
    summary_of,
    views,
    write_job,
)

SIZE = {"width_px": 6000, "height_px": 4000}


@pytest.fixture(scope="module")
def job():
    """Ten photos of 30 targets on a panel of 2 m, the camera known."""
    truth, points = network(np.random.default_rng(11), 10, 30, size_m=1.0)
    camera = truth.cameras[0]
    lens = {name: getattr(camera.distortion, name) for name in ("k1", "k2", "k3", "p1", "p2")}
    own = {
        "focal_px": camera.focal_y_px,
        "aspect": camera.focal_y_px / camera.focal_x_px - 1,
        "center_x_px": camera.center_x_px,
        "center_y_px": camera.center_y_px,
    }
    return truth, points, {**SIZE, **own, **lens}


def bars(truth, *pairs, sigma_mm=0.005):
    return {
        "a": [f"t{a}" for a, _ in pairs],
        "b": [f"t{b}" for _, b in pairs],
        "length_m": [length(truth, a, b) for a, b in pairs],
        "sigma_mm": [sigma_mm] * len(pairs),
    }


def control(truth, numbers, sigma_mm=None):
    columns = {"target": [f"t{k}" for k in numbers]}
    columns |= {f"{axis}_m": truth.points_m[numbers, i] for i, axis in enumerate("xyz")}
    return columns | ({} if sigma_mm is None else {f"sigma_{axis}_mm": [sigma_mm] * len(numbers) for axis in "xyz"})


@pytest.mark.parametrize("sigma_mm", [None, 0.05])
def test_control_points_from_a_table(job, tmp_path, sigma_mm):
    truth, points, camera = job
    folder = write_job(
        tmp_path / "in", points, camera=camera, files={"control_points": "control.csv"}, datum={"kind": "control"}
    )
    write_table_csv(folder / "control.csv", control(truth, [0, 5, 9, 14], sigma_mm))
    assert command(folder, tmp_path / "out") == 0
    found, sigmas = points_of(tmp_path / "out"), sigmas_of(tmp_path / "out")
    miss = np.array([(found[name] - truth.points_m[int(name[1:])]) for name in found])
    spread = np.array([sigmas[name] for name in found])
    held = (spread == 0).all(axis=1)
    assert held.sum() == (4 if sigma_mm is None else 0)
    assert np.abs(miss[~held] / spread[~held]).max() < 5
    assert summary_of(tmp_path / "out")["texts"]["datum"].startswith("all of it from 4")


def test_control_that_leaves_something_open_is_an_error(job, tmp_path, capsys):
    truth, points, camera = job
    folder = write_job(
        tmp_path / "in", points, camera=camera, files={"scale_bars": "bars.csv"}, datum={"kind": "control"}
    )
    write_table_csv(folder / "bars.csv", bars(truth, (0, 1)))
    assert command(folder, tmp_path / "out") == 2
    assert "leave 3 of position, 3 of rotation open" in " ".join(capsys.readouterr().err.split())


@pytest.mark.slow
def test_scale_bars_from_a_table_and_the_datum_of_a_photo(job, tmp_path):
    truth, points, camera = job
    means = {}
    for name, datum in (
        ("inner", {"kind": "inner"}),
        ("some", {"kind": "inner", "targets": ["t0", "t5", "t9", "t14"]}),
        ("photos", {"kind": "photos", "photos": ["photo3"]}),
    ):
        folder = write_job(tmp_path / name, points, camera=camera, files={"scale_bars": "bars.csv"}, datum=datum)
        table = bars(truth, (0, 1), (2, 3), (4, 7))
        write_table_csv(folder / "bars.csv", {**table, "check_only": ["0", "", "1"]})
        assert command(folder, tmp_path / f"{name} out") == 0
        summary = summary_of(tmp_path / f"{name} out")
        assert abs(summary["numbers"]["length_error_rms_m"]) < 6e-5
        means[name] = np.mean(np.square(list(sigmas_of(tmp_path / f"{name} out").values())))
        if name == "photos":
            assert "photo3 (position and rotation)" in summary["texts"]["datum"]
            pose = read_cameras_json(tmp_path / "photos out" / "cameras.json")[1]["photo3"]
            # The world is that photo's camera.
            np.testing.assert_allclose(pose.cam_from_world.rotation, np.eye(3), atol=1e-12)
            np.testing.assert_allclose(pose.cam_from_world.translation_m, 0.0, atol=1e-12)
            np.testing.assert_array_equal(pose.covariance, 0.0)
    assert means["inner"] < means["some"] < means["photos"]


def test_inner_datum_takes_over_start_coordinates(job, tmp_path):
    """The frame is that of the coordinates in the file: best fit over the datum's targets, the scale from the bar."""
    truth, points, camera = job
    given = truth.points_m * 1.002 + np.random.default_rng(0).normal(0, 1e-3, truth.points_m.shape) + [5.0, -3.0, 1.0]
    folder = write_job(
        tmp_path / "in", points, camera=camera, files={"scale_bars": "bars.csv"}, start={"points": "start.csv"}
    )
    write_table_csv(folder / "bars.csv", bars(truth, (0, 1)))
    columns = {f"{axis}_m": given[:, i] for i, axis in enumerate("xyz")}
    write_table_csv(folder / "start.csv", {"id": [f"t{k}" for k in range(30)], **columns})
    assert command(folder, tmp_path / "out") == 0
    found = points_of(tmp_path / "out")
    own = np.array([found[f"t{k}"] for k in range(30)])
    np.testing.assert_allclose(own.mean(axis=0), given.mean(axis=0), atol=1e-7)
    arms, far = own - own.mean(axis=0), given - given.mean(axis=0)
    np.testing.assert_allclose(np.cross(arms, far).sum(axis=0), 0, atol=2e-6)
    assert np.abs(fitted(found, truth.points_m)).max() < 1.5e-4


@pytest.mark.parametrize(
    ("table", "content", "message"),
    [
        ("control_points", "target,x_m,y_m,z_m\nt0,0,0,0\nt0,1,0,0\n", "control point t0 is given twice"),
        ("control_points", "target,x_m,y_m,z_m\nt0,0,nul,0\n", "line 2: could not convert string to float: 'nul'"),
        ("control_points", "target,x_m,y_m\nt0,0,0\n", "the columns z_m are missing"),
        ("control_points", "target,x_m,y_m,z_m\nt0,0,nan,0\n", "line 2: xyz_m.1: Input should be a finite number"),
        ("scale_bars", "a,b,length_m,sigma_mm\nt0,t1,-1,0.1\n", "line 2: length_m: Input should be greater than 0"),
        ("scale_bars", "a,b,length_m,sigma_mm,check_only\nt0,t1,1,0.1,yes\n", "check_only = 'yes'"),
        ("coordinates", "target,axis,value_m,sigma_mm\nt0,w,1,0.1\n", "line 2: axis"),
    ],
)
def test_mistakes_in_tables(job, tmp_path, capsys, table, content, message):
    _, points, camera = job
    folder = write_job(tmp_path / "in", points, camera=camera, files={table: "known.csv"})
    (folder / "known.csv").write_text(content)
    assert command(folder, tmp_path / "out") == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "known.csv" in said
    assert message in said


def test_a_table_that_is_not_there(job, tmp_path, capsys):
    _, points, camera = job
    folder = write_job(tmp_path / "in", points, camera=camera, files={"control_points": "nowhere.csv"})
    assert command(folder, tmp_path / "out") == 2
    assert "there is no file nowhere.csv" in " ".join(capsys.readouterr().err.split())


def test_collector_recipe(tmp_path):
    """A trough with targets on its rim (spec 002, 1.4): its frame and scale come from its shape, within the sigmas."""
    width, focal, long = 5.76, 1.71, 11.9
    rng = np.random.default_rng(12)
    along = np.linspace(0, long, 7)
    height = width**2 / (16 * focal)
    left = np.column_stack([np.full(7, -width / 2), along, np.full(7, height)])
    right = left * [-1, 1, 1]
    ground = np.column_stack([rng.uniform(-4, 4, 20), rng.uniform(-1, long + 1, 20), rng.uniform(-2.5, -2, 20)])
    built = np.concatenate([left, right]) + rng.normal(0, 5e-4, (14, 3)) * [1, 1, 1]
    truth, _ = network(np.random.default_rng(1), 4, 8)
    centers = [(9 * np.cos(a), long / 2 + 11 * np.sin(a), 5 + i % 3) for i, a in enumerate(np.linspace(0, 6.0, 12))]
    state = views(
        rng,
        [np.array(c) - [0, long / 2, 0] for c in centers],
        np.concatenate([built, ground]) - [0, long / 2, 0],
        truth.cameras,
    )
    moved = BundleState(state.cameras, state.rotations, state.translations_m, state.points_m)
    points = observe(moved, rng, 0.1)
    names = [f"t{k}" for k in range(7)], [f"t{k}" for k in range(7, 14)]
    collector = {
        "width_m": width,
        "focal_length_m": focal,
        "left": names[0],
        "right": names[1],
        "end": ["t0", "t7"],
        "along": [["t0", "t6"], ["t7", "t13"]],
        "length_m": long,
        "sigma_mm": 0.5,
        "length_sigma_mm": 1.0,
    }
    folder = write_job(tmp_path / "in", points, camera={**SIZE, "focal_length_35mm": 36.0}, collector=collector)
    assert command(folder, tmp_path / "out") == 0
    found, sigmas = points_of(tmp_path / "out"), sigmas_of(tmp_path / "out")
    summary = summary_of(tmp_path / "out")
    assert summary["texts"]["datum"] == "all of it from 32 constraints"
    miss = np.array([found[f"t{k}"] - np.concatenate([built, ground])[k] for k in range(34)])
    # Frame and scale are common to all: errors over sigma scatter less than those of single points.
    ratio = np.sqrt(np.mean((miss / np.array([sigmas[f"t{k}"] for k in range(34)])) ** 2))
    assert 0.2 < ratio < 2.0
    assert np.abs(miss[:14]).max() < 3e-3
