"""Photos and image points to coordinates: recovery of known truth, real photos, published results, bad input."""

import json
import re
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data_synth.targets.dataset import PhotoOptions, photogrammetry_content, write_target_dataset
from data_synth.targets.presets import PrintChoice, target_scene
from heliogauge.errors import EstimationError, InputError
from heliogauge.measurement.load import parse_measurement
from heliogauge.measurement.templates import write_template
from heliogauge.measurement.writer import dump_toml
from heliogauge.reporting.build import build_report
from heliogauge.results.folder import read_cameras_json, read_points_csv, read_summary, read_table_csv
from heliogauge.results.thumbnails import read_thumbnails
from photogrammetry.bundle.statistics import Rejected
from photogrammetry.keys.load import load_photogrammetry
from photogrammetry.networks.quality import check_network
from photogrammetry.pipeline.measure import run
from photogrammetry.pipeline.result import Result


def made(folder: Path, *, points_px: float | None) -> Path:
    """Write the small panel: photos, or image points with noise."""
    scene = target_scene("small", 0, PrintChoice(None, False, False))
    write_target_dataset(folder, scene, photogrammetry_content(scene), PhotoOptions(3, points_px))
    return folder


def changed(source: Path, folder: Path, change) -> Path:
    """Copy a folder of image points with another measurement.toml."""
    folder.mkdir()
    content = tomllib.loads((source / "measurement.toml").read_text())
    change(content)
    (folder / "measurement.toml").write_text(dump_toml(content))
    (folder / "image_points.csv").write_bytes((source / "image_points.csv").read_bytes())
    return folder


def with_true_names(result: Result, truth: dict[str, list[float]]) -> list[str]:
    """Return the true name of each target; those without a code by their place, after a motion from the coded ones."""
    bundle = result.solved.bundle
    names = list(bundle.problem.observations.targets)
    coded = [k for k, name in enumerate(names) if name in truth]
    own, far = bundle.points_m[coded], np.array([truth[names[k]] for k in coded])
    left, _, right = np.linalg.svd((own - own.mean(axis=0)).T @ (far - far.mean(axis=0)))
    turn = left @ np.diag([1, 1, np.sign(np.linalg.det(left @ right))]) @ right
    places = (bundle.points_m - own.mean(axis=0)) @ turn + far.mean(axis=0)
    true_names, true_places = list(truth), np.array(list(truth.values()))
    off = np.linalg.norm(places[:, None] - true_places, axis=2)
    assert off.min(axis=1).max() < 1e-3
    return [name if name in truth else true_names[int(np.argmin(off[k]))] for k, name in enumerate(names)]


def chi_square_per_rank(result: Result, folder: Path) -> tuple[float, int, float]:
    """Compare with the truth after the rigid motion that the inner datum leaves open; also the RMS error [m]."""
    truth = json.loads((folder / "truth.json").read_text())["points_m"]
    bundle = result.solved.bundle
    names = with_true_names(result, truth)
    wanted = np.array([truth[name] for name in names])
    own, far = bundle.points_m - bundle.points_m.mean(axis=0), wanted - wanted.mean(axis=0)
    left, _, right = np.linalg.svd(own.T @ far)
    turn = left @ np.diag([1, 1, np.sign(np.linalg.det(left @ right))]) @ right
    errors = own - far @ turn.T
    values, vectors = np.linalg.eigh(bundle.covariance.joint(targets=np.arange(len(names))))
    held = values > 1e-9 * values[-1]
    squares = (vectors.T @ errors.ravel())[held] ** 2 / values[held]
    return float(squares.sum() / held.sum()), int(held.sum()), float(np.sqrt((errors**2).mean()))


@pytest.fixture(scope="module")
def photo_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(tmp_path_factory.mktemp("photos") / "panel", points_px=None)


@pytest.fixture(scope="module")
def points_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(tmp_path_factory.mktemp("points") / "panel", points_px=0.02)


