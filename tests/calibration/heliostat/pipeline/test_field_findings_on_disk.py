"""What several heliostats share becomes one finding of the field, also in their folders that were finished before."""

import csv
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.heliostat.keys import load_heliostat
from calibration.heliostat.pipeline import field
from calibration.heliostat.pipeline.field import FieldResult, run_into
from calibration.heliostat.pipeline.measure import Options
from heliogauge.results.json_file import read_json
from heliogauge.results.tables import read_table_csv, write_table_csv
from heliogauge.running.progress import SilentProgress
from tests.calibration.heliostat_folders import write_field

pytestmark = pytest.mark.slow

NAMES = ("H1", "H2", "H3")


def calibrated(folder: Path, late: tuple[str, ...]) -> FieldResult:
    """Calibrate three heliostats; the clock is an hour slow for some."""
    write_field(folder / "in", heliostats=len(NAMES), observations=60)
    file = folder / "in" / "observations.csv"
    table = read_table_csv(file)
    slow = np.timedelta64(1, "h")
    table["time_utc"] = [
        f"{np.datetime64(time.removesuffix('Z'), 'ms') - slow}Z" if name in late else time
        for name, time in zip(table["heliostat"], table["time_utc"], strict=True)
    ]
    write_table_csv(file, table)
    return again(folder)


def again(folder: Path) -> FieldResult:
    options = Options(thorough=False, jobs=1)
    return run_into(load_heliostat(folder / "in"), folder / "out", options, SilentProgress(), force=False, report=False)


def contents(folder: Path) -> dict[str, dict[str, Any]]:
    """Return all that is written of each heliostat, by file."""
    files = ("heliostat.json", "heliostat_as_stated.json", "summary.json")
    return {
        f"{name}/{file}": read_json(folder / "out" / name / file)
        for name in NAMES
        for file in files
        if (folder / "out" / name / file).is_file()
    }


def rows(folder: Path) -> dict[str, dict[str, str]]:
    with (folder / "out" / "field.csv").open(encoding="utf-8", newline="") as file:
        return {row.pop("heliostat"): row for row in csv.DictReader(file)}


def test_a_clock_that_is_wrong_for_all_is_written_into_each_folder(tmp_path: Path) -> None:
    """One finding of the field: no heliostat is faulty for it, each folder says so, the undone model stays first."""
    calibrated(tmp_path, NAMES)
    said = [one for one in read_json(tmp_path / "out" / "summary.json")["doubts"] if one["code"] == "field_finding"]
    assert len(said) == 1
    # The sky is turned about the pole, right to 0.3 mrad an hour: 5 s.
    clock = re.match(r"The clock: \+(\d+) s have to be added", said[0]["text"])
    assert clock is not None
    assert abs(int(clock.group(1)) - 3600) <= 10
    assert "for 3 heliostats (H1, H2, H3)" in said[0]["text"]
    for name, row in rows(tmp_path).items():
        assert (name, row["diagnosis"]) == (name, "time_offset")
        assert row["status"] != "faulty"
        assert "The same is wrong for 2 other heliostats" in row["reason"]
    written = contents(tmp_path)
    assert len(written) == 9
    for name, content in written.items():
        text = content["doubts"][0]["text"]
        assert (name, content["doubts"][0]["code"]) == (name, "time_offset")
        assert "The same is wrong for 2 other heliostats: a finding of the field" in text
        for finding in content.get("diagnosis", {}).get("findings", [])[:1]:
            assert (finding["kind"], finding["severity"]) == ("time_offset", "field")
            assert finding["text"].removesuffix(".") in text
    # Models stay as they were: the clock is undone in the first, and stands in the other.
    for name in NAMES:
        sound, stated = (written[f"{name}/{file}.json"] for file in ("heliostat", "heliostat_as_stated"))
        assert (sound["remedy"]["applied"], stated["remedy"]["applied"]) == (True, False)


def test_a_run_that_was_killed_while_it_compared_ends_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Folders that were written anew already are written anew again, and read as those of a run in one go."""
    calibrated(tmp_path / "whole", NAMES)
    with monkeypatch.context() as patch:
        patch.setattr(field, "write_field", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            calibrated(tmp_path / "killed", NAMES)
    killed = contents(tmp_path / "killed")
    assert again(tmp_path / "killed").resumed == len(NAMES)
    assert contents(tmp_path / "killed") == killed
    done, whole = rows(tmp_path / "killed"), rows(tmp_path / "whole")
    for name in NAMES:
        assert {key: done[name][key] for key in done[name] if key != "duration_s"} == {
            key: whole[name][key] for key in whole[name] if key != "duration_s"
        }


def test_a_clock_that_is_wrong_for_one_stays_its_fault(tmp_path: Path) -> None:
    """Others say nothing against it: its own controller may have the wrong time."""
    calibrated(tmp_path, NAMES[:1])
    table = rows(tmp_path)
    assert {name: row["diagnosis"] for name, row in table.items()} == {"H1": "time_offset", "H2": "", "H3": ""}
    assert table["H1"]["status"] == "faulty"
    assert "other heliostats" not in table["H1"]["reason"]
    (finding, *_) = contents(tmp_path)["H1/heliostat.json"]["diagnosis"]["findings"]
    assert finding["severity"] == "fault"
