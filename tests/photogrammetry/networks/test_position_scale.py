"""Size of a flight by the drone's own positions: right, with its sigma, also along one straight line."""

import numpy as np
import pytest

from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector
from photogrammetry.bundle.adjustment import adjust
from photogrammetry.bundle.constraints import Coordinate
from photogrammetry.bundle.problem import BundleProblem, CameraModel
from photogrammetry.bundle.state import BundleState
from photogrammetry.networks.position_scale import PositionScale, scale_by_positions
from tests.photogrammetry.bundle_networks import look_at, observe

LEVER_M = np.array([0.02, -0.15, 0.05])
SIGMA_M = np.array([0.02, 0.02, 0.04])
PHOTOS, LISTED_M = 12, 5e-3


def flight(seed: int, *, is_straight: bool, size: float = 1.0, worse: float = 1.0) -> PositionScale:
    """Adjust a pass over listed targets, all with errors, and compare with positions ``size`` times apart.

    worse: Errors of the positions over their sigmas.
    """
    rng = np.random.default_rng([seed, int(is_straight)])
    points = np.column_stack([rng.uniform(-3, 3, (14, 2)), rng.uniform(0, 1, 14)])
    beside = np.zeros(PHOTOS) if is_straight else rng.uniform(-1.5, 1.5, PHOTOS)
    eyes = np.column_stack([np.linspace(-3, 3, PHOTOS), beside, np.full(PHOTOS, 12.0) + 0.5 * beside])
    poses = [look_at(eye, np.array([0.0, 0.0, 0.5])) for eye in eyes]
    camera = Camera(6000, 4000, 5000.0, 5000.0, 2999.5, 1999.5)
    truth = BundleState.from_poses([camera], poses, points)
    seen = observe(truth, rng, 0.3)
    listed = points + LISTED_M * rng.standard_normal(points.shape)
    known = tuple(
        Coordinate(f"t{k}", axis, float(listed[k, place]), LISTED_M)
        for k in range(len(points))
        for place, axis in enumerate("xyz")
    )
    bundle = adjust(BundleProblem(seen, (CameraModel("camera", free=()),), None, known), truth)
    antennas = np.array([pose.inverse().apply(LEVER_M) for pose in poses])
    world = RigidTransform(rotation_from_vector(np.array([0.1, -0.2, 2.0])), np.array([30.0, -20.0, 5.0]))
    enu = size * world.apply(antennas) + worse * SIGMA_M * rng.standard_normal(antennas.shape)
    return scale_by_positions(bundle, np.arange(PHOTOS), enu, np.tile(SIGMA_M, (PHOTOS, 1)), LEVER_M)


@pytest.mark.slow
@pytest.mark.parametrize("is_straight", [False, True])
def test_sigma_is_the_scatter(is_straight: bool) -> None:
    found = [flight(seed, is_straight=is_straight) for seed in range(60)]
    pulls = np.array([(one.ratio - 1) / one.sigma_ratio for one in found])
    # Sixty pulls: mean +- 0.13, mean square 1 +- 0.18.
    assert abs(pulls.mean()) < 0.45
    assert 0.5 < np.mean(pulls**2) < 1.6
    # Chi-square of 29 over 29: the mean of sixty is 1 +- 0.034.
    assert 0.88 < np.mean([one.misfit**2 for one in found]) < 1.12
    assert sum(one.fits for one in found) >= 59


def test_positions_say_where_the_list_is_too_small_and_are_silent_else() -> None:
    right = flight(1, is_straight=True)
    assert not right.doubts
    assert right.photos == PHOTOS
    wrong = flight(1, is_straight=True, size=1 + 6 * right.sigma_ratio)
    assert [one.code for one in wrong.doubts] == ["positions_contradict_scale"]
    assert wrong.ratio - right.ratio == pytest.approx(6 * right.sigma_ratio, rel=1e-2)


@pytest.mark.slow
def test_positions_without_corrections_contradict_themselves_not_the_list() -> None:
    """Errors of two metres with sigmas of RTK: the scale's sigma is the scatter still."""
    found = [flight(seed, is_straight=False, worse=100.0) for seed in range(20)]
    assert all([one.code for one in each.doubts][:1] == ["positions_do_not_fit"] for each in found)
    pulls = np.array([(one.ratio - 1) / one.sigma_ratio for one in found])
    assert 0.4 < np.mean(pulls**2) < 1.9
    assert sum(len(one.doubts) == 1 for one in found) >= 18


def test_two_photos_say_nothing() -> None:
    with pytest.raises(EstimationError, match="2 photos of the network have one, 3 are needed"):
        scale_by_positions(None, np.arange(2), np.zeros((2, 3)), np.ones((2, 3)), np.zeros(3))  # type: ignore[arg-type]
