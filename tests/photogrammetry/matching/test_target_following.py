"""Listed targets followed through photos along a path, and centred where they must be."""

from dataclasses import replace

import numpy as np
import pytest

from data_synth.optics.photo import View
from data_synth.targets.presets import SMALL_CAMERA, PrintChoice, look_at, target_scene
from data_synth.targets.scene import image_truth, render_photo
from heliogauge.camera.distortion import BrownDistortion
from heliogauge.camera.model import Camera
from photogrammetry.detection.detect import SearchLimits
from photogrammetry.detection.photo_targets import TargetSearch, measure_at, measure_targets
from photogrammetry.matching.target_following import (
    KnownTargets,
    agrees_with_list,
    follow,
    provisional_pose,
    start_following,
)
from photogrammetry.targets.coded_targets import aicon_dictionary
from photogrammetry.targets.ring_codes import Polarity

CAMERA = Camera(
    SMALL_CAMERA.width_px,
    SMALL_CAMERA.height_px,
    SMALL_CAMERA.focal_x_px,
    SMALL_CAMERA.focal_y_px,
    SMALL_CAMERA.center_x_px,
    SMALL_CAMERA.center_y_px,
    0.0,
    BrownDistortion(SMALL_CAMERA.k1, SMALL_CAMERA.k2, SMALL_CAMERA.k3, SMALL_CAMERA.p1, SMALL_CAMERA.p2),
)
SEARCH = TargetSearch(
    aicon_dictionary(12), SearchLimits(6.0, 40.0, polarities=(Polarity.BLACK_ON_WHITE,)), with_uncoded=False
)


@pytest.fixture(scope="module")
def walk():
    """Photos from a path round the small panel that nods by up to 1.5 degrees, and its targets with 0.3 mm noise."""
    scene = target_scene("small", 0, PrintChoice(None, False, False))
    views = []
    for k in range(4):
        angle, nod = np.radians(20 + 2.0 * k), 0.04 * (-1) ** k
        place = 2.2 * np.array([np.sin(angle), 0.15, np.cos(angle)])
        views.append(View(f"walk_{k}", SMALL_CAMERA, look_at(place, np.array([0.02, nod, 0.1]), 0.03 * k)))
    scene = replace(scene, views=tuple(views))
    rng = np.random.default_rng(0)
    truth = {name: point for name, point in scene.points_m().items() if name.isdecimal()}
    points = np.array(list(truth.values())) + rng.normal(0, 3e-4, (len(truth), 3))
    known = KnownTargets(tuple(truth), points, np.full(len(truth), 3e-4))
    return scene, known, [render_photo(scene, view, np.random.default_rng(k)) for k, view in enumerate(views)]


def begun(walk, known: KnownTargets):
    _, _, images = walk
    found = measure_targets(images[0], "walk_0", SEARCH)
    pose = provisional_pose(found.detections, known, CAMERA)
    shapes = np.array([one.ellipse.shape_px2 for one in found.centers])
    return start_following(images[0], found.detections, shapes, pose)


@pytest.mark.slow
def test_followed_targets_have_the_centres_that_a_search_gives(walk) -> None:
    scene, known, images = walk
    track = begun(walk, known)
    for k in range(1, 4):
        track = follow(images[k], track, known, CAMERA)
        assert track is not None
        searched = measure_targets(images[k], "photo", SEARCH).detections
        [(found, shapes)] = measure_at([images[k]], ["photo"], [track.ellipses], SEARCH)
        assert set(found.names) >= set(searched.names)
        assert len(shapes) == len(found.names)
        place = dict(zip(found.names, found.pixels_px, strict=True))
        off = np.array([place[name] for name in searched.names]) - searched.pixels_px
        # Iterations that end 1e-3 px from the best fit, from either start.
        assert np.abs(off).max() < 6e-3
        truth = image_truth(scene, scene.views[k])
        moved = np.abs(truth.pixels_px[0] - image_truth(scene, scene.views[k - 1]).pixels_px[0]).max()
        assert moved > 30


