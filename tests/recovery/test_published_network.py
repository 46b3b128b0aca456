"""DBAT's published calibration through the command line: image points and millimetres in, printed numbers out."""

import csv
import json

import numpy as np
import pytest

from heliogauge.measurement.writer import dump_toml
from heliogauge.results.tables import read_table_csv
from heliogauge.running.cli import main

PIXEL_MM = 5.43764 / 1704
CONTROL = {"1001": [0.0, 1.0, 0.0], "1002": [1.0, 1.0, 0.0], "1003": [0.0, 0.0, 0.0], "1004": [1.0, 0.0, 0.0]}
LENS = ["center_x_px", "center_y_px", "k1", "k2", "k3", "p1", "p2"]


def folder_of(shared_data, folder, camera, more=None):
    """Write measurement.toml, the marks and the control points as tables."""
    marks = shared_data / "photogrammetry" / "dbat_camcal" / "measurements" / "markpts.txt"
    if not marks.is_file():
        pytest.skip("DBAT's demonstration is not on this machine")
    with marks.open() as file:
        rows = [row for row in csv.reader(file, skipinitialspace=True) if row and not row[0].startswith("#")]
    folder.mkdir()
    lines = [",".join(cell.strip() for cell in row[:4]) + ",0.1,0.1" for row in rows]
    header = "image,target,x_px,y_px,sigma_x_px,sigma_y_px"
    (folder / "image_points.csv").write_text("\n".join([header, *lines]) + "\n")
    rows = [f"{name},{x},{y},{z}" for name, (x, y, z) in CONTROL.items()]
    (folder / "control.csv").write_text("\n".join(["target,x_m,y_m,z_m", *rows]) + "\n")
    content = {
        "kind": "photogrammetry",
        "name": "camcaldemo",
        "camera": {"name": "c4040z", "width_px": 2272, "height_px": 1704, **camera},
        "image_points": {"pixel_origin": "corner"},
        "files": {"control_points": "control.csv"},
        "datum": {"kind": "control"},
        # DBAT scales its sigmas by sigma0 and keeps every mark.
        "adjustment": {"reject": False, "sigmas": "from residuals"},
        **(more or {}),
    }
    (folder / "measurement.toml").write_text(dump_toml(content))
    return folder


def run(folder, out):
    with pytest.raises(SystemExit) as left:
        main(["photogrammetry", "measure", str(folder), "-o", str(out), "--no-report", "--quiet"])
    assert left.value.code == 0
    return json.loads((out / "summary.json").read_text())


MILLIMETRES = {"form": "brown", "focal_mm": 7.5, "pixel_mm": PIXEL_MM, "principal_origin": "corner"}


@pytest.fixture(scope="module")
def backward(shared_data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("camcal")
    camera = {"residuals": "corrected", "free": ["focal_px", "aspect", *LENS], "millimetres": MILLIMETRES}
    camera["distortion_direction"] = "measured_to_ideal"
    run(folder_of(shared_data, folder / "in", camera), folder / "out")
    return folder / "out"


def test_backward_summary(backward):
    summary = json.loads((backward / "summary.json").read_text())
    numbers = {name: one["value"] if isinstance(one, dict) else one for name, one in summary["numbers"].items()}
    assert numbers["redundancy_count"] == 3725
    assert numbers["image_sigma_posterior_px"] == pytest.approx(0.161480, abs=5e-7)
    assert numbers["largest_image_residual_px"] == pytest.approx(0.955, abs=5e-4)
    assert numbers["rejected_image_points_count"] == 0


def test_backward_camera_as_printed(backward):
    table = read_table_csv(backward / "camera_millimetres.csv")
    found = {
        name: (float(value), float(sigma))
        for name, value, sigma in zip(table["name"], table["value"], table["sigma"], strict=True)
    }
    # result/report.txt and result/c4040z.xml of the demonstration.
    printed = {
        "focal_mm": (7.45699532273933752, 0.00105),
        "principal_x_mm": (3.61546239970888994, 0.00082),
        "principal_y_mm": (2.61329279848268081, 0.00098),
        "aspect": (3.89598e-4, 2.08e-5),
        "K1": (0.00458860662755811253, 2.21e-5),
        "K2": (-4.51350997187018702e-05, 2.65e-6),
        "K3": (-2.05253370760761127e-06, 1.01e-7),
        "P1": (-6.12803065099492536e-05, 3.52e-6),
        "P2": (-4.41170561685059337e-05, 3.94e-6),
    }
    for name, (value, sigma) in printed.items():
        assert found[name][0] == pytest.approx(value, abs=2e-4 * sigma), name
        assert found[name][1] == pytest.approx(sigma, rel=6e-3), name


def test_backward_points(backward):
    points = read_table_csv(backward / "points.csv")
    sigmas = np.array([[float(cell) for cell in points[f"sigma_{axis}_m"]] for axis in "xyz"])
    np.testing.assert_allclose(sigmas.max(axis=1), [5.0e-5, 5.3e-5, 8.5e-5], atol=0.5e-6)
    control = {name: i for i, name in enumerate(points["id"])}
    for name, xyz in CONTROL.items():
        assert [float(points[f"{axis}_m"][control[name]]) for axis in "xyz"] == xyz


@pytest.mark.slow
def test_forward_summary(shared_data, tmp_path):
    camera = {
        "distortion_direction": "ideal_to_measured",
        "free": ["focal_px", *LENS],
        "millimetres": MILLIMETRES,
    }
    summary = run(folder_of(shared_data, tmp_path / "in", camera), tmp_path / "out")
    numbers = {name: one["value"] if isinstance(one, dict) else one for name, one in summary["numbers"].items()}
    assert numbers["redundancy_count"] == 3726
    assert numbers["image_sigma_posterior_px"] == pytest.approx(0.162168, abs=5e-7)
