r"""Lines of sight by way of the mirror: what a camera that sees the tube's edge at a mirror point says of the slope.

The observation equation of the whole method. At a mirror point P with slopes (s_x, s_y) the normal is
n = (-s_x, -s_y, 1). The line of sight from P to the camera, unit vector v, goes on after reflection along
r = 2 (n.v) n / n.n - v. Across the trough it leaves under psi = atan2(r_x, r_z). It touches the absorber tube of
radius a, whose axis it passes at A = (X_a, Z_a), where::

    e = psi - beta + side * w = 0,   beta = atan2(X_a - P_x, Z_a - P_z),   w = asin(a / |A - P|),

with side +1 for the edge that is seen at the larger camera angle. For s_y = 0 this is Phi = 2 theta_ra + side * w of
Owkes (2012), eqs 5.4 and 5.10, with theta_a = (beta_0 - beta) / 2 (its eq. 5.7 with the sign repaired).
"""

from dataclasses import dataclass

import numpy as np

from heliogauge.validate import FloatArray
from observer.absorber_path import AbsorberPath


@dataclass(frozen=True, slots=True, eq=False)
class Sights:
    """Lines of sight that touch the tube's edge after reflection.

    Parameters
    ----------
    points_m : ndarray, shape (m, 3)
        Mirror points [m].
    eyes_m : ndarray, shape (m, 3)
        The camera's centre for each [m].
    side : ndarray, shape (m,)
        +1 for the edge at the larger camera angle, -1 for the other.
    """

    points_m: FloatArray
    eyes_m: FloatArray
    side: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """How far reflected lines of sight pass beside the tube's edge, and what moves them.

    Parameters
    ----------
    angle_rad : ndarray, shape (m,)
        e of the module's text: angle across the trough by which the edge is missed [rad].
    d_angle_d_slope_x, d_angle_d_slope_y : ndarray, shape (m,)
        Derivatives with respect to dz/dx and dz/dy of the mirror [rad].
    d_angle_d_eye : ndarray, shape (m, 3)
        Derivatives with respect to the camera's centre, the mirror point held [rad/m].
    d_angle_d_absorber : ndarray, shape (m, 2)
        Derivatives with respect to X_a and Z_a where the ray passes [rad/m].
    d_angle_d_radius : ndarray, shape (m,)
        Derivative with respect to the tube's radius [rad/m].
    passing_y_m : ndarray, shape (m,)
        Where along the trough the ray passes the tube [m].
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

    Parameters
    ----------
    sights : Sights
        Mirror points, cameras and sides.
    slopes : (ndarray, ndarray), shape (m,) each
        dz/dx and dz/dy of the mirror at the points.
    absorber : AbsorberPath
        The tube's axis.
    radius_m : float
        The tube's radius [m].

    Returns
    -------
    Misfit
        Angles and derivatives; NaN where the ray does not reach the tube's height or starts inside the tube.
    """
    slope_x, slope_y = slopes
    points = sights.points_m
    away = sights.eyes_m - points
    distance = np.sqrt(np.einsum("mi,mi->m", away, away))
    sight = away / distance[:, None]
    normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=1)
    square = np.einsum("mi,mi->m", normal, normal)
    height = np.einsum("mi,mi->m", normal, sight) / square
    ray = 2 * height[:, None] * normal - sight

    across = ray[:, 0] ** 2 + ray[:, 2] ** 2

    def turn(change: FloatArray) -> FloatArray:
        """Return the change of psi for a change of the reflected ray."""
        return np.asarray((ray[:, 2] * change[:, 0] - ray[:, 0] * change[:, 2]) / across)

    d_slopes = []
    for axis in (0, 1):
        # dn has one component, -1 along the axis.
        d_height = -(sight[:, axis] - 2 * height * normal[:, axis]) / square
        change = 2 * d_height[:, None] * normal
        change[:, axis] -= 2 * height
        d_slopes.append(turn(change))
    # r is linear in v; psi does not change with the length of r, so v need not stay of unit length.
    d_eye = np.empty_like(points)
    for axis in range(3):
        change = (2 * normal[:, axis] / square)[:, None] * normal
        change[:, axis] -= 1.0
        d_eye[:, axis] = turn(change) / distance

    with np.errstate(divide="ignore", invalid="ignore"):
        passing = _passing_y(points, ray, absorber)
        axis_x, axis_z = absorber.at(passing)
        to_x, to_z = axis_x - points[:, 0], axis_z - points[:, 2]
        range_square = to_x**2 + to_z**2
        reach = np.sqrt(range_square)
        sine = radius_m / reach
        half = np.arcsin(np.where(sine < 1, sine, np.nan))
        angle = np.arctan2(ray[:, 0], ray[:, 2]) - np.arctan2(to_x, to_z) + sights.side * half
        # d asin(a / R) = -tan(w) dR / R
        shrink = -sights.side * np.tan(half) / range_square
        d_absorber = np.stack([-to_z / range_square + shrink * to_x, to_x / range_square + shrink * to_z], axis=1)
        d_radius = sights.side / (reach * np.cos(half))
    return Misfit(angle, d_slopes[0], d_slopes[1], d_eye, d_absorber, d_radius, passing)


