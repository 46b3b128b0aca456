"""Ring codes shown on a display and photographed, drawn by another program's rules, from its description alone.

That program counts the lowest bit first, clockwise from 3 o'clock, and names a code by the smallest rotation; a small
ring is left out of the dot's middle.
"""

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from heliogauge.validate import BoolArray, FloatArray
from photogrammetry.detection.photo_targets import PhotoTargets, TargetSearch, measure_targets
from photogrammetry.targets.coded_targets import user_dictionary
from photogrammetry.targets.ring_codes import Sense

COLUMNS, ROWS, PITCH = 4, 3, 8.0


def other_program_s_ink(u: FloatArray, v: FloatArray, word: npt.NDArray[np.int64]) -> BoolArray:
    """Ink at places right (u) and down (v) of the centre, in radii of the dot."""
    radius = np.hypot(u, v)
    sector = (np.degrees(np.arctan2(v, u)) % 360 / 30).astype(np.int64) % 12
    ring = (radius > 2) & (radius <= 3) & ((word >> sector) & 1 == 1)
    return ((radius <= 1) & ~((radius < 0.12) & (radius >= 0.04))) | ring


def smallest(word: int) -> int:
    """Smallest of a word's rotations."""
    return min((word >> k | word << (12 - k)) & 4095 for k in range(12))


def screen_photo(
    words: list[int], *, dot_px: float, tilt_deg: float, black: bool, seed: int, display_px: float = 2.3
) -> FloatArray:
    """A display of visible pixels with colour stripes, seen at a tilt, with a reflection, blur and noise."""
    size = (1200, 900)
    radius = dot_px / 2
    tilt = np.radians(tilt_deg)
    turned = cv2.Rodrigues(np.array([0.8 * tilt, 0.6 * tilt, 0.0]))[0] @ cv2.Rodrigues(np.array([0.0, 0.0, 0.2]))[0]
    focal = 1.3 * size[0]
    matrix = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]])
    back = np.linalg.inv(matrix @ np.column_stack([turned[:, 0], turned[:, 1], [0, 0, focal / radius]]))
    light = np.zeros((size[1], size[0]))
    for shift_y in (-0.25, 0.25):
        for shift_x in (-0.25, 0.25):
            y, x = np.meshgrid(np.arange(size[1]) + shift_y, np.arange(size[0]) + shift_x, indexing="ij")
            u, v, w = np.einsum("ij,jyx->iyx", back, np.stack([x, y, np.ones_like(x)]))
            across, down = u / w / display_px * radius, v / w / display_px * radius
            u, v = ((np.floor(part) + 0.5) * display_px / radius for part in (across, down))
            u, v = u + COLUMNS * PITCH / 2, v + ROWS * PITCH / 2
            column, row = np.floor(u / PITCH).astype(int), np.floor(v / PITCH).astype(int)
            shown = (column >= 0) & (column < COLUMNS) & (row >= 0) & (row < ROWS)
            word = np.array(words)[np.where(shown, row * COLUMNS + column, 0)]
            ink = other_program_s_ink(u - (column + 0.5) * PITCH, v - (row + 0.5) * PITCH, word) & shown
            pixels = 1 + 0.6 * np.cos(2 * np.pi * across) + 0.25 * np.cos(2 * np.pi * down)
            light += 0.25 * np.where(ink == black, 0.03, 0.7) * pixels
    light = cv2.GaussianBlur(light, (0, 0), 0.9)
    light += 0.3 * np.exp(-0.5 * (((x - 400) / 150) ** 2 + ((y - 300) / 110) ** 2))
    return np.rint(np.clip(230 * light + np.random.default_rng(seed).normal(0, 3, light.shape), 0, 255)).astype(
        np.uint8
    )


def chosen_words(seed: int) -> list[int]:
    every = sorted({smallest(word) for word in range(1, 4095)})
    return [int(word) for word in np.random.default_rng(seed).choice(every, COLUMNS * ROWS, replace=False)]


def read(image: FloatArray, words: list[int], sense: Sense) -> PhotoTargets:
    dictionary = user_dictionary("screen", 12, words).as_printed(sense)
    return measure_targets(image, "screen", TargetSearch(dictionary, with_uncoded=False))


@pytest.mark.parametrize(
    ("dot_px", "tilt_deg", "black", "seed"), [(48.0, 15.0, True, 0), (44.0, 45.0, False, 1), (30.0, 60.0, True, 2)]
)
def test_all_codes_of_a_display_are_read_and_none_is_false(
    dot_px: float, tilt_deg: float, black: bool, seed: int
) -> None:
    words = chosen_words(seed)
    image = screen_photo(words, dot_px=dot_px, tilt_deg=tilt_deg, black=black, seed=seed)
    found = read(image, words, Sense.COUNTERCLOCKWISE)
    assert sorted(found.detections.names) == sorted(map(str, words))


@pytest.mark.slow
def test_dots_of_seven_pixels_of_a_display_are_read() -> None:
    # Their outlines have steps of 0.05 to 0.08 radii. Ten of twelve suffice: the last ones are nearly squares.
    words = chosen_words(3)
    image = screen_photo(words, dot_px=20.0, tilt_deg=10.0, black=True, seed=3, display_px=2.7)
    found = read(image, words, Sense.COUNTERCLOCKWISE)
    assert set(found.detections.names) <= set(map(str, words))
    assert len(found.detections) >= 10


def test_the_wrong_sense_shows_as_mirror_images() -> None:
    words = [smallest(word) for word in (0b1101, 0b11001, 0b101100, 0b1001110, 0b10011011, 0b110100)]
    words = (words * 2)[: COLUMNS * ROWS]
    image = screen_photo(words, dot_px=44.0, tilt_deg=10.0, black=True, seed=0)
    unique = [word for word in dict.fromkeys(words) if smallest(int(f"{word:012b}"[::-1], 2)) not in words]
    found = read(image, unique, Sense.CLOCKWISE)
    assert len(found.detections) == 0
    assert len(found.mirrored) >= 2 * len(unique) > 0
    assert len(read(image, unique, Sense.COUNTERCLOCKWISE).detections) >= 2 * len(unique)
