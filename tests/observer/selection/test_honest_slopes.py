"""Slopes from simulated edges err by what their sigma says: chi-square within its 99 % band."""

import numpy as np
from scipy.stats import chi2

from observer.planning.simulated_edges import EdgeNoise, measured_edges, true_edges
from observer.selection.solve_and_refuse import solve_reflector
from observer.slopes.pose_modes import Photos
from observer.slopes.row_spline import Roughness
from observer.trough.expectation import Expectation
from observer.trough.typical_mirror import TypicalMirror
from tests.observer.simulated_trough import believed_with_errors, short_scene, short_trough

#: Nodes of one row, and rows, whose errors have nothing in common any more [m].
APART_X_M, APART_ROWS = 0.3, 1


def errors_over_sigma(seed: int) -> np.ndarray:
    """Solve a simulated pass with wrong poses; return error over sigma at nodes that are far from each other."""
    rng = np.random.default_rng(seed)
    mirror = TypicalMirror.drawn(short_trough(), rng, 3e-3, 0.0)
    scene = short_scene(mirror, photos=80, rows=12)
    believed = believed_with_errors(scene, rng)
    edges = measured_edges(scene, true_edges(scene, EdgeNoise()), believed.views, rng)
    photos = Photos(tuple(pose for _, pose in believed.views), believed.covariance)
    expected = Expectation(scene.truth.collector, scene.truth.absorber, scene.truth.y_m)
    found = solve_reflector(edges, photos, expected, 0.02, Roughness(1e-3, 2e-3), shaped=False)
    x, y = np.meshgrid(found.grid.x_m, found.y_m)
    true = mirror.errors(x.ravel(), y.ravel())[0].reshape(x.shape)
    variance = found.errors.random[..., 0, 0] + found.errors.shared[..., 0]
    error = (found.errors.slopes[..., 0] - true) / np.sqrt(variance)
    # Between edges, where panels end, and where the tube is in front, the mirror is not measured.
    error = np.where(found.measured & (variance < (1.5e-4) ** 2), error, np.nan)
    stride = round(APART_X_M / found.grid.step_m)
    some = error[:: APART_ROWS + 1, stride // 2 :: stride]
    return some[np.isfinite(some)]


def test_error_over_sigma_is_within_the_band_of_chi_square() -> None:
    values = np.concatenate([errors_over_sigma(seed) for seed in range(2)])
    low, high = chi2.ppf([0.005, 0.995], values.size) / values.size
    assert low < np.mean(values**2) < high
