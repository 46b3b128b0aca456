"""What limits make of values with uncertainty."""

import numpy as np
import pytest
from scipy.stats import norm, t

from calibration.heliostat.performance.entries import Conformity, Entry, Limit, decide
from heliogauge.errors import InputError


def entry(value, sigma, degrees=np.inf):
    return Entry("day", "beam_rms_rad", "RMS", value, sigma, degrees)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (2.0 - 1.65 * 0.1, Conformity.PASS),
        (2.0 - 1.64 * 0.1, Conformity.CONDITIONAL_PASS),
        (2.0 + 1.64 * 0.1, Conformity.CONDITIONAL_FAIL),
        (2.0 + 1.65 * 0.1, Conformity.FAIL),
    ],
)
def test_guard_band_is_1_645_sigma(value, expected):
    """ISO 14253-1:2017: 95 % for one limit is 1.645 standard uncertainties."""
    decision = decide(entry(value, 0.1), Limit(most=2.0))
    assert decision.conformity is expected
    assert decision.guard == pytest.approx(0.1645, abs=1e-4)
    assert decision.probability == pytest.approx(norm.cdf((2.0 - value) / 0.1), abs=1e-12)


def test_few_repetitions_widen_the_guard_band():
    decision = decide(entry(1.8, 0.1, 3), Limit(most=2.0))
    assert decision.probability == pytest.approx(t.cdf(2.0, 3), abs=1e-9)
    assert decision.conformity is Conformity.CONDITIONAL_PASS
    assert decide(entry(1.8, 0.1), Limit(most=2.0)).conformity is Conformity.PASS


def test_a_tolerance_has_two_ends():
    assert decide(entry(1.5, 0.1), Limit(1.0, 2.0)).conformity is Conformity.PASS
    wide = decide(entry(1.5, 0.5), Limit(1.0, 2.0))
    assert wide.probability == pytest.approx(norm.cdf(1) - norm.cdf(-1), abs=1e-12)
    assert decide(entry(0.5, 0.1), Limit(1.0, 2.0)).conformity is Conformity.FAIL


def test_what_is_not_known_proves_nothing():
    assert decide(entry(1.0, None), Limit(most=2.0)).conformity is Conformity.UNDECIDED
    assert decide(entry(None, None), Limit(most=2.0)).conformity is Conformity.NOT_MEASURED
    assert decide(entry(1.0, 0.1), None).conformity is Conformity.NO_LIMIT
    with pytest.raises(InputError, match="least or most"):
        Limit()
    with pytest.raises(InputError, match="not below"):
        Limit(2.0, 1.0)
    with pytest.raises(InputError, match="confidence"):
        decide(entry(1.0, 0.1), Limit(most=2.0), 0.4)


def test_share_of_wrong_passes_is_what_was_asked():
    """Of heliostats that are at their limit, 5 % pass."""
    rng = np.random.default_rng(1)
    passed = [decide(entry(2.0 + rng.normal(0, 0.1), 0.1), Limit(most=2.0)).conformity for _ in range(2000)]
    share = np.mean([one is Conformity.PASS for one in passed])
    assert share == pytest.approx(0.05, abs=3 * np.sqrt(0.05 * 0.95 / 2000))
