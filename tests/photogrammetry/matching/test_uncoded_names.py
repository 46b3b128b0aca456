"""Points named by a list of approximate coordinates, its frame known or found."""

import numpy as np
import pytest

from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from photogrammetry.matching.uncoded_names import ListedTargets, list_frame, name_points

SIGMA_M = 0.003
RNG = np.random.default_rng(0)
PLACES = RNG.uniform(-1, 1, (9, 3)) * (1.5, 1.0, 0.2)
WORLD_FROM_LIST = RigidTransform.from_rotation_vector([0.3, -1.2, 2.0], [4.0, 5.0, 6.0])


def listed(points=PLACES, sigma_m=SIGMA_M) -> ListedTargets:
    rng = np.random.default_rng(1)
    names = tuple(f"T{k}" for k in range(len(points)))
    return ListedTargets(names, points + sigma_m * rng.standard_normal(points.shape), np.full(points.shape, sigma_m))


def measured(extra: int = 6):
    """Points in the world, in another order, some of them not listed."""
    rng = np.random.default_rng(2)
    order = rng.permutation(len(PLACES))
    others = rng.uniform(-1, 1, (extra, 3)) * (1.5, 1.0, 0.2)
    points = WORLD_FROM_LIST.apply(np.concatenate([PLACES[order], others]))
    return points, np.broadcast_to(np.eye(3) * 1e-8, (len(points), 3, 3)), [f"T{k}" for k in order] + [None] * extra


def test_names_in_a_known_frame() -> None:
    points, covariance, names = measured()
    found = name_points(points, covariance, listed(), WORLD_FROM_LIST.inverse())
    assert list(found.names) == names
    assert found.left == ()


def test_frame_from_distances_and_from_common_names() -> None:
    points, covariance, names = measured()
    frame = list_frame(points, {}, listed())
    assert list(name_points(points, covariance, listed(), frame).names) == names
    known = {name: points[k] for k, name in enumerate(names) if name in ("T1", "T4", "T7", "T8")}
    frame = list_frame(points, known, listed())
    assert np.linalg.norm(frame.apply(points) - WORLD_FROM_LIST.inverse().apply(points), axis=1).max() < 0.02


def test_what_cannot_be_told_is_left() -> None:
    points, covariance, _ = measured(0)
    frame = WORLD_FROM_LIST.inverse()
    missing = name_points(points[1:], covariance[1:], listed(), frame)
    assert len(missing.left) == 1
    assert "the nearest point is" in missing.left[0].reason
    double = np.concatenate([points, points[:1] + 0.001])
    two = name_points(double, np.broadcast_to(np.eye(3) * 1e-8, (10, 3, 3)), listed(), frame)
    assert "two points agree with its listed place" in two.left[0].reason
    close = ListedTargets(("a", "b"), np.stack([PLACES[0], PLACES[0] + 0.001]), np.full((2, 3), SIGMA_M))
    both = name_points(points, covariance, close, frame)
    assert [one.name for one in both.left] == ["a", "b"]
    assert "may as well be b" in both.left[0].reason


def test_symmetric_list_without_a_frame_is_refused() -> None:
    square = np.array([[x, y, 0.0] for x in (-1, 1) for y in (-1, 1)])
    with pytest.raises(EstimationError, match="two ways of naming fit 4 points equally well"):
        list_frame(WORLD_FROM_LIST.apply(square), {}, listed(square))
    with pytest.raises(EstimationError, match="no frame puts 4 of the 9"):
        list_frame(2 * PLACES, {}, listed())
    with pytest.raises(EstimationError, match="leave open the list's frame"):
        list_frame(PLACES, {}, listed(PLACES[:2]))
