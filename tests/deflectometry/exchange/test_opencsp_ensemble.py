"""An ensemble measured by SofastFixed: files as OpenCSP writes them, made from a drawing, through the command."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from data_synth.dots import DotScene, dot_scene, write_dot_dataset
from deflectometry.cli import app
from deflectometry.dots.keys import load_dots
from deflectometry.pipeline.inputs import build_camera
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.images.photos import read_image
from heliogauge.results.tables import read_number_columns, read_table_csv
from tests.deflectometry.dots.known_dots import known_dots

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scene() -> DotScene:
    """Return two facets of the drawn ensemble, their dots all alike."""
    drawn = dot_scene("ensemble", "unmarked")
    return replace(drawn, scene=replace(drawn.scene, facets=drawn.scene.facets[3:5]))


def _write_h5(path: Path, group: str, content: dict[str, Any]) -> Path:
    with h5py.File(path, "w") as file:
        for key, value in content.items():
            file[f"{group}/{key}"] = value
    return path


@pytest.fixture(scope="module")
def drawn(scene: DotScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drawn") / "in"
    write_dot_dataset(folder, scene)
    return folder


def _opencsp_files(drawn: Path, folder: Path, dark: int | None = None) -> list[str]:
    """Write the drawn measurement as OpenCSP does.

    dark: Facet in the shade; None: none.
    """
    folder.mkdir()
    model = load_dots(drawn).model
    camera = build_camera(model.camera, drawn)
    photo = read_image(drawn / "photo.png").copy()
    facets = model.mirror.facet
    if dark is not None:
        # The facets stand beside each other: each has one half of the columns that are not dark.
        lit = np.flatnonzero((photo > 0.3 * photo.max()).any(axis=0))
        middle = (lit[0] + lit[-1]) // 2
        part = np.s_[:, :middle] if facets[dark].position_m[0] < facets[1 - dark].position_m[0] else np.s_[:, middle:]
        photo[part] = photo[part] // 12
    column, row, x, y, z = read_number_columns(drawn / "dots.csv", ("column", "row", "x_m", "y_m", "z_m"))
    columns, rows = (np.arange(one.min(), one.max() + 1).astype(np.int32) for one in (column, row))
    xyz = np.full((len(rows), len(columns), 3), np.nan)
    xyz[(row - rows[0]).astype(int), (column - columns[0]).astype(int)] = np.stack([x, y, z], axis=1)
    distance = model.mirror.distance
    assert distance is not None
    measurement = {
        "image": photo,
        "origin": np.zeros(2),
        "dist_optic_screen": distance.distance_m,
        "v_measure_point_facet": np.array(distance.point_m),
        "date": "2024-02-03T04:05:06",
        "name": "ensemble",
    }
    distortion = camera.distortion
    matrix = [
        [camera.focal_x_px, 0.0, camera.center_x_px],
        [0.0, camera.focal_y_px, camera.center_y_px],
        [0.0, 0.0, 1.0],
    ]
    coefficients = [[distortion.k1, distortion.k2, distortion.p1, distortion.p2, distortion.k3]]
    stated = RigidTransform.from_rotation_vector(model.screen.rotation_vector_rad, model.screen.translation_m)
    # Its words: r_cam_screen maps camera to screen, v_cam_screen_cam is the screen's origin seen from the camera.
    orientation = {
        "r_cam_screen": stated.inverse().rotation_vector_rad,
        "v_cam_screen_cam": stated.translation_m.reshape(3, 1),
        "optic_oriented": False,
    }
    size = np.array([[camera.width_px], [camera.height_px]], dtype=np.int32)
    lens = {"intrinsic_mat": matrix, "distortion_coef": coefficients, "image_shape_xy": size, "name": np.bytes_("c")}
    files = [
        _write_h5(folder / "measurement_facet_ensemble.h5", "MeasurementSofastFixed", measurement),
        _write_h5(
            folder / "dots.h5",
            "DotLocationsFixedPattern",
            {"x_dot_index": columns, "y_dot_index": rows, "xyz_dot_loc": xyz},
        ),
        _write_h5(folder / "camera.h5", "Camera", lens),
        _write_h5(folder / "orientation.h5", "SpatialOrientation", orientation),
    ]
    corners = np.array(facets[0].outline_m)[::-1]
    facet = {"v_facet_corners": _vectors(corners), "v_centroid_facet": _vectors(np.zeros((1, 2)))}
    (folder / "Facet.json").write_text(json.dumps(facet), encoding="utf-8")
    ensemble = {
        "v_facet_locations": _vectors(np.array([one.position_m for one in facets])),
        "r_facet_ensemble": {str(k): list(one.rotation_vector_rad) for k, one in enumerate(facets)},
        "ensemble_perimeter": {"facet_indices": [0, 0, 1, 1], "corner_indices": [0, 1, 2, 3]},
        "v_centroid_ensemble": _vectors(np.zeros((1, 3))),
    }
    (folder / "Ensemble.json").write_text(json.dumps(ensemble), encoding="utf-8")
    return [*(str(one) for one in files), str(folder / "Facet.json"), str(folder / "Ensemble.json")]


def _vectors(points: Any) -> dict[str, list[float]]:
    x, y, *z = np.asarray(points, dtype=np.float64).T
    return {"x": x.tolist(), "y": y.tolist(), "z": z[0].tolist() if z else [0.0] * len(x)}


def _known(scene: DotScene) -> list[str]:
    words = []
    for one in known_dots(scene):
        x, y = one["image_px"]
        words += ["--known-dot", f"{x},{y},{one['column']},{one['row']}"]
    return words


def _measured(files: list[str], known: list[str], folder: Path) -> dict[str, Any]:
    """Import and measure by the commands; return summary.json."""
    focal_length = ["--focal-length-m", "60", "-q"]
    answer = CliRunner().invoke(app, ["import", "opencsp", *files, *known, *focal_length, "-o", str(folder / "in")])
    assert answer.exit_code == 0, answer.output
    answer = CliRunner().invoke(app, ["measure", str(folder / "in"), "-o", str(folder / "out"), "--no-report", "-q"])
    if answer.exception is not None and not isinstance(answer.exception, SystemExit):
        raise answer.exception
    found: dict[str, Any] = json.loads((folder / "out" / "summary.json").read_text(encoding="utf-8"))
    return found


def test_an_ensemble_with_a_known_dot_in_each_facet(scene: DotScene, drawn: Path, tmp_path: Path) -> None:
    summary = _measured(_opencsp_files(drawn, tmp_path / "files"), _known(scene), tmp_path)
    codes = {one["code"] for one in summary["doubts"]}
    assert "dot_origin_open" not in codes
    canting = read_table_csv(tmp_path / "out" / "canting.csv", ("facet", "canting_x_rad", "sigma_canting_x_rad"))
    for axis in "xy":
        value, sigma = (np.array(canting[f"{k}canting_{axis}_rad"], dtype=float) for k in ("", "sigma_"))
        # The facets are drawn with less than half a milliradian of canting; a dot off it would be 2.3.
        assert (np.abs(value) < 0.5e-3 + 3.0 * sigma).all()


def test_one_lit_facet_of_two_is_not_taken_for_both(scene: DotScene, drawn: Path, tmp_path: Path) -> None:
    # Its outline fits both facets in another tilt, which is not that of the reflection.
    with pytest.raises(EstimationError, match=r"1 bright part for 2 facets.*another orientation of the mirror"):
        _measured(_opencsp_files(drawn, tmp_path / "files", dark=0), _known(scene)[2:], tmp_path)
