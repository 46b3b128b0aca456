r"""Lines of sight by way of the mirror: what a camera that sees the tube's edge at a mirror point says of the slope.

The observation equation of the whole method. At a mirror point P with slopes (s_x, s_y) the normal is
n = (-s_x, -s_y, 1). The line of sight from P to the camera, unit vector v, goes on after reflection along
r = 2 (n.v) n / n.n - v. Across the trough it leaves under psi = atan2(r_x, r_z). It touches the absorber tube of
radius a, whose axis it passes at A = (X_a, Z_a), where::

    e = psi - beta + side * w = 0,   beta = atan2(X_a - P_x, Z_a - P_z),   w = asin(a / |A - P|),

with side +1 for the edge that is seen at the larger camera angle. For s_y = 0 this is Phi = 2 theta_ra + side * w of
Owkes (2012), eqs 5.4 and 5.10, with theta_a = (beta_0 - beta) / 2 (its eq. 5.7 with the sign repaired).

A tube that sags or is bent leans where the ray passes, by (X_a', Z_a') = d(X_a, Z_a)/dy. A ray that runs along the
trough as well then touches its two sides at different places along it: 0.1 mm of width at 10 degrees and 8 mrad. Seen
in coordinates that lean with the tube, ``x - X_a' y`` and ``z - Z_a' y``, it is straight along y and as round, to the
square of the lean: all above holds with r_x - X_a' r_y for r_x, r_z - Z_a' r_y for r_z, and A where the leaning axis
comes through the plane of P across the trough.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from heliogauge.validate import FloatArray
from observer.trough.absorber_path import AbsorberPath


@dataclass(frozen=True, slots=True, eq=False)
class Sights:
    """Lines of sight that touch the tube's edge after reflection.

    points_m (m, 3): Mirror points [m].
    eyes_m (m, 3): The camera's centre for each [m].
    side (m,): +1 for the edge at the larger camera angle, -1 for the other.
    """

    points_m: FloatArray
    eyes_m: FloatArray
    side: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """How far reflected lines of sight pass beside the tube's edge, and what moves them.

    angle_rad (m,): e of the module's text: angle across the trough by which the edge is missed [rad].
    d_angle_d_slope_x, d_angle_d_slope_y (m,): Derivatives with respect to dz/dx and dz/dy of the mirror [rad].
    d_angle_d_eye (m, 3): Derivatives with respect to the camera's centre, the mirror point held [rad/m].
    d_angle_d_absorber (m, 2): Derivatives with respect to X_a and Z_a where the ray passes [rad/m].
    d_angle_d_radius (m,): Derivative with respect to the tube's radius [rad/m].
    passing_y_m (m,): Where along the trough the ray passes the tube [m].
    """

    angle_rad: FloatArray
    d_angle_d_slope_x: FloatArray
    d_angle_d_slope_y: FloatArray
    d_angle_d_eye: FloatArray
    d_angle_d_absorber: FloatArray
    d_angle_d_radius: FloatArray
    passing_y_m: FloatArray


def misfit(sights: Sights, slopes: tuple[FloatArray, FloatArray], absorber: AbsorberPath, radius_m: float) -> Misfit:
    """Evaluate by what angle reflected lines of sight miss the tube's edge.

    sights: Mirror points, cameras and sides.
    slopes (m,): dz/dx and dz/dy of the mirror at the points.
    Returns: Angles and derivatives; NaN where the ray does not reach the tube's height or starts inside the tube.
    """
    ray = _Ray(sights, slopes, absorber)
    angle, half, passing, to_x, to_z = _beside_tube(sights, ray, absorber, radius_m)
    by_x, by_y = ray.turns_with_slopes()
    with np.errstate(divide="ignore", invalid="ignore"):
        range_square = to_x**2 + to_z**2
        # d asin(a / R) = -tan(w) dR / R
        shrink = -sights.side * np.tan(half) / range_square
        d_absorber = np.stack([-to_z / range_square + shrink * to_x, to_x / range_square + shrink * to_z], axis=1)
        d_radius = sights.side / (np.sqrt(range_square) * np.cos(half))
    return Misfit(angle + sights.side * half, by_x, by_y, ray.turns_with_eye(), d_absorber, d_radius, passing)


class SlopeMisfit(NamedTuple):
    """How far reflected lines of sight pass beside the tube's edge, and what the slopes do to that.

    angle_rad (m,): NaN where the ray does not reach the tube [rad].
    d_slope_x, d_slope_y (m,): Derivatives with respect to dz/dx and dz/dy of the mirror [rad].
    """

    angle_rad: FloatArray
    d_slope_x: FloatArray
    d_slope_y: FloatArray


def misfit_with_slopes(
    sights: Sights, slopes: tuple[FloatArray, FloatArray], absorber: AbsorberPath, radius_m: float
) -> SlopeMisfit:
    """Evaluate what `misfit` does, with derivatives with respect to the slopes alone: half the time.

    slopes (m,): dz/dx and dz/dy of the mirror at the points.
    radius_m: The tube's radius [m].
    """
    ray = _Ray(sights, slopes, absorber)
    beside = _beside_tube(sights, ray, absorber, radius_m)
    return SlopeMisfit(beside.angle_rad + sights.side * beside.half_rad, *ray.turns_with_slopes())


class _Ray:
    """Reflected lines of sight r = 2 (n.v) n / n.n - v, one array for each component; v need not be of unit length.

    ``x`` and ``z`` lean with the tube where it is passed, by ``lean_x`` and ``lean_z``; ``level`` is what the normal
    leans with it, as z and x see it.
    """

    def __init__(self, sights: Sights, slopes: tuple[FloatArray, FloatArray], absorber: AbsorberPath) -> None:
        self.slope_x, self.slope_y = slopes
        away_x, away_y, away_z = (sights.eyes_m - sights.points_m).T
        self.square = 1.0 + self.slope_x**2 + self.slope_y**2
        self.twice = 2 * (away_z - self.slope_x * away_x - self.slope_y * away_y) / self.square
        self.upright_x = -self.twice * self.slope_x - away_x
        self.y = -self.twice * self.slope_y - away_y
        upright_z = self.twice - away_z
        self.passing_y_m = _passing_y(sights.points_m, self.y, upright_z, absorber)
        self.lean_x, self.lean_z = absorber.slopes_at(self.passing_y_m)
        self.x, self.z = self.upright_x - self.lean_x * self.y, upright_z - self.lean_z * self.y
        self.across = self.x**2 + self.z**2
        self.level = self.z * (self.slope_x - self.lean_x * self.slope_y) + self.x * (1 + self.lean_z * self.slope_y)

    def turns_with_slopes(self) -> tuple[FloatArray, FloatArray]:
        """Return by how much psi changes with both slopes, shape (m,) each.

        With h = (n.v) / n.n a slope changes it by ``r_i / n.n``, and r by ``2 n`` times that and by -2 h along i.
        """
        part = 2 * self.level / self.square
        by_x = -(self.twice * self.z + self.upright_x * part) / self.across
        return by_x, -(self.y * part - self.twice * self._leaning()) / self.across

    def turns_with_eye(self) -> FloatArray:
        """Return by how much psi changes with the camera's place, shape (m, 3) [rad/m].

        r is linear in v: v along i changes it by ``2 n_i n / n.n`` less v itself.
        """
        part = 2 * self.level / self.square
        along = np.stack([part * self.slope_x - self.z, part * self.slope_y + self._leaning(), self.x - part], axis=1)
        return np.asarray(along / self.across[:, None])

    def _leaning(self) -> FloatArray:
        return np.asarray(self.lean_x * self.z - self.lean_z * self.x)


class BesideTube(NamedTuple):
    """Where reflected lines of sight pass the tube, arrays of shape (m,).

    angle_rad: Angle beside the axis: the mean of the misfits of both edges [rad].
    half_rad: Half the tube's width: `misfit` is their sum for side +1, their difference for side -1 [rad].
    passing_y_m: Where along the trough [m].
    to_x_m, to_z_m: Way across the trough from the mirror point to the axis that leans as there [m].
    """

    angle_rad: FloatArray
    half_rad: FloatArray
    passing_y_m: FloatArray
    to_x_m: FloatArray
    to_z_m: FloatArray


def _beside_tube(sights: Sights, ray: _Ray, absorber: AbsorberPath, radius_m: float) -> BesideTube:
    points = sights.points_m
    with np.errstate(divide="ignore", invalid="ignore"):
        passing = ray.passing_y_m
        axis_x, axis_z = absorber.at(passing)
        back = points[:, 1] - passing
        to_x, to_z = axis_x + ray.lean_x * back - points[:, 0], axis_z + ray.lean_z * back - points[:, 2]
        sine = radius_m / np.sqrt(to_x**2 + to_z**2)
        half = np.arcsin(np.where(sine < 1, sine, np.nan))
        angle = np.arctan2(ray.x, ray.z) - np.arctan2(to_x, to_z)
    return BesideTube(angle, half, passing, to_x, to_z)


def beside_axis(sights: Sights, slope_x: FloatArray, absorber: AbsorberPath, radius_m: float) -> BesideTube:
    """Return where reflected lines of sight pass the tube, without derivatives.

    sights: Mirror points and cameras; sides do not matter.
    slope_x (m,): dz/dx of the mirror at the points; its slope along the trough counts as none.
    """
    return _beside_tube(sights, _Ray(sights, (slope_x, np.zeros_like(slope_x)), absorber), absorber, radius_m)


def _passing_y(points_m: FloatArray, ray_y: FloatArray, ray_z: FloatArray, absorber: AbsorberPath) -> FloatArray:
    """Return where along the trough the reflected rays come to the absorber's height."""
    with np.errstate(divide="ignore", invalid="ignore"):
        along = ray_y / np.where(ray_z > 1e-6, ray_z, np.nan)
    passing = points_m[:, 1] + (float(np.mean(absorber.z_m)) - points_m[:, 2]) * along
    height = np.interp(passing, absorber.y_m, absorber.z_m)
    return np.asarray(points_m[:, 1] + (height - points_m[:, 2]) * along)


