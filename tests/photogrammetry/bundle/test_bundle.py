"""The bundle adjustment against a dense one, against truth, and against published results."""

import numpy as np
import pytest

from heliogauge.adjust.least_squares import CovarianceScale, Huber, Prior
from heliogauge.adjust.robust_loss import Cauchy
from heliogauge.camera.distortion import DistortionDirection
from heliogauge.errors import EstimationError, InputError
from photogrammetry.bundle.adjustment import BundleOptions, adjust
from photogrammetry.bundle.constraints import CommonPlane, ControlPoint, Coordinate, Distance, KnownPlane
from photogrammetry.bundle.datum import Datum, DatumKind, similarity_movements
from photogrammetry.bundle.problem import BundleProblem, CameraModel, ResidualSpace
from photogrammetry.bundle.rows import BundleModel
from photogrammetry.bundle.state import INTRINSIC_NAMES, BundleState, camera_with_intrinsics, intrinsics_of
from tests.derivatives import central_differences, check_jacobian
from tests.photogrammetry.bundle_networks import disturbed, network, observe

FREE = ("focal_px", "aspect", "center_x_px", "center_y_px", "skew", "k1", "k2", "k3", "p1", "p2")


def small(seed=1, **options):
    rng = np.random.default_rng(seed)
    truth, points = network(rng, 8, 30, sigma_px=0.1, **options)
    return rng, truth, points


def distance_of(truth, a, b):
    return float(np.linalg.norm(truth.points_m[a] - truth.points_m[b]))


def dense_jacobian(model, state):
    """All derivatives as one matrix, rows in the model's order, put together without the code under test."""
    layout, rows = model.layout, []
    for one in model.camera_rows(state):
        for place, (photo, target) in enumerate(zip(one.photos, one.targets, strict=True)):
            for axis in range(2):
                row = np.zeros(layout.n)
                own = one.jacobian[axis, :, place]
                row[6 * photo : 6 * photo + 6] = own[:6]
                row[layout.intrinsic_columns[one.camera]] = own[6 : 6 + one.n_free]
                put(row, layout, target, own[7 + one.n_free :])
                rows.append(row)
    extra = model.extra_rows(state)
    for jacobian, targets in zip(extra.jacobians, extra.targets, strict=True):
        for own in jacobian:
            row = np.zeros(layout.n)
            for place, target in enumerate(targets):
                put(row, layout, target, own[place])
            rows.append(row)
    for own in extra.prior_jacobian:
        row = np.zeros(layout.n)
        row[6 * layout.n_photos : 6 * layout.n_photos + own.size] = own
        rows.append(row)
    return np.array(rows)


def put(row, layout, target, values):
    if layout.slot[target] >= 0:
        first = layout.n_global + 3 * layout.slot[target]
        row[first : first + 3] += values
    elif layout.kept_column[target] >= 0:
        row[layout.kept_column[target] : layout.kept_column[target] + 3] += values


@pytest.mark.slow
@pytest.mark.parametrize("space", list(ResidualSpace))
@pytest.mark.parametrize("direction", list(DistortionDirection))
def test_derivatives(direction, space):
    rng, truth, points = small(direction=direction)
    root = rng.normal(size=(points.n, 2, 2)) * 0.05 + 0.2 * np.eye(2)
    points = observe(truth, rng, covariances=root @ np.swapaxes(root, 1, 2))
    constraints = (
        Distance("t0", "t1", 1.0, 0.1),
        Coordinate("t2", "y", 0.5, 0.1),
        KnownPlane(("t3", "t4"), [1, 2, 3], 0.1, 0.2),
        ControlPoint("t5", [0, 1, 2], np.diag([1.0, 2.0, 3.0])),
    )
    camera = CameraModel("c", FREE, priors=(Prior("skew", 0.0, 0.5),), residual=space)
    model = BundleModel(BundleProblem(points, (camera,), constraints=constraints, fixed=("t9",)), truth)

    def predict(state):
        image = np.concatenate([one.residuals.T.ravel() for one in model.camera_rows(state)])
        return np.concatenate([image, model.extra_rows(state).all_residuals])

    steps = np.full(model.layout.n, 1e-4)
    columns = model.layout.intrinsic_columns[0]
    steps[columns] = np.where(np.isin(FREE, ("focal_px", "center_x_px", "center_y_px", "skew")), 0.1, 1e-4)
    differences = central_differences(predict, truth, model.retract, steps)
    check_jacobian(dense_jacobian(model, truth), differences, relative=1e-6, structural_zeros=False)


