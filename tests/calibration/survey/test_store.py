"""Results go into a store once, and come back as trends, changes and the worst."""

import numpy as np
import pytest
from typer.testing import CliRunner

from heliogauge.errors import InputError
from heliogauge.results.folder import Summary, read_table_csv, write_summary, write_table_csv

pytest.importorskip("duckdb")

from calibration.survey.cli import app
from calibration.survey.files.parquet_store import query
from calibration.survey.pipeline.add import AddOptions, add
from calibration.survey.pipeline.judge_store import SurveyOptions, run
from calibration.survey.pipeline.keep_store import add_event
from calibration.survey.report.sections import first_screen, open_survey, worst_tables


def write_result(folder, name, date, numbers, facets=None):
    folder.mkdir(parents=True)
    write_summary(folder / "summary.json", Summary("deflectometry", name, numbers, {"date": date}, facets=facets or {}))
    return folder


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """Twenty mirrors over a year: SD, reflectance that falls until it is cleaned, facets."""
    place = tmp_path_factory.mktemp("results")
    rng = np.random.default_rng(0)
    for number in range(20):
        for month in range(1, 13):
            dirt = 0.004 * ((month - 1) % 6)
            numbers = {
                "sd_rad": 1e-3 * (1 + 0.05 * number) + rng.normal(0, 2e-5),
                "sigma_sd_rad": 2e-5,
                "reflectance_share": 0.95 - dirt + rng.normal(0, 0.001),
                "sigma_reflectance_share": 0.001,
                "photos_count": 12,
            }
            facets = {"upper": {"canting_x_rad": rng.normal(3e-4, 1e-5), "sigma_canting_x_rad": 1e-5}}
            write_result(
                place / f"H{number:02d}_{month:02d}", f"H{number:02d}", f"2026-{month:02d}-15", numbers, facets
            )
    return place


@pytest.fixture(scope="module")
def store(drawn, tmp_path_factory):
    store = tmp_path_factory.mktemp("store") / "plant"
    assert add([drawn], store).results == 240
    add_event(store, "H*", "2026-07-01", "cleaned")
    return store


def test_each_result_once(drawn, store):
    again = add([drawn], store)
    assert again.results == 0
    assert len(again.known) == 240


def test_trends_worst_and_cleaning(store, tmp_path):
    result = run(store)
    result.write(tmp_path)
    worst = read_table_csv(tmp_path / "worst.csv")
    ranks = [s for q, s in zip(worst["quantity"], worst["subject"], strict=True) if q == "sd_rad"]
    assert ranks[:2] == ["H19", "H18"]
    events = read_table_csv(tmp_path / "events.csv")
    rows = [row for row, one in enumerate(events["quantity"]) if one == "reflectance_share"]
    assert len(rows) == 20
    # Dirt of the months before and after cleaning is alike, 0.010 in the mean: no change of the means.
    change, sigma = (np.array([float(events[key][row]) for row in rows]) for key in ("change", "sigma_change"))
    assert np.abs(change.mean()) < 3 * sigma.mean() / np.sqrt(20)
    parts = {(q, p) for q, p in zip(events["quantity"], events["part"], strict=True)}
    assert ("canting_x_rad", "upper") in parts
    assert result.counts == {"subjects": 20, "results": 240, "rows": 240 * 4}


def test_all_quantities_are_reported_and_errors_first(tmp_path):
    """Many neutral numbers whose names come early: none is cut off, and none is called the worst."""
    neutral = [f"{letter}_place_m" for letter in "abcdefghijklmnopqrst"] + ["curvature_x_per_m", "focal_length_x_m"]
    errors = {"sd_rad": 1e-3, "sdy_rad": 8e-4, "tracking_rms_rad": 6e-4}
    for number, subject in enumerate("AB"):
        values = dict.fromkeys(neutral, 2.0 + number) | {name: (1 + number) * one for name, one in errors.items()}
        values["reflectance_share"] = 0.9 + 0.01 * number
        sigmas = {f"sigma_{name}": 1e-5 for name in values}
        write_result(tmp_path / "all" / subject, subject, "2026-05-01", values | sigmas)
    add([tmp_path / "all"], tmp_path / "store")
    result = run(tmp_path / "store")
    (tmp_path / "out").mkdir()
    result.write(tmp_path / "out")
    for name in ("trends", "worst", "history"):
        assert set(read_table_csv(tmp_path / "out" / f"{name}.csv")["quantity"]) == {*values}, name
    worst = read_table_csv(tmp_path / "out" / "worst.csv")
    first = {quantity: row for row, quantity in reversed([*enumerate(worst["quantity"])])}
    assert list(dict.fromkeys(worst["quantity"]))[:4] == ["sd_rad", "reflectance_share", "tracking_rms_rad", "sdy_rad"]
    assert [worst["worse"][first[one]] for one in ("sd_rad", "reflectance_share", "a_place_m")] == [
        *("larger", "smaller", "")
    ]
    assert [worst["subject"][first[one]] for one in ("sd_rad", "reflectance_share")] == ["B", "A"]
    shown = first_screen(open_survey(tmp_path / "out"))._repr_html_()
    assert "Worst sd<" in shown
    assert "Worst reflectance share<" in shown
    for word in ("curvature", "place", "focal", "Largest"):
        assert word not in shown.split("<svg")[0], word
    assert "Largest curvature x" in worst_tables(open_survey(tmp_path / "out"))._repr_html_()
    assert "sd_rad: worst B, 2.000" in result.headline()
    assert "place" not in result.headline()
    assert "worst.csv has all 26 quantities" in result.headline()


