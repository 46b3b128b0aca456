"""Slopes against surfaces given by formulas, traced by another route."""

import numpy as np
import pytest

from deflectometry.setup.camera_and_screen import Setup
from deflectometry.shape.common_modes import PixelSamples, trace_samples
from deflectometry.shape.smooth_shape import (
    FacetSamples,
    RoundLimits,
    derivative_coefficients,
    gradient_terms,
    polynomial,
    slope_sensitivity,
    slopes_at,
    solve_shape,
)
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet, paraboloid, plane, sphere, trough
from heliogauge.slopes.map import monomials
from tests.deflectometry.mirror_trace import trace_pixels

SQUARE = np.array([[-0.6, -0.6], [0.6, -0.6], [0.6, 0.6], [-0.6, 0.6]])


def dish(focal_length_m, ripple=0.0):
    """Return height and gradient of a paraboloid with a ripple of known slope amplitude."""

    def height(x, y):
        return (x**2 + y**2) / (4 * focal_length_m) + ripple / 9.0 * np.sin(9 * x) * np.cos(5 * y)

    def gradient(x, y):
        return (
            x / (2 * focal_length_m) + ripple * np.cos(9 * x) * np.cos(5 * y),
            y / (2 * focal_length_m) - ripple * 5 / 9 * np.sin(9 * x) * np.sin(5 * y),
        )

    return height, gradient


def gutter(focal_length_m):
    def height(x, y):
        return x**2 / (4 * focal_length_m) + 0 * y

    def gradient(x, y):
        return x / (2 * focal_length_m), 0 * y

    return height, gradient


def ball(radius_m):
    def height(x, y):
        return radius_m - np.sqrt(radius_m**2 - x**2 - y**2)

    def gradient(x, y):
        root = np.sqrt(radius_m**2 - x**2 - y**2)
        return x / root, y / root

    return height, gradient


def observe(setup: Setup, facet: Facet, cam_from_facet: RigidTransform, surface, n=900):
    """Trace pixels spread over the facet; return samples, true positions and true slopes."""
    height, gradient = surface
    low, high = facet.outline_m.min(axis=0), facet.outline_m.max(axis=0)
    side = int(np.sqrt(n))
    x, y = (
        grid.ravel() for grid in np.meshgrid(np.linspace(low[0], high[0], side), np.linspace(low[1], high[1], side))
    )
    pixels = setup.camera.project(cam_from_facet.apply(np.stack([x, y, height(x, y)], axis=1)))
    u, v, x, y = trace_pixels(setup, pixels, cam_from_facet, height, gradient)
    samples = trace_samples(setup, [PixelSamples(facet, pixels, u, v)])
    return samples, np.stack([x, y]), np.stack(gradient(x, y))


def slopes_of(samples, solution, index=0):
    sample, surface = samples[index], solution.surfaces[index]
    facet_from_cam = (solution.cam_from_mirror @ sample.facet.ensemble_from_facet).inverse()
    camera = facet_from_cam.translation_m
    points = surface.intersect(camera, facet_from_cam.rotation @ sample.rays_cam)
    screen = facet_from_cam.rotation @ sample.screen_cam_m + camera[:, None]
    return points, np.stack(slopes_at(points, camera, screen))


CASES = {
    "flat": (plane(), dish(np.inf), SQUARE),
    "f = 100 m": (paraboloid(100.0), dish(100.0), SQUARE),
    "0.5 m off axis, f = 10 m": (paraboloid(10.0), dish(10.0), SQUARE * 0.5 + [0.5, 0.0]),
    "0.25 m off axis, f = 20 m": (paraboloid(20.0), dish(20.0), SQUARE * 0.5 + [0.0, 0.25]),
    "panel of a trough": (trough(5.0), gutter(5.0), SQUARE * 0.3 + [0.8, 0.0]),
    "sphere": (sphere(30.0), ball(30.0), SQUARE),
}


@pytest.mark.parametrize("name", CASES)
def test_slopes_of_a_perfect_mirror_have_no_bias(laboratory, cam_from_mirror, name):
    design, surface, outline = CASES[name]
    # A frame turned so that the facet's centre, and not its vertex, faces camera and wall.
    facet = Facet(name, outline, design)
    x, y = facet.reference_point_m
    slope = [float(s) for s in design.gradient(x, y)]
    turn = RigidTransform.from_rotation_vector([-slope[1], slope[0], 0.0], [0.0, 0.0, 0.0]).inverse()
    pose = cam_from_mirror @ turn
    samples, _, true_slope = observe(laboratory, facet, pose, surface)
    solution = solve_shape(samples, pose, align=True)
    _, slope = slopes_of(samples, solution)
    assert np.abs(slope - true_slope).max() < 1e-8
    assert np.abs(solution.tilt_rad).max() < 1e-8
    assert np.allclose(solution.cam_from_mirror.rotation, pose.rotation, atol=1e-8)


@pytest.mark.parametrize("name", CASES)
def test_alignment_finds_the_tilt_that_the_outline_missed(laboratory, cam_from_mirror, name):
    design, surface, outline = CASES[name]
    facet = Facet(name, outline, design)
    samples, _, _ = observe(laboratory, facet, cam_from_mirror, surface)
    x, y = facet.reference_point_m
    pivot = np.array([x, y, float(design.height(x, y))])
    wrong = RigidTransform.from_rotation_vector([0.02, -0.03, 0.0], [0.0, 0.0, 0.0])
    wrong_pose = cam_from_mirror @ RigidTransform(wrong.rotation, pivot - wrong.rotation @ pivot)
    solution = solve_shape(samples, wrong_pose, align=True)
    # Only the direction of the normal is found: a turn about it stays as the outline had it.
    normal = design.normal(x, y)
    assert np.allclose(solution.cam_from_mirror.rotate(normal), cam_from_mirror.rotate(normal), atol=2e-6)


