"""Where a heliostat's mirror stands at given readings, with derivatives by every parameter of the chain."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from calibration.heliostat.kinematic_model.actuators import DriveAngle, check_readings, drive_angle
from calibration.heliostat.kinematic_model.design import Driven, HeliostatDesign, Turn
from heliogauge.errors import InputError
from heliogauge.validate import FloatArray, IntArray, freeze

_IDENTITY, _ORIGIN = freeze(np.eye(3)), freeze(np.zeros(3))


@dataclass(frozen=True, slots=True, eq=False)
class MirrorPoses:
    """Poses of a mirror in the field's frame.

    rotation (n, 3, 3): ``world_from_mirror`` rotation matrices.
    centre_m (n, 3): The mirror's centre [m].
    """

    rotation: FloatArray
    centre_m: FloatArray

    def normals(self, design: HeliostatDesign) -> FloatArray:
        """Return the outward unit normals, shape (n, 3)."""
        return np.asarray(self.rotation @ design.normal)

    def points(self, points_mirror_m: npt.ArrayLike) -> FloatArray:
        """Return points fixed on the mirror, (3,) or (n, 3) in its frame [m], in the field's frame, (n, 3) [m]."""
        points = np.asarray(points_mirror_m, dtype=np.float64)
        return np.asarray((self.rotation @ points[..., None])[..., 0] + self.centre_m)


@dataclass(frozen=True, slots=True, eq=False)
class PoseDerivatives:
    """Poses of a mirror and how they change with the parameters.

    omega (n, 3, k): Rotation vector per unit of each parameter: a direction d fixed in the mirror changes by
        ``omega x d`` [rad].
    shift (n, 3, k): Change of the mirror's centre per unit of each parameter [m].
    columns (k,): Position of each parameter in ``design.parameters``.
    """

    poses: MirrorPoses
    omega: FloatArray
    shift: FloatArray
    columns: IntArray


class _Link(NamedTuple):
    """Constant steps up to a drive (or the mirror), gathered, in the frame where they start.

    Rotation and offset lead to the end. Turns and moves hold what the wanted parameters in between do: columns, axes,
    and for turns the points that they turn about.
    """

    rotation: FloatArray
    offset: FloatArray
    driven: Driven | None
    turns: tuple[list[int], list[FloatArray], list[FloatArray]]
    moves: tuple[list[int], list[FloatArray]]


class _Frame(NamedTuple):
    """A frame in the field for every row: axes (3 axes, 3 components, n or 1) and origin (3, n or 1) [m].

    Rows come last, so that constant vectors and matrices meet all rows in one product without strides: four times
    faster than a stack of (n, 3, 3).
    """

    axes: FloatArray
    origin: FloatArray

    def directions(self, vectors: FloatArray | Sequence[FloatArray]) -> FloatArray:
        """Return constant vectors (q, 3) of this frame in the field's, shape (q, 3, n or 1)."""
        _, components, rows = self.axes.shape
        seen = np.asarray(vectors) @ self.axes.reshape(3, components * rows)
        return np.asarray(seen.reshape(len(seen), components, rows))


def mirror_poses(
    design: HeliostatDesign,
    values: npt.ArrayLike,
    readings: npt.ArrayLike,
    approach: npt.ArrayLike | None = None,
    *,
    outside: Literal["raise", "nan"] = "raise",
) -> MirrorPoses:
    """Return the poses of the mirror at some readings.

    values (p,): Its numbers, in the order of ``design.parameters``.
    readings (n, 2): Readings of both drives in the design's unit.
    approach (n, 2): Direction of each drive's last move: +1 to larger readings, -1 to smaller ones, 0 unknown.
    outside: What to do with readings that a linear actuator cannot have: refuse them all, or give those rows as NaN
        (for a fit on its way).
    Returns: One pose per row.
    InputError: Shapes that do not fit, or readings outside the geometry of an actuator.
    """
    numbers, drives = _drive_angles(design, values, readings, approach, outside)
    return chain_poses(design, numbers, [drive.angle_rad for drive in drives])


