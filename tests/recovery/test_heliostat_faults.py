"""Every fault that a synthetic field can have, from its files to the name in field.csv."""

import csv

import pytest

from calibration.heliostat import Options
from calibration.heliostat.keys import load_heliostat
from calibration.heliostat.pipeline.field import run_into
from data_synth.heliostats.dataset import write_heliostat_dataset
from data_synth.heliostats.faults import FAULTS
from data_synth.heliostats.presets import HeliostatChoice, heliostat_scene
from heliogauge.running.progress import SilentProgress

NAMES = {
    "wrong-actuator": "actuator_numbers",
    "moved": "position",
    "change-point": "change_point",
    "drift": "drift",
    "backlash": "backlash",
    "outliers": "outliers",
    "wrong-target": "wrong_target",
    "south-azimuth": "sun_convention",
    "local-time": "time_offset",
    "stuck-reading": "constant_column",
    "duplicates": "duplicates",
    "few": "too_few",
}


def named(folder, seed, heliostats):
    """Calibrate a field in which a dozen heliostats have a fault each; return what is said of each, and its fault."""
    scene = heliostat_scene("faulty", HeliostatChoice(seed=seed, heliostats=heliostats))
    write_heliostat_dataset(folder / "in", scene)
    options = Options(thorough=False, jobs=1)
    run_into(load_heliostat(folder / "in"), folder / "out", options, SilentProgress(), force=False, report=False)
    with (folder / "out" / "field.csv").open(encoding="utf-8", newline="") as file:
        said = {row["heliostat"]: row["diagnosis"] for row in csv.DictReader(file)}
    return said, {unit.true.name: unit.faults for unit in scene.units}


@pytest.mark.slow
def test_each_fault_is_named_and_no_healthy_heliostat(tmp_path):
    """Twelve faults, each by its kind; twelve healthy heliostats without any."""
    assert set(NAMES) == set(FAULTS)
    said, faults = named(tmp_path, 0, 24)
    assert said == {name: ", ".join(NAMES[fault] for fault in own) for name, own in faults.items()}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5])
def test_each_fault_in_other_fields(tmp_path, seed):
    """Other draws: a tenth of a heliostat's spots can be a few that were hardly wrong, and is no other kind then."""
    said, faults = named(tmp_path, seed, 30)
    for name, own in faults.items():
        wanted = {NAMES[fault] for fault in own}
        found = set(said[name].split(", ")) - {""}
        assert found == wanted or (wanted == {"outliers"} and not found), name
