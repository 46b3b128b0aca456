"""Where a heliostat's mirror stands at given readings, with derivatives by every parameter of the chain."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from calibration.heliostat.actuators import check_readings, drive_angle
from calibration.heliostat.design import Driven, HeliostatDesign, Shift, Turn
from heliogauge.errors import InputError
from heliogauge.rigid import rotation_from_vector, skew
from heliogauge.validate import FloatArray

IndexArray = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class MirrorPoses:
    """Poses of a mirror in the field's frame.

    Parameters
    ----------
    rotation : ndarray, shape (n, 3, 3)
        ``world_from_mirror`` rotation matrices.
    centre_m : ndarray, shape (n, 3)
        The mirror's centre [m].
    """

    rotation: FloatArray
    centre_m: FloatArray

    def normals(self, design: HeliostatDesign) -> FloatArray:
        """Return the outward unit normals, shape (n, 3)."""
        return _apply(self.rotation, design.normal)

    def points(self, points_mirror_m: npt.ArrayLike) -> FloatArray:
        """Return points fixed on the mirror, (3,) or (n, 3) in its frame [m], in the field's frame, (n, 3) [m]."""
        points = np.asarray(points_mirror_m, dtype=np.float64)
        return np.asarray((self.rotation @ points[..., None])[..., 0] + self.centre_m)


@dataclass(frozen=True, slots=True, eq=False)
class PoseDerivatives:
    """Poses of a mirror and how they change with the parameters.

    Parameters
    ----------
    poses : MirrorPoses
        The poses.
    omega : ndarray, shape (n, 3, k)
        Rotation vector per unit of each parameter: a direction d fixed in the mirror changes by ``omega x d`` [rad].
    shift : ndarray, shape (n, 3, k)
        Change of the mirror's centre per unit of each parameter [m].
    columns : ndarray of int, shape (k,)
        Position of each parameter in ``design.parameters``.
    """

    poses: MirrorPoses
    omega: FloatArray
    shift: FloatArray
    columns: IndexArray


class Motion(NamedTuple):
    """What one step of the chain contributes: a turn (axis, origin) or a shift (axis, no origin) per unit."""

    name: str
    axis: FloatArray
    origin: FloatArray | None
    gain: FloatArray | float


def mirror_poses(
    design: HeliostatDesign,
    values: npt.ArrayLike,
    readings: npt.ArrayLike,
    approach: npt.ArrayLike | None = None,
    *,
    outside: Literal["raise", "nan"] = "raise",
) -> MirrorPoses:
    """Return the poses of the mirror at some readings.

    Parameters
    ----------
    design : HeliostatDesign
        The heliostat.
    values : array_like, shape (p,)
        Its numbers, in the order of ``design.parameters``.
    readings : array_like, shape (n, 2)
        Readings of both drives in the design's unit.
    approach : array_like, shape (n, 2), optional
        Direction of each drive's last move: +1 to larger readings, -1 to smaller ones, 0 unknown.
    outside : {"raise", "nan"}, optional
        What to do with readings that a linear actuator cannot have: refuse them all, or give those rows as NaN (for
        a fit on its way).

    Returns
    -------
    MirrorPoses
        One pose per row.

    Raises
    ------
    InputError
        Shapes that do not fit, or readings outside the geometry of an actuator.
    """
    values, readings, approach = _checked(design, values, readings, approach, outside)
    numbers = dict(zip(design.parameters.names, values.tolist(), strict=True))
    angles = [
        drive_angle(drive, numbers, readings[:, axis], None if approach is None else approach[:, axis]).angle_rad
        for axis, drive in enumerate(design.drives)
    ]
    return chain_poses(design, numbers, angles)


def pose_derivatives(
    design: HeliostatDesign,
    values: npt.ArrayLike,
    readings: npt.ArrayLike,
    approach: npt.ArrayLike | None = None,
    *,
    columns: Sequence[int] | IndexArray | None = None,
    outside: Literal["raise", "nan"] = "raise",
) -> PoseDerivatives:
    """Return the poses of the mirror with their derivatives by the parameters.

    Parameters
    ----------
    design : HeliostatDesign
        The heliostat.
    values : array_like, shape (p,)
        Its numbers, in the order of ``design.parameters``.
    readings : array_like, shape (n, 2)
        Readings of both drives in the design's unit.
    approach : array_like, shape (n, 2), optional
        Direction of each drive's last move: +1 to larger readings, -1 to smaller ones, 0 unknown.
    columns : sequence of int, optional
        Positions of the wanted parameters in ``design.parameters``; all of them if not given.
    outside : {"raise", "nan"}, optional
        What to do with readings that a linear actuator cannot have: refuse them all, or give those rows as NaN.

    Returns
    -------
    PoseDerivatives
        Poses and derivatives; columns of parameters that the chain does not use are zero.

    Raises
    ------
    InputError
        Shapes that do not fit, or readings outside the geometry of an actuator.

    Notes
    -----
    The geometric Jacobian of a serial chain: a parameter that turns about the axis w through the point q moves a centre
    c by ``w x (c - q)`` and turns everything behind it by w.
    """
    values, readings, approach = _checked(design, values, readings, approach, outside)
    wanted = np.arange(len(design.parameters)) if columns is None else np.asarray(columns, dtype=np.intp)
    position = {design.parameters.names[index]: column for column, index in enumerate(wanted)}
    numbers = dict(zip(design.parameters.names, values.tolist(), strict=True))
    drives = [
        drive_angle(drive, numbers, readings[:, axis], None if approach is None else approach[:, axis])
        for axis, drive in enumerate(design.drives)
    ]
    gains = [drive.by_parameter for drive in drives]
    motions: list[Motion] = []
    poses = chain_poses(design, numbers, [drive.angle_rad for drive in drives], gains, motions)
    used = [motion for motion in motions if motion.name in position]
    # Parameters first: each motion writes one block without strides; the last axis of the result is theirs.
    omega = np.zeros((len(wanted), len(readings), 3))
    shift = np.zeros((len(wanted), len(readings), 3))
    for motion in used:
        column = position[motion.name]
        if motion.origin is None:
            shift[column] += motion.gain * motion.axis
            continue
        turn = motion.axis * (motion.gain[:, None] if isinstance(motion.gain, np.ndarray) else motion.gain)
        omega[column] += turn
        _add_cross(shift[column], turn, poses.centre_m - motion.origin)
    return PoseDerivatives(poses, omega.transpose(1, 2, 0), shift.transpose(1, 2, 0), wanted)


