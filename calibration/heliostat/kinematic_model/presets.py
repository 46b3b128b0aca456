"""Published kinematic models as chains of steps: which axes, which errors, which signs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from calibration.heliostat.kinematic_model.design import (
    POSITION,
    Driven,
    DriveTerms,
    HeliostatDesign,
    LinearActuator,
    ReadingUnit,
    RotaryDrive,
    Shift,
    Step,
    Turn,
)
from calibration.heliostat.kinematic_model.parameters import Parameters, Quantity
from heliogauge.errors import InputError
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, float_array

_EAST, _NORTH, _UP = np.eye(3)
_WEST, _SOUTH, _DOWN = -np.eye(3)
#: Azimuth clockwise from north and elevation: one turn either way, and whatever is not upside down [rad].
_TURN, _QUARTER = 2 * np.pi, np.pi / 2
_TILTS, _OFFSETS = ("tilt_north", "tilt_east"), ("azimuth_offset", "elevation_offset")
#: Terms that `with_drive_terms` knows.
DRIVE_TERMS = ("scale", "worm", "worm2", "sag", "backlash")


@dataclass(frozen=True, slots=True)
class ActuatorNumbers(ShortRepr):
    """Delivered numbers of one linear actuator.

    initial_angle_rad: Angle of the axis at reading 0, as the plant counts it [rad].
    initial_stroke_m, offset_m, pivot_radius_m: Stroke at reading 0 and the two fixed sides of the triangle [m].
    increment_per_m: Counts per metre of stroke [1/m].
    clockwise: Sense of the axis.
    count_limits: Lowest and highest reading.
    """

    initial_angle_rad: float
    initial_stroke_m: float
    offset_m: float
    pivot_radius_m: float
    increment_per_m: float
    clockwise: bool
    count_limits: tuple[float, float]


def azimuth_elevation(
    name: str, position_m: npt.ArrayLike, *, rad_per_reading: Sequence[float] | None = None, printed_tilts: bool = False
) -> HeliostatDesign:
    """Return the eight-parameter azimuth-elevation heliostat of Malan (2014), section 4.2.

    position_m (3,): Intersection of its axes: east, north, up [m].
    rad_per_reading: Angle of one count of azimuth and of elevation [rad]; readings are radians if not given.
    printed_tilts: Take the tilts with the matrices as printed (4.16, 4.17) instead of as tilts toward north and
        east; to first order printed tilt_north = -(toward east), printed tilt_east = toward north.
    Returns: Readings are azimuth (0 = north, clockwise) and elevation of the normal; angle = reading + offset. The
        mirror's frame has y along the normal, z up, and x to the east when the mirror faces north. Free sets:
        ``"2"`` offsets, ``"5"`` angles, ``"8"`` all.
    InputError: Numbers that cannot be.

    Chain (4.12) to (4.18): tilt, azimuth, non-orthogonality, elevation. Positive non-orthogonality, as printed,
    raises the east end of the elevation axis of a mirror that faces north.
    """
    tilts = (Turn(_WEST, "tilt_north"), Turn(_NORTH, "tilt_east"))
    if printed_tilts:
        tilts = (Turn(_SOUTH, "tilt_north"), Turn(_WEST, "tilt_east"))
    steps = (Shift(POSITION), *tilts, Driven(_DOWN, 0), Turn(_SOUTH, "non_orthogonality"), Driven(_EAST, 1))
    angles = (*_TILTS, *_OFFSETS, "non_orthogonality")
    table = _position(position_m) | dict.fromkeys(angles, Quantity(0.0, "rad"))
    free_sets = {"2": _OFFSETS, "5": angles, "8": angles + POSITION}
    return _rotary(name, steps, table, free_sets, rad_per_reading=rad_per_reading, offset_sign=1.0)


def drone_heliostat(
    name: str,
    position_m: npt.ArrayLike,
    arm_m: Sequence[float],
    *,
    pylon_length_m: float = 1.5,
    rad_per_reading: Sequence[float] | None = None,
) -> HeliostatDesign:
    """Return the nine-parameter heliostat of Gouws (2018), chapter 5, whose mirror stands off its axes on an arm.

    position_m (3,): Top of the upright pylon, about which the mirror turns: east, north, up [m].
    arm_m: zeta 1 along the normal and zeta 2 up in the mirror's plane [m].
    pylon_length_m: Distance of the tilting foot below the top [m].
    rad_per_reading: Angle of one count of azimuth and of elevation [rad]; readings are radians if not given.
    Returns: Readings are azimuth and elevation; reading = angle + offset (5.24, 5.25), the other way round than in
        `azimuth_elevation`. Tilts are right-handed about east and north. Free sets: ``"2"`` offsets, ``"4"``
        offsets and tilts, ``"9"`` all but the pylon's length.
    InputError: Numbers that cannot be.

    Equations (5.24) to (5.42). The thesis estimates the vector T from pylon to target; here the target stands and the
    position is -T.
    """
    foot, top = Shift((None, None, "pylon_length"), -1.0), Shift((None, None, "pylon_length"))
    tilts = (Turn(_EAST, "tilt_about_east"), Turn(_NORTH, "tilt_about_north"))
    arm = Shift((None, "arm_normal", "arm_up"))
    steps = (Shift(POSITION), foot, *tilts, top, Driven(_DOWN, 0), Driven(_EAST, 1), arm)
    angles = (*_OFFSETS, "tilt_about_east", "tilt_about_north")
    lengths = {
        "arm_normal": Quantity(arm_m[0], "m"),
        "arm_up": Quantity(arm_m[1], "m"),
        "pylon_length": Quantity(pylon_length_m, "m"),
    }
    table = _position(position_m) | dict.fromkeys(angles, Quantity(0.0, "rad")) | lengths
    free_sets = {"2": _OFFSETS, "4": angles, "9": (*angles, *POSITION, "arm_normal", "arm_up")}
    return _rotary(name, steps, table, free_sets, rad_per_reading=rad_per_reading, offset_sign=-1.0)


def six_error(
    name: str, position_m: npt.ArrayLike, *, arm_normal_m: float = 0.0, rad_per_reading: Sequence[float] | None = None
) -> HeliostatDesign:
    """Return the azimuth-elevation heliostat with six angular errors of Sun et al. (2015), Guo et al. (2011).

    position_m (3,): Intersection of its axes: east, north, up [m].
    arm_normal_m: Distance of the mirror from the axes along its normal, H_z [m].
    rad_per_reading: Angle of one count of azimuth and of elevation [rad]; readings are radians if not given.
    Returns: Readings are azimuth and elevation; reading = angle + offset. Free sets: ``"2"`` offsets, ``"6"`` all
        angles, ``"10"`` with position and arm.
    InputError: Numbers that cannot be.

    ``n = tilt Rz(azimuth) Rx(tau_1) Ry(elevation) (cos mu, sin mu, 0)`` in axes north, east, up (left-handed):
    non-orthogonality tau_1 and canting mu toward clockwise azimuth.
    """
    tilts = (Turn(_WEST, "tilt_north"), Turn(_NORTH, "tilt_east"))
    axes = (Driven(_DOWN, 0), Turn(_SOUTH, "non_orthogonality"), Driven(_EAST, 1), Turn(_DOWN, "canting"))
    steps = (Shift(POSITION), *tilts, *axes, Shift((None, "arm_normal", None)))
    angles = (*_TILTS, *_OFFSETS, "non_orthogonality", "canting")
    table = (
        _position(position_m)
        | dict.fromkeys(angles, Quantity(0.0, "rad"))
        | {"arm_normal": Quantity(arm_normal_m, "m")}
    )
    free_sets = {"2": _OFFSETS, "6": angles, "10": (*angles, *POSITION, "arm_normal")}
    return _rotary(name, steps, table, free_sets, rad_per_reading=rad_per_reading, offset_sign=-1.0)


def two_axes(
    name: str,
    position_m: npt.ArrayLike,
    axes: npt.ArrayLike,
    normal: npt.ArrayLike,
    *,
    arm_m: Sequence[float] = (0.0, 0.0, 0.0),
    rad_per_reading: Sequence[float] | None = None,
) -> HeliostatDesign:
    """Return a heliostat with any two axes: pitch and roll, an axis that points at the tower, and so on.

    position_m (3,): Point of the first axis: east, north, up [m].
    axes (2, 3): Directions of the first axis, which stands still, and of the second as it is at readings 0;
        right-handed turns.
    normal (3,): The mirror's normal at readings 0.
    arm_m: From the axes to the mirror's centre at readings 0: east, north, up [m].
    rad_per_reading: Angle of one count of each axis [rad]; readings are radians if not given.
    Returns: angle = reading + offset, a quarter turn either way unless the limits are replaced. The mirror's frame
        is the field's at readings 0. Free sets: ``"2"`` offsets, ``"6"`` all angles, ``"12"`` with position and
        arm.
    InputError: The second axis is parallel to the first, or the normal to the second.

    Six angular errors, as many as two axes can have: the first axis leans toward the second (`lean_along`) or toward
    the common perpendicular ``axis 1 x axis 2`` (`lean_across`), two offsets, the angle between the axes
    (`non_orthogonality`), and that between second axis and normal (`canting`).
    """
    first, second = (_direction(f"axis {i + 1}", axis) for i, axis in enumerate(float_array("axes", axes, (2, 3))))
    facing = _direction("normal", float_array("normal", normal, (3,)))
    common, across = np.cross(first, second), np.cross(second, facing)
    if min(np.linalg.norm(common), np.linalg.norm(across)) < 1e-3:
        raise InputError(f"{name}: the axes, or second axis and normal, are parallel: no two axes point such a mirror")
    arm = Shift(("arm_e", "arm_n", "arm_u"))
    leans = (Turn(common, "lean_along"), Turn(np.cross(first, common), "lean_across"))
    drives = (Driven(first, 0), Turn(common, "non_orthogonality"), Driven(second, 1))
    steps = (Shift(POSITION), *leans, *drives, Turn(across, "canting"), arm)
    offsets = ("offset_1", "offset_2")
    angles = ("lean_along", "lean_across", *offsets, "non_orthogonality", "canting")
    table = _position(position_m) | dict.fromkeys(angles, Quantity(0.0, "rad")) | _lengths(arm, arm_m)
    free_sets = {"2": offsets, "6": angles, "12": (*angles, *POSITION, "arm_e", "arm_n", "arm_u")}
    design = _rotary(name, steps, table, free_sets, rad_per_reading=rad_per_reading, offset_sign=1.0)
    quarter = np.broadcast_to(_QUARTER / np.abs(1.0 if rad_per_reading is None else rad_per_reading), 2)
    return replace(design, normal=facing, limits=np.outer(quarter, [-1.0, 1.0]))


def linear_actuators(
    name: str,
    position_m: npt.ArrayLike,
    actuators: tuple[ActuatorNumbers, ActuatorNumbers],
    *,
    concentrator_m: Sequence[float] = (0.0, 0.175, 0.0),
    joints_m: Sequence[Sequence[float]] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
) -> HeliostatDesign:
    """Return a heliostat with two linear actuators, as those of the solar tower at Juelich.

    position_m (3,): Where its first axis stands: east, north, up [m].
    actuators: Delivered numbers of axis 1 (about east: elevation) and axis 2 (about up: azimuth).
    concentrator_m: From the second axis to the mirror's centre, in the frame of the mirror that looks south [m].
    joints_m: Shifts of the first and of the second joint [m].
    Returns: Readings are counts. Free sets: ``"4"`` the tilts; ``"8"`` with both initial angles and initial
        strokes; ``"15"`` with offsets and pivot radii of the triangles and the position. Axis 1's initial angle and
        tilt_2_e are the same turn: a fit that frees both has one combination too many.
    InputError: Numbers that cannot be.

    ``R_n(tilt_1_n) R_u(tilt_1_u) R_e(axis 1) R_e(tilt_2_e) R_n(tilt_2_n) R_u(axis 2)`` on the normal (0, -1, 0). The
    plant counts axis 1 from the mirror that looks at the zenith, hence its -pi/2.
    """
    drives = (_actuator(1, actuators[0], -np.pi / 2), _actuator(2, actuators[1], 0.0))
    tables = [_actuator_table(drive, numbers) for drive, numbers in zip(drives, actuators, strict=True)]
    steps, table = _south_chain(position_m, concentrator_m, joints_m, tables)
    limits = np.array([numbers.count_limits for numbers in actuators])
    return HeliostatDesign(name, steps, drives, _SOUTH, Parameters.of(table), limits, "counts", _LINEAR_FREE_SETS)


def ideal_actuators(
    name: str,
    position_m: npt.ArrayLike,
    limits_rad: Sequence[tuple[float, float]],
    *,
    concentrator_m: Sequence[float] = (0.0, 0.175, 0.0),
    joints_m: Sequence[Sequence[float]] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
) -> HeliostatDesign:
    """Return a heliostat of the chain of `linear_actuators` whose motor positions are the angles of its axes.

    position_m (3,): Where its first axis stands: east, north, up [m].
    limits_rad: Lowest and highest angle of axis 1 (about east) and axis 2 (about up); a turn either way where they
        are no angles, as the counts that public files keep beside ideal actuators [rad].
    concentrator_m: From the second axis to the mirror's centre, in the frame of the mirror that looks south [m].
    joints_m: Shifts of the first and of the second joint [m].
    Returns: Readings are radians, counted from the mirror that looks south; angle = reading + initial angle, which is
        0. Free sets: ``"4"`` the tilts, ``"5"`` with the second axis' initial angle, ``"8"`` with the position.
        Axis 1's initial angle and tilt_2_e are the same turn, as in `linear_actuators`.
    InputError: Numbers that cannot be.

    ARTIST's ``IdealActuators`` return a motor position as the joint's angle, whatever their other numbers say.
    """
    tables = [{start: Quantity(0.0, "rad")} for start in _IDEAL_STARTS]
    steps, table = _south_chain(position_m, concentrator_m, joints_m, tables)
    first, second = (RotaryDrive(start) for start in _IDEAL_STARTS)
    limits = np.array(limits_rad, dtype=np.float64)
    limits = np.where((np.abs(limits) <= _TURN).all(axis=1, keepdims=True), limits, [-_TURN, _TURN])
    return HeliostatDesign(name, steps, (first, second), _SOUTH, Parameters.of(table), limits, "rad", _IDEAL_FREE_SETS)


def _south_chain(
    position_m: npt.ArrayLike,
    concentrator_m: Sequence[float],
    joints_m: Sequence[Sequence[float]],
    drives: Sequence[dict[str, Quantity]],
) -> tuple[tuple[Step, ...], dict[str, Quantity]]:
    """Return the chain of a mirror that looks south at angles 0, and its numbers with those of both drives."""
    table = _position(position_m)
    steps: list[Step] = [Shift(POSITION)]
    for axis, (first, second), driven in ((1, "nu", Driven(_EAST, 0)), (2, "en", Driven(_UP, 1))):
        directions = {"e": _EAST, "n": _NORTH, "u": _UP}
        joint = Shift((f"joint_{axis}_e", f"joint_{axis}_n", f"joint_{axis}_u"))
        steps += [Turn(directions[first], f"tilt_{axis}_{first}"), Turn(directions[second], f"tilt_{axis}_{second}")]
        steps += [joint, driven]
        table |= {f"tilt_{axis}_{first}": Quantity(0.0, "rad"), f"tilt_{axis}_{second}": Quantity(0.0, "rad")}
        table |= _lengths(joint, joints_m[axis - 1]) | drives[axis - 1]
    concentrator = Shift(("concentrator_e", "concentrator_n", "concentrator_u"))
    return (*steps, concentrator), table | _lengths(concentrator, concentrator_m)


_LINEAR_TILTS = ("tilt_1_n", "tilt_1_u", "tilt_2_e", "tilt_2_n")
_LINEAR_STARTS = ("initial_angle_1", "initial_stroke_1", "initial_angle_2", "initial_stroke_2")
_LINEAR_SIDES = ("offset_1", "pivot_radius_1", "offset_2", "pivot_radius_2")
_LINEAR_FREE_SETS = {
    "4": _LINEAR_TILTS,
    "8": _LINEAR_TILTS + _LINEAR_STARTS,
    "15": _LINEAR_TILTS + _LINEAR_STARTS + _LINEAR_SIDES + POSITION,
}
_IDEAL_STARTS = ("initial_angle_1", "initial_angle_2")
_IDEAL_FREE_SETS = {
    "4": _LINEAR_TILTS,
    "5": (*_LINEAR_TILTS, _IDEAL_STARTS[1]),
    "8": (*_LINEAR_TILTS, _IDEAL_STARTS[1], *POSITION),
}


def with_drive_terms(
    design: HeliostatDesign, drive: int, terms: Sequence[str], *, worm_ratio: float = 0.0, sag_zero_rad: float = 0.0
) -> HeliostatDesign:
    """Return the same heliostat whose drive may have more errors; each is 0 (the scale 1) and held.

    terms: Any of ``"scale"`` (rotary drives only), ``"worm"`` (first harmonic), ``"worm2"`` (both harmonics),
        ``"sag"``, ``"backlash"``.
    worm_ratio: Cycles of the worm per turn of the axis (per metre of a linear actuator's stroke).
    sag_zero_rad: Angle of the drive at which the mirror stands upright [rad].
    Returns: With parameters ``scale_1``, ``worm_sin_1``, ``worm_cos_1``, ``worm_sin2_1``, ``worm_cos2_1``,
        ``sag_1``, ``backlash_1`` (``_2`` for drive 1) as asked for.
    InputError: A term that does not exist, or a ratio that is missing.
    """
    unknown = sorted(set(terms) - set(DRIVE_TERMS))
    if unknown:
        raise InputError(f"drive terms: {', '.join(unknown)} unknown; known: {', '.join(DRIVE_TERMS)}")
    old, axis = design.drives[drive], drive + 1
    waves = {"worm2": ("sin", "cos", "sin2", "cos2"), "worm": ("sin", "cos")}
    wave = next((waves[term] for term in waves if term in terms), ())
    added = DriveTerms(
        worm_ratio,
        tuple(f"worm_{part}_{axis}" for part in wave),
        f"sag_{axis}" if "sag" in terms else None,
        sag_zero_rad,
        f"backlash_{axis}" if "backlash" in terms else None,
    )
    table = dict.fromkeys(added.names, Quantity(0.0, "rad"))
    new: RotaryDrive | LinearActuator
    if "scale" not in terms:
        new = replace(old, terms=added)
    elif isinstance(old, RotaryDrive):
        new, table[f"scale_{axis}"] = replace(old, terms=added, scale=f"scale_{axis}"), Quantity(1.0, "1")
    else:
        raise InputError(f"drive terms: the scale of a linear actuator is its parameter {old.increment}")
    drives = (new, design.drives[1]) if drive == 0 else (design.drives[0], new)
    return replace(design, drives=drives, parameters=design.parameters.extended(Parameters.of(table)))


def _rotary(
    name: str,
    steps: tuple[Step, ...],
    table: Mapping[str, Quantity],
    free_sets: Mapping[str, tuple[str, ...]],
    *,
    rad_per_reading: Sequence[float] | None,
    offset_sign: float,
) -> HeliostatDesign:
    per_reading = float_array("rad_per_reading", (1.0, 1.0) if rad_per_reading is None else rad_per_reading, (2,))
    first, second = (
        RotaryDrive(offset, float(size), offset_sign=offset_sign)
        for offset, size in zip(free_sets["2"], per_reading, strict=True)
    )
    limits = np.abs(np.array([_TURN, _QUARTER]) / per_reading)[:, None] * [-1.0, 1.0]
    unit: ReadingUnit = "rad" if rad_per_reading is None else "counts"
    parameters = Parameters.of(table)
    return HeliostatDesign(name, steps, (first, second), _NORTH, parameters, limits, unit, free_sets)


def _position(position_m: npt.ArrayLike) -> dict[str, Quantity]:
    return _lengths(Shift(POSITION), float_array("position_m", position_m, (3,)).tolist())


def _direction(name: str, vector: FloatArray) -> FloatArray:
    length = float(np.linalg.norm(vector))
    if length == 0:
        raise InputError(f"{name}: a vector of length zero has no direction")
    return np.asarray(vector / length)


def _lengths(shift: Shift, lengths_m: Sequence[float]) -> dict[str, Quantity]:
    named = zip(shift.names, lengths_m, strict=True)
    return {name: Quantity(float(length), "m") for name, length in named if name is not None}


def _actuator(axis: int, numbers: ActuatorNumbers, zero_rad: float) -> LinearActuator:
    return LinearActuator(
        initial_angle=f"initial_angle_{axis}",
        initial_stroke=f"initial_stroke_{axis}",
        offset=f"offset_{axis}",
        pivot_radius=f"pivot_radius_{axis}",
        increment=f"increment_{axis}",
        clockwise=numbers.clockwise,
        zero_rad=zero_rad,
    )


def _actuator_table(drive: LinearActuator, numbers: ActuatorNumbers) -> dict[str, Quantity]:
    return {
        drive.initial_angle: Quantity(numbers.initial_angle_rad, "rad"),
        drive.initial_stroke: Quantity(numbers.initial_stroke_m, "m"),
        drive.offset: Quantity(numbers.offset_m, "m"),
        drive.pivot_radius: Quantity(numbers.pivot_radius_m, "m"),
        drive.increment: Quantity(numbers.increment_per_m, "1/m"),
    }
