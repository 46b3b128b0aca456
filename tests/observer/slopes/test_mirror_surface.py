"""Slopes to the mirror's shape, and points put on it."""

import numpy as np

from observer.selection.solve_and_refuse import row_grid
from observer.slopes.mirror_surface import at_points, beside_chord, heights, on_surface
from observer.trough.collector import Collector

COLLECTOR = Collector(
    4.0, 2.0, 1.5, 0.07, panel_edges_x_m=np.array([-2.0, 0.0, 2.0]), panel_edges_y_m=np.array([-1.0, 0.0, 1.0])
)
Y = (np.arange(40) + 0.5) * 0.05 - 1.0


def test_rows_give_the_height_of_a_mirror_curved_across() -> None:
    grid = row_grid(COLLECTOR, Y.size, 0.02)
    x = np.tile(grid.x_m, (Y.size, 1))
    truth = 1e-3 * np.sin(3 * x) + np.where(x > 0, 2e-3, 0.0) * x
    slopes = np.stack([3e-3 * np.cos(3 * x) + np.where(x > 0, 2e-3, 0.0), np.zeros_like(x)], axis=-1)
    everywhere = np.ones(x.shape, dtype=bool)
    found = heights(slopes, everywhere, ~everywhere, COLLECTOR, grid, Y)
    for half in (x[0] < 0, x[0] > 0):
        expected = truth[:, half] - truth[:, half].mean(axis=1, keepdims=True)
        assert np.abs(found[:, half] - expected).max() < 1e-6


def test_both_slopes_give_the_height_of_a_mirror_curved_both_ways() -> None:
    grid = row_grid(COLLECTOR, Y.size, 0.02)
    x, y = np.meshgrid(grid.x_m, Y)
    truth = 1e-3 * np.sin(2 * x + 3 * y)
    slopes = np.stack([2e-3 * np.cos(2 * x + 3 * y), 3e-3 * np.cos(2 * x + 3 * y)], axis=-1)
    everywhere = np.ones(x.shape, dtype=bool)
    rows_only = heights(slopes, everywhere, ~everywhere, COLLECTOR, grid, Y)
    both = heights(slopes, everywhere, everywhere, COLLECTOR, grid, Y)
    panel = COLLECTOR.panel_index(x, y)
    for number in range(4):
        inside = panel == number
        expected = truth[inside] - truth[inside].mean()
        assert np.abs(both[inside] - expected).max() < 5e-6
        assert np.abs(rows_only[inside] - expected).max() > 1e-4


def test_points_lie_on_the_surface_and_on_their_lines_of_sight() -> None:
    rng = np.random.default_rng(3)
    grid = row_grid(COLLECTOR, Y.size, 0.02)
    height = np.tile(1e-3 * np.sin(2 * grid.x_m), (Y.size, 1))
    row = rng.integers(0, Y.size, 50)
    x = rng.uniform(-1.9, 1.9, 50)
    points = np.stack([x, Y[row], x**2 / 6], axis=1)
    eyes = np.array([0.5, 0.3, 12.0]) + rng.normal(0, 0.3, (50, 3))
    moved = on_surface(points, eyes, row, height, grid, 1.5)
    beside = np.cross(moved - points, eyes - points)
    assert np.abs(beside).max() < 1e-12
    above = moved[:, 2] - moved[:, 0] ** 2 / 6 - at_points(height, row, moved[:, 0], grid)
    assert np.abs(above).max() < 2e-6
    assert np.abs(at_points(height, row, points[:, 0], grid)).max() > 9e-4


def test_cubics_of_each_panel_are_met_between_nodes() -> None:
    grid = row_grid(COLLECTOR, 2, 0.1)
    x = np.linspace(-1.95, 1.95, 200)
    x = x[np.abs(x) > grid.step_m]
    row = np.tile([0, 1], x.size // 2)

    def values(places: np.ndarray) -> np.ndarray:
        return np.where(places > 0, 1.0 + places - 2 * places**3, 0.5 * places**2)

    nodes = np.stack([values(grid.x_m), -values(grid.x_m)])
    found = at_points(nodes, row, x, grid) + beside_chord(nodes, row, x, grid)
    inner = (np.abs(x) > 1.5 * grid.step_m) & (np.abs(x) < 2.0 - 1.5 * grid.step_m)
    expected = values(x) * np.where(row > 0, -1, 1)
    np.testing.assert_allclose(found[inner | (x < 0)], expected[inner | (x < 0)], atol=1e-12)
    # Beside the panel's edge a cubic is met to the third difference, not to the bend.
    assert np.abs(found - expected).max() < 6 * 2 * grid.step_m**3
