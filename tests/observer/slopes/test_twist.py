"""Slopes along the trough from those across, on surfaces of known height: right but for one of each row and panel."""

import numpy as np

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
