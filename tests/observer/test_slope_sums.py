"""Covariance of weighted sums of slopes against dense algebra."""

import numpy as np
import pytest

from heliogauge.flags import SampleFlag
from heliogauge.slope_map import SlopeMap, no_common_modes
from observer.joint_solution import solve_jointly
from observer.slope_field import Roughness
from observer.slope_sums import sum_covariance, with_bridged
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


def test_bridged_nodes_err_as_the_nearest_that_have_a_value() -> None:
    """Rows 2 to 4 of a column have no edges: their own solution is the prior, their values are those of 1 and 5."""
    sigma = np.full((6, 3), 1e-4)
    sigma[2:5, 1] = 5e-3
    flags = np.zeros((6, 3), dtype=np.uint32)
    flags[2:5, 1] = np.uint32(SampleFlag.SMOOTHED_GAP)
    zero, x, y = np.zeros((6, 3)), np.arange(3.0), np.arange(6.0)
    slope_map = SlopeMap(
        x, y, zero, zero, zero, zero, sigma, sigma, 1.0, no_common_modes(), zero, flags, np.ones((6, 3), dtype=bool),
        "d", "f", "nothing",
    )  # fmt: skip

    def of_rows(weights: np.ndarray) -> np.ndarray:
        return np.einsum("kij,lij->kl", weights * sigma**2, weights)

    one = np.zeros((2, 6, 3))
    one[0, 1:6, 1], one[1, :, 0] = 1.0, 1.0
    found = with_bridged(of_rows, slope_map)(one)
    # Rows 2 and 3 err as row 1 (of two that are as near the first), row 4 as row 5: weights 3 and 2.
    np.testing.assert_allclose(found, np.diag([13e-8, 6e-8]), rtol=1e-12)
