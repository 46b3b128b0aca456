"""The adjustment of several poses, on slopes drawn from the very model it adjusts."""

from dataclasses import replace

import numpy as np
import pytest

from deflectometry.poses.adjustment import PoseSlopes, adjust_poses

N, COMMON, OWN = 20, 4, 5


def draw(rng, n_poses, *, noise=1e-3, common_change=None):
    """Return the poses of a drawn surface, and the true amounts of all errors."""
    surface, common = rng.normal(size=N), rng.standard_normal(COMMON)
    poses, owns = [], []
    for number in range(n_poses):
        changes = rng.normal(size=(N, COMMON)) if common_change is None else common_change(number)
        own_changes, own = 0.1 * rng.normal(size=(N, OWN)), rng.standard_normal(OWN)
        root = noise * (np.eye(N) + 0.2 * rng.normal(size=(N, N)))
        measured_at = rng.standard_normal(COMMON)
        slopes = surface - changes @ (common - measured_at) - own_changes @ own + root @ rng.standard_normal(N)
        poses.append(PoseSlopes(slopes, root @ root.T, changes, own_changes, measured_at))
        owns.append(own)
    return poses, np.concatenate([common, *owns])


def test_amounts_scatter_as_their_covariance_says():
    rng = np.random.default_rng(11)
    squares, chi_squares = [], []
    for _ in range(300):
        poses, true = draw(rng, 3)
        found = adjust_poses(poses)
        # Without the factor, which only ever enlarges.
        covariance = found.covariance if found.noise_factor == 1.0 else adjust_poses_as_stated(poses).covariance
        off = np.concatenate([found.common, *found.own]) - true
        squares.append(off @ np.linalg.solve(covariance, off) / true.size)
        chi_squares.append(found.chi_square / found.freedom)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.08)
    assert np.mean(chi_squares) == pytest.approx(1.0, abs=0.08)


def adjust_poses_as_stated(poses):
    """The covariance without the noise factor: that of slopes that agree perfectly."""
    return adjust_poses([replace(one, slopes=np.zeros(N), measured_at=np.zeros(COMMON)) for one in poses])


def test_what_acts_alike_in_all_poses_keeps_its_prior():
    """An error that changes all poses alike is the surface's."""
    same = np.random.default_rng(3).normal(size=(N, COMMON))
    poses, _ = draw(np.random.default_rng(4), 4, common_change=lambda _: same)
    found = adjust_poses(poses)
    assert np.allclose(found.covariance_common, np.eye(COMMON), atol=1e-6)
    turned = adjust_poses(draw(np.random.default_rng(4), 4)[0])
    assert np.diag(turned.covariance_common).max() < 1e-3


def test_noise_that_is_larger_than_stated_is_seen_and_counted():
    rng = np.random.default_rng(8)
    poses, _ = draw(rng, 4, noise=3e-3)
    too_sure = [replace(one, covariance=one.covariance / 9.0) for one in poses]
    found, honest = adjust_poses(too_sure), adjust_poses(poses)
    assert found.noise_factor == pytest.approx(3.0, rel=0.25)
    assert found.probability < 1e-6 < honest.probability
    assert np.diag(found.covariance_common) == pytest.approx(np.diag(honest.covariance_common), rel=0.6)


def test_turns_that_nobody_knows_add_up_to_zero():
    rng = np.random.default_rng(2)
    poses, _ = draw(rng, 3)
    turned = []
    for number, one in enumerate(poses):
        turns = np.zeros((N, 2))
        turns[0, 0] = turns[10, 1] = 1.0
        slopes = one.slopes + turns @ [0.3 * number, -0.2 * number]
        turned.append(replace(one, slopes=slopes, own=np.concatenate([one.own, turns], axis=1), free_turns=2))
    found = adjust_poses(turned)
    by_pose = np.array([own[-2:] for own in found.own])
    assert by_pose.sum(axis=0) == pytest.approx(0.0, abs=1e-6)
    assert np.diff(by_pose, axis=0) == pytest.approx(np.array([[-0.3, 0.2]] * 2), abs=0.2)
