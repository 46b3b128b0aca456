"""Outlier tests, defects by name, and whether the stated uncertainty is the scatter of errors."""

import numpy as np
import pytest

from heliogauge.adjust.least_squares import CovarianceScale
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError
from photogrammetry.bundle.adjustment import BundleOptions, adjust
from photogrammetry.bundle.constraints import Distance
from photogrammetry.bundle.datum import Datum, DatumKind
from photogrammetry.bundle.problem import BundleProblem, CameraModel
from photogrammetry.bundle.state import BundleState
from photogrammetry.bundle.statistics import (
    adjust_and_reject,
    examine_image_points,
    examine_intrinsics,
)
from photogrammetry.image_points import ImagePoints
from tests.photogrammetry.bundle_networks import disturbed, look_at, network, observe

INTRINSICS = ("focal_px", "aspect", "center_x_px", "center_y_px", "k1", "k2", "k3", "p1", "p2")


def small(seed=1, photos=8, points=30):
    rng = np.random.default_rng(seed)
    return rng, *network(rng, photos, points, sigma_px=0.1)


def moved(points, rows, by_px):
    pixels = points.pixels_px.copy()
    pixels[rows] += by_px
    return ImagePoints(
        points.photos, points.targets, points.photo_index, points.target_index, pixels, points.covariance_px2
    )


@pytest.mark.parametrize("scale", list(CovarianceScale))
def test_redundancy_adds_up_and_false_image_points_are_rejected(scale):
    rng, truth, points = small()
    bad = rng.choice(points.n, 6, replace=False)
    spoiled = moved(points, bad, rng.choice([-1, 1], (6, 2)) * rng.uniform(2.0, 20.0, (6, 2)))
    problem = BundleProblem(spoiled, (CameraModel("c", ("focal_px",)),))
    options = BundleOptions(covariance_scale=scale)
    numbers = examine_image_points(adjust(problem, truth, options=options)).redundancy
    assert np.einsum("mii->", numbers) == pytest.approx(adjust(problem, truth).redundancy, abs=1e-6)
    result, rejected = adjust_and_reject(problem, truth, options=options)
    assert {one.row for one in rejected} == set(bad.tolist())
    assert result.variance_factor == pytest.approx(1.0, abs=0.35)
    assert all(one.label == points.label(one.row) for one in rejected)


def test_suspects_that_agree_come_in_and_others_stay_out():
    rng, truth, points = small()
    bad = rng.choice(points.n, 3, replace=False)
    good = np.setdiff1d(rng.choice(points.n, 8, replace=False), bad)
    suspects = np.zeros(points.n, dtype=np.bool_)
    suspects[bad], suspects[good] = True, True
    problem = BundleProblem(moved(points, bad, 8.0), (CameraModel("c", ("focal_px",)),))
    result, rejected = adjust_and_reject(problem, truth, suspects=suspects)
    used = {result.problem.observations.label(row) for row in range(result.problem.observations.n)}
    assert {points.label(row) for row in good} <= used
    assert not {points.label(row) for row in bad} & used
    assert rejected == ()


def test_good_image_points_stay_and_baarda_is_normal():
    _, truth, points = small(photos=12, points=60)
    result, rejected = adjust_and_reject(BundleProblem(points, (CameraModel("c"),)), truth)
    assert len(rejected) <= 1
    tests = examine_image_points(result)
    assert np.nanstd(tests.baarda) == pytest.approx(1.0, abs=0.05)
    assert tests.length_squared.mean() == pytest.approx(2.0, abs=0.15)


def test_contradictory_scale_bars_show_their_residual():
    _, truth, points = small()
    lengths = [np.linalg.norm(truth.points_m[a] - truth.points_m[b]) for a, b in ((0, 1), (2, 3))]
    bars = (Distance("t0", "t1", lengths[0], 1e-5), Distance("t2", "t3", lengths[1] * 1.01, 1e-5))
    result = adjust(BundleProblem(points, (CameraModel("c"),), constraints=bars), truth)
    names = {name: residual[0] for name, residual in result.constraint_residuals}
    assert set(names) == {"distance t0 - t1", "distance t2 - t3"}
    assert max(abs(value) for value in names.values()) > 10
    assert "scale" not in result.datum


def test_single_ray_is_named():
    _, truth, points = small()
    one = np.nonzero(points.target_index == 5)[0]
    result = adjust(
        BundleProblem(points.subset(np.setdiff1d(np.arange(points.n), one[1:])), (CameraModel("c"),)), truth
    )
    (defect,) = result.defects
    assert defect.targets == ("t5",)
    assert defect.count == 1
    assert np.isnan(result.points_m[5]).all()
    assert np.isfinite(np.delete(result.sigma_points_m, 5, axis=0)).all()
    with pytest.raises(EstimationError, match=r"t5 \(1 ray\)"):
        result.require()


def test_photo_with_two_targets_is_named():
    _, truth, points = small()
    own = np.nonzero(points.photo_index == 3)[0]
    result = adjust(
        BundleProblem(points.subset(np.setdiff1d(np.arange(points.n), own[2:])), (CameraModel("c"),)), truth
    )
    (defect,) = result.defects
    assert defect.photos == ("photo3",)
    assert defect.count == 2
    assert np.isnan(result.covariance.poses[3]).all()
    assert np.isfinite(result.sigma_points_m).all()
    with pytest.raises(EstimationError, match=r"photo3 \(2 targets\)"):
        result.require()