def pose_derivatives(
    design: HeliostatDesign,
    values: npt.ArrayLike,
    readings: npt.ArrayLike,
    approach: npt.ArrayLike | None = None,
    *,
    columns: Sequence[int] | IntArray | None = None,
    outside: Literal["raise", "nan"] = "raise",
) -> PoseDerivatives:
    """Return the poses of the mirror with their derivatives by the parameters.

    values (p,): Its numbers, in the order of ``design.parameters``.
    readings (n, 2): Readings of both drives in the design's unit.
    approach (n, 2): Direction of each drive's last move: +1 to larger readings, -1 to smaller ones, 0 unknown.
    columns: Positions of the wanted parameters in ``design.parameters``; all of them if not given.
    outside: What to do with readings that a linear actuator cannot have: refuse them all, or give those rows as
        NaN.
    Returns: Poses and derivatives; columns of parameters that the chain does not use are zero.
    InputError: Shapes that do not fit, or readings outside the geometry of an actuator.

    The geometric Jacobian of a serial chain: a parameter that turns about the axis w through the point q moves a
    centre c by ``w x (c - q)`` and turns everything behind it by w.
    """
    numbers, drives = _drive_angles(design, values, readings, approach, outside)
    wanted = np.arange(len(design.parameters)) if columns is None else np.asarray(columns, dtype=np.intp)
    column_of = {design.parameters.names[index]: column for column, index in enumerate(wanted)}
    links = _links(design, numbers, column_of)
    frames = _walk(links, [drive.angle_rad for drive in drives])
    centre = frames[-1].origin
    omega, shift = np.zeros((2, len(wanted), 3, len(drives[0].angle_rad)))
    for link, frame in zip(links, frames[:-1], strict=True):
        _add_constant((omega, shift), link, frame, centre)
        if link.driven is not None:
            known = drives[link.driven.drive].by_parameter
            gains = {column_of[name]: gain for name, gain in known.items() if name in column_of}
            _add_driven((omega, shift), link, frame, gains, centre)
    poses = _poses(frames[-1], omega.shape[-1])
    return PoseDerivatives(poses, omega.transpose(2, 1, 0), shift.transpose(2, 1, 0), wanted)


def chain_poses(design: HeliostatDesign, numbers: Mapping[str, float], angles_rad: Sequence[FloatArray]) -> MirrorPoses:
    """Return the poses at given angles of the two axes.

    numbers: Value of each parameter by name.
    angles_rad (n,): Angle of each drive [rad].
    Returns: One pose per angle.
    """
    return _poses(_walk(_links(design, numbers, {}), angles_rad)[-1], len(angles_rad[0]))


def _links(design: HeliostatDesign, numbers: Mapping[str, float], column_of: Mapping[str, int]) -> list[_Link]:
    """Gather the constant steps between the drives."""
    links = []
    link = _new_link()
    rotation, offset = link.rotation, link.offset
    for step in design.steps:
        if isinstance(step, Driven):
            links.append(link._replace(rotation=rotation, offset=offset, driven=step))
            link = _new_link()
            rotation, offset = link.rotation, link.offset
        elif isinstance(step, Turn):
            if step.angle in column_of:
                link.turns[0].append(column_of[step.angle])
                link.turns[1].append(rotation @ step.axis)
                link.turns[2].append(offset)
            angle = numbers[step.angle]
            cross, square = rotation @ step.generator
            rotation = rotation + math.sin(angle) * cross + (2 * math.sin(angle / 2) ** 2) * square
        else:
            for i, name in enumerate(step.names):
                if name is not None and name in column_of:
                    link.moves[0].append(column_of[name])
                    link.moves[1].append(step.sign * rotation[:, i])
            lengths = [0.0 if name is None else step.sign * numbers[name] for name in step.names]
            offset = offset + rotation @ lengths
    return [*links, link._replace(rotation=rotation, offset=offset)]


def _new_link() -> _Link:
    return _Link(_IDENTITY, _ORIGIN, None, ([], [], []), ([], []))


