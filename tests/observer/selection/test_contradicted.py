"""Edges that the others of their row contradict although nothing is left of them."""

from dataclasses import replace

import numpy as np
import pytest

from observer.selection.contradicted import _fewest_refused, contradicted_edges, deletion_residuals
from observer.selection.edge_refusal import EdgeFate, undecided_doubt
from observer.selection.solve_and_refuse import _refuse_contradicted
from observer.slopes.joint_solution import solve_jointly
from observer.slopes.mirror_surface import at_points
from observer.slopes.row_spline import Roughness, RowGrid, TouchingLines

X_M = np.linspace(-1.0, 1.0, 60)
ROUGH = Roughness(1e-3, 2e-3, order=3)
SIGMA_RAD = 5e-5


def lines_of(row: np.ndarray, x_m: np.ndarray, slope_rad: np.ndarray) -> TouchingLines:
    """Return lines that say each slope to `SIGMA_RAD`."""
    by_x, by_y, sigma = (np.full(x_m.size, one) for one in (2.0, 0.05, SIGMA_RAD))
    index, by_common = np.zeros((x_m.size, 0), dtype=np.intp), np.zeros((x_m.size, 0))
    return TouchingLines(row, x_m, -2.0 * slope_rad, by_x, by_y, sigma, index, by_common)


@pytest.mark.parametrize("order", [2, 3])
def test_deletion_residuals_are_those_of_solutions_without_the_edge(order: int) -> None:
    rng = np.random.default_rng(0)
    grid = RowGrid(X_M, np.arange(59) != 29, 2)
    row, x = rng.integers(0, 2, 40), rng.uniform(-0.99, 0.99, 40)
    lines = lines_of(row, x, 1e-3 * np.sin(4 * x) + rng.normal(0, SIGMA_RAD, 40))
    rough = replace(ROUGH, order=order)
    found = deletion_residuals(lines, grid, rough)
    for k in range(0, 40, 5):
        off, left = (_misfit_of(lines, k, grid, rough, with_it=one) for one in (False, True))
        # What is left is off (1 - h), and the sigma of what it is off is sigma / sqrt(1 - h).
        assert found[k] == pytest.approx(np.sign(off) * np.sqrt(off * left) / SIGMA_RAD, rel=1e-5)


def _misfit_of(lines: TouchingLines, k: int, grid: RowGrid, rough: Roughness, *, with_it: bool) -> float:
    """Return by how much the slopes that lines say, with or without one of them, miss that one [rad]."""
    some, own = lines.chosen((np.arange(lines.row.size) != k) | with_it), lines.chosen(np.array([k]))
    slopes = solve_jointly(some, grid, rough, np.zeros((0, 0)), with_shares=None).slopes
    s_x, s_y = at_points(slopes, own.row, own.x_m, grid)[0]
    return float((own.misfit_rad + own.d_slope_x * s_x + own.d_slope_y * s_y)[0])


def test_an_edge_that_is_alone_at_its_place_is_refused_where_the_others_say_otherwise() -> None:
    """What is left of it is less than its sigma; its neighbours are not refused in its place."""
    rng = np.random.default_rng(1)
    grid = RowGrid(X_M, np.ones(59, dtype=bool), 1)
    x = np.concatenate([np.arange(-0.9, 0.7, 0.05), [0.85]])
    slope = 1e-3 * np.sin(4 * x) + rng.normal(0, SIGMA_RAD / 2, x.size)
    right = lines_of(np.zeros(x.size, dtype=int), x, slope)
    slope[-1] -= 9e-3
    wrong = lines_of(np.zeros(x.size, dtype=int), x, slope)
    together = solve_jointly(wrong, grid, ROUGH, np.zeros((0, 0)), with_shares=None)
    there = at_points(together.slopes, wrong.row, wrong.x_m, grid)[-1, 0]
    assert abs(there - slope[-1]) < SIGMA_RAD
    assert np.flatnonzero(contradicted_edges(wrong, grid, ROUGH, 4.0).refused).tolist() == [x.size - 1]
    assert not np.any(contradicted_edges(right, grid, ROUGH, 4.0))


