"""Slopes along the trough from those across, on surfaces of known height: right but for one of each row and panel."""

import numpy as np
import pytest

from observer.slopes.row_spline import RowGrid
from observer.slopes.twist import slopes_by_twist

STEP_M, EDGES_Y_M = 0.02, np.array([-0.8, 0.0, 0.8])
X, Y = np.arange(-1.2, 1.2, STEP_M) + STEP_M / 2, np.arange(-0.8, 0.8, STEP_M) + STEP_M / 2
GRID = RowGrid(X, np.arange(1, X.size) != X.size // 2, Y.size, Y)


def waves(turn: float) -> tuple[np.ndarray, np.ndarray]:
    """Return both slopes of waves of 1 m across whose crests are turned, and of four panels that lean by themselves."""
    x, y = np.meshgrid(X, Y)
    slope = 0.6e-3 * np.cos(2 * np.pi * (x + np.tan(turn) * y))
    lean = np.random.default_rng(1).normal(0, 1e-3, (2, 2, 2))[:, (y > 0).astype(int), (x > 0).astype(int)]
    return slope + lean[0], np.tan(turn) * slope + lean[1]


def found(across: np.ndarray, measured: np.ndarray) -> np.ndarray:
    return slopes_by_twist(across, np.full(across.shape, 0.05e-3), measured, GRID, Y, EDGES_Y_M)


def beside_means(along: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return slopes less the mean of each row's piece of a panel."""
    left = along.copy()
    for part in (slice(None, X.size // 2), slice(X.size // 2, None)):
        count = np.maximum(measured[:, part].sum(axis=1, keepdims=True), 1)
        left[:, part] -= (measured * along)[:, part].sum(axis=1, keepdims=True) / count
    return left


def test_slopes_along_follow_from_the_twist_on_every_panel() -> None:
    every = np.ones((Y.size, X.size), dtype=bool)
    across, along = waves(0.6)
    true = beside_means(along, every)
    error = found(across, every) - true
    # Rows around leave 0.94 of waves that are 1.46 m long along the trough; beside a panel's edge they lie on one side.
    inner = np.abs(np.abs(Y) - 0.4) < 0.2
    assert np.sqrt(np.mean(error[inner] ** 2)) < 0.08 * np.sqrt(np.mean(true[inner] ** 2))
    assert np.sqrt(np.mean(error**2)) < 0.3 * np.sqrt(np.mean(true**2))


def test_where_nothing_changes_from_row_to_row_nothing_is_said() -> None:
    """Waves along the trough have no slope along it; panels that lean by themselves do not tell each other's twist."""
    every = np.ones((Y.size, X.size), dtype=bool)
    np.testing.assert_allclose(found(waves(0.0)[0], every), 0.0, atol=1e-12)


def test_rows_that_were_not_measured_do_not_count() -> None:
    across, along = waves(0.6)
    measured = np.ones((Y.size, X.size), dtype=bool)
    measured[20:24] = False
    true = beside_means(along, measured)
    error = found(np.where(measured, across, 0.02), measured) - true
    assert np.sqrt(np.mean(error[measured] ** 2)) < 0.3 * np.sqrt(np.mean(true[measured] ** 2))
    assert not found(across, measured)[20:24].any()
    assert not slopes_by_twist(across, np.full(across.shape, 1e-3), measured, GRID, Y, EDGES_Y_M).any()


@pytest.mark.parametrize(("n_rows", "error_share"), [(24, 0.06), (8, 0.06), (6, 1.0)])
def test_a_surface_of_third_degree_is_told_from_rows_up_to_a_fifth_of_a_metre_apart(
    n_rows: int, error_share: float
) -> None:
    """Of ``h = a x y + b x^2 y + c x y^2``; rows 0.27 m apart, over three times the reach, tell nothing."""
    y_m = (np.arange(n_rows) + 0.5) * (1.6 / n_rows) - 0.8
    x, y = np.meshgrid(X, y_m)
    a, b, c = 1e-3, 0.8e-3, 0.5e-3
    across, along = a * y + 2 * b * x * y + c * y**2, a * x + b * x**2 + 2 * c * x * y
    # Half of a panel counts, so that a row's mean is that of what was measured.
    measured = np.abs(x + 0.1) < 0.8
    grid, sigma = RowGrid(X, GRID.joined, n_rows, y_m), np.full(x.shape, 0.3e-3)
    error = slopes_by_twist(across, sigma, measured, grid, y_m, EDGES_Y_M) - beside_means(along, measured)
    size = np.sqrt(np.mean(beside_means(along, measured)[measured] ** 2))
    assert np.sqrt(np.mean(error[measured] ** 2)) == pytest.approx(error_share * size, rel=0.5)


def test_noise_of_rows_makes_what_a_line_through_those_around_has() -> None:
    """Of rows d apart that count as a Gaussian of w the variance of a slope is ``s^2 d / (4 sqrt(pi) w^3)``."""
    every, noise = np.ones((Y.size, X.size), dtype=bool), 0.04e-3
    across = noise * np.random.default_rng(3).standard_normal((Y.size, 1)) * np.ones(X.size)
    along = found(across, every)
    inner = np.abs(np.abs(Y) - 0.4) < 0.2
    twist = np.diff(along, axis=1)[inner, 0] / STEP_M
    # Of some ten independent ones.
    expected = noise * np.sqrt(STEP_M / (4 * np.sqrt(np.pi) * 0.08**3))
    assert np.sqrt(np.mean(twist**2)) == pytest.approx(expected, rel=0.5)


@pytest.mark.parametrize(("n_rows", "is_told"), [(4, False), (5, True)])
def test_a_few_rows_side_by_side_tell_no_twist(n_rows: int, is_told: bool) -> None:
    measured = np.zeros((Y.size, X.size), dtype=bool)
    measured[60 : 60 + n_rows] = True
    assert found(waves(0.6)[0], measured).any() == is_told
