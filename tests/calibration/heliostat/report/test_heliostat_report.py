"""Reports on heliostats: what the files say is what the page and its figures say."""

import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.heliostat.keys import load_heliostat
from calibration.heliostat.pipeline.field import run_into
from calibration.heliostat.pipeline.measure import Options
from calibration.heliostat.report import figures_residuals as figures
from calibration.heliostat.report import sections
from calibration.heliostat.report.results import FieldReport, HeliostatReport, open_field, open_heliostat
from heliogauge.errors import InputError
from heliogauge.reporting.build import build_report
from heliogauge.results.tables import read_table_csv, write_table_csv
from tests.calibration.heliostat_folders import write_field


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> HeliostatReport:
    folder = tmp_path_factory.mktemp("one")
    write_field(folder / "in", observations=50)
    table = read_table_csv(folder / "in" / "observations.csv")
    table["target"][4] = "elsewhere"
    write_table_csv(folder / "in" / "observations.csv", table)
    run_into(load_heliostat(folder / "in"), folder / "out", Options(thorough=True, model="5", jobs=1))
    return open_heliostat(folder / "out")


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> FieldReport:
    folder = tmp_path_factory.mktemp("field")
    write_field(folder / "in", heliostats=3, observations=40)
    run_into(load_heliostat(folder / "in"), folder / "out", Options(thorough=False, model="5", jobs=1))
    return open_field(folder / "out")


def test_headline_is_what_residuals_csv_says(one):
    with (one.folder / "residuals.csv").open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["split"] == "test" and not row["flag"]]
    beam = np.array([float(row["residual_beam_mrad"]) for row in rows])
    text = sections.headline(one).text
    assert f"predicted ({len(rows)})" in text
    assert f"{np.sqrt(np.mean(beam**2)):.2f} mrad" in text
    assert f"{beam.max():.2f} mrad" in text


def test_the_row_that_was_left_out_is_told_with_its_reason(one):
    text = sections.unused_section(one).text
    assert "elsewhere" in text
    assert one.residuals.observation[4] in text
    assert int((~one.residuals.used).sum()) == 1


def test_arrows_on_the_target_lead_from_measured_to_predicted(one):
    (name,) = figures.targets_hit(one)
    axes = figures.target_figure(one, name).axes[0]
    quivers = [drawn for drawn in axes.collections if hasattr(drawn, "U")]
    assert sum(len(drawn.U) for drawn in quivers) == one.residuals.used.sum()
    # The factor that is printed is the factor that is drawn.
    note = next(text.get_text() for text in axes.figure.texts if "arrows" in text.get_text())
    found = re.search(r"([\d.]+) times", note)
    factor = float(found.group(1)) if found else 1.0
    rows = one.residuals.used & ~one.residuals.is_test
    step = one.residuals.numbers["predicted_x_m"] - one.residuals.numbers["measured_x_m"]
    np.testing.assert_allclose(quivers[0].U, factor * step[rows], rtol=1e-6)
    assert factor >= 1


def test_residuals_against_time_and_sun_are_all_drawn(one):
    for figure in figures.series_figures(one).values():
        upper, lower = figure.axes
        for axes, name in ((upper, "residual_right_mrad"), (lower, "residual_up_mrad")):
            drawn = np.concatenate([line.get_ydata() for line in axes.lines[:2]])
            np.testing.assert_allclose(np.sort(drawn), np.sort(one.residuals.numbers[name][one.residuals.used]))
            low, high = axes.get_ylim()
            assert low <= drawn.min()
            assert drawn.max() <= high


def test_residuals_without_time_and_sun_are_drawn_in_their_order(one):
    rows = one.residuals
    nowhere = {name: np.full(rows.used.size, np.nan) for name in ("sun_azimuth_deg", "sun_elevation_deg")}
    bare = replace(rows, time=np.full(rows.used.size, np.datetime64("NaT", "ms")), numbers={**rows.numbers, **nowhere})
    drawn = figures.series_figures(replace(one, residuals=bare))
    assert list(drawn) == ["row"]
    x = np.concatenate([line.get_xdata() for line in drawn["row"].axes[0].lines if line.get_linestyle() == "None"])
    assert sorted(x) == [row + 1 for row in np.flatnonzero(rows.used)]


