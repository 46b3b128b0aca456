"""Edges of a tube behind glass: a dark stripe beside one edge must not pull the bisector."""

from dataclasses import replace
from math import erf

import numpy as np
import pytest

from observer.photo_edges.edges import find_edges
from observer.photo_edges.rectify import Strip
from observer.photo_edges.silhouette import level_edges

STEP_M, HALF_M = 6.3e-3, 0.035
ERF = np.vectorize(erf)


def strip_with_stripe(rng: np.random.Generator, middle_m: np.ndarray, depth_dn: float, noise_dn: float = 0.8) -> Strip:
    """Draw rows with a dark tube, and a stripe of 9 mm in the glass that begins 9 mm beside its left edge."""
    x = np.arange(-0.15, 0.15, STEP_M)

    def bar(low: np.ndarray, high: np.ndarray) -> np.ndarray:
        sigma = 0.65 * STEP_M
        places = [np.asarray(edge)[:, None] for edge in (low, high)]
        return 0.5 * (ERF((x - places[0]) / sigma / 2**0.5) - ERF((x - places[1]) / sigma / 2**0.5))

    image = 126 - 104 * bar(middle_m - HALF_M, middle_m + HALF_M)
    image -= depth_dn * bar(middle_m - 0.053, middle_m - 0.044)
    image += rng.normal(0, noise_dn, image.shape)
    return Strip(image.astype(np.float32), x, np.ones(image.shape, dtype=bool))


@pytest.mark.parametrize(("depth_dn", "largest_m"), [(0.0, 0.03e-3), (40.0, 0.08e-3)])
def test_a_stripe_in_the_glass_hardly_moves_the_middle(depth_dn: float, largest_m: float) -> None:
    rng = np.random.default_rng(0)
    middle = rng.uniform(-0.01, 0.01, 200)
    strip = strip_with_stripe(rng, middle, depth_dn)
    left, right = level_edges(strip, np.arange(200), middle + 0.5e-3, np.full(200, HALF_M), 57.5 / 35)
    assert np.isfinite(left).all()
    assert np.isfinite(right).all()
    # 0.08 mm are 0.013 px; the steepest place would be pulled by twice as much.
    assert abs(np.mean(0.5 * (left + right) - middle)) < largest_m


def test_clouds_that_end_within_the_glass_hardly_move_the_middle() -> None:
    rng = np.random.default_rng(3)
    middle = rng.uniform(-0.01, 0.01, 240)
    strip = strip_with_stripe(rng, middle, 0.0)
    # In some rows the sky right of the tube is darker by 30 DN as far as 20 mm beyond the metal, and brighter after.
    clouded = (np.arange(240) // 40) % 3 == 1
    in_glass = (strip.x_m > middle[:, None]) & (strip.x_m < middle[:, None] + HALF_M + 0.02)
    cloud = np.where(clouded[:, None] & in_glass, (strip.image_dn - 22) * 30 / 104, 0.0)
    strip = replace(strip, image_dn=(strip.image_dn - cloud).astype(np.float32))
    left, right = level_edges(strip, np.arange(240), middle, np.full(240, HALF_M), 57.5 / 35)
    off = 0.5 * (left + right) - middle
    # By the level of what is beyond the glass the middle would be 1.2 mm aside.
    assert abs(off[clouded].mean() - off[~clouded].mean()) < 0.12e-3


def test_the_steepest_place_would_be_pulled() -> None:
    rng = np.random.default_rng(1)
    strip = strip_with_stripe(rng, np.zeros(200), 40.0)
    found, _ = find_edges([strip])
    left, right = (found.x_m[np.abs(found.x_m - side * HALF_M) < 4e-3].mean() for side in (-1, 1))
    assert abs(0.5 * (left + right)) > 0.15e-3


def test_the_tube_is_as_wide_as_it_is_whatever_the_blur() -> None:
    rng = np.random.default_rng(2)
    middle = rng.uniform(-0.01, 0.01, 200)
    strip = strip_with_stripe(rng, middle, 0.0, noise_dn=4.0)
    left, right = level_edges(strip, np.arange(200), middle, np.full(200, HALF_M), 57.5 / 35)
    # A quarter of the way up it would be 6 mm thinner.
    assert abs(np.mean(right - left) - 2 * HALF_M) < 0.1e-3


def test_rows_without_a_tube_have_no_edges() -> None:
    x = np.arange(-0.15, 0.15, STEP_M)
    strip = Strip(np.full((3, x.size), 100, dtype=np.float32), x, np.ones((3, x.size), dtype=bool))
    with np.errstate(all="ignore"):
        left, right = level_edges(strip, np.arange(3), np.zeros(3), np.full(3, HALF_M), 1.6)
    assert np.isnan(left).all()
    assert np.isnan(right).all()
