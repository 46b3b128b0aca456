"""What stands where in a deflectometry measurement: camera, screen and their relative pose; nothing is estimated."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from deflectometry.setup.smooth_screen import SharedStep
from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import (
    AnyFloatArray,
    BoolArray,
    Float32Array,
    FloatArray,
    covariance_matrix,
    float_array,
    freeze,
    positive,
)


class Screen(Protocol):
    """A surface that shows a pattern: display coordinates to points.

    Display coordinates are fractions of the displayed image: u from its left edge, v from its top edge. The screen
    frame has x to the right and y up as a viewer sees the screen, z towards the viewer.
    """

    def points_m(self, u: AnyFloatArray, v: AnyFloatArray) -> FloatArray:
        """Return the points that show display coordinates (u, v), shape (..., 3) [m]."""

    def describe(self) -> str:
        """Return the screen in words."""


@dataclass(frozen=True, slots=True, eq=False)
class RectangularScreen:
    """A flat rectangular screen whose frame has its origin in the middle.

    width_m, height_m: Size of the displayed image [m].
    """

    width_m: float
    height_m: float

    def __post_init__(self) -> None:
        positive("screen width_m", self.width_m, "metres")
        positive("screen height_m", self.height_m, "metres")

    def points_m(self, u: AnyFloatArray, v: AnyFloatArray) -> FloatArray:
        """Return the points that show display coordinates (u, v), shape (..., 3) [m]."""
        points = np.zeros((*np.shape(u), 3))
        np.multiply(np.subtract(u, 0.5, dtype=np.float64), self.width_m, out=points[..., 0])
        np.multiply(np.subtract(0.5, v, dtype=np.float64), self.height_m, out=points[..., 1])
        return points

    def describe(self) -> str:
        """Return the screen in words."""
        return f"flat rectangular screen {self.width_m:g} m x {self.height_m:g} m"


#: Nodes per side of the lattice that holds an interpolated screen table. Bilinear interpolation between them follows
#: the spline of a wall that is 5 mm off over a tenth of its width to 4 um, a slope of 0.2 urad at 10 m.
LATTICE_NODES = 129
#: Points of a table for which one spline is solved at once.
TILE_POINTS = 150


@dataclass(frozen=True, slots=True, eq=False)
class TabulatedScreen:
    """A screen known by measured points, with the thin-plate spline through them in between.

    u, v (n,): Display coordinates of the measured points.
    xyz_m (n, 3): Where these points are in the screen frame [m].
    InputError: Fewer than 4 points, two points at the same display coordinates, or all on one line.

    The spline runs through every point and has no kinks: linear facets between measured points put steps into the
    curvature map (0.1 mm RMS of difference on a 121-point table of a 9 m wall, 5 urad of slope at 10 m).
    """

    u: FloatArray
    v: FloatArray
    xyz_m: FloatArray
    _affine: FloatArray = field(init=False, repr=False)
    _deviation_m: Float32Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name in ("u", "v"):
            object.__setattr__(self, name, float_array(f"screen table {name}", getattr(self, name), (None,)))
        object.__setattr__(self, "xyz_m", float_array("screen table xyz_m", self.xyz_m, (self.u.size, 3)))
        affine, deviation = _thin_plate_lattice(np.stack([self.u, self.v], axis=1), self.xyz_m)
        object.__setattr__(self, "_affine", freeze(affine))
        object.__setattr__(self, "_deviation_m", freeze(deviation))

    def points_m(self, u: AnyFloatArray, v: AnyFloatArray) -> FloatArray:
        """Return the points that show display coordinates (u, v), shape (..., 3) [m]; NaN off the display."""
        columns = np.atleast_1d(np.multiply(u, LATTICE_NODES - 1.0))
        rows = np.atleast_1d(np.multiply(v, LATTICE_NODES - 1.0))
        inside = (columns >= 0) & (columns <= LATTICE_NODES - 1) & (rows >= 0) & (rows <= LATTICE_NODES - 1)
        columns, rows = np.where(inside, columns, 0.0), np.where(inside, rows, 0.0)
        column = np.minimum(columns.astype(np.int32), LATTICE_NODES - 2)
        row = np.minimum(rows.astype(np.int32), LATTICE_NODES - 2)
        to_right = (columns - column).astype(np.float32)[..., None]
        down = (rows - row).astype(np.float32)[..., None]
        node = row * LATTICE_NODES + column
        corner = [self._deviation_m.take(node + step, axis=0) for step in (0, 1, LATTICE_NODES, LATTICE_NODES + 1)]
        upper = corner[0] + to_right * (corner[1] - corner[0])
        lower = corner[2] + to_right * (corner[3] - corner[2])
        points = (upper + down * (lower - upper)).astype(np.float64)
        points += self._affine[0]
        points += np.asarray(u, dtype=np.float64)[..., None] * self._affine[1]
        points += np.asarray(v, dtype=np.float64)[..., None] * self._affine[2]
        points[~inside] = np.nan
        return np.asarray(points.reshape(*np.shape(u), 3))

    def describe(self) -> str:
        """Return the screen in words."""
        extent = np.ptp(self.xyz_m, axis=0)
        return f"screen of {self.u.size} measured points over {extent[0]:.3f} m x {extent[1]:.3f} m"


def _thin_plate_lattice(nodes: FloatArray, values: FloatArray) -> tuple[FloatArray, Float32Array]:
    """Return the affine part (3, 3) of nodes (n, 2) -> values (n, 3), and the spline through the rest on a lattice."""
    count = len(nodes)
    polynomial = np.column_stack([np.ones(count), nodes])
    if count < 4 or np.linalg.matrix_rank(polynomial, tol=1e-6) < 3:
        raise InputError(f"screen table: {count} points given; at least 4 are needed that are not on one line")
    if len(np.unique(nodes, axis=0)) < count:
        raise InputError("screen table: two points have the same display coordinates u, v; remove one")
    affine = np.linalg.lstsq(polynomial, values, rcond=None)[0]
    rest = values - polynomial @ affine
    lattice = np.zeros((LATTICE_NODES, LATTICE_NODES, 3), dtype=np.float32)
    axis = np.linspace(0.0, 1.0, LATTICE_NODES)
    # A spline through n points costs n^3: large tables are done in tiles, each with the points half a tile around it.
    tiles = max(1, round(np.sqrt(count / TILE_POINTS)))
    for rows in np.array_split(np.arange(LATTICE_NODES), tiles):
        for columns in np.array_split(np.arange(LATTICE_NODES), tiles):
            targets = np.stack(np.meshgrid(axis[columns], axis[rows]), axis=-1)
            near = _points_around(nodes, targets, 0.5 / tiles)
            part = _thin_plate(nodes[near], rest[near], targets.reshape(-1, 2))
            lattice[np.ix_(rows, columns)] = part.reshape(*targets.shape[:2], 3)
    return np.asarray(affine), lattice.reshape(-1, 3)


def _points_around(nodes: FloatArray, targets: FloatArray, margin: float) -> BoolArray:
    """Return which points lie in or near a tile; at least a quarter of a tile's usual number, or all."""
    low, high = targets.min(axis=(0, 1)), targets.max(axis=(0, 1))
    while True:
        near = ((nodes >= low - margin) & (nodes <= high + margin)).all(axis=1)
        if margin > 1.0 or np.count_nonzero(near) >= TILE_POINTS // 4:
            return np.asarray(near)
        margin *= 2.0