def test_parameters_are_given_in_milliradians_with_what_was_known(one):
    text = sections.parameter_table(one).text
    for name, parameter in one.content["parameters"].items():
        assert (name.replace("_", " ") in text) == (parameter["state"] != "held")
    tilt = one.content["parameters"]["tilt_north"]
    shown = re.search(r"tilt north</td><td[^>]*>([-\d.]+) ± ([\d.]+) mrad", text)
    assert float(shown.group(2)) == pytest.approx(1e3 * tilt["sigma"], rel=0.1)
    assert float(shown.group(1)) == pytest.approx(1e3 * tilt["value"], abs=0.1 * float(shown.group(2)))


def test_findings_are_told_with_what_to_do(one):
    finding = {"kind": "wrong_target", "severity": "fault", "text": "as if on <upper>", "remedy": "Check the name."}

    def told(diagnosis):
        return sections.finding_section(replace(one, content=one.content | {"diagnosis": diagnosis})).text

    text = told({"findings": [finding], "checks": [{}]})
    assert "wrong target (fault)" in text
    assert "as if on &lt;upper&gt;" in text
    assert "Check the name." in text
    assert "Nothing found in 7 " in told({"findings": [], "checks": [{}] * 7})


def test_sky_map_is_hatched_where_the_model_is_extrapolated(one):
    figure = figures.sky_figure(one)
    sky = one.content["sky"]
    axes = figure.axes[0]
    hatched = [drawn for drawn in axes.collections if drawn.get_hatch()]
    expected = sum(
        bool(beyond) and sigma is not None
        for row, sigmas in zip(sky["extrapolated"], sky["sigma_beam_mrad"], strict=True)
        for beyond, sigma in zip(row, sigmas, strict=True)
    )
    assert len(hatched) == 1
    assert hatched[0].get_array().count() == expected
    assert expected > 0


def test_field_names_the_worst_first_and_counts_what_needs_a_look(field):
    text = sections.field_table(field).text
    places = [text.index(name) for name in field.rows["heliostat"]]
    assert places == sorted(places)
    beam = field.numbers("beam_test_rms_mrad")
    assert (np.diff(beam) <= 0).all()
    doubtful = field.summary.numbers["doubtful_count"]
    said = sections.field_doubts(field).text
    assert (f"{doubtful} have warnings" in said) if doubtful else ("No warnings" in said)
    assert len(figures.field_map_figure(field.numbers("e_m"), field.numbers("n_m"), beam).axes) == 2


def test_damaged_tables_are_refused_by_name(one, tmp_path):
    for name in ("heliostat.json", "summary.json", "residuals.csv"):
        (tmp_path / name).write_bytes((one.folder / name).read_bytes())
    table = read_table_csv(tmp_path / "residuals.csv")
    table["residual_up_mrad"][2] = "much"
    write_table_csv(tmp_path / "residuals.csv", table)
    with pytest.raises(InputError, match="residual_up_mrad"):
        open_heliostat(tmp_path)
    table["residual_up_mrad"][2], table["time_utc"][1] = "0", "yesterday"
    write_table_csv(tmp_path / "residuals.csv", table)
    with pytest.raises(InputError, match="time_utc"):
        open_heliostat(tmp_path)


@pytest.mark.slow
def test_pages_of_a_heliostat_and_of_a_field(one: HeliostatReport, field: FieldReport) -> None:
    page = build_report(one.folder).read_text(encoding="utf-8")
    assert page.count("<img") >= len(figures.all_figures(one))
    assert json.loads((one.folder / "heliostat.json").read_text())["heliostat"] in page
    assert "Traceback" not in page
    whole = build_report(Path(field.folder)).read_text(encoding="utf-8")
    assert whole.count("<img") == 2
    assert "Traceback" not in whole