def test_a_quantity_without_worse_is_the_largest(tmp_path):
    write_result(tmp_path / "A", "A", "2026-05-01", {"curvature_x_per_m": 0.05, "sigma_curvature_x_per_m": 1e-4})
    add([tmp_path / "A"], tmp_path / "store")
    result = run(tmp_path / "store")
    (tmp_path / "out").mkdir()
    result.write(tmp_path / "out")
    assert "Largest curvature x<" in first_screen(open_survey(tmp_path / "out"))._repr_html_()
    assert "curvature_x_per_m: largest A" in result.headline()


def test_days_and_quantities_are_chosen(store):
    half = run(store, SurveyOptions(quantities=("reflectance_share",), since="2026-01-01", until="2026-07-01"))
    slope = np.array(half.trends["slope_per_year"])
    # 0.004 each month.
    assert slope.mean() == pytest.approx(-0.048, abs=0.003)
    assert set(half.trends["quantity"]) == {"reflectance_share"}
    with pytest.raises(InputError, match="did you mean reflectance_share"):
        run(store, SurveyOptions(quantities=("reflectance_shar",)))
    with pytest.raises(InputError, match="such as 2026-06-21"):
        run(store, SurveyOptions(since="yesterday"))


def test_values_are_stored_as_they_were(drawn, store):
    with query(store) as connection:
        ((value, sigma),) = connection.execute(
            "SELECT value, sigma FROM rows WHERE subject = 'H03' AND quantity = 'sd_rad' AND time = TIMESTAMP "
            "'2026-04-15'"
        ).fetchall()
    from heliogauge.results.folder import read_summary

    numbers = read_summary(drawn / "H03_04").numbers
    assert (value, sigma) == (numbers["sd_rad"], numbers["sigma_sd_rad"])


def test_rows_of_beams_by_time(tmp_path):
    folder = write_result(tmp_path / "beams", "H01", "2026-05-01", {"beams_count": 2})
    columns = {"time_utc": ["2026-05-01T10:00:00Z", ""], "x_m": [0.5, 0.6], "sigma_x_m": [0.02, 0.02]}
    write_table_csv(folder / "beams.csv", columns)
    add([folder], tmp_path / "store")
    with query(tmp_path / "store") as connection:
        rows = connection.execute("SELECT quantity, value, sigma FROM rows WHERE quantity = 'beams_x_m'").fetchall()
    assert rows == [("beams_x_m", 0.5, 0.02)]


def test_what_cannot_be_meant(tmp_path):
    folder = tmp_path / "result"
    folder.mkdir()
    write_summary(folder / "summary.json", Summary("deflectometry", "H01", {"sd_rad": 1e-3}))
    with pytest.raises(InputError, match="says no date"):
        add([folder], tmp_path / "store")
    assert add([folder], tmp_path / "store", AddOptions(date="2026-01-01")).rows == 1
    with pytest.raises(InputError, match="no store"):
        run(tmp_path / "elsewhere")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").write_text("x")
    with pytest.raises(InputError, match="holds files but is no store"):
        add([folder], tmp_path / "other", AddOptions(date="2026-01-01"))
    with pytest.raises(InputError, match="no results"):
        add([tmp_path / "other"], tmp_path / "store")


def test_commands(drawn, tmp_path):
    runner, store = CliRunner(), tmp_path / "store"
    done = runner.invoke(app, ["add", str(drawn / "H01_01"), "--to", str(store)])
    assert done.exit_code == 0, done.output
    assert done.stdout.startswith("1 result, ")
    done = runner.invoke(app, ["report", str(store), "-o", str(tmp_path / "out"), "--no-report"])
    assert done.exit_code == 0, done.output
    assert (tmp_path / "out" / "trends.csv").is_file()


