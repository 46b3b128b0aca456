import numpy as np
import pytest
from scipy import stats

from heliogauge.adjust.robust_scale import SIGMA_PER_MAD, robust_scale, robust_scale_of_rows

RNG = np.random.default_rng(5)


def test_constant_is_that_of_normal_errors() -> None:
    assert pytest.approx(1 / stats.norm.ppf(0.75), rel=2e-6) == SIGMA_PER_MAD


def test_a_tenth_of_outliers_hardly_moves_it() -> None:
    errors = 0.3 * RNG.normal(size=20_001)
    clean = robust_scale(errors)
    errors[::10] += 1e6
    assert clean == pytest.approx(0.3, rel=0.03)
    assert robust_scale(errors) == pytest.approx(0.3, rel=0.2)


def test_centre_and_upper_value() -> None:
    values = np.array([10.0, 11.0, 13.0, 16.0])
    assert robust_scale(values) == pytest.approx(12 * SIGMA_PER_MAD)
    assert robust_scale(values, upper=True) == pytest.approx(13 * SIGMA_PER_MAD)
    assert robust_scale(values, centred=False) == pytest.approx(1.5 * SIGMA_PER_MAD)
    assert robust_scale(values, centred=False) == pytest.approx(stats.median_abs_deviation(values) * SIGMA_PER_MAD)


def test_nan_is_left_out_of_rows_only() -> None:
    rows = np.array([[1.0, -2.0, 3.0], [np.nan, 4.0, np.nan]])
    np.testing.assert_allclose(robust_scale_of_rows(rows), [2 * SIGMA_PER_MAD, 4 * SIGMA_PER_MAD])
    assert np.isnan(robust_scale(rows))
