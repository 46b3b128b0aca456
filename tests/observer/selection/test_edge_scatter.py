"""The noise of edges from how they scatter beside their neighbours along the trough."""

from dataclasses import replace

import numpy as np
import pytest

from observer.photo_edges.reflection_edges import ReflectionEdges
from observer.selection.edge_scatter import scatter_along
from observer.selection.solve_and_refuse import solve_reflector
from observer.slopes.pose_modes import Photos
from observer.slopes.row_spline import Roughness
from observer.trough.expectation import Expectation
from observer.trough.typical_mirror import TypicalMirror
from tests.observer.own_trough import own_edges, own_measurement
from tests.observer.simulated_trough import believed_with_errors, short_scene, short_trough

STATED_M = 2e-4


def curves(noise: float, step_m: float, *, wrong: float = 0.0) -> tuple[ReflectionEdges, np.ndarray]:
    """Both edges of the tube in eight photos over rows of a mirror with waves; their noise in stated sigmas."""
    rng = np.random.default_rng(5)
    y = np.arange(150) * step_m
    photo, side, row = (one.ravel() for one in np.meshgrid(np.arange(8), [-1.0, 1.0], np.arange(y.size), indexing="ij"))
    # A slope of 1 mrad moves a curve by 10 mm and more.
    x = 0.3 * photo + 0.05 * side + 0.01 * np.sin(2 * np.pi * y[row] / 0.5 + photo)
    x = x + noise * STATED_M * rng.standard_normal(x.size) + np.where(rng.random(x.size) < wrong, 0.02, 0.0)
    points = np.stack([x, y[row], np.zeros(x.size)], axis=1)
    each = np.full(x.size, STATED_M)
    return ReflectionEdges(photo, row, side, points, each, np.ones(x.size), np.zeros(x.size), row < 0), y


@pytest.mark.parametrize("noise", [0.3, 1.0, 2.0, 4.0])
def test_scatter_beside_neighbours_is_the_noise(noise: float) -> None:
    edges, y = curves(noise, 0.02, wrong=0.02)
    assert scatter_along(edges, np.ones(y.size * 16, dtype=bool), y) == pytest.approx(noise, rel=0.15)


@pytest.mark.parametrize("step_mm", [20, 25, 30, 40, 50])
def test_waves_are_no_noise_whatever_the_distance_of_rows(step_mm: int) -> None:
    """At most 3 % of it; with rows 50 mm apart waves of 0.5 m looked like 2.6 times the noise."""
    edges, y = curves(1.0, 1e-3 * step_mm)
    found = scatter_along(edges, np.ones(y.size * 16, dtype=bool), y)
    assert found == (pytest.approx(1.0, rel=0.1) if step_mm <= 25 else 0.0)


@pytest.mark.parametrize("start_m", [0.0, 0.3, 7.3])
def test_rounding_does_not_move_rows_apart(start_m: float) -> None:
    edges, y = curves(1.0, 0.025)
    assert scatter_along(edges, np.ones(y.size * 16, dtype=bool), start_m + y) > 0.0


def test_rows_far_apart_do_not_tell() -> None:
    edges, y = curves(4.0, 0.2)
    assert scatter_along(edges, np.ones(y.size * 16, dtype=bool), y) == 0.0


def test_noise_of_edges_that_no_others_check_is_found() -> None:
    """Photos 0.33 m apart, edges with twice the noise that they state: most are all that is known of their place."""
    rng = np.random.default_rng(3)
    mirror = TypicalMirror.drawn(short_trough(), np.random.default_rng(3), 3e-3, 0.3e-3)
    scene = short_scene(mirror, photos=18, rows=12)
    close = replace(scene.truth, y_m=-0.9 + 0.02 * np.arange(12))
    scene = replace(scene, truth=close)
    believed = believed_with_errors(scene, rng)
    edges = own_measurement(scene, own_edges(scene, 0.1), believed.views, rng)
    poses = Photos(tuple(pose for _, pose in believed.views), believed.covariance)
    expected = Expectation(scene.truth.collector, scene.truth.absorber, scene.truth.y_m)
    halved = replace(edges, sigma_x_m=edges.sigma_x_m / 2)
    found = solve_reflector(halved, poses, expected, 0.02, Roughness(1e-3, 2e-3), shaped=False)
    assert 1.7 < found.noise_factor < 2.5
