"""The synthetic screen: hits lie on the wall, display coordinates invert its points."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from data_synth.optics.wall import Wall
from heliogauge.errors import InputError

FLAT = Wall(8.0, 3.0)
CURVED = Wall(8.0, 3.0, 0.15, -0.05, 0.03, -0.02)


def _uv(n=200):
    return np.random.default_rng(5).uniform(0, 1, (2, n))


@pytest.mark.parametrize("wall", [FLAT, CURVED], ids=["flat", "curved"])
def test_display_coordinates_invert_the_points(wall):
    u, v = _uv()
    assert_allclose(wall.display_coordinates(wall.points_m(u, v)), [u, v], atol=1e-14)


@pytest.mark.parametrize("wall", [FLAT, CURVED], ids=["flat", "curved"])
def test_rays_towards_points_of_the_wall_hit_them(wall):
    u, v = _uv()
    points = wall.points_m(u, v)
    origins = np.array([0.4, -0.3, 9.0]) + 0.1 * np.random.default_rng(6).normal(size=points.shape)
    directions = points - origins
    assert_allclose(wall.hit(origins, directions / np.linalg.norm(directions, axis=1)[:, None]), points, atol=1e-12)


def test_corners_of_the_display():
    # As a viewer sees it: u = 0 left is -x, v = 0 top is +y.
    assert_allclose(FLAT.points_m(np.array(0.0), np.array(0.0)), [-4.0, 1.5, 0.0])
    assert_allclose(CURVED.points_m(np.array(1.0), np.array(0.5))[2], 0.15)


def test_rays_from_behind_or_away_see_nothing():
    behind = FLAT.hit(np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0]))
    away = FLAT.hit(np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0]))
    assert np.isnan(behind).all()
    assert np.isnan(away).all()


def test_impossible_walls_are_refused():
    with pytest.raises(InputError, match="screen width_m"):
        Wall(0.0, 1.0)
    with pytest.raises(InputError, match="keystone"):
        Wall(1.0, 1.0, keystone_x=0.9)
