"""An edge of the reflection beside which a cloud begins is found where it is, not where brightness changes fastest."""

from math import erf

import numpy as np

from observer.photo_edges.edges import find_edges
from observer.photo_edges.rectify import Strip
from observer.photo_edges.reflection_edges import _beside_clouds, _Look

PIXEL_M, BLUR_PX = 0.01, 0.6
ERF = np.vectorize(erf)


def look_at(edge_px: np.ndarray, rise_dn: np.ndarray) -> _Look:
    """Draw a dark tube that ends at an edge in each row, and beside it a sky that changes so much within 4 px."""
    x = np.arange(60.0)
    place = x - edge_px[:, None]
    step = 0.5 * (1 + ERF(place / BLUR_PX / 2**0.5))
    image = 20 + step * (100 + rise_dn[:, None] * np.clip(place, 0, 4))
    return _Look(0, np.zeros(3), PIXEL_M, Strip(image.astype(np.float32), PIXEL_M * x, np.ones(image.shape, bool)))


def test_the_rim_of_a_cloud_beside_an_edge_hardly_moves_it() -> None:
    rng = np.random.default_rng(0)
    edge, rise = rng.uniform(28, 31, 300), rng.uniform(-8, 8, 300)
    look = look_at(edge, rise)
    found = find_edges([look.strip])[0]
    found = found.chosen(np.flatnonzero(np.abs(found.x_m / PIXEL_M - edge[found.row]) < 1))
    assert found.row.size == 300
    kept = _beside_clouds(look, found)
    before, after = (one.x_m / PIXEL_M - edge[one.row] for one in (found, kept))
    # By 0.19 px where the sky changes most; clouds change less far than this sky, and need less of a correction.
    slopes = [float(np.polyfit(rise[one.row], off, 1)[0]) for one, off in ((found, before), (kept, after))]
    assert slopes[0] > 0.01
    assert abs(slopes[1]) < 0.7 * slopes[0]
    assert (kept.sigma_x_m[np.abs(rise[kept.row]) > 6] > 1.5 * found.sigma_x_m[np.abs(rise[kept.row]) > 6]).all()


def test_an_even_sky_leaves_edges_and_sigma_as_they_are() -> None:
    edge = np.random.default_rng(1).uniform(28, 31, 100)
    look = look_at(edge, np.zeros(100))
    found = find_edges([look.strip])[0]
    kept = _beside_clouds(look, found)
    np.testing.assert_allclose(kept.x_m, found.x_m, atol=2e-3 * PIXEL_M)
    np.testing.assert_allclose(kept.sigma_x_m, found.sigma_x_m, rtol=0.05)
