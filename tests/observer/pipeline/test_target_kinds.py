"""One list of coded, plain and square targets: what it says of their looks, and their names in photos."""

from pathlib import Path

import numpy as np
import pytest

from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector
from observer.pipeline.reading.photo_poses import place_photo
from observer.pipeline.reading.target_kinds import target_kinds
from photogrammetry.detection import Detections
from photogrammetry.matching import KnownTargets, provisional_pose
from photogrammetry.pipeline import OnePhoto

CAMERA = Camera(4288, 2848, 3636.0, 3636.0, 2143.5, 1423.5)
#: Along both rims of an LS-2, unevenly: even spacing looks the same from the other end.
PLACES = np.array([[x, y, 1.05] for x in (-2.7, 2.7) for y in (-3.6, -2.5, -0.7, 0.9, 2.3, 3.7)])
PLACES[:6, 1] += 0.25


def photo_of(pixels: np.ndarray, names: list[str], dots: np.ndarray, sigma_px: float = 0.05) -> OnePhoto:
    def detections(places: np.ndarray, called: list[str]) -> Detections:
        count = len(places)
        covariance = np.tile(sigma_px**2 * np.eye(2), (count, 1, 1))
        return Detections("a.png", tuple(called), places, covariance, np.full(count, 9.0), np.zeros(count, np.uint32))

    shapes = [np.tile(81.0 * np.eye(2), (len(one), 1, 1)) for one in (pixels, dots)]
    loose = detections(dots.reshape(-1, 2), [f"u{k}" for k in range(len(dots))])
    return OnePhoto(detections(pixels.reshape(-1, 2), names), shapes[0], (4288, 2848), (), loose, shapes[1])


def from_beside() -> RigidTransform:
    """A camera 7 m beside and 7 m above that looks at the middle, across the trough."""
    toward = np.array([-1.0, 0.1, -1.0]) / np.linalg.norm([-1.0, 0.1, -1.0])
    right = np.cross(toward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    turn = np.array([right, np.cross(toward, right), toward])
    return RigidTransform(turn, -turn @ np.array([7.0, -0.5, 8.0]))


def test_list_with_all_kinds():
    table = {
        "target": ["A", "B", "C", "65"],
        "kind": ["coded", "plain", "square", ""],
        "code": ["12", "", "7", ""],
        "diameter_mm": ["60", "60", "", "60"],
    }
    kinds = target_kinds(table, Path("targets.csv"))
    assert kinds.plain == {"B"}
    assert kinds.name_of == {"12": "A"}
    assert kinds.middle_of == {"7": "C"}
    assert kinds.common_diameter_m == pytest.approx(0.06)
    corners = np.array([[100.0, 100.0], [160.0, 110.0], [170.0, 190.0], [90.0, 160.0]])
    seen = photo_of(np.array([[10.0, 20.0], *corners]), ["12", "7.0", "7.1", "7.2", "7.3"], np.zeros((0, 2)))
    named = kinds.named(seen).detections
    assert named.names == ("A", "7.0", "7.1", "7.2", "7.3", "C")
    # The diagonals cross where both have their middle in a plane seen straight: here by hand from their equations.
    middle = named.pixels_px[-1]
    for a, b in ((0, 2), (1, 3)):
        along = corners[b] - corners[a]
        assert np.cross(along, middle - corners[a]) == pytest.approx(0.0, abs=1e-6)
    # Four corners of 0.05 px: each moves the crossing by less than itself.
    assert 0.02 < named.sigma_px[-1].max() < 0.05


@pytest.mark.parametrize(
    ("sizes", "common"), [(["60", ""], None), (["60", "40"], None), (["", ""], None), (["60", "60"], 0.06)]
)
def test_one_diameter_is_that_of_all_only_where_each_has_it(sizes, common):
    table = {"target": ["1", "2", "7.0", "8"], "kind": ["", "", "", "square"], "diameter_mm": [*sizes, "", ""]}
    assert target_kinds(table, Path("targets.csv")).common_diameter_m == common


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"kind": ["round", ""]}, "kind = 'round': one of coded, plain, square"),
        ({"kind": ["plain", ""], "code": ["3", ""]}, "is plain and has the code 3"),
        ({"code": ["3", "3"]}, "line 3: code 3 stands in line 2 already"),
        ({"code": ["2", ""]}, "line 3: code 2 stands in line 2 already"),
        ({"diameter_mm": ["-4", ""]}, "a number above 0 is needed"),
    ],
)
def test_list_that_contradicts_itself(change, said):
    with pytest.raises(InputError, match=said):
        target_kinds({"target": ["1", "2"], **change}, Path("targets.csv"))


