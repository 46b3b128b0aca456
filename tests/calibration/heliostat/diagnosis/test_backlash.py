"""Play of the drives: the report's own numbers, honest scatter, what is not determined."""

import numpy as np
import pytest

from calibration.heliostat.diagnosis.backlash import backlash_from_marks, backlash_from_normals, normals_from_spots
from heliogauge.errors import EstimationError, InputError


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
