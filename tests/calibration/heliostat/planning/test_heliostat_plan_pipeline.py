"""`heliogauge heliostat plan`: from results to tables of measurements and slots."""

import dataclasses
import datetime
import json

import numpy as np
import pytest
import typer

from calibration.heliostat.cli import app
from calibration.heliostat.keys import load_heliostat
from calibration.heliostat.pipeline.field import run_into
from calibration.heliostat.pipeline.measure import Options as CalibrationOptions
from calibration.heliostat.planning.plan import NextOptions, run
from heliogauge.errors import InputError
from heliogauge.results.tables import read_table_csv
from heliogauge.running.progress import SilentProgress
from tests.calibration.heliostat_folders import write_field

FIRST = datetime.date(2026, 3, 2)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Return results of three heliostats, one of them with few observations."""
    folder = tmp_path_factory.mktemp("field")
    write_field(folder / "in", heliostats=3, observations=24)
    lines = (folder / "in" / "observations.csv").read_text().splitlines()
    kept = [line for i, line in enumerate(lines) if not line.startswith("H2,") or i % 8 == 0]
    (folder / "in" / "observations.csv").write_text("\n".join(kept) + "\n")
    options = CalibrationOptions(thorough=False, jobs=1)
    run_into(load_heliostat(folder / "in"), folder / "out", options, SilentProgress(), force=False, report=False)
    return folder / "out"


def test_tables(results, tmp_path):
    """Each heliostat has a line, its measurements a row each, all slots are within the days and apart."""
    said = run(results, tmp_path / "plan", NextOptions(FIRST, days=5, goal_rad=2e-4, slot_minutes=10.0))
    assert len(said) == 4
    needs = read_table_csv(tmp_path / "plan" / "heliostats.csv")
    assert sorted(needs["heliostat"]) == ["H1", "H2", "H3"]
    rows = read_table_csv(tmp_path / "plan" / "measurements.csv")
    for name, planned, now, then in zip(
        needs["heliostat"],
        needs["measurements_planned"],
        needs["sigma_beam_now_mrad"],
        needs["sigma_beam_then_mrad"],
        strict=True,
    ):
        own = [float(x) for x, who in zip(rows["sigma_beam_mrad"], rows["heliostat"], strict=True) if who == name]
        assert len(own) == int(planned)
        assert (np.diff([float(now), *own]) < 0).all()
        assert [float(then)] == ([*own][-1:] or [float(now)])
    slots = read_table_csv(tmp_path / "plan" / "schedule.csv")
    assert len({*zip(slots["time_utc"], slots["target"], strict=True)}) == len(slots["time_utc"]) > 0
    assert all("2026-03-02" <= time[:10] <= "2026-03-06" for time in slots["time_utc"])
    assert all(float(height) > 10 for height in slots["sun_elevation_deg"])
    content = json.loads((tmp_path / "plan" / "plan.json").read_text())
    assert content["beams_scheduled"] == len(slots["time_utc"])
    worst = max(needs["sigma_beam_now_mrad"], key=float)
    assert needs["heliostat"][needs["sigma_beam_now_mrad"].index(worst)] == "H2"


def test_wrong_choices(results, tmp_path):
    """No target of that name, too many days, no results, a plan that is there already."""
    with pytest.raises(InputError, match="target=nowhere"):
        run(results, tmp_path / "a", NextOptions(FIRST, target="nowhere"))
    with pytest.raises(InputError, match="days=0"):
        NextOptions(FIRST, days=0)
    with pytest.raises(InputError, match=r"heliostat\.json"):
        run(tmp_path, tmp_path / "b", NextOptions(FIRST))
    run(results, tmp_path / "c", NextOptions(FIRST, days=1, slot_minutes=60.0))
    with pytest.raises(InputError, match="force"):
        run(results, tmp_path / "c", NextOptions(FIRST, days=1, slot_minutes=60.0))


def test_flags_are_options():
    """Flags and options agree in name and default, up to the unit."""
    parameters = typer.main.get_command(app).commands["plan"].params
    flags = {one.name: one.default for one in parameters}
    options = {field.name: field.default for field in dataclasses.fields(NextOptions)}
    scaled = {"goal_mrad": ("goal_rad", 1e-3), "sigma_mm": ("sigma_m", 1e-3)}
    for name, default in flags.items():
        if name not in ("folder", "out", "as_json", "quiet", "verbose"):
            field, factor = scaled.get(name, (name, 1))
            assert options[field] == pytest.approx(default * factor if factor != 1 else default), name
            options.pop(field)
    assert options == {}
