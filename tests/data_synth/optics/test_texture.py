"""Textured ground: what it is between its nodes and beyond its paper."""

import numpy as np
import pytest

from data_synth.optics.coverage import Footprint
from data_synth.optics.texture import TexturePrint, random_texture
from heliogauge.errors import InputError

CELL = Footprint(np.eye(2) * 1e-6)


def ink(texture: TexturePrint, x: list[float], y: list[float]) -> list[float]:
    return texture.ink(np.array([x], np.float32), np.array([y], np.float32), CELL)[0].tolist()


def test_linear_between_nodes_and_nothing_beyond_the_paper() -> None:
    texture = TexturePrint(np.array([[0.0, 1.0, 0.5], [0.2, 0.4, 0.6]]), 0.1)
    assert texture.half_size_m == pytest.approx((0.1, 0.05))
    # Rows from the top: the first row has y = +0.05.
    assert ink(texture, [-0.0999, 0.0, 0.0, 0.05], [0.0499, 0.0499, -0.0499, 0.0]) == pytest.approx(
        [0.0, 1.0, 0.4, 0.625], abs=2e-3
    )
    assert ink(texture, [0.11, 0.0, 1e6], [0.0, 0.06, -1e6]) == [0.0, 0.0, 0.0]


def test_random_texture_uses_the_range_and_has_spots_of_all_sizes() -> None:
    texture = random_texture((0.5, 0.4), 0.002, np.random.default_rng(1))
    assert texture.shares.shape == (201, 251)
    assert 0.15 < texture.shares.std() < 0.3
    spectrum = np.abs(np.fft.rfft(texture.shares - texture.shares.mean(), axis=1)).mean(axis=0)
    assert spectrum[2] > 5 * spectrum[60] > 0
    assert texture.points_m == {}


@pytest.mark.parametrize("shares", [np.ones((1, 3)), np.full((3, 3), 1.5), -np.ones((2, 2))])
def test_bad_shares(shares: np.ndarray) -> None:
    with pytest.raises(InputError, match="texture"):
        TexturePrint(shares, 0.1)
