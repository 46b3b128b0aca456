"""The bell that is fitted to a beam: first and second derivatives against differences."""

import numpy as np
import pytest

from calibration.beam.light.beam_centroids import bell_curvature, bell_model

Y, X = (axis.ravel().astype(float) for axis in np.mgrid[:24, :32])


@pytest.mark.parametrize("exponent", [1.0, 0.7, 1.8])
def test_derivatives_of_the_bell_are_those_of_differences(exponent):
    bell = np.array([50.0, 14.3, 11.6, 0.02, 0.004, 0.05, exponent])
    wanted = bell_model(np.array([60.0, 15.0, 11.0, 0.03, 0.0, 0.04, 1.1]), X, Y, free_exponent=True)[0]
    _, derivatives = bell_model(bell, X, Y, free_exponent=True)
    curvature = bell_curvature(bell, (X, Y, wanted), derivatives)
    for k, step in enumerate(1e-5 * np.abs(bell)):
        sides = []
        for sign in (1, -1):
            moved = bell.copy()
            moved[k] += sign * step
            sides.append(bell_model(moved, X, Y, free_exponent=True))
        first = (sides[0][0] - sides[1][0]) / (2 * step)
        np.testing.assert_allclose(derivatives[k], first, rtol=1e-5, atol=1e-6 * np.abs(first).max())
        second = (sides[0][1] - sides[1][1]) @ (wanted - bell_model(bell, X, Y, free_exponent=True)[0]) / (2 * step)
        np.testing.assert_allclose(curvature[k], second, rtol=1e-5, atol=1e-6 * np.abs(second).max())


def test_a_gaussian_is_a_bell_of_exponent_one():
    bell = np.array([50.0, 14.3, 11.6, 0.02, 0.004, 0.05, 1.0])
    with_exponent, without = (bell_model(bell, X, Y, free_exponent=free) for free in (True, False))
    np.testing.assert_allclose(without[0], with_exponent[0], rtol=1e-12)
    np.testing.assert_allclose(without[1], with_exponent[1][:6], rtol=1e-10, atol=1e-12)
