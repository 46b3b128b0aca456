"""Coded targets where it is hard: small, large, tilted, blurred, shaded, covered, overexposed, cut, on busy ground."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from data_synth.targets.isolated_target import IsolatedTarget, draw_isolated
from data_synth.targets.presets import PrintChoice, target_scene
from data_synth.targets.scene import image_truth, render_photo
from heliogauge.flags import SampleFlag
from heliogauge.images.photos import read_image
from heliogauge.validate import FloatArray
from photogrammetry.detection.detect import SearchLimits
from photogrammetry.detection.photo_targets import PhotoTargets, TargetSearch, measure_targets
from photogrammetry.targets.coded_targets import aicon_dictionary
from photogrammetry.targets.ring_codes import mirrored_word

CODES = aicon_dictionary(12)
SEARCH = TargetSearch(CODES, with_uncoded=False)


def image_of(name: str, seed: int = 0, **how: object) -> FloatArray:
    target = IsolatedTarget(code=CODES.code(name), **how)  # type: ignore[arg-type]
    drawn = draw_isolated(target, np.random.default_rng(seed), turn_rad=0.3 * seed).image_dn
    return np.rint(np.clip(drawn, 0, 255)).astype(np.uint8)


def measured(image: FloatArray, search: TargetSearch = SEARCH) -> PhotoTargets:
    return measure_targets(image, "a", search)


@pytest.mark.parametrize("contrast", [160.0, -160.0])
@pytest.mark.parametrize(
    ("diameter", "tilt_deg"),
    [(6.0, 0.0), (6.0, 45.0), (7.0, 55.0), (9.0, 60.0), (12.0, 65.0), (40.0, 65.0), (100.0, 0.0), (100.0, 60.0)],
)
def test_sizes_and_tilts(diameter: float, tilt_deg: float, contrast: float) -> None:
    for seed in range(3):
        image = image_of(
            "52",
            seed,
            diameter_px=diameter,
            tilt_rad=np.deg2rad(tilt_deg),
            azimuth_rad=0.9 * seed,
            contrast_dn=contrast,
        )
        assert measured(image).detections.names == ("52",), seed


@pytest.mark.parametrize(("diameter", "blur"), [(8.0, 1.0), (14.0, 1.4), (30.0, 4.0)])
def test_blur(diameter: float, blur: float) -> None:
    image = image_of("52", diameter_px=diameter, blur_sigma_px=blur, signal_to_noise=60.0)
    assert measured(image).detections.names == ("52",)


@pytest.mark.parametrize("slope", [(1.0, 0.0), (-0.6, 0.8)])
def test_shading(slope: tuple[float, float]) -> None:
    image = image_of("52", diameter_px=16.0, slope_dn_per_px=slope, contrast_dn=100.0)
    assert measured(image).detections.names == ("52",)


def test_a_speck_on_the_dot_does_no_harm_and_a_bar_across_is_told() -> None:
    clean = image_of("52", diameter_px=24.0)
    place = measured(clean).detections.pixels_px[0]
    x, y = np.rint(place).astype(int)
    speck = clean.copy()
    cv2.circle(speck, (int(x) + 11, int(y)), 2, 255, -1)
    assert measured(speck).detections.pixels_px[0] == pytest.approx(place, abs=0.05)
    covered = clean.copy()
    # Along the dot's edge, within its gap: the ring is whole and can be read.
    cv2.ellipse(covered, (int(x), int(y)), (12, 12), 0, 0, 200, 120, 5)
    found = measured(covered)
    assert "52" not in found.detections.names
    if found.unused:
        assert found.unused[0].flag is SampleFlag.PARTLY_COVERED


def test_overexposed_paper_is_flagged_and_used() -> None:
    bright = np.clip(image_of("52", diameter_px=20.0).astype(np.float64) * 2.5, 0, 255).astype(np.uint8)
    found = measured(bright).detections
    assert found.names == ("52",)
    assert found.flags[0] == SampleFlag.CLIPPED
    assert found.usable[0]
    # The luminance of a photo in colour, and light of one that was encoded for the eye.
    assert measured(bright.astype(np.float32)).detections.flags[0] == SampleFlag.CLIPPED
    assert measured(image_of("52", diameter_px=20.0)).detections.flags[0] == 0


def test_a_target_cut_by_the_border_is_no_dot_without_a_code() -> None:
    image = image_of("52", diameter_px=20.0)
    middle = image.shape[1] // 2
    found = measured(image[:, middle - 18 :], TargetSearch(CODES))
    assert found.detections.names == ()
    assert [one.flag for one in found.unused] == [SampleFlag.CUT_BY_BORDER]


def test_mirrored_prints_are_recognised() -> None:
    chiral = [code for code in CODES.codes if code.word < mirrored_word(code.word, 12)][:12]
    own = CODES.subset([code.name for code in chiral])
    for code in chiral[::3]:
        found = measured(image_of(code.name, diameter_px=20.0)[:, ::-1], replace(SEARCH, dictionary=own))
        assert found.detections.names == ()
        assert found.mirrored == (code.name,)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_busy_scenes_have_no_false_codes(seed: int) -> None:
    prints = PrintChoice(light_on_dark=seed % 2 == 1)
    scene = target_scene("busy", seed, prints)
    view = scene.views[seed]
    image = render_photo(scene, view, np.random.default_rng(seed))
    truth = image_truth(scene, view)
    places = dict(zip(truth.names, truth.pixels_px, strict=True))
    found = measured(image).detections
    assert len(found) >= 30
    for name, pixel in zip(found.names, found.pixels_px, strict=True):
        assert np.hypot(*(pixel - places[name])) < 0.5


@pytest.mark.parametrize("n_bits", [12, 14])
def test_clutter_by_itself_has_no_codes(n_bits: int) -> None:
    scene = target_scene("busy", 0)
    empty = replace(scene, sheets=())
    search = TargetSearch(aicon_dictionary(n_bits), SearchLimits(), with_uncoded=False)
    for seed in range(3):
        image = render_photo(empty, scene.views[seed], np.random.default_rng(10 + seed))
        assert measured(image, search).detections.names == ()


def test_real_photos_without_ring_codes_have_none(shared_data: Path) -> None:
    folders = ("opencsp/scene_reconstruction/aruco_marker_images", "photogrammetry/opencv_chessboard")
    files = [file for folder in folders for file in sorted((shared_data / folder).glob("*.[jJ][pP]*[gG]"))[:6]]
    assert files
    for file in files:
        assert measured(read_image(file)).detections.names == (), file.name
