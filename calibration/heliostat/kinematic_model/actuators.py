"""From the reading of a drive to the angle of its axis and back, with derivatives by every number in between."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calibration.heliostat.kinematic_model.design import Drive, DriveTerms, HeliostatDesign, LinearActuator, RotaryDrive
from heliogauge.errors import InputError
from heliogauge.validate import FloatArray

# Newton on a worm term of 10 mrad and a ratio of 30 gains a digit in the first step and doubles them after that.
_NEWTON_STEPS = 30


@dataclass(frozen=True, slots=True, eq=False)
class DriveAngle:
    """Angle of an axis at some readings, with its derivatives.

    angle_rad (n,): Angle; NaN where the reading lies outside the actuator's geometry [rad].
    per_reading (n,): Derivative by the reading [rad per reading].
    by_parameter (n,): Derivative by each parameter that the drive uses [rad per unit of the parameter].
    """

    angle_rad: FloatArray
    per_reading: FloatArray
    by_parameter: Mapping[str, FloatArray]


class _Base(NamedTuple):
    """Angle and phase of the periodic error before the terms, each with its derivatives (base, phase)."""

    angle: FloatArray
    phase: FloatArray
    by_reading: tuple[FloatArray, FloatArray]
    by_parameter: dict[str, tuple[FloatArray, FloatArray]]


def drive_angle(
    drive: Drive, numbers: Mapping[str, float], readings: FloatArray, approach: FloatArray | None = None
) -> DriveAngle:
    """Return the angle of an axis.

    numbers: Value of each parameter by name.
    readings (n,): Readings in the design's unit.
    approach (n,): Direction of the last move: +1 to larger readings, -1 to smaller ones, 0 unknown; only backlash
        asks for it.

    ``angle = base + k cos(base - sag_zero) + sum_h (a_h sin h phase + b_h cos h phase) + approach backlash / 2``.
    The phase of a rotary drive is ``worm_ratio * scale * rad_per_reading * reading``, the nominal angle of the output
    shaft times the ratio: the periodic error of a worm gear (Malan 2014, eq. 6.1), which the offset does not move.
    The phase of a linear actuator is ``2 pi worm_ratio * reading / increment``.
    """
    base = _rotary(drive, numbers, readings) if isinstance(drive, RotaryDrive) else _linear(drive, numbers, readings)
    terms = drive.terms
    if not terms.names:
        return DriveAngle(base.angle, base.by_reading[0], {name: own[0] for name, own in base.by_parameter.items()})
    return _with_terms(terms, numbers, base, np.zeros(len(readings)) if approach is None else approach)


def drive_reading(
    drive: Drive, numbers: Mapping[str, float], angles_rad: FloatArray, approach: FloatArray | None = None
) -> FloatArray:
    """Return the readings at which an axis has these angles; the inverse of `drive_angle`.

    Shapes: angles_rad (n,).
    numbers: Value of each parameter by name.
    approach (n,): Direction of the move that will lead there; see `drive_angle`.
    Returns (n,): Readings; NaN for an angle that the actuator cannot reach.

    In closed form, followed by Newton's method where the drive has terms.
    """
    inverse = _rotary_reading if isinstance(drive, RotaryDrive) else _linear_reading
    readings = inverse(drive, numbers, angles_rad)  # type: ignore[arg-type]
    if not drive.terms.names:
        return readings
    # The last step only removes rounding; what is at most two units in the last place of the reading is not worth one.
    for _ in range(_NEWTON_STEPS):
        found = drive_angle(drive, numbers, readings, approach)
        step = (found.angle_rad - angles_rad) / found.per_reading
        readings = readings - step
        if not (np.abs(step) > 4e-16 * np.abs(readings)).any():
            break
    return readings


def check_readings(design: HeliostatDesign, values: FloatArray, readings: FloatArray) -> None:
    """Refuse readings that the drives cannot have.

    Shapes: readings (n, 2).
    values (p,): Its numbers, in the order of ``design.parameters``.
    InputError: A reading is not finite, or the triangle of a linear actuator does not close; the message names the
        first row (counted from 0), the reading and the argument of the arc cosine.
    """
    numbers = dict(zip(design.parameters.names, values.tolist(), strict=True))
    for axis, drive in enumerate(design.drives):
        row = int(np.argmin(np.isfinite(readings[:, axis]))) if len(readings) else 0
        if len(readings) and not np.isfinite(readings[row, axis]):
            raise InputError(f"{design.name}: row {row}: the reading of axis {axis + 1} is not a number")
        if isinstance(drive, LinearActuator):
            _check_triangle(design, axis, drive, numbers, readings[:, axis])


def _check_triangle(
    design: HeliostatDesign, axis: int, drive: LinearActuator, numbers: Mapping[str, float], readings: FloatArray
) -> None:
    start, side, other, increment = _triangle(drive, numbers)
    # Row -1 stands for reading 0, the angle from which all others are counted.
    strokes = np.append(start + readings / increment, start)
    argument = (side**2 + other**2 - strokes**2) / (2 * side * other)
    outside = ~(np.abs(argument) < 1)
    if not outside.any():
        return
    row = int(np.argmax(outside))
    where = f"row {row}: reading {readings[row]:g}" if row < len(readings) else "reading 0"
    raise InputError(
        f"{design.name}: {where} of axis {axis + 1} is a stroke of {strokes[row]:.4f} m, which does not close the "
        f"triangle with sides {side:.4f} m ({drive.offset}) and {other:.4f} m ({drive.pivot_radius}): "
        f"acos({argument[row]:.4f}); check the reading, {drive.increment} and the lengths"
    )


def _rotary(drive: RotaryDrive, numbers: Mapping[str, float], readings: FloatArray) -> _Base:
    scale = 1.0 if drive.scale is None else numbers[drive.scale]
    factor, ratio = scale * drive.rad_per_reading, drive.terms.worm_ratio
    nominal = factor * readings
    even, none = np.full(len(readings), factor), np.zeros(len(readings))
    by_parameter = {drive.offset: (none + drive.offset_sign, none)}
    if drive.scale is not None:
        by_parameter[drive.scale] = (drive.rad_per_reading * readings, ratio * drive.rad_per_reading * readings)
    angle = nominal + drive.offset_sign * numbers[drive.offset]
    return _Base(angle, ratio * nominal, (even, ratio * even), by_parameter)


def _rotary_reading(drive: RotaryDrive, numbers: Mapping[str, float], angles_rad: FloatArray) -> FloatArray:
    scale = 1.0 if drive.scale is None else numbers[drive.scale]
    return np.asarray((angles_rad - drive.offset_sign * numbers[drive.offset]) / (scale * drive.rad_per_reading))


class _Triangle(NamedTuple):
    """Stroke at reading 0 and the two other sides [m], readings per metre."""

    start: float
    side: float
    other: float
    increment: float


def _triangle(drive: LinearActuator, numbers: Mapping[str, float]) -> _Triangle:
    names = (drive.initial_stroke, drive.offset, drive.pivot_radius, drive.increment)
    return _Triangle(*(numbers[name] for name in names))


# A fit may try numbers whose triangle is open, or an increment of almost nothing: callers see what is not finite.
@np.errstate(invalid="ignore", divide="ignore", over="ignore")
def _linear(drive: LinearActuator, numbers: Mapping[str, float], readings: FloatArray) -> _Base:
    start, side, other, increment = _triangle(drive, numbers)
    sign, pitch = (1.0 if drive.clockwise else -1.0), 2 * np.pi * drive.terms.worm_ratio
    extension = readings / increment
    # The last entry is reading 0: both ends of the difference come from one evaluation.
    strokes = np.append(start + extension, start)
    cosine = (side**2 + other**2 - strokes**2) / (2 * side * other)
    inner = np.arccos(cosine)
    per_sine = 1 / np.sqrt((1 - cosine) * (1 + cosine))
    by_stroke = strokes / (side * other) * per_sine
    by_side, by_other = (cosine / side - 1 / other) * per_sine, (cosine / other - 1 / side) * per_sine
    none, per_reading = np.zeros(len(readings)), -sign * by_stroke[:-1] / increment
    by_parameter = {
        drive.initial_angle: (none + 1.0, none),
        drive.initial_stroke: (sign * (by_stroke[-1] - by_stroke[:-1]), none),
        drive.offset: (sign * (by_side[-1] - by_side[:-1]), none),
        drive.pivot_radius: (sign * (by_other[-1] - by_other[:-1]), none),
        drive.increment: (-per_reading * extension, -pitch * extension / increment),
    }
    angle = drive.zero_rad + numbers[drive.initial_angle] + sign * (inner[-1] - inner[:-1])
    return _Base(angle, pitch * extension, (per_reading, none + pitch / increment), by_parameter)


def _linear_reading(drive: LinearActuator, numbers: Mapping[str, float], angles_rad: FloatArray) -> FloatArray:
    start, side, other, increment = _triangle(drive, numbers)
    sign = 1.0 if drive.clockwise else -1.0
    with np.errstate(invalid="ignore"):
        first = np.arccos((side**2 + other**2 - start**2) / (2 * side * other))
        inner = first - sign * (angles_rad - drive.zero_rad - numbers[drive.initial_angle])
        # Half angles: (o - r)^2 + 4 o r sin^2(a / 2) loses nothing where the triangle is nearly flat.
        stroke = np.sqrt((side - other) ** 2 + 4 * side * other * np.sin(inner / 2) ** 2)
    stroke = np.where((inner > 0) & (inner < np.pi), stroke, np.nan)
    return np.asarray((stroke - start) * increment)


def _with_terms(terms: DriveTerms, numbers: Mapping[str, float], base: _Base, approach: FloatArray) -> DriveAngle:
    angle, own = base.angle.copy(), {}
    gain = np.ones(len(angle))
    wobble = np.zeros(len(angle))
    if terms.sag is not None:
        lever = base.angle - terms.sag_zero_rad
        own[terms.sag] = np.cos(lever)
        angle += numbers[terms.sag] * own[terms.sag]
        gain -= numbers[terms.sag] * np.sin(lever)
    for harmonic, (sine, cosine) in enumerate(zip(terms.worm[::2], terms.worm[1::2], strict=True), start=1):
        own[sine], own[cosine] = np.sin(harmonic * base.phase), np.cos(harmonic * base.phase)
        angle += numbers[sine] * own[sine] + numbers[cosine] * own[cosine]
        wobble += harmonic * (numbers[sine] * own[cosine] - numbers[cosine] * own[sine])
    if terms.backlash is not None:
        own[terms.backlash] = approach / 2
        angle += numbers[terms.backlash] * own[terms.backlash]
    by_parameter = {name: gain * of_base + wobble * of_phase for name, (of_base, of_phase) in base.by_parameter.items()}
    per_reading = gain * base.by_reading[0] + wobble * base.by_reading[1]
    return DriveAngle(angle, per_reading, by_parameter | own)
