"""All of the newest rows are rejected: something changed, with its date; and rows that are left out are all counted."""

import json
import shutil

import numpy as np
import pytest

from calibration.heliostat.diagnosis.full_diagnosis import diagnose
from calibration.heliostat.diagnosis.rows import newest_finding, outlier_finding
from calibration.heliostat.fitting.robust_fit import fit
from calibration.heliostat.keys import load_heliostat
from calibration.heliostat.pipeline.field import run_into
from calibration.heliostat.pipeline.measure import Options
from heliogauge.results.tables import read_table_csv
from tests.calibration.heliostat.diagnosis.test_heliostat_diagnosis import changed, drawn, nominal, seen, times_of
from tests.calibration.juelich import FAULTY, SOUND


@pytest.fixture
def found():
    """Return the fit of a healthy heliostat."""
    rng = np.random.default_rng(5)
    return fit(nominal(), seen(drawn(nominal(), rng), rng))


class TestNewest:
    @pytest.mark.parametrize(("count", "is_found"), [(4, False), (5, True), (14, True)])
    def test_five_of_the_newest_are_enough(self, found, count, is_found):
        rows = np.zeros(72, dtype=bool)
        rows[-count:] = True
        finding = newest_finding(found, rows)
        assert (finding is not None) is is_found

    def test_it_has_the_days_between_which_it_changed_and_all_rows_since(self, found):
        rows = np.zeros(72, dtype=bool)
        rows[-14:] = True
        # An older one of its own is no part of it.
        rows[10] = True
        finding = newest_finding(found, rows)
        times = times_of(72).astype("datetime64[D]")
        assert (finding.kind, finding.severity) == ("change_point", "fault")
        assert finding.rows == tuple(range(58, 72))
        assert finding.dates == (str(times[57]), str(times[58]))
        assert finding.chance < 1e-15
        assert "all 14 rows since then, the newest of 72" in finding.text

    def test_one_newer_row_that_agrees_ends_it(self, found):
        rows = np.zeros(72, dtype=bool)
        rows[-14:-1] = True
        assert newest_finding(found, rows) is None

    def test_rows_without_a_time_are_neither_newest_nor_older(self):
        rng = np.random.default_rng(5)
        observations = seen(drawn(nominal(), rng), rng)
        times = times_of(72).copy()
        times[-20:-14] = "NaT"
        pointings = observations.groups[0].pointings
        other = changed(observations, pointings=type(pointings)(pointings.readings, time=times))
        rows = np.zeros(72, dtype=bool)
        rows[-14:] = True
        assert newest_finding(fit(nominal(), other), rows).dates[0] == str(times[51].astype("datetime64[D]"))


def test_rows_beside_a_hint_are_counted_and_accuse_nobody(found):
    rows = np.zeros(72, dtype=bool)
    rows[20:34] = True
    accusing = rows.copy()
    accusing[20:31] = False
    finding = outlier_finding(found, rows, ("",) * 72, (), accusing)
    assert finding.text.startswith("14 of 72 rows contradict the others")
    assert (finding.severity, len(finding.rows)) == ("rows", 14)
    assert outlier_finding(found, rows, ("",) * 72, (), rows).severity == "fault"


def shifted(source, folder, name, counts, rows=14):
    """Copy a real heliostat, with the second axis of its newest rows off by so many counts."""
    for part in ("tower", name):
        shutil.copytree(source / part, folder / part, dirs_exist_ok=True)
    shutil.copy(source / "timestamps.json", folder)
    times = json.loads((source / "timestamps.json").read_text(encoding="utf-8"))
    known = [
        (time, file)
        for file in (folder / name / "calibration").glob("*.json")
        if (time := times.get(f"{name}_{file.stem.split('_')[0]}"))
    ]
    for _, file in sorted(known)[-rows:]:
        content = json.loads(file.read_text(encoding="utf-8"))
        content["motor_position"]["axis_2_motor_position"] += counts
        file.write_text(json.dumps(content), encoding="utf-8")
    return sorted(known)[-rows][0]


@pytest.mark.parametrize("counts", [300, 600])
def test_a_jump_of_a_real_heliostat_is_a_fault_on_terminal_table_and_page(tmp_path, shared_data, counts):
    """12 and 24 mrad; a spread over months that no term of time explains, and a smaller one that bends the fit."""
    source = shared_data / "csp" / "juelich_calibration"
    date = shifted(source, tmp_path / "field", "BH36", counts)[:10]
    shifted(source, tmp_path / "field", "BH35", 0)
    result = run_into(
        load_heliostat(tmp_path / "field"), tmp_path / "out", Options(thorough=False, jobs=1), report=True
    )
    table = read_table_csv(tmp_path / "out" / "field.csv", ("heliostat", "status", "diagnosis", "bad_row_dates"))
    rows = {name: k for k, name in enumerate(table["heliostat"])}
    jumped, sound = rows["BH36"], rows["BH35"]
    assert (table["status"][sound], table["diagnosis"][sound]) == ("ok", "")
    assert (table["status"][jumped], table["diagnosis"][jumped]) == ("faulty", "change_point")
    assert date in table["bad_row_dates"][jumped]
    assert "BH36 (change point): 124 of 138 observations" in result.headline()
    said = next(one.text for one in result.doubts if one.code == "heliostat_faulty")
    assert f"and {date} something changed: all 14 rows since then" in said
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert f"{date}): Calibrate with the rows after the change only" in page


@pytest.mark.slow
def test_no_run_of_rows_of_a_sound_heliostat_is_such_a_jump(shared_data):
    """Every fifth row the newest one: 24 to 177 rows of each of the six."""
    from calibration.heliostat.pipeline.measure import run

    folder = shared_data / "csp" / "juelich_calibration"
    result = run(load_heliostat(folder), Options(model="4", thorough=False, jobs=1))
    looked = 0
    for one in (one for one in result.heliostats if one.name != FAULTY):
        observations = one.fit.observations
        order = np.argsort(observations.time, kind="stable")
        order = order[~np.isnat(observations.time[order])]
        for count in range(24, order.size + 1, 5):
            part = np.zeros(len(observations), dtype=bool)
            part[order[:count]] = True
            diagnosis = diagnose(fit(one.fit.nominal, observations.select(part)), site=result.shared.plant.site)
            assert "change_point" not in diagnosis.kinds, (one.name, count)
            looked += 1
    assert looked > 20 * len(SOUND)
