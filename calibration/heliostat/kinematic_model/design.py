"""What a heliostat and its targets are: a chain of rigid steps with named parameters; nothing is estimated.

Frame of the field: x east, y north, z up [m]. A chain runs from the ground to the mirror; each step's axis or shift is
written in the frame that the steps before it have reached.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np

from calibration.heliostat.kinematic_model.parameters import Parameters
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import skew
from heliogauge.geometry.target_planes import PlaneTarget, unit_vector
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, float_array, freeze, positive

__all__ = [
    "POSITION",
    "Drive",
    "DriveTerms",
    "Driven",
    "HeliostatDesign",
    "LinearActuator",
    "PlaneTarget",
    "ReadingUnit",
    "RotaryDrive",
    "Shift",
    "Step",
    "Turn",
]

#: Names that every design has: where the chain stands.
POSITION = ("position_e", "position_n", "position_u")
ReadingUnit: TypeAlias = Literal["counts", "rad"]


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """A rotation by a named parameter about an axis that is fixed in the frame so far.

    axis (3,): Direction of the axis, of any length; the rotation is right-handed about it.
    angle: Name of the parameter [rad].
    """

    axis: FloatArray
    angle: str
    #: The axis' cross-product matrix and its square, shape (2, 3, 3): R = I + sin K + (1 - cos) K^2.
    generator: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "axis", unit_vector(f"axis of {self.angle}", self.axis))
        object.__setattr__(self, "generator", _generator(self.axis))


@dataclass(frozen=True, slots=True)
class Shift:
    """A translation by three named parameters.

    names: Parameters of the three components [m]; None for a component that is zero.
    sign: +1, or -1 to shift back.
    """

    names: tuple[str | None, str | None, str | None]
    sign: float = 1.0

    def __post_init__(self) -> None:
        if abs(self.sign) != 1.0:
            raise InputError(f"shift {self.names}: a sign of +1 or -1 is needed, not {self.sign:g}")


@dataclass(frozen=True, slots=True, eq=False)
class Driven:
    """A rotation by a drive about an axis that is fixed in the frame so far.

    axis (3,): Direction of the axis, of any length; the rotation is right-handed about it.
    drive: 0 or 1, the position in the design's `drives`.
    """

    axis: FloatArray
    drive: int
    #: The axis' cross-product matrix and its square, shape (2, 3, 3): R = I + sin K + (1 - cos) K^2.
    generator: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.drive not in (0, 1):
            raise InputError(f"driven step: drive 0 or 1 is needed, not {self.drive}")
        object.__setattr__(self, "axis", unit_vector(f"axis of drive {self.drive}", self.axis))
        object.__setattr__(self, "generator", _generator(self.axis))


@dataclass(frozen=True, slots=True)
class DriveTerms:
    """Errors that a drive adds to its angle; every part is optional.

    worm_ratio: Cycles of the periodic error per turn of the axis; for a linear actuator cycles per metre of stroke.
    worm: Coefficients [rad] of sin, cos of the first harmonic, then of sin, cos of the second; none, two or four
        names.
    sag: Coefficient [rad] of the bending by weight: ``sag * cos(angle - sag_zero_rad)`` is added.
    sag_zero_rad: Angle of the drive at which the lever of the weight is longest (the mirror upright) [rad].
    backlash: Play [rad]: half of it is added when the last move went to larger readings, half taken when to smaller
        ones.
    """

    worm_ratio: float = 0.0
    worm: tuple[str, ...] = ()
    sag: str | None = None
    sag_zero_rad: float = 0.0
    backlash: str | None = None

    def __post_init__(self) -> None:
        if len(self.worm) not in (0, 2, 4):
            raise InputError(f"worm terms: no, two or four names are needed, not {len(self.worm)}")
        if self.worm:
            positive("worm_ratio", self.worm_ratio, "cycles")

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that the terms use."""
        return self.worm + tuple(name for name in (self.sag, self.backlash) if name is not None)


