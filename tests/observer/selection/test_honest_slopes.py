"""Slopes err by what their joint covariance says; what photos show is drawn by plain vectors, not by the estimator.

Errors of nodes have poses, absorber and neighbours in common: each pass's errors are whitened by the covariance of all
its nodes together, ten passes.
"""

import numpy as np
import pytest

from observer.selection.solve_and_refuse import Reflector, solve_reflector
from observer.slopes.pose_modes import Photos
from observer.slopes.row_spline import Roughness
from observer.trough.expectation import Expectation
from observer.trough.typical_mirror import TypicalMirror
from tests.observer.own_trough import own_edges, own_measurement
from tests.observer.simulated_trough import believed_with_errors, short_scene, short_trough

#: Nodes of one row that are looked at, and rows [m]; the mirror's slopes along the trough are what one pass from above
#: leaves possible, so that the bound that is found for them is neither far above nor below [rad].
APART_X_M, APART_ROWS, ALONG_RAD = 0.3, 1, 0.7e-3


def whitened_errors(seed: int) -> np.ndarray:
    """Solve a simulated pass with wrong poses; return the errors at some nodes, whitened together."""
    rng = np.random.default_rng(seed)
    mirror = TypicalMirror.drawn(short_trough(), rng, 3e-3, ALONG_RAD)
    scene = short_scene(mirror, photos=80, rows=12)
    believed = believed_with_errors(scene, rng)
    edges = own_measurement(scene, own_edges(scene, 0.05), believed.views, rng)
    photos = Photos(tuple(pose for _, pose in believed.views), believed.covariance)
    expected = Expectation(scene.truth.collector, scene.truth.absorber, scene.truth.y_m)
    found = solve_reflector(edges, photos, expected, 0.02, Roughness(1e-3, 2e-3), shaped=False)
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
    values = np.concatenate([whitened_errors(seed) for seed in range(10)])
    assert values.size > 700
    assert 0.7 < np.mean(values**2) < 1.13
    assert np.mean(np.abs(values) > 3) < 0.005
