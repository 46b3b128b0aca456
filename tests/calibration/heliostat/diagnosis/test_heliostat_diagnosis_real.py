"""Diagnosis of the seven real heliostats: the one with another unit's actuators is named, no other is accused."""

import pytest

from calibration.heliostat.diagnosis.full_diagnosis import diagnose
from calibration.heliostat.fitting.fit_result import FitOptions
from calibration.heliostat.fitting.robust_fit import fit
from calibration.heliostat.keys import load_heliostat
from calibration.heliostat.pipeline.measure import Options, run
from tests.calibration.juelich import FAULTY, FOLDER, SOUND, heliostat

pytestmark = pytest.mark.skipif(
    not FOLDER.is_dir(), reason="real calibration data (../shared/data/csp) are not on this machine"
)


@pytest.mark.parametrize("name", SOUND)
def test_sound_ones_are_not_accused(name):
    """What a rigid model leaves of a real heliostat, about 1 mrad, is no fault, with few parameters or with many."""
    design, observations = heliostat(name)
    for free in ("4", "15"):
        found = fit(design.with_free(free), observations, FitOptions(sigma="estimated"))
        assert diagnose(found).kinds == ()


@pytest.mark.slow
def test_faulty_one_is_named():
    """The wrong unit's triangle does not close at 20 readings; with other numbers it would fit."""
    design, observations = heliostat(FAULTY)
    found = fit(design.with_free("4"), observations, FitOptions(sigma="estimated"))
    (finding,) = diagnose(found).faults
    assert finding.kind == "actuator_numbers"
    assert (finding.evidence["readings_beyond_count"], finding.evidence["readings_count"]) == (20, len(observations))
    assert len(finding.rows) == 20
    assert finding.evidence["median_after_mrad"] < 5 < 100 < finding.evidence["median_before_mrad"]


@pytest.mark.slow
@pytest.mark.parametrize("model", ["auto", "8", "15"])
def test_only_the_faulty_one_is_named_by_the_command(model):
    """From the folder, with names of targets and times."""
    result = run(load_heliostat(FOLDER), Options(model=model, thorough=False, jobs=1))
    kinds = {one.name: one.diagnosis.kinds for one in result.heliostats}
    assert set(kinds.pop(FAULTY)) == {"actuator_numbers"}
    assert kinds == dict.fromkeys(SOUND, ())
