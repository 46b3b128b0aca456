"""Panels of other reflectance pull a beam's centre: how much they differ, from frames of the empty target."""

from pathlib import Path

import numpy as np
import pytest

from calibration.beam.keys import load_beams
from calibration.beam.light.background import empty_target
from calibration.beam.light.beam_flags import BeamFlag
from calibration.beam.light.beam_image import measure_beam
from calibration.beam.pipeline.measure import run
from data_synth.heliostats import BenchOptions, write_beam_dataset
from heliogauge.images.photos import read_image, write_image
from tests.calibration.beam_pictures import gaussian, picture, sky_light


def panels(spread: float, seed: int, shape: tuple[int, int] = (6, 6)) -> np.ndarray:
    drawn = 1 + spread * np.random.default_rng(seed).standard_normal(shape)
    rows, columns = np.arange(224) * shape[0] // 224, np.arange(256) * shape[1] // 256
    return np.asarray(drawn[rows[:, None], columns[None, :]])


def empty(pattern: np.ndarray, seed: int = 0) -> np.ndarray:
    return sky_light() * pattern + np.random.default_rng(seed).normal(0, 1.5, pattern.shape)


@pytest.mark.parametrize("shape", [(6, 6), (6, 3)])
def test_spread_of_panels(shape: tuple[int, int]) -> None:
    """RMS of twelve targets; panels that are as long as two blocks differ across the other direction."""
    found = [empty_target([empty(panels(0.05, seed, shape))]).uneven_share for seed in range(12)]
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(0.05, rel=0.3)


def test_shadow_and_noise_are_no_panels() -> None:
    even = np.ones((224, 256))
    assert empty_target([empty(even)]).uneven_share < 0.004
    shadow = np.where(np.add.outer(np.arange(224), np.arange(256)) > 260, 0.55, 1.0)
    assert empty_target([empty(shadow)]).uneven_share < 0.03


def test_centres_on_uneven_panels_are_within_their_sigma() -> None:
    """Panels of 6 % under a beam as wide as one: with a map of the reflectance the sigma is that of an even target."""
    scores, mapped = [], []
    for seed in range(30):
        pattern = panels(0.06, seed)
        light = (sky_light() + 120 * gaussian((0.3, -0.2), (0.5, 0.4))) * pattern
        surface = empty_target([empty(pattern, one) for one in (seed, seed + 100)])
        image = picture(light, noise_dn=1.0, seed=seed)
        one = measure_beam(image, empty=surface)
        scores.append((one.spot.position_m - [0.3, -0.2]) / one.spot.sigma_m)
        other = measure_beam(image, empty=surface, reflectance=pattern)
        mapped.append((other.spot.position_m - [0.3, -0.2]) / other.spot.sigma_m)
        assert (other.spot.sigma_m < one.spot.sigma_m).all()
    # 60 numbers, two of a beam nearly independent; the spread itself is known to a third.
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.4
    assert np.sqrt(np.mean(np.square(mapped))) < 1.25


@pytest.mark.parametrize(("spread", "least", "most"), [(0.0, 0, 0), (0.01, 0, 2), (0.06, 12, 12)])
def test_panels_without_a_frame_of_the_empty_target_are_said(spread: float, least: int, most: int) -> None:
    """As wide as the beam, of 6 %: up to 5 sigma off, and said; with a frame nothing is to be said."""
    flagged, scores = [], []
    for seed in range(12):
        pattern = panels(spread, seed, ((4, 4), (6, 6))[seed % 2])
        image = picture((sky_light() + 120 * gaussian((0.3, -0.2), (0.5, 0.4))) * pattern, noise_dn=1.0, seed=seed)
        one = measure_beam(image)
        flagged.append(bool(one.flags & BeamFlag.UNEVEN_TARGET))
        scores.append((one.spot.position_m - [0.3, -0.2]) / one.spot.sigma_m)
        assert not measure_beam(image, empty=empty_target([empty(pattern)])).flags & BeamFlag.UNEVEN_TARGET
    assert least <= sum(flagged) <= most
    # 2.0 and 3.1 where no scale of the background's error was as wide as a panel, and blocks that the smooth functions
    # follow counted as free; 1.7 and 2.1 now.
    assert np.sqrt(np.mean(np.square(scores))) < (2.4 if least else 1.9)


def test_a_photo_of_a_camera_that_has_moved_is_refused(tmp_path: Path) -> None:
    """Corners by hand put the beam aside without a word otherwise: here by 0.25 and 1.2 m."""
    write_beam_dataset(tmp_path / "F", BenchOptions(suns=3, seed=9))
    for name, shift_px in (("beam_001.png", 8), ("beam_002.png", 40)):
        write_image(tmp_path / "F" / name, np.roll(read_image(tmp_path / "F" / name), shift_px, axis=1))
    beams = run(load_beams(tmp_path / "F")).beams
    assert ((beams.flags & np.uint32(BeamFlag.TARGET_MOVED)) != 0).tolist() == [False, True, True]
    assert beams.rejected.tolist() == [False, True, True]


def test_a_target_without_a_detail_does_not_tell() -> None:
    plain = sky_light() + 120 * gaussian((0.3, -0.2), (0.5, 0.4))
    even = empty_target([empty(np.ones_like(plain))])
    assert not measure_beam(picture(plain, noise_dn=1.5), empty=even).flags & BeamFlag.TARGET_MOVED


@pytest.mark.parametrize("faults", [("shadow",), ("moved-shadow",), ("clouds",), ("underexposed",)])
def test_details_of_drawn_photos_are_found_in_their_places(tmp_path: Path, faults: tuple[str, ...]) -> None:
    write_beam_dataset(tmp_path / "F", BenchOptions(suns=2, faults=faults, seed=4))
    beams = run(load_beams(tmp_path / "F")).beams
    assert not (beams.flags & np.uint32(BeamFlag.TARGET_MOVED)).any()


def test_photos_of_another_size_than_the_corners_are_refused(tmp_path: Path) -> None:
    write_beam_dataset(tmp_path / "F", BenchOptions(suns=2, seed=4))
    file = tmp_path / "F" / "beam_001.png"
    image = read_image(file)
    write_image(file, np.ascontiguousarray(np.repeat(np.repeat(image, 2, axis=0), 2, axis=1)))
    beams = run(load_beams(tmp_path / "F")).beams
    assert beams.rejected.tolist() == [False, True]
    assert "corners_px are those of photos of" in beams.reasons[1]


@pytest.mark.slow
def test_drawn_photos_of_uneven_targets(tmp_path: Path) -> None:
    """Panels of 6 % and seams of 6 cm: the largest of 30 errors was 5.3 sigma without the panels in it."""
    import json

    scores = []
    for seed in range(10, 15):
        folder = tmp_path / str(seed)
        write_beam_dataset(folder, BenchOptions(suns=3, faults=("panels",), seed=seed))
        beams = run(load_beams(folder)).beams
        truth = np.array([one["centroid_m"] for one in json.loads((folder / "truth.json").read_text())["photos"]])
        scores.append((np.stack([beams.x_m, beams.y_m], axis=1) - truth) / beams.sigma_m)
    assert np.sqrt(np.mean(np.square(scores))) < 1.5
    assert np.abs(scores).max() < 4.5