def _thin_plate(nodes: FloatArray, values: FloatArray, targets: FloatArray) -> FloatArray:
    """Evaluate the thin-plate spline through nodes (n, 2) -> values (n, 3) at targets (m, 2)."""
    polynomial = np.column_stack([np.ones(len(nodes)), nodes])
    system = np.block([[_thin_plate_kernel(nodes, nodes), polynomial], [polynomial.T, np.zeros((3, 3))]])
    solution = np.linalg.solve(system, np.vstack([values, np.zeros((3, 3))]))
    spline = [
        _thin_plate_kernel(part, nodes) @ solution[: len(nodes)]
        for part in np.array_split(targets, 1 + len(targets) // 512)
    ]
    plane = np.column_stack([np.ones(len(targets)), targets]) @ solution[len(nodes) :]
    return np.asarray(np.concatenate(spline) + plane)


def _thin_plate_kernel(points: FloatArray, nodes: FloatArray) -> FloatArray:
    squared = np.subtract.outer(points[:, 0], nodes[:, 0]) ** 2
    squared += np.subtract.outer(points[:, 1], nodes[:, 1]) ** 2
    # r^2 log r^2 is zero at a node; the smallest normal number keeps the logarithm finite there.
    return np.asarray(squared * np.log(np.maximum(squared, np.finfo(np.float64).tiny)))


@dataclass(frozen=True, slots=True, eq=False)
class FacetShift:
    """How far the points that some facets show may be others of the pattern.

    facets: Their names.
    sigma (2,): Standard deviations of u and v that all their samples share.
    """

    facets: frozenset[str]
    sigma: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Setup(ShortRepr):
    """Camera and screen in one frame.

    camera: The camera with the covariance of its parameters.
    screen: The screen in its own frame.
    covariance_cam_from_screen (6, 6): Covariance of the steps of `RigidTransform.moved`: rotation [rad], then
        translation [m]. Zero: exact.
    sigma_screen_points_m: Standard deviation of the screen's shape [m].
    sigma_size_m (2,): Standard deviations of its width and height [m].
    sigma_sag_m: Standard deviation of how far its middle stands out of the plane of its edges [m].
    sigma_periods (2,): Relative standard deviations of the scale of u and of v, where periods were estimated.
    sigma_shift (2,): Standard deviations of u and v that all pixels share, where orders were counted from a point.
    shared_errors: Independent errors of the screen's points and its pose together, where both were measured.
    are_errors_joint: Whether all errors of the camera and of the screen's pose are among `shared_errors`, because they
        hang together; the two covariances are then their shares.
    facet_shifts: What is open of single facets beside `sigma_shift`, where each counts for itself.
    """

    camera: Camera
    screen: Screen
    cam_from_screen: RigidTransform
    covariance_cam_from_screen: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))
    sigma_screen_points_m: float = 0.0
    sigma_size_m: FloatArray = field(default_factory=lambda: np.zeros(2))
    sigma_sag_m: float = 0.0
    sigma_periods: FloatArray = field(default_factory=lambda: np.zeros(2))
    sigma_shift: FloatArray = field(default_factory=lambda: np.zeros(2))
    shared_errors: tuple[SharedStep, ...] = ()
    are_errors_joint: bool = False
    facet_shifts: tuple[FacetShift, ...] = ()

    def __post_init__(self) -> None:
        matrix = covariance_matrix("covariance_cam_from_screen", self.covariance_cam_from_screen, 6)
        object.__setattr__(self, "covariance_cam_from_screen", matrix)

    @property
    def size_m(self) -> FloatArray:
        """Width and height of the displayed image through its middle, shape (2,) [m]."""
        corners = self.screen.points_m(np.array([0.0, 1.0, 0.5, 0.5]), np.array([0.5, 0.5, 0.0, 1.0]))
        return np.asarray(np.linalg.norm(corners[[1, 3]] - corners[[0, 2]], axis=1))