def test_beams_of_one_day_are_one_result(tmp_path):
    """A motion that remembers, without any change: changes between days scatter as their sigmas say."""
    rng = np.random.default_rng(3)
    for number in range(60):
        folder = write_result(tmp_path / "all" / f"H{number:02d}", f"H{number:02d}", "2026-06-01", {"beams_count": 1})
        times, values = [], []
        for day in range(1, 7):
            motion = rng.normal(0, 0.1)
            for minute in range(0, 300, 5):
                motion = 0.8 * motion + 0.06 * rng.normal()
                times.append(f"2026-06-{day:02d}T{8 + minute // 60:02d}:{minute % 60:02d}:00Z")
                values.append(motion)
        table = {"time_utc": times, "x_m": values, "sigma_x_m": [0.01] * len(values)}
        write_table_csv(folder / "beams.csv", table)
    add([tmp_path / "all"], tmp_path / "store")
    add_event(tmp_path / "store", "*", "2026-06-04", "cleaned")
    found = run(tmp_path / "store", SurveyOptions(quantities=("beams_x_m",)))
    assert set(found.trends["results_count"]) == {6}
    likely = np.array(found.events["chance_of_none"])
    assert likely.size == 60
    # Each beam on its own would be called certain in most heliostats.
    assert np.mean(likely < 0.05) < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 60)
    scores = np.array(found.events["change"]) / np.array(found.events["sigma_change"])
    assert 0.4 < np.mean(scores**2) < 2.0


def test_the_same_result_under_another_date_or_subject(tmp_path):
    """Its numbers are the same: nothing else is said of them; without a date it is known by its summary."""
    folder, store, runner = tmp_path / "facet", str(tmp_path / "store"), CliRunner()
    folder.mkdir()
    numbers = {"sd_rad": 1e-3, "sigma_sd_rad": 1e-5, "photos_count": 12}
    write_summary(folder / "summary.json", Summary("deflectometry", "A", numbers, input_sha256={"a.png": "1" * 64}))

    def said(*more):
        done = runner.invoke(app, ["add", str(folder), "-o", store, *more])
        assert done.exit_code == 0, done.output
        return done

    assert said("--date", "2026-05-01", "--subject", "C").stdout.startswith("1 result, 2 rows added")
    assert "1 known already" in said().stdout
    for more in (("--date", "2026-06-01"), ("--subject", "B")):
        done = said(*more)
        assert "with the same numbers, under C, 2026-05-01" in done.stderr
        assert "1 in the store under another subject or date" in done.stdout
        assert "other numbers" not in done.output
    # Evaluated again, with other numbers.
    numbers["sd_rad"] = 2e-3
    write_summary(folder / "summary.json", Summary("deflectometry", "A", numbers, input_sha256={"a.png": "1" * 64}))
    assert "1 in the store with other numbers" in said("--date", "2026-05-01", "--subject", "C").stdout
    refused = runner.invoke(app, ["add", str(folder), "-o", store])
    assert isinstance(refused.exception, InputError)
    assert "says no date" in str(refused.exception)
    assert said("--date", "2026-06-01", "--subject", "C", "--force").stdout.startswith("1 result, 2 rows added")
    done = runner.invoke(app, ["check", store])
    assert "1 result, 2 rows, 1 file, 0 events" in done.stdout


def test_an_event_of_nobody_is_said(store):
    runner = CliRunner()
    noted = ["--date", "2026-08-01", "--what", "looked at"]
    done = runner.invoke(app, ["event", str(store), "--subject", "zzz*", *noted])
    assert done.exit_code == 0
    assert "no subject of" in done.stderr
    assert "'zzz*'" in done.stderr
    assert "H00" in done.stderr
    done = runner.invoke(app, ["event", str(store), "--subject", "H0*", *noted, "--json"])
    assert done.stderr == ""
    assert '"subjects_count": 10' in done.stdout


def test_an_event_is_noted_in_a_store_that_is_damaged(tmp_path):
    add([write_result(tmp_path / "A", "A", "2026-05-01", {"sd_rad": 1e-3})], tmp_path / "store")
    (file,) = (tmp_path / "store" / "rows").iterdir()
    file.write_bytes(b"")
    noted = ["--date", "2026-08-01", "--what", "looked at", "--subject", "A", "--json"]
    done = CliRunner().invoke(app, ["event", str(tmp_path / "store"), *noted])
    assert done.exit_code == 0, done.output
    assert "warning: noted, but whether a result is of 'A' cannot be told" in done.stderr
    assert '"subjects_count": null' in done.stdout
