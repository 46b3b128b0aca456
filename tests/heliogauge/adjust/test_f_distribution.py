"""Tail of the F distribution against scipy's."""

import pytest
from scipy import stats

from heliogauge.adjust.f_distribution import f_tail


@pytest.mark.parametrize("value", [1e-3, 0.4, 1.0, 7.5, 60.0, 1e4])
@pytest.mark.parametrize("freedom", [1.0, 2.0, 5.0])
@pytest.mark.parametrize("spare", [3.6, 15.0, 280.0])
def test_tail_is_scipys(value, freedom, spare):
    """To 1e-10 of the tail, from ratios that say nothing to chances of 1e-200."""
    assert f_tail(value, freedom, spare) == pytest.approx(stats.f.sf(value, freedom, spare), rel=1e-10)


def test_no_ratio_says_nothing():
    """A term that leaves as much as before."""
    assert f_tail(0.0, 2.0, 10.0) == f_tail(-0.1, 2.0, 10.0) == 1.0
