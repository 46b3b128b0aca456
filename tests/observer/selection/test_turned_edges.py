"""Edges whose brightness steps the other way than the design lets expect: mirrors that bend or tilt very much."""

from dataclasses import dataclass

import numpy as np

from observer.photo_edges.reflection_edges import sides_of_tube
from observer.planning.simulated_edges import EdgeNoise, measured_edges, true_edges
from observer.selection.edge_refusal import EdgeFate
from observer.selection.solve_and_refuse import solve_reflector
from observer.slopes.pose_modes import Photos
from observer.slopes.row_spline import Roughness
from observer.trough.observation_equation import Sights, beside_axis
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


@dataclass(frozen=True)
class SteepWaves:
    """Waves across the whole mirror."""

    def errors(self, x_m: np.ndarray, y_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 5.5e-3 * np.sin(11 * x_m + 0.5 * y_m), np.zeros_like(x_m)


def test_a_mirror_of_steep_waves_is_not_taken_for_one_with_shadows() -> None:
    rng = np.random.default_rng(0)
    scene = short_scene(SteepWaves(), photos=120, rows=12)
    believed = believed_with_errors(scene, rng)
    edges = measured_edges(scene, true_edges(scene, EdgeNoise()), believed.views, rng)
    assert np.mean(edges.contrast * edges.side > 0) > 0.02
    photos = Photos(tuple(pose for _, pose in believed.views), believed.covariance)
    found = solve_reflector(edges, photos, scene.truth, 0.02, Roughness(1e-3, 2e-3), shaped=False)
    assert not found.has_shadows
    assert np.mean(found.fate == EdgeFate.USED) > 0.98


def test_a_mirror_that_bends_less_has_none() -> None:
    scene = short_scene(WavyMirror(3e-3), photos=20, rows=4)
    edges = true_edges(scene, EdgeNoise())
    assert (edges.contrast * edges.side < 0).all()


@dataclass(frozen=True)
class TiltedMirror:
    """Slope errors that grow towards the rims to more than a quarter of the tube's width."""

    def errors(self, x_m: np.ndarray, y_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return -7e-3 * x_m, np.zeros_like(x_m)


def test_sides_are_told_by_brightness_where_normals_turn_by_more_than_a_quarter_of_the_tube() -> None:
    scene = short_scene(TiltedMirror(), photos=40, rows=4)
    edges = true_edges(scene, EdgeNoise())
    eyes = np.array([pose.inverse().translation_m for _, pose in scene.views])[edges.photo]
    collector = scene.truth.collector
    slope = edges.points_m[:, 0] / (2 * collector.focal_length_m)
    sights = Sights(edges.points_m, eyes, edges.side)
    middle, half, *_ = beside_axis(sights, slope, scene.truth.absorber, collector.absorber_diameter_m / 2)
    nearest = np.where(middle < 0, 1.0, -1.0)
    assert np.count_nonzero(nearest != edges.side) > 20
    everywhere = np.ones(half.size, dtype=bool)
    for brighter in (1.0, -1.0):
        found = sides_of_tube(brighter * edges.contrast, middle, half, 12e-3, everywhere)
        assert (found == edges.side).all()
    # Where as many edges step one way as the other, brightness tells nothing.
    mixed = edges.contrast * np.where(np.arange(half.size) % 2, 1.0, -1.0)
    assert (sides_of_tube(mixed, middle, half, 12e-3, everywhere) == nearest).all()