@pytest.fixture(scope="module")
def from_photos(photo_folder: Path) -> Result:
    return run(load_photogrammetry(photo_folder))


@pytest.mark.slow
def test_photos_recover_the_truth(from_photos: Result, photo_folder: Path) -> None:
    ratio, rank, rms_m = chi_square_per_rank(from_photos, photo_folder)
    # 40 coded targets, and the 12 dots that were matched through their poses.
    assert rank == 3 * 52 - 6
    assert abs(ratio - 1) < 4 * np.sqrt(2 / rank)
    assert rms_m < 5e-6
    assert from_photos.refused == ()
    # Eccentricity is five times the noise of a centre here: without its correction nothing above would hold.
    assert from_photos.solved.largest_eccentricity_px > 0.015


def test_image_points_recover_the_truth(points_folder: Path) -> None:
    result = run(load_photogrammetry(points_folder))
    ratio, rank, _ = chi_square_per_rank(result, points_folder)
    assert rank == 3 * 52 - 6
    assert abs(ratio - 1) < 4 * np.sqrt(2 / rank)
    # Sigmas are given: they are believed.
    assert result.solved.image_sigma_factor == 1.0
    low, high = result.solved.bundle.variance_factor_interval(0.999)
    assert low < result.solved.bundle.variance_factor < high


@pytest.mark.slow
def test_files(from_photos: Result, tmp_path: Path) -> None:
    from_photos.write(tmp_path)
    points = read_points_csv(tmp_path / "points.csv")
    assert len(points.ids) == 52
    np.testing.assert_array_equal(points.xyz_m, from_photos.solved.bundle.points_m)
    cameras, poses = read_cameras_json(tmp_path / "cameras.json")
    assert cameras["camera"].sigma_parameters[0] > 0
    assert len(poses) == 8
    assert all(np.linalg.eigvalsh(pose.covariance).min() > 0 for pose in poses.values())
    summary = read_summary(tmp_path)
    assert summary.numbers["image_residual_rms_px"] < 0.006
    assert "inner constraints over 52 targets" in summary.texts["datum"]
    rows = read_table_csv(tmp_path / "residuals.csv")
    assert len(rows["image"]) == summary.numbers["image_points_count"]
    bars = read_table_csv(tmp_path / "constraints.csv")
    assert bars["used"] == ["1", "1", "1"]
    assert set(read_thumbnails(tmp_path, poses)) == set(poses)


def test_bar_kept_apart_checks_the_scale(points_folder: Path, tmp_path: Path) -> None:
    def keep_one_apart(content):
        content["scale_bar"][2]["check_only"] = True

    numbers = run(load_photogrammetry(changed(points_folder, tmp_path / "x", keep_one_apart))).summarise().numbers
    assert 0 < numbers["length_error_rms_m"] < 6e-5
    assert numbers["length_errors_outside_count"] is None


def test_length_errors_have_their_file_and_their_limits(points_folder: Path, tmp_path: Path) -> None:
    def apart_with_a_limit(content):
        content["scale_bar"][2]["check_only"] = True
        content["scale_bar"][2]["length_m"] += 0.001
        content["permissible_length_error"] = {"a_mm": 0.05, "k": 1e5, "b_mm": 0.2}

    result = run(load_photogrammetry(changed(points_folder, tmp_path / "x", apart_with_a_limit)))
    (tmp_path / "out").mkdir()
    result.write(tmp_path / "out")
    table = read_table_csv(tmp_path / "out" / "lengths.csv")
    assert table["role"] == ["kept apart", "left out", "left out"]
    assert float(table["error_m"][0]) == pytest.approx(-0.001, abs=6e-5)
    assert table["verdict"] == ["outside", "inside", "inside"]
    summary = read_summary(tmp_path / "out")
    assert summary.numbers["length_errors_outside_count"] == 1
    assert "exceeded by 1 of 1 length" in summary.texts["permissible_length_error"]
    assert "1 length kept apart on 1 measuring line," in summary.texts["length_check"]
    assert any(one.code == "scale_bar_kept_apart_off" and "is off by -1.0" in one.text for one in summary.doubts)


