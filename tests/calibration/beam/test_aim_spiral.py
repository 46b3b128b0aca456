"""Aim points that look for a lost beam."""

import numpy as np
import pytest

from calibration.beam.light.aim_spiral import MOST_RINGS, search_spiral
from heliogauge.errors import InputError


def test_search_spiral_covers_every_block_once() -> None:
    places = search_spiral(2.0, 3)
    assert places.shape == (49, 2)
    assert {tuple(place) for place in places} == {(float(x), float(y)) for x in range(-3, 4) for y in range(-3, 4)}
    assert np.abs(np.diff(places, axis=0)).sum(axis=1) == pytest.approx(1.0)
    rings = np.abs(places).max(axis=1)
    assert (np.diff(rings) >= 0).all()
    assert places[:6].tolist() == [[0, 0], [1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0]]


def test_a_spiral_that_no_memory_holds_is_refused() -> None:
    assert len(search_spiral(2.0, MOST_RINGS)) == (2 * MOST_RINGS + 1) ** 2
    with pytest.raises(
        InputError, match=r"rings: 0 to 100 are needed, not 100000, which are 40,000,400,001 aim points"
    ):
        search_spiral(2.0, 100_000)
