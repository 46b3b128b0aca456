"""Edges across a strip: bias and scatter against drawn edges that are integrated over the pixel."""

from math import erf

import numpy as np
import pytest

from observer.photo_edges.edges import find_edges
from observer.photo_edges.rectify import Strip

STEP_M = 6.3e-3
ERF = np.vectorize(erf)


def drawn_strip(
    rng: np.random.Generator, *, blur_px: float, noise_dn: float, shading: float, contrast_dn: float = 130.0
) -> tuple[Strip, np.ndarray]:
    """Draw a dark band on a bright, shaded ground; return its two edges in samples too."""
    n_rows, n = 200, 220
    first = 60 + rng.uniform(0, 1, n_rows) + 0.05 * np.arange(n_rows)
    edges = np.stack([first, first + 100], axis=1)
    columns = np.arange(n)

    def covered(edge: np.ndarray) -> np.ndarray:
        parts = [ERF((columns[None] + o - edge[:, None]) / blur_px / np.sqrt(2)) for o in np.linspace(-0.45, 0.45, 10)]
        return 0.5 + 0.5 * np.mean(parts, axis=0)

    image = 180 + contrast_dn * (covered(edges[:, 1]) - covered(edges[:, 0])) + shading * columns
    image = np.round(image + rng.normal(0, noise_dn, image.shape)).astype(np.float32)
    return Strip(image, columns * STEP_M, np.ones(image.shape, dtype=bool)), edges


@pytest.mark.parametrize(
    ("blur", "noise", "shading"), [(0.5, 1.0, 0.0), (0.5, 1.0, 0.3), (0.8, 2.0, 0.0), (0.4, 0.5, 1.0)]
)
def test_edges_are_where_they_were_drawn(blur: float, noise: float, shading: float) -> None:
    strip, edges = drawn_strip(np.random.default_rng(0), blur_px=blur, noise_dn=noise, shading=shading)
    found, _ = find_edges([strip])
    falling = found.rise_dn < 0
    assert np.count_nonzero(falling) == np.count_nonzero(~falling) == 200
    for which, column in ((falling, 0), (~falling, 1)):
        np.testing.assert_array_equal(found.row[which], np.arange(200))
        errors = found.x_m[which] / STEP_M - edges[:, column]
        # Below half a pixel of blur the pixel grid shows.
        assert abs(errors.mean()) < (0.006 if blur >= 0.5 else 0.02)
        assert errors.std() < 1.1 * np.median(found.sigma_x_m) / STEP_M
        assert np.median(np.abs(found.rise_dn[which])) == pytest.approx(130, rel=0.08)


def test_no_edges_in_noise_or_outside_the_photo() -> None:
    rng = np.random.default_rng(1)
    strip, _ = drawn_strip(rng, blur_px=0.5, noise_dn=3.0, shading=0.2, contrast_dn=0.0)
    assert find_edges([strip])[0].row.size <= 2
    strip, _ = drawn_strip(rng, blur_px=0.5, noise_dn=1.0, shading=0.0)
    seen = np.ones(strip.seen.shape, dtype=bool)
    seen[:, 100:] = False
    assert (find_edges([Strip(strip.image_dn, strip.x_m, seen)])[0].x_m < 100 * STEP_M).all()
