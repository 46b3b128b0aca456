"""Where the mirror stands among the points of a scan: its pose with covariance, and what the shape leaves free."""

from dataclasses import dataclass

import numpy as np

from deflectometry.shape.facet_pixels import spread_indices
from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Quadric
from heliogauge.slopes.map import CommonModes, monomials, no_common_modes
from heliogauge.validate import BoolArray, FloatArray
from photogrammetry.surface import DesignSurface, SurfaceFit, SurfacePoints, fit_surface

#: Points of the fit: its covariance is that of all of them together. With 0.1 mm each, 200 hold a tilt to 10 urad.
_POINTS = 200
_MODE_DEGREE = 2
#: Points from the back of a curved mirror fit it less well than from its front by more than this factor.
_FROM_BEHIND = 2.0
#: Slope error of a usual mirror: what it does to the place of a design is no better known.
_USUAL_ERROR_RAD = 1e-3
#: Fits whose RMS differ by less than this share are equally good.
_EQUAL = 1.05


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """The pose of a mirror among points.

    mirror_from_points: From the frame of the points to that of the mirror.
    covariance (6, 6): Of a step of it from errors of the points: turn [rad] and shift [m].
    held: Motions that the shape of the mirror leaves free; they stay as they were at the start.
    open_words: What the start left open; empty where nothing is.
    rms_m: RMS distance of the points from the design [m].
    outliers (n,): Points of the scan far from all others; only those of the fit can be among them.
    """

    mirror_from_points: RigidTransform
    covariance: FloatArray
    held: tuple[str, ...]
    open_words: str
    rms_m: float
    outliers: BoolArray


def register(
    points_m: FloatArray, design: DesignSurface, viewer_m: FloatArray, sigma_m: float, x_axis: FloatArray | None = None
) -> Registration:
    """Fit the design to points by orthogonal distances.

    points_m (n, 3): Points of the surface [m].
    viewer_m (3,): A point in front of the mirror [m].
    sigma_m: Standard deviation of each coordinate [m].
    x_axis (3,): About which way the mirror's x axis points among the points; None: along their principal axes.
    EstimationError: The design does not fit, or fits only from behind.

    Motions that leave the design as it is, and those that it hardly feels, are held
    (`photogrammetry.surface.fit_surface`).
    """
    place = _placed(points_m, design, viewer_m, sigma_m, x_axis)
    _refuse_from_behind(place.rms_m, points_m, design, viewer_m, sigma_m, x_axis)
    return place


def _placed(
    points_m: FloatArray, design: DesignSurface, viewer_m: FloatArray, sigma_m: float, x_axis: FloatArray | None
) -> Registration:
    """Fit the design to points as they are seen from one side."""
    few = spread_indices(len(points_m), _POINTS)
    starts = _starts(points_m, viewer_m, x_axis)
    if (slide := _slide_m(design, starts[0], points_m)) > 0:
        return _levelled(points_m, design.quadric, starts[0], sigma_m, slide, given_axis=x_axis is not None)
    points = SurfacePoints(tuple(map(str, few.tolist())), points_m[few], sigma_m**2 * np.eye(3 * few.size))
    fit, open_words = _best_fit(points, design, starts)
    outliers = np.zeros(len(points_m), dtype=np.bool_)
    outliers[few] = fit.outliers
    return Registration(
        fit.design_from_world,
        np.asarray(fit.parameters.covariance_measurement[:6, :6]),
        fit.held,
        open_words,
        fit.rms_deviation_m,
        outliers,
    )