def gradient_on_mirror(
    sights: Sights, found: Misfit, focal_length_m: float, bend_per_m: FloatArray | float = 0.0
) -> FloatArray:
    """Differentiate the misfit with respect to the mirror point, the camera held and the slopes following the mirror.

    focal_length_m: Focal length of the mirror, whose curvature turns the normal along the way [m].
    bend_per_m (m,): Curvature across that the mirror has beside that: change of the slope's error [1/m].
    Returns (m, 3): Derivatives [rad/m]; movements must stay on the mirror.
    """
    gradient = -found.d_angle_d_eye
    gradient[:, 0] += found.d_angle_d_slope_x * (1 / (2 * focal_length_m) + bend_per_m) - found.d_angle_d_absorber[:, 0]
    gradient[:, 2] -= found.d_angle_d_absorber[:, 1]
    return gradient


def change_across(
    sights: Sights, found: Misfit, focal_length_m: float, bend_per_m: FloatArray | float = 0.0
) -> FloatArray:
    """Return by how much the misfit changes where the mirror point moves across the trough, shape (m,) [rad/m].

    bend_per_m (m,): Curvature across that the mirror has beside that [1/m].
    Returns (m,): Total derivative along the parabola [rad/m].
    """
    gradient = gradient_on_mirror(sights, found, focal_length_m, bend_per_m)
    return np.asarray(gradient[:, 0] + gradient[:, 2] * sights.points_m[:, 0] / (2 * focal_length_m))
