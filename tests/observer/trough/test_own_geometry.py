"""The observation equation and the simulated edges against plain vectors: reflect, and see how far the tube is."""

import numpy as np
import pytest

from observer.planning.simulated_edges import EdgeNoise, true_edges
from observer.trough.absorber_path import AbsorberPath
from observer.trough.observation_equation import Sights, misfit
from observer.trough.typical_mirror import TypicalMirror
from tests.observer.own_trough import axis_of, own_edges, passing, reflected, true_slopes
from tests.observer.simulated_trough import short_scene, short_trough

RADIUS_M, FOCAL_M, AXIS = 0.035, 1.49, (0.004, 1.483)


def sights_drawn(seed: int, count: int = 400) -> tuple[Sights, tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-2.5, 2.5, count), rng.uniform(-2, 2, count)
    points = np.stack([x, y, x**2 / (4 * FOCAL_M)], axis=1)
    eyes = np.stack([x + rng.uniform(-0.4, 0.4, count), rng.uniform(-3, 3, count), rng.uniform(8, 20, count)], axis=1)
    slopes = x / (2 * FOCAL_M) + rng.normal(0, 3e-3, count), rng.normal(0, 3e-3, count)
    return Sights(points, eyes, rng.choice([-1.0, 1.0], count)), slopes


def beside_line(points: np.ndarray, ways: np.ndarray, through: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Distance of lines from a line."""
    across = np.cross(ways, along)
    return np.asarray(np.abs(((points - through) * across).sum(axis=1)) / np.linalg.norm(across, axis=1))


@pytest.mark.parametrize("lean", [(0.0, 0.0), (0.0, 8e-3), (-6e-3, 4e-3)])
def test_a_leaning_tube_is_touched_where_the_line_of_sight_is_a_radius_from_its_axis(lean):
    """A tube that sags leans by some mrad; as if it did not, lines of sight missed it by up to 0.2 mm."""
    sights, (slope_x, slope_y) = sights_drawn(3)
    ends = np.array([-30.0, 30.0])
    path = AbsorberPath(ends, AXIS[0] + lean[0] * ends, AXIS[1] + lean[1] * ends, np.zeros((4, 4)))
    for _ in range(6):
        found = misfit(sights, (slope_x, slope_y), path, RADIUS_M)
        slope_x = slope_x - found.angle_rad / found.d_angle_d_slope_x
    ways = reflected(sights.points_m, sights.eyes_m, (slope_x, slope_y))
    distance = beside_line(sights.points_m, ways, np.array([AXIS[0], 0.0, AXIS[1]]), np.array([lean[0], 1.0, lean[1]]))
    # A cut across the trough through a leaning tube is round to half the square of the lean: 1 um.
    np.testing.assert_allclose(distance, RADIUS_M, atol=2e-6)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_angle_is_that_of_plain_vectors(seed):
    sights, slopes = sights_drawn(seed)
    found = misfit(sights, slopes, AbsorberPath.straight(*AXIS, 5.0), RADIUS_M)
    ways = reflected(sights.points_m, sights.eyes_m, slopes)
    distance = passing(sights.points_m, ways, AXIS)[0]
    reach = np.hypot(AXIS[0] - sights.points_m[:, 0], AXIS[1] - sights.points_m[:, 2])
    # The axis is missed by the angle whose sine is distance over reach, the edge by half the tube's width more.
    expected = -np.arcsin(distance / reach) + sights.side * np.arcsin(RADIUS_M / reach)
    np.testing.assert_allclose(found.angle_rad, expected, atol=1e-9)
    # It is said to pass the tube where it is as high as the axis.
    rising = (AXIS[1] - sights.points_m[:, 2]) / ways[:, 2]
    at_height = sights.points_m[:, 1] + rising * ways[:, 1]
    np.testing.assert_allclose(found.passing_y_m, at_height, atol=1e-9)


@pytest.mark.parametrize("seed", [3, 4])
def test_what_moves_with_the_world_changes_nothing(seed):
    sights, slopes = sights_drawn(seed)
    tube = AbsorberPath.straight(*AXIS, 9.0)
    angle = misfit(sights, slopes, tube, RADIUS_M).angle_rad
    along = np.array([0.0, 1.7, 0.0])
    shifted = Sights(sights.points_m + along, sights.eyes_m + along, sights.side)
    np.testing.assert_allclose(misfit(shifted, slopes, tube, RADIUS_M).angle_rad, angle, atol=1e-12)
    # Mirrored in x, left edge and right edge change places and angles their sign; mirrored in y, nothing changes.
    flip = np.array([-1.0, 1.0, 1.0])
    other = Sights(sights.points_m * flip, sights.eyes_m * flip, -sights.side)
    mirrored = misfit(other, (-slopes[0], slopes[1]), AbsorberPath.straight(-AXIS[0], AXIS[1], 9.0), RADIUS_M)
    np.testing.assert_allclose(mirrored.angle_rad, -angle, atol=1e-12)
    flip = np.array([1.0, -1.0, 1.0])
    other = Sights(sights.points_m * flip, sights.eyes_m * flip, sights.side)
    np.testing.assert_allclose(misfit(other, (slopes[0], -slopes[1]), tube, RADIUS_M).angle_rad, angle, atol=1e-12)
    # Nearer along its line of sight a camera sees the same.
    nearer = Sights(sights.points_m, (sights.eyes_m + sights.points_m) / 2, sights.side)
    np.testing.assert_allclose(misfit(nearer, slopes, tube, RADIUS_M).angle_rad, angle, atol=1e-12)


def test_simulated_edges_touch_the_tube_and_none_is_missing():
    mirror = TypicalMirror.drawn(short_trough(), np.random.default_rng(8), 3e-3, 1e-3)
    scene = short_scene(mirror, photos=12, rows=6)
    edges, own = true_edges(scene, EdgeNoise()), own_edges(scene, 0.05)
    points = edges.points_m
    eyes = np.array([view.cam_from_frame.inverse().translation_m for view in scene.views])[edges.photo]
    ways = reflected(points, eyes, true_slopes(scene, points[:, 0], points[:, 1]))
    distance = passing(points, ways, axis_of(scene))[0]
    np.testing.assert_allclose(distance, edges.side * scene.truth.collector.absorber_diameter_m / 2, atol=1e-6)
    # Each of those found by plain vectors, which keep farther from borders, is among them; and steps the same way.
    for photo, row, side, point, step in zip(own.photo, own.row, own.side, own.points_m, own.contrast, strict=True):
        same = (edges.photo == photo) & (edges.row == row) & (edges.side == side)
        off = np.abs(points[same, 0] - point[0])
        assert off.min() < 1e-5
        assert np.sign(edges.contrast[same][np.argmin(off)]) == np.sign(step)
