"""Properties of the trough's geometry that hold for all troughs: panels, lines of sight, mirror images."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from observer.photo_edges.moved_edges import edges_in_poses
from observer.photo_edges.reflection_edges import ReflectionEdges
from observer.photo_edges.views import View
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector, ls2
from observer.trough.expectation import Expectation
from observer.trough.observation_equation import Sights, misfit

SEEDS = st.integers(0, 2**32 - 1)
CAMERA = Camera(1920, 1080, 2380.0, 2380.0, 959.5, 539.5)
DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def trough(rng: np.random.Generator) -> Collector:
    counts = rng.integers(0, 4, 2)
    edges = [np.linspace(-2.4, 2.4, n + 2)[1:-1] + rng.uniform(-0.2, 0.2, n) for n in counts]
    return replace(
        ls2(),
        panel_edges_x_m=np.array([-2.5, *edges[0], 2.5]),
        panel_edges_y_m=np.array([-3.945, *edges[1], 3.945]),
        panel_gap_m=float(rng.choice([0.0, 0.01, 0.1])),
        focal_length_m=float(rng.uniform(1.2, 2.2)),
    )


@settings(max_examples=40, deadline=None)
@given(SEEDS)
def test_a_point_belongs_to_the_panel_whose_edges_are_around_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    design = trough(rng)
    x, y = rng.uniform(-2.7, 2.7, 50), rng.uniform(-4.1, 4.1, 50)
    x[:8] = np.clip(rng.choice(design.panel_edges_x_m, 8) + rng.uniform(-0.06, 0.06, 8), -2.7, 2.7)
    expected, half = [], design.panel_gap_m / 2
    for place in zip(x, y, strict=True):
        cell = []
        for value, edges in zip(place, (design.panel_edges_x_m, design.panel_edges_y_m), strict=True):
            inner = edges[1:-1]
            is_clear = edges[0] <= value < edges[-1] and not (np.abs(inner - value) < half).any()
            cell.append(sum(edge <= value for edge in inner) if is_clear else -1)
        is_outside = min(cell) < 0
        expected.append(-1 if is_outside else cell[1] * (design.panel_edges_x_m.size - 1) + cell[0])
    assert design.panel_index(x, y).tolist() == expected


@settings(max_examples=25, deadline=None)
@given(SEEDS)
def test_edges_that_are_carried_to_another_pose_and_back_are_where_they_were(seed: int) -> None:
    rng = np.random.default_rng(seed)
    design = trough(rng)
    y_m = design.rows_m(0.02)
    expected = Expectation(design, AbsorberPath.straight(0.0, design.focal_length_m, 4.0), y_m)
    pose = RigidTransform(DOWN, -DOWN @ np.array([rng.uniform(-3, 3), 0.2, rng.uniform(8, 20)]))
    other = pose.moved(np.concatenate([rng.normal(0, 2e-3, 3), rng.normal(0, 0.03, 3)]))
    row, x = rng.integers(20, y_m.size - 20, 40), rng.uniform(-2.3, 2.3, 40)
    points = np.stack([x, y_m[row], x**2 / (4 * design.focal_length_m)], axis=1)
    ones = np.ones(40)
    edges = ReflectionEdges(np.zeros(40, dtype=np.intp), row, ones, points, ones, ones, ones, ones == 0)
    there = edges_in_poses(edges, [View(CAMERA, pose)], [View(CAMERA, other)], expected)
    back = edges_in_poses(there, [View(CAMERA, other)], [View(CAMERA, pose)], expected)
    np.testing.assert_allclose(back.points_m, points, atol=1e-9)
    np.testing.assert_array_equal(back.row, row)


@settings(max_examples=25, deadline=None)
@given(SEEDS)
def test_a_trough_seen_in_a_mirror_misses_by_the_opposite_angles(seed: int) -> None:
    """Left and right exchanged: the other edge of the tube is missed by as much the other way; along, by the same."""
    rng = np.random.default_rng(seed)
    design = trough(rng)
    x, y = rng.uniform(-2.4, 2.4, 30), rng.uniform(-3, 3, 30)
    points = np.stack([x, y, x**2 / (4 * design.focal_length_m)], axis=1)
    eyes = np.stack([x + rng.uniform(-0.4, 0.4, 30), rng.uniform(-3, 3, 30), rng.uniform(8, 20, 30)], axis=1)
    side, slopes = rng.choice([-1.0, 1.0], 30), rng.normal(0, 3e-3, (2, 30)) + [x / (2 * design.focal_length_m), 0 * x]
    stations, axis = np.array([-4.0, 0.0, 4.0]), rng.normal(0, 5e-3, (2, 3))
    none = np.zeros((6, 6))

    def missed(turn: tuple[float, float]) -> np.ndarray:
        ways = np.array([*turn, 1.0])
        order = slice(None, None, int(turn[1]))
        path = AbsorberPath(stations, turn[0] * axis[0, order], design.focal_length_m + axis[1, order], none)
        sights = Sights(points * ways, eyes * ways, turn[0] * side)
        return np.asarray(misfit(sights, (turn[0] * slopes[0], turn[1] * slopes[1]), path, 0.035).angle_rad)

    np.testing.assert_allclose(missed((-1.0, 1.0)), -missed((1.0, 1.0)), atol=1e-12)
    np.testing.assert_allclose(missed((1.0, -1.0)), missed((1.0, 1.0)), atol=1e-12)
