"""The middle of a dot's image against the image of its middle, by summing the area of the image itself."""

from typing import Any

import numpy as np

from deflectometry.dots.dot_size import shift_of_size
from deflectometry.dots.dot_source import DotSource
from deflectometry.dots.found_dots import FoundDots
from heliogauge.validate import FloatArray

_RADIUS, _WAVE = 0.25, 2 * np.pi / 6


def _image(places: FloatArray) -> FloatArray:
    """Return where the photo shows places of the wall: waves six dots long, aslant."""
    along = _WAVE * (0.83 * places[..., 0] + 0.56 * places[..., 1])
    bent = 0.06 * np.stack([0.83 * np.sin(along), 0.56 * np.sin(along)], axis=-1)
    return np.asarray(14.0 * (places + bent) @ np.array([[1.0, 0.03], [-0.05, 0.95]]))


def _disc() -> tuple[FloatArray, FloatArray]:
    """Return places of a disc and what each stands for of its area."""
    radius = (np.arange(40) + 0.5) / 40 * _RADIUS
    angle = (np.arange(60) + 0.5) / 60 * 2 * np.pi
    r, t = np.meshgrid(radius, angle)
    return np.stack([r * np.cos(t), r * np.sin(t)], axis=-1).reshape(-1, 2), r.ravel()


def test_the_middle_of_an_image_is_where_it_is_said_to_be() -> None:
    number = np.stack(np.meshgrid(np.arange(12.0), np.arange(12.0)), axis=-1)
    places = number + 0.01 * np.random.default_rng(2).standard_normal(number.shape)
    disc, weight = _disc()
    step = 1e-4
    middles, shapes = np.empty(places.shape), np.empty((*places.shape, 2))
    for at in np.ndindex(places.shape[:2]):
        there = places[at] + disc
        image = _image(there)
        by_x, by_y = ((_image(there + off) - _image(there - off)) / (2 * step) for off in step * np.eye(2))
        area = weight * np.abs(by_x[:, 0] * by_y[:, 1] - by_x[:, 1] * by_y[:, 0])
        middles[at] = area @ image / area.sum()
        off = image - middles[at]
        shapes[at] = 4 * np.einsum("n,ni,nj->ij", area, off, off) / area.sum()
    true = middles - _image(places)
    on_wall = np.concatenate([0.045 * places, np.zeros((*places.shape[:2], 1))], axis=-1)
    found = shift_of_size(middles, on_wall, shapes)
    inner = np.s_[2:-2, 2:-2]
    assert np.isnan(found[0]).all()
    assert np.sqrt(np.mean(true[inner] ** 2)) > 0.01
    assert np.sqrt(np.mean((found - true)[inner] ** 2)) < 0.1 * np.sqrt(np.mean(true[inner] ** 2))


def test_ellipses_are_exchanged_with_the_sides_of_the_photo() -> None:
    places = np.array([[3.0, 2.0], [5.0, 6.0]])
    shapes = np.tile(np.array([[4.0, 1.0], [1.0, 3.0]]), (2, 1, 1))
    number = np.array([[0, 0], [1, 1]])
    dots = FoundDots(places, 0.01 * shapes, number, np.full(2, 50.0), 1.0, shapes_px2=shapes, blur_px=1.0)
    wall: Any = None
    source = DotSource(np.zeros((10, 12), dtype=np.float32), (dots,), wall)
    seen: Any = None
    for words, changed, moves_outline in source.exchanges(seen):
        assert isinstance(changed, DotSource)
        assert changed.dots is not None
        assert moves_outline
        # A centre's covariance and its ellipse were alike, and are.
        np.testing.assert_allclose(changed.dots[0].outlines_px2, 100 * changed.dots[0].covariance_px2, err_msg=words)
