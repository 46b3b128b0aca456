"""From beams and spots to slopes: the law of reflection at places that are found together with the shape."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from deflectometry.laser.scan import LaserScan
from deflectometry.shape.common_modes import MovedSamples, departures, modes_of_samples
from deflectometry.shape.facet_pixels import spread_indices
from deflectometry.shape.smooth_shape import (
    SHAPE_DEGREE,
    FacetSamples,
    ShapeSolution,
    slope_sensitivity,
    slopes_at,
    solve_shape,
    start_surface,
)
from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet, Quadric
from heliogauge.slopes.map import CommonModes, monomials
from heliogauge.validate import BoolArray, FloatArray, IntArray

#: Beams for the common modes, as many as pixels of an image.
_MODE_BEAMS = 400
#: Whatever the distribution of errors, 20 sigma are exceeded at most once in 400 times (Chebyshev's inequality).
_IMPOSSIBLE_SIGMAS = 20.0
#: Beams around a beam with which it is compared.
_NEIGHBOURS = 8
#: Beams around a beam, itself included, and the degree of the polynomial through them, that tell its noise.
_PATCH, _PATCH_DEGREE = 25, 3
#: Spots that leave more than this share of what spots dealt at random would leave of a smooth surface are in the wrong
#: order: half of the beams, exchanged with others, leave 0.7 of it.
_UNRELATED = 0.5
#: An exchange explains slopes that it makes so much smaller, RMS, and as small as those of a mirror for sunlight [rad].
_EXPLAINS, _OF_A_MIRROR_RAD = 3.0, 1e-2


@dataclass(frozen=True, slots=True, eq=False)
class LaserSigmas:
    """Standard deviations of what is known of the instrument.

    spot_m, direction_rad: Of each spot and each beam by itself, each axis.
    distance_m, offset_m: Of the mirror's place along z, and beside the laser, each axis.
    laser_place_m, target_scale, angle_scale, roll_rad: As in `deflectometry.laser.keys.ScanSection`.
    """

    spot_m: float
    direction_rad: float = 0.0
    distance_m: float = 0.0
    offset_m: float = 0.0
    laser_place_m: float = 0.0
    target_scale: float = 0.0
    angle_scale: float = 0.0
    roll_rad: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class ScanSlopes:
    """Slopes where the beams met the mirror.

    solution: Pose of the mirror and its smooth shape.
    facet: The mirror: its outline is the convex hull of the beams.
    points_m (2, n): Where each beam met the surface, mirror frame [m]; NaN where it missed.
    slopes (2, n): dz/dx and dz/dy; NaN where no spot was seen.
    sigmas (2, n): Their random standard deviations [rad].
    noise_correlation: Variance of the sum of all slopes over the sum of their variances: more than 1 where beams share
        an error of direction.
    odd (n,): Spots that cannot belong to their neighbours' surface.
    scatter: Of slopes about cubics through those around them, over what their random sigmas make.
    common: What distance, place, scale and roll do to all slopes together.
    """

    solution: ShapeSolution
    facet: Facet
    points_m: FloatArray
    slopes: FloatArray
    sigmas: FloatArray
    noise_correlation: float
    odd: BoolArray
    scatter: float
    common: CommonModes


def solve_scan(
    scan: LaserScan, design: Quadric, laser_from_mirror: RigidTransform, sigmas: LaserSigmas, *, align: bool
) -> ScanSlopes:
    """Find the slopes of a mirror from a laser scan.

    laser_from_mirror: Where the mirror's frame stands.
    align: As in `deflectometry.shape.smooth_shape.solve_shape`.
    Returns: Slopes with their sigmas.
    EstimationError: Beams that do not meet the mirror, or spots that are not those of the beams.

    The beam from O meets the surface at P and returns to the spot T: the normal at P halves the angle between P O and
    P T (spec 003 C-26c). P needs the surface: instead of an assumed shape, as VSHOT has it, the polynomial that the
    slopes themselves give is added to the design until they agree, as for every other source of
    `deflectometry.shape.smooth_shape`; the laser stands for the camera and the spot for the point of the screen.
    """
    facet = _facet_of(scan, design, laser_from_mirror)
    _refuse_exchanges(scan, facet, laser_from_mirror, sigmas)
    good = scan.seen
    solution = _solve(scan.chosen(good), facet, laser_from_mirror, align=align)
    odd = np.zeros(good.size, dtype=bool)
    points, slopes, random, correlation = _slopes_of(scan, facet, solution, sigmas)
    smooth = np.stack(solution.surfaces[0].gradient(points[0], points[1]))
    usable = np.flatnonzero(good & np.isfinite(slopes).all(axis=0))
    found = _odd_ones(points[:, usable], (slopes - smooth)[:, usable], random[:, usable])
    if found.any():
        odd[usable[found]] = True
        solution = _solve(scan.chosen(good & ~odd), facet, laser_from_mirror, align=align)
        points, slopes, random, correlation = _slopes_of(scan, facet, solution, sigmas)
    few = np.flatnonzero(good & ~odd)
    few = few[spread_indices(few.size, _MODE_BEAMS)]
    common = _common_modes(scan, few, facet, solution, sigmas, align=align)
    used = good & ~odd & np.isfinite(slopes).all(axis=0)
    smooth = np.stack(solution.surfaces[0].gradient(points[0], points[1]))
    scatter = _scatter(points[:, used], (slopes - smooth)[:, used], random[:, used])
    return ScanSlopes(solution, facet, points, slopes, random, correlation, odd, scatter, common)


def _samples(scan: LaserScan, facet: Facet) -> list[FacetSamples]:
    return [FacetSamples(facet, scan.directions, scan.spots_m)]


def _solve(scan: LaserScan, facet: Facet, laser_from_mirror: RigidTransform, *, align: bool) -> ShapeSolution:
    return solve_shape(_samples(scan, facet), laser_from_mirror, align=align)


def _facet_of(scan: LaserScan, design: Quadric, laser_from_mirror: RigidTransform) -> Facet:
    """Return the mirror with the convex hull of the beams as its outline."""
    from scipy.spatial import ConvexHull, QhullError

    mirror_from_laser = laser_from_mirror.inverse()
    origin = mirror_from_laser.translation_m
    directions = mirror_from_laser.rotation @ scan.directions
    places = origin[:, None] + design.intersect(origin, directions.T) * directions
    met = np.isfinite(places).all(axis=0) & scan.seen
    try:
        corners = ConvexHull(places[:2, met].T).vertices
    except (QhullError, ValueError) as error:
        raise EstimationError(
            f"{int(met.sum())} beams with a spot meet the design, over no area; check distance_m and offset_m"
        ) from error
    # The frame is turned about the place that distance and offset say.
    return Facet("mirror", places[:2, met].T[corners], design, reference_point_m=np.zeros(2))


def _slopes_of(
    scan: LaserScan, facet: Facet, solution: ShapeSolution, sigmas: LaserSigmas
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return points (2, n), slopes (2, n), their random sigmas (2, n) and their noise correlation."""
    surface, mirror_from_laser = solution.surfaces[0], solution.cam_from_mirror.inverse()
    laser = mirror_from_laser.translation_m
    points = surface.intersect(laser, mirror_from_laser.rotation @ scan.directions)
    spots = mirror_from_laser.rotation @ scan.spots_m + laser[:, None]
    slopes = np.stack(slopes_at(points, laser, spots))
    steps = mirror_from_laser.rotation @ (sigmas.spot_m * scan.spot_steps)
    variance = np.sum([slope_sensitivity(points, laser, spots, step) ** 2 for step in steps], axis=0)
    if not sigmas.direction_rad > 0:
        return points[:2], slopes, np.sqrt(variance), 1.0
    (base,) = departures(_samples(scan, facet), solution, solution)
    by_direction = np.zeros_like(variance)
    for step in scan.direction_steps:
        turned = scan.with_directions(scan.directions + sigmas.direction_rad * step)
        (moved,) = departures(_samples(turned, facet), solution, solution)
        by_direction += (moved[1] - base[1]) ** 2
    variance = variance + by_direction
    share = float(np.nansum(by_direction) / np.nansum(variance))
    return points[:2], slopes, np.sqrt(variance), 1.0 + share * (scan.beams_of_one_error - 1.0)


