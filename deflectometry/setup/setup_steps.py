"""What may be wrong with camera and screen: independent steps of one sigma, and the setup after them."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from deflectometry.setup.camera_and_screen import Screen, Setup
from deflectometry.setup.smooth_screen import SmoothWarp
from heliogauge.validate import AnyFloatArray, FloatArray

#: Source of the modes of single facets that may show other points of the pattern.
PLACE_IN_PATTERN = "place in the pattern"


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

    def shifts_m(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Return the shifts of the points that show (u, v), shape (..., 3) [m]."""
        shifts = np.zeros((*np.shape(u), 3))
        shifts[..., self.axis] = self.rms_m * _legendre(self.order[0], u) * _legendre(self.order[1], v)
        return shifts

    def scaled(self, amount: float) -> "Warp":
        """Return the shape times an amount."""
        return replace(self, rms_m=amount * self.rms_m)


def _legendre(order: int, fraction: FloatArray) -> FloatArray:
    """Return the Legendre polynomial of order 0 to 2 over fractions 0 to 1, scaled to RMS 1."""
    centred = 2 * fraction - 1
    values = (np.ones_like(centred), centred, 1.5 * centred**2 - 0.5)[order]
    return np.asarray(np.sqrt(2 * order + 1) * values)


@dataclass(frozen=True, slots=True, eq=False)
class WarpedScreen:
    """A screen with smooth shapes added to it."""

    screen: Screen
    warps: "tuple[Warp | SmoothWarp, ...]"

    def points_m(self, u: AnyFloatArray, v: AnyFloatArray) -> FloatArray:
        """Return the points that show display coordinates (u, v), shape (..., 3) [m]."""
        points = self.screen.points_m(u, v)
        wide, high = np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64)
        for warp in self.warps:
            points += warp.shifts_m(wide, high)
        return points

    def describe(self) -> str:
        """Return the screen in words."""
        return f"{self.screen.describe()} as stated, size and shape adjusted"


@dataclass(frozen=True, slots=True, eq=False)
class SetupStep:
    """One sigma of one independent error of the setup.

    source: Which of its uncertainties it belongs to: "screen pose", "camera", "screen size" ...
    cam_from_screen (6,): Step of the screen's pose, as `RigidTransform.moved` takes it.
    camera (10,): Step of the camera's parameters.
    warp: Shape that is added to the screen; None for none.
    facets: Facets that it concerns; None for all.
    """

    source: str
    cam_from_screen: FloatArray = field(default_factory=lambda: np.zeros(6))
    camera: FloatArray = field(default_factory=lambda: np.zeros(10))
    warp: Warp | SmoothWarp | None = None
    facets: frozenset[str] | None = None

    @property
    def moves_pose(self) -> bool:
        """Whether camera or the screen's pose move, which a mirror's pose found in the image follows."""
        return bool(self.cam_from_screen.any() or self.camera.any())


def moved_setup(setup: Setup, steps: Sequence[SetupStep], amounts: FloatArray) -> Setup:
    """Return a setup after steps, each times its amount; its sigmas stay."""
    pose = sum((amount * one.cam_from_screen for one, amount in zip(steps, amounts, strict=True)), np.zeros(6))
    camera = sum((amount * one.camera for one, amount in zip(steps, amounts, strict=True)), np.zeros(10))
    warps = tuple(
        one.warp.scaled(float(amount))
        for one, amount in zip(steps, amounts, strict=True)
        if one.warp is not None and amount != 0
    )
    return replace(
        setup,
        cam_from_screen=setup.cam_from_screen.moved(pose) if pose.any() else setup.cam_from_screen,
        camera=setup.camera.with_parameters(setup.camera.parameters + camera) if camera.any() else setup.camera,
        screen=WarpedScreen(setup.screen, warps) if warps else setup.screen,
    )


def setup_steps(setup: Setup) -> Iterator[SetupStep]:
    """Yield the independent errors of camera and screen, one sigma each."""
    if not setup.are_errors_joint:
        for step in principal_steps(setup.covariance_cam_from_screen):
            yield SetupStep("screen pose", cam_from_screen=step)
        for step in principal_steps(setup.camera.covariance):
            yield SetupStep("camera", camera=step)
    if setup.sigma_screen_points_m > 0:
        for warp in _screen_warps(setup.sigma_screen_points_m):
            yield SetupStep("screen shape", warp=warp)
    for source, warp in _screen_sizes(setup):
        yield SetupStep(source, warp=warp)
    for one in setup.shared_errors:
        source = "camera and screen" if setup.are_errors_joint and one.moves_pose else "screen geometry"
        yield SetupStep(
            source,
            cam_from_screen=one.cam_from_screen,
            camera=one.camera,
            warp=one.warp if one.warp.coefficients.any() else None,
        )
    size_m = setup.size_m
    for shift in setup.facet_shifts:
        for axis in np.flatnonzero(shift.sigma > 0).tolist():
            warp = Warp(axis, (0, 0), float(shift.sigma[axis] * size_m[axis]))
            yield SetupStep(PLACE_IN_PATTERN, warp=warp, facets=shift.facets)


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
    size_m = setup.size_m
    # v runs downwards: a greater height moves the points of large v to smaller y.
    for axis, (order, sign) in enumerate((((1, 0), 1.0), ((0, 1), -1.0))):
        if setup.sigma_size_m[axis] > 0:
            yield "screen size", Warp(axis, order, sign * float(setup.sigma_size_m[axis]) / math.sqrt(12.0))
        if setup.sigma_periods[axis] > 0:
            by_periods = float(setup.sigma_periods[axis] * size_m[axis])
            yield "fringe periods", Warp(axis, order, by_periods / math.sqrt(12.0))
        if setup.sigma_shift[axis] > 0:
            # A shift may be large, and what it does to the curvature is a parabola whose bottom may be near: a step to
            # each side, with half of the variance each.
            for way in (1.0, -1.0):
                shift_m = way * float(setup.sigma_shift[axis] * size_m[axis]) / math.sqrt(2.0)
                yield "known point", Warp(axis, (0, 0), shift_m)
    if setup.sigma_sag_m > 0:
        for order in ((2, 0), (0, 2)):
            yield "screen sag", Warp(2, order, setup.sigma_sag_m * 2.0 / (3.0 * math.sqrt(5.0)))
