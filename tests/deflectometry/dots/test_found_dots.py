"""Lattices of dots: numbers survive distortion, gaps and specks, and wrong links are outvoted."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from deflectometry.dots.found_dots import find_dots, index_lattice
from heliogauge.errors import EstimationError
from heliogauge.validate import FloatArray, IntArray
from photogrammetry.targets import Polarity


def _bent_lattice(columns: int, rows: int, turn_rad: float = 0.1) -> tuple[FloatArray, IntArray]:
    """Return dots 11 px apart whose distances vary by a fifth from place to place, and their numbers."""
    number = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    x, y = number.T.astype(np.float64)
    bent = np.stack([11 * x + 3 * np.sin(0.5 * y) + 2 * np.sin(0.8 * x), 11 * y + 4 * np.sin(0.35 * x)], axis=1)
    turn = np.array([[np.cos(turn_rad), -np.sin(turn_rad)], [np.sin(turn_rad), np.cos(turn_rad)]])
    return bent @ turn.T + (100.0, 80.0), number


def _relative(number: IntArray) -> IntArray:
    return number - number[0]


@pytest.mark.parametrize("turn_rad", [-0.6, 0.0, 0.1, 0.7])
def test_numbers_of_a_bent_lattice(turn_rad: float) -> None:
    places, number = _bent_lattice(30, 25, turn_rad)
    assert np.array_equal(_relative(index_lattice(places)), number)


def test_gaps_and_specks_change_no_number() -> None:
    places, number = _bent_lattice(30, 25)
    rng = np.random.default_rng(3)
    kept = rng.random(len(places)) > 0.15
    specks = rng.uniform(places.min(axis=0), places.max(axis=0), (15, 2))
    found = index_lattice(np.concatenate([places[kept], specks]))[: np.count_nonzero(kept)]
    on_lattice = found[:, 0] > -1000
    assert np.count_nonzero(on_lattice) > 0.97 * len(found)
    apart = found[on_lattice] - number[kept][on_lattice]
    usual = np.median(apart, axis=0)
    # A dot beside a speck may lose its link; none may get a wrong number.
    assert np.array_equal(apart, np.broadcast_to(usual, apart.shape))


def test_columns_that_bend_away_keep_their_rows() -> None:
    """The last columns bend down as at a mirror's rolled edge: single diagonal links close no cell."""
    places, number = _bent_lattice(20, 20, 0.0)
    places[:, 1] += 0.6 * np.maximum(number[:, 0] - 15, 0) ** 2
    assert np.array_equal(_relative(index_lattice(places)), number)


def test_random_spots_are_no_lattice() -> None:
    rng = np.random.default_rng(1)
    with pytest.raises(EstimationError, match="rows and columns"):
        index_lattice(rng.uniform(0, 300, (400, 2)))


def _photo(places: FloatArray, noise_dn: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw dark discs of 4.4 px, blurred, eight times as fine as the pixels."""
    fine, (width, height) = 8, np.ceil(places.max(axis=0) + 60).astype(int)
    image = np.full((height * fine, width * fine), 120, dtype=np.uint8)
    for x, y in places:
        center = ((x + 0.5) * fine - 0.5, (y + 0.5) * fine - 0.5)
        shifted = tuple(round(value * 256) for value in center)
        cv2.circle(image, shifted, int(2.2 * fine * 256), 45, cv2.FILLED, cv2.LINE_8, 8)
    blurred = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 0.8 * fine)
    pixels = blurred.reshape(height, fine, width, fine).mean(axis=(1, 3))
    noisy = pixels + noise_dn * np.random.default_rng(seed).standard_normal(pixels.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8), np.ones(pixels.shape, dtype=np.bool_)


@pytest.mark.slow
def test_centres_scatter_as_their_sigmas_say() -> None:
    places, number = _bent_lattice(18, 15)
    normalised = []
    for seed in range(10):
        image, region = _photo(places, 2.0, seed)
        found = find_dots(image, region, Polarity.BLACK_ON_WHITE)
        assert len(found.number) == len(places)
        nearest = np.argmin(np.linalg.norm(places[:, None] - found.centers_px, axis=-1), axis=1)
        assert np.array_equal(_relative(found.number[nearest]), number)
        error = found.centers_px[nearest] - places
        normalised.append(error / np.sqrt(np.einsum("nii->ni", found.covariance_px2[nearest])))
    size = float(np.sqrt(np.mean(np.square(normalised))))
    assert 0.9 < size < 1.15


def test_a_photo_without_dots_is_refused_in_words() -> None:
    image, region = np.full((120, 160), 90, dtype=np.uint8), np.ones((120, 160), dtype=np.bool_)
    with pytest.raises(EstimationError, match="fewer than 25"):
        find_dots(image, region, Polarity.BLACK_ON_WHITE)


@pytest.mark.parametrize(("radius_px", "blur_px"), [(2.1, 1.1), (2.5, 0.8), (3.0, 1.0), (3.5, 1.3), (4.5, 1.0)])
def test_size_and_contrast_of_a_dot_hold_its_light(radius_px: float, blur_px: float) -> None:
    """Dots are taken off the photo by size, contrast and blur: without the tail of their blur it is 0.94 of that."""
    fine, pitch_px, count = 8, 14.0 if radius_px < 4 else 20.0, 8
    rng = np.random.default_rng(1)
    size = int(pitch_px * (count + 1))
    number = np.stack(np.meshgrid(np.arange(count), np.arange(count)), axis=-1).reshape(-1, 2)
    y, x = (np.mgrid[: size * fine, : size * fine] + 0.5) / fine - 0.5
    covered = np.zeros(x.shape)
    for place in pitch_px * (number + 1.0) + rng.uniform(-0.3, 0.3, number.shape):
        part = tuple(slice(int(fine * (one - 7)), int(fine * (one + 8))) for one in place[::-1])
        covered[part] += np.hypot(x[part] - place[0], y[part] - place[1]) < radius_px
    blurred = gaussian_filter(covered, fine * np.sqrt(blur_px**2 - 1 / 12))
    blurred = blurred.reshape(size, fine, size, fine).mean(axis=(1, 3))
    photo = np.rint(150 - 100 * blurred + rng.normal(0, 1, blurred.shape)).astype(np.uint8)
    dots = find_dots(photo, np.ones(photo.shape, dtype=np.bool_), Polarity.BLACK_ON_WHITE)
    light = dots.contrast_dn * np.pi * np.sqrt(np.linalg.det(dots.outlines_px2))
    assert np.median(light) == pytest.approx(100 * np.pi * radius_px**2, rel=0.01)
