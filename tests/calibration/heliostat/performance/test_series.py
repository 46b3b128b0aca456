"""Accuracy, drift, sawtooth of drawn series: recovered, and scattered as their sigmas say."""

import numpy as np
import pytest
from scipy.stats import chi2

from calibration.heliostat.performance.beam_series import BeamSeries, accuracy, near_noon, repeated
from calibration.heliostat.performance.wander import sawtooth, wander
from data_synth.acceptance.plant import slow_motion
from heliogauge.errors import EstimationError, InputError


def chi_square_bounds(count):
    """Range of a sum of squares that chance leaves in one of 1000 tests on either side."""
    return chi2.ppf([1e-3, 1 - 1e-3], count)


def series_of(true, sigma, rng, common=(0.0, 0.0)):
    shared = rng.normal(0, 1, 2) * common
    measured = true + shared + rng.normal(0, sigma, true.shape)
    return BeamSeries(np.arange(len(true)) * 60.0, measured, np.full(true.shape, sigma), np.array(common))


def test_sigma_of_accuracy_is_its_scatter():
    """RMS, spread, mean of a fixed motion under noise of centroids and a shared offset."""
    rng = np.random.default_rng(0)
    true = 1e-3 * np.array([0.6, -0.3]) + slow_motion(rng, np.arange(80) * 60.0, 0.4e-3, 600.0)
    mean = true.mean(axis=0)
    truth = {
        "rms": np.sqrt((true**2).sum(axis=1).mean()),
        "spread": np.sqrt(((true - mean) ** 2).sum() / 79),
    }
    scores = {name: [] for name in (*truth, "right")}
    for seed in range(150):
        found = accuracy(series_of(true, 0.3e-3, np.random.default_rng(seed), (0.05e-3, 0.08e-3)))
        for name, value in truth.items():
            one = getattr(found, name)
            scores[name].append((one.value - value) / one.sigma)
        scores["right"].append((found.mean[0].value - mean[0]) / found.mean[0].sigma)
    for name, values in scores.items():
        low, high = chi_square_bounds(len(values))
        assert low < np.sum(np.square(values)) < high, name
        assert abs(np.mean(values)) < 0.35, name


def test_mean_size_is_within_its_sigma():
    """Noise as large as half of the errors: what it adds to each size is taken off, half of that stays in the sigma."""
    true = np.array([0.6e-3, -0.3e-3]) + slow_motion(np.random.default_rng(0), np.arange(80) * 60.0, 0.4e-3, 600.0)
    scores = []
    for seed in range(60):
        found = accuracy(series_of(true, 0.3e-3, np.random.default_rng(seed))).average
        scores.append((found.value - np.hypot(*true.T).mean()) / found.sigma)
    assert np.sum(np.square(scores)) < chi_square_bounds(60)[1]
    assert np.sum(np.square(scores)) > 10


def test_noise_alone_is_no_error_of_tracking():
    found = accuracy(series_of(np.zeros((400, 2)), 0.3e-3, np.random.default_rng(3)))
    assert found.rms.value < 2 * found.rms.sigma + 0.05e-3
    assert found.rms.sigma < 0.15e-3


def test_noon_is_a_quarter_of_an_hour_about_culmination():
    series = series_of(np.tile([1e-3, 2e-3], (60, 1)), 0.1e-3, np.random.default_rng(2))
    right, up = near_noon(series, 1800.0)
    # 31 beams lie within 15 minutes.
    assert right.sigma == pytest.approx(0.1e-3 / np.sqrt(31))
    assert up.value == pytest.approx(2e-3, abs=4 * up.sigma)
    with pytest.raises(EstimationError, match="no beam within 15 minutes"):
        near_noon(series, 1e5)


def test_sigma_of_drift_and_oscillation_is_their_scatter():
    """A cubic under an oscillation with a memory (V-06 and E3 of the report: its own digits do not hold one)."""
    times = np.arange(120) * 60.0
    x = 2 * times / times[-1] - 1
    fine = np.linspace(-1, 1, 4001)
    scores = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        values = 0.9 * x**3 - 0.5 * x + slow_motion(rng, times, 0.1, 300.0)[:, 0] + rng.normal(0, 0.02, times.size)
        found = wander(times, values, np.full(times.size, 0.02))
        drift = (found.drift.value - np.ptp(0.9 * fine**3 - 0.5 * fine)) / found.drift.sigma
        size = np.log(found.oscillation.value / 0.1) * found.oscillation.value / found.oscillation.sigma
        scores.append((drift, size))
    low, high = chi_square_bounds(30)
    assert low < np.sum(np.array(scores)[:, 0] ** 2) < high
    assert low < np.sum(np.array(scores)[:, 1] ** 2) < high


