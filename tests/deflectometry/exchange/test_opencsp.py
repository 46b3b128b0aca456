"""OpenCSP files: every trap of the format on files made here, and the published measurement where it is at hand."""

import datetime
import json
import tomllib
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest

from deflectometry.dots.keys import load_dots
from deflectometry.exchange.measure_slopes import load_slopes
from deflectometry.exchange.measure_slopes import run as run_slopes
from deflectometry.exchange.opencsp_files import (
    CalculationRecord,
    CameraRecord,
    FringeRecord,
    TableRecord,
    read_opencsp_file,
)
from deflectometry.exchange.opencsp_import import OpencspOptions, SetupSigmas, import_opencsp
from deflectometry.exchange.slope_files import read_slopes
from deflectometry.keys import load_deflectometry
from deflectometry.pipeline.inputs import build_setup
from deflectometry.pipeline.measure import Options, run
from deflectometry.setup.dot_screen import DotScreen
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform

CAM_FROM_SCREEN = RigidTransform.from_rotation_vector([0.1, -0.3, 0.05], [1.0, 0.2, 0.3])
CAM_FROM_MIRROR = RigidTransform.from_rotation_vector([3.0, 0.1, -0.2], [0.1, 0.2, 9.0])


def _write_h5(path: Path, content: dict[str, Any]) -> Path:
    with h5py.File(path, "w") as file:
        for key, value in content.items():
            file[key] = value
    return path


def _opencsp_pose(prefix: str, other: str, cam_from_other: RigidTransform) -> dict[str, Any]:
    """The format's own words: r_cam_x maps camera to x, v_cam_x_cam is the origin of x seen from the camera."""
    return {
        f"{prefix}/r_cam_{other}": cam_from_other.inverse().rotation_vector_rad,
        f"{prefix}/v_cam_{other}_cam": cam_from_other.translation_m.reshape(3, 1),
    }


@pytest.fixture
def files(tmp_path: Path) -> dict[str, Path]:
    rng = np.random.default_rng(5)
    folder = tmp_path / "in"
    folder.mkdir()
    measurement = {
        "fringe_images": rng.integers(0, 255, (6, 8, 12), dtype=np.uint8),
        "mask_images": rng.integers(0, 255, (6, 8, 2), dtype=np.uint8),
        "fringe_periods_x": [0.9, 4.0],
        "fringe_periods_y": [0.8],
        "dist_optic_screen": 9.5,
        "v_measure_point_facet": [0.0, 0.1, 0.0],
        "name": "made here",
        "date": "2024-02-03T04:05:06",
    }
    camera = {
        "intrinsic_mat": np.array([[700.0, 0, 4.0], [0, 690.0, 3.0], [0, 0, 0.25]]),
        "distortion_coef": [[-0.1, 0.2, 1e-4, 2e-4]],
        "image_shape_xy": [6, 8],
        "name": "small",
    }
    display = {
        "screen_model": "distorted2D",
        "name": "wall",
        "xy_screen_fraction": [[0.0, 1.0, 0.5], [0.0, 0.0, 0.9]],
        "xy_screen_coords": [[-2.0, 2.1, 0.0], [-1.0, -1.1, 0.8]],
    }
    corners = {"x": [0.5, -0.5, -0.5, 0.5], "y": [-0.4, -0.4, 0.4, 0.4], "z": [0.0] * 4}
    facet = {"v_facet_corners": corners, "v_centroid_facet": {"x": [0.01], "y": [0.02], "z": [0.0]}}
    (folder / "f.json").write_text(json.dumps(facet))
    return {
        "measurement": _write_h5(folder / "m.h5", {f"MeasurementSofastFringe/{k}": v for k, v in measurement.items()}),
        "camera": _write_h5(folder / "c.h5", {f"Camera/{k}": v for k, v in camera.items()}),
        "display": _write_h5(folder / "d.h5", {f"DisplayShape/{k}": v for k, v in display.items()}),
        "orientation": _write_h5(folder / "o.h5", _opencsp_pose("SpatialOrientation", "screen", CAM_FROM_SCREEN)),
        "response": _write_h5(
            folder / "r.h5",
            {"ImageCalibration/camera_values": [0.0, 5.0], "ImageCalibration/display_values": [0.0, 255.0]},
        ),
        "facet": folder / "f.json",
    }


def _import(files: dict[str, Path], folder: Path, **options: Any) -> dict[str, Any]:
    import_opencsp(list(files.values()), folder, OpencspOptions(**{"focal_length_m": 50.0} | options))
    return tomllib.loads((folder / "measurement.toml").read_text())


