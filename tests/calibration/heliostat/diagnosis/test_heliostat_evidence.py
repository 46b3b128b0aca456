"""Numbers of another unit and bending that follows the angle look alike: which it is, is decided by probability."""

import numpy as np
import pytest

from calibration.heliostat.fitting.priors import with_priors
from calibration.heliostat.kinematic_model.presets import linear_actuators, with_drive_terms
from tests.calibration.heliostat.diagnosis.test_heliostat_diagnosis import POSITION, drawn, judged, seen
from tests.calibration.heliostat_models import ACTUATORS

SEEDS = range(5)


def _given():
    return with_priors(linear_actuators("L", POSITION, ACTUATORS))


def _other_strokes(rng):
    """A heliostat, and its description with strokes that differ by as much as those of other units at Juelich."""
    truth = drawn(_given(), rng)
    away = {f"initial_stroke_{axis}": rng.choice([-1, 1]) * rng.uniform(4e-3, 8e-3) for axis in (1, 2)}
    stated = {name: truth.parameters.value(name) + step for name, step in away.items()}
    return truth, _given().with_value(stated)


def _bent(rng):
    """A heliostat that bends about its second axis as no frame usually does, described rightly."""
    bent = with_drive_terms(drawn(_given(), rng), 1, ("sag",), sag_zero_rad=rng.uniform(0, 2 * np.pi))
    return bent.with_value({"sag_2": rng.uniform(15e-3, 30e-3)}), _given()


@pytest.mark.slow
@pytest.mark.parametrize(("made", "kind"), [(_other_strokes, "actuator_numbers"), (_bent, "sag")])
def test_numbers_of_others_and_bending_are_told_apart(made, kind):
    """Each is named by its kind; nothing is named as the other, and what is open holds the right one."""
    named = 0
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        truth, stated = made(rng)
        found = judged(seen(truth, rng, count=120), design=stated)
        assert set(found.kinds) <= {kind}, seed
        assert found.kinds or any(one.kind == kind for one in found.findings), seed
        named += kind in found.kinds
    assert named >= 4
