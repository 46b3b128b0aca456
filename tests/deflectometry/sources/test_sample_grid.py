"""Samples on a lattice: where they are in the image, and which sample a place in the image belongs to."""

import numpy as np
import pytest

from deflectometry.sources import LatticeGrid, PixelGrid


def _lattice() -> LatticeGrid:
    x, y = np.meshgrid(np.arange(12.0), np.arange(9.0))
    places = np.stack([20 + 11 * x + 0.3 * np.sin(y), 15 + 10 * y + 0.4 * np.cos(x)], axis=-1)
    places[4, 5] = np.nan
    return LatticeGrid(places)


def test_places_are_inverse_to_pixels() -> None:
    grid = _lattice()
    row, column = np.nonzero(np.isfinite(grid.places_px[..., 0]))
    found = grid.places(grid.pixels_px(row, column))
    assert found == pytest.approx(np.stack([column, row], axis=1), abs=1e-9)
    between = grid.places(0.5 * (grid.places_px[2:3, 3] + grid.places_px[2:3, 4]))
    assert between[0] == pytest.approx([3.5, 2.0], abs=0.02)
    assert (grid.places(np.array([[0.0, 0.0]])) < -2).all()


def test_an_image_is_read_where_the_samples_are() -> None:
    grid, image = _lattice(), np.zeros((120, 160), dtype=np.int16)
    image[15:60] = 7
    read = grid.of_image(image, -1)
    assert read[4, 5] == -1
    assert (read[:4] == 7).all()
    assert (read[5:, :5] == 0).all()
    assert PixelGrid().of_image(image, -1) is image


def test_spacing_is_that_of_neighbours() -> None:
    assert _lattice().spacing_px == pytest.approx(np.sqrt(110), rel=0.01)
