"""Targets of single photos from the command line: tables, overlays, report."""

import csv
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from data_synth.targets import PRINT_KINDS, image_truth, render_photo, target_scene, wall_scenes
from heliogauge.errors import InputError
from heliogauge.files.regular import MOST_IMAGE_BYTES
from heliogauge.images.photos import write_image
from photogrammetry.cli import app
from photogrammetry.keys.targets import TargetsSection
from photogrammetry.pipeline.single_photos import read_single_photos
from photogrammetry.targets import ring_dictionary


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


@pytest.mark.slow
def test_photos_of_one_sheet_share_where_its_rings_lie(tmp_path):
    """A blurred target alone in its photo, rings at 2.25 to 3.48 radii: the photo itself does not say where."""
    codes = ring_dictionary("aicon-12").codes
    kind = PRINT_KINDS["radii 2.25/3.48"]
    weak = replace(kind, diameters_px=(9, 11), conditions=replace(kind.conditions, blur_sigma_px=2.0))
    alone = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        (scene,) = wall_scenes([codes[5 * seed]], weak, rng)
        write_image(tmp_path / f"weak_{seed}.png", render_photo(scene, scene.views[0], rng))
        found = read_single_photos([tmp_path / f"weak_{seed}.png"], TargetsSection(dictionary="aicon-12"))
        alone.append(found.photos[0].detections.names)
    rng = np.random.default_rng(9)
    (scene,) = wall_scenes(codes[:9], replace(kind, diameters_px=(20, 29)), rng)
    write_image(tmp_path / "sheet.png", render_photo(scene, scene.views[0], rng))
    both = read_single_photos([tmp_path], TargetsSection(dictionary="aicon-12"))
    names = {one.detections.photo: one.detections.names for one in both.photos}
    assert set(names["sheet.png"]) == {code.name for code in codes[:9]}
    together = [names[f"weak_{seed}.png"] for seed in range(8)]
    # Found when written: 5 of 8 alone, 8 together; none wrong.
    assert together == [(codes[5 * seed].name,) for seed in range(8)]
    assert sum(len(one) for one in alone) < 8


def test_a_file_too_large_for_a_photo_is_refused_unread(tmp_path):
    file = tmp_path / "photo.jpg"
    with file.open("wb") as hole:
        hole.truncate(100 * MOST_IMAGE_BYTES)
    with pytest.raises(InputError, match=r"photo\.jpg: 204800\.0 MiB; a file of at most 2048 MiB is read"):
        read_single_photos([file], TargetsSection(dictionary="aicon-12"))