@pytest.mark.parametrize("codes", [0, 1, 2, 3])
def test_pose_where_few_codes_or_none_are_read(codes):
    rng = np.random.default_rng(codes)
    listed = PLACES + rng.normal(0, 1e-3, PLACES.shape)
    known = KnownTargets(tuple(str(k) for k in range(12)), listed, np.full(12, 1e-3))
    pose = from_beside()
    pixels = CAMERA.project(pose.apply(PLACES)) + rng.normal(0, 0.05, (12, 2))
    false = rng.uniform([200, 200], [4000, 2600], (12, 2))
    order = rng.permutation(24)
    read = rng.choice(12, codes, replace=False)
    rest = np.concatenate([np.delete(pixels, read, axis=0), false])[order[order < 24 - codes]]
    one = photo_of(pixels[read], [str(k) for k in read], rest)
    assert provisional_pose(one.detections, known, CAMERA) is None
    # Where all targets have codes, places alone are no evidence: one at least is to be read.
    plain = frozenset(known.names[:6]) if codes == 0 else frozenset[str]()
    found = place_photo(one, known, plain, CAMERA)
    assert found.by_list
    assert found.pose is not None
    # Twelve places of 1 mm hold a camera 10 m away to millimetres.
    assert np.linalg.norm(found.pose.inverse().translation_m - pose.inverse().translation_m) < 0.01
    for name, pixel in zip(found.photo.detections.names, found.photo.detections.pixels_px, strict=True):
        np.testing.assert_array_equal(pixel, pixels[int(name)])
    assert len(found.photo.detections) >= 11


@pytest.mark.parametrize("false_code", [(), ("96",)], ids=["", "something else reads like another code"])
def test_plain_dots_get_names_where_codes_say_the_pose(false_code):
    pose = from_beside()
    pixels = CAMERA.project(pose.apply(PLACES))
    known = KnownTargets(tuple(str(k) for k in range(12)), PLACES, np.full(12, 1e-3))
    coded = [0, 3, 5, 7, 10]
    # One of the others reads like a code that no list has; another one is a false dot.
    read = np.concatenate([pixels[[*coded, 8]], np.full((len(false_code), 2), 90.0)])
    dots = np.array([*pixels[[1, 2, 4, 6, 9]], [50.0, 60.0]])
    one = photo_of(read, [*map(str, coded), "143", *false_code], dots)
    plain = frozenset(name for name in known.names if int(name) not in coded)
    found = place_photo(one, known, plain, CAMERA)
    assert not found.by_list
    names = dict(zip(found.photo.detections.names, found.photo.detections.pixels_px, strict=True))
    assert set(names) == {*(str(k) for k in range(11)), *false_code}
    for name in set(names) - set(false_code):
        np.testing.assert_array_equal(names[name], pixels[int(name)])
    assert len(found.photo.dots) == 1


@pytest.mark.parametrize("plain", [frozenset(), frozenset({"11"})], ids=["all coded", "one plain"])
def test_the_next_trough_is_not_taken_for_this_one(plain):
    """Its targets stand in the same places, with codes of its own: a field's rows are built alike."""
    pixels = CAMERA.project(from_beside().apply(PLACES))
    known = KnownTargets(tuple(str(k) for k in range(12)), PLACES, np.full(12, 1e-3))
    none = np.zeros((0, 2))
    for named, dots in ((range(12), none), (range(4), pixels[4:])):
        one = photo_of(pixels[: len(named)], [str(k + 12) for k in named], dots)
        found = place_photo(one, known, plain, CAMERA)
        assert found.pose is None
        assert set(found.photo.detections.names) == {str(k + 12) for k in named}


def test_targets_of_large_sigma_do_not_turn_the_pose():
    """Ground targets known to 20 mm beside rims known to 1 mm: the pose is that of the rims."""
    rng = np.random.default_rng(2)
    ground = np.array([[x, y, -3.2] for x in (-3.7, 3.7) for y in (-3.0, 0.0, 3.0)])
    places = np.concatenate([PLACES, ground])
    sigma = np.repeat([1e-3, 2e-2], [12, 6])
    turn = rotation_from_vector(np.array([np.pi, 0.0, 0.0])) @ rotation_from_vector(np.array([0.0, 0.1, 0.0]))
    pose = RigidTransform(turn, -turn @ np.array([1.2, 0.0, 15.0]))
    coarse = Camera(1200, 900, 1030.0, 1030.0, 599.5, 449.5)
    off = []
    for _ in range(20):
        listed = places + sigma[:, None] * rng.standard_normal(places.shape)
        known = KnownTargets(tuple(str(k) for k in range(18)), listed, sigma)
        pixels = coarse.project(pose.apply(places)) + rng.normal(0, 0.05, (18, 2))
        found = provisional_pose(photo_of(pixels, list(known.names), np.zeros((0, 2))).detections, known, coarse)
        assert found is not None
        off.append((coarse.project(found.apply(PLACES)) - coarse.project(pose.apply(PLACES))).ravel())
    # Six parameters of a pose from 24 coordinates of 0.09 px leave half of that.
    assert np.sqrt(np.mean(np.square(off))) < 0.1
