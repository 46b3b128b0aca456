import numpy as np
import pytest
from scipy import stats

from heliogauge.adjust.chi_square import chi_square_limit, chi_square_quantile, two_sided_probability
from heliogauge.errors import InputError


@pytest.mark.parametrize(("redundancy", "limit"), [(1, 23.928), (2, 27.631), (5, 35.888), (8, 42.701)])
def test_chi_square_limit_against_tables(redundancy: int, limit: float) -> None:
    # scipy.stats.chi2.isf(1e-6, redundancy)
    assert chi_square_limit(1e-6, redundancy) == pytest.approx(limit, abs=2e-3)


@pytest.mark.parametrize("freedom", [1, 2, 7, 60, 5000])
def test_quantiles_and_tails_against_scipy(freedom: int) -> None:
    for probability in (1e-6, 0.025, 0.5, 0.999):
        expected = stats.chi2.ppf(probability, freedom)
        assert chi_square_quantile(probability, freedom) == pytest.approx(expected, rel=1e-9)
    for value in (0.3 * freedom, freedom, 1.2 * freedom):
        expected = 2 * min(stats.chi2.cdf(value, freedom), stats.chi2.sf(value, freedom))
        assert two_sided_probability(value, freedom) == pytest.approx(expected, rel=1e-9, abs=1e-15)


def test_what_is_no_probability_is_refused() -> None:
    with pytest.raises(InputError, match="chi-square"):
        chi_square_limit(np.nan, 3)
