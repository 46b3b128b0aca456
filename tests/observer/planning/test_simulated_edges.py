"""Edges without images: they touch the tube, closed forms for a perfect mirror, and what wrong poses make of them."""

import numpy as np
import pytest

from heliogauge.geometry.rigid import RigidTransform
from heliogauge.slopes.map import SlopeMap, no_common_modes
from observer.photo_edges.tube_bearings import bearing
from observer.photo_edges.views import View
from observer.planning.simulated_bearings import measured_bearings
from observer.planning.simulated_edges import EdgeNoise, measured_edges, seen_again, true_edges
from observer.trough.observation_equation import Sights, misfit
from observer.trough.typical_mirror import MeasuredMirror, TypicalMirror
from tests.observer.simulated_trough import CAMERA, believed_with_errors, short_scene, short_trough


def perfect() -> TypicalMirror:
    return TypicalMirror.drawn(short_trough(), np.random.default_rng(0), 0.0, 0.0)


def test_every_edge_touches_the_tube() -> None:
    mirror = TypicalMirror.drawn(short_trough(), np.random.default_rng(1), 3e-3, 2e-3)
    scene = short_scene(mirror)
    edges = true_edges(scene, EdgeNoise())
    eyes = np.array([pose.inverse().translation_m for _, pose in scene.views])[edges.photo]
    error_x, error_y = mirror.errors(edges.points_m[:, 0], edges.points_m[:, 1])
    slope = edges.points_m[:, 0] / (2 * scene.truth.collector.focal_length_m) + error_x
    found = misfit(Sights(edges.points_m, eyes, edges.side), (slope, error_y), scene.truth.absorber, 0.035)
    assert edges.row.size > 150
    assert np.abs(found.angle_rad).max() < 2e-6
    np.testing.assert_array_equal(edges.points_m[:, 1], scene.truth.y_m[edges.row])


def test_edges_of_a_perfect_mirror_lie_where_theta_a_and_the_acceptance_window_say() -> None:
    # Phi = 2 theta_a - side * w (Owkes 2012, eqs 5.4, 5.8, 5.10; theta_a with the repaired sign).
    scene = short_scene(perfect())
    edges = true_edges(scene, EdgeNoise())
    focal = scene.truth.collector.focal_length_m
    x, _, z = edges.points_m.T
    eyes = np.array([pose.inverse().translation_m for _, pose in scene.views])[edges.photo]
    phi = np.arctan2(eyes[:, 0] - x, eyes[:, 2] - z)
    axis_x, axis_z = 0.003, focal - 0.005
    theta_a = 0.5 * (np.arctan2(-x, focal - z) - np.arctan2(axis_x - x, axis_z - z))
    window = np.arcsin(0.035 / np.hypot(axis_x - x, axis_z - z))
    np.testing.assert_allclose(phi, 2 * theta_a + edges.side * window, atol=2e-6)


def test_who_knows_the_camera_sees_the_same_points() -> None:
    scene = short_scene(perfect())
    edges = true_edges(scene, EdgeNoise())
    again = measured_edges(scene, edges, scene.views, np.random.default_rng(2))
    shift = again.points_m[:, 0] - edges.points_m[:, 0]
    # Nothing but the noise, of the size that is stated.
    assert np.std(shift / edges.sigma_x_m) == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose(again.points_m[:, 1], edges.points_m[:, 1], atol=1e-9)


def test_a_camera_believed_to_stand_beside_moves_what_it_sees() -> None:
    scene = short_scene(perfect())
    pose = scene.views[5][1]
    moved = RigidTransform(pose.rotation, pose.translation_m - pose.rotation @ np.array([0.01, 0.0, 0.0]))
    points = np.array([[0.0, 0.3, 0.0]])
    surface = scene.truth.collector.surface
    found = seen_again(View(CAMERA, pose), View(CAMERA, moved), points, surface)
    assert found[0, 0] == pytest.approx(0.01, abs=1e-4)
    assert found[0, 2] == pytest.approx(found[0, 0] ** 2 / (4 * 1.49), abs=1e-12)


def test_bearings_are_those_of_the_tube() -> None:
    scene = short_scene(perfect(), rows=30)
    noise = EdgeNoise(absorber_px=0.1)
    found = measured_bearings(scene, scene.views, noise, np.random.default_rng(3))
    eyes = np.array([pose.inverse().translation_m for _, pose in scene.views])[found.photo]
    x, z = scene.truth.absorber.at(found.y_m)
    deviation = (found.angle_rad - bearing(x, z, eyes)) / found.sigma_rad
    assert np.std(deviation) == pytest.approx(1.0, abs=0.15)
    assert found.sigma_rad[0] == pytest.approx(0.1 / 1030)


def test_a_typical_mirror_has_the_slope_errors_asked_for() -> None:
    collector = short_trough()
    x, y = (part.reshape(-1) for part in np.meshgrid(np.linspace(-2.49, 2.49, 60), np.linspace(-1.5, 1.5, 40)))
    squares = []
    for seed in range(60):
        errors = TypicalMirror.drawn(collector, np.random.default_rng(seed), 3e-3, 1e-3).errors(x, y)
        squares.append([float(np.mean(one**2)) for one in errors])
    rms = np.sqrt(np.mean(squares, axis=0))
    np.testing.assert_allclose(rms, [3e-3, 1e-3], rtol=0.1)


def test_a_measured_mirror_is_interpolated_and_its_holes_are_filled() -> None:
    x, y = np.linspace(-2, 2, 41), np.linspace(-1, 1, 11)
    grid_x, grid_y = np.meshgrid(x, y)
    error = 1e-3 * grid_x + 2e-3 * grid_y
    measured = error.copy()
    measured[3, 10:14] = np.nan
    flags = np.where(np.isfinite(measured), 0, 512).astype(np.uint32)
    zero, sigma = np.zeros_like(error), np.where(np.isfinite(measured), 1e-4, np.nan)
    slope_map = SlopeMap(
        x,
        y,
        measured + 0.1,
        np.full_like(error, np.nan),
        zero + 0.1,
        zero,
        sigma,
        np.full_like(error, np.nan),
        1.0,
        no_common_modes(),
        np.full_like(error, np.nan),
        flags,
        np.ones_like(error, dtype=bool),
        design="plane",
        frame="trough",
        removed="nothing",
    )
    found_x, found_y = MeasuredMirror.of(slope_map).errors(np.array([0.333, -0.95]), np.array([0.111, -0.4]))
    np.testing.assert_allclose(found_x, [1e-3 * 0.333 + 2e-3 * 0.111, 1e-3 * -0.95 + 2e-3 * -0.4], atol=1e-9)
    np.testing.assert_array_equal(found_y, 0.0)


def test_believed_poses_differ_by_what_their_covariance_says() -> None:
    scene = short_scene(perfect())
    believed = believed_with_errors(scene, np.random.default_rng(4))
    shift = [
        a[1].inverse().translation_m - b[1].inverse().translation_m
        for a, b in zip(believed.views, scene.views, strict=True)
    ]
    assert 1e-3 < np.std(shift) < 5e-3
