"""Geodetic coordinates to east, north, up and back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliogauge.errors import InputError
from heliogauge.geometry.geodesy import enu_from_geodetic, geodetic_from_enu

ORIGIN = (50.913421122592574, 6.387824755874856, 87.0)


@given(east=st.floats(-3e4, 3e4), north=st.floats(-3e4, 3e4), up=st.floats(-500, 8000), latitude=st.floats(-89.9, 89.9))
def test_there_and_back(east, north, up, latitude):
    origin = (latitude, 179.9, 500.0)
    point = np.array([east, north, up])
    np.testing.assert_allclose(enu_from_geodetic(*geodetic_from_enu(point, origin), origin), point, atol=2e-8)


def test_a_step_along_meridian_and_parallel_against_the_radii_of_curvature():
    """Small steps: metres per degree from the textbook's meridian and prime vertical radii."""
    latitude = np.deg2rad(ORIGIN[0])
    e2 = 0.00669437999014
    prime = 6378137.0 / np.sqrt(1 - e2 * np.sin(latitude) ** 2)
    meridian = 6378137.0 * (1 - e2) / np.sqrt(1 - e2 * np.sin(latitude) ** 2) ** 3
    step = 1e-4
    north = enu_from_geodetic(ORIGIN[0] + step, *ORIGIN[1:], ORIGIN)
    east = enu_from_geodetic(ORIGIN[0], ORIGIN[1] + step, ORIGIN[2], ORIGIN)
    np.testing.assert_allclose(north[1], np.deg2rad(step) * (meridian + ORIGIN[2]), rtol=1e-5)
    np.testing.assert_allclose(east[0], np.deg2rad(step) * (prime + ORIGIN[2]) * np.cos(latitude), rtol=1e-9)
    np.testing.assert_allclose(enu_from_geodetic(*ORIGIN[:2], 100.0, ORIGIN), [0, 0, 13.0], atol=1e-8)


def test_the_ground_drops_below_the_plane():
    """78 mm at 1 km: d^2 / (2 R)."""
    east = enu_from_geodetic(ORIGIN[0], ORIGIN[1] + 1000 / 70328.9, ORIGIN[2], ORIGIN)
    assert east[0] == pytest.approx(1000, abs=1)
    assert east[2] == pytest.approx(-(east[0] ** 2) / (2 * 6.39e6), rel=2e-3)


def test_many_points_and_refusals():
    points = enu_from_geodetic([50.9, 50.91], [6.38, 6.39], [80, 90], ORIGIN)
    assert points.shape == (2, 3)
    with pytest.raises(InputError, match="beyond the pole; latitude precedes longitude"):
        enu_from_geodetic(106.0, 35.0, 0.0, ORIGIN)
    with pytest.raises(InputError, match="origin"):
        enu_from_geodetic(50.0, 6.0, 0.0, (50.0, 6.0))
    with pytest.raises(InputError, match="beyond the pole"):
        geodetic_from_enu([0.0, 0.0, 0.0], (-116.8, 34.8, 0.0))
