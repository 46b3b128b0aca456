"""Trends and changes: recovered, and scattered as their sigmas say."""

import numpy as np
from scipy.stats import chi2, t

from calibration.survey.judgement import chance, changes, trends


def sums_of(times, values, sigmas):
    """Sums of series, one row each, about their own origin."""
    w = 1 / sigmas**2
    names = {
        "w": w,
        "wt": w * times,
        "wy": w * values,
        "wtt": w * times**2,
        "wty": w * times * values,
        "wyy": w * values**2,
    }
    found = {name: column.sum(axis=1) for name, column in names.items()}
    return found | {"count": np.full(len(values), float(values.shape[1]))}


def drawn(seed, count=400, results=12, slope=0.3, more=1.0):
    rng = np.random.default_rng(seed)
    times = np.sort(rng.uniform(0, 2, (count, results)), axis=1)
    sigmas = rng.uniform(0.05, 0.2, (count, results))
    return times, 1.0 + slope * times + more * sigmas * rng.normal(size=(count, results)), sigmas


def test_sigma_of_a_trend_is_its_scatter():
    found = trends(sums_of(*drawn(1)))
    scores = (found.slope_per_year - 0.3) / found.sigma_slope
    # Birge's ratio is never below 1: sigmas are a little too large for some, never too small.
    assert 0.7 * 400 < np.sum(scores**2) < chi2.ppf(1 - 1e-3, 400)
    reference = [np.polyfit(one, values, 1, w=1 / sigma)[0] for one, values, sigma in zip(*drawn(1), strict=True)]
    np.testing.assert_allclose(found.slope_per_year, reference, rtol=1e-8)


def test_results_that_scatter_more_enlarge_the_sigma():
    found = trends(sums_of(*drawn(2, more=3.0)))
    scores = (found.slope_per_year - 0.3) / found.sigma_slope
    # Student's t with 10 degrees.
    assert np.sum(scores**2) < chi2.ppf(1 - 1e-3, 400) * t.var(10)
    assert 2.5 < np.median(found.birge) < 3.3
    plain = trends(sums_of(*drawn(2)))
    assert np.median(found.sigma_slope / plain.sigma_slope) > 2


def test_two_results_or_one_date_have_no_trend():
    times, values, sigmas = drawn(3, results=2)
    assert np.isnan(trends(sums_of(times, values, sigmas)).slope_per_year).all()
    times, values, sigmas = drawn(3, results=5)
    assert np.isnan(trends(sums_of(0 * times + 1.0, values, sigmas)).slope_per_year).all()


def test_chance_of_a_change_is_even_where_there_is_none():
    before, after = (sums_of(*drawn(seed, slope=0.0)) for seed in (4, 5))
    found = changes(before, after)
    likely = chance(found.change, found.sigma, found.degrees)
    # Kolmogorov: deviation of 400 even values beyond 1.95 / sqrt(400) has a chance of 1e-3; sigmas may be too large.
    assert np.mean(likely < 0.05) < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 400)
    moved = changes(before, sums_of(drawn(5, slope=0.0)[0], drawn(5, slope=0.0)[1] + 0.5, drawn(5)[2]))
    assert np.median(moved.change) > 0.4
    assert np.mean(chance(moved.change, moved.sigma, moved.degrees) < 1e-3) > 0.95
