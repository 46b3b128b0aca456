"""Bad input of photogrammetry through the command: one clear message, or a flagged and explained result."""

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from data_synth.targets.dataset import PhotoOptions, photogrammetry_content, write_target_dataset
from data_synth.targets.presets import PrintChoice, target_scene
from heliogauge.results.tables import read_table_csv
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
KNOWN = {
    **SIZE,
    "focal_px": 6103.0,
    "aspect": 6103.0 / 6100.0 - 1,
    "center_x_px": 3010.0,
    "center_y_px": 1990.0,
    "k1": -0.12,
    "k2": 0.08,
    "k3": -0.02,
    "p1": 3e-4,
    "p2": -2e-4,
}


@pytest.fixture(scope="module")
def good():
    truth, points = network(np.random.default_rng(21), 8, 24, size_m=1.0)
    return truth, points


def bar(truth, a, b, error_m=0.0, sigma_mm=0.01):
    return {"a": f"t{a}", "b": f"t{b}", "length_m": length(truth, a, b) + error_m, "sigma_mm": sigma_mm}


def said(capsys) -> str:
    captured = capsys.readouterr()
    return " ".join((captured.err + captured.out).split())


def lines_of(folder: Path) -> list[str]:
    return (folder / "image_points.csv").read_text().splitlines()


def with_lines(folder: Path, lines: list[str]) -> Path:
    (folder / "image_points.csv").write_text("\n".join(lines) + "\n")
    return folder


def swapped(lines):
    cells = [line.split(",") for line in lines]
    return [lines[0], *(",".join([*c[:2], c[3], c[2], *c[4:]]) for c in cells[1:])]


def cell(lines, row, column, text):
    cells = lines[row].split(",")
    cells[column] = text
    return [*lines[:row], ",".join(cells), *lines[row + 1 :]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda lines: [*lines, lines[4]], "is measured twice in image photo0; keep one (two sheets with the same"),
        (swapped, "with x_px and y_px exchanged all are inside: are the columns swapped?"),
        (lambda lines: cell(lines, 7, 2, "nan"), "line 8: x_px and y_px must be numbers"),
        (lambda lines: cell(lines, 7, 2, "1,5".replace(",", ";")), "column x_px must hold numbers"),
        (lambda lines: cell(lines, 7, 3, "4100.0"), "line 8: ("),
        (lambda lines: cell(lines, 7, 4, "0"), "line 8: sigma_x_px and sigma_y_px must be positive"),
        (lambda lines: cell(lines, 7, 1, ""), "line 8: image and target need a name"),
        (lambda lines: lines[:1], "there are no image points in it"),
        (lambda lines: [lines[0].replace("x_px", "u"), *lines[1:]], "the columns x_px are missing"),
    ],
)
def test_tables_that_cannot_be_meant(good, tmp_path, capsys, change, message):
    _, points = good
    folder = write_job(tmp_path / "in", points, camera=KNOWN)
    with_lines(folder, change(lines_of(folder)))
    assert command(folder, tmp_path / "out") == 2
    text = said(capsys)
    assert message in text
    assert "image_points.csv" in text
    assert not (tmp_path / "out").exists()


def test_missing_sigmas_come_from_the_residuals(good, tmp_path, capsys):
    truth, points = good
    folder = write_job(tmp_path / "in", points, camera=KNOWN, scale_bar=[bar(truth, 0, 1)])
    with_lines(folder, [",".join(line.split(",")[:4]) for line in lines_of(folder)])
    assert command(folder, tmp_path / "out") == 0
    assert "have no sigma; 0.1 px was taken" in said(capsys)
    numbers = summary_of(tmp_path / "out")["numbers"]
    # The noise is 0.05 px; the scale bar keeps its own sigma.
    assert numbers["image_sigma_posterior_px"] == pytest.approx(0.05, rel=0.2)
    errors = fitted(points_of(tmp_path / "out"), truth.points_m)
    sigma = np.array(list(sigmas_of(tmp_path / "out").values()))
    assert 0.6 < np.sqrt((errors**2).mean() / (sigma**2).mean()) < 1.4


