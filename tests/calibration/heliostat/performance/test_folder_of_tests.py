"""A folder of what was done becomes results and a data sheet; bad input is said in a sentence."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

import heliogauge as hg
from calibration.heliostat.performance.files.result import read_entries
from calibration.heliostat.performance.keys import load_tests
from calibration.heliostat.performance.pipeline.make_sheet import SheetOptions
from calibration.heliostat.performance.pipeline.make_sheet import run as make_sheets
from calibration.heliostat.performance.pipeline.run_tests import Options, run
from calibration.heliostat.performance.report.sheet_page import sheet_page
from data_synth.acceptance.dataset import write_tests_folder
from data_synth.acceptance.plant import TestPlant
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import InputError
from heliogauge.results.folder import read_summary, write_summary
from heliogauge.results.frame import into_folder
from heliogauge.running.progress import SilentProgress


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tests") / "AB12"
    write_tests_folder(folder, seed=3)
    # The year takes four seconds: a test of its own.
    file = folder / "measurement.toml"
    file.write_text(file.read_text().partition("[year]")[0])
    return folder


@pytest.fixture(scope="module")
def results(drawn, tmp_path_factory):
    out = tmp_path_factory.mktemp("results") / "AB12"
    into_folder(out, lambda: run(load_tests(drawn)), SilentProgress(), force=False, report=True)
    return out


def edited(drawn, tmp_path, name, change):
    """Copy the folder with one table changed."""
    folder = tmp_path / "copy"
    folder.mkdir()
    for file in drawn.iterdir():
        text = file.read_text()
        (folder / file.name).write_text(change(text) if file.name == name else text)
    return folder


def test_entries_are_the_truth_within_their_sigmas(drawn, results):
    truth = json.loads((drawn / "truth.json").read_text())
    _, entries = read_entries(results / "entries.csv")
    known = {one.name: one for one in entries}
    compared = [key for key in known if key in truth]
    assert len(compared) >= 14
    scores = {key: (known[key].value - truth[key]) / known[key].sigma for key in compared}
    assert max(map(abs, scores.values())) < 3.5, scores
    assert (results / "report.html").stat().st_size > 10_000


def test_sheet_has_every_entry_and_what_was_not_measured(drawn, results, tmp_path):
    sheets = make_sheets([results], SheetOptions(limits=drawn / "limits.toml", pdf=False))
    sheets.write(tmp_path)
    page = (tmp_path / "AB12.html").read_text()
    assert "Example laboratory" in page
    assert "Approved by: B. Person" in page
    assert "not measured" in page
    assert "http" not in page.replace("http://www.w3.org", "").replace("http-equiv", "")
    lines = {line.entry.name: line for line in sheets.sheets[0].lines}
    assert lines["day_beam_rms_rad"].decision.conformity == "pass"
    assert lines["quality_sd_rad"].decision.conformity == "not measured"
    assert lines["control_faults_answered_share"].decision.conformity == "conditional fail"


def test_sheet_counts_the_doubts_of_its_results_and_says_the_heaviest_first(results, tmp_path):
    folder = tmp_path / "AB12-results"
    shutil.copytree(results, folder)
    summary = read_summary(folder)
    light = [Doubt("log_out_of_order", f"wind.csv: {k} rows are late") for k in range(6)]
    heavy = Doubt("result_of_another_name", "these are of another heliostat", severity=Severity.SERIOUS)
    write_summary(folder / "summary.json", replace(summary, doubts=(*light, heavy)))
    sheets = make_sheets([folder], SheetOptions(pdf=False))
    (tmp_path / "sheet").mkdir()
    sheets.write(tmp_path / "sheet")
    assert hg.open(tmp_path / "sheet").summary["doubts_count"] == 7
    page = (tmp_path / "sheet" / "AB12.html").read_text()
    assert page.index("these are of another heliostat") < page.index("wind.csv: 0 rows are late")
    assert "and 2 more, in summary.json" in page
    assert "Doubts of the results, in their own reports: AB12-results: 7" in page


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("time_utc", "when", r"day_rows\.csv: .*time_utc"),
        ("beam_up_rad", "up", r"day_rows\.csv: .*beam_up_rad"),
        ("2026", "soon", r"day_rows\.csv: damaged or changed by hand .*soon"),
    ],
)
def test_sheet_of_rows_without_times_is_refused_in_words(results, tmp_path, old, new, match):
    folder = tmp_path / "AB12-results"
    shutil.copytree(results, folder)
    text = (folder / "day_rows.csv").read_text()
    (folder / "day_rows.csv").write_text(text.replace(old, new))
    with pytest.raises(InputError, match=match):
        make_sheets([folder], SheetOptions(pdf=False))


def test_one_result_given_twice_was_measured_once(results):
    sheets = make_sheets([results, results], SheetOptions(pdf=False))
    assert not [one for one in sheets.doubts if one.code == "measured_twice"]


@pytest.mark.slow
def test_year_says_what_a_mrad_costs(tmp_path):
    write_tests_folder(tmp_path / "AB12", seed=1)
    result = run(load_tests(tmp_path / "AB12"), Options("year"))
    known = {one.key: one for one in result.entries}
    assert {one.test for one in result.entries} == {"year"}
    assert 0.9 < known["intercept_share"].value < 1
    costs = [known[f"{cause}_next_mrad_lost_share"] for cause in ("offset", "scatter", "slope", "canting")]
    # One mrad more of the normal costs more than one of the beam.
    assert costs[2].value > 2 * costs[1].value > 0
    assert all(one.value > 3 * one.sigma for one in costs)
    lost = known["slope_lost_share"]
    assert lost.value > 5 * lost.sigma


@pytest.mark.slow
def test_pdf_is_one_page(drawn, results, tmp_path):
    pytest.importorskip("weasyprint", exc_type=ImportError)
    from heliogauge.reporting.print_pdf import write_pdf

    sheets = make_sheets([results], SheetOptions(limits=drawn / "limits.toml"))
    assert write_pdf(sheet_page(sheets.sheets[0], 0.95, printed=True), tmp_path / "sheet.pdf") == 1
    assert (tmp_path / "sheet.pdf").read_bytes().startswith(b"%PDF")


def test_one_test_alone(drawn):
    found = run(load_tests(drawn), Options("backlash"))
    assert {one.test for one in found.entries} == {"backlash"}
    with pytest.raises(InputError, match=r"no section \[quality\]"):
        run(load_tests(drawn), Options("quality"))


def test_wrong_time_zone_is_named(drawn, tmp_path):
    """Clocks 6 hours ahead put the last beams into the night."""
    folder = edited(drawn, tmp_path, "day_1.csv", lambda text: text.replace("Z,", "-06:00,"))
    with pytest.raises(InputError, match=r"below the horizon .* wrong time zone.*clocks that are \d h ahead"):
        run(load_tests(folder), Options("day"))


def test_time_without_zone_is_refused(drawn, tmp_path):
    folder = edited(drawn, tmp_path, "wind.csv", lambda text: text.replace("Z,", ","))
    with pytest.raises(InputError, match="says no zone"):
        run(load_tests(folder), Options("wind"))


def test_log_out_of_order_is_sorted_and_said(drawn, tmp_path):
    def swapped(text):
        lines = text.splitlines()
        return "\n".join([lines[0], *lines[20:], *lines[1:20]]) + "\n"

    folder = edited(drawn, tmp_path, "wind.csv", swapped)
    found, plain = (run(load_tests(one), Options("wind")) for one in (folder, drawn))
    assert "log_out_of_order" in {one.code for one in found.doubts}
    assert [one.value for one in found.entries] == [one.value for one in plain.entries]


def test_degrees_are_read_and_said(drawn, tmp_path):
    def to_degrees(text):
        head, *rows = text.splitlines()
        cells = [row.split(",") for row in rows]
        body = [f"{a},{np.degrees(1e-3 * float(b))},{np.degrees(1e-3 * float(c))}" for a, b, c in cells]
        return "\n".join([head.replace("_mrad", "_deg"), *body]) + "\n"

    folder = edited(drawn, tmp_path, "sun_camera.csv", to_degrees)
    found, plain = (run(load_tests(one), Options("sun_camera")) for one in (folder, drawn))
    assert "angles_in_degrees" in {one.code for one in found.doubts}
    assert [one.value for one in found.entries] == pytest.approx([one.value for one in plain.entries])


def test_column_without_a_unit_is_refused(drawn, tmp_path):
    folder = edited(drawn, tmp_path, "sun_camera.csv", lambda text: text.replace("azimuth_mrad", "azimuth"))
    with pytest.raises(InputError, match="has no unit"):
        run(load_tests(folder), Options("sun_camera"))


@pytest.mark.parametrize("cell", ["nan", "", "inf"])
@pytest.mark.parametrize("column", ["azimuth_mrad", "elevation_mrad"])
def test_angles_of_the_sun_camera_that_are_none_are_refused(drawn, tmp_path, column, cell):
    def emptied(text):
        head, *rows = text.splitlines()
        place = head.split(",").index(column)
        cells = [row.split(",") for row in rows]
        return "\n".join([head, *(",".join([*c[:place], cell, *c[place + 1 :]]) for c in cells)]) + "\n"

    folder = edited(drawn, tmp_path, "sun_camera.csv", emptied)
    with pytest.raises(InputError, match=r"sun_camera.csv.*(no row has both angles|is not finite)"):
        run(load_tests(folder), Options("sun_camera"))


def test_a_log_without_events_is_refused(drawn, tmp_path):
    def emptied(text):
        head, *rows = text.splitlines()
        place = head.split(",").index("event")
        cells = [row.split(",") for row in rows]
        return "\n".join([head, *(",".join([*c[:place], "", *c[place + 1 :]]) for c in cells)]) + "\n"

    folder = edited(drawn, tmp_path, "control.csv", emptied)
    with pytest.raises(InputError, match="no row has an event"):
        run(load_tests(folder), Options("control"))


def test_pixels_as_metres_are_noticed(drawn, tmp_path):
    def enlarged(text):
        head, *rows = text.splitlines()
        cells = [row.split(",") for row in rows]
        return "\n".join([head, *(",".join([c[0], f"{400 + float(c[1])}", *c[2:]]) for c in cells)]) + "\n"

    folder = edited(drawn, tmp_path, "wind.csv", enlarged)
    with pytest.raises(InputError, match="a unit or an origin is wrong"):
        run(load_tests(folder), Options("wind"))


def test_rows_of_another_heliostat_are_refused(drawn, tmp_path):
    def named(text):
        head, *rows = text.splitlines()
        return (
            "\n".join([f"{head},heliostat", *(f"{row},{'AB12' if k else 'CD34'}" for k, row in enumerate(rows))]) + "\n"
        )

    folder = edited(drawn, tmp_path, "wind.csv", named)
    with pytest.raises(InputError, match=r"CD34.*another heliostat"):
        run(load_tests(folder), Options("wind"))


def test_gap_of_spectra_is_named(drawn):
    found = run(load_tests(drawn), Options("reflectance"))
    texts = [one.text for one in found.doubts if one.code == "spectrum_gap"]
    assert any("840 to 885 nm" in text for text in texts)


GIVEN = """key,value,sigma,label,method,date
sd_mrad,1.21,0.05,Slope deviation of the normals,star reflection,2025-02-11
soiling_percent,3.1,,,,
moon_d90_m,,,,photo of the moon,
"""


def given(folder, text):
    """Return the results of numbers that were measured elsewhere."""
    folder.mkdir(exist_ok=True)
    (folder / "given.csv").write_text(text)
    (folder / "measurement.toml").write_text(
        'kind = "heliostat-tests"\nname = "AB12"\ndate = 2026-06-25\n'
        '[heliostat]\nposition_m = [9.0, 52.0, 2.2]\n[given]\nfile = "given.csv"\n'
    )
    return run(load_tests(folder), Options("given"))


def test_numbers_measured_elsewhere_stand_on_the_sheet(tmp_path):
    found = given(tmp_path / "elsewhere", GIVEN)
    assert [(one.key, one.value, one.sigma, one.date) for one in found.entries] == [
        ("sd_rad", pytest.approx(1.21e-3), pytest.approx(0.05e-3), "2025-02-11"),
        ("soiling_share", pytest.approx(0.031), None, "2026-06-25"),
        ("moon_d90_m", None, None, "2026-06-25"),
    ]
    into_folder(tmp_path / "out", lambda: found, SilentProgress(), force=False, report=True)
    (sheet,) = make_sheets([tmp_path / "out"], SheetOptions(pdf=False)).sheets
    page = sheet_page(sheet, 0.95, printed=True)
    assert "Measured elsewhere</b> star reflection; 2025-02-11" in page
    assert "1.210 \u00b1 0.050 mrad" in page
    # What the first row says holds for the others only where they say nothing else.
    assert "soiling <small>method not stated; 2026-06-25</small>" in page


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("", "there is no row"),
        ("sd,1.2,0.1,star,\n", "must end with its unit"),
        ("sd_mrad,inf,0.1,star,\n", "value = inf is not finite"),
        ("sd_mrad,1.2,-0.1,star,\n", "sigma = -0.1: a positive number"),
        ("sd_mrad,1.2,0.1,star,11.02.2025\n", "a day such as"),
        ("sd_mrad,1.2,0.1,star,\nsd_urad,1300,100,star,\n", "sd_rad is given 2 times"),
    ],
)
def test_given_numbers_that_cannot_be_meant_are_refused(tmp_path, rows, said):
    with pytest.raises(InputError, match=said):
        given(tmp_path / "elsewhere", f"key,value,sigma,method,date\n{rows}")


def test_unknown_limit_is_listed_and_doubted(results, tmp_path):
    (tmp_path / "limits.toml").write_text("[day_beam_rmz_mrad]\nmost = 2.0\n")
    sheets = make_sheets([results], SheetOptions(limits=tmp_path / "limits.toml", pdf=False))
    (doubt,) = [one for one in sheets.doubts if one.code == "limit_without_entry"]
    assert "day_beam_rms_rad" in doubt.text
    (tmp_path / "limits.toml").write_text("[day_beam_rms]\nmost = 2.0\n")
    with pytest.raises(InputError, match="with its unit"):
        make_sheets([results], SheetOptions(limits=tmp_path / "limits.toml", pdf=False))


def test_two_commands(drawn, tmp_path):
    """From the folder to the sheet by the command line."""
    from calibration.heliostat.cli import app

    runner = CliRunner()
    first = runner.invoke(app, ["test", "backlash", str(drawn), "-o", str(tmp_path / "R"), "--no-report"])
    assert first.exit_code == 0, first.output
    second = runner.invoke(app, ["sheet", str(tmp_path / "R"), "-o", str(tmp_path / "S"), "--no-pdf"])
    assert second.exit_code == 0, second.output
    assert (tmp_path / "S" / "AB12.html").is_file()


def test_photos_of_beams_become_the_day(tmp_path):
    """Photos beside the tables: measured, and the day's offset is that of the drawn beams."""
    from heliogauge.images.photos import write_image

    folder = tmp_path / "AB12"
    photos = folder / "photos"
    photos.mkdir(parents=True)
    rng = np.random.default_rng(4)
    times = np.datetime64("2026-06-21T10:00", "s") + np.arange(8) * np.timedelta64(600, "s")
    x, y = np.meshgrid((np.arange(120) + 0.5) / 120 * 6 - 3, 3 - (np.arange(120) + 0.5) / 120 * 6)
    places = np.array([0.30, -0.20]) + rng.normal(0, 0.05, (8, 2))
    for number, (right, up) in enumerate(places):
        light = 20 + 180 * np.exp(-0.5 * ((x - right) ** 2 + (y - up) ** 2) / 0.5**2) + rng.normal(0, 1.5, x.shape)
        write_image(photos / f"beam_{number}.png", np.clip(light, 0, 255).astype(np.uint8))
    rows = [f"beam_{number}.png,{time}Z" for number, time in enumerate(times)]
    (photos / "photos.csv").write_text("\n".join(["image,time_utc", *rows]) + "\n")
    (photos / "measurement.toml").write_text(
        'kind = "beam"\nname = "AB12"\n[photos]\ntable = "photos.csv"\n[[target]]\nname = "white"\nwidth_m = 6.0\n'
        'height_m = 6.0\n[[images]]\ntarget = "white"\nwhole = "edge"\n'
    )
    (folder / "measurement.toml").write_text(
        'kind = "heliostat-tests"\nname = "AB12"\n[site]\nlatitude_deg = 37.09\nlongitude_deg = -2.36\n[heliostat]\n'
        "position_m = [0.0, 120.0, 4.0]\n[target]\ncenter_m = [0.0, 0.0, 40.0]\nfacing_azimuth_deg = 0.0\n"
        'sigma_aim_m = 0.001\n[day]\nfile = "photos"\n'
    )
    found = {one.key: one for one in run(load_tests(folder)).entries}
    scale = TestPlant(heliostat_m=(0.0, 120.0, 4.0)).angles(np.array([[0.01, 0.0]]))[0] / 0.01
    right = found["beam_mean_right_rad"]
    assert right.value == pytest.approx(places[:, 0].mean() * scale, abs=4 * right.sigma)
    assert right.sigma < 0.2e-3