def test_folder_holds_everything_in_our_conventions(files: dict[str, Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    content = _import(dict(reversed(files.items())), out)
    assert content["kind"] == "deflectometry"
    assert content["date"] == datetime.datetime(2024, 2, 3, 4, 5, 6)
    camera = content["camera"]
    assert (camera["width_px"], camera["height_px"]) == (8, 6)
    assert (camera["focal_x_px"], camera["center_x_px"], camera["center_y_px"]) == (700.0, 4.0, 3.0)
    assert [camera[key] for key in ("k1", "k2", "p1", "p2", "k3")] == [-0.1, 0.2, 1e-4, 2e-4, 0.0]
    np.testing.assert_allclose(
        content["screen"]["rotation_vector_rad"], CAM_FROM_SCREEN.rotation_vector_rad, atol=1e-12
    )
    np.testing.assert_allclose(content["screen"]["translation_m"], CAM_FROM_SCREEN.translation_m, atol=1e-12)
    assert [(item["axis"], item["periods"]) for item in content["pattern"]["set"]] == [
        ("y", 0.8),
        ("x", 0.9),
        ("x", 4.0),
    ]
    assert all(item["steps_deg"] == [0, 90, 180, 270] for item in content["pattern"]["set"])
    outline = np.array(content["mirror"]["outline_m"])
    following = np.roll(outline, -1, axis=0)
    assert (outline[:, 0] * following[:, 1] - outline[:, 1] * following[:, 0]).sum() / 2 == pytest.approx(0.8)
    assert content["mirror"]["distance"] == {"distance_m": 9.5, "sigma_mm": 10.0, "point_m": [0.0, 0.1, 0.0]}
    assert "pose" not in content["mirror"]
    table = np.loadtxt(out / "screen_points.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table[2], [0.5, 0.1, 0.0, 0.8, 0.0], atol=1e-15)
    np.testing.assert_array_equal(np.loadtxt(out / "response.csv", delimiter=",", skiprows=1), [[0, 0], [5, 255]])


def test_frames_come_back_without_loss_and_in_order(files: dict[str, Path], tmp_path: Path) -> None:
    _import(files, tmp_path / "out")
    with h5py.File(files["measurement"]) as file:
        expected = file["MeasurementSofastFringe/fringe_images"][()]
        masks = file["MeasurementSofastFringe/mask_images"][()]
    paths = sorted((tmp_path / "out").glob("fringe_*.png"))
    frames = np.stack([np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)) for path in paths], axis=-1)
    np.testing.assert_array_equal(frames, expected)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "out" / "dark.png"), cv2.IMREAD_UNCHANGED), masks[..., 0])


def test_principal_point_of_averaged_images_is_corrected_on_request(files: dict[str, Path], tmp_path: Path) -> None:
    # Averaging 4 x 4: full-size pixel x = 4 * small + 1.5, so small = (x - 1.5) / 4.
    camera = _import(files, tmp_path / "out", correct_principal_point=True)["camera"]
    assert camera["center_x_px"] == pytest.approx((4 * 4.0 - 1.5) / 4)
    (doubt,) = import_opencsp(list(files.values()), tmp_path / "other", OpencspOptions(focal_length_m=1.0)).doubts
    assert (doubt.code, doubt.numbers["shift_px"]) == ("principal_point_not_shifted", pytest.approx(-0.375))


def test_usual_sigmas_are_written_and_stated_ones_come_first(files: dict[str, Path], tmp_path: Path) -> None:
    # Focal length 700 px: a permille of it is 0.7 px.
    content = _import(files, tmp_path / "out", sigmas=SetupSigmas("laboratory", center_px=0.2))
    assert (content["camera"]["sigma_focal_px"], content["camera"]["sigma_center_px"]) == (0.7, 0.2)
    screen = {key: value for key, value in content["screen"].items() if key.startswith("sigma_")}
    assert screen == {
        "sigma_rotation_mrad": 1.0,
        "sigma_translation_mm": 5.0,
        "sigma_width_mm": 5.0,
        "sigma_height_mm": 5.0,
        "sigma_sag_mm": 5.0,
    }
    by_hand = _import(files, tmp_path / "hand", sigmas=SetupSigmas("hand", screen_mm=8.0))
    assert (by_hand["camera"]["sigma_focal_px"], by_hand["screen"]["sigma_rotation_mrad"]) == (3.5, 5.0)
    assert by_hand["screen"]["sigma_height_mm"] == 8.0


