"""The prior of slopes along the trough has the stated standard deviation everywhere, at all ends of panels too."""

import numpy as np
import pytest

from observer.slopes.row_spline import Roughness, RowGrid, prior_bands


def along_covariance(grid: RowGrid, prior: Roughness) -> np.ndarray:
    bands = prior_bands(grid, prior)[:, :, 1]
    precision = np.diag(bands[0])
    for reach in range(1, len(bands)):
        precision += np.diag(bands[reach, :-reach], reach) + np.diag(bands[reach, :-reach], -reach)
    return np.linalg.inv(precision)


def panels() -> RowGrid:
    """Panels of 1.2 and 1.3 m and of one node, nodes 2 cm apart."""
    joined = np.ones(250, dtype=bool)
    joined[[60, 125, 126, 190]] = False
    return RowGrid(np.arange(251) * 0.02 - 2.5, joined, 1)


@pytest.mark.parametrize("length_m", [0.3, 1.0, 3.0])
def test_the_stated_standard_deviation_at_every_node(length_m: float) -> None:
    grid, prior = panels(), Roughness(1e-3, 2e-3, along_length_m=length_m)
    covariance = along_covariance(grid, prior)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), 2e-3, rtol=1e-6)
    # Panels have nothing in common.
    assert np.abs(covariance[60, 61:]).max() < 1e-12
    # No two nodes are more than alike, and neighbours nearly so: (1 + k h) exp(-k h) for Matern's 3/2.
    correlation = covariance / 4e-6
    assert correlation.max() < 1 + 1e-6
    near = np.sqrt(3) * grid.step_m / length_m
    assert correlation[30, 31] == pytest.approx((1 + near) * np.exp(-near), abs=5e-3)


def test_far_from_all_ends_it_is_the_process_that_is_stated() -> None:
    """Whittle's process of length 0.3 m: (1 + k d) exp(-k d) at the distance d, where ends are 1.25 m away."""
    grid, prior = (
        RowGrid(np.arange(126) * 0.02, np.ones(125, dtype=bool), 1),
        Roughness(1e-3, 1.5e-3, along_length_m=0.3),
    )
    row = along_covariance(grid, prior)[62] / 1.5e-3**2
    way = np.sqrt(3) / 0.3 * np.abs(grid.x_m - grid.x_m[62])
    np.testing.assert_allclose(row[40:85], ((1 + way) * np.exp(-way))[40:85], atol=0.01)
