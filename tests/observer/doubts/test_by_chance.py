"""Alarms by chance over many modules: as improbable in all of them together as in one alone."""

import numpy as np
import pytest

from observer.doubts.by_chance import contradicting_sigmas
from observer.doubts.stated_dimensions import Found, diameter_doubt
from observer.trough.collector import ls2


def test_a_flight_over_many_modules_has_no_more_false_alarms_than_one_over_a_single_one() -> None:
    assert contradicting_sigmas(1) == pytest.approx(3.0)
    off = np.abs(np.random.default_rng(0).normal(size=(20000, 100)))
    # 0.27 %, that is 54 of 20,000; with three sigmas it would be 24 %.
    alarms = np.count_nonzero((off > contradicting_sigmas(100)).any(axis=1))
    assert abs(alarms - 54) < 4 * np.sqrt(54)


def test_a_tube_that_is_beside_its_diameter_by_chance_in_one_of_a_hundred_modules_is_not_doubted() -> None:
    found = Found(0.070 + 3.5 * 0.2e-3, 0.2e-3)
    assert diameter_doubt(found, ls2()) is not None
    assert diameter_doubt(found, ls2(), n_modules=100) is None
    assert diameter_doubt(Found(0.070 + 5.0 * 0.2e-3, 0.2e-3), ls2(), n_modules=100) is not None