def test_start_shape_does_not_matter(laboratory, cam_from_mirror):
    results = []
    samples, _, true_slope = observe(laboratory, Facet("dish", SQUARE, plane()), cam_from_mirror, dish(10.0))
    for design in (plane(), sphere(25.0), paraboloid(12.0), trough(10.0)):
        moved = [FacetSamples(Facet("dish", SQUARE, design), samples[0].rays_cam, samples[0].screen_cam_m)]
        solution = solve_shape(moved, cam_from_mirror, align=False)
        results.append(slopes_of(moved, solution)[1])
    for result in results:
        assert np.abs(result - true_slope).max() < 2e-9


def test_ripple_is_recovered(laboratory, cam_from_mirror):
    surface = dish(100.0, ripple=1e-3)
    samples, _, true_slope = observe(laboratory, Facet("rippled", SQUARE, paraboloid(100.0)), cam_from_mirror, surface)
    solution = solve_shape(samples, cam_from_mirror, align=False)
    _, slope = slopes_of(samples, solution)
    # A ripple of 1 mrad is 0.1 mm high; the polynomial of degree 4 takes part of it, the rest moves no slope by 3 urad.
    assert np.abs(slope - true_slope).max() < 3e-6


def test_tilted_mirror_gives_positive_slope_for_a_normal_turned_to_minus_x(laboratory, cam_from_mirror):
    """A plane with dz/dx = +1 mrad has its normal turned towards -x by 1 mrad: the sign is the slope's."""
    tilted = (lambda x, y: 1e-3 * x + 0 * y, lambda x, y: (1e-3 + 0 * x, 0 * y))
    samples, _, _ = observe(laboratory, Facet("flat", SQUARE, plane()), cam_from_mirror, tilted)
    solution = solve_shape(samples, cam_from_mirror, align=False)
    assert solution.tilt_rad[0] == pytest.approx([1e-3, 0.0], abs=1e-9)


def test_ensemble_keeps_the_canting_of_its_facets(laboratory, cam_from_mirror):
    """One facet is canted by 2 mrad against its design; alignment takes out the mean, half of it, and no more."""
    canting = 2e-3
    places = [RigidTransform(np.eye(3), np.array([offset, 0.0, 0.0])) for offset in (-0.35, 0.35)]
    outline = SQUARE * 0.5
    samples = []
    for place, tilt in zip(places, (0.0, canting), strict=True):
        facet = Facet("half", outline, plane(), place)
        surface = (lambda x, y, t=tilt: t * x, lambda x, y, t=tilt: (t + 0 * x, 0 * y))
        samples += observe(laboratory, facet, cam_from_mirror @ place, surface)[0]
    solution = solve_shape(samples, cam_from_mirror, align=True)
    assert solution.tilt_rad[:, 0] == pytest.approx([-canting / 2, canting / 2], abs=1e-6)


def test_rounds_that_do_not_settle_are_an_error(laboratory, cam_from_mirror):
    samples, _, _ = observe(laboratory, Facet("dish", SQUARE, plane()), cam_from_mirror, dish(10.0))
    with pytest.raises(EstimationError, match="after 1 rounds"):
        solve_shape(samples, cam_from_mirror, align=True, rounds=RoundLimits(outer=1))


def test_sensitivity_is_the_derivative(laboratory, cam_from_mirror):
    samples, _, _ = observe(laboratory, Facet("dish", SQUARE, paraboloid(50.0)), cam_from_mirror, dish(50.0))
    solution = solve_shape(samples, cam_from_mirror, align=False)
    points, _ = slopes_of(samples, solution)
    facet_from_cam = cam_from_mirror.inverse()
    camera = facet_from_cam.translation_m
    screen = facet_from_cam.rotation @ samples[0].screen_cam_m + camera[:, None]
    for direction in np.eye(3):
        step = 1e-4 * direction
        ahead = np.stack(slopes_at(points, camera, screen + step[:, None]))
        behind = np.stack(slopes_at(points, camera, screen - step[:, None]))
        expected = slope_sensitivity(points, camera, screen, step)
        assert np.allclose(0.5 * (ahead - behind), expected, rtol=1e-6, atol=1e-13)


def test_polynomial_and_its_derivatives_agree_with_monomials():
    rng = np.random.default_rng(3)
    coefficients, u, v = rng.normal(size=15), rng.uniform(-1, 1, 50), rng.uniform(-1, 1, 50)
    terms = monomials(u, v, 4)
    assert np.allclose(polynomial(coefficients, u, v), coefficients @ terms, atol=1e-14)
    along_u, along_v = derivative_coefficients(coefficients)
    by_terms = np.einsum("i,aik->ak", coefficients[1:], gradient_terms(u, v, 4))
    assert np.allclose([polynomial(along_u, u, v), polynomial(along_v, u, v)], by_terms, atol=1e-13)
    step = 1e-6
    central = (polynomial(coefficients, u + step, v) - polynomial(coefficients, u - step, v)) / (2 * step)
    assert np.allclose(central, by_terms[0], atol=1e-8)