def _walk(links: Sequence[_Link], angles_rad: Sequence[FloatArray]) -> list[_Frame]:
    """Go along the chain: the frame in which each link starts, and the mirror's as the last."""
    frames = [_Frame(_IDENTITY[:, :, None], _ORIGIN[:, None])]
    for link in links:
        start = frames[-1]
        origin = start.origin + start.directions(link.offset[None])[0]
        if link.driven is None:
            frames.append(_Frame(start.directions(link.rotation.T), origin))
            continue
        angle = angles_rad[link.driven.drive]
        # Rodrigues about a constant axis: three constant matrices instead of n.
        cross, square = link.rotation @ link.driven.generator
        turned = start.directions(np.concatenate([link.rotation.T, cross.T, square.T]))
        axes = turned[:3] + np.sin(angle) * turned[3:6] + 2 * np.sin(angle / 2) ** 2 * turned[6:]
        frames.append(_Frame(axes, origin))
    return frames


def _poses(frame: _Frame, count: int) -> MirrorPoses:
    # A view: rows first as everybody else has them.
    return MirrorPoses(frame.axes.transpose(2, 1, 0), np.broadcast_to(frame.origin, (3, count)).T)


def _add_constant(into: tuple[FloatArray, FloatArray], link: _Link, start: _Frame, centre: FloatArray) -> None:
    """Add what the parameters of a link's constant steps do to omega and shift, (k, 3, n) each."""
    columns, axes = link.moves
    if columns:
        _scatter(into[1], columns, start.directions(axes))
    columns, axes, origins = link.turns
    if columns:
        both = start.directions(axes + origins)
        turned, origin = both[: len(columns)], both[len(columns) :]
        _scatter(into[0], columns, turned)
        _scatter(into[1], columns, _cross(turned, centre - start.origin - origin))


def _add_driven(
    into: tuple[FloatArray, FloatArray], link: _Link, start: _Frame, gains: Mapping[int, FloatArray], centre: FloatArray
) -> None:
    """Add what the parameters of the drive at a link's end do."""
    if not gains or link.driven is None:
        return
    axis, offset = start.directions([link.rotation @ link.driven.axis, link.offset])
    moved = _cross(axis, centre - start.origin - offset)
    for column, gain in gains.items():
        into[0][column] += gain * axis
        into[1][column] += gain * moved


def _scatter(into: FloatArray, columns: Sequence[int], block: FloatArray) -> None:
    # One by one: a parameter may act twice, as a pylon's length at its foot and its top.
    for column, part in zip(columns, block, strict=True):
        into[column] += part


def _cross(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the cross products along the last axis but one; numpy.cross costs 30 microseconds before it starts."""
    x, y, z = first[..., 0, :], first[..., 1, :], first[..., 2, :]
    u, v, w = second[..., 0, :], second[..., 1, :], second[..., 2, :]
    product = np.empty(np.broadcast_shapes(first.shape, second.shape))
    product[..., 0, :] = y * w - z * v
    product[..., 1, :] = z * u - x * w
    product[..., 2, :] = x * v - y * u
    return product


def _drive_angles(
    design: HeliostatDesign,
    values: npt.ArrayLike,
    readings: npt.ArrayLike,
    approach: npt.ArrayLike | None,
    outside: Literal["raise", "nan"],
) -> tuple[dict[str, float], list[DriveAngle]]:
    """Check the shapes; return the numbers by name and the angles of both drives."""
    value_array = np.asarray(values, dtype=np.float64)
    if value_array.shape != (len(design.parameters),):
        raise InputError(f"values: shape ({len(design.parameters)},) is needed, not {value_array.shape}")
    reading_array = np.asarray(readings, dtype=np.float64)
    if reading_array.ndim != 2 or reading_array.shape[1] != 2:
        raise InputError(f"readings: shape (n, 2) is needed, not {reading_array.shape}")
    moves = None if approach is None else np.asarray(approach, dtype=np.float64)
    if moves is not None and moves.shape != reading_array.shape:
        raise InputError(f"approach: shape {reading_array.shape} is needed, not {moves.shape}")
    numbers = dict(zip(design.parameters.names, value_array.tolist(), strict=True))
    drives = [
        drive_angle(drive, numbers, reading_array[:, axis], None if moves is None else moves[:, axis])
        for axis, drive in enumerate(design.drives)
    ]
    # Only when something is wrong is it worth asking what.
    if outside == "raise" and not all(np.isfinite(drive.angle_rad).all() for drive in drives):
        check_readings(design, value_array, reading_array)
    return numbers, drives