@pytest.mark.parametrize("space", list(ResidualSpace))
@pytest.mark.parametrize("direction", list(DistortionDirection))
def test_exact_image_points_give_the_truth(direction, space):
    rng, truth, _ = small(direction=direction)
    points = observe(truth, rng, 1e-9)
    values = intrinsics_of(truth.cameras[0])
    values[:4] += [40.0, 1e-3, 5.0, -5.0]
    values[5:] = 0.0
    start = disturbed(truth, rng)
    camera = camera_with_intrinsics(truth.cameras[0], values)
    near = np.concatenate([truth.points_m[:4], start.points_m[4:]])
    start = BundleState.from_poses([camera], truth_poses(start), near)
    free = tuple(name for name in FREE if name != "skew")
    problem = BundleProblem(points, (CameraModel("c", free, residual=space),), fixed=("t0", "t1", "t2", "t3"))
    result = adjust(problem, start)
    assert result.converged, result.reason
    np.testing.assert_allclose(result.state.points_m, truth.points_m, atol=1e-8)
    found, wanted = (intrinsics_of(one) for one in (result.state.cameras[0], truth.cameras[0]))
    np.testing.assert_allclose(found[:5], wanted[:5], atol=1e-5)
    np.testing.assert_allclose(found[5:], wanted[5:], atol=1e-7)


CASES = {
    "free": {},
    "minimal": {"datum": Datum(DatumKind.MINIMAL, ("t0", "t5", "t9"))},
    "chosen": {"datum": Datum(targets=("t0", "t5", "t9", "t12"))},
    "scale bars": {"constraints": ("bar", "bar 2")},
    "mixed": {"constraints": ("bar", "plane", "z", "control"), "fixed": ("t9",)},
    "fixed": {"fixed": ("t1", "t2", "t3")},
    "photos": {"datum": Datum(DatumKind.PHOTOS, photos=("photo2", "photo5"))},
    "photo and bar": {"datum": Datum(DatumKind.PHOTOS, photos=("photo3",)), "constraints": ("bar",)},
}


def problem_of(case, truth, points):
    known = {
        "bar": Distance("t0", "t1", distance_of(truth, 0, 1), 1e-4),
        "bar 2": Distance("t0", "t4", distance_of(truth, 0, 4), 1e-4),
        "plane": CommonPlane(("t0", "t1", "t2", "t3", "t4"), 50.0),
        "z": Coordinate("t7", "z", 0.0, 1.0),
        "control": ControlPoint("t8", truth.points_m[8], np.diag([1e-4, 2e-4, 3e-4])),
    }
    constraints = tuple(known[name] for name in CASES[case].get("constraints", ()))
    rest = {name: value for name, value in CASES[case].items() if name != "constraints"}
    camera = CameraModel("c", FREE[:4] + ("k1", "k2"), priors=(Prior("k2", 0.08, 0.01),))
    return BundleProblem(points, (camera,), constraints=constraints, **rest)


