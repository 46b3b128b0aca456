"""The way back: readings that send light from the sun or a lamp to an aim point."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from calibration.heliostat.kinematic_model.actuators import drive_angle, drive_reading
from calibration.heliostat.kinematic_model.design import Driven, HeliostatDesign, Turn
from calibration.heliostat.kinematic_model.kinematics import chain_poses
from heliogauge.errors import InputError
from heliogauge.geometry.rays import reflect
from heliogauge.geometry.rigid import rotation_from_vector
from heliogauge.validate import BoolArray, FloatArray, freeze

# Each pass shrinks the error by about arm / distance: 1/70 at 30 m and 0.5 m. A drone two arm lengths away takes 50.
_MOST_PASSES = 200
# Steps of the axes below which a pass changes nothing but rounding [rad].
_STILL_RAD = 1e-15
# A beam that misses its aim by more than this has not been found [rad]. Usual misses are 1e-14; a normal within 1e-6 of
# the pole of azimuth and elevation, where the azimuth is nearly lost, leaves 1e-10: 3 nanometres at 30 m.
_CONVERGED_RAD = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Aim:
    """Readings that point a heliostat.

    readings (n, 2): Readings of both drives in the design's unit; NaN where no position of the axes does it.
    angles_rad (n, 2): Angles of both axes [rad].
    normals (n, 3): The mirror's normals.
    centre_m (n, 3): The mirror's centre [m].
    miss_rad (n,): Angle between the reflected beam and the direction to the aim point [rad].
    converged (n,): Whether the beam meets the aim point to rounding.
    within_limits (n,): Whether the drives can go there.
    """

    readings: FloatArray
    angles_rad: FloatArray
    normals: FloatArray
    centre_m: FloatArray
    miss_rad: FloatArray
    converged: BoolArray
    within_limits: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class _TwoAxes:
    """A chain with its constant turns gathered: ``before R_1 between R_2 normal``, and where the drives may go."""

    design: HeliostatDesign
    numbers: Mapping[str, float]
    before: FloatArray
    first: Driven
    between: FloatArray
    second: Driven
    normal: FloatArray
    ranges: FloatArray

    @property
    def middle(self) -> FloatArray:
        """Middle of the range of each drive, 0 where it has no end, shape (2,) [rad]."""
        middle = self.ranges.mean(axis=1)
        return np.where(np.isfinite(middle), middle, 0.0)


def aim(
    design: HeliostatDesign,
    values: npt.ArrayLike,
    source: npt.ArrayLike,
    aim_points_m: npt.ArrayLike,
    *,
    finite: bool = False,
    approach: npt.ArrayLike | None = None,
) -> Aim:
    """Return the readings that reflect a source to aim points.

    values (p,): Its numbers, in the order of ``design.parameters``.
    source (n, 3) or (3,): Directions to the sun, of any length; with `finite` points of the field's frame [m].
    aim_points_m (n, 3) or (3,): Where the beam shall go [m].
    finite: Whether the source is at a finite distance: a drone, a lamp.
    approach (n, 2): Direction of each drive's move that will lead there, for drives with backlash.
    InputError: Shapes that do not fit.

    The mirror's normal bisects the directions to source and aim; for two axes both angles follow in closed form.
    The directions depend on the mirror's centre, which moves with the angles: a fixed point, contracting by about
    the arm over the distance. Of two solutions the one within the limits is taken, else the nearer one.
    """
    numbers, source, target = _checked(design, values, source, aim_points_m)
    axes = _two_axes(design, numbers)
    count = len(source)
    angles = np.repeat(axes.middle[None], count, axis=0)
    poses = chain_poses(design, numbers, list(angles.T))
    for _ in range(_MOST_PASSES):
        wanted = _bisector(source, target, poses.centre_m, finite)
        moved = _solve(axes, wanted)
        step = np.abs(moved - angles)
        angles = moved
        poses = chain_poses(design, numbers, list(angles.T))
        if not (step > _STILL_RAD).any():
            break
    return _result(axes, angles, (source, target), finite, approach)


def _result(
    axes: _TwoAxes,
    angles: FloatArray,
    ends: tuple[FloatArray, FloatArray],
    finite: bool,
    approach: npt.ArrayLike | None,
) -> Aim:
    design, numbers = axes.design, axes.numbers
    moves = np.zeros_like(angles) if approach is None else np.broadcast_to(np.asarray(approach), angles.shape)
    readings = np.empty_like(angles)
    reached = np.empty_like(angles)
    for i, drive in enumerate(design.drives):
        readings[:, i] = drive_reading(drive, numbers, angles[:, i], moves[:, i])
        # Judged by what the readings do, not by what was wanted of them.
        reached[:, i] = drive_angle(drive, numbers, readings[:, i], moves[:, i]).angle_rad
    poses = chain_poses(design, numbers, list(reached.T))
    normals = poses.normals(design)
    to_source = ends[0] - poses.centre_m if finite else ends[0]
    beam = reflect(-_unit(to_source), normals)
    to_aim = _unit(ends[1] - poses.centre_m)
    # The chord keeps what the arc cosine of a scalar product would lose below 1e-8 rad.
    miss = 2 * np.arcsin(np.minimum(np.linalg.norm(beam - to_aim, axis=1) / 2, 1.0))
    converged = np.less(miss, _CONVERGED_RAD)
    inside = np.all((readings >= design.limits[:, 0]) & (readings <= design.limits[:, 1]), axis=1)
    return Aim(
        freeze(readings), freeze(angles), freeze(normals), poses.centre_m, freeze(miss), converged, np.asarray(inside)
    )


def _two_axes(design: HeliostatDesign, numbers: Mapping[str, float]) -> _TwoAxes:
    """Gather the constant turns of the chain."""
    turns, driven = [np.eye(3)], []
    for step in design.steps:
        if isinstance(step, Turn):
            turns[-1] = turns[-1] @ rotation_from_vector(numbers[step.angle] * step.axis)
        elif isinstance(step, Driven):
            driven.append(step)
            turns.append(np.eye(3))
    ends = [
        np.sort(drive_angle(drive, numbers, limit).angle_rad)
        for drive, limit in zip(design.drives, design.limits, strict=True)
    ]
    before, between, after = turns
    return _TwoAxes(
        design, numbers, before, driven[0], between, driven[1], np.asarray(after @ design.normal), np.stack(ends)
    )


def _solve(axes: _TwoAxes, wanted: FloatArray) -> FloatArray:
    """Return the angles of the drives (n, 2) that turn the normal to the wanted directions (n, 3)."""
    goal = wanted @ axes.before
    first, second = axes.first.axis, axes.second.axis
    # Height of the goal over the first axis = constant + cosine part + sine part of the second angle.
    along = (second @ axes.normal) * second
    seen = first @ axes.between
    level, cosine, sine = seen @ along, seen @ (axes.normal - along), seen @ np.cross(second, axes.normal)
    with np.errstate(invalid="ignore", divide="ignore"):
        opening = np.arccos((goal @ first - level) / np.hypot(cosine, sine))
    candidates = [_both(axes, goal, np.arctan2(sine, cosine) + side * opening) for side in (1.0, -1.0)]
    excess = [
        np.maximum(np.maximum(axes.ranges[:, 0] - angles, angles - axes.ranges[:, 1]), 0).sum(axis=1)
        + 1e-9 * np.abs(angles - axes.middle).sum(axis=1)
        for angles in candidates
    ]
    return np.where((excess[0] <= excess[1])[:, None], candidates[0], candidates[1])


def _both(axes: _TwoAxes, goal: FloatArray, second_angle: FloatArray) -> FloatArray:
    """Return the angles by drive for one choice of the second axis' angle, each within half a turn of its middle."""
    first, second = axes.first.axis, axes.second.axis
    along = (second @ axes.normal) * second
    across = axes.normal - along
    turned = along + np.cos(second_angle)[:, None] * across + np.sin(second_angle)[:, None] * np.cross(second, across)
    arm = turned @ axes.between.T
    first_angle = np.arctan2(np.cross(arm, goal) @ first, (arm * goal).sum(axis=1) - (arm @ first) * (goal @ first))
    angles = np.empty((len(goal), 2))
    angles[:, axes.first.drive], angles[:, axes.second.drive] = first_angle, second_angle
    return np.asarray(angles - 2 * np.pi * np.round((angles - axes.middle) / (2 * np.pi)))


