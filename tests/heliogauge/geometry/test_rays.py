"""Rays: the laws of reflection and refraction, checked by angles and by Fermat's principle."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliogauge.errors import InputError
from heliogauge.geometry.rays import intersect_plane, reflect, refract

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


@given(seeds, st.floats(1.0, 2.0), st.floats(1.0, 2.0))
def test_refraction_follows_snell_and_reverses(seed, index_from, index_to):
    rng = np.random.default_rng(seed)
    ray, normal = directions(rng, 50), directions(rng, 50)
    out = refract(ray, normal, index_from, index_to)
    sine_in = np.linalg.norm(np.cross(ray, normal), axis=1)
    passes = index_from * sine_in < index_to * (1 - 1e-9)
    sine_out = np.linalg.norm(np.cross(out, normal), axis=1)
    np.testing.assert_allclose(index_from * sine_in[passes], index_to * sine_out[passes], rtol=0, atol=1e-12)
    total = index_from * sine_in > index_to * (1 + 1e-9)
    assert np.isnan(out[total]).all()
    clear = index_from * sine_in < 0.99 * index_to
    np.testing.assert_allclose(
        refract(-out[clear], normal[clear], index_to, index_from), -ray[clear], rtol=0, atol=1e-12
    )


def test_refraction_is_the_path_of_least_time():
    # from (0, 1) in air to (1, -1) in glass: minimise the optical path over the crossing point
    x = np.linspace(0, 1, 200_001)
    path = np.hypot(x, 1) + 1.5 * np.hypot(1 - x, 1)
    crossing = x[path.argmin()]
    out = refract([crossing, 0, -1], [0, 0, 1], 1.0, 1.5)
    assert out[0] / -out[2] == pytest.approx(1 - crossing, abs=2e-5)


def test_plane_intersection_and_parallel_lines():
    t = intersect_plane([[0, 0, 5.0], [0, 0, 5.0]], [[0, 1.0, -1.0], [1.0, 0, 0]], [7, 8, 2.0], [0, 0, -3.0])
    assert t[0] == pytest.approx(3.0)
    assert np.isnan(t[1])


def test_refraction_refuses_an_impossible_index():
    with pytest.raises(InputError, match="index_to"):
        refract([0, 0, 1], [0, 0, 1], 1.0, 0.0)
