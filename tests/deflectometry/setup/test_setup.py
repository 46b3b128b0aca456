"""Screens: display coordinates to points."""

import numpy as np
import pytest

from deflectometry.setup.camera_and_screen import RectangularScreen, TabulatedScreen
from heliogauge.errors import InputError


def table(shape):
    u, v = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 1, 11), np.linspace(0, 1, 9)))
    return u, v, shape(u, v)


def bowed(u, v):
    return np.stack([8 * (u - 0.5) + 0.01 * v * v, 4 * (0.5 - v), 0.02 * (u - 0.5) ** 2 + 0.01 * u * v], axis=-1)


def test_display_runs_right_and_down_the_frame_right_and_up():
    screen = RectangularScreen(8.0, 4.0)
    corners = screen.points_m(np.array([0.0, 1.0, 0.5]), np.array([0.0, 1.0, 0.5]))
    assert np.allclose(corners, [[-4, 2, 0], [4, -2, 0], [0, 0, 0]])


def test_table_of_a_flat_screen_is_that_screen():
    u, v, points = table(lambda u, v: np.stack([8 * (u - 0.5), 4 * (0.5 - v), 0 * u], axis=-1))
    rng = np.random.default_rng(2)
    at = rng.uniform(0, 1, (2, 500))
    difference = TabulatedScreen(u, v, points).points_m(*at) - RectangularScreen(8.0, 4.0).points_m(*at)
    assert np.abs(difference).max() < 1e-6


def test_table_goes_through_its_points_and_follows_a_bow_between_them():
    u, v, points = table(bowed)
    screen = TabulatedScreen(u, v, points)
    assert np.abs(screen.points_m(u, v) - points).max() < 5e-6
    at = np.random.default_rng(2).uniform(0.1, 0.9, (2, 500))
    assert np.abs(screen.points_m(*at) - bowed(*at)).max() < 1e-4


def test_off_the_display_is_nan_and_scalars_work():
    u, v, points = table(bowed)
    screen = TabulatedScreen(u, v, points)
    assert np.isnan(screen.points_m(np.array([-0.01, 0.5, np.nan]), np.array([0.5, 1.01, 0.5]))).all()
    assert screen.points_m(np.float64(0.5), np.float64(0.5)).shape == (3,)
    assert screen.points_m(np.zeros((4, 5)), np.zeros((4, 5))).shape == (4, 5, 3)


@pytest.mark.parametrize(
    ("u", "v", "message"),
    [
        ([0.0, 1.0, 0.5], [0.0, 0.0, 1.0], "3 points given"),
        ([0.0, 0.3, 0.6, 1.0], [0.0, 0.3, 0.6, 1.0], "not on one line"),
        ([0.0, 1.0, 0.0, 1.0, 1.0], [0.0, 0.0, 1.0, 1.0, 1.0], "two points have the same"),
    ],
)
def test_tables_that_determine_no_screen_are_refused(u, v, message):
    with pytest.raises(InputError, match=message):
        TabulatedScreen(u, v, np.zeros((len(u), 3)))


def test_size_must_be_positive():
    with pytest.raises(InputError, match="screen width_m"):
        RectangularScreen(0.0, 1.0)


def test_large_tables_are_done_in_tiles_without_seams():
    u, v = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 41)))
    screen = TabulatedScreen(u, v, bowed(u, v))
    line = np.linspace(0.0, 1.0, 4001)
    points = screen.points_m(line, np.full_like(line, 0.37))
    assert np.abs(points - bowed(line, np.full_like(line, 0.37))).max() < 2e-5
    # A seam would show as a step of the second difference.
    assert np.abs(np.diff(points, n=2, axis=0)).max() < 1e-5