def test_parts_that_hang_by_two_targets_are_named():
    _, truth, points = small(photos=8, points=40)
    # Even photos see the first half, odd ones the second; two targets are common.
    half = np.where(points.photo_index % 2 == 0, points.target_index < 21, points.target_index >= 19)
    result = adjust(BundleProblem(points.subset(np.nonzero(half)[0]), (CameraModel("c"),)), truth)
    (defect,) = result.defects
    # Seven movements of the second part, six of them taken by two common points less one turn about their line.
    assert defect.count == 1
    assert len(defect.photos) >= 4


def test_intrinsics_that_a_network_does_not_hold_are_named():
    rng = np.random.default_rng(3)
    # A flat field seen straight on from one height: focal length and height are the same thing.
    points = np.column_stack([rng.uniform(-1, 1, (40, 2)), np.zeros(40)])
    poses = [look_at(np.array([x, y, 5.0]), [x, y, 0.0], 0.0) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
    truth = BundleState.from_poses([Camera(6000, 4000, 6100.0, 6103.0, 3010.0, 1990.0)], poses, points)
    result = adjust(BundleProblem(observe(truth, rng, 1e-6), (CameraModel("c", ("focal_px",)),)), truth)
    (defect,) = result.defects
    assert defect.intrinsics == ("focal_px of c",)
    with pytest.raises(EstimationError, match="focal_px of c"):
        result.require()


def test_significance_and_correlations():
    _, truth, points = small(photos=12, points=60)
    result = adjust(BundleProblem(points, (CameraModel("c", ("focal_px", "skew", "k1", "k2", "k3")),)), truth)
    tests = {one.name: one for one in examine_intrinsics(result)}
    assert tests["k1"].significance > 0.99
    assert tests["skew"].significance < 0.999
    assert np.isnan(tests["focal_px"].significance)
    assert {tests["k2"].rival, tests["k3"].rival} <= {"k1", "k2", "k3"}


def test_datum_does_not_change_what_is_estimable():
    _, truth, points = small()
    kinds = [Datum(), Datum(DatumKind.MINIMAL, ("t0", "t1", "t2")), Datum(targets=("t3", "t4", "t6", "t7"))]
    results = [adjust(BundleProblem(points, (CameraModel("c"),), datum=one), truth) for one in kinds]
    ratios, traces = [], []
    for result in results:
        joint = result.covariance.joint([0, 1, 2])
        ends = result.points_m[:3]
        u, v = ends[1] - ends[0], ends[2] - ends[0]
        # The relative sigma of a ratio of lengths needs no datum.
        row = np.concatenate([-u / (u @ u) + v / (v @ v), u / (u @ u), -v / (v @ v)])
        ratios.append(float(row @ joint @ row))
        traces.append(float(np.trace(result.covariance.points.sum(axis=0))))
    np.testing.assert_allclose(ratios, ratios[0], rtol=1e-6)
    assert traces[0] < min(traces[1:])
    assert len({result.datum for result in results}) == 3


def test_estimate_is_in_the_datum_of_its_covariance():
    rng, truth, points = small()
    start = disturbed(truth, rng, 0.1)
    minimal = Datum(DatumKind.MINIMAL, ("t0", "t1", "t2"))
    result = adjust(BundleProblem(points, (CameraModel("c"),), datum=minimal), start)
    held = result.sigma_points_m < 1e-9
    assert held.sum() == 7
    np.testing.assert_allclose(result.state.points_m[held], start.points_m[held], atol=1e-10)
    chosen = adjust(BundleProblem(points, (CameraModel("c"),), datum=Datum(targets=("t3", "t4", "t6", "t7"))), start)
    shift = (chosen.state.points_m - start.points_m)[[3, 4, 6, 7]]
    np.testing.assert_allclose(shift.mean(axis=0), 0.0, atol=1e-10)
    arms = start.points_m[[3, 4, 6, 7]] - start.points_m[[3, 4, 6, 7]].mean(axis=0)
    # Turn and stretch are zero to second order in the 2 mm that the start was off.
    np.testing.assert_allclose(np.cross(arms, shift).sum(axis=0), 0.0, atol=1e-4)
    assert abs((arms * shift).sum()) < 1e-4


@pytest.mark.slow
def test_scatter_of_errors_is_the_stated_one():
    """40 photos of 300 targets on an 8 m panel: chi-square of errors, residuals and estimable sizes, 25 networks."""
    rng = np.random.default_rng(5)
    truth, _ = network(rng, 40, 300)
    chi, factors, largest = [], [], 0.0
    for _ in range(25):
        points = observe(truth, rng, 0.05)
        result = adjust(BundleProblem(points, (CameraModel("c", INTRINSICS),)), truth)
        # Start at the truth: inner constraints make the error's own datum that of the covariance.
        error = result.state.points_m - truth.points_m
        chi.append(error**2 / np.einsum("nii->ni", result.covariance.points))
        factors.append(result.variance_factor)
        largest = max(largest, float(result.sigma_points_m.mean()))
        own = result.cameras[0].parameters - truth.cameras[0].parameters
        free = result.cameras[0].sigma_parameters > 0
        assert (np.abs(own[free]) < 5 * result.cameras[0].sigma_parameters[free]).all()
    # 25 networks with a few common directions each: 0.006 at 1 sigma.
    assert np.sqrt(np.mean(chi)) == pytest.approx(1.0, abs=0.02)
    assert np.mean(factors) == pytest.approx(1.0, abs=0.01)
    assert 8.0 / largest > 250_000
