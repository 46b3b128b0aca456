"""Planning of flights: the published numbers of what a mirror shows and of RTK-GPS at rest (Gouws 2018)."""

import numpy as np
import pytest

from calibration.heliostat.observations.rtk import rtk_statistics
from calibration.heliostat.observations.visibility import ConcaveMirror
from heliogauge.errors import EstimationError, InputError

SIGMA_M = np.array([5.781e-3, 5.602e-3, 8.866e-3])
TEST_MIRROR = {"size_m": 1.9, "camera_m": 32.0, "target_m": 27.0}


def test_the_published_mirror():
    """Section 4.2.2.1: 0.797 deg; all curves cross at 34130.774 mm; colours are lost at 45 m and 70 m."""
    mirror = ConcaveMirror.showing(2.0, **TEST_MIRROR)
    assert np.degrees(mirror.edge_slope_rad) == pytest.approx(0.79718, abs=5e-6)
    assert mirror.focal_length_m == pytest.approx(34.130774, abs=5e-7)
    np.testing.assert_allclose(mirror.visible_width_m(mirror.focal_length_m, [7, 27, 60]), 1.9, atol=1e-12)
    np.testing.assert_allclose(mirror.visible_width_m([45, 55, 60, 70], 27), [1.537, 1.330, 1.252, 1.130], atol=6e-4)
    np.testing.assert_allclose(mirror.visible_width_m([20, 32, 70], 7), [2.175, 1.926, 1.700], atol=6e-4)
    sun = mirror.visible_width_m(np.inf, [7.0, 27.0])
    np.testing.assert_allclose(sun, [1.5103, 0.3970], atol=5e-5)
    assert sun[0] / sun[1] == pytest.approx(3.8047, abs=1e-4)


@pytest.mark.parametrize(
    ("target", "slope_deg", "camera", "focal"),
    [
        (7, 3.0639, 8.290, 8.849),
        (15, 1.4341, 17.776, 18.962),
        (30, 0.7175, 35.556, 37.923),
        (60, 0.3589, 71.114, 75.846),
    ],
)
def test_the_published_field_curve(target, slope_deg, camera, focal):
    """Figure 4.12: each mirror bent for the same spot of 396.96 mm; from where 2 m of the target are seen."""
    slope = 0.5 * np.arctan((1.9 - 0.39696) / (2 * target))
    mirror = ConcaveMirror(1.9, slope)
    assert np.degrees(slope) == pytest.approx(slope_deg, abs=1e-4)
    assert mirror.nearest_camera_m(2.0, target) == pytest.approx(camera, abs=6e-4)
    assert mirror.focal_length_m == pytest.approx(focal, abs=6e-4)


def test_error_of_the_centre_becomes_error_of_the_beam():
    mirror = ConcaveMirror.showing(2.0, **TEST_MIRROR)
    assert mirror.beam_error_per_metre(32, 27) == pytest.approx(0.0390, abs=5e-5)
    assert mirror.beam_error_per_metre(55, 27) == pytest.approx(0.0259, abs=5e-5)


def test_visible_width_follows_from_rays_at_the_edge():
    """An independent route: reflect the ray to the edge at its normal."""
    mirror = ConcaveMirror(1.9, 0.01)
    ray = np.array([0.95, -40.0])
    normal = np.array([-np.sin(0.01), np.cos(0.01)])
    out = ray - 2 * (ray @ normal) * normal
    assert mirror.visible_width_m(40.0, 25.0) == pytest.approx(2 * (0.95 + 25.0 * out[0] / out[1]), rel=1e-12)
    assert mirror.nearest_camera_m(float(mirror.visible_width_m(40.0, 25.0)), 25.0) == pytest.approx(40.0)


def test_what_no_mirror_shows_is_refused():
    with pytest.raises(InputError, match="convex"):
        ConcaveMirror.showing(9.0, **TEST_MIRROR)
    with pytest.raises(InputError, match="even from afar"):
        ConcaveMirror(1.9, 0.001).nearest_camera_m(0.5, 27)
    with pytest.raises(InputError, match="edge_slope_rad"):
        ConcaveMirror(1.9, -0.1)


def test_a_log_as_long_as_the_published_one():
    """Table 3.1 from its sigmas: DRMS 8.048 mm and MRSE 11.972 mm of 1500 epochs, within 3 sigma of the estimator."""
    log = SIGMA_M * np.random.default_rng(3).standard_normal((1500, 3)) + [-2.108755, 2.531074, 0.135710]
    found = rtk_statistics(log)
    assert 1e3 * found.drms_m == pytest.approx(8.048, abs=0.3)
    assert 1e3 * found.mrse_m == pytest.approx(11.972, abs=0.42)
    np.testing.assert_allclose(found.sigma_m, SIGMA_M, rtol=0.06)
    assert np.linalg.norm(found.mean_m) == pytest.approx(3.2972, abs=5e-4)
    assert found.correlation_time_s == pytest.approx(0.1, rel=0.6)


def test_drms_and_mrse_of_the_published_sigmas():
    """Two points per axis at plus and minus sigma have exactly that spread over n: 8.0500 and 11.9753 mm."""
    signs = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)] * 3)
    found = rtk_statistics(signs * SIGMA_M)
    assert 1e3 * found.drms_m == pytest.approx(8.0500, abs=5e-5)
    assert 1e3 * found.mrse_m == pytest.approx(11.9753, abs=5e-5)
    assert 1e3 * found.drms_m * np.sqrt(1.5) == pytest.approx(9.856, abs=5e-3)


def test_errors_that_last_are_recognised():
    """A first-order process of 5 s: the mean over a minute is 0.28 sigma, not the 0.04 of white noise."""
    rng, keep = np.random.default_rng(8), np.exp(-0.1 / 5.0)
    log = np.zeros((30_000, 3))
    steps = np.sqrt(1 - keep**2) * rng.standard_normal(log.shape)
    for k in range(1, len(log)):
        log[k] = keep * log[k - 1] + steps[k]
    found = rtk_statistics(log)
    assert found.correlation_time_s == pytest.approx(10.0, rel=0.35)
    means = log.reshape(50, 600, 3).mean(axis=1).std(axis=0)
    np.testing.assert_allclose(found.sigma_of_mean_m(60, 0.1), means, rtol=0.35)


def test_epochs_without_a_fix_are_left_out_and_few_are_refused():
    log = np.random.default_rng(0).standard_normal((100, 3))
    fixed = np.arange(100) < 60
    spoiled = np.where(fixed[:, None], log, 50.0)
    assert rtk_statistics(spoiled, is_fixed=fixed).n_epochs == 60
    assert rtk_statistics(spoiled, is_fixed=fixed).mrse_m == pytest.approx(rtk_statistics(log[:60]).mrse_m)
    with pytest.raises(EstimationError, match="20"):
        rtk_statistics(log[:10])
    with pytest.raises(InputError, match="is_fixed"):
        rtk_statistics(log, is_fixed=fixed[:5])
