"""Slope-error fields: the slopes are the derivatives of the heights, and they come back from truth.json unchanged."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from data_synth.optics.surface_errors import (
    Dimple,
    EdgeTurnDown,
    HeightGrid,
    Kink,
    Polynomial,
    Ripple,
    SurfaceErrors,
    Zernike,
)
from heliogauge.errors import InputError

_GRID = np.linspace(-0.8, 0.8, 9)
TERMS = [
    Polynomial([(1, 0, 1e-3), (0, 1, -2e-3), (2, 0, 3e-3), (1, 1, 1e-3), (3, 2, -4e-3), (0, 4, 2e-3)]),
    Zernike(0, 0, 1e-5, 0.7),
    Zernike(1, 1, 1e-5, 0.7),
    Zernike(1, -1, 1e-5, 0.7),
    Zernike(2, 0, 1e-5, 0.7),
    Zernike(2, -2, 1e-5, 0.7),
    Zernike(3, 1, 1e-5, 0.7),
    Zernike(4, 0, 1e-5, 0.7),
    Zernike(5, -3, 1e-5, 0.7),
    Ripple(2e-4, 0.2, 0.6, 0.3),
    Dimple(-3e-5, 0.1, 0.2, -0.1),
    EdgeTurnDown(5e-4, 0.07, 0.6, 0.5),
    Kink(2e-3, 0.08, 0.3, 0.1),
    HeightGrid(_GRID, _GRID, 1e-5 * np.outer(np.sin(3 * _GRID), np.cos(2 * _GRID))),
]


@pytest.fixture
def points() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(7)
    return rng.uniform(-0.6, 0.6, 200), rng.uniform(-0.6, 0.6, 200)


@pytest.mark.parametrize("term", TERMS, ids=lambda term: f"{term.KIND}")
def test_slopes_are_central_differences_of_the_height(term, points):
    x, y = points
    step = 1e-5
    _, slope_x, slope_y = term.evaluate(x, y)
    along_x = (term.evaluate(x + step, y)[0] - term.evaluate(x - step, y)[0]) / (2 * step)
    along_y = (term.evaluate(x, y + step)[0] - term.evaluate(x, y - step)[0]) / (2 * step)
    scale = max(np.abs(slope_x).max(), np.abs(slope_y).max(), 1e-12)
    # Truncation of the difference: (step / 0.07 m)^2 / 6 = 3e-9 of the slope; round-off 1e-16 * 1e-3 / 1e-5.
    assert_allclose(slope_x, along_x, atol=1e-7 * scale + 1e-14)
    assert_allclose(slope_y, along_y, atol=1e-7 * scale + 1e-14)


def test_zernike_by_its_trigonometric_form():
    radius, angle = np.meshgrid(np.linspace(0, 1, 11), np.linspace(0, 6, 13))
    x, y = 0.7 * radius * np.cos(angle), 0.7 * radius * np.sin(angle)
    coma = Zernike(3, -1, 2.0, 0.7).evaluate(x, y)[0]
    assert_allclose(coma, 2 * (3 * radius**3 - 2 * radius) * np.sin(angle), atol=1e-13)
    secondary = Zernike(4, 2, 1.0, 0.7).evaluate(x, y)[0]
    assert_allclose(secondary, (4 * radius**4 - 3 * radius**2) * np.cos(2 * angle), atol=1e-13)
    spherical = Zernike(4, 0, 1.0, 0.7).evaluate(x, y)[0]
    assert_allclose(spherical, 6 * radius**4 - 6 * radius**2 + 1, atol=1e-13)


def test_amplitudes_mean_what_they_say():
    position = np.linspace(-0.6, 0.6, 2001)
    _, slope_x, slope_y = Ripple(2e-4, 0.3, np.pi / 2).evaluate(np.zeros_like(position), position)
    assert_allclose(slope_x, 0, atol=1e-19)
    assert np.abs(slope_y).max() == pytest.approx(2e-4, rel=1e-5)
    # The rim bends back: its height falls outwards, by the named slope in the middle of the edge.
    _, slope_x, _ = EdgeTurnDown(5e-4, 0.05, 0.6, 0.5).evaluate(np.array([0.6, -0.6]), np.zeros(2))
    assert_allclose(slope_x, [-5e-4, 5e-4], rtol=1e-9)


def test_sum_of_terms_and_round_trip_through_json(points):
    errors = SurfaceErrors(tuple(TERMS))
    parts = np.sum([term.evaluate(*points) for term in TERMS], axis=0)
    assert_allclose(errors.evaluate(*points), parts, rtol=1e-12, atol=1e-18)
    again = SurfaceErrors.from_json(json.loads(json.dumps(errors.to_json())))
    assert_array_equal(again.evaluate(*points), errors.evaluate(*points))


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"kind": "dent"}, "one of polynomial, zernike"),
        ({"kind": "dimple", "sigma_m": 0.1}, "height_m"),
        ({"kind": "dimple", "height_m": 1e-5, "sigma_m": 0.0}, "dimple sigma_m"),
        ({"kind": "zernike", "n": 2, "m": 1, "amplitude_m": 1.0, "radius_m": 1.0}, "n - |m| even"),
        ({"kind": "polynomial", "terms": [[-1, 0, 1.0]]}, "negative"),
    ],
)
def test_impossible_terms_are_refused(values, said):
    with pytest.raises(InputError) as caught:
        SurfaceErrors.from_json([values])
    assert said in str(caught.value)
