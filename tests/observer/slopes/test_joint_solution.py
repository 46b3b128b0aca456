"""Slopes of many rows with common unknowns: against dense algebra, and scatter against sigma."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from observer.slopes.common_elimination import Reduction
from observer.slopes.edge_likeness import EdgeLikeness
from observer.slopes.joint_solution import RoughnessEvidence, find_roughness, sample_rows, solve_jointly
from observer.slopes.row_spline import Roughness, RowGrid, TouchingLines, assemble, prior_bands


def random_lines(rng: np.random.Generator, grid: RowGrid, m: int, n_common: int) -> TouchingLines:
    return TouchingLines(
        rng.integers(0, grid.n_rows, m),
        rng.uniform(grid.x_m[0], grid.x_m[-1], m),
        rng.normal(0, 1e-3, m),
        rng.normal(-2, 0.2, m),
        rng.normal(0, 0.1, m),
        1e-4 * rng.uniform(1, 2, m),
        rng.integers(0, n_common, (m, 1)),
        rng.normal(-0.07, 0.01, (m, 1)),
    )


def small_grid(n_rows: int = 3) -> RowGrid:
    joined = np.ones(19, dtype=bool)
    joined[9] = False
    return RowGrid(np.linspace(-1, 1, 20), joined, n_rows)


def dense(
    grid: RowGrid, lines: TouchingLines, prior: Roughness, covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Solve all rows and the common unknowns at once."""
    n, c = 2 * grid.x_m.size, len(covariance)
    jacobian = np.zeros((lines.row.size, grid.n_rows * n + c))
    for i in range(lines.row.size):
        position = (lines.x_m[i] - grid.x_m[0]) / grid.step_m
        before = min(int(position), grid.x_m.size - 2)
        share = position - before if grid.joined[before] else round(position - before)
        for node, part in ((before, 1 - share), (before + 1, share)):
            first = lines.row[i] * n + 2 * node
            jacobian[i, first : first + 2] += part * np.array([lines.d_slope_x[i], lines.d_slope_y[i]])
        for k in range(lines.common_index.shape[1]):
            jacobian[i, grid.n_rows * n + lines.common_index[i, k]] += lines.d_common[i, k]
    bands = prior_bands(grid, prior)
    precision = np.zeros((n, n))
    for reach in range(len(bands)):
        for i in range(grid.x_m.size - reach):
            for f in range(2):
                precision[2 * i + f, 2 * (i + reach) + f] = precision[2 * (i + reach) + f, 2 * i + f] = bands[
                    reach, i, f
                ]
    normal = jacobian.T @ (jacobian / lines.sigma_rad[:, None] ** 2)
    for r in range(grid.n_rows):
        normal[r * n : (r + 1) * n, r * n : (r + 1) * n] += precision
    normal[grid.n_rows * n :, grid.n_rows * n :] += np.linalg.inv(covariance)
    inverse = np.linalg.inv(normal)
    return -inverse @ jacobian.T @ (lines.misfit_rad / lines.sigma_rad**2), inverse


