"""Where a mirror bends so much that the reflection moves the other way, its edges step the other way and are used."""

from dataclasses import dataclass

import numpy as np

from observer.edge_fates import EdgeFate
from observer.reflector import Photos, solve_reflector
from observer.simulated_edges import EdgeNoise, measured_edges, true_edges
from observer.slope_field import Roughness
from tests.observer.simulated_trough import believed_with_errors, short_scene


@dataclass(frozen=True)
class WavyMirror:
    """A wave across; from 12 m the reflection stands still where the slope error changes by 42 mrad in a metre."""

    amplitude_rad: float

    def errors(self, x_m: np.ndarray, y_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        place = x_m - 0.7 + 0.05 * y_m
        return self.amplitude_rad * np.sin(11 * place) * np.exp(-((place / 0.3) ** 2)), np.zeros_like(x_m)


def test_edges_that_step_the_other_way_are_used_where_the_mirror_turns_them() -> None:
    rng = np.random.default_rng(0)
    scene = short_scene(WavyMirror(8e-3), photos=80, rows=12)
    believed = believed_with_errors(scene, rng)
    edges = measured_edges(scene, true_edges(scene, EdgeNoise()), believed.views, rng)
    turned = edges.contrast * edges.side > 0
    # Fewer than where shadows would be suspected.
    assert 15 < np.count_nonzero(turned) < 0.02 * turned.size
    photos = Photos(tuple(pose for _, pose in believed.views), believed.covariance)
    found = solve_reflector(edges, photos, scene.truth, 0.02, Roughness(1e-3, 2e-3), shaped=False)
    fate = found.fate[turned]
    assert np.count_nonzero(fate == EdgeFate.USED) > 0.8 * fate.size
    assert found.roughness.order == 3
    x, y = np.meshgrid(found.grid.x_m, found.y_m)
    error = found.errors.slopes[..., 0] - scene.mirror.errors(x.ravel(), y.ravel())[0].reshape(x.shape)
    sigma = np.sqrt(found.errors.random[..., 0, 0])
    good = found.measured & (sigma < 0.2e-3)
    assert (error[good] - error[good].mean()).std() < 0.1e-3


def test_a_mirror_that_bends_less_has_none() -> None:
    scene = short_scene(WavyMirror(3e-3), photos=20, rows=4)
    edges = true_edges(scene, EdgeNoise())
    assert (edges.contrast * edges.side < 0).all()