@pytest.mark.parametrize("loss", [None, Huber(2.0)], ids=["squares", "huber"])
@pytest.mark.parametrize("case", CASES)
def test_joint_covariance_is_that_of_the_dense_problem(case, loss):
    _, truth, points = small()
    problem = problem_of(case, truth, points)
    options = BundleOptions() if loss is None else BundleOptions(loss=loss)
    result = adjust(problem, truth, options=options)
    assert result.converged, result.reason
    layout, model = result.system.layout, result.rows.model
    jacobian = dense_jacobian(model, result.state)
    image = slice(0, 2 * points.n)
    # Roots of the constant weight that the loss leaves, seen in the system's own rows.
    jacobian[image] *= result.system.rows[0].residuals[0, 0] / result.rows.rows[0].residuals[0, 0]
    movements = similarity_movements(result.state)
    generators = np.zeros((layout.n, 7))
    for photo in range(8):
        generators[6 * photo : 6 * photo + 6] = movements.poses[photo]
    for target in range(30):
        for k in range(7):
            put(generators[:, k], layout, target, movements.points[target, :, k])
    scale = np.linalg.norm(jacobian, axis=0)
    # What neither image points nor constraints nor fixed targets see of the seven movements.
    fixed = movements.points[problem.target_indices(problem.fixed)].reshape(-1, 7)
    _, singular, right = np.linalg.svd(np.concatenate([jacobian @ generators / 1e4, fixed]))
    free = right[np.count_nonzero(singular > 1e-7) :].T
    generators = generators @ free
    assert free.shape[1] == result.system.movements.count
    assert np.abs(jacobian @ generators).max(initial=0) < 1e-6
    columns = np.zeros_like(generators)
    if free.shape[1] and problem.datum.kind is DatumKind.INNER:
        chosen = [int(name[1:]) for name in problem.datum.targets or points.targets]
        for target in chosen:
            for k in range(free.shape[1]):
                put(columns[:, k], layout, target, (movements.points[target] @ free)[:, k])
    elif problem.datum.kind is DatumKind.PHOTOS:
        assert f"{problem.datum.photos[0]} (position and rotation)" in result.datum
        first = 6 * int(problem.datum.photos[0][5:])
        columns[first : first + 6, :6] = np.eye(6)
        if free.shape[1] == 7:
            axis = result.datum.split("shift ")[1][0]
            columns[6 * int(problem.datum.photos[1][5:]) + 3 + "xyz".index(axis), 6] = 1.0
    elif free.shape[1]:
        held = result.datum.split(": ")[1].removesuffix(" held").split(", ")
        for k, text in enumerate(held):
            put(columns[:, k], layout, int(text.split("t")[1]), np.eye(3)["xyz".index(text[0])])
    normal = jacobian.T @ jacobian / scale[:, None] / scale
    border = columns / scale[:, None]
    size = border.shape[1]
    bordered = np.block([[normal, border], [border.T, np.zeros((size, size))]])
    cofactor = np.linalg.inv(bordered)[: layout.n, : layout.n] / scale[:, None] / scale
    if problem.datum.kind is DatumKind.PHOTOS:
        # The inverse has rounding there, which depends on the processor.
        held = (columns != 0).any(axis=1)
        assert np.abs(cofactor[held]).max() < 1e-15 * np.abs(cofactor).max()
        cofactor[held], cofactor[:, held] = 0.0, 0.0
    share = float(
        np.trace(result.covariance.intrinsics) / np.trace(cofactor[np.ix_(*[layout.intrinsic_columns[0]] * 2)])
    )
    if loss is None:
        assert share == pytest.approx(1.0, abs=1e-6)
        share = 1.0
    targets = [i for i in range(30) if f"t{i}" not in problem.fixed]
    places = []
    for target in targets:
        row = np.zeros(layout.n)
        put(row, layout, target, [1, 2, 3])
        places += [int(np.argmax(row == k)) for k in (1, 2, 3)]
    places += list(range(48)) + list(layout.intrinsic_columns[0])
    joint = result.covariance.joint(targets, np.arange(8), intrinsics=True)
    if loss is None:
        wanted = cofactor[np.ix_(places, places)]
        sigma = np.maximum(np.sqrt(np.maximum(np.diag(wanted), 0)), 1e-9)
        np.testing.assert_allclose(joint / sigma[:, None] / sigma, wanted / sigma[:, None] / sigma, atol=1e-4)
    for place, target in enumerate(targets):
        block = joint[3 * place : 3 * place + 3, 3 * place : 3 * place + 3]
        np.testing.assert_allclose(result.covariance.points[target], block, atol=1e-9 * np.abs(block).max() + 1e-20)
    for photo in range(8):
        first = 3 * len(targets) + 6 * photo
        block = joint[first : first + 6, first : first + 6]
        np.testing.assert_allclose(result.covariance.poses[photo], block, atol=1e-9 * np.abs(block).max())
    assert (result.covariance.points[problem.target_indices(problem.fixed)] == 0).all()


