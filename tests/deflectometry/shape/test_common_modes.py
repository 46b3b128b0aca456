"""The common share of the uncertainty: is what it says the scatter of slopes measured with a setup that is off?"""

from dataclasses import replace

import numpy as np
import pytest

from deflectometry.pose.pose_observations import UncertainPose
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.setup.setup_steps import principal_steps
from deflectometry.shape.common_modes import common_modes
from deflectometry.shape.facet_pixels import PixelSamples, spread_indices, trace_samples
from deflectometry.shape.smooth_shape import slopes_at, solve_shape
from heliogauge.geometry.surfaces import Facet, paraboloid
from tests.deflectometry.mirror_trace import trace_pixels

OUTLINE = np.array([[-0.6, -0.6], [0.6, -0.6], [0.6, 0.6], [-0.6, 0.6]])
FOCAL_LENGTH_M = 40.0
SIGMA_CAMERA = np.array([1.0, 1.0, 1.5, 1.5, 0.0, 2e-3, 0.0, 2e-4, 2e-4, 0.0])
SIGMA_POSE = np.diag([5e-4, 5e-4, 1e-3, 1e-3, 1e-3, 2e-3]) ** 2
# Where the map is judged: middle, middle of the sides, corners.
PROBES = np.array([[0, 0.5, -0.5, 0, 0, 0.5, -0.5], [0, 0, 0, 0.5, -0.5, 0.5, -0.5]], dtype=np.float64)


def height(x, y):
    return (x**2 + y**2) / (4 * FOCAL_LENGTH_M)


def gradient(x, y):
    return x / (2 * FOCAL_LENGTH_M), y / (2 * FOCAL_LENGTH_M)


@pytest.fixture(scope="module")
def uncertain(laboratory) -> Setup:
    return replace(laboratory, camera=laboratory.camera.with_covariance(np.diag(SIGMA_CAMERA**2)))


def pixels_of_mirror(setup, pose):
    grid = np.linspace(-0.58, 0.58, 15)
    x, y = (axis.ravel() for axis in np.meshgrid(grid, grid))
    return setup.camera.project(pose.apply(np.stack([x, y, height(x, y)], axis=1)))


def measured_errors(nominal, pose, samples, align):
    """Measure with the nominal setup; return slope errors at the probes, shape (2, n_probes), and the solution."""
    traced = trace_samples(nominal, samples)
    solution = solve_shape(traced, pose, align=align)
    facet_from_cam = solution.cam_from_mirror.inverse()
    camera = facet_from_cam.translation_m
    points = solution.surfaces[0].intersect(camera, facet_from_cam.rotation @ traced[0].rays_cam)
    screen = facet_from_cam.rotation @ traced[0].screen_cam_m + camera[:, None]
    error = np.stack(slopes_at(points, camera, screen)) - np.stack(gradient(points[0], points[1]))
    # The errors are smooth: read them at the probes from a cubic.
    terms = np.stack([points[0] ** i * points[1] ** j for i in range(4) for j in range(4 - i)])
    at = np.stack([PROBES[0] ** i * PROBES[1] ** j for i in range(4) for j in range(4 - i)])
    return (np.linalg.lstsq(terms.T, error.T, rcond=None)[0].T) @ at, solution


@pytest.mark.slow
@pytest.mark.parametrize("align", [True, False])
def test_common_sigma_is_the_scatter(uncertain, cam_from_mirror, align):
    rng = np.random.default_rng(11)
    facet = Facet("dish", OUTLINE, paraboloid(FOCAL_LENGTH_M))
    n_trials = 150
    errors = []
    for _ in range(n_trials):
        true_setup = replace(
            uncertain,
            camera=uncertain.camera.with_parameters(
                uncertain.camera.parameters + rng.normal(0.0, 1.0, 10) * SIGMA_CAMERA
            ),
            cam_from_screen=uncertain.cam_from_screen.moved(
                rng.multivariate_normal(np.zeros(6), uncertain.covariance_cam_from_screen)
            ),
        )
        true_pose = cam_from_mirror.moved(rng.multivariate_normal(np.zeros(6), SIGMA_POSE))
        pixels = pixels_of_mirror(uncertain, cam_from_mirror)
        u, v, _, _ = trace_pixels(true_setup, pixels, true_pose, height, gradient)
        samples = [PixelSamples(facet, pixels, u, v)]
        error, solution = measured_errors(uncertain, cam_from_mirror, samples, align)
        errors.append(error)
    modes = common_modes(uncertain, samples, solution, UncertainPose(cam_from_mirror, SIGMA_POSE), align=align)[
        0
    ].evaluate(*PROBES)
    predicted = np.sqrt((modes**2).sum(axis=0))
    scatter = np.sqrt(np.mean(np.square(errors), axis=0))
    # Aligned, the middle has no error left to scatter; it is compared by what is left of the largest.
    weighty = predicted > 0.1 * predicted.max()
    ratio = scatter[weighty] / predicted[weighty]
    # 99.9 % band of a standard deviation from 150 trials: 1 +- 0.19.
    assert np.all(np.abs(ratio - 1) < 0.19), ratio
    assert np.all(scatter[~weighty] < 0.2 * predicted.max())