def test_contradictory_scale_bar_is_named(points_folder: Path, tmp_path: Path) -> None:
    def lengthen(content):
        content["scale_bar"][1]["length_m"] += 0.002

    result = run(load_photogrammetry(changed(points_folder, tmp_path / "x", lengthen)))
    assert any(one.code == "known_value_contradicts" and "distance 33 - 40" in one.text for one in result.doubts)


def test_a_bar_in_millimetres_is_refused_by_name(points_folder: Path, tmp_path: Path) -> None:
    def in_millimetres(content: dict) -> None:
        content["scale_bar"][0]["length_m"] *= 1000

    folder = changed(points_folder, tmp_path / "millimetres", in_millimetres)
    with pytest.raises(EstimationError, match=r"distance 1 - 8 is given as 1397\.99 m and measures 1\.398.*units"):
        run(load_photogrammetry(folder))


def test_no_scale_is_said(points_folder: Path, tmp_path: Path) -> None:
    result = run(load_photogrammetry(changed(points_folder, tmp_path / "x", lambda content: content.pop("scale_bar"))))
    assert "scale_missing" in [one.code for one in result.doubts]


def test_bar_to_an_unknown_target_is_not_fatal(points_folder: Path, tmp_path: Path) -> None:
    def add(content):
        content["scale_bar"].append({"a": "1", "b": "999", "length_m": 1.0, "sigma_mm": 0.1})

    result = run(load_photogrammetry(changed(points_folder, tmp_path / "x", add)))
    assert any(one.code == "known_value_not_used" and "999" in one.text for one in result.doubts)


def test_false_image_point_is_rejected_by_name(points_folder: Path, tmp_path: Path) -> None:
    folder = changed(points_folder, tmp_path / "x", lambda content: None)
    lines = (folder / "image_points.csv").read_text().splitlines()
    cells = lines[30].split(",")
    cells[2] = str(float(cells[2]) + 0.3)
    (folder / "image_points.csv").write_text("\n".join([*lines[:30], ",".join(cells), *lines[31:]]) + "\n")
    refused = run(load_photogrammetry(folder)).refused
    assert [one.name for one in refused] == [f"target {cells[1]} in photo {cells[0]}"]


