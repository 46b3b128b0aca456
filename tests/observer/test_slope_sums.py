"""Covariance of weighted sums of slopes against dense algebra."""

import numpy as np
import pytest

from observer.joint_solution import solve_jointly
from observer.slope_field import Roughness
from observer.slope_sums import sum_covariance
from tests.observer.test_joint_solution import dense, random_lines, small_grid


@pytest.mark.parametrize(("order", "across"), [(2, 1e-3), (3, 0.1)])
def test_sums_have_the_covariance_of_dense_algebra(order: int, across: float) -> None:
    rng = np.random.default_rng(5)
    grid, prior, covariance = small_grid(), Roughness(across, order=order), np.diag([1e-6, 4e-6, 9e-6])
    lines = random_lines(rng, grid, 200, 3)
    found = solve_jointly(lines, grid, prior, covariance)
    weights = rng.normal(0, 1, (12, 3, 20))
    flat = np.zeros((12, 123))
    flat[:, :120:2] = weights.reshape(12, 60)
    _, inverse = dense(grid, lines, prior, covariance)
    sums = sum_covariance(lines, grid, prior, found.covariance_common)(weights)
    np.testing.assert_allclose(sums, flat @ inverse @ flat.T, rtol=1e-8, atol=1e-9 * np.abs(sums).max())