def test_white_noise_would_make_the_drift_look_sure():
    """Negative control: with its memory ignored the same series has a sigma three times too small."""
    times = np.arange(120) * 60.0
    values = slow_motion(np.random.default_rng(5), times, 0.1, 600.0)[:, 0]
    found = wander(times, values, np.full(times.size, 0.01))
    basis = np.polynomial.legendre.legvander(2 * times / times[-1] - 1, 3)
    white = np.std(values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0])
    sigma_white = white * np.sqrt(np.diag(np.linalg.inv(basis.T @ basis))).max()
    assert found.drift.sigma > 2 * sigma_white


@pytest.mark.parametrize("period_s", [60.0, None])
def test_sawtooth_of_updates_each_minute(period_s):
    """V-07: 0.40 m between updates each 60 s; a sawtooth of that height has a standard deviation of 0.115 m."""
    times = np.arange(400) * 2.0
    tooth = ((times - 7.3) / 60.0) % 1.0 - 0.5
    assert 0.4 * tooth.std() == pytest.approx(0.115, abs=3e-3)
    scores = []
    for seed in range(12 if period_s else 2):
        rng = np.random.default_rng(seed)
        values = np.outer(tooth, [0.40, -0.10]) + rng.normal(0, 0.15, (400, 2))
        found = sawtooth(times, values, period_s=period_s)
        assert found.period_s == pytest.approx(60.0, abs=0.25)
        assert found.p_chance < 1e-4
        scores += [(one.value - true) / one.sigma for one, true in zip(found.height, (0.40, -0.10), strict=True)]
    low, high = chi_square_bounds(len(scores))
    assert low < np.sum(np.square(scores)) < high


def test_noise_has_no_sawtooth():
    chances = [
        sawtooth(np.arange(200) * 5.0, np.random.default_rng(seed).normal(0, 1, (200, 2)), period_s=60.0).p_chance
        for seed in range(40)
    ]
    assert np.mean(np.array(chances) < 0.01) <= 0.025
    with pytest.raises(EstimationError, match="cannot show a period"):
        sawtooth(np.arange(200) * 30.0, np.zeros((200, 2)), period_s=60.0)


def test_repeatability_and_sides():
    sides = np.tile(["east", "west"], 20)
    shift = np.where(sides == "east", 0.5, -0.5)
    scores = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        true = np.stack([shift, np.zeros(40)], axis=1) + rng.normal(0, [1.0, 0.6], (40, 2))
        found = repeated(series_of(true, 0.2, rng), sides)
        scores.append((found.scatter[0].value - 1.0) / found.scatter[0].sigma)
        assert found.scatter[0].degrees == 38
    low, high = chi_square_bounds(40)
    assert low < np.sum(np.square(scores)) < high
    with pytest.raises(EstimationError, match="no approach was repeated"):
        repeated(series_of(true[:2], 0.2, rng), np.array(["a", "b"]))


def test_times_ascend():
    with pytest.raises(InputError, match="ascending"):
        BeamSeries(np.array([0.0, 0.0]), np.zeros((2, 2)), np.ones((2, 2)), np.zeros(2))


def test_tracking_accuracy_of_unam():
    """V-05 and V-06: oscillation 0.215 m and 0.067 m at 126 m are 1.706 and 0.53 mrad; drift 0.61 m and 0.50 m."""
    times = np.arange(300) * 12.0
    x = 2 * times / times[-1] - 1
    fine = np.linspace(-1, 1, 4001)
    for size, drift, expected in ((0.215, 0.61, 1.706), (0.067, 0.50, 0.53)):
        shape = np.polynomial.polynomial.polyval(fine, [0.0, 0.4, 0.1, -1.0])
        cubic = drift / np.ptp(shape) * np.polynomial.polynomial.polyval(x, [0.0, 0.4, 0.1, -1.0])
        values = cubic + np.random.default_rng(7).normal(0, size, times.size)
        found = wander(times, values / 126.0, np.full(times.size, 0.0175 / 126.0))
        assert 1e3 * size / 126.0 == pytest.approx(expected, abs=2e-3)
        assert abs(1e-3 * expected - found.oscillation.value) < 3 * found.oscillation.sigma
        assert abs(drift / 126.0 - found.drift.value) < 3 * found.drift.sigma
        assert found.oscillation.sigma < 0.1 * found.oscillation.value