def test_sigmas_that_nobody_states_are_asked_for_once(files: dict[str, Path], tmp_path: Path) -> None:
    imported = import_opencsp(list(files.values()), tmp_path / "out", OpencspOptions(focal_length_m=50.0))
    (asked,) = [line for line in imported.taken if "sigma" in line]
    assert "unknown" in asked
    assert "--sigmas laboratory | hand" in asked
    content = tomllib.loads((tmp_path / "out" / "measurement.toml").read_text())
    assert not [key for section in ("camera", "screen") for key in content[section] if key.startswith("sigma_")]


def test_sigmas_that_are_none_or_have_nothing_to_belong_to_are_refused(files: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="sigma_focal_px: a positive number of px"):
        _import(files, tmp_path / "out", sigmas=SetupSigmas(focal_px=-1.0))
    result = _result_file(tmp_path / "r.h5", [RigidTransform.identity()])
    with pytest.raises(InputError, match="neither camera nor screen"):
        import_opencsp([result], tmp_path / "out", OpencspOptions(sigmas=SetupSigmas("hand")))


@pytest.mark.parametrize(
    ("missing", "words"),
    [
        ("measurement", "MeasurementSofastFringe"),
        ("camera", "holds a camera"),
        ("display", "DisplayShape"),
        ("orientation", "SpatialOrientation"),
    ],
)
def test_missing_kind_is_named_and_nothing_is_written(
    files: dict[str, Path], tmp_path: Path, missing: str, words: str
) -> None:
    rest = {key: path for key, path in files.items() if key != missing}
    with pytest.raises(InputError, match=words):
        _import(rest, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_an_undefined_mirror_is_what_shows_fringes(files: dict[str, Path], tmp_path: Path) -> None:
    rest = [path for key, path in files.items() if key != "facet"]
    imported = import_opencsp(rest, tmp_path / "out", OpencspOptions(focal_length_m=50.0))
    mirror = load_deflectometry(tmp_path / "out").model.mirror
    assert mirror.outline_m is None
    assert (mirror.focal_length_m, mirror.distance.distance_m if mirror.distance else None) == (50.0, 9.5)
    assert "facet_definition_missing" in [one.code for one in imported.doubts]


def _result_file(path: Path, places: list[RigidTransform]) -> Path:
    """What SOFAST found of facets on a paraboloid of f = 20 m, on the lower three quarters of each."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-0.5, 0.5, 21), np.linspace(-0.4, 0.2, 13)))
    content: dict[str, Any] = {}
    for number in range(len(places)):
        facet = f"DataSofastCalculation/facet/facet_{number:03d}/SlopeSolverData"
        content[f"{facet}/v_surf_points_facet"] = np.stack([x, y, (x**2 + y**2) / 80])
        content[f"{facet}/slopes_facet_xy"] = np.stack([x / 40 + 1e-3, y / 40])
        definition = f"DataSofastInput/optic_definition/facet_{number:03d}"
        corners = np.array([[-0.5, 0.5, 0.5, -0.5], [-0.4, -0.4, 0.4, 0.4], [0.0] * 4])
        content[f"{definition}/DefinitionFacet/v_facet_corners"] = corners
        content[f"{definition}/DefinitionFacet/v_facet_centroid"] = np.zeros((3, 1))
        content[f"{definition}/ParamsSurface/initial_focal_lengths_xy"] = [20.0, 20.0]
    if len(places) > 1:
        ensemble = "DataSofastInput/optic_definition/DefinitionEnsemble"
        content[f"{ensemble}/v_facet_locations"] = np.stack([one.translation_m for one in places], axis=1)
        content[f"{ensemble}/r_facet_ensemble"] = np.stack([one.rotation_vector_rad for one in places])
        content[f"{ensemble}/v_centroid_ensemble"] = np.zeros((3, 1))
        general = "DataSofastCalculation/general/CalculationDataGeometryGeneral"
        content[f"{general}/r_optic_cam_refine_1"] = np.zeros(3)
        content[f"{general}/v_cam_optic_cam_refine_1"] = np.array([[0.0], [0.0], [9.0]])
    return _write_h5(path, content)


def test_a_result_file_alone_gives_its_slopes(tmp_path: Path) -> None:
    """+1 mrad in x over the design of the file; a quarter of the facet that SOFAST did not measure is counted."""
    file = _result_file(tmp_path / "r.h5", [RigidTransform.identity()])
    import_opencsp([file], tmp_path / "out")
    result = run_slopes(load_slopes(tmp_path / "out"))
    assert result.numbers["sdx_rad"] == pytest.approx(1e-3, rel=1e-3)
    assert result.numbers["sdy_rad"] == pytest.approx(0.0, abs=1e-7)
    assert result.numbers["measured_share"] == pytest.approx(0.75, abs=0.04)
    assert result.points == 21 * 13


def test_facets_of_a_result_file_stand_in_the_ensemble(tmp_path: Path) -> None:
    """The second facet is turned by 2 mrad about y: its dz/dx is 2 mrad less at every point."""
    turned = RigidTransform.from_rotation_vector([0.0, 2e-3, 0.0], [1.1, 0.0, 0.0])
    import_opencsp([_result_file(tmp_path / "r.h5", [RigidTransform.identity(), turned])], tmp_path / "out")
    points = read_slopes(tmp_path / "out" / "slopes.csv")
    first, second = points.measured & (points.x_m < 0.55), points.measured & (points.x_m > 0.55)
    assert (first.sum(), second.sum()) == (21 * 13, 21 * 13)
    assert points.slope_x[second].mean() - points.slope_x[first].mean() == pytest.approx(-2e-3, rel=1e-3)
    assert points.x_m[second].mean() == pytest.approx(1.1, abs=1e-4)


def test_two_files_of_one_kind_are_refused(files: dict[str, Path], tmp_path: Path) -> None:
    twin = files["camera"].with_name("twin.h5")
    twin.write_bytes(files["camera"].read_bytes())
    with pytest.raises(InputError, match=r"camera: c\.h5, twin\.h5"):
        _import(files | {"twin": twin}, tmp_path / "out")


def test_camera_for_another_image_size_is_refused(files: dict[str, Path], tmp_path: Path) -> None:
    with h5py.File(files["camera"], "a") as file:
        file["Camera/image_shape_xy"][...] = [60, 80]
    with pytest.raises(InputError, match="60 x 80 px, the frames are 8 x 6 px"):
        _import(files, tmp_path / "out")


def test_incomplete_and_foreign_files_are_refused_in_words(files: dict[str, Path], tmp_path: Path) -> None:
    fixed = _write_h5(tmp_path / "fixed.h5", {"MeasurementSofastFixed/image": np.zeros((3, 3))})
    with pytest.raises(InputError, match="holds no 'dist_optic_screen'"):
        read_opencsp_file(fixed)
    foreign = _write_h5(tmp_path / "foreign.h5", {"Something": 1.0})
    with pytest.raises(InputError, match="nothing of a fringe measurement"):
        read_opencsp_file(foreign)
    (tmp_path / "text.json").write_text("no json")
    with pytest.raises(InputError, match=r"not valid JSON .*it is no HDF5 file either"):
        read_opencsp_file(tmp_path / "text.json")
    with pytest.raises(InputError, match="no such file"):
        read_opencsp_file(tmp_path / "absent.h5")


def test_wrong_number_of_frames_is_refused(files: dict[str, Path], tmp_path: Path) -> None:
    with h5py.File(files["measurement"], "a") as file:
        del file["MeasurementSofastFringe/fringe_periods_y"]
        file["MeasurementSofastFringe/fringe_periods_y"] = [0.9, 3.9]
    with pytest.raises(InputError, match=r"12 fringe frames.*need 16"):
        _import(files, tmp_path / "out")


def test_frames_of_text_are_refused(files: dict[str, Path], tmp_path: Path) -> None:
    with h5py.File(files["measurement"], "a") as file:
        frames = file["MeasurementSofastFringe/fringe_images"][()]
        del file["MeasurementSofastFringe/fringe_images"]
        file["MeasurementSofastFringe/fringe_images"] = frames.astype("S3")
    with pytest.raises(InputError, match="no whole numbers from 0 to 65535"):
        _import(files, tmp_path / "out")


def test_an_existing_measurement_is_not_overwritten(files: dict[str, Path], tmp_path: Path) -> None:
    _import(files, tmp_path / "out")
    with pytest.raises(InputError, match="holds files already; choose another folder or give force=True"):
        _import(files, tmp_path / "out")


def test_without_a_focal_length_the_design_is_a_plane_with_a_doubt(files: dict[str, Path], tmp_path: Path) -> None:
    options = OpencspOptions(correct_principal_point=True)
    imported = import_opencsp(list(files.values()), tmp_path / "out", options)
    assert [one.code for one in imported.doubts] == ["design_focal_length_missing"]
    assert any(line.startswith("camera: ") for line in imported.taken)


def test_ensemble_places_each_facet(files: dict[str, Path], tmp_path: Path) -> None:
    turn = [0.0, 0.01, 0.0]
    ensemble = {
        "v_facet_locations": {"x": [-0.6, 0.6], "y": [0.0, 0.1], "z": [0.0, 0.02]},
        "r_facet_ensemble": {"1": turn, "0": [0.0, 0.0, 0.0]},
        "ensemble_perimeter": {"facet_indices": [0, 1], "corner_indices": [0, 1]},
        "v_centroid_ensemble": {"x": [0.0], "y": [0.0], "z": [0.0]},
    }
    path = tmp_path / "e.json"
    path.write_text(json.dumps(ensemble))
    facets = _import(files | {"ensemble": path}, tmp_path / "out")["mirror"]["facet"]
    assert [facet["position_m"] for facet in facets] == [[-0.6, 0.0, 0.0], [0.6, 0.1, 0.02]]
    np.testing.assert_allclose(facets[1]["rotation_vector_rad"], turn, atol=1e-15)
    assert [facet["focal_length_m"] for facet in facets] == [50.0, 50.0]


def test_pose_of_a_result_file_is_taken_only_on_request(files: dict[str, Path], tmp_path: Path) -> None:
    facet = "DataSofastCalculation/facet/facet_000"
    pose = _opencsp_pose(f"{facet}/CalculationDataGeometryFacet/SpatialOrientation", "optic", CAM_FROM_MIRROR)
    result = _write_h5(tmp_path / "data.h5", pose)
    assert "pose" not in _import(files | {"result": result}, tmp_path / "a")["mirror"]
    found = _import(files, tmp_path / "b", pose_from=result)["mirror"]["pose"]
    found_pose = RigidTransform.from_rotation_vector(found["rotation_vector_rad"], found["translation_m"])
    np.testing.assert_allclose(found_pose.rotation, CAM_FROM_MIRROR.rotation, atol=1e-12)
    np.testing.assert_allclose(found_pose.translation_m, CAM_FROM_MIRROR.translation_m, atol=1e-12)
    with pytest.raises(InputError, match="no SOFAST result"):
        _import(files, tmp_path / "c", pose_from=files["camera"])


def test_published_result_closes_the_loop_of_frames(shared_data: Path) -> None:
    # The publisher's own points, once in the screen frame and once in the facet frame, must map into each other.
    path = shared_data / "opencsp" / "fringe" / "expected_facet" / "data.h5"
    records = read_opencsp_file(path).records
    cam_from_screen = next(record for record in records if isinstance(record, RigidTransform))
    cam_from_mirror = next(record for record in records if isinstance(record, CalculationRecord)).cam_from_mirror
    table = next(record for record in records if isinstance(record, TableRecord))
    assert table.v.min() >= 0
    assert table.v.max() <= 1
    with h5py.File(path) as file:
        geometry = file["DataSofastCalculation/facet/facet_000/CalculationDataGeometryFacet"]
        on_screen = geometry["v_screen_points_screen"][()].T
        on_facet = geometry["v_screen_points_facet"][()].T
    mapped = (cam_from_mirror.inverse() @ cam_from_screen).apply(on_screen)
    np.testing.assert_allclose(mapped, on_facet, atol=1e-9)


def test_published_measurement_is_imported_whole(shared_data: Path, tmp_path: Path) -> None:
    root = shared_data / "opencsp"
    files = {
        path.stem: path
        for path in (
            root / "common" / "Facet_NSTTF.json",
            root / "common" / "display_rectangular.h5",
            root / "common" / "spatial_orientation.h5",
            root / "fringe" / "measurement_facet.h5",
            root / "common" / "camera_sofast_downsampled.h5",
        )
    }
    content = _import(files, tmp_path / "out")
    assert content["screen"]["width_m"] == pytest.approx(8.726678)
    assert len(list((tmp_path / "out").glob("fringe_*.png"))) == 32
    fringes = next(r for r in read_opencsp_file(files["measurement_facet"]).records if isinstance(r, FringeRecord))
    assert fringes.distance_m == 10.232
    camera = next(
        r for r in read_opencsp_file(files["camera_sofast_downsampled"]).records if isinstance(r, CameraRecord)
    )
    assert camera.averaged == pytest.approx(8.0)
    assert camera.matrix[2, 2] == 1.0


@pytest.mark.slow
def test_a_mirror_imported_as_two_facets_is_evaluated_facet_by_facet(shared_data: Path, tmp_path: Path) -> None:
    """The published facet read as the publisher's ensemble of two halves: each half has the design about its middle."""
    root = shared_data / "opencsp"
    common = (
        "Ensemble_split_NSTTF_facet.json",
        "Facet_split_NSTTF.json",
        "display_distorted_2d.h5",
        "spatial_orientation.h5",
        "camera_sofast_downsampled.h5",
    )
    files = {name: root / "common" / name for name in common} | {"m": root / "fringe" / "measurement_facet.h5"}
    result_file = root / "fringe" / "expected_facet" / "data.h5"
    content = _import(files, tmp_path / "in", focal_length_m=100.0, pose_from=result_file)
    assert "design" not in content["mirror"]
    assert [facet["focal_length_m"] for facet in content["mirror"]["facet"]] == [100.0, 100.0]
    result = run(load_deflectometry(tmp_path / "in"), Options(grid_step_mm=20.0))
    left, right = (result.evaluation.maps[name] for name in ("facet_000", "facet_001"))
    # Each half leans against its own paraboloid by its own mean slope, which the publisher found too. (Against one
    # paraboloid over both halves, f = 100 m, the means would differ by 0.5 mrad and not by 2.7.) Within 0.25 x 0.5 m
    # of each middle, clear of the edges where the two programs leave out different pixels.
    with h5py.File(result_file) as file:
        solved = file["DataSofastCalculation/facet/facet_000/SlopeSolverData"]
        x_m, y_m = solved["v_surf_points_facet"][:2]
        slope_x = solved["slopes_facet_xy"][0]
    leaning = []
    for one, middle in ((left, -0.32), (right, 0.32)):
        inner = (np.abs(one.x_m) < 0.25) & (np.abs(one.y_m) < 0.5)[:, None]
        published = slope_x[(np.abs(x_m - middle) < 0.25) & (np.abs(y_m) < 0.5)]
        leaning.append((np.nanmean(one.slope_error_x[inner]), published.mean()))
    (left_ours, left_theirs), (right_ours, right_theirs) = leaning
    assert right_ours - left_ours == pytest.approx(right_theirs - left_theirs, abs=0.03e-3)
    for one in (left, right):
        assert one.measured_share > 0.9
        expected = np.broadcast_to(one.x_m / 200, one.shape)
        np.testing.assert_allclose(one.design_slope_x[one.valid], expected[one.valid], atol=1e-12)


def test_a_photo_of_dots_becomes_a_measurement(files: dict[str, Path], tmp_path: Path) -> None:
    photo = np.random.default_rng(2).integers(0, 255, (6, 8), dtype=np.uint8)
    column, row = np.arange(-3, 4), np.arange(-2, 3)
    places = np.random.default_rng(3).normal(size=(5, 7, 3))
    places[0] = np.nan
    record = {"image": photo, "origin": [3.2, 2.1], "dist_optic_screen": 9.5, "v_measure_point_facet": [0.0, 0.1, 0.0]}
    table = {"x_dot_index": column, "y_dot_index": row, "xyz_dot_loc": places}
    fixed = _write_h5(tmp_path / "fixed.h5", {f"MeasurementSofastFixed/{key}": one for key, one in record.items()})
    dots = _write_h5(tmp_path / "dots.h5", {f"DotLocationsFixedPattern/{key}": one for key, one in table.items()})
    chosen = [files[name] for name in ("camera", "orientation", "facet")]
    import_opencsp([fixed, dots, *chosen], tmp_path / "out", OpencspOptions(focal_length_m=50.0))
    measurement = load_dots(tmp_path / "out")
    assert np.array_equal(cv2.imread(str(measurement.path("photo.png")), cv2.IMREAD_UNCHANGED), photo)
    screen = build_setup(measurement).screen
    assert isinstance(screen, DotScreen)
    # Rows count upwards; those without places are not in the table.
    assert screen.places_m(np.array([-3, 2]), np.array([-1, 2])) == pytest.approx(places[[1, 4], [0, 5]])
    assert not screen.has(column[:1], row[:1])[0]
    assert measurement.model.pattern.origin == "light"
    with pytest.raises(InputError, match="places of the dots"):
        import_opencsp([fixed, *chosen], tmp_path / "other")