def _odd_ones(points_m: FloatArray, error: FloatArray, sigma: FloatArray) -> BoolArray:
    """Return which slopes are impossibly far from those around them, shape (n,)."""
    from scipy.spatial import cKDTree

    around = cKDTree(points_m.T).query(points_m.T, k=_NEIGHBOURS + 1)[1][:, 1:]
    off = error - np.median(error[:, around], axis=2)
    usual = 1.4826 * np.median(np.abs(off), axis=1, keepdims=True)
    return np.asarray((np.abs(off) > _IMPOSSIBLE_SIGMAS * np.maximum(usual, sigma)).any(axis=0))


def _scatter(points_m: FloatArray, error: FloatArray, sigma: FloatArray) -> float:
    """Return the noise of slopes by what cubics through 25 of them leave of the middle one, over their sigmas."""
    from scipy.spatial import cKDTree

    near = cKDTree(points_m.T).query(points_m.T, k=_PATCH)[1]
    away = points_m[:, near] - points_m[:, :, None]
    u, v = away / np.abs(away).max()
    terms = monomials(u, v, _PATCH_DEGREE)
    weights = -np.linalg.pinv(np.moveaxis(terms, 0, -1))[:, 0]
    weights[:, 0] += 1.0
    left = np.einsum("nk,cnk->cn", weights, error[:, near])
    expected = np.sqrt(np.einsum("nk,cnk->cn", weights**2, sigma[:, near] ** 2))
    return robust_scale((left / expected).ravel())