def test_photos_with_no_or_one_target_are_left_out_by_name(good, tmp_path, capsys):
    _, points = good
    rows = points.photo_index == 3
    keep = ~rows
    keep[np.nonzero(rows)[0][0]] = True
    folder = write_job(tmp_path / "in", points.subset(keep), camera=KNOWN)
    assert command(folder, tmp_path / "out") == 0
    text = said(capsys)
    assert "photo photo3 is left out: shows 1 targets, 4 are needed" in text
    assert "there is no scale" in text
    assert "photo3" in read_table_csv(tmp_path / "out" / "rejected.csv")["name"]


def test_all_photos_from_one_spot(good, tmp_path, capsys):
    truth, _ = good
    rng = np.random.default_rng(5)
    spot = views(rng, [(0.5, 0.2, 3.0)] * 8, truth.points_m, truth.cameras)
    folder = write_job(tmp_path / "in", observe(spot, rng, 0.1), camera=KNOWN)
    assert command(folder, tmp_path / "out") == 2
    assert "taken from one place" in said(capsys)


def test_photos_without_overlap(good, tmp_path, capsys):
    _, points = good
    keep = (points.target_index % 8) == points.photo_index
    folder = write_job(tmp_path / "in", points.subset(keep), camera=KNOWN)
    assert command(folder, tmp_path / "out") == 2
    assert "common targets" in said(capsys)


@pytest.mark.slow
def test_targets_in_one_plane(tmp_path, capsys):
    """A plane with a known camera is measured rightly; an unknown one is calibrated by rolled, tilted photos."""
    rng = np.random.default_rng(6)
    truth, _ = network(rng, 9, 30, size_m=1.0)
    flat = replace_points(truth, truth.points_m * [1, 1, 0])
    points = observe(flat, rng, 0.05)
    for name, camera in (("known", KNOWN), ("unknown", SIZE)):
        folder = write_job(tmp_path / name, points, camera=camera, scale_bar=[bar(flat, 0, 1)])
        assert command(folder, tmp_path / f"{name} out") == 0
        errors = fitted(points_of(tmp_path / f"{name} out"), flat.points_m)
        sigma = np.array(list(sigmas_of(tmp_path / f"{name} out").values()))
        assert 0.5 < np.sqrt((errors**2).mean() / (sigma**2).mean()) < 1.5, name
    assert "error" not in said(capsys)


def replace_points(state, points_m):
    return type(state)(state.cameras, state.rotations, state.translations_m, points_m)


