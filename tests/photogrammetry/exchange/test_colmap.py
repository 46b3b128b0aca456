"""COLMAP models: round trips, the other program's reader, a measurement folder out of one, bad models."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from data_synth.targets.dataset import PhotoOptions, photogrammetry_content, write_target_dataset
from data_synth.targets.presets import PrintChoice, target_scene
from heliogauge.camera.distortion import BrownDistortion, DistortionDirection
from heliogauge.camera.formats import COLMAP_MODELS, from_colmap
from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.results.folder import read_cameras_json, read_points_csv, read_table_csv, write_cameras_json
from heliogauge.running.cli import main
from photogrammetry.exchange.colmap import export_colmap, import_colmap
from photogrammetry.exchange.colmap_files import ColmapImage, ColmapModel, read_colmap, write_colmap
from photogrammetry.keys.load import load_photogrammetry
from photogrammetry.pipeline.measure import run
from tests.photogrammetry.bundle_networks import look_at

#: Values of every parameter any model has; k4 to k6 must be zero.
VALUES = {
    "f": 812.5,
    "fx": 812.5,
    "fy": 811.25,
    "cx": 401.0,
    "cy": 299.5,
    "k1": -0.11,
    "k2": 0.04,
    "p1": 1e-3,
    "p2": -2e-3,
    "k3": 0.01,
}


def model_of(cameras: dict[int, Camera], n_points: int = 12) -> ColmapModel:
    """Draw a small model; every image also has keypoints without a point."""
    rng = np.random.default_rng(8)
    points = {int(k): rng.normal(0, 0.4, 3) for k in rng.permutation(100)[:n_points] + 1}
    images = []
    for place, number in enumerate([*cameras, *cameras, *cameras]):
        # One image upside down: a turn of almost pi, where rotation vectors change sign.
        pose = look_at(rng.normal(0, 1, 3) + [0, 0, 5], [0, 0, 0], np.pi if place == 0 else float(rng.normal()))
        pixels = cameras[number].project(pose.apply(np.array(list(points.values()))))
        ids = np.array([*points, -1, -1])
        images.append(ColmapImage(f"img{place}.jpg", number, pose, np.concatenate([pixels, [[3, 4], [5, 6]]]), ids))
    return ColmapModel(cameras, tuple(images), points)


def same(one: ColmapModel, other: ColmapModel, atol: float = 1e-9) -> None:
    assert one.cameras.keys() == other.cameras.keys()
    for number in one.cameras:
        np.testing.assert_allclose(one.cameras[number].parameters, other.cameras[number].parameters, atol=atol)
    assert [image.name for image in one.images] == [image.name for image in other.images]
    for left, right in zip(one.images, other.images, strict=True):
        np.testing.assert_allclose(left.cam_from_world.rotation, right.cam_from_world.rotation, atol=atol)
        np.testing.assert_allclose(left.cam_from_world.translation_m, right.cam_from_world.translation_m, atol=atol)
        np.testing.assert_allclose(left.pixels_px, right.pixels_px, atol=atol)
        np.testing.assert_array_equal(left.point_ids, right.point_ids)
        assert left.camera == right.camera
    assert one.points_m.keys() == other.points_m.keys()
    for number in one.points_m:
        np.testing.assert_allclose(one.points_m[number], other.points_m[number], atol=atol)


def all_models() -> dict[int, Camera]:
    cameras = {}
    for number, (name, parameters) in enumerate(COLMAP_MODELS.items(), 1):
        cameras[number] = from_colmap(name, [VALUES.get(one, 0.0) for one in parameters], 800, 600)
    return cameras


@pytest.mark.parametrize("binary", [False, True], ids=["text", "binary"])
def test_round_trip_of_all_camera_models(tmp_path: Path, binary: bool) -> None:
    model = model_of(all_models())
    write_colmap(tmp_path, model, binary=binary)
    same(read_colmap(tmp_path), model)


@pytest.mark.parametrize("binary", [False, True], ids=["text", "binary"])
def test_the_other_program_reads_the_same(tmp_path: Path, binary: bool) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="pip install heliogauge[natural]")
    model = model_of(all_models())
    write_colmap(tmp_path, model, binary=binary)
    scene = pycolmap.Reconstruction(tmp_path)
    # Its own errors are at round-off: origin, pose and lens mean the same there.
    scene.update_point_3d_errors()
    assert scene.num_reg_images() == len(model.images)
    assert max(point.error for point in scene.points3D.values()) < 1e-9
    assert all(point.track.length() == len(model.images) for point in scene.points3D.values())
    for kind in ("text", "binary"):
        (tmp_path / kind).mkdir()
        getattr(scene, f"write_{kind}")(tmp_path / kind)
        again = read_colmap(tmp_path / kind)
        order = {image.name: image for image in again.images}
        same(ColmapModel(again.cameras, tuple(order[one.name] for one in model.images), again.points_m), model)


def with_pose(tmp_path: Path, change) -> Path:
    write_colmap(tmp_path, model_of({1: all_models()[2]}))
    change(tmp_path)
    return tmp_path


def replaced(name: str, old: str, new: str):
    def change(folder: Path) -> None:
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1))

    return change


def cut(folder: Path) -> None:
    write_colmap(folder, model_of({1: all_models()[2]}), binary=True)
    content = (folder / "images.bin").read_bytes()
    (folder / "images.bin").write_bytes(content[: len(content) // 2])


def no_points(folder: Path) -> None:
    (folder / "points3D.txt").write_text("# nothing\n")
    lines = (folder / "images.txt").read_text().splitlines()
    (folder / "images.txt").write_text("\n".join(line if line.endswith("jpg") else "" for line in lines) + "\n")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: (f / "points3D.txt").unlink(), "points3D.txt missing"),
        (replaced("cameras.txt", "PINHOLE", "OPENCV_FISHEYE"), "camera 1: COLMAP camera model 'OPENCV_FISHEYE'"),
        (replaced("cameras.txt", "PINHOLE", "SIMPLE_PINHOLE"), "camera 1: COLMAP parameters of SIMPLE_PINHOLE"),
        (replaced("images.txt", " 1 img0.jpg", " 7 img0.jpg"), "img0.jpg is of camera 7"),
        (replaced("images.txt", "img1.jpg", "img0.jpg"), "img0.jpg is there twice"),
        (lambda f: (f / "images.txt").write_text("# none\n"), "no images"),
        (no_points, "no points"),
        (lambda f: (f / "points3D.txt").write_text("3 0 0 0 1 1 1 0.5 1 1\n"), "which the model does not have"),
        (lambda f: (f / "points3D.txt").write_text("3 0 0\n"), "points3D.txt, line 1: 8 or more values"),
        (cut, "images.bin: the file is cut"),
    ],
)
def test_bad_models(tmp_path: Path, change, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_colmap(with_pose(tmp_path, change))


def test_no_folder_or_the_folder_above(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        read_colmap(tmp_path / "absent")
    (tmp_path / "0").mkdir()
    with_pose(tmp_path / "0", lambda folder: None)
    with pytest.raises(InputError, match="the folder 0 in it holds one"):
        read_colmap(tmp_path)


def test_text_models_take_no_spaces_in_names(tmp_path: Path) -> None:
    plain = model_of({1: all_models()[2]})
    image = plain.images[0]
    spaced = ColmapImage("a b.jpg", 1, image.cam_from_world, image.pixels_px, image.point_ids)
    model = ColmapModel(plain.cameras, (spaced,), plain.points_m)
    with pytest.raises(InputError, match="white space"):
        write_colmap(tmp_path, model)
    write_colmap(tmp_path, model, binary=True)
    same(read_colmap(tmp_path), model)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a small panel given as image points, lens and all estimated."""
    folder = tmp_path_factory.mktemp("colmap")
    scene = target_scene("small", 0, PrintChoice(None, False, False))
    write_target_dataset(folder / "panel", scene, photogrammetry_content(scene), PhotoOptions(3, 0.02))
    (folder / "result").mkdir()
    run(load_photogrammetry(folder / "panel")).write(folder / "result")
    return folder / "result"


