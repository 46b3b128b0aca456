"""Dots followed through photos along a path, from marks in one of them."""

from dataclasses import replace

import numpy as np
import pytest

from data_synth.optics.photo import View
from data_synth.targets.presets import SMALL_CAMERA, PrintChoice, look_at, target_scene
from data_synth.targets.scene import Cover, TargetScene, image_truth, render_photo
from heliogauge.errors import InputError
from photogrammetry.detection.detect import SearchLimits
from photogrammetry.detection.photo_targets import TargetSearch
from photogrammetry.matching.tracking import TrackLimits, follow, start_track
from photogrammetry.targets.ring_codes import Polarity

SEARCH = TargetSearch(limits=SearchLimits(6.0, 40.0, polarities=(Polarity.BLACK_ON_WHITE,)))


def walk(n_photos: int = 6, step_deg: float = 2.5) -> TargetScene:
    """The small panel's dots, among its coded targets, from a path round it."""
    scene = target_scene("small", 0, PrintChoice(None, False, False))
    views = []
    for k in range(n_photos):
        angle = np.radians(20 + step_deg * k)
        place = 2.2 * np.array([np.sin(angle), 0.15, np.cos(angle)])
        views.append(View(f"walk_{k}", SMALL_CAMERA, look_at(place, np.array([0.02, 0.01, 0.1]), 0.03 * k)))
    return replace(scene, views=tuple(views))


def dots(scene: TargetScene, k: int) -> dict[str, np.ndarray]:
    truth = image_truth(scene, scene.views[k])
    return {name: pixel for name, pixel in zip(truth.names, truth.pixels_px, strict=True) if name.startswith("dot")}


@pytest.fixture(scope="module")
def photos():
    scene = walk()
    return scene, [render_photo(scene, view, np.random.default_rng(k)) for k, view in enumerate(scene.views)]


def started(photos, limits: TrackLimits | None = None):
    scene, images = photos
    first = dots(scene, 0)
    rough = np.array(list(first.values())) + np.random.default_rng(1).uniform(-2, 2, (len(first), 2))
    return start_track(images[0], "walk_0", tuple(first), rough, SEARCH, limits)


@pytest.mark.slow
def test_all_dots_are_followed(photos) -> None:
    scene, images = photos
    track, seen = started(photos)
    for k, image in enumerate(images):
        if k:
            track, seen = follow(track, image, f"walk_{k}")
        assert seen.lost == ()
        true = dots(scene, k)
        off = seen.detections.pixels_px - np.array([true[name] for name in seen.detections.names])
        # Eccentricity included; a false target would be 100 px off.
        assert np.abs(off).max() < 0.05
    moved = np.linalg.norm(np.array(list(dots(scene, 1).values())) - np.array(list(dots(scene, 0).values())), axis=1)
    assert moved.max() > 20


@pytest.mark.slow
def test_a_hidden_dot_is_lost_and_found_again(photos) -> None:
    scene, images = photos
    track, _ = started(photos)
    track, _ = follow(track, images[1], "walk_1")
    x, y = dots(scene, 2)["dot5"] / (1600, 1200)
    cover = Cover((x - 0.01, y), (x + 0.01, y), 0.02, 0.3)
    hidden = replace(scene, conditions=replace(scene.conditions, covers=(cover,)))
    track, seen = follow(track, render_photo(hidden, scene.views[2], np.random.default_rng(2)), "walk_2")
    assert [one.name for one in seen.lost] == ["target dot5 in walk_2"]
    assert "lost: " in seen.lost[0].reason
    assert not seen.detections.usable[list(seen.detections.names).index("dot5")]
    track, seen = follow(track, images[3], "walk_3")
    assert seen.lost == ()
    place = seen.detections.pixels_px[list(seen.detections.names).index("dot5")]
    assert np.linalg.norm(place - dots(scene, 3)["dot5"]) < 0.05


@pytest.mark.slow
def test_too_large_a_step_loses_targets_instead_of_taking_others(photos) -> None:
    scene, images = photos
    track, _ = started(photos, TrackLimits(search_radius_px=15.0))
    _, seen = follow(track, images[5], "walk_5")
    true = dots(scene, 5)
    good = seen.detections.usable
    off = [
        np.linalg.norm(p - true[n])
        for p, n, g in zip(seen.detections.pixels_px, seen.detections.names, good, strict=True)
        if g
    ]
    assert len(seen.lost) >= 8
    assert all(far < 0.1 for far in off)


@pytest.mark.slow
def test_mistakes(photos) -> None:
    scene, images = photos
    first = dots(scene, 0)
    place = first["dot1"]
    with pytest.raises(InputError, match="no round target under a at"):
        start_track(images[0], "walk_0", ("a",), place[None] + 60, SEARCH)
    with pytest.raises(InputError, match="a is marked twice"):
        start_track(images[0], "walk_0", ("a", "a"), np.stack([place, place]), SEARCH)
    with pytest.raises(InputError, match="a and b are on one target"):
        start_track(images[0], "walk_0", ("a", "b"), np.stack([place, place + 1]), SEARCH)
    with pytest.raises(InputError, match="is outside of 1600 x 1200"):
        start_track(images[0], "walk_0", ("a",), np.array([[2000.0, 3.0]]), SEARCH)
    track, _ = start_track(images[0], "walk_0", ("a",), place[None], SEARCH)
    with pytest.raises(InputError, match="photos of one size"):
        follow(track, images[0][:-1], "walk_1")
    with pytest.raises(InputError, match="search_radius_px >= 4"):
        TrackLimits(search_radius_px=1.0)
