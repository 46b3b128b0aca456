"""Slopes from lines of sight, screen points and a surface that is found together with them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from heliogauge.adjust.robust_loss import Tukey
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform, rotation_between
from heliogauge.geometry.surfaces import Facet, Quadric
from heliogauge.slopes.map import monomials
from heliogauge.validate import FloatArray

#: Degree of the polynomial that holds the measured shape beside the design. Slopes depend on the height only
#: through the place of the reflecting point: what degree 4 leaves (ripple of 1 mrad over 0.1 m is 16 um high)
#: changes a slope at 10 m by less than 1 urad.
SHAPE_DEGREE = 4
#: The shape and the tilt are converged when no slope changes by more than this [rad].
SLOPE_TOLERANCE_RAD = 1e-9
#: Slopes that change by more than this run away: single sights along a surface that is seen edge on make thousands.
_NO_SURFACE = 1e6
#: A line of sight that meets a surface so many half sizes from the facet's middle does not meet the facet.
_OFF_FACET = 100.0
#: A fit is settled when reweighting changes its coefficients by less than this share of the largest.
SETTLED = 1e-7
#: Where the biweight ends, in median absolute residuals: 95 % efficient for normal errors.
_BIWEIGHT_MEDIANS = 4.685 / 0.6745
#: Newton rounds along a line of sight, and what may be missing at the end [m]: it changes no slope by 1e-12.
MAX_ITERATIONS = 30
_SETTLED_M = 1e-12
#: Places that are worked on at once: what belongs to them stays in a 2 MiB second-level cache.
_BLOCK = 16384


@dataclass(frozen=True, slots=True, eq=False)
class FittedSurface:
    """The design surface plus a polynomial that follows the measured slopes.

    design: Design surface in the facet frame.
    coefficients_m (15,): Height of the polynomial on the monomials of `heliogauge.slopes.map.monomials`, degree 4
        [m].
    center_m (2,): Point where the polynomial's variables are zero [m].
    scale_m: Length that becomes 1 [m].
    """

    design: Quadric
    coefficients_m: FloatArray
    center_m: FloatArray
    scale_m: float

    def correction(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """Return the height of the polynomial, shape (...) [m]."""
        return self._evaluate([self.coefficients_m], x_m, y_m)[0]

    def correction_gradient(self, x_m: FloatArray, y_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the slopes of the polynomial in x and y, each of shape (...)."""
        along_u, along_v = derivative_coefficients(self.coefficients_m)
        slope_x, slope_y = self._evaluate([along_u / self.scale_m, along_v / self.scale_m], x_m, y_m)
        return slope_x, slope_y

    def _evaluate(self, polynomials: Sequence[FloatArray], x_m: FloatArray, y_m: FloatArray) -> list[FloatArray]:
        """Evaluate polynomials in the surface's variables, some places at a time."""
        found = [np.empty(np.shape(x_m)) for _ in polynomials]
        flat_x, flat_y, flat = x_m.reshape(-1), y_m.reshape(-1), [one.reshape(-1) for one in found]
        for start in range(0, flat_x.size, _BLOCK):
            part = slice(start, start + _BLOCK)
            u, v = (flat_x[part] - self.center_m[0]) / self.scale_m, (flat_y[part] - self.center_m[1]) / self.scale_m
            for values, coefficients in zip(flat, polynomials, strict=True):
                values[part] = polynomial(coefficients, u, v)
        return found

    def gradient(self, x_m: FloatArray, y_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the slopes of design and polynomial together, each of shape (...)."""
        design_x, design_y = self.design.gradient(x_m, y_m)
        more_x, more_y = self.correction_gradient(x_m, y_m)
        return design_x + more_x, design_y + more_y

    def height(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """Return the height of design and polynomial together, shape (...) [m]."""
        return self.design.height(x_m, y_m) + self.correction(x_m, y_m)

    def intersect(self, origin_m: FloatArray, directions: FloatArray) -> FloatArray:
        """Return where lines of sight meet the surface.

        Shapes: origin_m (3,).
        directions (3, n): Directions of any length.
        Returns (3, n): Points [m]; NaN where a line misses the design surface.
        """
        length = self.design.intersect(origin_m, directions.T)
        points = origin_m[:, None] + length * directions
        if not self.coefficients_m.any():
            return np.asarray(points)
        # Newton along the ray: each step leaves the product of two small slopes, 3 steps reach round-off
        # from a plane that stands for an f = 10 m dish.
        before = 0.0
        for _ in range(MAX_ITERATIONS):
            height, design_x, design_y = self.design.height_and_gradient(points[0], points[1])
            missing = height - points[2]
            missing += self.correction(points[0], points[1])
            points += missing / (directions[2] - design_x * directions[0] - design_y * directions[1]) * directions
            # The next would be smaller by the same factor again.
            now = float(np.fmax.reduce(np.abs(missing), initial=0.0))
            if now <= max(_SETTLED_M, min(np.sqrt(_SETTLED_M * before), 1e-3 * before)):
                break
            before = now
        return np.asarray(points)


def polynomial(coefficients: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
    """Evaluate a polynomial on the monomials of `heliogauge.slopes.map.monomials` by Horner's rule in both variables.

    Shapes: u, v (...), result (...).
    coefficients (n_terms,): Coefficients ordered by total degree, then by the power of v.
    """
    degree = int((np.sqrt(8 * coefficients.size + 1) - 3) / 2)
    # The last coefficient of a row or column is still a number, not an array.
    total: FloatArray | float = float(coefficients[degree * (degree + 1) // 2])
    for power_u in range(degree - 1, -1, -1):
        inner: FloatArray | float = float(coefficients[-1 - power_u])
        for power_v in range(degree - power_u - 1, -1, -1):
            order = power_u + power_v
            inner = np.multiply(inner, v, out=inner if isinstance(inner, np.ndarray) else None)
            inner += coefficients[order * (order + 1) // 2 + power_v]
        total = np.multiply(total, u, out=total if isinstance(total, np.ndarray) else None)
        total += inner
    return total if isinstance(total, np.ndarray) else np.full(np.shape(u), total)


def derivative_coefficients(coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients of the derivatives after u and after v, which are of one degree less."""
    degree = int((np.sqrt(8 * coefficients.size + 1) - 3) / 2)
    along_u, along_v = np.zeros((2, degree * (degree + 1) // 2))
    for order in range(1, degree + 1):
        first, below = order * (order + 1) // 2, order * (order - 1) // 2
        for power_v in range(order + 1):
            if power_v < order:
                along_u[below + power_v] = (order - power_v) * coefficients[first + power_v]
            if power_v > 0:
                along_v[below + power_v - 1] = power_v * coefficients[first + power_v]
    return along_u, along_v


def slopes_at(points_m: FloatArray, camera_m: FloatArray, screen_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the slopes of the mirror that shows a screen point to the camera.

    Shapes: points_m (3, n).
    camera_m (3,): Projection centre [m].
    screen_m (3, n): Screen points seen there [m].
    slope_x, slope_y (n,): dz/dx and dz/dy.

    The normal halves the angle: ``n ~ a / |a| + b / |b|``, a to the screen, b to the camera (spec 003 C-31).
    """
    to_screen, to_camera = screen_m - points_m, camera_m[:, None] - points_m
    normal = to_screen * np.sqrt(np.einsum("ij,ij->j", to_camera, to_camera))
    normal += to_camera * np.sqrt(np.einsum("ij,ij->j", to_screen, to_screen))
    return -normal[0] / normal[2], -normal[1] / normal[2]


def slope_sensitivity(
    points_m: FloatArray, camera_m: FloatArray, screen_m: FloatArray, d_screen: FloatArray
) -> FloatArray:
    """Return how slopes follow a shift of the screen point along one direction.

    Shapes: d_screen (3,), or (3, n) for a shift of each point's own.
    Returns (2, n): Change of slope_x and slope_y for this shift.
    """
    to_screen, to_camera = screen_m - points_m, camera_m[:, None] - points_m
    length_camera = np.sqrt(np.einsum("ij,ij->j", to_camera, to_camera))
    length_screen = np.sqrt(np.einsum("ij,ij->j", to_screen, to_screen))
    normal = to_screen * length_camera + to_camera * length_screen
    shift = d_screen.reshape(3, -1)
    d_normal = shift * length_camera + to_camera * ((shift * to_screen).sum(axis=0) / length_screen)
    slope = -normal[:2] / normal[2]
    return np.asarray(-(d_normal[:2] + slope * d_normal[2]) / normal[2])


class Align(StrEnum):
    """To which orientation the slopes refer."""

    NORMAL = "normal"
    OUTLINE = "outline"


def alignment_words(align: Align, n_facets: int) -> str:
    """Say what the alignment took out of the slopes of a mirror of so many facets."""
    if align is Align.OUTLINE:
        return "nothing; the orientation is that of the pose"
    if n_facets == 1:
        return "mean tilt, by turning the mirror's frame until the best-fit surface has the design's normal"
    return "mean tilt of the ensemble, by turning its frame; the canting of single facets is kept"


@dataclass(frozen=True, slots=True, eq=False)
class FacetSamples:
    """Some pixels of one facet: enough to find its smooth shape.

    facet: The facet with its design.
    rays_cam (3, n): Lines of sight in the camera frame.
    screen_cam_m (3, n): Screen points seen there, in the camera frame [m].
    """

    facet: Facet
    rays_cam: FloatArray
    screen_cam_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RoundLimits:
    """How long to look for the shape.

    outer: Rounds between shape and slopes.
    reweighting: Rounds of reweighting in each fit; 1 is plain least squares. The biweight settles to round-off
        within 12 on measured facets.
    must_settle: Raise when the last round still changes a slope.
    """

    outer: int = 30
    reweighting: int = 12
    must_settle: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class ShapeSolution:
    """Pose and smooth shapes that agree with the slopes they give.

    cam_from_mirror: Pose of the mirror (of the ensemble), aligned if that was asked for.
    surfaces: The smooth shape of each facet in its own frame.
    tilt_rad (n_facets, 2): Slope of each facet against its design at its reference point, in the aligned frame
        [rad].
    iterations: Rounds until no slope changed by more than 1e-9 rad.
    """

    cam_from_mirror: RigidTransform
    surfaces: tuple[FittedSurface, ...]
    tilt_rad: FloatArray
    iterations: int


def start_surface(facet: Facet) -> FittedSurface:
    """Return the design of a facet with no correction yet, scaled to the facet's size."""
    half_size = 0.5 * float(np.ptp(facet.outline_m, axis=0).max())
    terms = (SHAPE_DEGREE + 1) * (SHAPE_DEGREE + 2) // 2
    return FittedSurface(facet.design, np.zeros(terms), np.asarray(facet.reference_point_m), half_size)


def solve_shape(
    samples: Sequence[FacetSamples],
    cam_from_mirror: RigidTransform,
    *,
    align: bool,
    start: ShapeSolution | None = None,
    rounds: RoundLimits | None = None,
) -> ShapeSolution:
    """Find the smooth shape of each facet, and the tilt of the mirror, that the measured slopes themselves give.

    cam_from_mirror: Pose of the mirror from its outline.
    align: Turn the mirror frame about its reference point until the mean tilt against the design is zero: an
        outline fixes the tilt only to some 10 mrad, the slopes to microradians.
    start: Shapes of a neighbouring problem to begin with.
    rounds: How many rounds, and whether the fits are robust.
    Returns: The consistent pose and shapes.
    EstimationError: The rounds do not settle.

    Each round: intersect the lines of sight with the current shapes, slopes there, least-squares polynomial of the
    slope errors against the design (height zero at the reference point, which the pose fixes), new tilt. The tilt is
    the slope at the reference point of the best-fit quadratic ``dz/dx = 2 A x + C + E y``,
    ``dz/dy = 2 B y + D + E x`` (spec 003 C-32: C and D), robust so that the frame follows the bulk of the mirror and
    not a turned-down edge. The design
    normal at the reference point is compared with the measured one as directions, so facets away from the vertex of
    their optic, whose design is itself tilted there, are left where they are.
    """
    surfaces = tuple(start_surface(sample.facet) for sample in samples) if start is None else start.surfaces
    pose = cam_from_mirror
    limits = rounds or RoundLimits()
    before = [np.zeros((2, sample.rays_cam.shape[1])) for sample in samples]
    near: Sequence[_FacetFit | None] = [None] * len(samples)
    for iteration in range(1, limits.outer + 1):
        fits = [
            _fit_facet(sample, surface, pose @ sample.facet.ensemble_from_facet, limits.reweighting, old)
            for sample, surface, old in zip(samples, surfaces, near, strict=True)
        ]
        near, surfaces = fits, tuple(fit.surface for fit in fits)
        errors = [fit.slope_error for fit in fits]
        tilts = np.array([fit.tilt_rad for fit in fits])
        change = max(float(np.nanmax(np.abs(now - old))) for now, old in zip(errors, before, strict=True))
        before = errors
        if align:
            pose, turned = _aligned(pose, samples, tilts)
            change = max(change, turned)
        if change < SLOPE_TOLERANCE_RAD:
            return ShapeSolution(pose, surfaces, tilts, iteration)
        if not change < _NO_SURFACE:
            break
    if not limits.must_settle and change < _NO_SURFACE:
        return ShapeSolution(pose, surfaces, tilts, limits.outer)
    changes = f"still changes by {change:.2g} rad" if change < _NO_SURFACE else "runs away"
    raise EstimationError(
        f"slopes: after {iteration} rounds a slope {changes} between shape and slopes; "
        "check the screen's size and pose, the mirror's pose and distance, the design's focal length (in metres), and "
        "that nothing hides a part of the mirror, whose edge was taken for its outline"
    )


class _FacetFit(NamedTuple):
    """What one round gave for one facet: its shape, its slope errors (2, n) and its tilt (2,).

    quadratic (5,): What the tilt is part of, as `_fit_potential` returns it.
    """

    surface: FittedSurface
    slope_error: FloatArray
    tilt_rad: FloatArray
    quadratic: FloatArray


def _fit_facet(
    sample: FacetSamples,
    surface: FittedSurface,
    cam_from_facet: RigidTransform,
    reweighting: int,
    near: _FacetFit | None,
) -> _FacetFit:
    """Fit shape and tilt of one facet once; the fit of the round before is near."""
    facet_from_cam = cam_from_facet.inverse()
    camera = facet_from_cam.translation_m
    screen = facet_from_cam.rotation @ sample.screen_cam_m + camera[:, None]
    # Where nothing settles the shape runs away, which is found below.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        points = surface.intersect(camera, facet_from_cam.rotation @ sample.rays_cam)
        error = np.stack(slopes_at(points, camera, screen)) - np.stack(surface.design.gradient(points[0], points[1]))
    near_shape, near_quadratic = (None, None) if near is None else (near.surface.coefficients_m[1:], near.quadratic)
    shape = _fit_potential(surface, points, error, SHAPE_DEGREE, reweighting, near_shape)
    quadratic = _fit_potential(surface, points, error, 2, reweighting, near_quadratic)
    # The height of the polynomial stays zero at the reference point.
    moved = replace(surface, coefficients_m=np.concatenate([[0.0], shape]))
    return _FacetFit(moved, error, quadratic[:2] / surface.scale_m, quadratic)


def tilt_of(facet: Facet, places_m: FloatArray, slope_error: FloatArray) -> FloatArray:
    """Return the tilt of a facet as `solve_shape` has it, (2,): that of the best-fit quadratic at its reference point.

    places_m, slope_error (2, n): Places on the facet [m], slopes there minus the design's.
    """
    surface = start_surface(facet)
    return _fit_potential(surface, places_m, slope_error, 2, RoundLimits().reweighting, None)[:2] / surface.scale_m


def sigma_of_tilt(facet: Facet, places_m: FloatArray, sigma_slope: FloatArray) -> FloatArray:
    """Return the standard deviation of `tilt_of` by independent errors of the slopes, (2,).

    places_m, sigma_slope (2, n): Places on the facet [m], standard deviations of both slopes there.
    EstimationError: Places on one line, which do not tell a tilt from a bend.
    """
    surface = start_surface(facet)
    u, v = (places_m - surface.center_m[:, None]) / surface.scale_m
    matrix = gradient_terms(u, v, 2).swapaxes(0, 1).reshape(-1, 2 * u.size)
    if np.linalg.matrix_rank(matrix) < len(matrix):
        raise EstimationError(f"slopes: {u.size} places on one line of the facet do not tell its tilt from its bend")
    return np.asarray(np.linalg.norm(np.linalg.pinv(matrix.T)[:2] * sigma_slope.ravel(), axis=1))


def _fit_potential(
    surface: FittedSurface,
    points_m: FloatArray,
    slope_error: FloatArray,
    degree: int,
    reweighting: int,
    near: FloatArray | None,
) -> FloatArray:
    """Fit slopes by the gradient of one polynomial, robustly: Tukey's biweight in each axis (95 % efficient).

    near (n_terms - 1,): Coefficients to begin reweighting with, instead of those of plain least squares.
    """
    places = (points_m[:2] - surface.center_m[:, None]) / surface.scale_m
    usable = (np.abs(places) < _OFF_FACET).all(axis=0) & np.isfinite(slope_error).all(axis=0)
    if np.count_nonzero(usable) < (degree + 1) * (degree + 2) // 2:
        raise EstimationError(
            f"slopes: only {np.count_nonzero(usable)} of {usable.size} lines of sight meet the mirror's surface; check "
            "the camera (focal length and center in pixels), the mirror's pose and its design (all in metres)"
        )
    u, v = places[:, usable]
    matrix = gradient_terms(u, v, degree).swapaxes(0, 1).reshape(-1, 2 * u.size) / surface.scale_m
    target = slope_error[:, usable]

    def weight_of(coefficients: FloatArray) -> FloatArray:
        residual = target - (coefficients @ matrix).reshape(2, -1)
        limit = _BIWEIGHT_MEDIANS * np.median(np.abs(residual), axis=1, keepdims=True)
        return Tukey(1.0).weight(residual / np.maximum(limit, SLOPE_TOLERANCE_RAD)).ravel()

    is_robust = reweighting > 1
    coefficients: FloatArray = np.zeros(len(matrix)) if near is None or not is_robust else near
    weight = np.ones(2 * u.size) if near is None or not is_robust else weight_of(near)
    for _ in range(reweighting):
        weighted = matrix * weight
        # Least squares, not solve: a facet seen on one line of pixels has no shape across it, and needs none.
        solved = np.linalg.lstsq(weighted @ matrix.T, weighted @ target.ravel(), rcond=1e-13)[0]
        before, coefficients = coefficients, np.asarray(solved, dtype=np.float64)
        if not is_robust or np.abs(coefficients - before).max() < SETTLED * np.abs(coefficients).max():
            break
        weight = weight_of(coefficients)
    return np.asarray(coefficients)


def gradient_terms(u: FloatArray, v: FloatArray, degree: int) -> FloatArray:
    """Return the derivatives of all monomials but the constant.

    Shapes: u, v (n,).
    degree: Highest total degree.
    Returns (2, n_terms - 1, n): Derivative after u and after v of each monomial of
        `heliogauge.slopes.map.monomials`.
    """
    inner = monomials(u, v, degree - 1)
    terms = np.zeros((2, (degree + 1) * (degree + 2) // 2, u.size))
    for order in range(1, degree + 1):
        first, below = order * (order + 1) // 2, order * (order - 1) // 2
        for power_v in range(order + 1):
            if power_v < order:
                terms[0, first + power_v] = (order - power_v) * inner[below + power_v]
            if power_v > 0:
                terms[1, first + power_v] = power_v * inner[below + power_v - 1]
    return terms[:, 1:]


def _aligned(
    pose: RigidTransform, samples: Sequence[FacetSamples], tilts_rad: FloatArray
) -> tuple[RigidTransform, float]:
    """Turn the mirror frame about its reference point by the mean tilt against the design, weighted by area."""
    facets = [sample.facet for sample in samples]
    areas = np.array([facet.area_m2 for facet in facets])
    pivots, before, after = [], [], []
    for facet, tilt in zip(facets, tilts_rad, strict=True):
        x_m, y_m = facet.reference_point_m
        design = np.array([float(slope) for slope in facet.design.gradient(x_m, y_m)])
        pivots.append(facet.ensemble_from_facet.apply([x_m, y_m, float(facet.design.height(x_m, y_m))]))
        before.append(facet.ensemble_from_facet.rotate([*-design, 1.0]))
        after.append(facet.ensemble_from_facet.rotate([*-(design + tilt), 1.0]))
    pivot = areas @ np.array(pivots) / areas.sum()
    rotation = rotation_between(areas @ np.array(before), areas @ np.array(after))
    turned = float(np.linalg.norm(rotation - np.eye(3)))
    return pose @ RigidTransform(rotation, pivot - rotation @ pivot), turned
