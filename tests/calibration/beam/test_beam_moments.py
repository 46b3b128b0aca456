"""Moments of a beam: known shapes, and what must not depend on origin, scale and direction."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.beam.light.beam_moments import beam_moments, encircled_diameters_m
from heliogauge.errors import EstimationError, InputError
from tests.calibration.beam_pictures import gaussian, grid_m

X_M, Y_M = grid_m()[0][0], grid_m()[1][:, 0]


@pytest.mark.slow
@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(0.5, 0.7), st.floats(0.2, 0.4), st.floats(-1.5, 1.5))
def test_ellipse_of_a_gaussian(x: float, y: float, major: float, minor: float, direction: float) -> None:
    moments = beam_moments(gaussian((x, y), (major, minor), direction), X_M, Y_M)
    assert moments.centroid_m == pytest.approx([x, y], abs=1e-5)
    assert moments.widths_m == pytest.approx([major, minor], rel=1e-4)
    assert np.sin(moments.direction_rad - direction) == pytest.approx(0, abs=1e-4)
    assert moments.ellipticity == pytest.approx(major / minor, rel=1e-3)
    assert moments.total == pytest.approx(2 * np.pi * major * minor, rel=1e-4)


def test_covariance_is_central() -> None:
    light = gaussian((0.0, 0.0), (0.6, 0.3))
    near, far = beam_moments(light, X_M, Y_M), beam_moments(light, X_M + 100, Y_M - 50)
    assert far.covariance_m2 == pytest.approx(near.covariance_m2, abs=1e-9)


def test_angle_to_the_vertical() -> None:
    upright = beam_moments(gaussian((0, 0), (0.6, 0.3), np.pi / 2), X_M, Y_M)
    assert upright.angle_to_vertical_rad == pytest.approx(0, abs=1e-6)
    leaning = beam_moments(gaussian((0, 0), (0.6, 0.3), np.pi / 2 - 0.2), X_M, Y_M)
    assert leaning.angle_to_vertical_rad == pytest.approx(0.2, abs=1e-4)


def test_encircled_light_of_a_round_gaussian() -> None:
    light = gaussian((0.2, -0.3), (0.5, 0.5))
    found = encircled_diameters_m(light, X_M, Y_M, [0.2, -0.3], (0.5, 0.9))
    # Share inside radius r of a Gaussian: 1 - exp(-r^2 / 2 s^2).
    expected = 2 * 0.5 * np.sqrt(-2 * np.log([0.5, 0.1]))
    assert found == pytest.approx(expected, abs=0.02)


def test_no_light() -> None:
    with pytest.raises(EstimationError, match="no beam"):
        beam_moments(np.zeros((10, 10)), np.arange(10.0), np.arange(10.0))
    assert np.isnan(encircled_diameters_m(np.zeros((9, 9)), np.arange(9.0), np.arange(9.0), [4, 4], (0.5,))).all()


def test_bad_input() -> None:
    with pytest.raises(InputError, match="not finite"):
        beam_moments([[1.0, np.nan], [0, 1]], [0, 1], [0, 1])
    with pytest.raises(InputError, match="shares"):
        encircled_diameters_m(np.ones((9, 9)), np.arange(9.0), np.arange(9.0), [4, 4], (1.5,))
