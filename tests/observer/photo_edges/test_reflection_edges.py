"""Edges of the reflection in a mirror drawn by the law of reflection; several photos at once against each alone."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from observer.photo_edges.edges import find_edges
from observer.photo_edges.rectify import Strip
from observer.photo_edges.reflection_edges import edge_profiles, reflection_edges
from observer.photo_edges.tube_bearings import tube_bearings
from observer.photo_edges.views import Shot, View
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector
from observer.trough.expectation import Expectation
from tests.observer.drawn_tube import drawn_tube, looking

CAMERA = Camera(360, 260, 1050.0, 1050.0, 181.3, 128.2)
COLLECTOR = Collector(2.0, 1.4, 1.49, 0.070)
ROWS_M = (np.arange(70) + 0.5) * 0.02 - 0.7
EXPECTED = Expectation(COLLECTOR, AbsorberPath.straight(0.0, 1.49, 0.7), ROWS_M)


def beside_axis_m(points: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """Return how far from the focal line reflected lines of sight pass, by the law of reflection."""
    normal = np.stack([-points[..., 0] / (2 * 1.49), np.zeros(points.shape[:-1]), np.ones(points.shape[:-1])], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    sight = points - eye
    ray = sight - 2 * (sight * normal).sum(axis=-1, keepdims=True) * normal
    across = ray[..., [0, 2]] / np.linalg.norm(ray[..., [0, 2]], axis=-1, keepdims=True)
    to_axis = np.stack([-points[..., 0], 1.49 - points[..., 2]], axis=-1)
    return np.abs(to_axis[..., 0] * across[..., 1] - to_axis[..., 1] * across[..., 0])


def drawn_mirror(pose: RigidTransform, seed: int, around_dn: float = 180.0) -> np.ndarray:
    """Draw the mirror with the tube's reflection; four times four lines of sight a pixel, noise of 1 DN.

    around_dn: Brightness of what is 25 mm around the tube.
    """
    fine = (np.arange(4) + 0.5) / 4 - 0.5
    u, v = np.meshgrid((np.arange(360)[:, None] + fine).ravel(), (np.arange(260)[:, None] + fine).ravel())
    rays = np.stack([(u - 181.3) / 1050, (v - 128.2) / 1050, np.ones_like(u)], axis=-1) @ pose.rotation
    eye = -pose.rotation.T @ pose.translation_m
    # x^2 = 4 f z along a line of sight that goes down; written so that no digits are lost where it is steep.
    a, b = rays[..., 0] ** 2, eye[0] * rays[..., 0] - 2 * 1.49 * rays[..., 2]
    c = eye[0] ** 2 - 4 * 1.49 * eye[2]
    points = eye + (-c / (b + np.sqrt(b * b - a * c)))[..., None] * rays
    on_mirror = (np.abs(points[..., 0]) < 1.0) & (np.abs(points[..., 1]) < 0.7)
    beside = beside_axis_m(points, eye)
    tone = np.where(on_mirror, np.select([beside < 0.035, beside < 0.06], [20.0, around_dn], 180.0), 90.0)
    image = cv2.GaussianBlur(tone.reshape(260, 4, 360, 4).mean(axis=(1, 3)), (0, 0), 0.5)
    return np.rint(image + np.random.default_rng(seed).normal(0, 1.0, image.shape)).astype(np.uint8)


@pytest.fixture(scope="module")
def shots() -> list[Shot]:
    """Three photos of the mirror from different places, the last from too far aside."""
    taken = []
    for number, x in enumerate((0.55, -0.6, 4.0)):
        pose = looking(np.array([x, 0.1, 7.0]), np.array([0.05 * x, 0.0, 0.1]))
        image = drawn_mirror(pose, number) if number < 2 else np.full((260, 360), 90, dtype=np.uint8)
        taken.append(Shot(image, number, View(CAMERA, pose)))
    return taken


def test_edges_are_where_reflected_lines_of_sight_touch_the_tube(shots: list[Shot]) -> None:
    for shot, found in zip(shots[:2], reflection_edges(shots[:2], EXPECTED), strict=True):
        assert np.count_nonzero(found.side > 0) >= 45
        assert np.count_nonzero(found.side < 0) >= 45
        points = found.points_m
        off = beside_axis_m(points, shot.view.eye_m) - 0.035
        # By how much the distance changes across the mirror, where an edge is found 1 mm aside.
        aside = points + np.stack([np.full(len(points), 1e-3), np.zeros(len(points)), points[:, 0] / 2.98e3], axis=1)
        per_m = (beside_axis_m(aside, shot.view.eye_m) - 0.035 - off) / 1e-3
        errors_px = off / per_m / 6.5e-3
        assert np.abs(np.median(errors_px)) < 0.015
        assert np.std(errors_px) < 0.08
        assert (found.photo == shot.number).all()


def test_edges_stay_where_samples_lie_elsewhere_among_the_pixels() -> None:
    """A wider window begins elsewhere; with one sample a pixel edges moved by 0.039 px RMS, those of a photo alike."""
    pose = looking(np.array([0.55, 0.1, 7.0]), np.array([0.0275, 0.0, 0.1]))
    shot = Shot(drawn_mirror(pose, 0), 0, View(CAMERA, pose))
    [first] = reflection_edges([shot], EXPECTED)
    for wider in (0.7, 1.1, 1.3):
        [found] = reflection_edges([shot], replace(EXPECTED, slope_error_rad=wider * EXPECTED.slope_error_rad))
        np.testing.assert_array_equal(found.row, first.row)
        moved_px = (found.points_m - first.points_m)[:, 0] / 6.5e-3
        assert np.sqrt(np.mean(moved_px**2)) < 0.004


def test_several_photos_at_once_give_what_each_gives_alone(shots: list[Shot]) -> None:
    together = reflection_edges(shots, EXPECTED)
    for shot, found in zip(shots, together, strict=True):
        [alone] = reflection_edges([shot], EXPECTED)
        for name in found.__slots__:
            np.testing.assert_allclose(getattr(found, name), getattr(alone, name), rtol=1e-12, atol=1e-12)
    assert together[2].row.size == 0
    assert reflection_edges([], EXPECTED) == []
    assert edge_profiles(shots[0], EXPECTED).shape[1] == 13
    assert edge_profiles(shots[2], EXPECTED).shape == (0, 13)


def test_profiles_are_none_of_lesser_steps() -> None:
    """What is around the tube has 50 of 180 DN: from there to the tube brightness steps less than to there."""
    pose = looking(np.array([0.55, 0.1, 7.0]), np.array([0.0275, 0.0, 0.1]))
    shot = Shot(drawn_mirror(pose, 0, around_dn=50.0), 0, View(CAMERA, pose))
    [edges] = reflection_edges([shot], EXPECTED)
    profiles = edge_profiles(shot, EXPECTED)
    assert np.count_nonzero(edges.is_lesser) >= 90
    assert len(profiles) >= 45
    np.testing.assert_allclose(profiles[:, -1] - profiles[:, 0], 130.0, atol=8.0)


def test_tubes_of_several_photos_at_once_are_those_of_each_alone() -> None:
    taken = []
    for number, x in enumerate((2.5, -2.0, 0.1)):
        pose = looking(np.array([x, 0.1, 6.0]), np.array([0.0, 0.0, 1.49]))
        image = drawn_tube(View(CAMERA, pose), lambda y: (np.zeros_like(y), np.full_like(y, 1.49)), 0.035)
        taken.append(Shot(image, number, View(CAMERA, pose)))
    together = tube_bearings(taken, EXPECTED)
    # From above the tube stands before its own reflection.
    assert [one.y_m.size > 40 for one in together] == [True, True, False]
    for shot, found in zip(taken, together, strict=True):
        [alone] = tube_bearings([shot], EXPECTED)
        for name in found.__slots__:
            np.testing.assert_allclose(getattr(found, name), getattr(alone, name), rtol=1e-12, atol=1e-15)
    assert tube_bearings([], EXPECTED) == []


def test_edges_of_a_strip_are_those_of_a_plain_search() -> None:
    rng = np.random.default_rng(0)
    x = np.arange(120) * 6.3e-3
    edge = rng.uniform(40, 80, 30)
    image = 60 + 120 / (1 + np.exp(-(np.arange(120) - edge[:, None]) / 0.5)) + rng.normal(0, 1, (30, 120))
    strips = [Strip(part.astype(np.float32), x, np.ones(part.shape, dtype=bool)) for part in (image[:12], image[12:])]
    found, strip = find_edges(strips)
    np.testing.assert_array_equal(strip, np.repeat([0, 1], [12, 18]))
    np.testing.assert_array_equal(found.row, [*range(12), *range(18)])
    place = np.arange(-5, 6)
    kernel = place / 1.2**2 * np.exp(-0.5 * (place / 1.2) ** 2)
    for k, row in enumerate(image):
        size = np.abs(np.convolve(row, kernel[::-1], mode="same"))[5:-5]
        top = int(np.argmax(size))
        before, here, after = np.log(size[top - 1 : top + 2])
        expected = top + 5 + 0.5 * (before - after) / (before - 2 * here + after)
        assert found.x_m[k] / 6.3e-3 == pytest.approx(expected, abs=1e-4)
