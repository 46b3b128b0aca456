"""Beams and lines that a laser will send to a mirror of design shape, and where they will come back."""

import numpy as np

from deflectometry.laser.line_sweep import CrossedLines, Sweep, cross_lines
from deflectometry.laser.planning.keys import LaserPlanSection
from deflectometry.laser.scan import LaserScan, single_beams
from heliogauge.errors import InputError
from heliogauge.geometry.rays import reflect
from heliogauge.geometry.surfaces import Quadric
from heliogauge.validate import FloatArray

#: Points of a line that are seen: 64 times an odd number, so that other numbers of lines do not cross in points.
_POINTS_OF_LINE = 320


def predicted_beams(plan: LaserPlanSection, design: Quadric, laser_m: FloatArray) -> LaserScan:
    """Return beams to the middles of equal cells of the mirror, with the spots that will be seen.

    laser_m (3,): Where the laser stands in the mirror's frame, whose axes are parallel to its own [m].
    """
    x, y = (one.ravel() for one in np.meshgrid(_places(plan, 0, plan.columns), _places(plan, 1, plan.rows)))
    directions = np.stack([x, y, _heights(design, x, y)]) - laser_m[:, None]
    return single_beams(directions, _spots(plan, design, laser_m, directions))


def predicted_lines(plan: LaserPlanSection, design: Quadric, laser_m: FloatArray, sigma_spot_m: float) -> CrossedLines:
    """Return the beams in which the sheets of two sweeps will cut each other, with the spots where lines cross.

    sigma_spot_m: Standard deviation of each point of a line across it [m].

    Spots are those of lines without noise, where lines with it cross once, too: near twice the focal length they are
    hardly longer than that.
    """
    rng = np.random.default_rng(0)
    exact: list[Sweep] = []
    scattered: list[Sweep] = []
    for axis, count in enumerate((plan.columns, plan.rows)):
        # Of a line the middle is aimed; the fan within its sheet covers the mirror from rim to rim.
        middle = np.full(count, plan.center_m[1 - axis])
        tangents = _tangents(design, laser_m, axis, _places(plan, axis, count), middle)
        along = _places(plan, 1 - axis, _POINTS_OF_LINE)
        fan = _tangents(design, laser_m, 1 - axis, along, np.full(along.size, plan.center_m[axis]))
        swept, within = (one.ravel() for one in np.meshgrid(tangents, fan, indexing="ij"))
        beams = np.stack([swept, within, -np.ones(swept.size)] if axis == 0 else [within, swept, -np.ones(swept.size)])
        normals = np.zeros((count, 3))
        normals[:, axis], normals[:, 2] = 1.0, tangents
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        spots = _spots(plan, design, laser_m, beams)[:2].reshape(2, count, _POINTS_OF_LINE)
        along_m = _along(spots)
        across = np.stack([-along_m[1], along_m[0]]) / np.maximum(np.hypot(*along_m), np.finfo(float).tiny)
        noise = sigma_spot_m * rng.standard_normal(spots.shape[1:]) * across
        for sweeps, seen in ((exact, spots), (scattered, spots + noise)):
            line, point = np.nonzero(np.isfinite(seen[0]))
            sweeps.append(Sweep(normals, line, seen[:, line, point].T))
    crossed = cross_lines(exact[0], exact[1], sigma_spot_m)
    cross_once = cross_lines(scattered[0], scattered[1], sigma_spot_m).scan.seen
    spots_m = np.where(cross_once, crossed.scan.spots_m, np.nan)
    return CrossedLines(crossed.scan.with_spots(spots_m), crossed.unclear | (crossed.scan.seen & ~cross_once))


def _along(spots: FloatArray) -> FloatArray:
    """Return the steps along lines (2, k, n) at each of their points, at their ends to the one neighbour; 0 alone."""
    steps = np.nan_to_num(np.diff(spots, axis=2))
    return np.asarray(np.pad(steps, ((0, 0), (0, 0), (1, 0))) + np.pad(steps, ((0, 0), (0, 0), (0, 1))))


def _places(plan: LaserPlanSection, axis: int, count: int) -> FloatArray:
    size = (plan.width_m, plan.height_m)[axis]
    return plan.center_m[axis] + size * ((np.arange(count) + 0.5) / count - 0.5)


def _heights(design: Quadric, x: FloatArray, y: FloatArray) -> FloatArray:
    z = design.height(x, y)
    if not np.isfinite(z).all():
        raise InputError(
            f"the design ({design.describe()}) does not reach the whole mirror; check plan.width_m, plan.height_m, "
            "plan.center_m and the design's focal length or radius"
        )
    return z


def _tangents(design: Quadric, laser_m: FloatArray, axis: int, along: FloatArray, across: FloatArray) -> FloatArray:
    """Return tangents of the angles of beams along an axis of the mirror."""
    x, y = (along, across) if axis == 0 else (across, along)
    return np.asarray((along - laser_m[axis]) / (laser_m[2] - _heights(design, x, y)))


def _spots(plan: LaserPlanSection, design: Quadric, laser_m: FloatArray, directions: FloatArray) -> FloatArray:
    """Return where beams (3, n) come back to the target's plane, in the laser's frame; NaN beside mirror or target."""
    if not (directions[2] < 0).all():
        raise InputError(
            f"the laser at {laser_m[2]:.3g} m stands within the mirror; check mirror.distance_m and the size in [plan]"
        )
    points = laser_m[:, None] + design.intersect(laser_m, directions.T) * directions
    back = reflect(directions.T, design.normal(points[0], points[1])).T
    with np.errstate(divide="ignore", invalid="ignore"):
        spots = points - laser_m[:, None] - ((points[2] - laser_m[2]) / back[2]) * back
        seen = back[2] > 0
        for axis, size in enumerate((plan.width_m, plan.height_m)):
            # Beams aimed at the rim itself are on the mirror.
            seen &= np.abs(points[axis] - plan.center_m[axis]) <= 0.5 * size * (1 + 1e-9)
        if plan.target_m is not None:
            seen &= (np.abs(spots[:2]) <= 0.5 * np.array(plan.target_m)[:, None]).all(axis=0)
    spots[2] = 0.0
    return np.where(seen, spots, np.nan)
