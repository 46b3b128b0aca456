"""How edges are blurred, from discs that are drawn by adding up a fine grid."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from photogrammetry.centers import EdgeShape, edge_shape

#: Points to a pixel of the fine grid, each way; pixels of a drawn disc.
FINE, SIZE = 8, 25
ALONG = np.array([0.0, 2.0])


def discs(rng: np.random.Generator, blur_px: float, mixed: float, n: int = 12) -> tuple[np.ndarray, ...]:
    """Draw dark discs of 4 to 6 px on paper; neighbours above and below are mixed. Image, centres and ellipses."""
    image, centers, ellipses = [], [], []
    place = (np.arange(SIZE * FINE) + 0.5) / FINE - 0.5
    for k in range(n):
        center, axes = SIZE // 2 + rng.uniform(-0.5, 0.5, 2), rng.uniform(4, 6, 2)
        x, y = np.meshgrid(place - center[0], place - center[1])
        light = 150.0 - 120.0 * ((x / axes[0]) ** 2 + (y / axes[1]) ** 2 < 1)
        light = gaussian_filter(light, blur_px * FINE).reshape(SIZE, FINE, SIZE, FINE).mean(axis=(1, 3))
        light[1:-1] = (1 - mixed) * light[1:-1] + 0.5 * mixed * (light[2:] + light[:-2])
        image.append(light)
        centers.append(center + [SIZE * k, 0])
        ellipses.append(np.diag(axes**2))
    drawn = np.hstack(image)
    # Discs at the very rim of a photo are not used.
    drawn = np.pad(drawn + rng.normal(size=drawn.shape), 5, mode="edge")
    return drawn, np.array(centers) + 5, np.array(ellipses)


def found(image: np.ndarray, centers: np.ndarray, ellipses: np.ndarray) -> EdgeShape:
    shape = edge_shape(image, centers, ellipses, ALONG)
    assert shape is not None
    return shape


@pytest.mark.parametrize(("blur_px", "mixed"), [(0.5, 0.0), (0.3, 0.25), (0.5, -0.3), (0.8, 0.2)])
def test_variance_and_mixing_are_those_drawn(blur_px: float, mixed: float) -> None:
    shape = found(*discs(np.random.default_rng(1), blur_px, mixed))
    # A blur of 0.1 px is a tenth of the variance of a pixel's own width.
    assert shape.blur_px**2 + shape.mixed == pytest.approx(blur_px**2 + mixed, abs=0.03)
    assert shape.mixed == pytest.approx(mixed, abs=0.08)


def test_targets_that_are_blurred_differently_say_so() -> None:
    """Half of the discs with 0.4 px, half with 0.6: variances 0.16 and 0.36, 0.1 from their mean."""
    rng = np.random.default_rng(5)
    alike = found(*discs(rng, 0.5, 0.0)).scatter_px2
    (less, centers, ellipses), (more, others, forms) = (discs(rng, blur, 0.0) for blur in (0.4, 0.6))
    both = found(
        np.hstack([less, more]), np.vstack([centers, others + [less.shape[1], 0]]), np.vstack([ellipses, forms])
    )
    assert alike < 0.04
    assert both.scatter_px2 == pytest.approx(0.1, rel=0.25)


def test_one_covered_disc_does_not_count() -> None:
    image, centers, ellipses = discs(np.random.default_rng(2), 0.5, 0.0)
    image[:15, 5 : SIZE + 5] = 150.0
    shape = found(image, centers, ellipses)
    assert shape.blur_px**2 + shape.mixed == pytest.approx(0.25, abs=0.03)


def test_paper_that_saturates_says_nothing() -> None:
    image, centers, ellipses = discs(np.random.default_rng(3), 0.5, 0.0)
    assert edge_shape(np.minimum(image, 100.0), centers, ellipses, ALONG, 100.0) is None


def test_no_discs_or_small_ones_say_nothing() -> None:
    image, centers, ellipses = discs(np.random.default_rng(4), 0.5, 0.0)
    assert edge_shape(image, centers, 0.1 * ellipses, ALONG) is None
    assert edge_shape(image, centers[:0], ellipses[:0], ALONG) is None


@pytest.mark.filterwarnings("error")
def test_corners_have_no_ellipse_and_do_not_count() -> None:
    image, centers, ellipses = discs(np.random.default_rng(5), 0.5, 0.0)
    with_corners = np.concatenate([centers, centers[:3]]), np.concatenate([ellipses, np.full((3, 2, 2), np.nan)])
    assert found(image, *with_corners) == found(image, centers, ellipses)
