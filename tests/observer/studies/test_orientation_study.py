"""Gravity study: weight told from bend, sigmas, refusals; results in, table and figure out."""

import base64
import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from heliogauge.errors import EstimationError, InputError
from heliogauge.results.folder import Summary, write_summary, write_table_csv
from heliogauge.results.slope_map_file import write_slope_map
from heliogauge.results.tables import read_table_csv
from heliogauge.slopes.map import SlopeMap, no_common_modes
from observer import cli
from observer.absorber.product import absorber_columns, shape_numbers, span_columns, tube_spans
from observer.files import COLLECTOR as COLLECTOR_FILE
from observer.files import write_collector
from observer.product.orientation_study import SpanSags, mirror_change, sag_by_weight
from observer.report import compare as report
from observer.report.figures_modules import OneMap, maps_sheet
from observer.studies.compare import mirror_changes, run
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector

TURNS = np.radians([0.0, 90.0, 170.0])
COLLECTOR = Collector(5.0, 7.8, 1.49, 0.07)
Y_M = np.linspace(-3.9, 3.9, 33)


def sags(noise: np.ndarray, sigma_m: float = 2e-4) -> SpanSags:
    """A tube that sags by 6 mm and is bent by (1, -0.5) mm."""
    full = np.full(3, sigma_m)
    return SpanSags(TURNS, 6e-3 * np.sin(TURNS) + 1e-3 + noise[0], -6e-3 * np.cos(TURNS) - 5e-4 + noise[1], full, full)


def test_weight_is_told_from_bend_with_its_sigma() -> None:
    exact = sag_by_weight(sags(np.zeros((2, 3))))
    np.testing.assert_allclose([exact.by_weight_m, exact.bend_x_m, exact.bend_z_m], [6e-3, 1e-3, -5e-4], atol=1e-12)
    rng = np.random.default_rng(3)
    found = [sag_by_weight(sags(2e-4 * rng.standard_normal((2, 3)))) for _ in range(400)]
    for name in ("by_weight_m", "bend_x_m", "bend_z_m"):
        scatter = np.std([getattr(one, name) for one in found])
        np.testing.assert_allclose(scatter, getattr(exact, f"sigma_{name}"), rtol=0.12)
    # A tube that slipped by 3 mm at one orientation is seen.
    assert sag_by_weight(sags(np.array([[0, 3e-3, 0], [0, 0, 0]]))).worst_residual > 3.5


def test_one_orientation_or_two_alike_are_refused() -> None:
    one = SpanSags(*(np.zeros(1) for _ in range(3)), np.ones(1), np.ones(1))
    with pytest.raises(EstimationError, match=r"1 orientations within 0 degrees.*10 degrees apart"):
        sag_by_weight(one)
    alike = replace(sags(np.zeros((2, 3))), orientation_rad=np.radians([10.0, 12.0, 15.0]))
    with pytest.raises(EstimationError, match="3 orientations within 5 degrees"):
        sag_by_weight(alike)


def mirror(change_rad: float = 0.0, noise_rad: float = 0.0) -> SlopeMap:
    """A trough's mirror whose normals are turned towards +x by an angle, and noise."""
    x, y = (np.arange(40) - 19.5) * 0.1, (np.arange(30) - 14.5) * 0.2
    design = np.tile(x / (2 * 1.49), (30, 1))
    noise = noise_rad * np.random.default_rng(1).standard_normal(design.shape)
    slope = np.tan(np.arctan(design) - change_rad + noise)
    zero, sigma = np.zeros(design.shape), np.full(design.shape, max(noise_rad, 1e-6))
    return SlopeMap(
        x_m=x,
        y_m=y,
        slope_x=slope,
        slope_y=zero,
        design_slope_x=design,
        design_slope_y=zero,
        sigma_random_x=sigma * (1 + design**2),
        sigma_random_y=sigma,
        noise_correlation=0.0,
        common=no_common_modes(),
        height_m=np.full(design.shape, np.nan),
        flags=np.zeros(design.shape, dtype=np.uint32),
        aperture=np.ones(design.shape, dtype=bool),
        design="parabola",
        frame="trough",
        removed="nothing",
    )