@pytest.mark.slow
def test_one_wrong_entry_of_the_list_neither_stops_following_nor_moves_it(walk) -> None:
    _, known, images = walk
    wrong = known.points_m.copy()
    wrong[3] += 0.1
    track = begun(walk, KnownTargets(known.names, wrong, known.sigma_m))
    right = follow(images[1], begun(walk, known), known, CAMERA)
    track = follow(images[1], track, KnownTargets(known.names, wrong, known.sigma_m), CAMERA)
    assert track is not None
    off = CAMERA.project(track.pose.apply(known.points_m)) - CAMERA.project(right.pose.apply(known.points_m))
    assert np.abs(off).max() < 1.5


def test_a_list_that_exchanges_two_targets_does_not_agree(walk) -> None:
    _, known, images = walk
    found = measure_targets(images[0], "walk_0", SEARCH).detections
    exchanged = KnownTargets((known.names[1], known.names[0], *known.names[2:]), known.points_m, known.sigma_m)
    for listed, agrees in ((known, True), (exchanged, False)):
        pose = provisional_pose(found, listed, CAMERA)
        assert agrees_with_list(found, listed, CAMERA, pose) is agrees


def test_a_code_that_is_not_listed_contradicts_the_list_only_where_the_list_has_another(walk) -> None:
    _, known, images = walk
    found = measure_targets(images[0], "walk_0", SEARCH).detections
    pose = provisional_pose(found, known, CAMERA)
    without = KnownTargets(known.names[1:], known.points_m[1:], known.sigma_m[1:])
    renamed = KnownTargets(("999", *known.names[1:]), known.points_m, known.sigma_m)
    assert known.names[0] in found.names
    assert agrees_with_list(found, without, CAMERA, pose)
    assert not agrees_with_list(found, renamed, CAMERA, pose)


def test_a_list_of_which_too_little_was_read_for_a_pose_does_not_agree(walk) -> None:
    _, known, images = walk
    found = measure_targets(images[0], "walk_0", SEARCH).detections
    pose = provisional_pose(found, known, CAMERA)
    for count, agrees in ((0, False), (3, False), (4, True)):
        assert agrees_with_list(found.chosen(np.arange(count)), known, CAMERA, pose) is agrees
    # Codes that are not listed, away from what is.
    away = replace(found, pixels_px=found.pixels_px + 1e4).chosen(np.arange(3))
    elsewhere = replace(away, names=("997", "998", "999"))
    assert not agrees_with_list(elsewhere, known, CAMERA, pose)


def test_targets_that_are_not_listed_are_followed_by_the_picture(walk) -> None:
    _, known, images = walk
    others = set(known.names[::4])
    listed = [k for k, name in enumerate(known.names) if name not in others]
    few = KnownTargets(tuple(known.names[k] for k in listed), known.points_m[listed], known.sigma_m[listed])
    track = follow(images[1], begun(walk, few), few, CAMERA)
    assert track is not None
    searched = measure_targets(images[1], "photo", SEARCH).detections
    places = dict(zip(track.ellipses.names, track.ellipses.centers_px, strict=True))
    own = [(name, place) for name, place in zip(searched.names, searched.pixels_px, strict=True) if name in others]
    assert len(own) >= 3
    for name, place in own:
        # To half a pixel or so, as listed ones; the picture has moved by more than 30.
        assert np.linalg.norm(places[name] - place) < 1.0
    empty = images[1].copy()
    x, y = own[0][1].round().astype(int)
    empty[max(y - 60, 0) : y + 60, max(x - 60, 0) : x + 60] = 90
    gone = follow(empty, begun(walk, few), few, CAMERA)
    assert gone is not None
    assert own[0][0] not in gone.ellipses.names


def test_another_picture_is_not_followed(walk) -> None:
    _, known, images = walk
    track = begun(walk, known)
    assert follow(np.full_like(images[1], 90), track, known, CAMERA) is None
    assert follow(images[1][::-1].copy(), track, known, CAMERA) is None


def test_too_few_listed_targets_give_no_pose(walk) -> None:
    _, known, images = walk
    found = measure_targets(images[0], "walk_0", SEARCH).detections
    few = KnownTargets(known.names[:3], known.points_m[:3], known.sigma_m[:3])
    assert provisional_pose(found, few, CAMERA) is None
