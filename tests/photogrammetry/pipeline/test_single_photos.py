"""Targets of single photos from the command line: tables, overlays, report."""

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from data_synth.targets import image_truth, render_photo, target_scene
from heliogauge.images.photos import write_image
from photogrammetry.cli import app


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    """A folder of results of one drawn photo with a code twice in it, and the photo's truth."""
    folder = tmp_path_factory.mktemp("targets")
    scene = target_scene("small", 1)
    view = scene.views[0]
    image = render_photo(scene, view, np.random.default_rng(1))
    truth = image_truth(scene, view)
    write_image(folder / "photo.png", image)
    code = str(folder / "photo.png")
    done = CliRunner().invoke(app, ["targets", code, "-o", str(folder / "out"), "-q"], catch_exceptions=False)
    assert done.exit_code == 0
    return folder / "out", truth


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_targets_csv_has_every_code_at_its_place(read):
    out, truth = read
    rows = _rows(out / "targets.csv")
    assert list(rows[0]) == ["photo", "code", "x_px", "y_px", "sigma_px", "radius_px", "flag"]
    places = dict(zip(truth.names, truth.pixels_px, strict=True))
    wanted = {name for name in truth.names if name.isdecimal()}
    assert {row["code"] for row in rows} == wanted
    assert len(rows) == len(wanted)
    off = np.array([[float(row["x_px"]), float(row["y_px"])] - places[row["code"]] for row in rows])
    # Truth is the projected centre: the centre of an ellipse 13 px wide is up to 0.01 px away from it.
    assert np.abs(off).max() < 0.05
    assert all(0 < float(row["sigma_px"]) < 0.05 and row["flag"] == "" for row in rows)


def test_overlay_and_report_show_the_photo(read):
    out, _ = read
    picture = cv2.imread(str(out / "overlays" / "photo.jpg"))
    assert picture.shape[:2] == (1200, 1600)
    # Marks are in colour on a grey photo.
    assert (np.ptp(picture.astype(int), axis=2) > 60).sum() > 2000
    text = (out / "report.html").read_text(encoding="utf-8")
    assert "Targets read" in text
    assert "Nothing was refused" in text