def _common_modes(
    scan: LaserScan, few: IntArray, facet: Facet, solution: ShapeSolution, sigmas: LaserSigmas, *, align: bool
) -> CommonModes:
    chosen = np.zeros(scan.seen.size, dtype=bool)
    chosen[few] = True
    some = scan.chosen(chosen)
    (modes,) = modes_of_samples(
        _samples(some, facet), solution, lambda pose: _moved(some, facet, pose, sigmas), align=align
    )
    return modes


def _moved(
    scan: LaserScan, facet: Facet, laser_from_mirror: RigidTransform, sigmas: LaserSigmas
) -> Iterator[MovedSamples]:
    """Yield scan and pose with one input after the other off by one sigma."""

    def one(source: str, moved: LaserScan, pose: RigidTransform = laser_from_mirror) -> MovedSamples:
        return MovedSamples(source, _samples(moved, facet), pose)

    for axis, sigma in enumerate((sigmas.offset_m, sigmas.offset_m, sigmas.distance_m)):
        if sigma > 0:
            step = np.concatenate([np.zeros(3), sigma * np.eye(3)[axis]])
            yield one("mirror place", scan, laser_from_mirror.moved(step))
    for axis in range(3):
        unit = np.eye(3)[axis][:, None]
        if sigmas.laser_place_m > 0:
            yield one("laser place", scan.with_spots(scan.spots_m + sigmas.laser_place_m * unit))
        if axis < 2 and sigmas.target_scale > 0:
            yield one("target scale", scan.with_spots(scan.spots_m * (1 + sigmas.target_scale * unit)))
        if axis < 2 and sigmas.angle_scale > 0:
            angles = np.arctan2(scan.directions[:2], -scan.directions[2]) * (1 + sigmas.angle_scale * unit[:2])
            stretched = np.vstack([np.tan(angles), -np.ones(angles.shape[1])])
            yield one("angle scale", scan.with_directions(stretched))
    if sigmas.roll_rad > 0:
        x, y, z = scan.spots_m
        yield one("roll", scan.with_spots(np.stack([x - sigmas.roll_rad * y, y + sigmas.roll_rad * x, z])))


