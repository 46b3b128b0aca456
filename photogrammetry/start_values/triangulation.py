"""Coordinates of targets from the lines of sight of several photos, all targets at once."""

from dataclasses import dataclass

import numpy as np

from heliogauge.adjust.robust_loss import Cauchy
from heliogauge.camera.model import Camera
from heliogauge.validate import BoolArray, FloatArray, IntArray

# Two lines of sight that differ by less fix no depth worth having: 1 degree makes depth 57 times as uncertain.
LEAST_ANGLE_RAD = np.deg2rad(1.0)
_ROUNDS = 6


@dataclass(frozen=True, slots=True, eq=False)
class Triangulation:
    """Intersections of lines of sight.

    points_m (n, 3): The points [m]; NaN with fewer than two lines or without an angle between them.
    covariance_m2 (n, 3, 3): Their covariance for exact poses [m^2].
    angle_rad (n,): Largest angle of a line with the mean direction, doubled; 0 with one line [rad].
    misses (m,): How far each line passes the point, in sigma.
    """

    points_m: FloatArray
    covariance_m2: FloatArray
    angle_rad: FloatArray
    misses: FloatArray

    @property
    def found(self) -> BoolArray:
        """Which points were found, shape (n,)."""
        return np.asarray(np.isfinite(self.points_m).all(axis=1))


def ray_sigma_rad(camera: Camera, covariance_px2: FloatArray) -> FloatArray:
    """Return the angular uncertainty of lines of sight from that of their image points, shape (m,) [rad].

    Shapes: covariance_px2 (m, 2, 2).
    Returns (m,): Mean sigma over the focal length: within 1 / cos^2 of the angle to the axis, enough for weights.
    """
    mean = np.sqrt(0.5 * np.einsum("mii->m", covariance_px2))
    return np.asarray(mean / np.sqrt(camera.focal_x_px * camera.focal_y_px))


def intersect_lines(
    origins_m: FloatArray, directions: FloatArray, sigma_rad: FloatArray, point: IntArray, count: int
) -> Triangulation:
    """Intersect lines of sight.

    origins_m (m, 3): Projection centres [m].
    directions (m, 3): Unit vectors towards the points.
    sigma_rad (m,): Angular uncertainty of each line [rad].
    point (m,): The point each line belongs to.
    Returns: Points that no two lines fix, or that lie behind a camera that votes for them, are NaN.

    Minimises ``sum w |(I - d d^T) (X - C)|^2 / (sigma t)^2`` with t the distance, by iterated weights; w is Cauchy's
    weight of the miss in sigma, so that one false line among four does no harm.
    """
    weight = 1.0 / sigma_rad**2
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    robust = np.ones_like(weight)
    points, solvable = np.zeros((count, 3)), np.zeros((count, 3, 3))
    distance = np.ones_like(weight)
    misses = np.zeros_like(weight)
    for turn in range(_ROUNDS):
        normal = _summed(across, weight * robust / distance**2, point, count)
        right = _summed(np.einsum("mij,mj->mi", across, origins_m), weight * robust / distance**2, point, count)
        # A share of 1e-9 of the trace keeps single lines solvable; they are dropped below.
        scale = np.maximum(np.einsum("nii->n", normal), 1e-300)
        solvable = normal + 1e-9 * scale[:, None, None] * np.eye(3)
        points = np.linalg.solve(solvable, right[:, :, None])[:, :, 0]
        arms = points[point] - origins_m
        along = np.einsum("mi,mi->m", arms, directions)
        distance = np.maximum(np.abs(along), 1e-9)
        misses = np.linalg.norm(np.einsum("mij,mj->mi", across, arms), axis=1) / (sigma_rad * distance)
        misses = np.where(along > 0, misses, np.inf)
        if turn + 1 < _ROUNDS:
            # Poses may be rough: judge lines against the median of all, at least against their own sigma.
            finite = misses[np.isfinite(misses)]
            typical = max(1.0, 1.5 * float(np.median(finite))) if finite.size else 1.0
            robust = Cauchy(3.0).weight(np.minimum(misses / typical, 3e6))
    angle = _spread(directions, point, count)
    good = (np.bincount(point, minlength=count) >= 2) & (angle > LEAST_ANGLE_RAD)
    behind = np.bincount(point, weights=~np.isfinite(misses), minlength=count)
    good &= behind <= 0.25 * np.bincount(point, minlength=count)
    covariance = np.full((count, 3, 3), np.nan)
    covariance[good] = np.linalg.inv(solvable[good])
    points[~good] = np.nan
    return Triangulation(points, covariance, angle, misses)


def _summed(values: FloatArray, weight: FloatArray, point: IntArray, count: int) -> FloatArray:
    flat = (values * weight.reshape(-1, *[1] * (values.ndim - 1))).reshape(len(values), -1)
    sums = [np.bincount(point, weights=column, minlength=count) for column in flat.T]
    return np.asarray(np.stack(sums, axis=-1).reshape(count, *values.shape[1:]), dtype=np.float64)


def _spread(directions: FloatArray, point: IntArray, count: int) -> FloatArray:
    """Twice the largest angle between a line and the mean direction of its point, shape (n,)."""
    mean = _summed(directions, np.ones(len(directions)), point, count)
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300)
    sine = np.linalg.norm(np.cross(directions, mean[point]), axis=1)
    half = np.arctan2(sine, np.einsum("mi,mi->m", directions, mean[point]))
    widest = np.zeros(count)
    np.maximum.at(widest, point, half)
    return 2 * widest
