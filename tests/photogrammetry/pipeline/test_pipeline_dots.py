"""Photos with dots only: followed from marks set by hand, or told by a list of rough places."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data_synth.optics.photo import View
from data_synth.optics.prints import DotPrint
from data_synth.targets.dataset import PhotoOptions, photogrammetry_content, write_target_dataset
from data_synth.targets.presets import SMALL_CAMERA, PrintChoice, look_at, target_scene
from heliogauge.errors import EstimationError, InputError
from heliogauge.measurement.writer import dump_toml
from heliogauge.results.folder import read_table_csv
from photogrammetry.keys.load import load_photogrammetry
from photogrammetry.pipeline.measure import run
from photogrammetry.pipeline.result import Result

CAMERA = {
    "width_px": 1600,
    "height_px": 1200,
    "focal_px": 1508.0,
    "aspect": 1508.0 / 1510.0 - 1,
    "center_x_px": 806.0,
    "center_y_px": 593.0,
    "k1": -0.08,
    "k2": 0.06,
    "p1": 2e-4,
    "p2": -3e-4,
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six photos along a path round the 12 dots of the small panel, with a table of marks and one of rough places."""
    scene = target_scene("small", 0, PrintChoice(None, False, False))
    views = []
    for k in range(6):
        angle = np.radians(-14 + 5.5 * k)
        place = 2.2 * np.array([np.sin(angle), 0.15 * (k % 3), np.cos(angle)])
        views.append(View(f"photo_{k + 1:03d}", SMALL_CAMERA, look_at(place, np.array([0.02, 0.01, 0.1]), 0.05 * k)))
    sheets = tuple(sheet for sheet in scene.sheets if isinstance(sheet.figure, DotPrint))
    scene = replace(scene, views=tuple(views), sheets=sheets, lengths=())
    made = tmp_path_factory.mktemp("dots") / "walk"
    write_target_dataset(made, scene, photogrammetry_content(scene), PhotoOptions(3, None))
    true = read_table_csv(made / "image_points_true.csv")
    rng = np.random.default_rng(0)
    rows = [
        f"{image},{target},{float(x) + rng.uniform(-2, 2):.1f},{float(y) + rng.uniform(-2, 2):.1f}"
        for image, target, x, y in zip(true["image"], true["target"], true["x_px"], true["y_px"], strict=True)
        if image == "photo_003.png"
    ]
    (made / "marks.csv").write_text("\n".join(["image,target,x_px,y_px", *rows]) + "\n")
    places = json.loads((made / "truth.json").read_text())["points_m"]
    lines = [
        f"rim-{name}," + ",".join(f"{v + 0.003 * rng.standard_normal():.4f}" for v in place) + ",3.0"
        for name, place in places.items()
    ]
    (made / "rim.csv").write_text("\n".join(["id,x_m,y_m,z_m,sigma_mm", *lines]) + "\n")
    return made


def evaluated(folder: Path, targets: dict, camera: dict = CAMERA) -> Result:
    file = folder / "measurement.toml"
    content = tomllib.loads(file.read_text())
    content["targets"], content["camera"] = {"polarity": "black-on-white", **targets}, camera
    content.pop("scale_bar", None)
    file.write_text(dump_toml(content))
    return run(load_photogrammetry(folder))


def largest_error_in_sigma(result: Result, folder: Path, prefix: str) -> float:
    """Errors after the best similarity over the sigmas, the largest."""
    truth = json.loads((folder / "truth.json").read_text())["points_m"]
    bundle = result.solved.bundle
    wanted = np.array([truth[name.removeprefix(prefix)] for name in bundle.problem.observations.targets])
    own, far = bundle.points_m - bundle.points_m.mean(axis=0), wanted - wanted.mean(axis=0)
    left, singular, right = np.linalg.svd(far.T @ own)
    sign = np.diag([1, 1, np.sign(np.linalg.det(left @ right))])
    scale = np.trace(np.diag(singular) @ sign) / (own**2).sum()
    return float(np.max(np.abs(scale * own @ (left @ sign @ right).T - far) / (scale * bundle.sigma_points_m)))


def test_marks_are_followed_forwards_and_backwards(folder: Path) -> None:
    result = evaluated(folder, {"tracked_from": "marks.csv"})
    table = result.solved.bundle.problem.observations
    assert sorted(table.targets) == sorted(f"dot{k}" for k in range(1, 13))
    assert (table.n_rays >= 5).all()
    assert largest_error_in_sigma(result, folder, "") < 5
    assert "marks.csv" in result.input_sha256


def test_a_list_of_rough_places_tells_the_dots(folder: Path) -> None:
    sense = {"up": [0.0, 1.0, 0.0], "front": [0.0, 0.0, 1.0]}
    result = evaluated(folder, {"uncoded_file": "rim.csv", **sense})
    table = result.solved.bundle.problem.observations
    assert sorted(table.targets) == sorted(f"rim-dot{k}" for k in range(1, 13))
    assert (table.n_rays >= 5).all()
    assert largest_error_in_sigma(result, folder, "rim-") < 5
    # Place, attitude and scale are those of the list.
    truth = json.loads((folder / "truth.json").read_text())["points_m"]
    wanted = np.array([truth[name.removeprefix("rim-")] for name in table.targets])
    assert np.abs(result.solved.bundle.points_m - wanted).max() < 0.01


def test_list_needs_a_known_camera(folder: Path) -> None:
    with pytest.raises(InputError, match="named by their list only with a known camera"):
        evaluated(folder, {"uncoded_file": "rim.csv"}, {})


def test_list_of_something_else(folder: Path) -> None:
    rows = [f"x{k},{k},{k * k},{0.1 * k**3},1.0" for k in range(5)]
    (folder / "other.csv").write_text("\n".join(["id,x_m,y_m,z_m,sigma_mm", *rows]) + "\n")
    with pytest.raises(EstimationError, match="in none of 6 photos the list names the dots; assignment: no pose"):
        evaluated(folder, {"uncoded_file": "other.csv"})


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([], "there are no marks"),
        (["photo_009.png,a,1,2"], "line 2: 'photo_009.png' is none of the photos"),
        (["photo_001.png,a,1,x"], "line 2: could not convert"),
        (["photo_001.png,,1,2"], "line 2: a target needs a name"),
        (["photo_001.png,a,1,2", "photo_002.png,a,1,2"], "mark one photo only"),
        (["photo_001.png,a,3.0,3.0"], "no round target under a at"),
    ],
)
def test_mistakes_in_marks(folder: Path, rows: list[str], message: str) -> None:
    (folder / "bad.csv").write_text("\n".join(["image,target,x_px,y_px", *rows]) + "\n")
    with pytest.raises(InputError, match=message):
        evaluated(folder, {"tracked_from": "bad.csv"})


def test_no_way_to_tell_targets(folder: Path) -> None:
    with pytest.raises(InputError, match=r"say which dictionary .*\(uncoded_file\), or name a file with marks"):
        evaluated(folder, {})
