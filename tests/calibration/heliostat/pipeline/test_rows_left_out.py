"""Rows that are left out are counted by reason: on the terminal, in summary and table, on the page."""

import csv
import json

import pytest

from calibration.heliostat.keys import load_heliostat
from calibration.heliostat.pipeline.field import run_into
from calibration.heliostat.pipeline.measure import Options
from data_synth.heliostats.dataset import HeliostatOptions, write_heliostat_dataset
from data_synth.heliostats.presets import HeliostatChoice, heliostat_scene
from heliogauge.results.folder import read_summary, read_table_csv


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return two heliostats; of the first two rows are of the night and one has its spot a metre aside."""
    place = tmp_path_factory.mktemp("left_out") / "field"
    scene = heliostat_scene("small", HeliostatChoice(2, 2, 60))
    write_heliostat_dataset(place, scene, HeliostatOptions(2))
    with (place / "observations.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows[3:5]:
        row["time_utc"] = f"{row['time_utc'][:11]}23:30:00.000Z"
    rows[20]["x_m"] = str(float(rows[20]["x_m"]) + 1.0)
    with (place / "observations.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return place


def test_of_a_single_heliostat(folder, tmp_path):
    options = Options(only="H01", thorough=False, jobs=1)
    result = run_into(load_heliostat(folder), tmp_path / "out", options, report=True)
    said = "3 left out: 2 sun, 1 outlier"
    assert f" observations ({said}), model" in result.headline()
    assert read_summary(tmp_path / "out").texts["left_out"] == said
    assert f"observations used; {said}" in (tmp_path / "out" / "report.html").read_text()


def test_of_a_field(folder, tmp_path):
    result = run_into(load_heliostat(folder), tmp_path / "out", Options(thorough=False, jobs=1), report=True)
    assert "(3 left out: 2 sun, 1 outlier)" in result.headline()
    table = read_table_csv(tmp_path / "out" / "field.csv", ("heliostat", "left_out"))
    assert dict(zip(table["heliostat"], table["left_out"], strict=True)) == {
        "H01": "3 left out: 2 sun, 1 outlier",
        "H02": "",
    }
    numbers = json.loads((tmp_path / "out" / "summary.json").read_text())["numbers"]
    assert numbers["left_out_count"] == 3
    assert numbers["observations_count"] == len((folder / "observations.csv").read_text().splitlines()) - 1
