"""How large slopes along the trough are, told from edges of one pass; where it says nothing the assumption stays."""

from dataclasses import replace

import numpy as np
import pytest

from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector
from observer.photo_edges.views import View
from observer.planning.simulated_edges import EdgeNoise, measured_edges, true_edges
from observer.selection.solve_and_refuse import solve_reflector
from observer.slopes.along_variance import find_along
from observer.slopes.pose_modes import Photos
from observer.slopes.row_spline import Roughness, RowGrid, TouchingLines
from observer.trough.expectation import Expectation
from observer.trough.typical_mirror import TypicalMirror
from tests.observer.simulated_trough import short_scene, short_trough

ASSUMED = Roughness(1e-3, 2e-3)


def found_and_true(along_rad: float) -> tuple[float, float]:
    """Solve a simulated pass 3 m beside the middle of the trough; return what is found along it and what is true."""
    mirror = TypicalMirror.drawn(short_trough(), np.random.default_rng(3), 3e-3, along_rad)
    scene = short_scene(mirror, photos=60, rows=60)
    turn = rotation_from_vector(np.array([np.arctan(3.0 / 12.0), 0.0, 0.0]))
    views = []
    for camera, pose in scene.views:
        rotation = pose.rotation @ turn
        views.append(
            View(camera, RigidTransform(rotation, -rotation @ (pose.inverse().translation_m + [0.0, 3.0, 0.0])))
        )
    scene = replace(scene, views=tuple(views))
    edges = measured_edges(scene, true_edges(scene, EdgeNoise()), scene.views, np.random.default_rng(4))
    photos = Photos(tuple(pose for _, pose in views), np.eye(6 * len(views)) * 1e-12)
    expected = Expectation(scene.truth.collector, scene.truth.absorber, scene.truth.y_m)
    found = solve_reflector(edges, photos, expected, 0.05, ASSUMED).roughness.along_rad
    return found, float(np.std(mirror.errors(edges.points_m[:, 0], edges.points_m[:, 1])[1]))


def test_one_pass_tells_how_large_slopes_along_the_trough_are() -> None:
    assert found_and_true(0.0)[0] < 0.5e-3
    found, true = found_and_true(3e-3)
    assert true > 1e-3
    assert 0.6 * true < found < 2 * true


def test_where_the_edges_say_nothing_what_was_assumed_stays() -> None:
    rng = np.random.default_rng(5)
    grid = RowGrid(np.linspace(-1, 1, 40), np.ones(39, dtype=bool), 3)
    x, row = rng.uniform(-1, 1, 90), np.repeat(np.arange(3), 30)
    none = np.zeros((90, 0))
    # The slope along the trough moves nothing.
    lines = TouchingLines(
        row, x, rng.normal(0, 1e-4, 90), np.full(90, -2.0), np.zeros(90), np.full(90, 1e-4), none.astype(int), none
    )
    found = find_along(lines, grid, ASSUMED)
    assert {one.roughness.along_rad for one in found} == {ASSUMED.along_rad}
    # Nor do they say anything of the length.
    assert [one.probability for one in found] == pytest.approx([1 / 3] * 3)


def test_the_length_of_slopes_that_hardly_any_edge_tells_stays_open() -> None:
    """By chance a length of metres is a little more probable; slopes alike along it would move the whole map."""
    grid = RowGrid(np.linspace(-1, 1, 40), np.ones(39, dtype=bool), 8)
    for weak, own_rad, seed in ((0.05, 1e-3, 7), (0.1, 0.5e-3, 7), (0.1, 0.5e-3, 6)):
        rng = np.random.default_rng(seed)
        x, row, none = rng.uniform(-1, 1, 200), np.repeat(np.arange(8), 25), np.zeros((200, 0))
        by_y = rng.choice([-weak, weak], 200)
        found = rng.normal(0, 1e-4, 200) + by_y * rng.normal(0, own_rad, 200)
        lines = TouchingLines(row, x, found, np.full(200, -2.0), by_y, np.full(200, 1e-4), none.astype(int), none)
        probability = {one.roughness.along_length_m: one.probability for one in find_along(lines, grid, ASSUMED)}
        assert set(probability) == {0.3, 1.0, 3.0}
        assert max(probability.values()) < 0.5


@pytest.mark.parametrize(("wave_m", "length_m"), [(None, 3.0), (0.5, 0.3)])
def test_a_length_that_edges_tell_is_the_only_one(wave_m: float | None, length_m: float) -> None:
    """Slopes along of 2 mrad that each row has as a whole, or that wave across it."""
    rng = np.random.default_rng(1)
    grid = RowGrid(np.linspace(-1, 1, 40), np.ones(39, dtype=bool), 8)
    x, row, none = rng.uniform(-1, 1, 400), np.repeat(np.arange(8), 50), np.zeros((400, 0))
    by_y = rng.choice([-0.3, 0.3], 400)
    along = rng.normal(0, 2e-3, 8)[row] if wave_m is None else 2e-3 * np.sin(2 * np.pi * x / wave_m + row)
    found = rng.normal(0, 1e-4, 400) - by_y * along
    lines = TouchingLines(row, x, found, np.full(400, -2.0), by_y, np.full(400, 1e-4), none.astype(int), none)
    [one] = find_along(lines, grid, ASSUMED)
    assert (one.probability, one.roughness.along_length_m) == (1.0, length_m)
    assert one.roughness.along_rad >= ASSUMED.along_rad