def test_alignment_takes_the_tilt_out_of_the_uncertainty(uncertain, cam_from_mirror):
    facet = Facet("dish", OUTLINE, paraboloid(FOCAL_LENGTH_M))
    pixels = pixels_of_mirror(uncertain, cam_from_mirror)
    u, v, _, _ = trace_pixels(uncertain, pixels, cam_from_mirror, height, gradient)
    samples = [PixelSamples(facet, pixels, u, v)]
    middle = []
    for align in (True, False):
        solution = solve_shape(trace_samples(uncertain, samples), cam_from_mirror, align=align)
        modes = common_modes(uncertain, samples, solution, UncertainPose(cam_from_mirror, SIGMA_POSE), align=align)[0]
        middle.append(np.sqrt((modes.evaluate(np.zeros(1), np.zeros(1)) ** 2).sum()))
    assert middle[1] > 5e-4
    assert middle[0] < 1e-5


def test_sources_without_sigma_give_no_modes(laboratory, cam_from_mirror):
    facet = Facet("dish", OUTLINE, paraboloid(FOCAL_LENGTH_M))
    exact = replace(laboratory, covariance_cam_from_screen=np.zeros((6, 6)))
    pixels = pixels_of_mirror(exact, cam_from_mirror)
    u, v, _, _ = trace_pixels(exact, pixels, cam_from_mirror, height, gradient)
    samples = [PixelSamples(facet, pixels, u, v)]
    solution = solve_shape(trace_samples(exact, samples), cam_from_mirror, align=True)
    modes = common_modes(exact, samples, solution, UncertainPose(cam_from_mirror, np.zeros((6, 6))), align=True)[0]
    assert modes.sources == ()
    assert modes.evaluate(np.zeros(3), np.zeros(3)).shape == (0, 2, 3)
    shaped = common_modes(
        replace(exact, sigma_screen_points_m=1e-3),
        samples,
        solution,
        UncertainPose(cam_from_mirror, np.zeros((6, 6))),
        align=True,
    )[0]
    assert set(shaped.sources) == {"screen shape"}


def test_principal_steps_add_up_to_the_covariance():
    rng = np.random.default_rng(4)
    root = rng.normal(size=(5, 5)) * np.array([1e-6, 1.0, 1e3, 1.0, 1e-3])[:, None]
    covariance = np.zeros((7, 7))
    covariance[:5, :5] = root @ root.T
    steps = principal_steps(covariance)
    scale = np.sqrt(np.diag(covariance)) + (np.diag(covariance) == 0)
    assert np.allclose(steps.T @ steps / np.outer(scale, scale), covariance / np.outer(scale, scale), atol=1e-12)
    assert steps.shape == (5, 7)
    assert principal_steps(np.zeros((6, 6))).shape == (0, 6)


@pytest.mark.parametrize(("width", "height"), [(400, 500), (800, 1000), (640, 500), (70, 200)])
def test_pixels_are_picked_over_all_columns_and_rows(width, height):
    """Whole rows of equal length: every k-th of 800 x 1000 pixels lies in one of two columns."""
    chosen = spread_indices(width * height, 2000)
    assert 1990 <= chosen.size <= 2000
    assert np.all(np.diff(chosen) > 0)
    row, column = np.divmod(chosen, width)
    for place, size in ((row, height), (column, width)):
        assert np.histogram(place, bins=8, range=(0, size))[0] == pytest.approx([250] * 8, abs=40)
    assert spread_indices(7, 2000).tolist() == list(range(7))
