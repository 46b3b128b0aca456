"""Glass that nobody stated shows in a tube that looks wider near its own reflection; a bare tube is not blamed."""

from dataclasses import replace

import numpy as np
import pytest

from observer.absorber.forgotten_glass import glass_doubt, widening
from observer.photo_edges.tube_bearings import Bearings
from observer.trough.collector import Collector, ls2

BARE: Collector = replace(ls2(), glass=None)
ROWS = 40
#: How far from the reflection twenty photos of a pass across the trough are [rad], and how wide the tube looked to them
#: in ray-traced photos of one in glass, 7 px wide [mm].
TO_REFLECTION = (
    0.235,
    0.204,
    0.167,
    0.145,
    0.133,
    0.103,
    0.096,
    0.061,
    0.041,
    0.012,
    0.010,
    0.036,
    0.055,
    0.081,
    0.103,
    0.126,
    0.146,
    0.173,
    0.203,
    0.219,
)
IN_GLASS = (
    69.6,
    69.5,
    69.3,
    69.3,
    69.2,
    69.3,
    69.3,
    70.9,
    76.6,
    77.8,
    77.1,
    76.6,
    71.5,
    69.6,
    69.3,
    69.2,
    69.1,
    69.4,
    69.5,
    69.6,
)


def bearings(width_mm: np.ndarray, to_reflection: np.ndarray) -> Bearings:
    photo = np.repeat(np.arange(len(width_mm)), ROWS)
    none, wide = np.zeros(photo.size), 1e-3 * np.repeat(width_mm, ROWS)
    return Bearings(photo, none, none, none, wide, none, none + 10.4e-3, np.repeat(to_reflection, ROWS))


def seen(width_mm: object, scatter_mm: float = 0.0, seed: int = 0) -> Bearings:
    noise = np.random.default_rng(seed).normal(0, scatter_mm, len(TO_REFLECTION))
    return bearings(np.asarray(width_mm) + noise, np.array(TO_REFLECTION))


def test_a_tube_in_glass_that_was_not_stated() -> None:
    found = widening(seen(IN_GLASS))
    assert found is not None
    assert found.value_m == pytest.approx(7.5e-3, abs=0.5e-3)
    assert found.pixel_m == pytest.approx(10.4e-3)
    said = glass_doubt(found, BARE)
    assert said is not None
    assert said.code == "glass_not_stated"
    assert "glass_outer_diameter_mm" in said.text
    assert glass_doubt(found, ls2()) is None


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("scatter_mm", [0.05, 2.0])
def test_a_bare_tube_is_not_blamed(scatter_mm: float, seed: int) -> None:
    # Clouds and blur change the width from photo to photo.
    flat = np.full(len(TO_REFLECTION), 70.3)
    assert glass_doubt(widening(seen(flat, scatter_mm, seed)), BARE) is None


def test_photos_from_one_kind_of_place_tell_nothing() -> None:
    angle = np.array(TO_REFLECTION)
    for chosen in (angle > 0.07, angle < 0.07):
        assert widening(bearings(np.array(IN_GLASS)[chosen], angle[chosen])) is None
    none = np.zeros(3)
    assert widening(Bearings(np.arange(3), none, none, none, none + 0.07)) is None