@pytest.mark.parametrize(("order", "across"), [(2, 1e-3), (3, 0.1)])
def test_joint_solution_is_that_of_dense_algebra(order: int, across: float) -> None:
    rng = np.random.default_rng(0)
    grid, prior, covariance = small_grid(), Roughness(across, order=order), np.diag([1e-6, 4e-6, 9e-6])
    lines = random_lines(rng, grid, 200, 3)
    found = solve_jointly(lines, grid, prior, covariance)
    solution, inverse = dense(grid, lines, prior, covariance)
    np.testing.assert_allclose(found.slopes.reshape(-1), solution[:-3], rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(found.common, solution[-3:], rtol=1e-8)
    np.testing.assert_allclose(found.covariance_common, inverse[-3:, -3:], rtol=1e-8)
    # The common share is computed in single precision.
    variance = found.random[..., [0, 1], [0, 1]] + found.shared
    np.testing.assert_allclose(variance.reshape(-1), np.diag(inverse)[:-3], rtol=1e-6)


def test_unknowns_shown_apart_are_what_they_do_with_the_others_following() -> None:
    rng = np.random.default_rng(1)
    grid, prior, covariance = small_grid(), Roughness(1e-3), np.diag([1e-6, 4e-6, 9e-6])
    lines = random_lines(rng, grid, 200, 3)
    own = np.array([True, False, True])
    found = solve_jointly(lines, grid, prior, covariance, with_shares=own)
    _, inverse = dense(grid, lines, prior, covariance)
    held = np.zeros((3, 3))
    held[np.ix_(own, own)] = np.linalg.inv(np.linalg.inv(inverse[-3:, -3:])[np.ix_(own, own)])
    by_common = np.linalg.lstsq(inverse[-3:, -3:], inverse[-3:, :-3], rcond=None)[0]
    together = np.diag(by_common.T @ inverse[-3:, -3:] @ by_common).reshape(3, 20, 2)
    others = np.diag(by_common.T @ held @ by_common).reshape(3, 20, 2)
    np.testing.assert_allclose(found.shared, together, rtol=1e-5)
    np.testing.assert_allclose(np.square(found.modes).sum(axis=0), others[..., 0], rtol=0.02, atol=0.02 * others.max())
    apart = together[..., 0] - others[..., 0]
    np.testing.assert_allclose(np.square(found.modes_apart).sum(axis=0), apart, rtol=1e-4, atol=1e-6 * apart.max())


def test_patterns_beside_the_common_unknowns_are_found_as_unknowns_of_their_own_would_be() -> None:
    rng = np.random.default_rng(6)
    grid, prior, covariance = small_grid(), Roughness(1e-3), np.diag([1e-6, 4e-6, 9e-6])
    lines = random_lines(rng, grid, 200, 3)
    patterns, deviation = rng.normal(0, 1e-3, (200, 2)), np.array([3.0, 0.5])
    found = Reduction(lines, grid, covariance).under(prior, beside=(patterns, deviation)).beside
    more = replace(
        lines,
        common_index=np.column_stack([lines.common_index, np.tile([3, 4], (200, 1))]),
        d_common=np.column_stack([lines.d_common, patterns]),
    )
    solution, inverse = dense(grid, more, prior, np.diag([1e-6, 4e-6, 9e-6, *deviation**2]))
    np.testing.assert_allclose(found.amount, solution[-2:], rtol=1e-8)
    np.testing.assert_allclose(found.covariance, inverse[-2:, -2:], rtol=1e-8)


def test_evidence_is_that_of_dense_algebra() -> None:
    rng = np.random.default_rng(7)
    grid, covariance = small_grid(), np.diag([1e-6, 4e-6, 9e-6])
    lines = random_lines(rng, grid, 200, 3)
    reduction, found, expected = Reduction(lines, grid, covariance), [], []
    for prior in (Roughness(1e-3), Roughness(1e-4, 1e-3)):
        solution, inverse = dense(grid, lines, prior, covariance)
        bands = prior_bands(grid, prior)
        spread = np.zeros((40, 40))
        for reach in range(3):
            for i in range(20 - reach):
                for f in range(2):
                    spread[2 * i + f, 2 * (i + reach) + f] = spread[2 * (i + reach) + f, 2 * i + f] = bands[reach, i, f]
        # log p = (log |prior| - log |normal| + b^T normal^-1 b) / 2, but for what no roughness changes.
        determinant = 3 * np.linalg.slogdet(spread)[1] + np.linalg.slogdet(inverse)[1]
        expected.append(0.5 * (determinant + solution @ np.linalg.solve(inverse, solution)))
        found.append(reduction.under(prior).evidence)
    assert found[1] - found[0] == pytest.approx(expected[1] - expected[0], rel=1e-7)


def test_evidence_of_many_rows_by_themselves_is_that_of_their_solution() -> None:
    rng, grid = np.random.default_rng(8), small_grid(70)
    lines = random_lines(rng, grid, 2000, 1).alone(rng.normal(0, 1e-3, 2000), np.full(2000, 1e-4))
    rows, reduction = assemble(lines, grid), Reduction(lines, grid, np.zeros((0, 0)))
    pulls = rows.right_sides(lines.misfit_rad / lines.sigma_rad)
    for prior in (Roughness(1e-3), Roughness(1e-3, 1e-3, 1.0, 3)):
        assert rows.evidence(prior, pulls) == pytest.approx(reduction.under(prior).evidence, rel=1e-10)


@pytest.mark.parametrize("order", [2, 3])
def test_panels_do_not_know_of_each_other(order: int) -> None:
    rng = np.random.default_rng(2)
    grid, prior = small_grid(1), Roughness(1e-3, order=order)
    lines = random_lines(rng, grid, 80, 1)
    left = lines.chosen(lines.x_m < 0)
    for one in (lines, left):
        rows = assemble(one, grid)
        slopes = rows.under(prior).factor.solve(rows.right_sides(-one.misfit_rad / one.sigma_rad)).reshape(1, 20, 2)
        if one is lines:
            whole = slopes
    np.testing.assert_allclose(slopes[:, :10], whole[:, :10], rtol=1e-12)
    assert np.abs(slopes[:, 10:, 0]).max() < 1e-12 < np.abs(whole[:, 10:, 0]).max()


@pytest.mark.parametrize("order", [2, 3])
def test_prior_leaves_polynomials_of_a_panel_free_and_has_the_stated_differences(order: int) -> None:
    grid, across = small_grid(1), 0.02
    bands = prior_bands(grid, Roughness(across, order=order))[..., 0]
    precision = sum(
        np.diag(bands[i, : 20 - i], -i) + (i > 0) * np.diag(bands[i, : 20 - i], i) for i in range(order + 1)
    )
    precision -= np.diag(np.full(20, 0.05**-2))
    left = np.where(grid.x_m < 0, 1.0, 0.0)
    for power in range(order):
        assert np.abs(precision @ (left * grid.x_m**power)).max() < 1e-9 * np.abs(precision).max()
    # One sigma of each of the 10 - order differences of a panel.
    wave = left * np.cumprod(np.full(20, -1.0))
    expected = (10 - order) * (2.0**order) ** 2 / (across * grid.step_m ** (2 * order - 1))
    assert wave @ precision @ wave == pytest.approx(expected, rel=1e-9)


def wavy_lines(rng: np.random.Generator, *, kinks: bool) -> tuple[RowGrid, TouchingLines]:
    """Sample waves of 0.7 m, or a mirror that bends abruptly each 0.2 m."""
    grid = RowGrid(np.linspace(-2.4, 2.4, 100), np.ones(99, dtype=bool), 20)
    row, x = np.repeat(np.arange(20), 80), rng.uniform(-2.38, 2.38, 1600)
    knots = np.arange(-2.4, 2.6, 0.2)
    height = rng.normal(0, 1e-3, (20, knots.size))
    if kinks:
        value = np.array([np.interp(at, knots, height[k]) for k, at in zip(row, x, strict=True)])
    else:
        value = 2e-3 * np.sin(9.0 * x + 0.3 * row)
    misfit = 2 * value + rng.normal(0, 2e-5, x.size)
    none = np.zeros(x.size)
    return grid, TouchingLines(
        row,
        x,
        misfit,
        np.full(x.size, -2.0),
        none,
        none + 2e-5,
        np.zeros((x.size, 0), dtype=np.intp),
        np.zeros((x.size, 0)),
    )


@pytest.mark.parametrize("kinks", [False, True])
def test_waves_are_told_from_kinks(kinks: bool) -> None:
    grid, lines = wavy_lines(np.random.default_rng(3), kinks=kinks)
    for start in (2, 3):
        prior = Roughness(1e-2, along_rad=1e-6, order=start)
        evidence = RoughnessEvidence(lines, grid, np.zeros((0, 0)))
        assert find_roughness(evidence, prior, any_order=True).order == (2 if kinks else 3)
        assert find_roughness(evidence, prior).order == start


def test_rows_without_lines_are_no_sample_where_most_have_none() -> None:
    rng = np.random.default_rng(2)
    grid, covariance = small_grid(7), np.diag([1e-6, 4e-6, 9e-6])
    # Shadows may leave most rows without any edge.
    lines = random_lines(rng, grid, 200, 3)
    lines = lines.chosen((lines.row == 1) | (lines.row == 4))
    assert sample_rows(lines, grid, 5).tolist() == [1, 4]
    found = solve_jointly(lines, grid, Roughness(1e-3), covariance)
    assert np.abs(found.slopes[[0, 2, 3, 5, 6]]).max() == 0
    assert np.isfinite(found.shared).all()


def test_rows_without_lines_are_no_sample() -> None:
    rng = np.random.default_rng(8)
    grid = RowGrid(np.linspace(-1, 1, 20), np.ones(19, dtype=bool), 12)
    lines = random_lines(rng, grid, 1200, 1)
    middle = lines.chosen((lines.row >= 2) & (lines.row < 11))
    np.testing.assert_array_equal(sample_rows(middle, grid, 3), [2, 6, 10])
    found = solve_jointly(middle, grid, Roughness(1e-3), np.array([[1e-6]]))
    # Beyond the last of them the share of what all rows have in common is that of the last.
    assert (found.shared[[0, 1, 11], :, 0].mean(axis=1) > 0.5 * found.shared[5, :, 0].mean()).all()


def drawn(rng: np.random.Generator, grid: RowGrid, prior: Roughness) -> np.ndarray:
    """Draw slope errors from the prior itself: panel by panel an integrated random walk."""
    slopes = np.zeros((grid.n_rows, grid.x_m.size))
    starts = np.concatenate([[0], np.nonzero(~grid.joined)[0] + 1, [grid.x_m.size]])
    for first, last in pairwise(starts):
        bends = rng.normal(0, np.sqrt(prior.across * grid.step_m**3), (grid.n_rows, last - first))
        slopes[:, first:last] = np.cumsum(np.cumsum(bends, axis=1), axis=1) + rng.normal(0, 2e-3, (grid.n_rows, 1))
    return slopes


def measured(seed: int) -> tuple[float, float, float]:
    """Simulate a mirror drawn from the prior; return mean squares of error over sigma, slopes and cameras."""
    rng = np.random.default_rng(seed)
    truth_prior = Roughness(1e-4, along_rad=1e-6)
    joined = np.ones(99, dtype=bool)
    joined[49] = False
    grid = RowGrid(np.linspace(-2.4, 2.4, 100), joined, 60)
    slopes = drawn(rng, grid, truth_prior)
    n_photos, sigma_eye = 60, 4e-3
    eyes = rng.normal(0, sigma_eye, n_photos)
    row, photo = (part.reshape(-1) for part in np.meshgrid(np.arange(60), np.arange(n_photos), indexing="ij"))
    row, photo = np.tile(row, 2), np.tile(photo, 2)
    side = np.repeat([1.0, -1.0], row.size // 2)
    x = np.linspace(-2.6, 2.6, n_photos)[photo] + 0.33 * side + rng.uniform(-0.01, 0.01, row.size)
    keep = np.abs(x) < 2.39
    row, photo, x = row[keep], photo[keep], x[keep]
    sigma = np.full(row.size, 5e-5)
    value = np.array([np.interp(x[i], grid.x_m, slopes[row[i]]) for i in range(row.size)])
    inner = np.abs(x) > 0.06
    misfit = 2 * value - eyes[photo] / 14.0 + rng.normal(0, sigma)
    lines = TouchingLines(
        row,
        x,
        misfit,
        np.full(row.size, -2.0),
        np.zeros(row.size),
        sigma,
        photo[:, None],
        np.full((row.size, 1), 1 / 14.0),
    ).chosen(inner)
    covariance = sigma_eye**2 * np.eye(n_photos)
    prior = find_roughness(RoughnessEvidence(lines, grid, covariance), Roughness(1.0, along_rad=1e-6))
    assert abs(np.log10(prior.across / truth_prior.across)) < 1.0
    found = solve_jointly(lines, grid, truth_prior, covariance)
    errors = found.common - eyes
    chi_square = float(errors @ np.linalg.solve(found.covariance_common, errors)) / n_photos
    sigma_slopes = np.sqrt(found.random[..., 0, 0] + found.shared[..., 0])
    ratio = (found.slopes[..., 0] - slopes) / sigma_slopes
    return float(np.mean(ratio**2)), chi_square, float(errors.std() / sigma_eye)


def test_errors_have_the_stated_sigma_and_cameras_are_found_better_than_known() -> None:
    found = np.array([measured(seed) for seed in range(6)])
    # A few smooth patterns, which cameras and slopes share, dominate: about ten independent ones in each simulation.
    assert found[:, 0].mean() == pytest.approx(1.0, abs=0.25)
    assert found[:, 1].mean() == pytest.approx(1.0, abs=0.2)
    assert (found[:, 2] < 0.5).all()


@pytest.mark.parametrize("count", [2, 5, 30, 90])
def test_modes_are_as_many_as_hold_the_variance_that_is_shared(count: int) -> None:
    """They lack 1 % of the variance over the map at most, and would lack more without the weakest."""
    rng = np.random.default_rng(11)
    grid = small_grid(8)
    lines = random_lines(rng, grid, 800, count)
    found = solve_jointly(lines, grid, Roughness(1e-3), np.diag(np.linspace(1.0, 4.0, count)) * 1e-6)
    whole = found.shared[found.mode_rows, :, 0].sum()
    each = (found.modes**2).sum(axis=(1, 2))
    assert 0.989 * whole < each.sum() < 1.001 * whole
    assert each.sum() - each.min() < 0.99 * whole
    products = np.einsum("irx,jrx->ij", found.modes, found.modes)
    assert np.abs(products - np.diag(each)).max() < 1e-4 * each.max()
    # More than the ten that were kept whatever they held.
    assert (len(each) > 20) == (count >= 30)


def test_rows_whose_edges_err_together_say_less_of_what_they_have_in_common() -> None:
    rng = np.random.default_rng(8)
    grid, y_m = small_grid(6), np.linspace(0, 1, 6)
    lines, covariance = random_lines(rng, grid, 600, 3), 0.5 * np.eye(3)
    likeness = EdgeLikeness(0.4, 0.5)
    larger = replace(lines, sigma_rad=likeness.counted(y_m) * lines.sigma_rad)
    found = solve_jointly(lines, grid, Roughness(1e-4), covariance, enlarged=lambda rows: likeness.counted(y_m[rows]))
    common = solve_jointly(larger, grid, Roughness(1e-4), covariance)
    np.testing.assert_allclose(found.common, common.common, rtol=1e-9)
    np.testing.assert_allclose(found.covariance_common, common.covariance_common, rtol=1e-9)
    # Each row by itself knows as much as before.
    np.testing.assert_allclose(found.random, solve_jointly(lines, grid, Roughness(1e-4), covariance).random, rtol=1e-12)


def test_slopes_have_from_the_common_unknowns_what_their_own_edges_make_of_these() -> None:
    """The common unknowns are known less well than by edges that err by themselves; slopes follow them by all edges."""
    rng = np.random.default_rng(8)
    grid, prior, covariance, factor = small_grid(6), Roughness(1e-4), 0.5 * np.eye(3), 1.62
    lines = random_lines(rng, grid, 600, 3)
    found = solve_jointly(lines, grid, prior, covariance, enlarged=lambda rows: factor)
    _, inverse = dense(grid, lines, prior, covariance)
    _, weaker = dense(grid, replace(lines, sigma_rad=factor * lines.sigma_rad), prior, covariance)
    np.testing.assert_allclose(found.covariance_common, weaker[-3:, -3:], rtol=1e-8)
    carried = np.linalg.solve(inverse[-3:, -3:], inverse[-3:, :-3])
    shared = np.diag(carried.T @ weaker[-3:, -3:] @ carried).reshape(found.shared.shape)
    np.testing.assert_allclose(found.shared, shared, rtol=1e-5)
    np.testing.assert_allclose(np.square(found.modes).sum(axis=0), shared[..., 0], rtol=0.02, atol=0.02 * shared.max())
