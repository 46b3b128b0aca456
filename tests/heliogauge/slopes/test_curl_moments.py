"""Smooth curl: zero within sigma for any surface, and 200 times clearer than at single nodes for what is none."""

from dataclasses import replace

import numpy as np
import pytest

from heliogauge.adjust.chi_square import chi_square_quantile
from heliogauge.flags import SampleFlag
from heliogauge.geometry.surfaces import plane
from heliogauge.slopes.curl_moments import curl_moments
from heliogauge.slopes.map import CommonModes, SlopeMap, no_common_modes

SIGMA = 1e-5


def wavy_map(rng: np.random.Generator, *, common: CommonModes | None = None) -> SlopeMap:
    """Waves of 9 to 20 cm and a turned-down corner, 0.2 mrad high, with noise; a hole, and a round aperture."""
    x_m, y_m = np.linspace(-0.6, 0.6, 81), np.linspace(-0.5, 0.5, 71)
    x, y = np.meshgrid(x_m, y_m)
    slopes = np.zeros((2, *x.shape))
    for wavelength, angle in ((0.09, 0.3), (0.13, 1.9), (0.2, 2.7)):
        wave = 2 * np.pi / wavelength * np.array([np.cos(angle), np.sin(angle)])
        slopes += 1e-4 * np.multiply.outer(wave / np.linalg.norm(wave), np.cos(wave[0] * x + wave[1] * y + angle))
    corner = 2e-4 * np.exp(8 * (x + y - 1.0))
    slopes += corner
    aperture = np.hypot(x / 0.58, y / 0.48) < 1
    flags = np.where(np.hypot(x - 0.1, y + 0.2) < 0.06, np.uint32(SampleFlag.SATURATED), np.uint32(0))
    zero, one = np.zeros(x.shape), np.ones(x.shape)
    noisy = slopes + SIGMA * rng.standard_normal(slopes.shape)
    words = plane().describe(), "facet", "nothing"
    modes = common or no_common_modes()
    return SlopeMap(x_m, y_m, *noisy, zero, zero, SIGMA * one, SIGMA * one, 1.0, modes, zero, flags, aperture, *words)


def test_moments_of_surfaces_are_zero_within_their_covariance() -> None:
    squares = [curl_moments(wavy_map(np.random.default_rng(seed))).chi_square for seed in range(40)]
    # 240 degrees of freedom: 4 standard deviations of the mean are 2.2.
    assert np.mean(squares) == pytest.approx(6.0, abs=2.2)


def test_curl_a_thirtieth_of_the_noise_is_seen() -> None:
    slope_map = wavy_map(np.random.default_rng(1))
    sheared = replace(slope_map, slope_x=slope_map.slope_x + 2e-5 * slope_map.y_m[:, None])
    found = curl_moments(sheared)
    sigma = np.sqrt(found.covariance[0, 0])
    assert found.values_per_m[0] == pytest.approx(2e-5, abs=4 * sigma)
    # Single nodes have a curl of SIGMA over their distance: 200 times more.
    assert sigma < 5e-3 * SIGMA / (slope_map.x_m[1] - slope_map.x_m[0])
    assert found.chi_square > chi_square_quantile(1 - 1e-6, 6) > curl_moments(slope_map).chi_square


def test_a_stated_error_that_makes_the_curl_explains_it() -> None:
    # slope_x = 2e-5 * y: the second linear term.
    shear = np.zeros((1, 2, 3))
    shear[0, 0, 2] = 2e-5
    stated = CommonModes(("screen pose",), shear, np.zeros(2), 1.0)
    slope_map = wavy_map(np.random.default_rng(1), common=stated)
    sheared = replace(slope_map, slope_x=slope_map.slope_x + 2e-5 * slope_map.y_m[:, None])
    found = curl_moments(sheared)
    assert found.chi_square < chi_square_quantile(1 - 1e-4, 6)
    np.testing.assert_allclose(found.of_modes(stated)[0], 2e-5, rtol=1e-9)


def test_a_map_of_few_nodes_has_none() -> None:
    slope_map = wavy_map(np.random.default_rng(1))
    aperture = np.zeros(slope_map.shape, dtype=bool)
    aperture[30:40, 30:40] = True
    assert curl_moments(replace(slope_map, aperture=aperture)) is None


def test_covariance_and_modes_are_those_of_the_written_out_weights() -> None:
    """Each slope's weight in each mean from a map with that slope alone, on a small uneven grid with a hole."""
    rng = np.random.default_rng(4)
    x_m, y_m = np.sort(rng.uniform(-0.6, 0.6, 17)), np.sort(rng.uniform(-0.5, 0.5, 15))
    shape = (y_m.size, x_m.size)
    modes = CommonModes(("camera", "screen pose"), rng.normal(size=(2, 2, 10)), np.array([0.1, -0.05]), 0.6)
    flags = np.zeros(shape, dtype=np.uint32)
    flags[6, 5] = SampleFlag.SATURATED
    sigma = np.where(flags != 0, np.nan, rng.uniform(1e-5, 3e-5, (2, *shape)))
    zero = np.zeros(shape)
    words = plane().describe(), "facet", "nothing"
    empty = SlopeMap(
        x_m, y_m, zero, zero, zero, zero, *sigma, 2.0, modes, zero, flags, np.ones(shape, dtype=bool), *words
    )
    found = curl_moments(empty)
    weights = np.zeros((6, 2, *shape))
    for axis, name in enumerate(("slope_x", "slope_y")):
        for node in np.argwhere(flags == 0).tolist():
            slopes = zero.copy()
            slopes[tuple(node)] = 1.0
            weights[:, axis, *node] = curl_moments(replace(empty, **{name: slopes})).values_per_m
    by_mode = np.einsum("kaij,maij->km", weights, np.stack(list(modes.on_grid(x_m, y_m))))
    np.testing.assert_allclose(found.of_modes(modes), by_mode, atol=1e-12 * np.abs(by_mode).max())
    random = np.einsum("kaij,laij->kl", weights * np.nan_to_num(sigma) ** 2, weights)
    np.testing.assert_allclose(
        found.covariance, 2.0 * random + by_mode @ by_mode.T, atol=1e-12 * np.abs(found.covariance).max()
    )
    only_noise = curl_moments(replace(empty, common=no_common_modes()))
    np.testing.assert_allclose(only_noise.covariance, 2.0 * random, atol=1e-12 * np.abs(random).max())
