"""Edges of shadows among the tube's: one side alone, or both sides in contradiction, is not believed."""

from dataclasses import replace

import numpy as np

from observer.selection.shadows import confirmed_edges, pulled_curves
from observer.slopes.joint_solution import solve_jointly
from observer.slopes.row_spline import Roughness, RowGrid, TouchingLines, nodes_of

GRID = RowGrid(np.linspace(-1.0, 1.0, 80), np.ones(79, dtype=bool), 6)
SMOOTH = Roughness(1e-4, along_rad=1e-4)


def lines_of(x: np.ndarray, row: np.ndarray, error: np.ndarray) -> TouchingLines:
    """Lines that see a flat mirror with the slope error 2 mrad, and their own error."""
    n = x.size
    return TouchingLines(
        row,
        x,
        4e-3 + error,
        np.full(n, -2.0),
        np.zeros(n),
        np.full(n, 1e-4),
        np.zeros((n, 0), dtype=int),
        np.zeros((n, 0)),
    )


def test_what_one_side_says_alone_or_both_differently_is_refused() -> None:
    rng = np.random.default_rng(0)
    x = np.tile(np.arange(-0.95, 1.0, 0.05), 12)
    row = np.repeat(np.tile(np.arange(6), 2), x.size // 12)
    side = np.repeat([1.0, -1.0], x.size // 2)
    # On the left a shadow hides the edges of one side; on the right it shifts those of the other.
    hidden = (side < 0) & (x < -0.5)
    shifted = (side > 0) & (x > 0.6)
    error = rng.normal(0, 1e-4, x.size) + np.where(shifted, 6e-3, 0.0)
    seen = ~hidden
    lines = lines_of(x[seen], row[seen], error[seen])
    edges, nodes = confirmed_edges(lines, side[seen], GRID, SMOOTH)
    inner = (x[seen] > -0.4) & (x[seen] < 0.5)
    assert edges[inner].mean() > 0.99
    assert not edges[(x[seen] < -0.85) | (x[seen] > 0.65)].any()
    assert nodes[:, np.abs(GRID.x_m - 0.05) < 0.4].all()
    assert nodes[:, (GRID.x_m < -0.85) | (GRID.x_m > 0.75)].mean() < 0.2


def test_edges_of_one_side_only_bear_nothing_out() -> None:
    """As with a camera that is 20 % wrong: no edge is left of the other side."""
    x, row = np.tile(np.arange(-0.9, 1.0, 0.1), 6), np.repeat(np.arange(6), 19)
    edges, nodes = confirmed_edges(lines_of(x, row, np.zeros(x.size)), np.ones(x.size), GRID, SMOOTH)
    assert not edges.any()
    assert not nodes.any()


def test_clean_edges_of_both_sides_are_all_kept() -> None:
    rng = np.random.default_rng(1)
    x = np.tile(np.arange(-0.95, 1.0, 0.05), 12)
    row, side = np.repeat(np.tile(np.arange(6), 2), x.size // 12), np.repeat([1.0, -1.0], x.size // 2)
    edges, _ = confirmed_edges(lines_of(x, row, rng.normal(0, 1e-4, x.size)), side, GRID, SMOOTH)
    assert edges.mean() > 0.999


def test_a_curve_that_is_off_by_little_everywhere_is_refused_one_that_scatters_is_not() -> None:
    rng = np.random.default_rng(2)
    row = np.tile(np.arange(40), 3)
    curve = np.repeat([0, 1, 5], 40)
    normalised = rng.normal(0, 1, 120)
    normalised[(curve == 1) & (row < 20)] -= 5.0
    normalised[60] = 30.0
    pulled = pulled_curves(curve, row, normalised, 50)
    assert pulled[(curve == 1) & (row < 15)].all()
    assert not pulled[curve != 1].any()
    assert not pulled_curves(curve[:0], row[:0], normalised[:0], 50).any()


def test_rows_that_lost_edges_are_solved_again_and_no_others_need_it() -> None:
    """Against solving all rows of both sides from all edges that are left, in each round."""
    rng = np.random.default_rng(2)
    # Under it edges say little of places beside them.
    rough = replace(SMOOTH, across=1.0)
    x = np.tile(np.arange(-0.95, 1.0, 0.05), 12)
    row, side = np.repeat(np.tile(np.arange(6), 2), x.size // 12), np.repeat([1.0, -1.0], x.size // 2)
    # Row by row more of one side is shifted by more: what it leaves alone falls out a round later.
    shifted = (side > 0) & (np.abs(x - 0.1) < 0.18 * row)
    error = rng.normal(0, 1e-4, x.size) + np.where(shifted, 1.5e-3 * row * (1 + x), 0.0)
    lines = lines_of(x, row, error)
    before, share = nodes_of(GRID, x)
    nearest = before + (share > 0.5)
    kept, left_in = np.ones(x.size, dtype=bool), []
    for _ in range(4):
        both = []
        for way in (1.0, -1.0):
            some = lines.chosen(kept & (side == way))
            both.append(solve_jointly(some, GRID, rough, np.zeros((0, 0)), with_shares=None))
        slope, variance = [one.slopes[..., 0] for one in both], [one.random[..., 0, 0] for one in both]
        known = (variance[0] < 1e-6) & (variance[1] < 1e-6)
        agrees = known & (np.abs(slope[0] - slope[1]) < np.maximum(4 * np.sqrt(variance[0] + variance[1]), 5e-4))
        kept = kept & agrees[row, nearest]
        left_in.append(np.count_nonzero(kept))
    assert left_in[3] < left_in[2] < left_in[1] < left_in[0] < x.size
    edges, nodes = confirmed_edges(lines, side, GRID, rough)
    np.testing.assert_array_equal(edges, kept)
    np.testing.assert_array_equal(nodes, agrees)
