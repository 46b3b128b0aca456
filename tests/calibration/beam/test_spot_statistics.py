"""Statistics of beam places and backlash: the reports' own numbers, known series, honest scatter."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.beam.light.spot_statistics import (
    daily_tracking,
    drift_and_oscillation,
    repeatability,
    search_spiral,
)
from calibration.heliostat.diagnosis.backlash import backlash_from_marks, backlash_from_normals, normals_from_spots
from heliogauge.errors import EstimationError, InputError


def test_drift_of_a_cubic_with_a_sawtooth() -> None:
    """Stage-STE V-06, V-07: the coefficients printed have too few digits, so a cubic of the same amplitude."""
    times = np.arange(0.0, 7200.0, 10.0)
    scaled = times / 3600 - 1
    sawtooth = 0.40 * ((times % 60.0) / 60.0 - 0.5)
    places = np.stack([0.61 / 0.77 * (scaled**3 - scaled) + sawtooth, 0.25 * scaled], axis=1)
    found = drift_and_oscillation(times, places, 126.0)
    assert found.amplitude_m == pytest.approx([0.61, 0.50], rel=0.03)
    # A uniform sawtooth of 0.40 m has a standard deviation of 0.115 m.
    assert found.oscillation_m[0] == pytest.approx(0.40 / np.sqrt(12), rel=0.03)
    assert found.oscillation_m[1] == pytest.approx(0, abs=1e-9)


def test_tracking_accuracy_of_the_report() -> None:
    """Stage-STE V-05: 0.215 m at 126 m is 1.7 mrad of the beam."""
    rng = np.random.default_rng(1)
    times = np.linspace(0, 3600, 4000)
    found = drift_and_oscillation(times, rng.normal(0, [0.215, 0.067], (4000, 2)), 126.0)
    assert 1e3 * found.oscillation_beam_rad == pytest.approx([1.706, 0.53], rel=0.03)


@given(st.integers(6, 40), st.integers(0, 1000))
def test_scatter_about_the_trend_is_unbiased_in_its_degrees(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    places = rng.normal(0, 0.1, (n, 2))
    found = drift_and_oscillation(np.arange(float(n)), places, 100.0)
    residuals = places - found.trend_m
    assert found.oscillation_m**2 * (n - 4) == pytest.approx(np.sum(residuals**2, axis=0))
    # Residuals are orthogonal to the trend, whatever the origin of time.
    later = drift_and_oscillation(np.arange(float(n)) + 1e9, places, 100.0)
    assert later.oscillation_m == pytest.approx(found.oscillation_m, rel=1e-6)


def test_drift_that_is_not_determined() -> None:
    with pytest.raises(EstimationError, match="4 places"):
        drift_and_oscillation(np.arange(5.0), [[0, 0], [1, 1], [2, 2], [3, 3], [np.nan, 0]], 100.0)
    with pytest.raises(EstimationError, match="one time"):
        drift_and_oscillation(np.zeros(8), np.zeros((8, 2)), 100.0)
    with pytest.raises(EstimationError, match="2 different times"):
        drift_and_oscillation([0, 0, 0, 0, 1, 1, 1, 1], np.zeros((8, 2)), 100.0)
    with pytest.raises(InputError, match="slant_range_m"):
        drift_and_oscillation(np.arange(8.0), np.zeros((8, 2)), 0.0)


def test_daily_tracking() -> None:
    offsets = np.array([[0.3, 0.0], [0.5, 0.0], [0.4, 0.1], [0.4, -0.1], [np.nan, 0.0]])
    day = daily_tracking(offsets, 100.0, hours_from_noon=[-3, -0.2, 0.2, 3, 0])
    assert 1e3 * day.mean_rad == pytest.approx([4, 0])
    assert 1e3 * day.noon_rad == pytest.approx([4.5, 0.5])
    assert day.rms_rad**2 == pytest.approx(np.sum(day.mean_rad**2) + 3 / 4 * np.sum(day.standard_deviation_rad**2))
    assert (day.n, 1e3 * day.largest_rad) == (4, pytest.approx(5.0))
    with pytest.raises(EstimationError, match="two spots"):
        daily_tracking([[0.0, 0.0]], 100.0)


def test_easy_heliostat() -> None:
    """Stage-STE V-44: 380 m, a picture every 2 min for 7 h, less than 1 mrad rms."""
    rng = np.random.default_rng(2)
    day = daily_tracking(rng.normal(0, 0.6e-3 * 380, (210, 2)), 380.0)
    assert 1e3 * day.rms_rad == pytest.approx(0.6 * np.sqrt(2), rel=0.1)


def test_repeatability_is_what_is_not_systematic() -> None:
    rng = np.random.default_rng(3)
    groups = np.repeat(np.arange(40), 5)
    systematic = rng.normal(0, 0.2, (40, 2))
    offsets = systematic[groups] + rng.normal(0, [0.03, 0.06], (200, 2))
    found = repeatability(offsets, groups, 100.0)
    assert 100 * found.repeatability_rad == pytest.approx([0.03, 0.06], rel=0.15)
    assert 100 * found.systematic_rad == pytest.approx(systematic, abs=0.12)
    assert found.degrees_of_freedom == 160
    with pytest.raises(EstimationError, match="no approach was repeated"):
        repeatability(offsets[:3], ["a", "b", "c"], 100.0)


def test_search_spiral_covers_every_block_once() -> None:
    places = search_spiral(2.0, 3)
    assert places.shape == (49, 2)
    assert {tuple(place) for place in places} == {(float(x), float(y)) for x in range(-3, 4) for y in range(-3, 4)}
    assert np.abs(np.diff(places, axis=0)).sum(axis=1) == pytest.approx(1.0)
    rings = np.abs(places).max(axis=1)
    assert (np.diff(rings) >= 0).all()
    assert places[:6].tolist() == [[0, 0], [1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0]]


# --- backlash -------------------------------------------------------------------------------------------------------


def _west_south_up(zenith_deg: float, azimuth_deg: float) -> np.ndarray:
    """Sun in the report's axes: x west, y south, z up; azimuth from south, east negative."""
    zenith, azimuth = np.radians([zenith_deg, azimuth_deg])
    return np.array([np.sin(zenith) * np.sin(azimuth), np.sin(zenith) * np.cos(azimuth), np.cos(zenith)])


