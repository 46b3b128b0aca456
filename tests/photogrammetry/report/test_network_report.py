"""The report of a network: the verdict is true, numbers are the files', links lead somewhere, large ones stay small."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from heliogauge.reporting.build import build_report
from heliogauge.reporting.verdict import State
from heliogauge.view.arrays import PAGE
from photogrammetry.report import charts, photos, sections, tables
from photogrammetry.report.network import NetworkResults, open_network
from photogrammetry.report.scene import network_view
from tests.photogrammetry.report.drawn_results import DOUBT, LEFT_OUT, NASTY, PHOTOS, write_network
from tests.without_plots import without_plots

_PICTURE = r'<img[^>]* src="data:image/svg\+xml,([^"]+)"'


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("network")
    write_network(folder)
    with without_plots():
        build_report(folder)
    return folder


@pytest.fixture(scope="module")
def results(folder: Path) -> NetworkResults:
    return open_network(folder)


@pytest.fixture(scope="module")
def page(folder: Path) -> str:
    return (folder / "report.html").read_text(encoding="utf-8")


def test_photos_left_out_and_lost_targets_are_missing(results: NetworkResults) -> None:
    found = sections.verdict(results)
    assert found.state is State.INCOMPLETE
    assert set(found.missing) == {"1 of 4 photos left out", "1 of 13 targets without coordinates"}
    assert any("known lengths" in text for text in found.passed)
    assert any("at least 3 photos" in text for text in found.passed)


def test_a_whole_network_without_doubts_is_sound(tmp_path: Path) -> None:
    write_network(tmp_path, doubts=())
    table = (tmp_path / "points.csv").read_text(encoding="utf-8").splitlines()
    (tmp_path / "points.csv").write_text("\n".join(table[:-1]) + "\n", encoding="utf-8")
    content = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    content["numbers"]["left_out_photos_count"] = 0
    (tmp_path / "summary.json").write_text(json.dumps(content), encoding="utf-8")
    assert sections.verdict(open_network(tmp_path)).state is State.SOUND


def test_the_first_screen_holds_verdict_numbers_and_scene(page: str, results: NetworkResults) -> None:
    first = page.partition("<main>")[2].partition("<h2")[0]
    assert first.index('class="verdict incomplete"') < first.index('class="numbers"') < first.index('data-view="scene"')
    assert DOUBT.text.partition(";")[0] in first
    for axis in "xyz":
        shown = re.search(rf"RMS sigma of the points in {axis}</th><td>([0-9.]+) (\u00b5m|mm)</td>", first)
        value = float(shown[1]) * {"\u00b5m": 1e-6, "mm": 1e-3}[shown[2]]
        assert value == pytest.approx(results.summary.numbers[f"point_sigma_{axis}_rms_m"], rel=0.05)
    shown = re.search(r"RMS image residual</th><td>([0-9.]+) px", first)
    assert float(shown[1]) == pytest.approx(results.summary.numbers["image_residual_rms_px"], rel=0.005)


def test_links_lead_to_places_in_the_page(page: str) -> None:
    shown = [
        json.loads(text) for text in re.findall(r'<script type="application/json">(.*?)</script>', page, re.DOTALL)
    ]
    marks = {photo["mark"] for one in shown for photo in one.get("photos", ())}
    assert len(marks) == len(PHOTOS) + 1
    places = set(re.findall(r'id="([^"]+)"', page)) | marks
    links = re.findall(r'href="#([^"]+)"', page)
    assert len([link for link in links if link.startswith("photo-")]) >= 4 + 12
    assert set(links) <= places


def test_what_the_user_wrote_is_text(page: str) -> None:
    assert "<script>alert" not in page
    assert "a$\\bad{$b &lt;script&gt;alert(1)&lt;/script&gt;" in page


def test_photos_show_what_was_used_and_refused(results: NetworkResults) -> None:
    shown = {photo.name: photo for photo in photos.photo_view(results).photos}
    assert list(shown)[-1] == LEFT_OUT
    used, refused = shown[PHOTOS[0]].marks
    own = results.used.photo == 0
    np.testing.assert_array_equal(used.xy_px, results.used.pixels_px[own])
    # Measured minus predicted: an arrow from the prediction to the measurement.
    np.testing.assert_array_equal(used.residual_px, -results.used.residuals_px[own])
    np.testing.assert_array_equal(refused.xy_px, [[100.0, 200.0]])
    assert "contradicts the others" in refused.labels[0]
    assert shown[LEFT_OUT].image is not None
    assert shown[LEFT_OUT].note == "not in the network"


def test_points_link_to_the_photo_with_their_largest_residual(results: NetworkResults) -> None:
    columns = {column.name: column for column in tables.point_table(results).columns}
    names, worst = columns["point"].texts, columns["largest residual"]
    for row, name in enumerate(names):
        own = [i for i, target in enumerate(results.used.targets) if target == name]
        sizes = np.linalg.norm(results.used.residuals_px[own], axis=1)
        assert worst.numbers[row] == pytest.approx(sizes.max())
        photo = PHOTOS[results.used.photo[own[int(np.argmax(sizes))]]]
        assert worst.texts[row].endswith(f"px in {photo}")
        assert worst.links[row] == f"#{results.photo_marks[photo]}"
    sigmas = [results.sigma_mm[list(results.points.ids).index(name)] for name in names]
    assert sigmas == sorted(sigmas, reverse=True)


def test_the_scene_holds_points_cameras_and_known_lengths(results: NetworkResults) -> None:
    view = network_view(results, list(PHOTOS))
    groups = {group.name.partition(",")[0].partition(" (")[0]: group for group in view.groups}
    assert set(groups) == {"points", "error ellipsoids", "cameras", "projection centres", "known lengths"}
    np.testing.assert_array_equal(groups["known lengths"].xyz_m, results.points.xyz_m[:2])
    assert any(NASTY in label for label in groups["points"].labels)


def test_residuals_in_cells_are_those_of_the_table(results: NetworkResults) -> None:
    view = charts.residual_map(results)
    layers = {layer.key: layer.values for layer in view.layers}
    count = np.nan_to_num(layers["count"])
    assert count.sum() == len(results.used.photo)
    total = np.nansum(layers["mean_x"] * count)
    assert total == pytest.approx(results.used.residuals_px[:, 0].sum())
    assert np.sqrt(np.nansum(layers["residual_rms"] ** 2 * count) / count.sum()) == pytest.approx(
        results.summary.numbers["image_residual_rms_px"]
    )


def test_many_image_points_are_thinned_and_the_largest_kept(results: NetworkResults) -> None:
    rng = np.random.default_rng(3)
    few, words = photos._used_marks(results, rng.permutation(len(results.used.photo)), 8)
    assert len(few.xy_px) <= 8
    assert "the largest residuals among them" in words
    sizes = np.linalg.norm(results.used.residuals_px, axis=1)
    assert np.linalg.norm(few.residual_px, axis=1).max() == pytest.approx(sizes.max())


def test_everything_is_drawn_for_paper_once(folder: Path, page: str) -> None:
    notebook = json.loads((folder / "report.ipynb").read_text(encoding="utf-8"))
    text = "".join(
        line for cell in notebook["cells"] for one in cell.get("outputs", ()) for line in one["data"]["text/html"]
    )
    pictures = re.findall(_PICTURE, text)
    # Network twice, first photo, coverage, means, radius, histogram, rays, lengths; one intrinsic has no correlation.
    assert len(pictures) == len(set(pictures)) == 9
    assert re.findall(_PICTURE, page) == pictures


def test_views_of_a_network_without_points_say_so(tmp_path: Path) -> None:
    write_network(tmp_path)
    for name in ("points.csv", "points_covariance.csv", "residuals.csv"):
        head = (tmp_path / name).read_text(encoding="utf-8").splitlines()[0]
        (tmp_path / name).write_text(head + "\n", encoding="utf-8")
    results = open_network(tmp_path)
    assert "No point has coordinates" in sections.points(results)._repr_html_()
    assert "No image point was used" in sections.residuals(results)._repr_html_()
    assert sections.first_screen(results).page_html(PAGE)
