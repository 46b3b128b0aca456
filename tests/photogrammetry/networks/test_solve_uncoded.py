"""Targets without a code in the pipeline: all of them, their names, and what is refused."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from data_synth.targets.dataset import PhotoOptions, photogrammetry_content, write_target_dataset
from data_synth.targets.presets import PrintChoice, target_scene
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.measurement.load import parse_measurement
from heliogauge.measurement.writer import dump_toml
from photogrammetry.keys.load import load_photogrammetry
from photogrammetry.pipeline.inputs import listed_targets
from photogrammetry.pipeline.measure import run
from photogrammetry.pipeline.result import Result
from tests.photogrammetry.pipeline.test_pipeline import chi_square_per_rank, with_true_names


def made(folder: Path, preset: str) -> Path:
    scene = target_scene(preset, 0, PrintChoice(None, False, False))
    write_target_dataset(folder, scene, photogrammetry_content(scene), PhotoOptions(3, None))
    return folder


def listing(folder: Path, *, sigma_m: float = 0.003) -> list[str]:
    """Lines of a table of the dots in a frame of its own, with what a tape measure adds."""
    truth = json.loads((folder / "truth.json").read_text())["points_m"]
    rng = np.random.default_rng(1)
    frame = RigidTransform.from_rotation_vector([0.4, 2.0, -1.0], [3.0, -2.0, 7.0])
    lines = ["id,x_m,y_m,z_m,sigma_mm"]
    for name, place in truth.items():
        if name.startswith("dot"):
            x, y, z = frame.apply(np.array(place)) + sigma_m * rng.standard_normal(3)
            lines.append(f"rim-{name},{x:.4f},{y:.4f},{z:.4f},{1e3 * sigma_m}")
    return lines


@pytest.fixture(scope="module")
def named(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    """The small panel with a table of 11 of its 12 dots, and of one that is not there."""
    folder = made(tmp_path_factory.mktemp("photos") / "panel", "small")
    lines = listing(folder)
    (folder / "rim.csv").write_text("\n".join([*lines[:6], *lines[7:], "rim-lost,3.0,-2.0,9.0,3.0"]) + "\n")
    content = tomllib.loads((folder / "measurement.toml").read_text())
    content["targets"]["uncoded_file"] = "rim.csv"
    (folder / "measurement.toml").write_text(dump_toml(content))
    return folder, run(load_photogrammetry(folder))


@pytest.mark.slow
def test_listed_dots_keep_their_names(named: tuple[Path, Result]) -> None:
    folder, result = named
    names = result.solved.bundle.problem.observations.targets
    true = with_true_names(result, json.loads((folder / "truth.json").read_text())["points_m"])
    pairs = {name: right for name, right in zip(names, true, strict=True) if not name.isdecimal()}
    assert len(pairs) == 12
    # The one that is not listed gets a number.
    assert [name for name in pairs if name.startswith("u")] == ["u1"]
    assert all(name == f"rim-{right}" for name, right in pairs.items() if name != "u1")
    assert any(one.name == "rim-lost" and "no point agrees" in one.reason for one in result.refused)
    assert "rim.csv" in result.input_sha256


@pytest.mark.slow
def test_dots_have_honest_sigmas(named: tuple[Path, Result]) -> None:
    folder, result = named
    ratio, rank, _ = chi_square_per_rank(result, folder)
    assert rank == 3 * 52 - 6
    assert abs(ratio - 1) < 4 * np.sqrt(2 / rank)
    rays = dict(zip(result.points.ids, result.points.n_rays.tolist(), strict=True))
    assert min(rays.values()) >= 7


@pytest.mark.slow
@pytest.mark.parametrize(("preset", "unread"), [("retro", False), ("busy", True)])
def test_bright_dots_on_black_and_busy_ground(tmp_path: Path, preset: str, unread: bool) -> None:
    """Nothing but the 12 dots: no piece of an unread code ring, no clutter."""
    folder = made(tmp_path / preset, preset)
    result = run(load_photogrammetry(folder))
    truth = json.loads((folder / "truth.json").read_text())["points_m"]
    names = result.solved.bundle.problem.observations.targets
    true = with_true_names(result, truth)
    found = [right for name, right in zip(names, true, strict=True) if name.startswith("u")]
    assert sorted(found) == sorted(name for name in truth if name.startswith("dot"))
    # Codes behind something are dots in some photos; where all are read there is nothing to say.
    assert any("its code was not read" in one.reason for one in result.refused) is unread


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["id,x_m,y_m,z_m"], "sigma_mm"),
        (["id,x_m,y_m,z_m,sigma_mm", "a,1,2,3,4", "a,1,2,3,4"], "line 3: id 'a' is empty or listed twice"),
        (["id,x_m,y_m,z_m,sigma_mm", "a,1,2,x,4"], "line 2: could not convert"),
        (["id,x_m,y_m,z_m,sigma_mm", "a,1,2,3,0"], "line 2: finite coordinates and a positive sigma_mm"),
    ],
)
def test_mistakes_in_the_table(tmp_path: Path, lines: list[str], message: str) -> None:
    (tmp_path / "rim.csv").write_text("\n".join(lines) + "\n")
    model = parse_measurement(content_with({"uncoded_file": "rim.csv"}), Path("measurement.toml"))
    with pytest.raises(InputError, match=message):
        listed_targets(model.targets, tmp_path)


def content_with(targets: dict) -> dict:
    return {
        "kind": "photogrammetry",
        "name": "a",
        "images": {"photos": "*.png"},
        "targets": {"dictionary": "aicon-12", **targets},
    }


@pytest.mark.parametrize(
    ("targets", "message"),
    [
        ({"find_uncoded": False, "uncoded_file": "rim.csv"}, "leave one of both out"),
        ({"uncoded": [{"target": "a", "xyz_m": [0, 0, 0], "sigma_mm": 1.0}] * 2}, "a is listed twice"),
        ({"uncoded": [{"target": "a", "xyz_m": [0, 0, 0]}]}, "sigma_mm"),
        ({"find_uncodet": True}, "did you mean 'find_uncoded'"),
    ],
)
def test_mistakes_in_the_file(targets: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse_measurement(content_with(targets), Path("measurement.toml"))