def _slide_m(design: DesignSurface, start: RigidTransform, points_m: FloatArray) -> float:
    """Return how far a slope error slides a shallow design along the mirror; 0 where the shape holds it better [m].

    Where that is more than the spacing of the points, the edge of what was scanned knows the place better.
    """
    inside = start.apply(points_m)
    extent = np.ptp(inside[:, :2], axis=0)
    surface = design.quadric
    reach = 0.25 * float(extent.max())
    places = reach * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    slopes = np.stack(surface.gradient(places[:, 0], places[:, 1]))
    bends = np.abs([slopes[0, 0] - slopes[0, 1], slopes[1, 2] - slopes[1, 3]]) / (2 * reach)
    if not bends.max() > 0:
        return float("inf")
    slide = _USUAL_ERROR_RAD / float(bends.max())
    return slide if slide > float(np.sqrt(np.prod(extent) / len(points_m))) else 0.0


def _levelled(
    points_m: FloatArray,
    design: Quadric,
    start: RigidTransform,
    sigma_m: float,
    slide_m: float,
    *,
    given_axis: bool,
) -> Registration:
    """Fit height and tilts of a shallow design, its middle where the middle of the scanned mirror is."""
    pose = start
    kept = np.ones(len(points_m), dtype=np.bool_)
    for _ in range(8):
        inside = pose.apply(points_m)
        left = inside[:, 2] - design.height(inside[:, 0], inside[:, 1])
        terms = np.column_stack([np.ones(len(left)), inside[:, :2]])
        rise = np.linalg.lstsq(terms[kept], left[kept], rcond=None)[0]
        rest = left - terms @ rise
        kept = np.abs(rest) < 5 * max(robust_scale(rest), 1e-9)
        # What rises by t along x is turned back about y.
        pose = pose.moved(np.array([-rise[2], rise[1], 0.0, 0.0, 0.0, -rise[0]]))
    inverse = sigma_m**2 * np.linalg.inv(terms[kept].T @ terms[kept])
    covariance = np.zeros((6, 6))
    order = [5, 1, 0]
    signs = np.array([1.0, 1.0, -1.0])
    covariance[np.ix_(order, order)] = inverse * np.outer(signs, signs)
    reach = "any length" if np.isinf(slide_m) else f"{slide_m:.2g} m"
    held = (f"shift in x and y (a slope error of 1 mrad would slide the design by {reach})", "turn about z")
    words = "" if given_axis else "x was put along the longer side of the points; give x_axis in [points]"
    return Registration(pose, covariance, held, words, float(np.sqrt(np.mean(rest[kept] ** 2))), ~kept)


def _starts(points_m: FloatArray, viewer_m: FloatArray, x_axis: FloatArray | None) -> list[RigidTransform]:
    """Return where the mirror's frame may stand: in the middle of the points, z to the viewer, x by quarters."""
    middle = points_m.mean(axis=0)
    _, singular, axes = np.linalg.svd(points_m - middle, full_matrices=False)
    if singular[1] < 1e-6 * singular[0]:
        raise EstimationError(f"{len(points_m)} points on a line; points of a surface are needed")
    z = axes[2] if axes[2] @ (viewer_m - middle) >= 0 else -axes[2]
    along = axes[0] if x_axis is None else x_axis - (x_axis @ z) * z
    length = float(np.linalg.norm(along))
    if x_axis is not None and not length > 0.1 * float(np.linalg.norm(x_axis)):
        raise InputError("x_axis in [points] points out of the mirror; the mirror's x axis lies along it, nearly")
    x = along / length
    found = []
    for quarter in range(4 if x_axis is None else 1):
        first = np.cos(0.5 * np.pi * quarter) * x + np.sin(0.5 * np.pi * quarter) * np.cross(z, x)
        rotation = np.stack([first, np.cross(z, first), z])
        # The frame's origin is in the middle of what the mirror covers, not in that of its points.
        inside = (points_m - middle) @ rotation.T
        center = 0.5 * (inside[:, :2].min(axis=0) + inside[:, :2].max(axis=0))
        found.append(RigidTransform(rotation, -rotation @ middle - [*center, 0.0]))
    return found


