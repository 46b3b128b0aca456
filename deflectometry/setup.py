"""What stands where in a deflectometry measurement: camera, screen and their relative pose (a description, no estimate)."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from heliogauge.camera import Camera
from heliogauge.errors import InputError
from heliogauge.rigid import RigidTransform
from heliogauge.validate import FloatArray, covariance_matrix, float_array, freeze, positive


class Screen(Protocol):
    """A surface that shows a pattern: display coordinates to points.

    Notes
    -----
    Display coordinates are fractions of the displayed image: u from its left edge, v from its top edge. The screen
    frame has x to the right and y up as a viewer sees the screen, z towards the viewer.
    """

    def points_m(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Return the points that show display coordinates (u, v), shape (..., 3) [m]."""

    def describe(self) -> str:
        """Return the screen in words."""


@dataclass(frozen=True, slots=True, eq=False)
class RectangularScreen:
    """A flat rectangular screen whose frame has its origin in the middle.

    Parameters
    ----------
    width_m, height_m : float
        Size of the displayed image [m].
    """

    width_m: float
    height_m: float

    def __post_init__(self) -> None:
        positive("screen width_m", self.width_m, "metres")
        positive("screen height_m", self.height_m, "metres")

    def points_m(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Return the points that show display coordinates (u, v), shape (..., 3) [m]."""
        points = np.zeros((*np.shape(u), 3))
        points[..., 0] = (np.asarray(u, dtype=np.float64) - 0.5) * self.width_m
        points[..., 1] = (0.5 - np.asarray(v, dtype=np.float64)) * self.height_m
        return points

    def describe(self) -> str:
        """Return the screen in words."""
        return f"flat rectangular screen {self.width_m:g} m x {self.height_m:g} m"


@dataclass(frozen=True, slots=True, eq=False)
class TabulatedScreen:
    """A screen known by measured points; linear interpolation between them (Delaunay triangles).

    Parameters
    ----------
    u, v : array_like, shape (n,)
        Display coordinates of the measured points.
    xyz_m : array_like, shape (n, 3)
        Where these points are in the screen frame [m].
    lattice : int
        Nodes per side of the regular lattice that holds the interpolated table. With 513 the lattice of the
        9 m x 3.5 m reference wall follows its triangles to 0.01 mm.

    Raises
    ------
    InputError
        Fewer than 3 points, or all on one line.
    """

    u: FloatArray
    v: FloatArray
    xyz_m: FloatArray
    lattice: int = 513
    _table: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name in ("u", "v"):
            object.__setattr__(self, name, float_array(f"screen table {name}", getattr(self, name), (None,)))
        object.__setattr__(self, "xyz_m", float_array("screen table xyz_m", self.xyz_m, (self.u.size, 3)))
        object.__setattr__(self, "_table", freeze(self._interpolate_table()))

    def _interpolate_table(self) -> FloatArray:
        raise InputError("screen table: replaced below")

    def points_m(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Return the points that show display coordinates (u, v), shape (..., 3) [m]; NaN outside the table."""
        raise InputError("screen table: replaced below")

    def describe(self) -> str:
        """Return the screen in words."""
        extent = self.xyz_m.max(axis=0) - self.xyz_m.min(axis=0)
        return f"screen of {self.u.size} measured points over {extent[0]:.3f} m x {extent[1]:.3f} m"


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """Camera and screen in one frame.

    Parameters
    ----------
    camera : Camera
        The camera with the covariance of its parameters.
    screen : Screen
        The screen in its own frame.
    cam_from_screen : RigidTransform
        Screen frame to camera frame.
    covariance_cam_from_screen : array_like, shape (6, 6)
        Covariance of the steps of `RigidTransform.moved`: rotation [rad], then translation [m]. Zero: exact.
    sigma_screen_points_m : float
        Standard deviation of the screen's shape [m].
    """

    camera: Camera
    screen: Screen
    cam_from_screen: RigidTransform
    covariance_cam_from_screen: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))
    sigma_screen_points_m: float = 0.0

    def __post_init__(self) -> None:
        matrix = covariance_matrix("covariance_cam_from_screen", self.covariance_cam_from_screen, 6)
        object.__setattr__(self, "covariance_cam_from_screen", matrix)
