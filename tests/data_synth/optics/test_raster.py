"""What a pixel gathers, against closed forms: a half plane, a cosine, moments."""

from math import erf, exp, pi, sqrt

import numpy as np
import pytest
from numpy.testing import assert_allclose

from data_synth.optics.raster import EDGE_RAYS, PixelKernel
from heliogauge.errors import InputError


def half_plane_share(distance: float, angle: float, sigma: float) -> float:
    """Share of a pixel (square of 1 px, Gaussian blur) on the positive side of a line.

    The projection of the kernel onto the line's normal is the sum of two uniform variables and a Gaussian one, so its
    distribution is a second difference of the twice integrated normal distribution.
    """

    def twice_integrated(t: float) -> float:
        if sigma == 0:
            return 0.5 * max(t, 0.0) ** 2
        z = t / sigma
        phi = exp(-0.5 * z * z) / sqrt(2 * pi)
        return 0.5 * ((t * t + sigma * sigma) * 0.5 * (1 + erf(z / sqrt(2))) + t * sigma * phi)

    # An edge along a row needs the limit b -> 0; 1e-4 is as good (error of the second difference 1e-9).
    a, b = max(abs(np.cos(angle)), 1e-4), max(abs(np.sin(angle)), 1e-4)
    corners = ((0.5, 0.5, 1), (0.5, -0.5, -1), (-0.5, 0.5, -1), (-0.5, -0.5, 1))
    return sum(sign * twice_integrated(distance + i * a + j * b) for i, j, sign in corners) / (a * b)


def test_the_reference_itself():
    assert half_plane_share(0.0, 0.7, 0.4) == pytest.approx(0.5)
    assert half_plane_share(0.2, 0.0, 0.0) == pytest.approx(0.7, abs=1e-4)
    # A diagonal line at 0.6 px cuts off a triangle of height sqrt(2)/2 - 0.6: area is the height squared.
    assert half_plane_share(0.6, pi / 4, 0.0) == pytest.approx(1 - (sqrt(0.5) - 0.6) ** 2, abs=1e-9)


@pytest.mark.parametrize("sigma", [0.0, 0.4, 1.0])
def test_coverage_by_a_half_plane(sigma):
    rng = np.random.default_rng(2)
    distance, angle = rng.uniform(-1, 1, 2000), rng.uniform(0, 2 * pi, 2000)
    angle[:200] = 0.0
    offsets = PixelKernel(sigma).scattered_offsets(2000, rng)
    along = offsets[..., 0] * np.cos(angle)[:, None] + offsets[..., 1] * np.sin(angle)[:, None]
    share = (along > -distance[:, None]).mean(axis=1)
    wanted = [half_plane_share(d, a, sigma) for d, a in zip(distance, angle, strict=True)]
    error = share - wanted
    assert np.abs(error).max() < 0.03
    assert error.std() < 0.004
    # No bias that a whole edge would share.
    assert abs(error.mean()) < 4 * error.std() / sqrt(2000)
    assert error[:200].std() < 0.0015


@pytest.mark.parametrize("sigma", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("period", [1.9, 5.0, 8.0, 40.0])
def test_mean_of_a_cosine_is_sinc_times_gaussian(sigma, period):
    kernel = PixelKernel(sigma)
    frequency = np.array([1, 0.6]) / period
    rule = kernel.smooth_rule(2 * pi / period)
    phase = 2 * pi * (rule.offsets_px @ frequency) + 0.3
    mean = rule.weights @ np.cos(phase)
    loss = np.prod(np.sinc(frequency)) * exp(-2 * (pi * sigma) ** 2 * frequency @ frequency)
    assert mean == pytest.approx(loss * np.cos(0.3), abs=1e-5 if loss > 1e-3 else 1e-4)


@pytest.mark.parametrize("sigma", [0.0, 0.4, 2.0])
def test_both_rules_have_the_moments_of_the_kernel(sigma):
    kernel = PixelKernel(sigma)
    rule = kernel.smooth_rule(0.1)
    assert rule.weights.sum() == pytest.approx(1.0, abs=1e-14)
    assert_allclose(rule.weights @ rule.offsets_px, 0, atol=1e-14)
    variance = 1 / 12 + sigma**2
    fourth = 1 / 80 + sigma**2 / 2 + 3 * sigma**4
    assert_allclose(rule.weights @ rule.offsets_px**2, variance, rtol=1e-12)
    assert_allclose(rule.weights @ rule.offsets_px**4, fourth, rtol=1e-12)
    scattered = kernel.scattered_offsets(400, np.random.default_rng(0)).reshape(-1, 2)
    assert len(scattered) == 400 * EDGE_RAYS
    # The Gaussian is cut at 4 sigma: 0.11 % of its variance.
    assert_allclose((scattered**2).mean(axis=0), variance, rtol=3e-3)
    assert np.abs(scattered).max() <= 0.5 + 4 * sigma + 1e-12
    assert np.hypot(*scattered.T).max() <= kernel.reach_px


def test_an_impossible_blur_is_refused():
    with pytest.raises(InputError, match="blur_sigma_px"):
        PixelKernel(-0.1)