def result_at(folder: Path, degrees: float, *, with_map: bool = True) -> Path:
    """Write what `heliogauge observer measure` writes, as far as the study reads it."""
    folder.mkdir()
    turn = np.radians(degrees)
    shape = 1 - (Y_M / 3.9) ** 2
    path = AbsorberPath(Y_M, 6e-3 * np.sin(turn) * shape, 1.49 - 6e-3 * np.cos(turn) * shape, 1e-8 * np.eye(66))
    write_table_csv(folder / "absorber.csv", absorber_columns(path, None, COLLECTOR))
    write_table_csv(folder / "absorber_spans.csv", span_columns(tube_spans(path, None, COLLECTOR, turn)))
    write_collector(folder / COLLECTOR_FILE, COLLECTOR)
    numbers = {**shape_numbers(path, None, COLLECTOR, turn), "orientation_rad": turn}
    write_summary(folder / "summary.json", Summary("observer", "LS-2", numbers, texts={"design": COLLECTOR.describe()}))
    if with_map:
        write_slope_map(folder / "slope_map.nc", {"": mirror(1e-3 * np.sin(turn), 2e-4 if degrees else 0.0)})
    return folder


def test_command_line_makes_table_and_figure(tmp_path: Path) -> None:
    folders = [result_at(tmp_path / f"at{degrees:g}", degrees) for degrees in (0.0, 90.0, 170.0)]
    out = tmp_path / "study"
    result = CliRunner().invoke(cli.app, ["compare", *map(str, folders), "-o", str(out)])
    assert result.exit_code == 0, result.output
    assert "3 results at 0, 90, 170 degrees" in result.output
    assert "sag by weight 6.00" in result.output
    table = read_table_csv(out / "orientations.csv")
    np.testing.assert_allclose([float(cell) for cell in table["orientation_deg"]], [0, 90, 170])
    np.testing.assert_allclose(float(table["theta_r_turned_rad"][1]), 1e-3, atol=3e-5)
    np.testing.assert_allclose(float(table["theta_r_change_rms_rad"][1]), 2e-4, rtol=0.1)
    np.testing.assert_allclose(float(table["theta_r_change_noise_rad"][1]), 2e-4, rtol=0.1)
    weight = read_table_csv(out / "sag_by_weight.csv")
    np.testing.assert_allclose(float(weight["by_weight_m"][0]), 6e-3, atol=1e-6)
    for name, words in (("orientations.svg", "Sag of the absorber"), ("theta_r_change.svg", "LS-2 (170 deg)")):
        drawn = (out / name).read_text(encoding="utf-8")
        assert ElementTree.fromstring(drawn).tag.endswith("svg")
        assert words in drawn


def test_the_report_has_what_the_study_wrote(tmp_path: Path) -> None:
    folders = [result_at(tmp_path / f"at{degrees:g}", degrees) for degrees in (0.0, 90.0)]
    study = run(folders)
    study.write(tmp_path)
    results = report.open_study(tmp_path)
    assert [one.label for one in results.profiles] == ["LS-2 (0 deg)", "LS-2 (90 deg)"]
    for one, other in zip(results.profiles, study.orientations, strict=True):
        np.testing.assert_allclose(one.z_m, other.profile.z_m, rtol=1e-9)
        np.testing.assert_allclose(one.sigma_x_m, other.profile.sigma_x_m, rtol=1e-9)
        assert one.orientation_rad == pytest.approx(other.profile.orientation_rad)
    np.testing.assert_allclose(results.sags[0].sag_x_m, [0.0, 6e-3], atol=1e-6)
    np.testing.assert_allclose(results.changes[0].angle_rad, mirror_changes(study)[0].angle_rad, atol=1e-9)
    # Without its mean, 1 mrad, the change is noise; x goes to the right and y up, as in all maps.
    assert abs(np.nanmean(results.changes[0].angle_rad)) < 1e-8
    assert "6.00" in report.weight(results).text
    assert "1.01 mrad" in report.absorber(results).text
    first = report.head(results).text
    assert first.count("<img") == 1
    assert "2 orientations" in first
    assert "6.00" in first
    change = report.head(results).picture.layers[0]
    sigma = np.hypot(*(one.sigma_random_x for one in study.maps)) / (1 + study.maps[0].slope_x ** 2)
    np.testing.assert_allclose(change.sigma, np.where(np.isfinite(change.values), sigma, np.nan), rtol=1e-6)