def _with_false_ones(n: int, false: np.ndarray, off_rad: float) -> TouchingLines:
    """Return lines that n evenly spaced true edges say on two panels of 1 m, and after them those of false ones."""
    x = np.concatenate([np.linspace(-0.98, 0.98, n), false])
    slope = 1e-3 * np.sin(4 * x) + np.random.default_rng(2).normal(0, SIGMA_RAD / 2, x.size)
    slope[n:] += off_rad
    return lines_of(np.zeros(x.size, dtype=int), x, slope)


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize(("n", "n_false", "off_rad"), [(32, 3, 3e-3), (64, 5, 3e-3), (64, 5, 12e-3), (64, 5, -12e-3)])
def test_false_edges_side_by_side_are_refused_and_no_true_one(n: int, n_false: int, off_rad: float, order: int) -> None:
    lines = _with_false_ones(n, np.linspace(0.4, 0.45, n_false), off_rad)
    grid, rough = RowGrid(X_M, np.arange(59) != 29, 1), Roughness(2.3e-4, 2e-3, order=order)
    found = contradicted_edges(lines, grid, rough, 4.0)
    assert np.flatnonzero(found.refused).tolist() == list(range(n, n + n_false))
    assert not found.undecided.any()


def test_true_edges_between_false_ones_are_kept() -> None:
    """To leave out all of a stretch would lower chi-square as much as to leave out its two ends."""
    lines = _with_false_ones(64, np.array([0.3, 0.3, 0.5]), 12e-3)
    grid = RowGrid(X_M, np.arange(59) != 29, 1)
    found = contradicted_edges(lines, grid, Roughness(2.3e-4, 2e-3), 4.0)
    assert np.flatnonzero(found.refused).tolist() == [64, 65, 66]


@pytest.mark.parametrize("scale", [1e4, 1e7, 1e10])
def test_one_wrong_value_among_nearly_dependent_ones_is_told(scale: float) -> None:
    """Differences of such covariances have no digits left: an edge was refused and taken back without end."""
    rng = np.random.default_rng(0)
    x = np.sort(rng.uniform(0, 1, 100))
    covariance = scale * np.exp(-(((x[:, None] - x) / 0.3) ** 2) / 2) + np.eye(100)
    values = np.linalg.cholesky(covariance) @ rng.normal(size=100)
    values[50] += 12
    assert np.flatnonzero(_fewest_refused(values, covariance, 4.0)).tolist() == [50]


def test_where_a_third_of_the_edges_contradict_the_others_none_of_the_panel_is_believed() -> None:
    lines = _with_false_ones(32, np.linspace(0.4, 0.45, 8), 3e-3)
    found = contradicted_edges(lines, RowGrid(X_M, np.arange(59) != 29, 1), Roughness(2.3e-4, 2e-3), 4.0)
    assert not found.refused.any()
    np.testing.assert_array_equal(found.undecided, lines.x_m > 0)


def test_refused_edges_keep_the_reason_they_had_before_and_undecided_ones_are_doubted() -> None:
    grid, rough = RowGrid(X_M, np.arange(59) != 29, 1), Roughness(2.3e-4, 2e-3)
    lines = _with_false_ones(64, np.linspace(0.4, 0.45, 3), 3e-3)
    used = np.full(67, int(EdgeFate.USED))
    first = used.copy()
    first[64:66] = EdgeFate.WRONG_STEP, EdgeFate.EITHER
    fate = _refuse_contradicted(lines, used, first, grid, rough)
    assert fate[64:].tolist() == [EdgeFate.WRONG_STEP, EdgeFate.EITHER, EdgeFate.BESIDE]
    assert (fate[:64] == EdgeFate.USED).all()
    assert undecided_doubt(fate) is None

    lines = _with_false_ones(32, np.linspace(0.4, 0.45, 8), 3e-3)
    used = np.full(40, int(EdgeFate.USED))
    fate = _refuse_contradicted(lines, used, used, grid, rough)
    np.testing.assert_array_equal(fate == EdgeFate.UNDECIDED, lines.x_m > 0)
    doubt = undecided_doubt(fate)
    assert doubt is not None
    assert doubt.numbers["undecided_share"] == pytest.approx(24 / 40)
