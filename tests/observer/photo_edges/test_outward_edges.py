"""Edges that lie further outward: by an angle at the camera, towards the brighter side, and what slopes make of it."""

from dataclasses import replace

import numpy as np
import pytest

from observer.photo_edges.outward_edges import moved_outward, outward_between
from observer.photo_edges.reflection_edges import ReflectionEdges, joined
from observer.planning.simulated_edges import Scene
from observer.selection.solve_and_refuse import solve_reflector
from observer.slopes.pose_modes import Photos
from observer.slopes.row_spline import Roughness
from observer.trough.typical_mirror import TypicalMirror
from tests.observer.own_trough import own_edges, own_measurement
from tests.observer.simulated_trough import believed_with_errors, short_scene, short_trough

#: A pixel of the camera is 0.97 mrad, an edge is found to a twentieth of one.
BY_RAD, EDGE_PX = 1e-3, 0.05


def scene_of(seed: int, photos: int) -> Scene:
    mirror = TypicalMirror.drawn(short_trough(), np.random.default_rng(seed), 2e-3, 0.3e-3)
    return short_scene(mirror, photos=photos, rows=6)


def drawn(scene: Scene) -> tuple[ReflectionEdges, np.ndarray]:
    eyes = np.array([view.cam_from_frame.inverse().translation_m for view in scene.views])
    return own_edges(scene, EDGE_PX), eyes


def test_edges_move_by_the_angle_towards_the_brighter_side() -> None:
    scene = scene_of(0, 12)
    edges, eyes = drawn(scene)
    focal = scene.truth.collector.focal_length_m
    by = np.linspace(-1.0, 1.0, 12) * BY_RAD
    moved = moved_outward(edges, by, eyes, focal)
    ways = [one.points_m - eyes[one.photo] for one in (edges, moved)]
    ways = [one / np.linalg.norm(one, axis=1, keepdims=True) for one in ways]
    angle = np.linalg.norm(np.cross(*ways), axis=1)
    np.testing.assert_allclose(angle, np.abs(by[edges.photo]), rtol=0.01)
    towards = np.sign(moved.points_m[:, 0] - edges.points_m[:, 0])
    assert (towards == np.sign(edges.contrast * by[edges.photo])).all()
    np.testing.assert_allclose(moved.points_m[:, 2], moved.points_m[:, 0] ** 2 / (4 * focal))


def test_what_edges_lie_further_outward_is_found_again_from_some_of_them() -> None:
    scene = scene_of(1, 12)
    edges, eyes = drawn(scene)
    focal = scene.truth.collector.focal_length_m
    rng = np.random.default_rng(0)
    moved = moved_outward(edges, np.full(12, BY_RAD), eyes, focal)
    some = moved.chosen(np.flatnonzero((rng.random(moved.row.size) < 0.7) & (moved.photo % 2 == 0)))
    found = outward_between(edges, some, eyes, focal)
    assert found.size == some.row.size
    assert np.median(found) == pytest.approx(BY_RAD, rel=0.01)
    # Nor do lesser steps count that have not moved.
    rims = [replace(one, is_lesser=np.ones(one.row.size, dtype=bool)) for one in (edges, edges, edges)]
    found = outward_between(joined([edges, *rims]), joined([some, *rims]), eyes, focal)
    assert found.size == some.row.size
    assert np.median(found) == pytest.approx(BY_RAD, rel=0.01)
    # Nothing steps the same way in rows that have no edges.
    others = replace(some, row=some.row + 100)
    assert outward_between(edges, others, eyes, focal).size == 0


def z_square(seed: int, by_rad: float, outward_rad: float) -> float:
    """Return the mean square of errors over sigmas where all edges lie outward by so much.

    One edge of the tube only: where both are seen through all of the mirror their mean cancels it.
    """
    rng = np.random.default_rng([seed, 3])
    scene = scene_of(seed, 24)
    edges, eyes = drawn(scene)
    edges = edges.chosen(np.flatnonzero(edges.side > 0))
    believed = believed_with_errors(scene, rng, position_m=1e-3)
    seen = own_measurement(scene, edges, believed.views, rng)
    seen = moved_outward(seen, np.full(len(eyes), by_rad), eyes, scene.truth.collector.focal_length_m)
    photos = Photos(tuple(pose for _, pose in believed.views), believed.covariance)
    prior = Roughness(1e-3, 1e-3)
    found = solve_reflector(seen, photos, scene.truth, 0.02, prior, shaped=False, outward_rad=outward_rad)
    x, y = np.meshgrid(found.grid.x_m, found.y_m)
    error = found.errors.slopes[..., 0] - scene.mirror.errors(x.ravel(), y.ravel())[0].reshape(x.shape)
    variance = found.errors.random[..., 0, 0] + found.errors.shared[..., 0]
    return float(np.mean((error**2 / variance)[found.measured]))


@pytest.mark.slow
def test_an_outward_displacement_that_is_left_open_is_in_the_sigmas() -> None:
    displaced = [(seed, way * BY_RAD) for seed in range(3) for way in (-1.0, 1.0)]
    left_open = np.mean([z_square(seed, by, BY_RAD) for seed, by in displaced])
    taken_for_none = np.mean([z_square(seed, by, 0.0) for seed, by in displaced])
    assert 0.5 < left_open < 1.3
    assert taken_for_none > 5.0
