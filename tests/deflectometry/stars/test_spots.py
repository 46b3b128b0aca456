"""Points of light: places, and what is around a facet under a sky that glows."""

import cv2
import numpy as np
import pytest

from deflectometry.stars.spots import RIM_PX, Spots, find_spots

SHAPE = (160, 200)
STARS = np.array([[60.3, 40.2], [120.7, 90.4], [80.1, 110.6], [148.4, 44.9]])


def facet() -> np.ndarray:
    mask = np.zeros(SHAPE, dtype=np.uint8)
    cv2.fillPoly(mask, [np.array([[35, 25], [165, 30], [160, 135], [30, 128]])], 1)
    return mask


def spots_of(mirror_dn: float, around_dn: float, seed: int = 3) -> Spots:
    """Stars of 400 DN in a facet that shows the glow of the sky, before what glows less or more."""
    rng, mask = np.random.default_rng(seed), facet()
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    light = cv2.GaussianBlur(np.where(mask > 0, mirror_dn, around_dn).astype(np.float64), (0, 0), 0.8)
    for at_x, at_y in STARS:
        light += 400 / (2 * np.pi) * np.exp(-0.5 * ((x - at_x) ** 2 + (y - at_y) ** 2))
    inside = cv2.erode(mask, np.ones((2 * RIM_PX + 1,) * 2, np.uint8)) > 0
    return find_spots(np.rint(light + 2.0 * rng.standard_normal(SHAPE)), inside, 4095.0)


@pytest.mark.parametrize(("mirror_dn", "around_dn"), [(60, 60), (300, 40), (40, 300), (900, 20)])
def test_stars_alone_whatever_glows_around_the_facet(mirror_dn: float, around_dn: float) -> None:
    found = spots_of(mirror_dn, around_dn)
    assert len(found.flux_dn) == len(STARS)
    away = np.linalg.norm(found.places_px[:, None] - STARS, axis=2)
    assert sorted(away.argmin(axis=1).tolist()) == list(range(len(STARS)))
    assert (away.min(axis=1) < 4 * found.sigma_px).all()
    np.testing.assert_allclose(np.sort(found.flux_dn), np.sort(spots_of(60, 60).flux_dn), rtol=0.01)