def columns_x(columns: dict[str, list[str]]) -> dict[tuple[str, str], float]:
    keys = zip(columns["image"], columns["target"], strict=True)
    return dict(zip(keys, map(float, columns["x_px"]), strict=True))


def test_export_and_import_again(result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model, folder = tmp_path / "model", tmp_path / "measurement"
    with pytest.raises(SystemExit) as ended:
        main(["photogrammetry", "export", "colmap", str(result), "-o", str(model)])
    assert ended.value.code == 0
    assert "any covariance" in capsys.readouterr().out
    cameras, poses = read_cameras_json(result / "cameras.json")
    exported = read_colmap(model)
    np.testing.assert_allclose(exported.cameras[1].parameters, cameras["camera"].parameters, rtol=1e-12)
    for image in exported.images:
        pose = poses[image.name].cam_from_world
        np.testing.assert_allclose(image.cam_from_world.rotation, pose.rotation, atol=1e-12)
    with pytest.raises(SystemExit) as ended:
        main(["photogrammetry", "import", "colmap", str(model), "-o", str(folder)])
    assert ended.value.code == 0
    assert "conditional" in capsys.readouterr().out

    again = run(load_photogrammetry(folder))
    points = read_points_csv(result / "points.csv")
    place = {name: i for i, name in enumerate(points.ids)}
    order = [place[name] for name in again.points.ids]
    # The same image points with the same weights, without the scale bars: less than a sigma apart, and by the datum not
    # moved, turned or stretched as a whole against the model.
    assert again.solved.bundle.sigma0 == pytest.approx(1.0, abs=1e-3)
    moved = again.points.xyz_m - points.xyz_m[order]
    assert np.abs(moved / points.sigma_m[order]).max() < 1.5
    arms = points.xyz_m - points.xyz_m.mean(axis=0)
    np.testing.assert_allclose(moved.mean(axis=0), 0, atol=1e-9)
    np.testing.assert_allclose(np.cross(arms[order], moved).mean(axis=0), 0, atol=1e-9)
    np.testing.assert_allclose((arms[order] * moved).sum(axis=1).mean(), 0, atol=1e-9)
    original = read_table_csv(result / "residuals.csv")
    taken = read_table_csv(folder / "image_points.csv")
    both, mine = columns_x(original), columns_x(taken)
    assert both.keys() == mine.keys()
    assert max(abs(mine[key] - 0.5 - both[key]) for key in both) < 1e-9


def test_start_values_are_files_of_the_measurement(result: Path, tmp_path: Path) -> None:
    export_colmap(result, tmp_path / "model", binary=True)
    import_colmap(tmp_path / "model", tmp_path / "m")
    file = tmp_path / "m" / "measurement.toml"
    content = tomllib.loads(file.read_text())
    assert content["start"] == {"cameras": "cameras.json", "points": "points.csv"}
    assert content["image_points"]["pixel_origin"] == "corner"
    assert "center_x_px" in content["camera"]["free"]
    file.write_text(file.read_text().replace('"cameras.json"', '"absent.json"'))
    with pytest.raises(InputError, match=r"there is no file absent\.json"):
        load_photogrammetry(tmp_path / "m")


def test_several_cameras(tmp_path: Path) -> None:
    """Two cameras, three images each; a third took none."""
    model = model_of({number: camera for number, camera in all_models().items() if number in (2, 3)}, 40)
    unused = ColmapModel(model.cameras | {9: all_models()[5]}, model.images, model.points_m)
    (tmp_path / "model").mkdir()
    write_colmap(tmp_path / "model", unused)
    said = import_colmap(tmp_path / "model", tmp_path / "m")
    assert not any("one photo each" in line for line in said)
    content = tomllib.loads((tmp_path / "m" / "measurement.toml").read_text())
    assert [one["name"] for one in content["camera"]] == ["camera 2", "camera 3"]
    assert content["camera"][0]["photos"] == ["img0.jpg", "img2.jpg", "img4.jpg"]
    assert content["camera"][1]["free"] == ["focal_px", "center_x_px", "center_y_px", "k1"]
    # Image points without any error: everything comes back.
    result = run(load_photogrammetry(tmp_path / "m"))
    for number, own in zip((2, 3), result.solved.bundle.cameras, strict=True):
        np.testing.assert_allclose(own.parameters, model.cameras[number].parameters, rtol=1e-6, atol=1e-7)


def test_a_camera_for_each_photo_is_said(tmp_path: Path) -> None:
    model = model_of({number: camera for number, camera in all_models().items() if number in (2, 3)}, 40)
    alone = ColmapModel(model.cameras, model.images[:2], model.points_m)
    (tmp_path / "model").mkdir()
    write_colmap(tmp_path / "model", alone)
    said = import_colmap(tmp_path / "model", tmp_path / "m")
    assert any(line.startswith("2 cameras took one photo each (camera 2)") for line in said)


def test_lens_of_the_other_direction_is_refitted_and_said(result: Path, tmp_path: Path) -> None:
    cameras, poses = read_cameras_json(result / "cameras.json")
    own = cameras["camera"]
    lens = BrownDistortion(k1=-0.1, k2=0.02, direction=DistortionDirection.MEASURED_TO_IDEAL)
    other = Camera(own.width_px, own.height_px, 1400.0, 1400.0, own.center_x_px, own.center_y_px, distortion=lens)
    for name in ("points.csv", "residuals.csv"):
        (tmp_path / name).write_bytes((result / name).read_bytes())
    write_cameras_json(tmp_path / "cameras.json", {"camera": other}, poses)
    said = export_colmap(tmp_path, tmp_path / "out")
    assert any("off by at most" in line for line in said)
    skewed = Camera(own.width_px, own.height_px, 1400.0, 1400.0, own.center_x_px, own.center_y_px, 0.5)
    write_cameras_json(tmp_path / "cameras.json", {"camera": skewed}, poses)
    with pytest.raises(InputError, match="skew"):
        export_colmap(tmp_path, tmp_path / "out2")
    with pytest.raises(InputError, match="a results folder"):
        export_colmap(tmp_path / "out", tmp_path / "out3")


def test_files_of_two_runs_are_refused(result: Path, tmp_path: Path) -> None:
    for name in ("points.csv", "residuals.csv"):
        (tmp_path / name).write_bytes((result / name).read_bytes())
    content = json.loads((result / "cameras.json").read_text())
    content["poses"] = dict(list(content["poses"].items())[1:])
    (tmp_path / "cameras.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match="has no pose"):
        export_colmap(tmp_path, tmp_path / "out")
