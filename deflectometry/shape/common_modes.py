"""The share of the uncertainty that a whole slope map has in common: pose, screen and camera."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deflectometry.pose.pose_observations import UncertainPose
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.shape.facet_pixels import PixelSamples, Warp, trace_samples
from deflectometry.shape.smooth_shape import FacetSamples, RoundLimits, ShapeSolution, slopes_at, solve_shape
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.slopes.map import CommonModes, monomials
from heliogauge.validate import FloatArray

#: Degree of the polynomials that hold a mode: what pose, lens and screen do to a map is smooth, a cubic leaves
#: less than 2 % of it on the setups tried.
MODE_DEGREE = 3


def common_modes(
    setup: Setup,
    samples: Sequence[PixelSamples],
    solution: ShapeSolution,
    located: UncertainPose,
    *,
    align: bool,
) -> list[CommonModes]:
    """Propagate the uncertainty of pose, screen and camera into the slopes of each facet.

    solution: The shape found with the values as given.
    located: The mirror's pose.
    align: As in `deflectometry.shape.smooth_shape.solve_shape`.
    Returns: One mode for each independent direction of each covariance, for each facet.

    Each covariance is split into its principal directions; the whole solution (shape and alignment included) is
    repeated with the input moved by one sigma along each, and the change of the slopes is fitted by a cubic. A pixel
    that then sees another point of the mirror is compared with the slope of the smooth shape there. A pose that was
    found from the image, or from a distance to the screen, follows camera and screen; what is left of its uncertainty
    is independent of theirs. (With the pose held in place, a focal length off by 0.15 % and a distance that gave way
    to it would count five times too much, a principal point in y half of its true share.)
    """
    # The base must be at rest on these very samples, or the first step would move it too.
    start = solve_shape(
        trace_samples(setup, samples), solution.cam_from_mirror, align=align, start=solution, rounds=RoundLimits(30, 1)
    )
    base = _departures(trace_samples(setup, samples), start, start)
    sources: list[str] = []
    changes: list[list[FloatArray]] = []
    rounds = RoundLimits(2, 1, must_settle=False)
    for one in _perturbations(setup, start.cam_from_mirror, located):
        traced = trace_samples(one.setup, samples, one.warp)
        shape = solve_shape(traced, one.cam_from_mirror, align=align, start=start, rounds=rounds)
        sources.append(one.source)
        moved_on = _departures(traced, shape, start)
        changes.append([after[1] - before[1] for after, before in zip(moved_on, base, strict=True)])
    return [_as_modes(sources, [change[k] for change in changes], base[k][0], samples[k]) for k in range(len(samples))]


def _departures(
    samples: Sequence[FacetSamples], solution: ShapeSolution, start: ShapeSolution
) -> list[tuple[FloatArray, FloatArray]]:
    """Return the positions of each facet's samples, and their slopes minus those of the start's shape there."""
    results = []
    for sample, surface, smooth in zip(samples, solution.surfaces, start.surfaces, strict=True):
        facet_from_cam = (solution.cam_from_mirror @ sample.facet.ensemble_from_facet).inverse()
        camera = facet_from_cam.translation_m
        points = surface.intersect(camera, facet_from_cam.rotation @ sample.rays_cam)
        screen = facet_from_cam.rotation @ sample.screen_cam_m + camera[:, None]
        slopes = np.stack(slopes_at(points, camera, screen))
        results.append((points[:2], slopes - np.stack(smooth.gradient(points[0], points[1]))))
    return results


@dataclass(frozen=True, slots=True, eq=False)
class _Perturbed:
    """Inputs of which one was moved by one sigma, and the name of its source."""

    source: str
    setup: Setup
    cam_from_mirror: RigidTransform
    warp: Warp | None = None


def _perturbations(setup: Setup, cam_from_mirror: RigidTransform, located: UncertainPose) -> Iterator[_Perturbed]:
    """Yield the inputs moved by one sigma along each principal direction of each covariance."""
    for step in principal_steps(located.covariance):
        yield _Perturbed("mirror pose", setup, cam_from_mirror.moved(step))
    for step in principal_steps(setup.covariance_cam_from_screen):
        moved = replace(setup, cam_from_screen=setup.cam_from_screen.moved(step))
        yield _Perturbed("screen pose", moved, located.following(moved, cam_from_mirror))
    for step in principal_steps(setup.camera.covariance):
        camera = setup.camera.with_parameters(setup.camera.parameters + step)
        moved = replace(setup, camera=camera)
        yield _Perturbed("camera", moved, located.following(moved, cam_from_mirror))
    if setup.sigma_screen_points_m > 0:
        for warp in _screen_warps(setup.sigma_screen_points_m):
            yield _Perturbed("screen shape", setup, cam_from_mirror, warp)
    for source, warp in _screen_sizes(setup):
        yield _Perturbed(source, setup, cam_from_mirror, warp)


def principal_steps(covariance: FloatArray) -> FloatArray:
    """Return one-sigma steps along the principal directions of a covariance.

    covariance (n, n): Covariance matrix; parameters may differ in unit.
    Returns (k, n): Independent steps whose outer products add up to the covariance; k is its rank.
    """
    scale = np.sqrt(np.diag(covariance))
    used = scale > 0
    if not used.any():
        return np.zeros((0, scale.size))
    correlation = covariance[np.ix_(used, used)] / np.outer(scale[used], scale[used])
    values, vectors = np.linalg.eigh(correlation)
    keep = values > 1e-12 * values[-1]
    steps = np.zeros((int(np.count_nonzero(keep)), scale.size))
    steps[:, used] = (vectors[:, keep] * np.sqrt(values[keep])).T * scale[used]
    return steps


def _screen_warps(sigma_m: float) -> Iterator[Warp]:
    """Yield the smooth shapes that a surveyed screen may have wrong; together each axis has the RMS sigma.

    Legendre polynomials over the display: stretch and shear in the screen's plane, bows and twist out of it. Shifts
    and turns are those of the screen's pose.
    """
    in_plane, out_of_plane = ((1, 0), (0, 1)), ((2, 0), (1, 1), (0, 2))
    for axis, orders in ((0, in_plane), (1, in_plane), (2, out_of_plane)):
        for order in orders:
            yield Warp(axis, order, sigma_m / float(np.sqrt(len(orders))))


def _screen_sizes(setup: Setup) -> Iterator[tuple[str, Warp]]:
    """Yield what width, height, sag and periods that are one sigma off do to the screen's points.

    A width off by s moves the point at u by s (u - 1/2), an RMS of s / sqrt(12) over the display; a bulge that is s
    high in the middle and 0 at two edges is a Legendre polynomial of order 2 with an RMS of 2 s / (3 sqrt(5)).
    """
    corners = setup.screen.points_m(np.array([0.0, 1.0, 0.5, 0.5]), np.array([0.5, 0.5, 0.0, 1.0]))
    size_m = np.linalg.norm(corners[[1, 3]] - corners[[0, 2]], axis=1)
    orders = ((1, 0), (0, 1))
    for axis, order in enumerate(orders):
        if setup.sigma_size_m[axis] > 0:
            yield "screen size", Warp(axis, order, float(setup.sigma_size_m[axis]) / math.sqrt(12.0))
        if setup.sigma_periods[axis] > 0:
            by_periods = float(setup.sigma_periods[axis] * size_m[axis])
            yield "fringe periods", Warp(axis, order, by_periods / math.sqrt(12.0))
    if setup.sigma_sag_m > 0:
        for order in ((2, 0), (0, 2)):
            yield "screen sag", Warp(2, order, setup.sigma_sag_m * 2.0 / (3.0 * math.sqrt(5.0)))


def _as_modes(sources: list[str], changes: list[FloatArray], points_m: FloatArray, sample: PixelSamples) -> CommonModes:
    """Fit each change of slopes by polynomials over the facet."""
    center = np.asarray(sample.facet.reference_point_m)
    scale = 0.5 * float(np.ptp(sample.facet.outline_m, axis=0).max())
    terms = (MODE_DEGREE + 1) * (MODE_DEGREE + 2) // 2
    usable = np.isfinite(points_m).all(axis=0)
    for change in changes:
        usable &= np.isfinite(change).all(axis=0)
    u, v = (points_m[:, usable] - center[:, None]) / scale
    matrix = monomials(u, v, MODE_DEGREE)
    solver = np.linalg.pinv(matrix @ matrix.T, rcond=1e-12, hermitian=True) @ matrix
    # Every facet keeps every mode, so that the modes of all facets belong together one by one.
    coefficients = np.array([(solver @ change[:, usable].T).T for change in changes]).reshape(-1, 2, terms)
    return CommonModes(tuple(sources), coefficients, center, scale)