def test_a_network_that_lost_many_image_points_says_so(points_folder: Path) -> None:
    solved = run(load_photogrammetry(points_folder)).solved
    total = solved.bundle.problem.observations.n
    few, many = (
        replace(solved, rejected=(Rejected(0, "target 1 in photo a", 1.0, "far off", "1"),) * n)
        for n in (total // 20, total // 5)
    )
    assert "many_image_points_rejected" in [one.code for one in check_network(many)]
    assert "many_image_points_rejected" not in [one.code for one in check_network(few)]


def test_many_doubtful_targets_are_all_counted(points_folder: Path) -> None:
    solved = run(load_photogrammetry(points_folder)).solved
    names = solved.bundle.problem.observations.targets[:20]
    lost = tuple(Rejected(0, f"target {name} in photo {k}", 1.0, "far off", name) for name in names for k in range(5))
    doubts = list(check_network(replace(solved, rejected=lost)))
    alone = [one for one in doubts if one.code == "target_contradicts_itself"]
    assert [one.numbers for one in alone] == [{"rejected_count": 5, "image_points_count": 13}] * 3
    (more,) = (one for one in doubts if one.code == "more_targets_contradict_themselves")
    assert more.text.startswith("so do those of 17 more targets or features: ")
    assert more.text.endswith(", ...")


def test_photos_of_another_size_are_refused(photo_folder: Path) -> None:
    measurement = load_photogrammetry(photo_folder)
    camera = (measurement.model.camera[0].model_copy(update={"width_px": 1601}),)
    other = replace(
        measurement,
        model=measurement.model.model_copy(update={"camera": camera}),
        photo_files=measurement.photo_files[:2],
    )
    with pytest.raises(InputError, match="the photos have 1600 x 1200 px, but the camera 1601 x 1200"):
        run(other)


def test_a_photo_that_is_there_twice_is_refused(photo_folder: Path, tmp_path: Path) -> None:
    folder = tmp_path / "twice"
    folder.mkdir()
    (folder / "measurement.toml").write_bytes((photo_folder / "measurement.toml").read_bytes())
    for name in ("photo_001.png", "photo_002.png", "photo_009.png"):
        (folder / name).write_bytes((photo_folder / name.replace("9", "1")).read_bytes())
    with pytest.raises(InputError, match=r"photo_009\.png is a copy of photo_001\.png; remove one"):
        run(load_photogrammetry(folder))


def test_two_photos_of_the_wrong_dictionary(photo_folder: Path) -> None:
    measurement = load_photogrammetry(photo_folder)
    targets = measurement.model.targets.model_copy(update={"dictionary": "DICT_6X6_50"})
    other = replace(
        measurement,
        model=measurement.model.model_copy(update={"targets": targets}),
        photo_files=measurement.photo_files[:2],
    )
    with pytest.raises(EstimationError, match="none of 2 photos shows a target of the dictionary"):
        run(other)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c["camera"].update(focal_pix=3.0), "did you mean 'focal_px'"),
        (lambda c: c["camera"].update(file="camera.json"), "k1; leave one of both out"),
        (lambda c: c["camera"].update(sigma={"skew": 1.0}), "sigma of skew, which is held"),
        (lambda c: c.update(images={"photos": "*.png"}), "one of both"),
        (lambda c: c["camera"].pop("width_px"), "width_px and height_px"),
        (lambda c: c.update(constraint=[{"kind": "plan", "targets": ["1"], "sigma_mm": 1.0}]), "constraint"),
        (lambda c: c.update(control_point=[{"target": "1", "xyz_m": [0, 0, 0], "sigma_mm": [1, 0, 0]}]), "all three"),
    ],
)
def test_mistakes_in_the_file(change, message: str) -> None:
    content = {
        "kind": "photogrammetry",
        "name": "a",
        "camera": {"width_px": 10, "height_px": 10, "k1": 0.1},
        "image_points": {},
    }
    change(content)
    with pytest.raises(InputError, match=message):
        parse_measurement(content, Path("measurement.toml"))


def test_every_key_of_the_template_is_a_real_key(tmp_path: Path) -> None:
    text = write_template("photogrammetry", tmp_path).read_text(encoding="utf-8")
    parse_measurement(tomllib.loads(text), Path("plain"))
    rivals = ("focal_length_35mm", 'file = "camera.json"', "prior")
    full = text
    for rival in rivals:
        full = full.replace(f"#: {rival}", "# ")
    full = full.replace("#: ", "")
    head, points = full.split("[images]")[0], full.split("[image_points]")[1]
    model = parse_measurement(tomllib.loads(head + "[image_points]" + points), Path("full"))
    assert [one.kind for one in model.constraint] == ["coordinate", "distance", "plane"]