def test_gear_slack_of_unam_by_the_command(tmp_path):
    """Stage-STE V-01 and V-02 (table 3): 14.0 +- 0.5 mrad; the frame there is x west, y south, azimuth from south."""
    folder = tmp_path / "unam"
    folder.mkdir()
    rows = [
        "pair,end,x_m,y_m,sun_azimuth_deg,sun_elevation_deg",
        f"1,1,-1.332,21.867,{180 - 77.420},{90 - 46.962}",
        f"1,2,0.915,20.900,{180 - 77.267},{90 - 46.766}",
    ]
    (folder / "spots.csv").write_text("\n".join(rows) + "\n")
    (folder / "measurement.toml").write_text(
        'kind = "heliostat-tests"\nname = "unam"\n[site]\nlatitude_deg = 29.03\nlongitude_deg = -110.96\n[heliostat]\n'
        "position_m = [-5.17, 122.0, -0.33]\n[target]\ncenter_m = [0.0, 0.0, 0.0]\nfacing_azimuth_deg = 0.0\n"
        'sigma_place_m = 0.0175\n[backlash]\nspots = "spots.csv"\n'
    )
    found = {one.key: one for one in run(load_tests(folder)).entries}
    play = found["azimuth_by_beams_axis_rad"]
    assert 1e3 * play.value == pytest.approx(14.0, abs=0.5)
    # Two places of 17.5 mm at 124 m, seen by a normal that rises 32 degrees.
    assert 1e3 * play.sigma == pytest.approx(0.5 * 17.5 / 124.2 * np.sqrt(2) / np.cos(np.radians(32)), rel=0.02)