def chain_poses(
    design: HeliostatDesign,
    numbers: Mapping[str, float],
    angles_rad: Sequence[FloatArray],
    gains: Sequence[Mapping[str, FloatArray]] | None = None,
    motions: list[Motion] | None = None,
) -> MirrorPoses:
    """Return the poses at given angles of the two axes.

    Parameters
    ----------
    design : HeliostatDesign
        The heliostat.
    numbers : mapping
        Value of each parameter by name.
    angles_rad : sequence of ndarray, shape (n,)
        Angle of each drive [rad].
    gains : sequence of mapping, optional
        Derivative of each drive's angle by its parameters; needed for `motions`.
    motions : list, optional
        Takes up what each parameter moves.

    Returns
    -------
    MirrorPoses
        One pose per angle.
    """
    # One row while nothing moves; rotations broadcast against the points until the first drive.
    rotation, centre = np.eye(3)[None], np.zeros((1, 3))
    for step in design.steps:
        if isinstance(step, Shift):
            offset = np.array([0.0 if name is None else step.sign * numbers[name] for name in step.names])
            if motions is not None:
                columns = [(name, i) for i, name in enumerate(step.names) if name is not None]
                motions.extend(Motion(name, rotation[:, :, i], None, step.sign) for name, i in columns)
            centre = centre + _apply(rotation, offset)
            continue
        if motions is not None:
            axis = _apply(rotation, step.axis)
            if isinstance(step, Turn):
                motions.append(Motion(step.angle, axis, centre, 1.0))
            elif gains is not None:
                motions.extend(Motion(name, axis, centre, gain) for name, gain in gains[step.drive].items())
        if isinstance(step, Turn):
            rotation = _times(rotation, rotation_from_vector(numbers[step.angle] * step.axis))
        else:
            rotation = _driven(rotation, step, angles_rad[step.drive])
    count = len(angles_rad[0])
    return MirrorPoses(np.broadcast_to(rotation, (count, 3, 3)), np.broadcast_to(centre, (count, 3)))


def _driven(rotation: FloatArray, step: Driven, angle: FloatArray) -> FloatArray:
    """Multiply by Rodrigues' rotation: with a constant axis only two constant products are needed."""
    cross = skew(step.axis)
    sine, versine = np.sin(angle)[:, None, None], 2 * np.sin(angle / 2)[:, None, None] ** 2
    return np.asarray(rotation + sine * _times(rotation, cross) + versine * _times(rotation, cross @ cross))


def _times(rotation: FloatArray, matrix: FloatArray) -> FloatArray:
    # One product of (3 n, 3) with (3, 3): a stack of small products is four times slower.
    return np.asarray((rotation.reshape(-1, 3) @ matrix).reshape(-1, 3, 3))


def _apply(rotation: FloatArray, vector: FloatArray) -> FloatArray:
    return np.asarray((rotation.reshape(-1, 3) @ vector).reshape(-1, 3))


def _add_cross(into: FloatArray, first: FloatArray, second: FloatArray) -> None:
    # numpy.cross spends 30 microseconds on its arguments; a chain has fifteen of these.
    into[:, 0] += first[:, 1] * second[:, 2] - first[:, 2] * second[:, 1]
    into[:, 1] += first[:, 2] * second[:, 0] - first[:, 0] * second[:, 2]
    into[:, 2] += first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]


def _checked(
    design: HeliostatDesign,
    values: npt.ArrayLike,
    readings: npt.ArrayLike,
    approach: npt.ArrayLike | None,
    outside: Literal["raise", "nan"],
) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    value_array = np.asarray(values, dtype=np.float64)
    if value_array.shape != (len(design.parameters),):
        raise InputError(f"values: shape ({len(design.parameters)},) is needed, not {value_array.shape}")
    reading_array = np.asarray(readings, dtype=np.float64)
    if reading_array.ndim != 2 or reading_array.shape[1] != 2:
        raise InputError(f"readings: shape (n, 2) is needed, not {reading_array.shape}")
    approach_array = None if approach is None else np.asarray(approach, dtype=np.float64)
    if approach_array is not None and approach_array.shape != reading_array.shape:
        raise InputError(f"approach: shape {reading_array.shape} is needed, not {approach_array.shape}")
    if outside == "raise":
        check_readings(design, value_array, reading_array)
    return value_array, reading_array, approach_array
