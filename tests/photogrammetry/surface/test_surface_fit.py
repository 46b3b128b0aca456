"""Points to the best fit of a design: closed forms, an independent route, honesty, symmetries, outliers, refusals."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform, vector_from_rotation
from heliogauge.geometry.surfaces import paraboloid, paraboloid_xy, plane, quadric, sphere, trough
from photogrammetry.surface.design import CompositeDesign, motion_words
from photogrammetry.surface.fit import fit_surface
from photogrammetry.surface.fitted import FitChoices, SurfacePoints
from photogrammetry.surface.start import find_start
from tests.derivatives import central_differences, check_jacobian
from tests.photogrammetry.surfaces_synthetic import (
    WORLD_FROM_DESIGN,
    correlated,
    design,
    drawn,
    grid_xy,
    on_surface,
)

DESIGNS = [
    design(plane),
    design(sphere, 8.0),
    design(paraboloid, 4.0),
    design(paraboloid_xy, 4.0, 6.0),
    design(trough, 3.0),
]


def test_distances_of_a_sphere_are_closed_form() -> None:
    points = np.random.default_rng(0).uniform(-2, 2, (50, 3)) + [0, 0, 1]
    feet = design(sphere, 8.0).feet(points)
    arms = points - [0, 0, 8]
    length = np.linalg.norm(arms, axis=1)
    np.testing.assert_allclose(feet.distance_m, 8 - length, atol=1e-14)
    np.testing.assert_allclose(feet.normals, -arms / length[:, None], atol=1e-14)
    # A sphere through the origin of radius R: d = R - |x - R z|, so dd/dR = 1 - (R - z) / |...|, and R = 1 / c.
    expected = -(8.0**2) * (1 - (8 - points[:, 2]) / length)
    np.testing.assert_allclose(feet.d_distance_d_curvature[:, 0], expected, atol=1e-12)


@pytest.mark.parametrize("surface", DESIGNS, ids=lambda one: one.quadric.name)
def test_feet_are_on_the_surface_below_their_points(surface) -> None:
    points = np.random.default_rng(1).uniform(-1, 1, (40, 3))
    feet = surface.feet(points)
    foot = points - feet.distance_m[:, None] * feet.normals
    np.testing.assert_allclose(foot[:, 2], surface.quadric.height(foot[:, 0], foot[:, 1]), atol=1e-13)
    np.testing.assert_allclose(feet.normals, surface.quadric.normal(foot[:, 0], foot[:, 1]), atol=1e-12)


@pytest.mark.parametrize("surface", DESIGNS[1:], ids=lambda one: one.quadric.name)
def test_derivative_by_curvature(surface) -> None:
    points = on_surface(surface, grid_xy(3)) + 0.01

    def distances(curvatures):
        return surface.with_curvatures(curvatures).feet(points).distance_m

    start = np.array(surface.curvatures_per_m)
    numeric = central_differences(distances, start, np.add, np.full(start.size, 1e-3))
    check_jacobian(surface.feet(points).d_distance_d_curvature, numeric, structural_zeros=False)


@pytest.mark.parametrize(
    ("surface", "words"),
    [
        (design(plane), {"rotation about z", "shift along x", "shift along y"}),
        (design(paraboloid, 4.0), {"rotation about z"}),
        (design(paraboloid_xy, 4.0, 6.0), set()),
        (design(trough, 3.0), {"shift along y"}),
        (
            design(sphere, 8.0),
            {"rotation about x through (0, 0, 8) m", "rotation about y through (0, 0, 8) m", "rotation about z"},
        ),
    ],
    ids=lambda one: getattr(getattr(one, "quadric", None), "name", ""),
)
def test_symmetries_are_found_from_the_surface_itself(surface, words) -> None:
    found = {text.replace("-0,", "0,") for text in motion_words(surface.symmetries())}
    assert found == words
    moved = surface.transformed(WORLD_FROM_DESIGN)
    assert moved.symmetries().shape == surface.symmetries().shape


@pytest.mark.parametrize("surface", DESIGNS, ids=lambda one: one.quadric.name)
def test_exact_points_are_fitted_exactly_from_an_unknown_attitude(surface) -> None:
    points = WORLD_FROM_DESIGN.apply(on_surface(surface, grid_xy(6)))
    start = find_start(points, surface, WORLD_FROM_DESIGN.apply([0.3, 0.2, 6.0]))
    fit = fit_surface(
        SurfacePoints(tuple(map(str, range(36))), points, 1e-10 * np.eye(108)), surface, start.design_from_world
    )
    assert np.abs(fit.deviation_m).max() < 1e-9
    # +z points to the cameras, whatever the in-plane attitude.
    assert fit.design_from_world.apply(WORLD_FROM_DESIGN.apply([0, 0, 6.0]))[2] > 0


def test_weighted_fit_agrees_with_scipy() -> None:
    surface, rng = design(paraboloid_xy, 4.0, 6.0), np.random.default_rng(3)
    truth = WORLD_FROM_DESIGN.apply(on_surface(surface, grid_xy(6)))
    sigma = np.repeat(rng.uniform(1e-5, 4e-5, 36), 3)
    points = drawn(truth, np.diag(sigma), rng)
    fit = fit_surface(points, surface, WORLD_FROM_DESIGN.inverse(), FitChoices(curvature=True, robust=False))

    def residuals(values):
        # Foot points as unknowns beside the pose: nothing is shared with the fit under test.
        pose, lengths, feet = values[:6], values[6:8], values[8:].reshape(-1, 2)
        z = feet[:, 0] ** 2 / (4 * lengths[0]) + feet[:, 1] ** 2 / (4 * lengths[1])
        rotation = RigidTransform.from_rotation_vector(pose[:3], pose[3:])
        return ((points.points_m - rotation.apply(np.column_stack([feet, z]))).ravel()) / weights

    weights = np.sqrt(sigma**2 + fit.shape_sigma_m**2)
    start = np.concatenate(
        [WORLD_FROM_DESIGN.rotation_vector_rad, WORLD_FROM_DESIGN.translation_m, [4.0, 6.0], grid_xy(6).ravel()]
    )
    found = least_squares(residuals, start, xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac").x
    lengths = fit.parameters.lengths()
    sigmas = {name: values[1] for name, values in lengths.items()}
    for k, name in enumerate(("length_0_m", "length_1_m")):
        assert abs(lengths[name][0] - found[6 + k]) < 0.01 * sigmas[name]
    other = RigidTransform.from_rotation_vector(found[:3], found[3:6]).inverse()
    sigma_pose = np.sqrt(np.diag(fit.parameters.covariance)[:6])
    step = vector_from_rotation(fit.design_from_world.rotation @ other.rotation.T)
    assert (np.abs(step) < 0.02 * sigma_pose[:3]).all()


@pytest.mark.slow
@pytest.mark.parametrize("inner", [False, True], ids=["full covariance", "inner datum"])
def test_sigmas_are_the_scatter(inner: bool) -> None:
    surface, rng = design(paraboloid, 4.0), np.random.default_rng(4)
    own = on_surface(surface, grid_xy(6))
    truth = WORLD_FROM_DESIGN.apply(own)
    root = correlated(truth, 1e-4, rng, inner=inner)
    inverse = WORLD_FROM_DESIGN.inverse()
    ratios: dict[str, list] = {"deviation": [], "point": [], "curvature": [], "pose": [], "variance factor": []}
    for _ in range(60):
        fit = fit_surface(drawn(truth, root, rng), surface, inverse, FitChoices(curvature=True, robust=False))
        sigma = np.sqrt(np.diag(fit.parameters.covariance_measurement))
        pose = fit.design_from_world
        step = np.append(
            vector_from_rotation(pose.rotation @ inverse.rotation.T)[:2], pose.translation_m - inverse.translation_m
        )
        ratios["deviation"].append(fit.deviation_m / fit.sigma_deviation_m)
        ratios["point"].append((fit.points.points_m - own) / fit.points.sigma_m)
        ratios["curvature"].append((fit.parameters.curvatures_per_m[0] - 0.25) / sigma[6])
        ratios["pose"].append(step / sigma[[0, 1, 3, 4, 5]])
        ratios["variance factor"].append(np.sqrt(fit.variance_factor))
    for name, values in ratios.items():
        assert np.sqrt(np.mean(np.square(values))) == pytest.approx(1, abs=0.28 if name == "curvature" else 0.13), name


def test_roughness_is_estimated_and_frees_the_fit_from_the_weights() -> None:
    surface, rng = design(plane), np.random.default_rng(5)
    xy = grid_xy(10)
    rough = 2e-4 * rng.standard_normal(100)
    truth = on_surface(surface, xy, lambda x, y: rough)
    sigma = np.repeat(np.where(np.arange(100) < 3, 1e-7, 1e-5), 3)
    fit = fit_surface(drawn(truth, np.diag(sigma), rng), surface, RigidTransform.identity(), FitChoices(robust=False))
    assert fit.shape_sigma_m == pytest.approx(2e-4, rel=0.25)
    assert fit.variance_factor > 100
    # Three points measured 100 times better must not pull the plane through themselves.
    design_matrix = np.column_stack([np.ones(100), xy])
    plain = rough - design_matrix @ np.linalg.lstsq(design_matrix, rough, rcond=None)[0]
    np.testing.assert_allclose(fit.deviation_m, plain, atol=3e-5)
    # Without roughness as a weight they would.
    assert np.abs(fit.deviation_m[:3]).max() > 1e-5


def test_outliers_are_left_out_and_named_by_their_test() -> None:
    surface, rng = design(paraboloid, 4.0), np.random.default_rng(6)
    own = on_surface(surface, grid_xy(7))
    own[[3, 20, 41], 2] += [0.004, -0.02, 0.3]
    points = drawn(WORLD_FROM_DESIGN.apply(own), 1e-5 * np.eye(147), rng)
    fit = fit_surface(points, surface, WORLD_FROM_DESIGN.inverse())
    assert np.flatnonzero(fit.outliers).tolist() == [3, 20, 41]
    assert np.abs(fit.tests[fit.outliers]).min() > 50
    assert fit.rms_deviation_m < 2e-5
    assert fit.deviation_m[20] == pytest.approx(-0.02, rel=0.05)
    plain = fit_surface(points, surface, WORLD_FROM_DESIGN.inverse(), FitChoices(robust=False))
    assert not plain.outliers.any()
    assert plain.rms_deviation_m > 1e-2


def test_held_frame_measures_the_offset_itself() -> None:
    surface = design(plane)
    points = on_surface(surface, grid_xy(4)) + [0, 0, 0.003]
    given = SurfacePoints(tuple(map(str, range(16))), points, 1e-10 * np.eye(48))
    fit = fit_surface(given, surface, RigidTransform.identity(), FitChoices(pose=False))
    np.testing.assert_allclose(fit.deviation_m, 0.003, atol=1e-15)
    np.testing.assert_allclose(fit.sigma_deviation_m, 1e-5, rtol=1e-9)
    assert fit.held == ()


def test_composite_measures_each_facet_from_its_own_surface() -> None:
    low, high = design(plane), design(plane).transformed(RigidTransform(np.eye(3), np.array([0, 0, 0.5])))
    which = np.array([0, 0, 1, 1])
    both = CompositeDesign((low, high), which)
    points = np.array([[0, 0, 0.1], [1, 0, 0.0], [0, 1, 0.4], [1, 1, 0.7]])
    np.testing.assert_allclose(both.feet(points).distance_m, [0.1, 0, -0.1, 0.2], atol=1e-15)
    assert both.symmetries().shape == (6, 3)


PLAIN, FREE = FitChoices(robust=False), FitChoices(curvature=True)
LINE = np.column_stack([np.arange(9.0), np.zeros(9)])


@pytest.mark.parametrize(
    ("xy", "surface", "choices", "error", "words"),
    [
        (LINE, design(plane), PLAIN, EstimationError, "one line"),
        (grid_xy(2)[:2], design(plane), PLAIN, EstimationError, "too few for 3 unknowns"),
        (grid_xy(3), design(plane), FREE, InputError, "no focal length"),
        (grid_xy(3), design(lambda: quadric([0.1, 0.1, 0, 0, 0, 0])), FREE, InputError, "no focal length"),
    ],
)
def test_what_is_not_determined_is_refused(xy, surface, choices, error, words) -> None:
    points = on_surface(surface, xy)
    count = len(points)
    with pytest.raises(error, match=words):
        fit_surface(
            SurfacePoints(tuple(map(str, range(count))), points, 1e-8 * np.eye(3 * count)),
            surface,
            RigidTransform.identity(),
            choices,
        )


def test_start_says_when_the_orientation_is_open() -> None:
    surface = design(trough, 3.0)
    turned = RigidTransform.from_rotation_vector([0, 0, 0.7], [3.0, 0, 1.0]) @ WORLD_FROM_DESIGN
    points = turned.apply(on_surface(surface, grid_xy(6)))
    start = find_start(points, surface, turned.apply([0, 0, 5.0]))
    assert "reference" in start.open_words or "network" in start.how
    with pytest.raises(EstimationError, match="4 or more"):
        find_start(points[:3], surface, turned.apply([0, 0, 5.0]))


def test_shallow_bowl_keeps_its_place_where_it_cannot_be_felt() -> None:
    surface, rng = design(paraboloid, 50.0), np.random.default_rng(9)
    points = drawn(on_surface(surface, grid_xy(6)), 5e-5 * np.eye(108), rng)
    fit = fit_surface(points, surface, RigidTransform.identity())
    # Turns about the centre of curvature slide the bowl along itself: two of them beside its own symmetry.
    assert len(fit.held) == 3
    assert np.abs(fit.points.points_m[:, :2] - points.points_m[:, :2]).max() < 1e-3
    deep = fit_surface(
        drawn(on_surface(design(paraboloid, 2.0), grid_xy(6)), 5e-5 * np.eye(108), rng),
        design(paraboloid, 2.0),
        RigidTransform.identity(),
    )
    assert deep.held == ("rotation about z",)