def test_normals_and_play_of_the_report() -> None:
    """Stage-STE V-01 and V-02 (Table 3): both normals to 2.5e-4, play of 14 mrad within 0.5."""
    spots = np.array([[-1.332, 0.0, 21.867], [0.915, 0.0, 20.900]])
    sun = np.stack([_west_south_up(46.962, -77.420), _west_south_up(46.766, -77.267)])
    normals = normals_from_spots(spots, sun, [5.17, -122.0, -0.33])
    # The report prints three digits.
    assert normals == pytest.approx(np.array([[-0.472, 0.704, 0.531], [-0.462, 0.710, 0.531]]), abs=7.5e-4)
    play = backlash_from_normals(normals[:1], normals[1:])
    assert play.full_rad == pytest.approx(0.01423, abs=0.0005)
    assert np.isnan(play.sigma_full_rad)


def test_play_by_laser() -> None:
    assert backlash_from_marks([[0.0, 0.032]], 25.0).full_rad == pytest.approx(1.28e-3)
    assert backlash_from_marks([[0.0, 0.032]], 25.0).half_rad == pytest.approx(0.64e-3)
    assert backlash_from_marks([[0.0, 0.032]], 25.0, sigma_mark_m=0.001).sigma_full_rad == pytest.approx(
        np.sqrt(2) * 0.001 / 25
    )
    with pytest.raises(InputError, match="distance_m"):
        backlash_from_marks([[0.0, 0.1]], -1.0)


def test_sigma_of_the_play_is_its_scatter() -> None:
    rng = np.random.default_rng(4)
    turned = np.array([np.cos(0.01), np.sin(0.01), 0.0]) * 0.8 + [0, 0, 0.6]
    start = np.array([0.8, 0.0, 0.6])
    plays = []
    for _ in range(300):
        pairs = [n + rng.normal(0, 1e-4, (4, 3)) for n in (np.tile(start, (4, 1)), np.tile(turned, (4, 1)))]
        plays.append(backlash_from_normals(*pairs, sigma_normal_rad=1e-4))
    values = np.array([play.full_rad for play in plays])
    assert values.mean() == pytest.approx(0.01, abs=2e-5)
    assert values.std() / plays[0].sigma_full_rad == pytest.approx(1.0, abs=0.12)


def test_play_that_is_not_determined() -> None:
    with pytest.raises(EstimationError, match="along the axis"):
        backlash_from_normals([[0, 0, 1.0]], [[0, 0, 1.0]])
    with pytest.raises(EstimationError, match="opposite"):
        normals_from_spots([[0, 0, 10.0]], [[0, 0, -1.0]], [0, 0, 0])
    with pytest.raises(InputError, match="spot in the mirror"):
        normals_from_spots([[0, 0, 0.0]], [[0, 0, 1.0]], [0, 0, 0])
