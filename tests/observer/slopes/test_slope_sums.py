"""Covariance of weighted sums of slopes against dense algebra."""

from dataclasses import replace

import numpy as np
import pytest

from heliogauge.flags import SampleFlag
from heliogauge.slopes.map import SlopeMap, no_common_modes
from observer.slopes.along_variance import PossibleRoughness, averaged
from observer.slopes.joint_solution import solve_jointly
from observer.slopes.row_spline import Roughness, TouchingLines, assemble, prior_bands
from observer.slopes.slope_sums import AveragedSums, SlopeSums, noise_correlation, with_bridged
from tests.observer.slopes.test_joint_solution import dense, random_lines, small_grid


@pytest.mark.parametrize(("order", "across"), [(2, 1e-3), (3, 0.1)])
def test_sums_have_the_covariance_of_dense_algebra(order: int, across: float) -> None:
    rng = np.random.default_rng(5)
    grid, prior, covariance = small_grid(), Roughness(across, order=order), np.diag([1e-6, 4e-6, 9e-6])
    lines = random_lines(rng, grid, 200, 3)
    found = solve_jointly(lines, grid, prior, covariance)
    weights = rng.normal(0, 1, (12, 3, 20))
    # Rows without weights are not solved: the first, the last, all but one, all.
    weights[1, 0] = weights[2, 2] = weights[3, :2] = weights[4] = 0.0
    flat = np.zeros((12, 123))
    flat[:, :120:2] = weights.reshape(12, 60)
    _, inverse = dense(grid, lines, prior, covariance)
    sums = SlopeSums(lines, grid, prior, found.covariance_common)(weights)
    np.testing.assert_allclose(sums, flat @ inverse @ flat.T, rtol=1e-8, atol=1e-9 * np.abs(sums).max())


def test_sums_over_models_are_those_of_a_mixture() -> None:
    rng = np.random.default_rng(6)
    grid, covariance = small_grid(), np.diag([1e-6, 4e-6, 9e-6])
    lines = random_lines(rng, grid, 200, 3)
    models = [PossibleRoughness(p, Roughness(1e-3, along_length_m=m)) for p, m in ((0.7, 3.0), (0.3, 0.3))]
    found = [solve_jointly(lines, grid, one.roughness, covariance) for one in models]
    both = averaged(models, found)
    apart = np.stack([one.slopes[..., 0] - both.slopes[..., 0] for one in found])
    each = [SlopeSums(lines, grid, one.roughness, found[0].covariance_common) for one in models]
    weights = rng.normal(0, 1, (2, 3, 20))
    weights[1] = 0.0
    weights[1, 2, 5] = 1.0
    mean = [(weights * one.slopes[..., 0]).sum(axis=(1, 2)) for one in (*found, both)]
    within = 0.7 * each[0](weights) + 0.3 * each[1](weights)
    expected = within + 0.21 * np.outer(mean[0] - mean[1], mean[0] - mean[1])
    np.testing.assert_allclose(AveragedSums(each, np.array([0.7, 0.3]), apart)(weights), expected, rtol=1e-9)
    # A sum that is one node has that node's variance.
    alone = AveragedSums(each, np.array([0.7, 0.3]), apart).without_common(weights)
    assert alone[1, 1] == pytest.approx(both.random[2, 5, 0, 0], rel=1e-9)
    np.testing.assert_allclose(both.slopes, 0.7 * found[0].slopes + 0.3 * found[1].slopes, rtol=1e-12)


def _alone(lines: TouchingLines) -> TouchingLines:
    return lines.alone(lines.misfit_rad, lines.sigma_rad)


