"""The report of a deflectometric measurement: the first screen answers, and every number is that of the files."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deflectometry.report import sections
from deflectometry.report.light import spots
from deflectometry.report.maps import seen_part
from heliogauge.flags import SampleFlag
from heliogauge.reporting.build import build_report
from heliogauge.reporting.html import Html
from heliogauge.results.folder import write_pixels, write_slope_map, write_summary
from heliogauge.view.maps import MapView
from heliogauge.view.tables import TableView
from tests.heliogauge.reporting.test_report import FOCAL_M, make_map, make_summary, write_results
from tests.without_plots import without_plots


def first_screen(folder: Path) -> str:
    results = sections.open_results(folder)
    return sections.first_screen(results, sections.slope_view(results)).text


def test_a_result_with_a_hole_is_never_green(tmp_path: Path) -> None:
    """63.3 % measured: the report said "every check passed" over such a map."""
    slope_map = write_results(tmp_path)
    calm = replace(make_summary(slope_map), doubts=())
    x, y = np.meshgrid(slope_map.x_m, slope_map.y_m)
    distance = np.hypot(x - 0.1, y)
    hole = distance <= np.quantile(distance, 1 - 0.633)
    flags = np.where(hole, np.uint32(SampleFlag.LOW_MODULATION), np.uint32(0))
    nothing = {name: np.where(hole, np.nan, getattr(slope_map, name)) for name in ("slope_x", "slope_y", "height_m")}
    holed = replace(slope_map, flags=flags, **nothing)
    write_slope_map(tmp_path / "slope_map.nc", {"": holed})
    write_summary(tmp_path / "summary.json", replace(calm, numbers={**calm.numbers, "measured_share": 0.633}))
    shown = first_screen(tmp_path)
    assert 'class="verdict incomplete"' in shown
    assert "36.7 % of the mirror not measured" in shown
    assert "sound" not in shown


def test_a_whole_result_is_green(tmp_path: Path) -> None:
    slope_map = write_results(tmp_path)
    whole = replace(make_map(), flags=np.zeros(slope_map.shape, np.uint32))
    filled = {name: np.nan_to_num(getattr(whole, name)) for name in ("slope_x", "slope_y")}
    write_slope_map(tmp_path / "slope_map.nc", {"": replace(whole, **filled)})
    write_summary(tmp_path / "summary.json", replace(make_summary(slope_map), doubts=()))
    assert 'class="verdict sound"' in first_screen(tmp_path)


def test_doubts_of_the_first_screen_lead_to_their_words(tmp_path: Path) -> None:
    write_results(tmp_path)
    build_report(tmp_path)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert '<a href="#doubt-1">2.0 % of the mirror was not measured &lt;saturated&gt;</a>' in text
    assert text.count('id="doubt-1"') == 1


def test_the_map_lives_in_the_page_and_is_still_in_the_notebook(tmp_path: Path) -> None:
    write_results(tmp_path)
    with without_plots():
        build_report(tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    first = page[page.index('<div class="first">') : page.index('id="doubts"')]
    assert first.count('data-view="map"') == 1
    assert first.count("<img") == 2
    assert "data-view" not in (tmp_path / "report.ipynb").read_text(encoding="utf-8")


def test_names_are_text_everywhere(tmp_path: Path) -> None:
    name = "a$\\bad{$b <i>"
    slope_map = write_results(tmp_path)
    facets = {name: {"sdx_rad": 1e-3, "sigma_sdx_rad": 1e-5}}
    write_slope_map(tmp_path / "slope_map.nc", {"": slope_map, "A1": slope_map})
    write_summary(tmp_path / "summary.json", replace(make_summary(slope_map), name=name, facets=facets))
    build_report(tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<h1>a$\\bad{$b &lt;i&gt;</h1>" in page
    assert "<i>" not in re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)


def test_facets_are_linked_to_their_maps(tmp_path: Path) -> None:
    slope_map = write_results(tmp_path)
    write_slope_map(tmp_path / "slope_map.nc", {"": slope_map, "A1": slope_map, "A2": slope_map})
    facets = {
        "A1": {"canting_x_rad": 1e-3, "sigma_canting_x_rad": 1e-5, "twist_per_m": 0.0},
        "A2": {"canting_x_rad": -2e-3, "twist_per_m": 0.0},
    }
    write_summary(tmp_path / "summary.json", replace(make_summary(slope_map), facets=facets))
    results = sections.open_results(tmp_path)
    table = sections.facet_table(results)
    assert isinstance(table, TableView)
    text = table._repr_html_()
    assert "1.000 \u00b1 0.010 mrad" in text
    assert "-2 mrad" in text
    maps = sections.facet_views(results).text
    marks = re.findall(r'href="#(facet-\d)">(A\d)', text)
    assert [name for _, name in marks] == ["A1", "A2"]
    assert all(f'<div id="{mark}">' in maps for mark, _ in marks)


def test_a_single_facet_has_no_table_of_facets(tmp_path: Path) -> None:
    write_results(tmp_path)
    results = sections.open_results(tmp_path)
    table = sections.facet_table(results)
    assert isinstance(table, Html)
    assert table.text == sections.facet_views(results).text == ""


def test_the_design_spot_is_the_image_of_the_sun(tmp_path: Path) -> None:
    write_results(tmp_path)
    traced = spots(sections.open_results(tmp_path), rays=100_000)
    design, measured = traced["design"], traced["as measured"]
    assert design.distance_m == pytest.approx(FOCAL_M, rel=1e-7)  # slopes are stored as float32
    # A uniform disc holds half of its light within its radius over sqrt(2).
    assert design.radius_of_share(0.5) == pytest.approx(4.65e-3 * FOCAL_M / math.sqrt(2), rel=0.02)
    assert measured.radius_of_share(0.99) > design.radius_of_share(0.99)
    assert measured.rays == 100_000


def test_a_summary_can_name_the_target(tmp_path: Path) -> None:
    slope_map = write_results(tmp_path)
    summary = make_summary(slope_map)
    numbers = {**summary.numbers, "target_distance_m": 25.0}
    write_summary(tmp_path / "summary.json", replace(summary, numbers=numbers))
    assert spots(sections.open_results(tmp_path), rays=1000)["design"].distance_m == 25.0


def test_images_are_cut_to_what_was_seen(tmp_path: Path) -> None:
    write_results(tmp_path)
    seen = np.full((200, 300), np.nan)
    seen[50:90, 100:160] = 80.0
    write_pixels(tmp_path / "pixels.nc", {"modulation_dn": seen})
    results = sections.open_results(tmp_path)
    rows, columns = seen_part(np.isfinite(results.pixels["modulation_dn"]))
    assert (rows.start, rows.stop, columns.start, columns.stop) == (47, 93, 96, 164)
    view = sections.image_view(results)
    assert isinstance(view, MapView)
    assert (view.x_m[0], view.x_m[-1], view.y_m[0], view.y_m[-1]) == (96, 163, 47, 92)
    bare = sections.image_view(replace(results, pixels={}))
    assert isinstance(bare, Html)
    assert "no per-pixel" in bare.text


def test_shares_in_the_table_are_those_of_the_variance(tmp_path: Path) -> None:
    write_results(tmp_path)
    text = sections.share_table(sections.open_results(tmp_path)).text
    shares = [tuple(map(int, pair)) for pair in re.findall(r"(\d+) %, (\d+) %", text)]
    assert shares[-1] == (100, 100)
    for axis in (0, 1):
        assert sum(pair[axis] for pair in shares[:-1]) == pytest.approx(100, abs=2)
    assert math.isfinite(float(re.findall(r"([\d.]+) \u00b5rad", text)[0]))