@pytest.mark.slow
def test_a_plane_seen_squarely_does_not_tell_the_focal_length(tmp_path, capsys):
    """Photos that all look straight down on a plane: named, with a remedy, or a sigma that says so."""
    rng = np.random.default_rng(7)
    truth, _ = network(rng, 6, 25, size_m=1.0)
    points_m = truth.points_m * [1, 1, 0]
    down = np.diag([1.0, -1.0, -1.0])
    centers = [(0.3 * (i % 3 - 1), 0.3 * (i // 3), 2.5) for i in range(6)]
    state = type(truth)(truth.cameras, np.stack([down] * 6), np.stack([-down @ np.array(c) for c in centers]), points_m)
    folder = write_job(tmp_path / "in", observe(state, rng, 0.05), camera=SIZE, scale_bar=[bar(state, 0, 1)])
    code = command(folder, tmp_path / "out")
    text = said(capsys)
    if code == 2:
        assert "not determined" in text
        assert "focal_px" in text
    else:
        intrinsics = read_table_csv(tmp_path / "out" / "intrinsics.csv")
        sigma = dict(zip(intrinsics["name"], map(float, intrinsics["sigma"]), strict=True))
        assert sigma["focal_px"] > 20
        assert "held the same way" in text


def test_contradictory_scale_bars_are_named_with_their_residual(good, tmp_path, capsys):
    truth, points = good
    bars = [bar(truth, 0, 1), bar(truth, 2, 3), bar(truth, 4, 5, error_m=0.003)]
    folder = write_job(tmp_path / "in", points, camera=KNOWN, scale_bar=bars)
    assert command(folder, tmp_path / "out") == 0
    text = said(capsys)
    assert "distance t4 - t5 contradicts the rest: its residual is" in text
    assert " mm)" in text


def test_one_code_at_two_places(good, tmp_path, capsys):
    """Two sheets with the same codes, of which each photo sees one: one of both places is refused, and it is said."""
    truth, points = good
    other = observe(replace_points(truth, truth.points_m + [0.2, -0.1, 0.05]), np.random.default_rng(3), 0.05)
    lookup = {other.label(row): other.pixels_px[row] for row in range(other.n)}
    pixels, moved, stayed = points.pixels_px.copy(), [], []
    for row in np.nonzero(points.target_index == points.targets.index("t6"))[0]:
        label = points.label(row)
        if points.photo_index[row] in {1, 4, 6} and label in lookup:
            pixels[row] = lookup[label]
            moved.append(label)
        else:
            stayed.append(label)
    folder = write_job(tmp_path / "in", replace(points, pixels_px=pixels), camera=KNOWN, scale_bar=[bar(truth, 0, 1)])
    assert command(folder, tmp_path / "out") == 0
    rejected = read_table_csv(tmp_path / "out" / "rejected.csv")
    refused = sorted(name for name in rejected["name"] if "target" in name)
    assert refused in (sorted(moved), sorted(stayed))
    # Each stands where it was measured, for the report's picture of its photo.
    measured = {points.label(row): pixels[row] for row in range(points.n)}
    for name, photo, x, y in zip(*(rejected[key] for key in ("name", "image", "x_px", "y_px")), strict=True):
        assert photo in name
        assert [float(x), float(y)] == pytest.approx(measured[name])
    text = (
        f"target t6: {len(refused)} of its {len(moved) + len(stayed)} image points contradict the others; is the code"
    )
    assert text in said(capsys)
    found = points_of(tmp_path / "out")
    del found["t6"]
    assert np.abs(fitted(found, truth.points_m)).max() < 2e-4


@pytest.fixture(scope="module")
def photos(tmp_path_factory) -> Path:
    """JPEG photos of the small panel; no test may change them."""
    folder = tmp_path_factory.mktemp("photos") / "panel"
    scene = target_scene("small", 0, PrintChoice(None, False, False))
    write_target_dataset(folder, scene, photogrammetry_content(scene), PhotoOptions(3, jpeg_quality=92))
    return folder


@pytest.mark.slow
def test_a_photo_that_is_cut_off(photos, tmp_path, capsys):
    folder = shutil.copytree(photos, tmp_path / "in")
    broken = sorted(folder.glob("photo_*.jpg"))[2]
    broken.write_bytes(broken.read_bytes()[:20000])
    assert command(folder, tmp_path / "out") == 2
    assert broken.name in said(capsys)


@pytest.mark.slow
def test_exif_rotation_is_no_matter_but_turned_pixels_are_refused(photos, tmp_path, capsys):
    folder = shutil.copytree(photos, tmp_path / "in")
    files = sorted(folder.glob("photo_*.jpg"))
    for file in files[:3]:
        content = file.read_bytes()
        # An EXIF block that says "turned by 90 degrees": the sensor's pixels stay where they are.
        tiff = b"II*\x00\x08\x00\x00\x00\x01\x00\x12\x01\x03\x00\x01\x00\x00\x00\x06\x00\x00\x00\x00\x00\x00\x00"
        block = b"Exif\x00\x00" + tiff
        file.write_bytes(content[:2] + b"\xff\xe1" + (len(block) + 2).to_bytes(2, "big") + block + content[2:])
    assert command(folder, tmp_path / "out") == 0
    assert command(photos, tmp_path / "plain") == 0
    with_tag, plain = points_of(tmp_path / "out"), points_of(tmp_path / "plain")
    assert all(np.array_equal(with_tag[name], plain[name]) for name in plain)
    capsys.readouterr()
    turned = cv2.rotate(cv2.imread(str(files[5]), cv2.IMREAD_GRAYSCALE), cv2.ROTATE_90_CLOCKWISE)
    cv2.imwrite(str(files[5]), turned)
    assert command(folder, tmp_path / "turned") == 2
    text = said(capsys)
    assert f"not {files[5].name} (1200 x 1600)" in text
    assert "turned by a program" in text


@pytest.mark.slow
def test_photos_of_another_camera_among_them(photos, tmp_path, capsys):
    folder = shutil.copytree(photos, tmp_path / "in")
    file = sorted(folder.glob("photo_*.jpg"))[4]
    cv2.imwrite(str(file), cv2.resize(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), (800, 600)))
    assert command(folder, tmp_path / "out") == 2
    text = said(capsys)
    assert f"{file.name} (800 x 600)" in text
    assert "describe several cameras with [[camera]]" in text
