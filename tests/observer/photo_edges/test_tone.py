"""How photos are encoded: blurred edges are even in light, lopsided in numbers drawn apart for the eye."""

from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtr

from observer.photo_edges.tone import Tone, find_tone, full_scale, linear_light
from observer.pipeline.tone import usual_tone

PLACE = np.arange(-6, 7)


def edges(rng: np.random.Generator, *, n: int = 400, blur_px: float = 0.7, noise: float = 0.004) -> np.ndarray:
    """Draw edges from a dark tube to a sky, as shares of the full scale, within half a pixel of the middle."""
    dark, bright = rng.uniform(0.03, 0.08, (n, 1)), rng.uniform(0.4, 0.7, (n, 1))
    share = ndtr((PLACE - rng.uniform(-0.5, 0.5, (n, 1))) / blur_px)
    return np.clip(dark + (bright - dark) * share + noise * rng.standard_normal((n, PLACE.size)), 0, 1)


def encoded(light: np.ndarray) -> np.ndarray:
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 0) ** (1 / 2.4) - 0.055)


def decoded(stored: np.ndarray) -> np.ndarray:
    return linear_light((255 * stored).astype(np.float32), Tone.SRGB).astype(np.float64) / 255


@pytest.mark.parametrize("blur_px", [0.7, 0.9, 1.2])
def test_edges_tell_how_photos_are_encoded(blur_px: float) -> None:
    light = edges(np.random.default_rng(0), blur_px=blur_px)
    assert find_tone(light, decoded(light)).tone is Tone.LINEAR
    stored = encoded(light)
    found = find_tone(stored, decoded(stored))
    assert found.tone is Tone.SRGB
    assert abs(found.lopsided) < 0.045 < found.as_stored


def test_thin_lines_that_are_as_bright_on_both_sides_tell_nothing() -> None:
    stored = encoded(edges(np.random.default_rng(2)))
    line = np.full((3, PLACE.size), 0.6)
    line[:, PLACE.size // 2] = 0.2
    line[1, -1] += 1e-3
    both = np.concatenate([stored, line])
    found, alone = find_tone(both, decoded(both)), find_tone(stored, decoded(stored))
    assert found.tone is Tone.SRGB
    assert abs(found.as_stored - alone.as_stored) < 0.02
    assert find_tone(np.repeat(line[:1], 200, axis=0), np.repeat(line[:1], 200, axis=0)).tone is Tone.LINEAR


def test_few_edges_tell_nothing() -> None:
    stored = encoded(edges(np.random.default_rng(1), n=40))
    assert find_tone(stored, decoded(stored)).tone is Tone.LINEAR
    assert find_tone(stored[:0], stored[:0]).tone is Tone.LINEAR
    # Then they are what such files usually are.
    assert find_tone(stored[:0], stored[:0], usual=Tone.SRGB).tone is Tone.SRGB
    assert usual_tone([Path("a.JPG"), Path("b.jpeg")]) is Tone.SRGB
    assert usual_tone([Path("a.jpg"), Path("b.png")]) is Tone.LINEAR
    light = edges(np.random.default_rng(3))
    assert find_tone(light, decoded(light), usual=Tone.SRGB).tone is Tone.LINEAR


def test_srgb_numbers_become_light_in_every_depth() -> None:
    light = np.linspace(0, 1, 200).reshape(10, 20)
    stored = encoded(light)
    for image in (
        np.rint(255 * stored).astype(np.uint8),
        np.rint(65535 * stored).astype(np.uint16),
        (255 * stored).astype(np.float32),
        (65535 * stored).astype(np.float32),
    ):
        found = linear_light(image, Tone.SRGB)
        assert found.dtype == np.float32
        np.testing.assert_allclose(found / full_scale(image), light, atol=5e-3 if image.dtype == np.uint8 else 2e-5)
        assert linear_light(image, Tone.LINEAR) is image


def test_targets_of_known_size_decide_before_edges() -> None:
    light = edges(np.random.default_rng(2))
    stored = encoded(light)
    rng = np.random.default_rng(3)
    small, right, large = (rng.normal(mean, 0.005, 20) for mean in (0.93, 1.0, 1.08))
    # Clouds beside the tube make linear edges lopsided too.
    found = find_tone(stored, decoded(stored), (right, large))
    assert found.tone is Tone.LINEAR
    assert found.by_targets
    assert find_tone(light, decoded(light), (small, right)).tone is Tone.SRGB
    # A diameter that fits neither way was stated wrongly, few targets tell nothing.
    assert find_tone(stored, decoded(stored), (small + 0.2, large + 0.2)).tone is Tone.SRGB
    assert find_tone(stored, decoded(stored), (right[:3], large[:3])).tone is Tone.SRGB