def test_priors_and_weighted_control_are_observations():
    _, truth, points = small()
    held = adjust(BundleProblem(points, (CameraModel("c", ("center_x_px",)),)), truth)
    tight = CameraModel("c", ("center_x_px", "focal_px"), priors=(Prior("focal_px", 6103.0, 1e-6),))
    prior = adjust(BundleProblem(points, (tight,)), truth)
    assert prior.redundancy == held.redundancy
    np.testing.assert_allclose(prior.state.points_m, held.state.points_m, atol=1e-8)
    covariance = np.zeros((10, 10))
    covariance[0, 0] = 1e-12
    joint = adjust(
        BundleProblem(
            points, (CameraModel("c", ("center_x_px", "focal_px"), prior_covariance=covariance + 1e-30 * np.eye(10)),)
        ),
        truth,
    )
    assert abs(intrinsics_of(joint.state.cameras[0])[0] - 6103.0) < 1e-4
    control = tuple(ControlPoint(f"t{i}", truth.points_m[i], np.eye(3) * 1e-18) for i in range(4))
    weighted = adjust(BundleProblem(points, (CameraModel("c"),), constraints=control), truth)
    fixed = adjust(BundleProblem(points, (CameraModel("c"),), fixed=("t0", "t1", "t2", "t3")), truth)
    np.testing.assert_allclose(weighted.state.points_m, fixed.state.points_m, atol=1e-8)
    np.testing.assert_allclose(weighted.sigma_points_m[4:], fixed.sigma_points_m[4:], rtol=1e-4)
    assert weighted.redundancy == fixed.redundancy


def test_two_cameras_each_with_its_own_lens():
    rng, truth, _ = small()
    values = intrinsics_of(truth.cameras[0])
    values[[0, 5]] = [5000.0, 0.05]
    other = camera_with_intrinsics(truth.cameras[0], values)
    first = observe(truth, rng, 0.01)
    second = observe(BundleState.from_poses([other], truth_poses(truth), truth.points_m), rng, 0.01)
    odd_first, odd_second = first.photo_index % 2 == 1, second.photo_index % 2 == 1
    points = type(first)(
        first.photos,
        first.targets,
        np.concatenate([first.photo_index[~odd_first], second.photo_index[odd_second]]),
        np.concatenate([first.target_index[~odd_first], second.target_index[odd_second]]),
        np.concatenate([first.pixels_px[~odd_first], second.pixels_px[odd_second]]),
        np.concatenate([first.covariance_px2[~odd_first], second.covariance_px2[odd_second]]),
    )
    models = (CameraModel("a", ("focal_px", "k1")), CameraModel("b", ("k1", "focal_px")))
    start = BundleState.from_poses([truth.cameras[0], truth.cameras[0]], truth_poses(truth), truth.points_m)
    result = adjust(BundleProblem(points, models, np.arange(8) % 2), start)
    assert result.converged
    for camera, wanted in zip(result.cameras, (truth.cameras[0], other), strict=True):
        sigma = np.sqrt(camera.covariance[[1, 5], [1, 5]])
        assert (np.abs(camera.parameters - wanted.parameters)[[1, 5]] < 5 * sigma).all()
        assert (sigma > 0).all()
        assert sigma[0] < 1.0


def truth_poses(truth):
    return [truth.cam_from_world(i) for i in range(len(truth.rotations))]


