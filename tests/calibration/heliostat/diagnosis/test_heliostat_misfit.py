"""Smooth errors of sound heliostats: the chance of a term's gain, by simulation."""

import numpy as np
import pytest

from calibration.heliostat.diagnosis.findings import REMEDIES, Finding
from calibration.heliostat.diagnosis.misfit import GAINS, chance_in_sound, criterion, effective_components


@pytest.mark.parametrize(("kind", "freedom"), [("sag", 2), ("drift", 5), ("backlash", 1)])
@pytest.mark.parametrize("misfit", [0.0, 1.0])
def test_chance_is_that_of_drawn_gains(kind, freedom, misfit):
    """Gains drawn as sound heliostats have them fall below a chance as often as it says, within 4 sigma of 20,000."""
    rng, spare, count = np.random.default_rng(4), 200.0, 20_000
    sound = GAINS["time" if kind == "drift" else "approach" if kind == "backlash" else "smooth"]
    known = spare if misfit == 0 else min(sound.freedom, spare)
    mean = 1 / spare + misfit * sound.mean
    gains = mean * rng.chisquare(freedom, count) / (rng.chisquare(known, count) / known)
    chances = np.array(
        [chance_in_sound(kind, gain, freedom, spare=spare, looks=1, misfit=misfit) for gain in gains.tolist()]
    )
    for level in (0.5, 0.1, 0.01):
        assert abs((chances < level).mean() - level) < 4 * np.sqrt(level * (1 - level) / count)


def test_smooth_errors_pass_for_a_bend_and_not_for_play():
    """A half of what is left means nothing of a bend, and all of play, which changes from row to row."""
    bend, play = (chance_in_sound(kind, 0.5, 1, spare=200.0, looks=1, misfit=1.0) for kind in ("sag", "backlash"))
    assert bend > 1e-3
    assert play < 1e-12


def test_more_looks_and_nothing_determined_are_no_evidence():
    """The best of many dates gains more; numbers that the rest imitates gain nothing."""
    one, many = (chance_in_sound("episode", 0.3, 2, spare=100.0, looks=looks, misfit=0.5) for looks in (1, 300))
    assert one < many
    assert chance_in_sound("sag", 9.0, 0, spare=100.0, looks=1, misfit=0.5) == 1.0


def test_further_numbers_must_pay():
    """Of two explanations that leave the same the one with fewer numbers is likelier."""
    count = effective_components(280.0)
    assert count == pytest.approx(1 / (1 / 280 + GAINS["smooth"].mean))
    assert criterion(0.1, 2, count) < criterion(0.1, 4, count) < criterion(0.9, 2, count)


def test_a_remedy_that_changes_records_is_given_only_where_chance_is_no_reason() -> None:
    sure, chance = (Finding("wrong_target", "rows", "2 of 169 rows", {}, chance=one) for one in (1e-4, 0.2))
    assert sure.remedy == REMEDIES["wrong_target"]
    assert chance.remedy.startswith("It may be chance")
    assert Finding("drift", "doubt", "drifts", {}, chance=0.2).remedy == REMEDIES["drift"]
