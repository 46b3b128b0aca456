"""A smooth surface over the display, measured; and smooth errors of it that are shared with the camera's pose."""

import math
from dataclasses import dataclass, field

import numpy as np

from heliogauge.slopes.map import monomials
from heliogauge.validate import AnyFloatArray, FloatArray, freeze


def display_terms(u: AnyFloatArray, v: AnyFloatArray, terms: int) -> FloatArray:
    """Return the monomials of u and v, from -1 to 1 over the display, shape (..., terms)."""
    wide, high = (2.0 * np.asarray(one, dtype=np.float64) - 1.0 for one in (u, v))
    degree = degree_of(terms)
    return np.asarray(np.moveaxis(np.asarray(monomials(wide, high, degree)), 0, -1))


def degree_of(terms: int) -> int:
    """Return the degree of the polynomials in two variables that have so many terms.

    >>> degree_of(3), degree_of(15)
    (1, 4)
    """
    return round((math.sqrt(8.0 * terms + 1.0) - 3.0) / 2.0)


def terms_of(degree: int) -> int:
    """Return the number of terms of polynomials in two variables."""
    return (degree + 1) * (degree + 2) // 2


@dataclass(frozen=True, slots=True, eq=False)
class SmoothScreen:
    """A display whose surface is a polynomial of its fractions.

    coefficients (terms, 3): Of the monomials of u and v, from -1 to 1 over the display [m].
    measured_u, measured_v: First and last fraction of the points that it was measured by.
    form: What it was taken for: plane, bent, free.
    """

    coefficients: FloatArray
    measured_u: tuple[float, float] = (0.0, 1.0)
    measured_v: tuple[float, float] = (0.0, 1.0)
    form: str = "free"

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients", freeze(np.array(self.coefficients, dtype=np.float64)))

    def points_m(self, u: AnyFloatArray, v: AnyFloatArray) -> FloatArray:
        """Return the points that show display coordinates (u, v), shape (..., 3) [m]; NaN off the display."""
        points = np.asarray(display_terms(u, v, len(self.coefficients)) @ self.coefficients)
        wide, high = np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64)
        points[~((wide >= 0) & (wide <= 1) & (high >= 0) & (high <= 1))] = np.nan
        return points

    def describe(self) -> str:
        """Return the screen in words."""
        sides = self.points_m(np.array([0.0, 1.0, 0.5, 0.5]), np.array([0.5, 0.5, 0.0, 1.0]))
        width, height = np.linalg.norm(sides[[1, 3]] - sides[[0, 2]], axis=1)
        return f"measured {self.form} display {width:.3f} m x {height:.3f} m"


@dataclass(frozen=True, slots=True, eq=False)
class SmoothWarp:
    """A smooth movement of all points of a screen, of any direction.

    coefficients (terms, 3): Of the monomials of u and v, from -1 to 1 over the display [m].
    """

    coefficients: FloatArray

    def shifts_m(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Return the shifts of the points that show (u, v), shape (..., 3) [m]."""
        return display_terms(u, v, len(self.coefficients)) @ self.coefficients

    def scaled(self, amount: float) -> "SmoothWarp":
        """Return the movement times an amount."""
        return SmoothWarp(amount * self.coefficients)


@dataclass(frozen=True, slots=True, eq=False)
class SharedStep:
    """One sigma of an independent error that a measured screen, the pose of its camera and the camera share.

    cam_from_screen (6,): Step of the pose, as `RigidTransform.moved` takes it.
    warp: What it does to the screen's points.
    camera (10,): Step of the camera's parameters.
    """

    cam_from_screen: FloatArray
    warp: SmoothWarp
    camera: FloatArray = field(default_factory=lambda: np.zeros(10))

    @property
    def moves_pose(self) -> bool:
        """Whether camera or the screen's pose move."""
        return bool(self.cam_from_screen.any() or self.camera.any())
