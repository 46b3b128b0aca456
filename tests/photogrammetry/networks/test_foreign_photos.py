"""Photos of another object with the same codes are left out by name, and sound ones are not."""

import numpy as np
import pytest

from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from photogrammetry.bundle.constraints import Constraint, ControlPoint, KnownPlaces
from photogrammetry.bundle.datum import Datum
from photogrammetry.bundle.problem import CameraModel
from photogrammetry.image_points import ImagePoints
from photogrammetry.networks.foreign_photos import contradicting_photos
from photogrammetry.networks.quality import check_network
from photogrammetry.networks.solve_network import Knowledge, NetworkCameras, Solved, SolveOptions, solve_network
from photogrammetry.start_values import StartValues

CAMERA = Camera(940, 940, 1750.0, 1750.0, 469.5, 469.5)
#: Six targets along each rim of a trough, listed to 1 mm.
TARGETS = np.array([[side * 3.06, y, 1.21] for side in (-1, 1) for y in np.linspace(-3.28, 3.28, 6)])
NAMES = tuple(str(k + 1) for k in range(len(TARGETS)))
SIGMA_PX = 0.05


def solved(
    shifted: range,
    shift_m: float,
    seed: int = 0,
    moved_rows: range = range(6, 12),
    more: tuple[Constraint, ...] = (),
) -> Solved:
    """A flight of 20 photos; in the last one five targets of one rim and some others, which are elsewhere."""
    rng = np.random.default_rng(seed)
    places = TARGETS + rng.normal(0, 1e-3, TARGETS.shape)
    poses, photos, names, pixels = {}, [], [], []
    for number, x in enumerate(np.linspace(-2.5, 2.5, 20)):
        tilt = np.arctan2(x, 14.0)
        across = np.array([0.0, 1.0, 0.0]), np.array([np.cos(tilt), 0.0, np.sin(tilt)])
        turn = np.array([*across, np.cross(*across)])
        photo = f"photo{number}"
        poses[photo] = RigidTransform(turn, -turn @ np.array([x, 0.1 * number % 0.3, 15.0]))
        is_last = number == 19
        own = [*range(5), *shifted] if is_last else range(12)
        is_moved = np.isin(np.arange(12), moved_rows)[:, None] & is_last
        moved = places + np.array([shift_m, 0, 0]) * is_moved
        pixels.append(CAMERA.project(poses[photo].apply(moved[[*own]])) + rng.normal(0, SIGMA_PX, (len(own), 2)))
        photos += [photo] * len(own)
        names += [NAMES[k] for k in own]
    covariance = np.tile(SIGMA_PX**2 * np.eye(2), (len(names), 1, 1))
    points = ImagePoints.from_names(photos, names, np.concatenate(pixels), covariance)
    cameras = NetworkCameras((CAMERA,), (CameraModel("camera"),), dict.fromkeys(points.photos, 0))
    listed = KnownPlaces(NAMES, TARGETS, 1e-6 * np.eye(36))
    knowledge = Knowledge((listed, *more), {}, Datum(), StartValues(poses))
    return solve_network(points, np.full((len(names), 2, 2), np.nan), cameras, knowledge, SolveOptions())


@pytest.mark.parametrize("shift_m", [-1.5, 0.5])
@pytest.mark.parametrize("shifted", [range(6, 7), range(7, 11), range(6, 12)])
def test_photo_of_another_object(shifted: range, shift_m: float) -> None:
    """What agrees lies along one rim, and determines no pose."""
    found = solved(shifted, shift_m)
    left = {one.name: one.reason for one in found.network.photos_left_out}
    assert list(left) == ["photo19"]
    assert len(found.bundle.problem.observations.photos) == 19


def test_a_photo_that_agrees_more_than_it_contradicts_is_used_and_named() -> None:
    """Five along one rim and one of the other agree, four contradict: what agrees spans an area."""
    found = solved(range(6, 11), 0.5, moved_rows=range(7, 11))
    assert found.network.photos_left_out == ()
    assert [one.name for one in found.doubtful] == ["photo19"]
    [doubt] = [one for one in check_network(found) if one.code == "photos_contradict_others"]
    assert "photo19: 4 of its 10 image points contradict" in doubt.text


def test_sound_photos_stay() -> None:
    for seed in range(4):
        found = solved(range(6, 11), 0.0, seed)
        assert found.network.photos_left_out == ()
        assert found.doubtful == ()
        assert len(found.bundle.problem.observations.photos) == 20


def found_among(false_targets: dict[int, int]) -> tuple[list[str], list[str]]:
    """Which of ten photos of twenty targets are foreign and doubtful, with so many false image points in some."""
    photo, target = np.repeat(np.arange(10), 20), np.tile(np.arange(20), 10)
    names = tuple(f"photo{k}" for k in range(10)), tuple(f"t{k}" for k in range(20))
    every = ImagePoints(*names, photo, target, np.zeros((200, 2)), np.tile(np.eye(2), (200, 1, 1)))
    false = target < np.array([false_targets.get(k, 0) for k in range(10)])[photo]
    places = np.random.default_rng(0).uniform(-1, 1, (20, 3))
    found = contradicting_photos(every, every.subset(~false), places, np.flatnonzero(false), 0.05)
    return [one.name for one in found.foreign], [one.name for one in found.doubtful]


def test_false_image_points_of_foreign_photos_hide_no_other() -> None:
    """The share of false ones by chance is that of the photos that stay."""
    assert found_among({3: 6}) == ([], ["photo3"])
    assert found_among({3: 6, 7: 19}) == (["photo7"], ["photo3"])
    # Ten of twenty might be chance only while three photos that are false throughout count.
    assert found_among({3: 10, 7: 20, 8: 20, 9: 20}) == (["photo3", "photo7", "photo8", "photo9"], [])


def test_known_values_that_no_photo_shows_are_listed_for_one_reason() -> None:
    """28 corners of a published wall were said one by one, each twice."""
    unseen = tuple(ControlPoint(f"{n}.0", np.zeros(3), 1e-6 * np.eye(3)) for n in range(20, 48))
    [doubt] = [
        one for one in check_network(solved(range(6, 12), 0.0, more=unseen)) if one.code == "known_values_not_used"
    ]
    assert doubt.text.startswith("28 known values are not used: not in the network (")
    assert doubt.text.endswith(" and 18 more)")
    assert doubt.text.count("20.0") == 1
