"""Edges and bearings that were found with a provisional pose, carried to the adjusted one."""

import numpy as np

from heliogauge.camera.distortion import BrownDistortion
from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from observer.photo_edges.moved_edges import bearings_in_poses, edges_in_poses
from observer.photo_edges.reflection_edges import ReflectionEdges
from observer.photo_edges.tube_bearings import Bearings, bearing
from observer.photo_edges.views import View
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector
from observer.trough.expectation import Expectation

COLLECTOR = Collector(5.0, 8.0, 1.49, 0.07)
Y = (np.arange(400) + 0.5) * 0.02 - 4.0
EXPECTED = Expectation(COLLECTOR, AbsorberPath.straight(0.0, 1.49, 4.0), Y)
CAMERA = Camera(1920, 1080, 2380.0, 2380.0, 959.5, 539.5)
ADJUSTED = Camera(1920, 1080, 2384.0, 2384.0, 961.0, 538.0, 0.0, BrownDistortion(-0.01, 0.0, 0.0, 0.0, 0.0))


def views(rng: np.random.Generator) -> tuple[list, list]:
    """Three photos from 15 m with provisional poses, and adjusted poses up to some centimetres and mrad beside them."""
    down = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    before, after = [], []
    for x in (-1.0, 0.0, 1.5):
        pose = RigidTransform(down, -down @ np.array([x, 0.2, 15.0]))
        before.append(View(CAMERA, pose))
        after.append(View(ADJUSTED, pose.moved(np.concatenate([rng.normal(0, 1e-3, 3), rng.normal(0, 0.02, 3)]))))
    return before, after


def test_edges_keep_their_pixels_and_come_to_lie_on_the_mirror() -> None:
    rng = np.random.default_rng(0)
    before, after = views(rng)
    photo, row, x = rng.integers(0, 3, 500), rng.integers(40, 360, 500), rng.uniform(-2.4, 2.4, 500)
    points = np.stack([x, Y[row], x**2 / (4 * 1.49)], axis=1)
    edges = ReflectionEdges(
        photo, row, np.ones(500), points, np.full(500, 1e-3), np.full(500, 0.5), np.zeros(500), photo < 0
    )
    found = edges_in_poses(edges, before, after, EXPECTED)
    assert found.photo.size == 500
    assert np.abs(found.points_m[:, 2] - found.points_m[:, 0] ** 2 / (4 * 1.49)).max() < 1e-12
    assert np.linalg.norm(found.points_m - points, axis=1).max() > 5e-3
    assert np.abs(found.points_m[:, 1] - Y[found.row]).max() < 0.0101
    for k in range(3):
        own = photo == k
        first = before[k][0].project(before[k][1].apply(points[own]))
        second = after[k][0].project(after[k][1].apply(found.points_m[own]))
        assert np.abs(first - second).max() < 1e-6


def test_edges_that_leave_the_mirror_are_left_out() -> None:
    before, after = views(np.random.default_rng(1))
    after = [View(camera, pose.moved([0, 0, 0, 0.1, 0, 0])) for camera, pose in after]
    points = np.array([[0.5, Y[0], 0.25 / 5.96], [0.5, Y[-1], 0.25 / 5.96]])
    edges = ReflectionEdges(
        np.zeros(2, int), np.array([0, 399]), np.ones(2), points, np.ones(2), np.ones(2), np.zeros(2), np.zeros(2, bool)
    )
    assert edges_in_poses(edges, before, after, EXPECTED).photo.size == 1


def test_bearings_are_those_of_the_same_pixels_from_the_adjusted_places() -> None:
    before, after = views(np.random.default_rng(2))
    photo, y = np.repeat(np.arange(3), 100), np.tile(np.linspace(-3, 3, 100), 3)
    eyes = np.array([pose.inverse().translation_m for _, pose in before])
    angle = bearing(np.full(300, 0.01), np.full(300, 1.49), eyes[photo])
    some = np.full(300, 1e-5)
    found = bearings_in_poses(Bearings(photo, y, angle, some, some, 7e3 * some), before, after, EXPECTED)
    for k in range(3):
        own = photo == k
        points = np.stack([np.full(100, 0.01), y[own], np.full(100, 1.49)], axis=1)
        pixels = before[k][0].project(before[k][1].apply(points))
        back = after[k][1].inverse()
        rays, eye = back.rotate(after[k][0].cast_rays(pixels)), back.translation_m
        seen = np.arctan2(rays[:, 0], -rays[:, 2])
        assert np.abs(found.angle_rad[own] - seen).max() < 1e-9
        assert np.abs(eye[1] + (1.49 - eye[2]) / rays[:, 2] * rays[:, 1] - found.y_m[own]).max() < 1e-9
    assert np.abs(found.angle_rad - angle).max() > 1e-4
