"""The share of the uncertainty that a whole slope map has in common: pose, screen and camera."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deflectometry.setup.bench import Setup
from deflectometry.shape.slopes import FacetSamples, RoundLimits, ShapeSolution, slopes_at, solve_shape
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.slopes.map import CommonModes, monomials
from heliogauge.validate import Float32Array, FloatArray, IntArray

#: Degree of the polynomials that hold a mode: what pose, lens and screen do to a map is smooth, a cubic leaves
#: less than 2 % of it on the setups tried.
MODE_DEGREE = 3


@dataclass(frozen=True, slots=True, eq=False)
class PixelSamples:
    """Some pixels of one facet as they were measured.

    pixels_px (n, 2): Pixel positions (x, y) [px].
    u, v (n,): Display coordinates seen there.
    """

    facet: Facet
    pixels_px: FloatArray
    u: Float32Array | FloatArray
    v: Float32Array | FloatArray


def spread_indices(count: int, most: int) -> IntArray:
    """Pick indices spread evenly over all, but not in step with any row length.

    One from each of `most` equal parts, its place within the part from the golden ratio. Every k-th pixel would do
    for a round mirror; of one that fills 800 x 1000 px exactly it takes pixels of two columns only.
    """
    if count <= most:
        return np.arange(count)
    part = np.arange(most)
    return np.unique(((part + part * 0.6180339887498949 % 1.0) * (count / most)).astype(np.intp))


@dataclass(frozen=True, slots=True)
class Warp:
    """A smooth shape added to a screen.

    axis: Coordinate of the screen frame that changes.
    order: Orders of the Legendre polynomials in u and in v.
    rms_m: RMS over the display [m].
    """

    axis: int
    order: tuple[int, int]
    rms_m: float

    def shift_m(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Return the shift of the points that show (u, v), shape (n, 3) [m]."""
        shift = np.zeros((u.size, 3))
        shift[:, self.axis] = self.rms_m * _legendre(self.order[0], u) * _legendre(self.order[1], v)
        return shift


def _legendre(order: int, fraction: FloatArray) -> FloatArray:
    """Return the Legendre polynomial of order 0 to 2 over fractions 0 to 1, scaled to RMS 1."""
    centred = 2 * fraction - 1
    values = (np.ones_like(centred), centred, 1.5 * centred**2 - 0.5)[order]
    return np.asarray(np.sqrt(2 * order + 1) * values)


def trace_samples(setup: Setup, samples: Sequence[PixelSamples], warp: Warp | None = None) -> list[FacetSamples]:
    """Turn pixels and display coordinates into lines of sight and screen points.

    warp: Smooth shape added to the screen.
    Returns: The same pixels in the camera frame.
    """
    traced = []
    for sample in samples:
        points = setup.screen.points_m(sample.u, sample.v)
        if warp is not None:
            points = points + warp.shift_m(sample.u.astype(np.float64), sample.v.astype(np.float64))
        rays = setup.camera.cast_rays(sample.pixels_px)
        traced.append(
            FacetSamples(sample.facet, np.ascontiguousarray(rays.T), setup.cam_from_screen.apply(points).T.copy())
        )
    return traced


@dataclass(frozen=True, slots=True, eq=False)
class UncertainPose:
    """The pose of a mirror before alignment, how well it is known, and how it follows camera and screen.

    covariance (6, 6): Covariance for steps of `RigidTransform.moved` [rad, m], for camera and screen as given.
    with_setup: The pose that the same observations give with another setup; without it the pose stays where it is.
    """

    cam_from_mirror: RigidTransform
    covariance: FloatArray
    with_setup: Callable[[Setup], RigidTransform] | None = None

    def following(self, setup: Setup, aligned: RigidTransform) -> RigidTransform:
        """Carry an aligned pose along with what another setup does to the pose."""
        if self.with_setup is None:
            return aligned
        return self.with_setup(setup) @ self.cam_from_mirror.inverse() @ aligned


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
    align: As in `deflectometry.shape.slopes.solve_shape`.
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
    for source, moved, pose, warp in _perturbations(setup, start.cam_from_mirror, located):
        traced = trace_samples(moved, samples, warp)
        shape = solve_shape(traced, pose, align=align, start=start, rounds=RoundLimits(2, 1, must_settle=False))
        sources.append(source)
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


def _perturbations(
    setup: Setup, cam_from_mirror: RigidTransform, located: UncertainPose
) -> Iterator[tuple[str, Setup, RigidTransform, Warp | None]]:
    """Yield the inputs moved by one sigma along each principal direction of each covariance."""
    for step in principal_steps(located.covariance):
        yield "mirror pose", setup, cam_from_mirror.moved(step), None
    for step in principal_steps(setup.covariance_cam_from_screen):
        moved = replace(setup, cam_from_screen=setup.cam_from_screen.moved(step))
        yield "screen pose", moved, located.following(moved, cam_from_mirror), None
    for step in principal_steps(setup.camera.covariance):
        camera = setup.camera.with_parameters(setup.camera.parameters + step)
        moved = replace(setup, camera=camera)
        yield "camera", moved, located.following(moved, cam_from_mirror), None
    if setup.sigma_screen_points_m > 0:
        for warp in _screen_warps(setup.sigma_screen_points_m):
            yield "screen shape", setup, cam_from_mirror, warp


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