# --- beams and spots that do not belong together --------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _OnDesign:
    """Slope errors with the beams' places on the design: good to tell what was exchanged.

    points_m (3, n): Where the beams meet the design, mirror frame [m].
    mirror_from_laser: Where the laser stands.
    design: The mirror's design.
    """

    points_m: FloatArray
    mirror_from_laser: RigidTransform
    design: Quadric

    def errors(self, spots_m: FloatArray) -> FloatArray:
        """Return slopes minus those of the design, shape (2, n); NaN without a spot."""
        laser = self.mirror_from_laser.translation_m
        spots = self.mirror_from_laser.rotation @ spots_m + laser[:, None]
        design = np.stack(self.design.gradient(self.points_m[0], self.points_m[1]))
        return np.asarray(np.stack(slopes_at(self.points_m, laser, spots)) - design)

    def spread(self, spots_m: FloatArray) -> float:
        """Return the RMS of the slope errors about their mean [rad]."""
        error = self.errors(spots_m)
        return float(np.sqrt(np.nanmean((error - np.nanmean(error, axis=1, keepdims=True)) ** 2)))

    def unexplained(self, spots_m: FloatArray) -> float:
        """Return the RMS of the slope errors about a polynomial of degree 4 in the places [rad]."""
        error = self.errors(spots_m)
        known = np.isfinite(error).all(axis=0)
        u, v = self.points_m[:2, known] / np.abs(self.points_m[:2, known]).max()
        terms = monomials(u, v, SHAPE_DEGREE)
        left = error[:, known] - (np.linalg.lstsq(terms.T, error[:, known].T, rcond=None)[0].T @ terms)
        return float(np.sqrt(np.mean(left**2)))


def _on_design(scan: LaserScan, facet: Facet, laser_from_mirror: RigidTransform) -> _OnDesign:
    mirror_from_laser = laser_from_mirror.inverse()
    directions = mirror_from_laser.rotation @ scan.directions
    points = start_surface(facet).intersect(mirror_from_laser.translation_m, directions)
    return _OnDesign(points, mirror_from_laser, facet.design)


def _refuse_exchanges(scan: LaserScan, facet: Facet, laser_from_mirror: RigidTransform, sigmas: LaserSigmas) -> None:
    """Refuse spots that are not those of the beams in the same rows, or whose axes are not those of the beams.

    EstimationError: Spots and beams are unrelated, or one exchange makes the slope errors three times smaller.
    """
    seen = _on_design(scan, facet, laser_from_mirror)
    laser = seen.mirror_from_laser.translation_m
    as_given = seen.spread(scan.spots_m)
    noise = 0.5 * sigmas.spot_m / float(np.linalg.norm(laser)) + sigmas.direction_rad
    if as_given < _IMPOSSIBLE_SIGMAS * noise:
        return
    x, y, z = laser_from_mirror.translation_m
    nearer = _on_design(scan, facet, RigidTransform(laser_from_mirror.rotation, np.array([x, y, 1e-3 * z])))
    least, words = min(
        (nearer.spread(scan.spots_m), "distance_m is in millimetres, 1000 times too large"),
        *((seen.spread(spots), words) for words, spots in _exchanged(scan.spots_m)),
    )
    if least < min(as_given / _EXPLAINS, _OF_A_MIRROR_RAD):
        raise EstimationError(
            f"slope errors of {1e3 * as_given:.3g} mrad RMS, but of {1e3 * least:.3g} mrad if {words}: put that right"
        )
    left, dealt = (seen.unexplained(spots) for spots in (scan.spots_m, _dealt_anew(scan.spots_m)))
    if left > max(_UNRELATED * dealt, _IMPOSSIBLE_SIGMAS * noise):
        raise EstimationError(
            f"slope errors of {1e3 * left:.3g} mrad RMS about a smooth surface, {1e3 * dealt:.3g} if the spots were "
            "dealt to the beams at random: are the rows of the table in the order of the scan?"
        )


def _dealt_anew(spots_m: FloatArray) -> FloatArray:
    seen = np.flatnonzero(np.isfinite(spots_m).all(axis=0))
    dealt = spots_m.copy()
    dealt[:, seen] = spots_m[:, np.random.default_rng(0).permutation(seen)]
    return dealt


def _exchanged(spots_m: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Yield what programs and people exchange."""
    for axis, name in enumerate("xy"):
        yield f"spot_{name}_m has the other sign", spots_m * np.where(np.arange(3) == axis, -1.0, 1.0)[:, None]
    yield "both coordinates of the spots have the other sign", spots_m * np.array([-1.0, -1.0, 1.0])[:, None]
    yield "spot_x_m and spot_y_m are exchanged", spots_m[[1, 0, 2]]
    yield "the spots are in reverse order", spots_m[:, ::-1]
    yield "the spots are in millimetres", 1e-3 * spots_m
