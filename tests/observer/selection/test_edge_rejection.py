"""How far an edge must lie beside the others to be refused."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from observer.planning.simulated_edges import EdgeNoise, measured_edges, true_edges
from observer.selection.edge_refusal import EdgeFate
from observer.selection.solve_and_refuse import solve_reflector
from observer.slopes.pose_modes import Photos
from observer.slopes.row_spline import Roughness
from tests.observer.simulated_trough import believed_with_errors, short_scene


@dataclass(frozen=True)
class SmoothMirror:
    """One wave of 6 m: what edges say of their neighbours is known much better than they are."""

    def errors(self, x_m: np.ndarray, y_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 1e-3 * np.sin(x_m), np.zeros_like(x_m)


@pytest.mark.slow
def test_edges_nine_standard_deviations_off_are_refused_and_the_others_are_not() -> None:
    """A limit of eight instead of four keeps them all, one of two refuses 2 % of the good ones.

    A third of its displacement an edge takes over into the mirror: what remains of nine is six, of which 0.83 are
    beyond four of the sigmas of an edge that has no part in the solution, and 0.98 of what it is off the others.
    """
    rng = np.random.default_rng(0)
    scene = short_scene(SmoothMirror(), photos=80, rows=24)
    believed = believed_with_errors(scene, rng)
    edges = measured_edges(scene, true_edges(scene, EdgeNoise()), believed.views, rng)
    displaced = rng.random(edges.row.size) < 0.04
    step = np.where(displaced, rng.choice([-9.0, 9.0], edges.row.size), 0.0) * edges.sigma_x_m
    focal = scene.truth.collector.focal_length_m
    points = edges.points_m + step[:, None] * np.array([1.0, 0.0, 0.0])
    points[:, 2] = points[:, 0] ** 2 / (4 * focal)
    edges = replace(edges, points_m=points)
    photos = Photos(tuple(pose for _, pose in believed.views), believed.covariance)
    found = solve_reflector(edges, photos, scene.truth, 0.02, Roughness(1e-3, 2e-3), shaped=False)
    beside = found.fate == EdgeFate.BESIDE
    assert np.count_nonzero(displaced) > 50
    assert np.mean(beside[displaced]) > 0.9
    assert np.mean(beside[~displaced]) < 0.005