@pytest.mark.parametrize("n_photos", [1, 2])
def test_poses_alone_to_known_targets(n_photos):
    # Nothing but poses is unknown: no target is, and no part of the camera.
    rng = np.random.default_rng(4)
    truth, points = network(rng, n_photos, 30)
    names = tuple(f"t{i}" for i in range(30))
    start = disturbed(truth, rng)
    start = type(start)(start.cameras, start.rotations, start.translations_m, truth.points_m)
    result = adjust(BundleProblem(points, (CameraModel("c"),), fixed=names), start)
    assert result.converged, result.reason
    assert result.redundancy == 2 * points.n - 6 * n_photos
    np.testing.assert_allclose(result.state.centers_m, truth.centers_m, atol=2e-3)


def test_residuals_are_in_the_order_of_the_observations():
    rng, truth, points = small()
    shuffled = points.subset(rng.permutation(points.n))
    result = adjust(BundleProblem(shuffled, (CameraModel("c"),)), truth)
    for row in (0, 7, points.n - 1):
        photo, target = shuffled.photo_index[row], shuffled.target_index[row]
        point = result.state.cam_from_world(photo).apply(result.state.points_m[target])
        wanted = result.state.cameras[0].project(point) - shuffled.pixels_px[row]
        np.testing.assert_allclose(result.residuals_px[row], wanted, atol=1e-9)
    assert result.variance_factor * result.redundancy == pytest.approx((result.whitened_residuals**2).sum())


def test_loose_start_is_refused_by_name_and_missing_convergence_is_told():
    _, truth, points = small()
    moved = truth.points_m.copy()
    moved[3] = truth.centers_m[2] + [0, 0, 5.0]
    behind = BundleState.from_poses(truth.cameras, truth_poses(truth), moved)
    with pytest.raises(EstimationError, match="target t3 in photo photo"):
        adjust(BundleProblem(points, (CameraModel("c"),)), behind)
    with pytest.raises(InputError, match="not of 1, 9 and 30"):
        adjust(
            BundleProblem(points, (CameraModel("c"),)),
            BundleState.from_poses(truth.cameras, [*truth_poses(truth)] + truth_poses(truth)[:1], truth.points_m),
        )


def test_a_posteriori_scale_and_robust_loss():
    rng, truth, points = small()
    doubled = type(points)(*(getattr(points, n) for n in points.__slots__[:5]), points.covariance_px2 / 4)
    problem = BundleProblem(doubled, (CameraModel("c"),))
    result = adjust(problem, truth, options=BundleOptions(covariance_scale=CovarianceScale.POSTERIOR))
    believed = adjust(problem, truth)
    assert result.sigma0 == pytest.approx(2.0, rel=0.1)
    np.testing.assert_allclose(result.sigma_points_m, believed.sigma_points_m * result.sigma0)
    assert believed.variance_factor_probability() < 1e-6
    pixels = points.pixels_px.copy()
    bad = rng.choice(points.n, 5, replace=False)
    pixels[bad] += 50.0
    spoiled = type(points)(*(getattr(points, n) for n in points.__slots__[:4]), pixels, points.covariance_px2)
    robust = adjust(BundleProblem(spoiled, (CameraModel("c"),)), truth, options=BundleOptions(loss=Cauchy()))
    clean = adjust(BundleProblem(points, (CameraModel("c"),)), truth)
    difference = robust.state.points_m - clean.state.points_m
    assert (np.abs(difference) < 2 * clean.sigma_points_m).mean() > 0.9
    assert (np.sort(np.argsort(-np.linalg.norm(robust.residuals_px, axis=1))[:5]) == np.sort(bad)).all()


def test_names_are_checked():
    _, _, points = small()
    with pytest.raises(InputError, match="nobody"):
        BundleProblem(points, (CameraModel("c"),), fixed=("nobody",))
    with pytest.raises(InputError, match="focal"):
        CameraModel("c", ("focus",))
    with pytest.raises(InputError, match="not free"):
        CameraModel("c", ("k1",), priors=(Prior("k2", 0, 1),))
    assert INTRINSIC_NAMES[0] == "focal_px"
