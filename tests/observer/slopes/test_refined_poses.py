"""Poses as the reflection refines them: nearer to the truth than what the targets say, by what their sigma says."""

import numpy as np
from scipy.stats import chi2

from heliogauge.geometry.rigid import RigidTransform, vector_from_rotation
from observer.planning.simulated_edges import EdgeNoise, measured_edges, true_edges
from observer.selection.solve_and_refuse import solve_reflector
from observer.slopes.pose_modes import Photos
from observer.slopes.row_spline import Roughness
from observer.trough.expectation import Expectation
from observer.trough.typical_mirror import TypicalMirror
from tests.observer.simulated_trough import believed_with_errors, short_scene, short_trough

#: Of the poses of `believed_with_errors`: rotations [rad], then translations [m].
SIGMAS = np.array([2e-4, 2e-4, 2e-4, 2e-3, 2e-3, 2e-3])
#: Photos at the ends of the pass show no reflection.
INNER = slice(12, 48)


def step_between(true: RigidTransform, found: RigidTransform) -> np.ndarray:
    turn = vector_from_rotation(found.rotation @ true.rotation.T)
    return np.concatenate([turn, found.translation_m - true.translation_m])


def refined_pass(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what edges tell best of each pose, before and after, over its sigma before; chi-square of each pose."""
    rng = np.random.default_rng(seed)
    mirror = TypicalMirror.drawn(short_trough(), rng, 1e-3, 0.0)
    scene = short_scene(mirror, photos=60, rows=8)
    believed = believed_with_errors(scene, rng)
    edges = measured_edges(scene, true_edges(scene, EdgeNoise()), believed.views, rng)
    photos = Photos(tuple(pose for _, pose in believed.views), believed.covariance)
    expected = Expectation(scene.truth.collector, scene.truth.absorber, scene.truth.y_m)
    found = solve_reflector(edges, photos, expected, 0.02, Roughness(1e-3, 2e-3), shaped=False)
    solution = found.errors.common, found.errors.covariance_common
    refined, covariance = found.unknowns.moved_poses(photos.poses, photos.covariance, *solution)
    before, after = (
        np.array([step_between(true, pose) for (_, true), pose in zip(scene.views, poses, strict=True)])
        for poses in (photos.poses, refined)
    )
    reading = found.unknowns.steps[:, :, 0] / SIGMAS**2
    squares = np.array([error @ np.linalg.solve(own, error) for error, own in zip(after, covariance, strict=True)])
    return (reading * before).sum(axis=1), (reading * after).sum(axis=1), squares


def test_refined_poses_err_less_and_as_their_covariance_says() -> None:
    before, after, squares = (np.array(part) for part in zip(*(refined_pass(seed) for seed in (5, 6)), strict=True))
    assert 0.8 < np.std(before[:, INNER]) < 1.2
    assert np.std(after[:, INNER]) < 0.35 * np.std(before[:, INNER])
    dof = 6 * squares.size
    low, high = chi2.ppf([0.005, 0.995], dof) / dof
    assert low < squares.sum() / dof < high
