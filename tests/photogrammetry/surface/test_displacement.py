"""The same targets on two dates: exact motions, honesty of the test, who moved, refusals."""

import numpy as np
import pytest

from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from photogrammetry.surface.displacement import displacements, rigid_fit
from photogrammetry.surface.fitted import SurfacePoints
from tests.photogrammetry.surfaces_synthetic import correlated, drawn

NOW_FROM_BEFORE = RigidTransform.from_rotation_vector([0.3, -0.4, 2.0], [1.0, -2.0, 0.5])
PLACES = np.random.default_rng(0).uniform(-2, 2, (25, 3))


def named(points: np.ndarray, sigma_m: float) -> SurfacePoints:
    return SurfacePoints(tuple(f"T{k}" for k in range(len(points))), points, sigma_m**2 * np.eye(points.size))


def test_rigid_fit_recovers_an_exact_motion() -> None:
    fit = rigid_fit(named(PLACES, 1e-4), named(NOW_FROM_BEFORE.apply(PLACES), 1e-4), np.ones(25, dtype=bool))
    np.testing.assert_allclose(fit.b_from_a.rotation, NOW_FROM_BEFORE.rotation, atol=1e-13)
    assert np.abs(fit.difference_m).max() < 1e-13


@pytest.mark.parametrize("inner", [False, True])
def test_differences_scatter_as_their_covariance_says(inner: bool) -> None:
    rng = np.random.default_rng(1)
    now = NOW_FROM_BEFORE.apply(PLACES)
    roots = correlated(PLACES, 1e-4, rng, inner=inner), correlated(now, 5e-5, rng, inner=inner)
    fitted = np.arange(25) < 10
    ratios, factors = [], []
    for _ in range(60):
        fit = rigid_fit(drawn(PLACES, roots[0], rng), drawn(now, roots[1], rng), fitted)
        ratios.append(fit.difference_m.ravel() / np.sqrt(np.diag(fit.covariance_m2)))
        factors.append(fit.variance_factor)
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1, abs=0.08)
    assert np.mean(factors) == pytest.approx(1, abs=0.12)


def test_moved_targets_are_found_with_direction_and_size() -> None:
    rng = np.random.default_rng(2)
    shift = np.zeros((25, 3))
    shift[[3, 9]] = [[0, 0, 0.002], [-0.001, 0, 0]]
    before = drawn(PLACES, 2e-5 * np.eye(75), rng)
    now = drawn(NOW_FROM_BEFORE.apply(PLACES) + shift, 2e-5 * np.eye(75), rng)
    found = displacements(before, now)
    assert [found.ids[i] for i in np.flatnonzero(found.moved)] == ["T3", "T9"]
    assert not found.stable[[3, 9]].any()
    np.testing.assert_allclose(found.displacement_m[[3, 9]], shift[[3, 9]], atol=1.5e-4)
    assert found.probability[3] < 1e-10
    assert 0.5 < found.variance_factor < 1.7


def test_targets_at_rest_seldom_move() -> None:
    rng, alarms = np.random.default_rng(3), 0
    now = NOW_FROM_BEFORE.apply(PLACES)
    for _ in range(60):
        found = displacements(drawn(PLACES, 2e-5 * np.eye(75), rng), drawn(now, 3e-5 * np.eye(75), rng))
        alarms += bool(found.moved.any())
    # 5 % of the families: 3 of 60, 9 would be 4 sigma.
    assert alarms <= 8


def test_named_stable_targets_define_the_frame_and_are_tested() -> None:
    rng = np.random.default_rng(4)
    # Most targets move together; only a name can tell that the few are the ones at rest.
    shift = np.where(np.arange(25)[:, None] < 5, 0.0, [0.0, 0.0, 0.003])
    before = drawn(PLACES, 2e-5 * np.eye(75), rng)
    now = drawn(NOW_FROM_BEFORE.apply(PLACES) + shift, 2e-5 * np.eye(75), rng)
    found = displacements(before, now, stable=tuple(f"T{k}" for k in range(5)))
    assert found.moved[5:].all()
    assert not found.moved[:5].any()
    assert found.stable_probability > 1e-3
    wrong = displacements(before, now, stable=("T0", "T1", "T2", "T10"))
    assert wrong.stable_probability < 1e-6


def test_only_common_names_count_and_their_order_does_not() -> None:
    before = named(PLACES, 1e-5)
    now = NOW_FROM_BEFORE.apply(PLACES)
    places = np.vstack([now[[7, 2]], [[9.0, 9, 9]], now[[20, 1, 11]]])
    some = SurfacePoints(("T7", "T2", "new", "T20", "T1", "T11"), places, 1e-10 * np.eye(18))
    found = displacements(before, some)
    assert found.ids == ("T7", "T2", "T20", "T1", "T11")
    assert np.abs(found.displacement_m).max() < 1e-12


@pytest.mark.parametrize(
    ("names", "places", "stable", "words"),
    [
        (("A", "B"), PLACES[:2], (), "three common targets are needed, not 0"),
        (("T0", "T1", "T2"), PLACES[:3], ("T0", "T1", "X"), "stable targets X are not measured"),
        (("T0", "T1", "T2"), PLACES[:3], ("T0", "T1"), "three common points"),
    ],
)
def test_what_cannot_be_compared_is_refused(names, places, stable, words) -> None:
    with pytest.raises(EstimationError, match=words):
        displacements(named(PLACES, 1e-5), SurfacePoints(names, places, 1e-10 * np.eye(places.size)), stable=stable)


def test_line_of_targets_is_refused() -> None:
    line = np.column_stack([np.arange(5.0), np.zeros((5, 2))])
    with pytest.raises(EstimationError, match="on one line"):
        rigid_fit(named(line, 1e-5), named(line, 1e-5), np.ones(5, dtype=bool))
