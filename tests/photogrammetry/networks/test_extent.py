"""The largest distance of two points against all pairs."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from photogrammetry.networks.quality import largest_distance_m


@pytest.mark.parametrize("n_points", [2, 3, 70, 1000])
@pytest.mark.parametrize("shape", ["cloud", "plane", "sphere", "one place"])
def test_largest_distance_is_that_of_all_pairs(n_points, shape):
    points = np.random.default_rng(n_points).normal(size=(n_points, 3))
    if shape == "plane":
        points[:, 2] = 0.0
    elif shape == "sphere":
        points /= np.linalg.norm(points, axis=1)[:, None]
    elif shape == "one place":
        points[:] = points[0]
    assert largest_distance_m(points) == pytest.approx(pdist(points).max(), rel=1e-14)


def test_a_single_point_has_no_extent():
    assert largest_distance_m(np.zeros((1, 3))) == 0.0
