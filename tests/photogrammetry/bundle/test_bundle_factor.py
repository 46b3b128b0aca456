"""Factor by blocks against the whole matrix: the same estimates, covariances and tests."""

import numpy as np
import pytest

from photogrammetry.bundle.adjustment import adjust
from photogrammetry.bundle.constraints import Coordinate, Distance
from photogrammetry.bundle.factor import BlockFactor, BorderedBlocks, DenseFactor
from photogrammetry.bundle.problem import BundleProblem, CameraModel
from photogrammetry.bundle.statistics import examine_image_points
from tests.photogrammetry.bundle.test_bundle import CASES, problem_of, small
from tests.photogrammetry.bundle_networks import disturbed, network


def arrow(rng, n_poses, n_others):
    """A positive definite bordered matrix with ties that leave it so, and the same written out."""
    size = 6 * n_poses + n_others
    roots = rng.normal(size=(n_poses, 6, 6)) + 3 * np.eye(6)
    corner = rng.normal(size=(n_others, n_others)) + 4 * np.eye(n_others)
    border = 0.1 * rng.normal(size=(6 * n_poses, n_others))
    blocks = BorderedBlocks(roots @ np.swapaxes(roots, 1, 2), border, corner @ corner.T + np.eye(n_others))
    minus, plus = 0.05 * rng.normal(size=(size, 7)), rng.normal(size=(size, 2))
    return blocks, minus, plus, blocks.whole() - minus @ minus.T + plus @ plus.T


def test_whole_matrix_has_blocks_border_and_corner_where_they_belong():
    rng = np.random.default_rng(1)
    blocks, *_ = arrow(rng, 3, 2)
    whole = blocks.whole()
    np.testing.assert_array_equal(whole, whole.T)
    np.testing.assert_array_equal(whole[6:12, 6:12], blocks.poses[1])
    assert (whole[:6, 6:18] == 0).all()
    np.testing.assert_array_equal(whole[:18, 18:], blocks.border)
    np.testing.assert_array_equal(np.diagonal(whole), blocks.diagonal)
    scale = rng.uniform(0.5, 2, 20)
    wanted = whole / scale[:, None] / scale + 0.3 * np.eye(20)
    np.testing.assert_allclose(blocks.scaled(scale, 0.3).whole(), wanted, rtol=1e-14)


@pytest.mark.parametrize("n_others", [0, 4])
def test_factor_is_that_of_the_whole_matrix(n_others):
    rng = np.random.default_rng(2)
    blocks, minus, plus, whole = arrow(rng, 5, n_others)
    inverse, own = np.linalg.inv(whole), BlockFactor(blocks, minus, plus)
    right = rng.normal(size=(len(whole), 3))
    np.testing.assert_allclose(own.solve(right), inverse @ right, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(own.half(right).T @ own.half(right), right.T @ inverse @ right, rtol=1e-10)
    np.testing.assert_allclose(own.solve(right[:, 0]), inverse @ right[:, 0], rtol=1e-10, atol=1e-12)
    columns = np.array([1, 7, 8, len(whole) - 1, 0, 2])
    dense = DenseFactor(whole.copy())
    for one in (own, dense):
        np.testing.assert_allclose(one.inverse(columns), inverse[np.ix_(columns, columns)], rtol=1e-9, atol=1e-13)
        pairs = one.inverse_blocks(columns.reshape(2, 3))
        np.testing.assert_allclose(pairs[1], inverse[np.ix_(columns[3:], columns[3:])], rtol=1e-9, atol=1e-13)


def test_nearly_singular_matrix_is_left_to_the_whole():
    blocks = BorderedBlocks(np.tile(np.eye(6), (4, 1, 1)), np.zeros((24, 0)), np.zeros((0, 0)))
    tie = np.zeros((24, 1))
    tie[:2, 0] = np.sqrt(0.5)
    with pytest.raises(np.linalg.LinAlgError):
        BlockFactor(blocks, tie, np.zeros((24, 0)))


@pytest.mark.parametrize("case", CASES)
def test_adjustment_by_blocks_is_the_same(case, monkeypatch):
    rng, truth, points = small()
    problem, start = problem_of(case, truth, points), disturbed(truth, rng)
    found = []
    for by_blocks in (False, True):
        monkeypatch.setattr(BlockFactor, "pays", staticmethod(lambda *_, answer=by_blocks: answer))
        result = adjust(problem, start)
        # Constraints a million times as sharp as image points are left to the whole matrix.
        assert isinstance(result.system.undamped.factor, BlockFactor) == (by_blocks and case != "mixed")
        assert result.converged
        joint = result.covariance.joint([0, 4, 11], np.arange(8), intrinsics=True)
        found.append((result, joint, examine_image_points(result).redundancy))
    (dense, joint, redundancy), (blocks, other, shares) = found
    # Held coordinates have a variance of 0 to rounding, 20 times 2e-16 of the 2e-8 m^2 that the datum takes away.
    sigma = np.sqrt(np.maximum(np.diag(joint), 1e-17))
    np.testing.assert_allclose(blocks.points_m, dense.points_m, atol=1e-4 * dense.sigma_points_m.max())
    np.testing.assert_allclose(other / sigma[:, None] / sigma, joint / sigma[:, None] / sigma, atol=1e-5)
    np.testing.assert_allclose(shares, redundancy, atol=1e-6)
    np.testing.assert_allclose(blocks.covariance.points, dense.covariance.points, atol=1e-5 * sigma.max() ** 2)
    np.testing.assert_allclose(blocks.covariance.poses, dense.covariance.poses, atol=1e-5 * sigma.max() ** 2)
    assert blocks.rank == dense.rank


def test_many_photos_of_few_targets_take_blocks_and_name_what_is_lost():
    rng = np.random.default_rng(3)
    truth, points = network(rng, n_photos=60, n_points=12)
    listed = [
        Coordinate(f"t{i}", axis, float(truth.points_m[i, k]), 1e-3) for i in range(12) for k, axis in enumerate("xyz")
    ]
    bar = Distance("t0", "t5", float(np.linalg.norm(truth.points_m[5] - truth.points_m[0])), 1e-3)
    free = BundleProblem(points, (CameraModel("c", ()),))
    held = BundleProblem(points, (CameraModel("c", ()),), constraints=(*listed, bar))
    for problem in (free, held):
        result = adjust(problem, truth)
        assert isinstance(result.system.undamped.factor, BlockFactor)
        assert result.converged
        assert result.sigma0 == pytest.approx(1.0, abs=0.1)
    # A photo with two targets cannot be placed: lost directions are found by the whole matrix.
    keep = (points.photo_index != 7) | (np.cumsum(points.photo_index == 7) <= 2)
    result = adjust(BundleProblem(points.subset(keep), (CameraModel("c", ()),)), truth)
    assert isinstance(result.system.undamped.factor, DenseFactor)
    assert result.defect == 2