def test_slopes_that_rows_share_err_together() -> None:
    """The scatter of sums over mirrors that are alike along the rows, seen with noise and solved row by row.

    Slopes across and along are so over other lengths.
    """
    rng = np.random.default_rng(11)
    grid, prior = small_grid(), Roughness(1e-3)
    # All rows see the same few places, as photos 0.4 m apart do.
    one = _alone(random_lines(rng, grid, 8, 1))
    lines = replace(one.chosen(np.tile(np.arange(8), 3)), row=np.repeat(np.arange(3), 8))
    bands = prior_bands(grid, prior)
    size = 2 * grid.x_m.size
    precision = np.zeros((size, size))
    for reach, band in enumerate(bands):
        first = np.arange(size - 2 * reach)
        precision[first, first + 2 * reach] = precision[first + 2 * reach, first] = band.ravel()[: first.size]
    apart_m = np.abs(np.subtract.outer(np.arange(3), np.arange(3)))
    alike, alike_along = np.exp(-apart_m / 5.0), np.exp(-apart_m / 0.5)
    of_node = np.linalg.inv(precision)
    of_rows = np.kron(alike, of_node)
    # What is across and what is along have nothing in common beforehand.
    of_rows[1::2, 1::2] = np.kron(alike_along, of_node[1::2, 1::2])
    derivatives = assemble(lines, grid).derivatives().toarray()
    normal = derivatives.T @ derivatives + np.kron(np.eye(3), precision)
    # Errors are what the estimate lacks of the mirror, and what noise of unit variance makes.
    lacks = np.linalg.solve(normal, derivatives.T @ derivatives) - np.eye(3 * size)
    from_noise = np.linalg.solve(normal, derivatives.T)
    whole = lacks @ of_rows @ lacks.T + from_noise @ from_noise.T
    weights = np.stack([np.ones((3, 20)), rng.normal(0, 1, (3, 20)), np.eye(3)[[1]].T * np.ones(20)])
    flat = np.zeros((3, 3 * size))
    flat[:, 0::2] = weights.reshape(3, -1)
    sums = SlopeSums(lines, grid, prior, np.zeros((0, 0)), alike=alike, alike_along=alike_along)(weights)
    expected = flat @ whole @ flat.T
    np.testing.assert_allclose(sums, expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())
    apart = SlopeSums(lines, grid, prior, np.zeros((0, 0)))(weights)
    assert sums[0, 0] > 1.5 * apart[0, 0]  # three rows, nearly one: 2.7 times


def test_noise_correlation_is_that_of_sums_over_panels() -> None:
    """Nodes that err alike in blocks of 2 x 3: six times the variance of independent nodes."""
    shape, sigma = (6, 6), 1e-4
    zero, x, y = np.zeros(shape), np.arange(6.0), np.arange(6.0)
    panel = np.repeat([0, 0, 0, 1, 1, 1], 6).reshape(6, 6).T
    slope_map = SlopeMap(
        x,
        y,
        zero,
        zero,
        zero,
        zero,
        zero + sigma,
        zero + sigma,
        1.0,
        no_common_modes(),
        zero,
        np.zeros(shape, dtype=np.uint32),
        np.ones(shape, dtype=bool),
        "d",
        "f",
        "nothing",
    )

    def of_blocks(weights: np.ndarray) -> np.ndarray:
        blocks = weights.reshape(-1, 3, 2, 2, 3).sum(axis=(2, 4)).reshape(len(weights), -1)
        return sigma**2 * blocks @ blocks.T

    def apart(weights: np.ndarray) -> np.ndarray:
        flat = weights.reshape(len(weights), -1)
        return sigma**2 * flat @ flat.T

    # Means have six; bends across blocks of a panel's width have none, and the median is between.
    assert noise_correlation(of_blocks, slope_map, panel) == pytest.approx(3.0)
    assert noise_correlation(apart, slope_map, panel) == pytest.approx(1.0)
    assert noise_correlation(apart, slope_map, np.full(shape, -1)) == 1.0


def test_bridged_nodes_err_as_the_nearest_that_have_a_value() -> None:
    """Rows 2 to 4 of a column have no edges: their own solution is the prior, their values are those of 1 and 5."""
    sigma = np.full((6, 3), 1e-4)
    sigma[2:5, 1] = 5e-3
    flags = np.zeros((6, 3), dtype=np.uint32)
    flags[2:5, 1] = np.uint32(SampleFlag.SMOOTHED_GAP)
    zero, x, y = np.zeros((6, 3)), np.arange(3.0), np.arange(6.0)
    slope_map = SlopeMap(
        x,
        y,
        zero,
        zero,
        zero,
        zero,
        sigma,
        sigma,
        1.0,
        no_common_modes(),
        zero,
        flags,
        np.ones((6, 3), dtype=bool),
        "d",
        "f",
        "nothing",
    )

    def of_rows(weights: np.ndarray) -> np.ndarray:
        return np.einsum("kij,lij->kl", weights * sigma**2, weights)

    one = np.zeros((2, 6, 3))
    one[0, 1:6, 1], one[1, :, 0] = 1.0, 1.0
    found = with_bridged(of_rows, slope_map)(one)
    # Rows 2 and 3 err as row 1 (of two that are as near the first), row 4 as row 5: weights 3 and 2.
    np.testing.assert_allclose(found, np.diag([13e-8, 6e-8]), rtol=1e-12)
