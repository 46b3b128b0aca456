"""Estimates between samples: as far off as their sigmas say, for rough and for smooth surfaces."""

import numpy as np
import pytest

from deflectometry.shape.kriging import krige
from heliogauge.validate import FloatArray


def _waves(points: FloatArray, length: float, rng: np.random.Generator) -> FloatArray:
    """Return the sum of thirty waves that run anywhere, with a mean square of 1."""
    angle, phase = rng.uniform(0, 2 * np.pi, (2, 30))
    number = 2 * np.pi / length * np.stack([np.cos(angle), np.sin(angle)])
    return np.sqrt(2 / 30) * np.cos(points @ number + phase).sum(axis=1)


@pytest.mark.parametrize(("length", "least"), [(4.0, 0.65), (6.0, 0.8), (12.0, 0.8)])
def test_estimates_are_as_far_off_as_their_sigmas_say(length: float, least: float) -> None:
    """Waves of one length are smoother than any power of the distance: of short ones sigmas are rather too large."""
    squares = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        grid = np.stack(np.meshgrid(np.arange(16.0), np.arange(16.0)), axis=-1).reshape(-1, 2)
        points = grid + 0.02 * rng.standard_normal(grid.shape)
        places = rng.uniform(1.0, 14.0, (400, 2))
        waves = _waves(np.concatenate([points, places]), length, rng)
        noise = np.full(len(points), 0.01)
        values = waves[: len(points)] + noise * rng.standard_normal(len(points))
        found = krige(points, values, noise, places)
        squares.append(np.mean(((found.values - waves[len(points) :]) / found.sigma) ** 2))
    assert least < np.sqrt(np.mean(squares)) < 1.25


@pytest.mark.parametrize(("length", "noise", "most"), [(8.0, 0.01, 1.4), (12.0, 0.01, 1.25), (12.0, 0.1, 1.25)])
def test_beyond_the_outermost_samples_sigmas_hold_as_well(length: float, noise: float, most: float) -> None:
    """Half a distance beyond, as far as maps reach: with the roughness between samples errors are 2 sigma, and 25 where
    no roughness at all is taken for the likeliest. Sigmas of short waves without noise are a third too small."""
    squares = []
    for seed in range(12):
        rng = np.random.default_rng([seed, 1])
        grid = np.stack(np.meshgrid(np.arange(16.0), np.arange(16.0)), axis=-1).reshape(-1, 2)
        points = grid + 0.02 * rng.standard_normal(grid.shape)
        places = np.stack([rng.uniform(-0.5, 0.0, 300), rng.uniform(0.0, 15.0, 300)], axis=1)
        waves = _waves(np.concatenate([points, places]), length, rng)
        values = waves[: len(points)] + noise * rng.standard_normal(len(points))
        found = krige(points, values, np.full(len(points), noise), places)
        squares.append(np.mean(((found.values - waves[len(points) :]) / found.sigma) ** 2))
    assert 0.8 < np.sqrt(np.mean(squares)) < most


def test_what_is_quadratic_is_exact_and_noise_is_averaged() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(0, 10, (200, 2))
    places = rng.uniform(2, 8, (50, 2))

    def surface(at: FloatArray) -> FloatArray:
        return np.asarray(1.0 + at @ [0.3, -0.2] + 0.05 * at[:, 0] ** 2 - 0.02 * at[:, 0] * at[:, 1])

    exact = krige(points, surface(points), np.full(200, 1e-6), places)
    assert np.abs(exact.values - surface(places)).max() < 1e-5
    noisy = krige(points, surface(points) + 0.1 * rng.standard_normal(200), np.full(200, 0.1), places)
    assert np.median(noisy.sigma) < 0.1
    error = noisy.values - surface(places)
    assert np.sqrt(np.mean(error**2)) < 0.1
    assert np.sqrt(np.mean((error / noisy.sigma) ** 2)) < 1.25
