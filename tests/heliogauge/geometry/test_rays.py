"""Rays: the law of reflection, checked by angles."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliogauge.geometry.rays import intersect_plane, reflect

seeds = st.integers(0, 2**32 - 1)


def directions(rng, n):
    vectors = rng.normal(size=(n, 3))
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


@given(seeds)
def test_reflection_keeps_length_and_is_its_own_inverse(seed):
    rng = np.random.default_rng(seed)
    ray, normal = 3 * directions(rng, 50), 0.7 * directions(rng, 50)
    out = reflect(ray, normal)
    np.testing.assert_allclose(np.linalg.norm(out, axis=1), 3, rtol=1e-13)
    np.testing.assert_allclose(reflect(out, -normal), ray, rtol=0, atol=1e-13)
    # angle of incidence equals angle of reflection, in one plane
    np.testing.assert_allclose((ray * normal).sum(1), -(out * normal).sum(1), rtol=0, atol=1e-13)
    np.testing.assert_allclose((np.cross(ray, out) * normal).sum(1), 0, rtol=0, atol=1e-12)


def test_a_tilt_turns_the_beam_by_twice_the_tilt_towards_the_tilt():
    # slope dz/dx = +1 mrad: the normal leans to -x, and so does the beam, by twice the angle
    out = reflect([0.0, 0.0, -1.0], [-1e-3, 0.0, 1.0])
    assert np.arctan2(out[0], out[2]) == pytest.approx(-2 * np.arctan(1e-3), rel=1e-12)


def test_plane_intersection_and_parallel_lines():
    t = intersect_plane([[0, 0, 5.0], [0, 0, 5.0]], [[0, 1.0, -1.0], [1.0, 0, 0]], [7, 8, 2.0], [0, 0, -3.0])
    assert t[0] == pytest.approx(3.0)
    assert np.isnan(t[1])
