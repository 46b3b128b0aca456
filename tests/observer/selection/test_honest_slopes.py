"""Slopes err by what their joint covariance says; what photos show is drawn by plain vectors, not by the estimator.

Errors of nodes have poses, absorber and neighbours in common: each pass's errors are whitened by the covariance of all
its nodes together, ten passes.
"""

import numpy as np
import pytest

from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector
from observer.doubts.halves import halves_limit
from observer.photo_edges.views import View
from observer.selection.solve_and_refuse import Reflector, solve_reflector
from observer.slopes.halves import Halves
from observer.slopes.pose_modes import Photos
from observer.slopes.row_spline import Roughness
from observer.trough.expectation import Expectation
from observer.trough.typical_mirror import TypicalMirror
from tests.observer.own_trough import own_edges, own_measurement
from tests.observer.simulated_trough import believed_with_errors, short_scene, short_trough

#: Nodes of one row that are looked at, and rows [m]; the mirror's slopes along the trough are what one pass from above
#: leaves possible, so that the bound that is found for them is neither far above nor below [rad].
APART_X_M, APART_ROWS, ALONG_RAD = 0.3, 1, 0.7e-3


def flight(seed: int, *, stated_share: float = 1.0, lean_rad: float = 0.0) -> tuple[Reflector, TypicalMirror]:
    """Solve a simulated pass with wrong poses.

    stated_share: Sigma that is stated of the poses, over that of their errors.
    lean_rad: Turn of the list of targets about the trough, which all poses have in common [rad].
    """
    rng = np.random.default_rng(seed)
    mirror = TypicalMirror.drawn(short_trough(), rng, 3e-3, ALONG_RAD)
    scene = short_scene(mirror, photos=80, rows=12)
    believed = believed_with_errors(scene, rng)
    leaning = RigidTransform(rotation_from_vector(np.array([0.0, lean_rad, 0.0])), np.zeros(3))
    views = tuple(View(camera, pose @ leaning) for camera, pose in believed.views)
    edges = own_measurement(scene, own_edges(scene, 0.05), views, rng)
    photos = Photos(tuple(pose for _, pose in views), stated_share**2 * believed.covariance)
    expected = Expectation(scene.truth.collector, scene.truth.absorber, scene.truth.y_m)
    return solve_reflector(edges, photos, expected, 0.02, Roughness(1e-3, 2e-3), shaped=False), mirror


def whitened_errors(found: Reflector, mirror: TypicalMirror) -> np.ndarray:
    """Return the errors at some nodes, whitened together."""
    x, y = np.meshgrid(found.grid.x_m, found.y_m)
    true = mirror.errors(x.ravel(), y.ravel())[0].reshape(x.shape)
    variance = found.errors.random[..., 0, 0] + found.errors.shared[..., 0]
    # Between edges, where panels end, and where the tube is in front, the mirror is not measured.
    chosen = np.zeros(x.shape, dtype=bool)
    stride = round(APART_X_M / found.grid.step_m)
    chosen[:: APART_ROWS + 1, stride // 2 :: stride] = True
    chosen &= found.measured & (variance < (1.5e-4) ** 2)
    covariance = joint_covariance(found, chosen)
    # The diagonal is what the map states, whose common part is interpolated between some nodes.
    assert np.mean(np.diag(covariance) / variance[chosen]) == pytest.approx(1.0, abs=0.05)
    return np.linalg.solve(np.linalg.cholesky(covariance), (found.errors.slopes[..., 0] - true)[chosen])


def joint_covariance(found: Reflector, chosen: np.ndarray) -> np.ndarray:
    """Covariance of the chosen nodes: with the absorber held, and what its place adds."""
    row, column = np.nonzero(chosen)
    single = np.zeros((row.size, *chosen.shape))
    single[np.arange(row.size), row, column] = 1.0
    apart, rows = found.errors.modes_apart, found.errors.mode_rows
    places = [
        np.stack([np.interp(np.arange(chosen.shape[0]), rows, line) for line in mode.T], axis=1) for mode in apart
    ]
    shown = np.array([place[chosen] for place in places]).reshape(-1, row.size)
    return found.sums(single) + shown.T @ shown


@pytest.mark.slow
def test_errors_whitened_together_are_of_unit_size() -> None:
    """Ten passes of some 84 nodes.

    840 independent values are within 0.87 to 1.13 (99 %); slopes along the trough have a bound of two sigma instead of
    an estimate, which makes the stated sigmas larger by up to a fifth.
    """
    flights = [flight(seed) for seed in range(10)]
    values = np.concatenate([whitened_errors(*one) for one in flights])
    assert values.size > 700
    assert 0.7 < np.mean(values**2) < 1.13
    assert np.mean(np.abs(values) > 3) < 0.005
    # Every second photo against the others, 160 numbers: the bounds that the nodes have, wider by their number.
    halves = [halves_of_flight(found) for found, _ in flights]
    assert 0.5 < np.mean([one.chi_square for one in halves]) < 1.31
    assert all(one.chi_square <= halves_limit(one.difference_rad.size) for one in halves)


@pytest.mark.slow
def test_halves_tell_poses_that_are_worse_than_said_and_not_what_all_photos_share() -> None:
    """Poses three times worse: halves differ by 0.06 mrad. A list that leans by a milliradian: 0.6, in both alike."""
    worse, sound = halves_of_flight(flight(0, stated_share=1 / 3)[0]), halves_of_flight(flight(0)[0])
    assert worse.chi_square > halves_limit(worse.difference_rad.size)
    found, mirror = flight(0, lean_rad=1e-3)
    x, y = np.meshgrid(found.grid.x_m, found.y_m)
    error = found.errors.slopes[..., 0] - mirror.errors(x.ravel(), y.ravel())[0].reshape(x.shape)
    assert np.sqrt(np.mean(error[found.measured] ** 2)) > 0.4e-3
    assert halves_of_flight(found).chi_square == pytest.approx(sound.chi_square, abs=0.05)


def halves_of_flight(found: Reflector) -> Halves:
    assert found.halves is not None
    return found.halves