def beside_axis(
    sights: Sights, slope_x: FloatArray, absorber: AbsorberPath, radius_m: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return by what angle reflected lines of sight pass beside the tube's axis, without derivatives.

    Parameters
    ----------
    sights : Sights
        Mirror points and cameras; sides do not matter.
    slope_x : ndarray, shape (m,)
        dz/dx of the mirror at the points; its slope along the trough counts as none.
    absorber : AbsorberPath
        The tube's axis.
    radius_m : float
        The tube's radius [m].

    Returns
    -------
    angle_rad : ndarray, shape (m,)
        Mean of the misfits of both edges [rad].
    half_rad : ndarray, shape (m,)
        Half the tube's width: `misfit` is their sum for side +1, their difference for side -1 [rad].
    passing_y_m : ndarray, shape (m,)
        Where along the trough the ray passes the tube [m].
    """
    points = sights.points_m
    away = sights.eyes_m - points
    twice = 2 * (away[:, 2] - slope_x * away[:, 0]) / (1 + slope_x * slope_x)
    ray = np.stack([-twice * slope_x - away[:, 0], -away[:, 1], twice - away[:, 2]], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        passing = _passing_y(points, ray, absorber)
        axis_x, axis_z = absorber.at(passing)
        to_x, to_z = axis_x - points[:, 0], axis_z - points[:, 2]
        sine = radius_m / np.hypot(to_x, to_z)
        half = np.arcsin(np.where(sine < 1, sine, np.nan))
        angle = np.arctan2(ray[:, 0], ray[:, 2]) - np.arctan2(to_x, to_z)
    return angle, half, passing


def _passing_y(points_m: FloatArray, ray: FloatArray, absorber: AbsorberPath) -> FloatArray:
    """Return where along the trough the reflected rays come to the absorber's height."""
    upward = np.where(ray[:, 2] > 1e-6, ray[:, 2], np.nan)
    passing = np.asarray(points_m[:, 1] + (np.mean(absorber.z_m) - points_m[:, 2]) * ray[:, 1] / upward)
    return np.asarray(points_m[:, 1] + (absorber.at(passing)[1] - points_m[:, 2]) * ray[:, 1] / upward)


def gradient_on_mirror(
    sights: Sights, found: Misfit, focal_length_m: float, bend_per_m: FloatArray | float = 0.0
) -> FloatArray:
    """Differentiate the misfit with respect to the mirror point, the camera held and the slopes following the mirror.

    Parameters
    ----------
    sights : Sights
        The lines.
    found : Misfit
        Their misfits and derivatives.
    focal_length_m : float
        Focal length of the mirror, whose curvature turns the normal along the way [m].
    bend_per_m : float or ndarray, shape (m,), optional
        Curvature across that the mirror has beside that: change of the slope's error [1/m].

    Returns
    -------
    ndarray, shape (m, 3)
        Derivatives [rad/m]; movements must stay on the mirror.
    """
    gradient = -found.d_angle_d_eye
    gradient[:, 0] += found.d_angle_d_slope_x * (1 / (2 * focal_length_m) + bend_per_m) - found.d_angle_d_absorber[:, 0]
    gradient[:, 2] -= found.d_angle_d_absorber[:, 1]
    return gradient


def change_across(
    sights: Sights, found: Misfit, focal_length_m: float, bend_per_m: FloatArray | float = 0.0
) -> FloatArray:
    """Return by how much the misfit changes where the mirror point moves across the trough, shape (m,) [rad/m].

    Parameters
    ----------
    sights : Sights
        The lines.
    found : Misfit
        Their misfits and derivatives.
    focal_length_m : float
        Focal length of the mirror [m].
    bend_per_m : float or ndarray, shape (m,), optional
        Curvature across that the mirror has beside that [1/m].

    Returns
    -------
    ndarray, shape (m,)
        Total derivative along the parabola [rad/m].
    """
    gradient = gradient_on_mirror(sights, found, focal_length_m, bend_per_m)
    return np.asarray(gradient[:, 0] + gradient[:, 2] * sights.points_m[:, 0] / (2 * focal_length_m))