def _bisector(source: FloatArray, target: FloatArray, centre: FloatArray, finite: bool) -> FloatArray:
    to_source = _unit(source - centre if finite else source)
    return _unit(to_source + _unit(target - centre))


def _unit(vectors: FloatArray) -> FloatArray:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])


class _Checked(NamedTuple):
    """Numbers by name; sources and targets (n, 3)."""

    numbers: dict[str, float]
    sources: FloatArray
    targets: FloatArray


def _checked(
    design: HeliostatDesign, values: npt.ArrayLike, source: npt.ArrayLike, aim_points_m: npt.ArrayLike
) -> _Checked:
    value_array = np.asarray(values, dtype=np.float64)
    if value_array.shape != (len(design.parameters),):
        raise InputError(f"values: shape ({len(design.parameters)},) is needed, not {value_array.shape}")
    sources, targets = (
        np.atleast_2d(np.asarray(source, dtype=np.float64)),
        np.atleast_2d(np.asarray(aim_points_m, float)),
    )
    if sources.shape[1:] != (3,) or targets.shape[1:] != (3,):
        raise InputError(f"source and aim points: shape (n, 3) is needed, not {sources.shape} and {targets.shape}")
    try:
        sources, targets = np.broadcast_arrays(sources, targets)
    except ValueError:
        raise InputError(f"source and aim points: {len(sources)} and {len(targets)} rows do not go together") from None
    return _Checked(dict(zip(design.parameters.names, value_array.tolist(), strict=True)), sources, targets)
