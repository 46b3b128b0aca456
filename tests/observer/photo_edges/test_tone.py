"""How photos are encoded: blurred edges are even in light, lopsided in numbers drawn apart for the eye."""

import numpy as np
import pytest
from scipy.special import ndtr

from observer.photo_edges.tone import (
    Tone,
    full_scale,
    linear_light,
    log_odds_of_linear,
    numbers_for_the_eye,
    tone_evidence,
)

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


def odds(stored: np.ndarray, sizes: tuple[np.ndarray, np.ndarray] | None = None) -> float:
    both = np.zeros((2, 0)) if sizes is None else np.stack(sizes)
    return log_odds_of_linear([tone_evidence(255 * stored, 255 * decoded(stored), both)])


def odds_of_flight(photos: list[np.ndarray]) -> float:
    return log_odds_of_linear([tone_evidence(one, decoded(one), np.zeros((2, 0))) for one in photos])


@pytest.mark.parametrize(("blur_px", "least"), [(0.7, 0.4), (0.9, 0.3), (1.2, 0.05)])
def test_edges_tell_how_photos_are_encoded(blur_px: float, least: float) -> None:
    light = [edges(np.random.default_rng(k), blur_px=blur_px) for k in range(10)]
    assert odds_of_flight(light) > least
    assert odds_of_flight([encoded(one) for one in light]) < -0.8


def test_further_photos_of_one_flight_make_no_certainty_of_edges() -> None:
    # Glass and clouds beside the tube are as lopsided in every photo.
    stored = [encoded(edges(np.random.default_rng(k), n=60)) for k in range(40)]
    one, ten, forty = (odds_of_flight(stored[:n]) for n in (1, 10, 40))
    assert -np.log(20) < forty < ten + 0.1 < one
    assert abs(forty - ten) < 0.5


def test_thin_lines_that_are_as_bright_on_both_sides_tell_nothing() -> None:
    stored = encoded(edges(np.random.default_rng(2)))
    line = np.full((3, PLACE.size), 0.6)
    line[:, PLACE.size // 2] = 0.2
    line[1, -1] += 1e-3
    assert odds(np.concatenate([stored, line])) == pytest.approx(odds(stored), abs=0.3)
    assert odds(np.repeat(line[:1], 200, axis=0)) == 0


def test_few_edges_tell_nothing() -> None:
    stored = encoded(edges(np.random.default_rng(1), n=29))
    assert odds(stored) == 0
    assert odds(stored[:0]) == 0
    assert log_odds_of_linear([]) == 0


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


def test_light_becomes_the_numbers_of_the_file_again() -> None:
    stored = np.arange(256, dtype=np.uint8).reshape(16, 16)
    np.testing.assert_allclose(numbers_for_the_eye(linear_light(stored, Tone.SRGB)), stored, atol=1e-2)


def test_targets_of_known_size_decide_before_edges() -> None:
    light = edges(np.random.default_rng(2))
    stored = encoded(light)
    rng = np.random.default_rng(3)
    small, right, large = (rng.normal(mean, 0.005, 20) for mean in (0.93, 1.0, 1.08))
    # Clouds beside the tube make linear edges lopsided too.
    assert odds(stored, (right, large)) > np.log(20)
    assert odds(light, (small, right)) < -np.log(20)
    # A diameter that fits neither way was stated wrongly: it says next to nothing.
    assert abs(odds(stored, (right + 0.3, large + 0.3)) - odds(stored)) < 3
    # The worst of what right encodings were seen to show, 1.5 %, against what the wrong one makes at least.
    assert odds(stored[:0], (right - 0.035, right + 0.015)) < -np.log(10)


def test_scattered_sizes_of_few_targets_say_less() -> None:
    rng = np.random.default_rng(4)
    scattered = rng.normal(1.0, 0.03, 400)
    none = np.zeros((0, PLACE.size))
    many, few = (odds(none, (scattered[:n] + 0.0, scattered[:n] + 0.05)) for n in (400, 3))
    assert many > np.log(20)
    assert abs(few) < many
