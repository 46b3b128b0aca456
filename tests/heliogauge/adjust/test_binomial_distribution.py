"""Tail of the binomial distribution against scipy's, also where binomial coefficients overflow."""

import pytest
from scipy import stats

from heliogauge.adjust.binomial_distribution import binomial_tail


@pytest.mark.parametrize("trials", [1, 5, 60, 1200, 5000])
@pytest.mark.parametrize("chance", [1e-9, 1e-3, 0.3, 0.999])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 1.0])
def test_tail_is_scipys(trials: int, chance: float, share: float) -> None:
    hits = max(round(share * trials), 1)
    expected = float(stats.binom.sf(hits - 1, trials, chance))
    assert binomial_tail(hits, trials, chance) == pytest.approx(expected, rel=1e-9, abs=1e-290)


def test_ends() -> None:
    assert binomial_tail(0, 5, 0.0) == 1.0
    assert binomial_tail(1, 5, 0.0) == binomial_tail(6, 5, 0.5) == 0.0
    assert binomial_tail(5, 5, 1.0) == 1.0
