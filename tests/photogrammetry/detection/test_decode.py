"""Ring codes read off rendered targets, and what must not be read."""

import numpy as np
import pytest

from data_synth.targets.isolated_target import IsolatedTarget, draw_isolated
from data_synth.targets.presets import target_scene
from data_synth.targets.scene import image_truth, render_photo
from photogrammetry.detection.detect import SearchLimits
from photogrammetry.detection.photo_targets import PhotoTargets, TargetSearch, measure_targets
from photogrammetry.targets.coded_targets import aicon_dictionary
from photogrammetry.targets.ring_codes import Polarity

CODES = aicon_dictionary(12)


def measured(name: str, *, mirror: bool = False, dictionary=CODES, **how) -> PhotoTargets:  # type: ignore[no-untyped-def]
    target = IsolatedTarget(code=CODES.code(name), **how)
    image = draw_isolated(target, np.random.default_rng(2), turn_rad=0.4).image_dn
    return measure_targets(image[:, ::-1] if mirror else image, "a", TargetSearch(dictionary))


@pytest.mark.parametrize("name", ["1", "20", "77", "147"])
def test_codes_are_read_in_any_rotation(name: str) -> None:
    assert measured(name, diameter_px=16.0).detections.names == (name,)


@pytest.mark.parametrize("tilt_deg", [30.0, 50.0, 65.0])
def test_tilted_codes_are_read(tilt_deg: float) -> None:
    found = measured("52", diameter_px=30.0, tilt_rad=np.deg2rad(tilt_deg), azimuth_rad=0.7)
    assert found.detections.names == ("52",)


@pytest.mark.parametrize("diameter", [10.0, 24.0, 60.0, 96.0])
def test_all_sizes_are_read(diameter: float) -> None:
    assert measured("52", diameter_px=diameter).detections.names == ("52",)


def test_light_codes_on_dark_ground_are_read() -> None:
    assert measured("52", diameter_px=20.0, contrast_dn=-160.0).detections.names == ("52",)


def test_mirror_images_are_reported_as_such() -> None:
    lopsided = next(code for code in CODES.codes if not code.is_symmetric)
    own = CODES.subset([lopsided.name])
    found = measured(lopsided.name, diameter_px=20.0, mirror=True, dictionary=own)
    assert found.detections.names == ()
    assert found.mirrored == (lopsided.name,)
    assert found.mirrored_px.shape == (1, 2)


def test_rings_that_no_dictionary_holds_are_reported_not_named() -> None:
    other = CODES.subset(["1", "2"])
    found = measured("52", diameter_px=20.0, dictionary=other)
    assert found.detections.names == ()
    assert len(found.unknown_words) == len(found.unknown_px) == 1


def test_duplicates_in_one_photo_are_named() -> None:
    image = draw_isolated(IsolatedTarget(20.0, code=CODES.code("9")), np.random.default_rng(1)).image_dn
    found = measure_targets(np.hstack([image, image]), "a", TargetSearch(CODES))
    assert found.detections.names == ("9", "9")
    assert found.duplicated == ("9",)


def test_busy_ground_gives_no_false_code() -> None:
    scene = target_scene("busy", 1)
    view = scene.views[0]
    image = render_photo(scene, view, np.random.default_rng(3))
    truth = image_truth(scene, view)
    places = dict(zip(truth.names, truth.pixels_px, strict=True))
    limits = SearchLimits(polarities=(Polarity.BLACK_ON_WHITE,))
    found = measure_targets(image, "a", TargetSearch(CODES, limits, with_uncoded=False)).detections
    assert len(found) > 20
    for name, pixel in zip(found.names, found.pixels_px, strict=True):
        assert pixel == pytest.approx(places[name], abs=0.5)