@dataclass(frozen=True, slots=True)
class RotaryDrive:
    """A drive whose angle grows evenly with its reading: ``scale * rad_per_reading * reading + sign * offset``.

    offset: Parameter of the reference offset [rad].
    rad_per_reading: Angle of one count [rad]; 1 for readings in radians. Negative where the count runs against the
        axis.
    scale: Parameter of a factor on the reading [1].
    offset_sign: +1 for angle = reading + offset, -1 for reading = angle + offset.
    terms: Periodic error, sag, backlash.
    """

    offset: str
    rad_per_reading: float = 1.0
    scale: str | None = None
    offset_sign: float = 1.0
    terms: DriveTerms = field(default_factory=DriveTerms)

    def __post_init__(self) -> None:
        if not (np.isfinite(self.rad_per_reading) and self.rad_per_reading != 0) or abs(self.offset_sign) != 1.0:
            raise InputError(
                f"rotary drive {self.offset}: an angle per reading other than 0 and a sign of +1 or -1 are needed, "
                f"not {self.rad_per_reading:g} and {self.offset_sign:g}"
            )

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that the drive uses."""
        return (self.offset, *((self.scale,) if self.scale is not None else ()), *self.terms.names)


@dataclass(frozen=True, slots=True)
class LinearActuator:
    """A spindle that closes a triangle: two fixed sides, the third is the stroke, the angle between the two turns.

    ``angle = zero_rad + initial_angle +- (a(s0) - a(s))``, ``a(s) = acos((o^2 + r^2 - s^2) / (2 o r))``,
    ``s = s0 + reading / increment``; the sign is + for a clockwise axis.

    initial_angle, initial_stroke, offset, pivot_radius, increment: Parameters: angle [rad] and stroke s0 [m] at
        reading 0, sides o and r of the triangle [m], counts per metre [1/m].
    clockwise: Sense of the axis.
    zero_rad: Angle from which the initial angle is counted [rad].
    terms: Periodic error, sag, backlash.
    """

    initial_angle: str
    initial_stroke: str
    offset: str
    pivot_radius: str
    increment: str
    clockwise: bool = True
    zero_rad: float = 0.0
    terms: DriveTerms = field(default_factory=DriveTerms)

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that the drive uses."""
        own = (self.initial_angle, self.initial_stroke, self.offset, self.pivot_radius, self.increment)
        return own + self.terms.names


Step: TypeAlias = Turn | Shift | Driven
Drive: TypeAlias = RotaryDrive | LinearActuator


@dataclass(frozen=True, slots=True, eq=False)
class HeliostatDesign(ShortRepr):
    """A heliostat: the chain from the ground to its mirror, two drives, and all numbers by name.

    name: Which heliostat (or kind of heliostat) this is.
    steps: The chain from the field's frame to the mirror's; both drives occur once. The mirror's centre is where it
        ends.
    drives: The drives 0 and 1.
    normal (3,): The mirror's outward normal in the mirror's frame.
    parameters: All numbers with what is known of them; may hold more than the chain uses (such as positions of
        cameras).
    limits (2, 2): Lowest and highest reading of each drive (row).
    reading_unit: Unit of the readings.
    free_sets: Usual choices of free parameters by name, such as ``{"4": (...)}``.
    InputError: A step or drive names a parameter that is not there, a drive does not occur exactly once, the
        position is missing, or limits are not in order.
    """

    name: str
    steps: tuple[Step, ...]
    drives: tuple[Drive, Drive]
    normal: FloatArray
    parameters: Parameters
    limits: FloatArray
    reading_unit: ReadingUnit = "rad"
    free_sets: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "normal", unit_vector("normal", self.normal))
        limits = float_array("limits", self.limits, (2, 2), finite=False)
        if not (limits[:, 0] < limits[:, 1]).all():
            raise InputError(f"{self.name}: limits of the readings must be lowest and highest, not {limits.tolist()}")
        object.__setattr__(self, "limits", limits)
        if self.reading_unit not in ("counts", "rad"):
            raise InputError(f"{self.name}: reading_unit must be counts or rad, not {self.reading_unit!r}")
        driven = sorted(step.drive for step in self.steps if isinstance(step, Driven))
        if driven != [0, 1] or len(self.drives) != 2:
            raise InputError(f"{self.name}: the drives 0 and 1 must occur once each in the chain, not {driven}")
        for name in POSITION + self.used_names + sum(self.free_sets.values(), ()):
            self.parameters.index(name)

    @property
    def used_names(self) -> tuple[str, ...]:
        """Parameters that the chain uses, each once, in the order of the chain."""
        names: list[str] = []
        for step in self.steps:
            if isinstance(step, Turn):
                names.append(step.angle)
            elif isinstance(step, Shift):
                names.extend(name for name in step.names if name is not None)
            else:
                names.extend(self.drives[step.drive].names)
        return tuple(dict.fromkeys(names))

    @property
    def position_m(self) -> FloatArray:
        """Where the chain stands: east, north, up, shape (3,) [m]."""
        return np.asarray(self.parameters.values[self.parameters.indices(POSITION)])

    def with_parameters(self, parameters: Parameters) -> "HeliostatDesign":
        """Return the same heliostat with other numbers."""
        return replace(self, parameters=parameters)

    def with_value(self, values: Mapping[str, float]) -> "HeliostatDesign":
        """Return the same heliostat with some numbers replaced by name."""
        return replace(self, parameters=self.parameters.with_value(values))

    def with_free(self, free: str | Sequence[str]) -> "HeliostatDesign":
        """Return the same heliostat with the parameters of a usual choice (or these names) free and all others held.

        InputError: There is no such choice or parameter.
        """
        if isinstance(free, str):
            if free not in self.free_sets:
                known = ", ".join(self.free_sets) or "none is named"
                raise InputError(f"{self.name}: no choice of free parameters {free!r}; known: {known}")
            free = self.free_sets[free]
        return replace(self, parameters=self.parameters.with_only_free(free))


def _generator(axis: FloatArray) -> FloatArray:
    cross = skew(axis)
    return np.asarray(freeze(np.stack([cross, cross @ cross])))
