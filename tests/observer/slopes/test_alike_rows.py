"""Rows that are alike along the trough against dense algebra."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array

from observer.slopes.alike_rows import AlikeFactor
from observer.slopes.common_elimination import Reduction
from observer.slopes.row_spline import LARGEST_SLOPE_RAD, Likeness, Roughness, RowGrid, prior_bands
from tests.observer.slopes.test_joint_solution import random_lines, small_grid

Y_M = np.array([0.0, 0.3, 1.1])


def grid_along() -> RowGrid:
    return replace(small_grid(Y_M.size), y_m=Y_M)


def alike(across: float, order: int, length_m: float) -> Roughness:
    return Roughness(3e-3, order=5 - order, alike=Likeness(across, order, length_m))


def dense_prior(grid: RowGrid, stated: Roughness) -> np.ndarray:
    """Return the prior's precision of all rows' slopes across and along, shape (r nx 2, r nx 2).

    Rows are alike by a Matern correlation of the order 3/2, but for a thousandth.
    """
    assert stated.alike is not None
    prior = replace(stated, across=stated.alike.across, order=stated.alike.order)
    bands, n = prior_bands(grid, prior), grid.x_m.size
    one = np.zeros((n, 2, n, 2))
    for reach, band in enumerate(bands):
        for node in range(n - reach):
            for axis in range(2):
                one[node, axis, node + reach, axis] = one[node + reach, axis, node, axis] = band[node, axis]
    walk = one[:, 0, :, 0] - np.eye(n) / LARGEST_SLOPE_RAD**2
    if prior.order == 3:
        # Within pieces of ten nodes the bend's change is remembered over their length.
        panel_m = 10 * grid.step_m
        for first in (*range(8), *range(10, 18)):
            second = np.zeros(n)
            second[first : first + 3] = 1.0, -2.0, 1.0
            walk += np.outer(second, second) / (prior.across * panel_m**2 * grid.step_m**3)
    away = np.sqrt(3) * np.abs(Y_M[:, None] - Y_M) / stated.alike.length_m
    correlation = 0.999 * (1 + away) * np.exp(-away) + 0.001 * np.eye(Y_M.size)
    whole = np.einsum("rs,nimj->rnismj", np.eye(Y_M.size), one)
    across = np.einsum("rs,nm->rnsm", np.linalg.inv(correlation), walk)
    whole[:, :, 0, :, :, 0] = across + np.einsum("rs,nm->rnsm", np.eye(Y_M.size), np.eye(n) / LARGEST_SLOPE_RAD**2)
    return whole.reshape(2 * n * Y_M.size, -1)


@pytest.mark.parametrize("order", [2, 3])
def test_rows_that_are_alike_are_those_of_dense_algebra(order: int) -> None:
    grid, covariance = grid_along(), np.diag([1e-6, 4e-6, 9e-6])
    lines = random_lines(np.random.default_rng(3), grid, 200, 3)
    reduction, evidences, dense_evidences = Reduction(lines, grid, covariance), [], []
    columns = np.array([2, 7])
    for prior in (alike(1e-3, order, 0.8), alike(1e-2, order, 20.0)):
        found = reduction.under(prior)
        before = np.clip(((lines.x_m - grid.x_m[0]) / grid.step_m).astype(int), 0, grid.x_m.size - 2)
        share = (lines.x_m - grid.x_m[before]) / grid.step_m
        apart = ~grid.joined[before]
        share[apart] = np.round(share[apart])
        design = np.zeros((lines.row.size, grid.n_rows, grid.x_m.size, 2))
        every = np.arange(lines.row.size)
        for node, part in ((before, 1 - share), (before + 1, share)):
            design[every, lines.row, node, 0] += part * lines.d_slope_x
            design[every, lines.row, node, 1] += part * lines.d_slope_y
        common = np.zeros((lines.row.size, 3))
        for k in range(lines.common_index.shape[1]):
            common[every, lines.common_index[:, k]] += lines.d_common[:, k]
        by_slopes = design.reshape(lines.row.size, -1)
        precision = dense_prior(grid, prior)
        # The misfits are -B s - D c + noise.
        scatter = by_slopes @ np.linalg.solve(precision, by_slopes.T) + np.diag(lines.sigma_rad**2)
        normal = common.T @ np.linalg.solve(scatter, common) + np.linalg.inv(covariance)
        np.testing.assert_allclose(found.normal, normal, rtol=1e-6, atol=1e-6 * np.abs(normal).max())
        pulled = common.T @ np.linalg.solve(scatter, lines.misfit_rad)
        np.testing.assert_allclose(found.common, -np.linalg.solve(normal, pulled), rtol=1e-6)
        whole = scatter + common @ covariance @ common.T
        evidences.append(found.evidence)
        dense_evidences.append(
            -0.5 * (np.linalg.slogdet(whole)[1] + lines.misfit_rad @ np.linalg.solve(whole, lines.misfit_rad))
        )
        # Slopes follow row by row, by the rows' own roughness.
        rows = reduction.carried(replace(prior, alike=None), columns)
        np.testing.assert_allclose(reduction.carried(prior, columns), rows, rtol=1e-12)
    # But for a constant.
    assert np.diff(evidences) == pytest.approx(np.diff(dense_evidences), rel=1e-6)


def test_rows_that_are_hardly_alike_are_independent() -> None:
    grid, covariance = grid_along(), np.diag([1e-6, 4e-6, 9e-6])
    reduction = Reduction(random_lines(np.random.default_rng(4), grid, 200, 3), grid, covariance)
    alone, hardly = (reduction.under(Roughness(1e-3, alike=one)) for one in (None, Likeness(1e-3, 2, 0.01)))
    np.testing.assert_allclose(hardly.common, alone.common, rtol=1e-6)
    np.testing.assert_allclose(hardly.normal, alone.normal, rtol=1e-6, atol=1e-6 * np.abs(alone.normal).max())
    assert hardly.evidence == pytest.approx(alone.evidence, rel=1e-8)


@pytest.mark.parametrize("border", [40, 34, 3])
def test_explained_is_that_of_the_solution_where_columns_begin_late(
    border: int, capfd: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(5)
    n_rows, n_nodes, reach = 2, 40, 3
    width = 2 * n_rows
    turned = np.tril(rng.normal(size=(n_nodes, width, width)) * 0.1) + np.eye(width)
    below = rng.normal(size=(n_nodes, reach, width, width)) * 0.1
    for away in range(1, reach + 1):
        below[n_nodes - away :, away - 1] = 0.0
        # Nothing ties one panel to the next.
        below[max(border - away, 0) : border, away - 1] = 0.0
    ends = np.where(np.arange(n_nodes) < border, border, n_nodes)
    factor = AlikeFactor(turned, below, n_rows, ends)
    # The first sixteen nodes, which are summed at once, touch none of the columns.
    pulls = np.zeros((n_rows, n_nodes, 2, 5))
    pulls[:, 20, :, :3] = rng.normal(size=(n_rows, 2, 3))
    pulls[:, 33:35, :, 3:] = rng.normal(size=(n_rows, 2, 2, 2))
    columns = pulls.reshape(-1, 5)
    solved = factor.solve(columns.T.reshape(5, n_rows, 2 * n_nodes)).reshape(5, -1)

    explained = factor.explained(csr_array(columns))

    np.testing.assert_allclose(explained, solved @ columns, rtol=1e-10, atol=1e-12)
    assert capfd.readouterr() == ("", "")
