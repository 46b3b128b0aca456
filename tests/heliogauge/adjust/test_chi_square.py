import numpy as np
import pytest
from scipy import stats

from heliogauge.adjust.chi_square import (
    chi_square_limit,
    chi_square_noncentrality,
    chi_square_quantile,
    two_sided_probability,
)
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


@pytest.mark.parametrize("freedom", [1, 2, 6, 15])
@pytest.mark.parametrize(("value", "probability"), [(20.0, 1e-3), (60.0, 0.1), (60.0, 0.01), (200.0, 0.5)])
def test_noncentrality_against_scipy(value: float, freedom: int, probability: float) -> None:
    found = chi_square_noncentrality(value, freedom, probability)
    assert stats.ncx2.cdf(value, freedom, found) == pytest.approx(probability, rel=1e-9)


def test_a_probability_above_the_central_one_has_no_noncentrality() -> None:
    with pytest.raises(InputError, match=r"between 0 and 0\.9"):
        chi_square_noncentrality(9.0, 2, 0.999)


def test_what_is_no_probability_is_refused() -> None:
    with pytest.raises(InputError, match="chi-square"):
        chi_square_limit(np.nan, 3)