def test_published_calibration(shared_data: Path, tmp_path: Path) -> None:
    """DBAT's demonstration as image points with another program's pixel origin."""
    marks = shared_data / "photogrammetry" / "dbat_camcal" / "measurements" / "markpts.txt"
    if not marks.is_file():
        pytest.skip("DBAT's demonstration is not on this machine")
    rows = [line for line in marks.read_text().splitlines() if line.strip() and not line.startswith("#")]
    cells = [[cell.strip() for cell in line.split(",")] for line in rows]
    body = "\n".join(",".join([*row[:4], "0.1", "0.1"]) for row in cells)
    (tmp_path / "image_points.csv").write_text("image,target,x_px,y_px,sigma_x_px,sigma_y_px\n" + body + "\n")
    control = {"1001": [0.0, 1.0, 0.0], "1002": [1.0, 1.0, 0.0], "1003": [0.0, 0.0, 0.0], "1004": [1.0, 0.0, 0.0]}
    content = {
        "kind": "photogrammetry",
        "name": "camcal",
        "camera": {
            "width_px": 2272,
            "height_px": 1704,
            "focal_px": 2350.0,
            "distortion_direction": "measured_to_ideal",
            "residuals": "corrected",
            "free": ["focal_px", "aspect", "center_x_px", "center_y_px", "k1", "k2", "k3", "p1", "p2"],
        },
        "image_points": {"pixel_origin": "corner"},
        "adjustment": {"reject": False},
        "control_point": [{"target": name, "xyz_m": xyz} for name, xyz in control.items()],
    }
    (tmp_path / "measurement.toml").write_text(dump_toml(content))
    result = run(load_photogrammetry(tmp_path))
    assert result.solved.bundle.redundancy == 3725
    assert result.solved.bundle.sigma0 / 10 == pytest.approx(0.161480, abs=5e-7)
    assert result.refused == ()
    assert any("1.61 times what the stated sigmas say" in one.text for one in result.doubts)


@pytest.mark.slow
def test_real_markers(shared_data: Path, tmp_path: Path) -> None:
    """54 photos of square markers on a dish, with what OpenCSP's camera file says as a start."""
    source = shared_data / "opencsp" / "scene_reconstruction"
    if not source.is_dir():
        pytest.skip("the photos of markers are not on this machine")
    shutil.copytree(source / "aruco_marker_images", tmp_path / "photos")
    lens = {"k1": -0.05576391, "k2": 0.03966674, "p1": -0.00055473, "p2": 0.00049181}
    free = ["focal_px", "aspect", "center_x_px", "center_y_px", "k1", "k2", "p1", "p2", "k3"]
    bars = (("43.0", "42.0", 3.421), ("31.0", "10.0", 5.702))
    content = {
        "kind": "photogrammetry",
        "name": "dish",
        "camera": {"focal_px": 935.57, "center_x_px": 869.7, "center_y_px": 576.1, "free": free, **lens},
        "images": {"photos": "photos/*.JPG"},
        "targets": {"dictionary": "DICT_4X4_1000"},
        "scale_bar": [{"a": a, "b": b, "length_m": length, "sigma_mm": 0.5} for a, b, length in bars],
    }
    (tmp_path / "measurement.toml").write_text(dump_toml(content))
    result = run(load_photogrammetry(tmp_path))
    numbers = result.summarise().numbers
    assert numbers["photos_count"] == 54
    assert numbers["image_residual_rms_px"] < 0.11
    assert numbers["scale_bar_residual_rms_m"] < 0.0005
    assert numbers["largest_image_residual_px"] < 1.0
    # Covariances of corners hold from photo to photo; with independent pixels alone the factor was 2.54.
    assert 0.85 < numbers["image_sigma_factor"] < 1.2
    # Markers too small to be measured are refused by name.
    assert any(one.name.startswith("marker 10 at") and "DSC03677" in one.name for one in result.refused)
    assert np.isfinite(result.points.sigma_m).all()


@pytest.mark.slow
def test_the_report_holds_figures_and_tables(points_folder: Path, tmp_path: Path) -> None:
    run(load_photogrammetry(points_folder)).write(tmp_path)
    text = build_report(tmp_path).read_text(encoding="utf-8")
    # Network twice, the first photo, residuals four times, rays, lengths, correlations.
    assert text.count("<img ") == 2 + 1 + 4 + 1 + 1 + 1
    words = ("inner constraints over 52 targets", "distance 33 - 40", "focal_px", "photo_008.png", 'data-view="scene"')
    for word in words:
        assert word in text
    # Nothing is loaded from elsewhere.
    assert not re.search(r"""(src|href)=["']https?:""", text)
    assert len(text) < 2e6