def test_maps_beside_each_other_are_seen_from_the_front() -> None:
    """x to the right and y up: the node at the lower right alone is turned towards +x, and red; the upper left blue."""
    angle = np.zeros((4, 6))
    angle[0, -1], angle[-1, 0] = 1e-3, -1e-3
    maps = [OneMap(name, np.arange(6.0), np.arange(4.0), angle) for name in ("a", "<b>")]
    drawn = maps_sheet(maps, "both").svg()
    assert "&lt;b&gt;: 0.29 mrad RMS" in drawn
    pictures = re.findall(r'data:image/png;base64,([^"]+)"', drawn)
    assert len(pictures) == 2
    image = cv2.imdecode(np.frombuffer(base64.b64decode(pictures[1]), np.uint8), cv2.IMREAD_COLOR)
    (blue, _, red), (last_blue, _, last_red) = image[0, 0].tolist(), image[-1, -1].tolist()
    assert blue > red
    assert last_red > last_blue


def test_absorber_alone_is_enough(tmp_path: Path) -> None:
    folders = [result_at(tmp_path / f"at{degrees:g}", degrees, with_map=False) for degrees in (0.0, 60.0)]
    found = run(folders)
    assert found.maps == (None, None)
    found.write(tmp_path)
    profiles = {one.name: one for one in report.head(report.open_study(tmp_path)).picture.series}
    assert profiles.keys() == {one.profile.label for one in found.orientations}
    assert found.sags[0] is not None
    np.testing.assert_allclose(found.sags[0].by_weight_m, 6e-3, atol=1e-6)


def test_what_is_not_a_result_is_said(tmp_path: Path) -> None:
    one = result_at(tmp_path / "one", 0.0, with_map=False)
    with pytest.raises(InputError, match="1 result given"):
        run([one])
    field = tmp_path / "field"
    field.mkdir()
    (field / "overview.csv").write_text("result,name\nloop-1,Loop 1\n")
    with pytest.raises(InputError, match=r"several modules; compare each with itself: give .*loop-1"):
        run([field, tmp_path])
    # One that failed has no folder.
    (field / "overview.csv").write_text("result,name,failed\nloop-1,Loop 1,no targets\nloop-2,Loop 2,\n")
    with pytest.raises(InputError, match=r"several modules; compare each with itself: give .*loop-2"):
        run([field, tmp_path])
    for nothing in ("", "loop-1,Loop 1,no targets\n"):
        (field / "overview.csv").write_text(f"result,name,failed\n{nothing}")
        with pytest.raises(InputError, match=r"several modules, none of which was measured"):
            run([field, tmp_path])
    with pytest.raises(InputError, match=r"no absorber_spans\.csv; give results of"):
        run([one, tmp_path])
    with pytest.raises(InputError, match=r"one and .*one are the same result"):
        run([one, tmp_path / "two" / ".." / "one"])
    again = result_at(tmp_path / "again", 0.0, with_map=False)
    found = run([one, again])
    assert found.sags == ()
    # Of one orientation nothing is asked of weight.
    assert found.doubts == ()


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ({"focal_length_m": 1.5}, r"focal_length_m is 1\.49 in .* and 1\.5 in"),
        ({"panel_edges_x_m": [-2.5, 0.3, 2.5]}, r"panel_edges_x_m is -2\.5, 0, 2\.5 in .* and -2\.5, 0\.3, 2\.5 in"),
        ({"panel_edges_y_m": [-3.9, 0.0, 3.9]}, "panel_edges_y_m"),
    ],
)
def test_other_collectors_are_refused(tmp_path: Path, other: dict[str, Any], said: str) -> None:
    """Eight panels with other edges are other panels; another focal length turns all of them."""
    folders = [result_at(tmp_path / name, 0.0) for name in ("one", "other")]
    design = replace(COLLECTOR, panel_edges_x_m=[-2.5, 0.0, 2.5])
    write_collector(folders[0] / COLLECTOR_FILE, design)
    write_collector(folders[1] / COLLECTOR_FILE, replace(design, **other))
    with pytest.raises(InputError, match=said):
        run(folders)
    write_collector(folders[1] / COLLECTOR_FILE, replace(design, panel_edges_x_m=[-2.5, 0.004, 2.5]))
    assert run(folders).doubts == ()


def test_a_result_without_spans_has_no_sags(tmp_path: Path) -> None:
    folders = [result_at(tmp_path / name, degrees) for name, degrees in (("one", 0.0), ("other", 60.0))]
    spans = folders[1] / "absorber_spans.csv"
    spans.write_text(spans.read_text().splitlines()[0] + "\n")
    found = run(folders)
    assert found.sags == (None,)
    assert [one.code for one in found.doubts] == ["sag_not_determined"]


def test_a_turned_mirror_is_a_tilt() -> None:
    change = mirror_change(mirror(), mirror(5e-4))
    np.testing.assert_allclose(change.tilt_rad, 5e-4, rtol=1e-3)
    assert change.rms_rad < 1e-6