def _best_fit(points: SurfacePoints, design: DesignSurface, starts: list[RigidTransform]) -> tuple[SurfaceFit, str]:
    """Return the best of the fits from several starts, and what these leave open."""
    fits, last = [], None
    for start in starts:
        try:
            fits.append(fit_surface(points, design, start))
        except EstimationError as error:
            last = error
    if not fits:
        raise EstimationError(f"the design does not fit the points: {last}") from last
    best = min(fits, key=lambda one: one.rms_deviation_m)
    good = sum(one.rms_deviation_m <= _EQUAL * best.rms_deviation_m for one in fits)
    words = (
        f"{good} ways to turn the mirror by quarters fit the points equally well: x was put along their longer side; "
        "give x_axis in [points]"
    )
    return (fits[0] if good == len(fits) else best), (words if good > 1 else "")


def _refuse_from_behind(
    rms_m: float,
    points_m: FloatArray,
    design: DesignSurface,
    viewer_m: FloatArray,
    sigma_m: float,
    x_axis: FloatArray | None,
) -> None:
    """Refuse points that fit the design from behind much better than from the front, by rms_m."""
    if rms_m < 3 * sigma_m:
        return
    try:
        other = _placed(points_m, design, 2 * points_m.mean(axis=0) - viewer_m, sigma_m, x_axis)
    except EstimationError:
        return
    if rms_m > _FROM_BEHIND * other.rms_m:
        stood = ", ".join(f"{one:.4g}" for one in viewer_m)
        raise EstimationError(
            f"the points lie {1e3 * rms_m:.3g} mm RMS off the design seen from scanner_m = [{stood}] (unless stated, "
            f"the origin of the points), and {1e3 * other.rms_m:.3g} mm seen from the other side: the mirror is "
            "upside down, or scanner_m in [points] is not in front of it"
        )


def given_place(count: int) -> Registration:
    """Return the registration of points that are in the mirror's frame already."""
    none = np.zeros(count, dtype=np.bool_)
    return Registration(RigidTransform.identity(), np.zeros((6, 6)), (), "", float("nan"), none)


def common_modes(design: Quadric, place: Registration, outline_m: FloatArray, sigma_scale: float) -> CommonModes:
    """Return what errors of the pose and of the scanner's scale do to all slopes together.

    outline_m (n, 2): Places that show how far the mirror reaches [m].
    sigma_scale: Relative standard deviation of lengths.
    """
    low, high = outline_m.min(axis=0), outline_m.max(axis=0)
    center, scale = 0.5 * (low + high), 0.5 * float((high - low).max())
    steps = np.linspace(-1, 1, 5)
    u, v = (one.ravel() for one in np.meshgrid(steps, steps))
    x, y = center[0] + scale * u, center[1] + scale * v
    at = np.stack(design.gradient(x, y))
    modes, names = [], []
    variances, vectors = np.linalg.eigh(place.covariance)
    for variance, vector in zip(variances, vectors.T, strict=True):
        if variance > 1e-12 * max(variances[-1], 1e-300):
            moved = design.transformed(RigidTransform.identity().moved(np.sqrt(variance) * vector))
            modes.append(np.stack(moved.gradient(x, y)) - at)
            names.append("mirror pose")
    if sigma_scale > 0:
        # Lengths too long by s: the slope at a place is that of the place nearer to the middle by s.
        shrunk = design.gradient(center[0] + scale * u * (1 - sigma_scale), center[1] + scale * v * (1 - sigma_scale))
        modes.append(np.stack(shrunk) - at)
        names.append("scanner scale")
    if not modes:
        return no_common_modes()
    values = np.nan_to_num(np.stack(modes)).reshape(-1, u.size)
    terms = monomials(u, v, _MODE_DEGREE)
    found = np.asarray(np.linalg.lstsq(terms.T, values.T, rcond=None)[0].T, dtype=np.float64)
    return CommonModes(tuple(names), found.reshape(len(names), 2, -1), center, scale)
