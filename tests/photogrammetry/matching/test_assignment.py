"""Dots of one photo named by a list of approximate coordinates, its pose unknown."""

import numpy as np
import pytest

from heliogauge.camera.distortion import BrownDistortion
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError
from photogrammetry.matching.assignment import Sense, assign_near, assign_targets
from photogrammetry.matching.uncoded_names import ListedTargets
from tests.photogrammetry.bundle_networks import look_at

CAMERA = Camera(3000, 2000, 3100.0, 3100.0, 1500.0, 1000.0, distortion=BrownDistortion(k1=-0.1, k2=0.05))
SIGMA_PX, SIGMA_M = 0.1, 0.004
#: A trough of 5.76 m x 11.9 m: six targets on each rim, evenly spaced or not.
EVEN = np.array([[x, y, 1.2] for x in (-2.88, 2.88) for y in np.linspace(0, 11.9, 6)])
UNEVEN = EVEN + np.array([0, 1, 0]) * np.array([0, 0.3, -0.4, 0.2, 0.5, 0, 0, -0.5, 0.3, 0.45, -0.2, 0])[:, None]


def listed(points: np.ndarray, rng) -> ListedTargets:
    """What a tape tells of the points."""
    names = tuple(f"T{k + 1}" for k in range(len(points)))
    return ListedTargets(names, points + SIGMA_M * rng.standard_normal(points.shape), np.full(points.shape, SIGMA_M))


def photo(points, rng, *, center=(6.0, 2.0, 24.0), roll=0.0, false=0, missing=()):
    """Dots in random order with the true place of each, -1 for false ones."""
    pose = look_at(np.array(center), points.mean(axis=0), roll)
    keep = np.array([k for k in range(len(points)) if k not in missing])
    pixels = CAMERA.project(pose.apply(points[keep]))
    pixels = np.concatenate([pixels, rng.uniform(0, 1, (false, 2)) * (2999, 1999)])
    pixels += SIGMA_PX * rng.standard_normal(pixels.shape)
    order = rng.permutation(len(pixels))
    return pixels[order], np.concatenate([keep, np.full(false, -1)])[order], pose


def covariances(pixels):
    return np.broadcast_to(np.eye(2) * SIGMA_PX**2, (len(pixels), 2, 2))


@pytest.mark.parametrize(("false", "missing"), [(0, ()), (8, ()), (8, (1, 7, 10)), (0, (0, 3, 4, 8))])
def test_uneven_layout(false: int, missing: tuple[int, ...]) -> None:
    rng = np.random.default_rng(false + len(missing))
    pixels, who, pose = photo(UNEVEN, rng, false=false, missing=missing, roll=2.0)
    found = assign_targets(CAMERA, pixels, covariances(pixels), listed(UNEVEN, rng))
    named = found.target_of_dot >= 0
    assert (found.target_of_dot[named] == who[named]).all()
    assert named.sum() >= 12 - len(missing) - 1
    assert found.accidents < 0.01
    far = found.cam_from_list.inverse().translation_m - pose.inverse().translation_m
    assert np.linalg.norm(far) < 0.25


def test_even_layout_is_refused_without_a_sense() -> None:
    rng = np.random.default_rng(5)
    pixels, _, _ = photo(EVEN, rng)
    with pytest.raises(EstimationError, match=r"ways of naming 12 dots fit equally well \(one dot is T\d+ or T\d+\)"):
        assign_targets(CAMERA, pixels, covariances(pixels), listed(EVEN, rng))


@pytest.mark.parametrize("roll", [0.0, 0.5])
def test_up_and_front_settle_an_even_layout(roll: float) -> None:
    rng = np.random.default_rng(6)
    pixels, who, pose = photo(EVEN, rng, roll=roll, false=4)
    # What is up in this photo before its roll, as somebody would state it.
    up = look_at(pose.inverse().translation_m, EVEN.mean(axis=0)).inverse().rotate([0.0, -1.0, 0.0])
    sense = Sense(up=up, front=np.array([0.0, 0.0, 1.0]))
    found = assign_targets(CAMERA, pixels, covariances(pixels), listed(EVEN, rng), sense=sense)
    named = found.target_of_dot >= 0
    assert named.sum() >= 11
    assert (found.target_of_dot[named] == who[named]).all()
    turned = Sense(up=-up, front=np.array([0.0, 0.0, 1.0]))
    other = assign_targets(CAMERA, pixels, covariances(pixels), listed(EVEN, rng), sense=turned)
    assert (other.target_of_dot[named] != who[named]).all()


def test_mirrored_layout_is_told_by_the_front() -> None:
    """A flat layout with one mirror plane looks from behind as from the front."""
    points = np.array(
        [[x, y, 0.0] for y, half in ((0, 1.0), (1.3, 1.6), (2.1, 0.7), (3.4, 1.2)) for x in (-half, half)]
    )
    rng = np.random.default_rng(7)
    pixels, who, _ = photo(points, rng, center=(1.0, 0.5, 8.0))
    both = listed(points, rng)
    with pytest.raises(EstimationError, match="fit equally well"):
        assign_targets(CAMERA, pixels, covariances(pixels), both)
    found = assign_targets(CAMERA, pixels, covariances(pixels), both, sense=Sense(front=np.array([0, 0, 1.0])))
    named = found.target_of_dot >= 0
    assert (found.target_of_dot[named] == who[named]).all()


def test_dots_of_something_else() -> None:
    rng = np.random.default_rng(8)
    pixels = rng.uniform(0, 1, (9, 2)) * (2999, 1999)
    with pytest.raises(EstimationError, match="no pose explains the dots"):
        assign_targets(CAMERA, pixels, covariances(pixels), listed(UNEVEN[::2], rng))


def test_too_few_and_bad_values() -> None:
    rng = np.random.default_rng(9)
    known = listed(UNEVEN, rng)
    with pytest.raises(EstimationError, match="3 dots and 12 listed targets; 5 of both"):
        assign_targets(CAMERA, np.ones((3, 2)), covariances(np.ones(3)), known)
    line = ListedTargets(tuple("abcdef"), np.outer(np.arange(6.0), [1, 2, 3]), np.full((6, 3), 0.01))
    with pytest.raises(EstimationError, match="on one line"):
        assign_targets(CAMERA, rng.uniform(0, 1000, (8, 2)), covariances(np.ones(8)), line)
    with pytest.raises(InputError, match="up: a direction"):
        Sense(up=np.zeros(3))
    with pytest.raises(InputError, match="a is listed twice"):
        ListedTargets(("a", "a"), np.zeros((2, 3)), np.ones((2, 3)))
    with pytest.raises(InputError, match="positive sigma"):
        ListedTargets(("a", "b"), np.zeros((2, 3)), np.array([[1, 1, 1], [0, 1, 1.0]]))


def test_a_thousand_listed_targets() -> None:
    """Their binomial coefficients are no floating-point numbers any more."""
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(-3, 3, 1200), rng.uniform(0, 12, 1200), rng.uniform(0, 1, 1200)])
    pixels, who, pose = photo(points, rng, missing=tuple(range(40, 1200)), false=4)
    found = assign_near(CAMERA, pixels, covariances(pixels), listed(points, rng), pose)
    assert found is not None
    named = found.target_of_dot >= 0
    assert np.mean(found.target_of_dot[named] == who[named]) > 0.9
    assert np.isfinite(found.accidents)
