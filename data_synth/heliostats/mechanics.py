"""How true heliostats move: from drive readings to the mirror's pose, and back, written from the published models.

Nothing is shared with the estimator's chain of steps: each kind of heliostat has its equations written out once more,
so that a slip in either shows as a disagreement. Frame: x east, y north, z up; azimuth 0 = north, clockwise.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from heliogauge.errors import InputError
from heliogauge.validate import FloatArray

EAST, NORTH, UP = np.eye(3)
#: Newton's steps of the inverse; from 0.3 rad off it needs six.
_MOST_STEPS = 40
#: Step of the numerical derivative of the pose by a reading, in radians of the axis.
_STEP_RAD = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Where mirrors are and how they are turned.

    rotation (n, 3, 3): World from mirror; mirror axes are x to the right and y up as seen from the front, z out of
        the mirror.
    center_m (n, 3): Middle of the mirror [m].
    """

    rotation: FloatArray
    center_m: FloatArray

    @property
    def normals(self) -> FloatArray:
        """Unit normals, shape (n, 3)."""
        return np.asarray(self.rotation[..., 2])


def rotation_about(axis: FloatArray, angle_rad: FloatArray | float) -> FloatArray:
    """Return right-handed rotations about an axis (Rodrigues).

    Shapes: axis (3,) or (n, 3), angle_rad (n,), result (n, 3, 3) or (3, 3).
    """
    axis = np.asarray(axis, dtype=np.float64)
    x, y, z = axis[..., 0], axis[..., 1], axis[..., 2]
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*axis.shape[:-1], 3, 3)
    outer = axis[..., :, None] * axis[..., None, :]
    cosine, sine = np.cos(angle_rad)[..., None, None], np.sin(angle_rad)[..., None, None]
    return np.asarray(cosine * np.eye(3) + (1 - cosine) * outer + sine * cross)


@dataclass(frozen=True, slots=True)
class DriveFlaws:
    """What a drive does beside what its reading says.

    worm_ratio: Turns of the worm for one turn of the axis.
    worm_rad: Periodic error: coefficients of sin, cos of the first harmonic, sin, cos of the second [rad].
    sag_rad: Bending by weight: ``sag_rad * cos(angle - sag_zero_rad)`` [rad].
    sag_zero_rad: Angle at which the weight's lever is longest [rad].
    backlash_rad: Play; half of it ahead after a move to larger readings, half behind after one to smaller readings
        [rad].
    """

    worm_ratio: float = 0.0
    worm_rad: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    sag_rad: float = 0.0
    sag_zero_rad: float = 0.0
    backlash_rad: float = 0.0

    def added(self, turning: FloatArray, angle: FloatArray, approach: FloatArray) -> FloatArray:
        """Return what is added to the angle [rad].

        Shapes: angle (n,).
        turning (n,): Phase of the worm's motion: angle of the axis [rad], or stroke [m] in whose cycles the ratio
            counts.
        approach (n,): Direction of the last move: -1, 0 or +1.
        """
        first_sine, first_cosine, second_sine, second_cosine = self.worm_rad
        phase = self.worm_ratio * turning
        wave = first_sine * np.sin(phase) + first_cosine * np.cos(phase)
        wave = wave + second_sine * np.sin(2 * phase) + second_cosine * np.cos(2 * phase)
        sag = self.sag_rad * np.cos(angle - self.sag_zero_rad)
        return np.asarray(wave + sag + 0.5 * self.backlash_rad * approach)


Values: TypeAlias = Mapping[str, float]
_Motion: TypeAlias = Callable[[Values, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


def _upright(azimuth: FloatArray, elevation: FloatArray) -> FloatArray:
    """Rotation of a mirror whose normal has this azimuth and elevation and whose width is level."""
    sin_a, cos_a, sin_e, cos_e = np.sin(azimuth), np.cos(azimuth), np.sin(elevation), np.cos(elevation)
    right = np.stack([-cos_a, sin_a, np.zeros_like(sin_a)], axis=-1)
    above = np.stack([-sin_a * sin_e, -cos_a * sin_e, cos_e], axis=-1)
    normal = np.stack([sin_a * cos_e, cos_a * cos_e, sin_e], axis=-1)
    return np.stack([right, above, normal], axis=-1)


def _position(values: Values) -> FloatArray:
    return np.array([values["position_e"], values["position_n"], values["position_u"]])


def _azimuth_elevation(values: Values, azimuth: FloatArray, elevation: FloatArray) -> tuple[FloatArray, FloatArray]:
    # Malan, eqs. 4.12 to 4.18, with the tilt towards north and towards east; angles are those of the axes.
    heading = np.stack([np.sin(azimuth), np.cos(azimuth), np.zeros_like(azimuth)], axis=-1)
    skewed = rotation_about(heading, np.full_like(azimuth, -values["non_orthogonality"]))
    tilt = rotation_about(EAST, -values["tilt_north"]) @ rotation_about(NORTH, values["tilt_east"])
    turned = tilt @ skewed @ _upright(azimuth, elevation)
    return turned, np.broadcast_to(_position(values), (len(azimuth), 3))


def _drone(values: Values, azimuth: FloatArray, elevation: FloatArray) -> tuple[FloatArray, FloatArray]:
    # Gouws, eqs. 5.2 to 5.16: tilt about east after tilt about north; the pylon's foot stays, its top moves by psi.
    tilt = rotation_about(EAST, values["tilt_about_east"]) @ rotation_about(NORTH, values["tilt_about_north"])
    pylon = np.array([0.0, 0.0, values["pylon_length"]])
    turned = tilt @ _upright(azimuth, elevation)
    arm = values["arm_normal"] * turned[..., 2] + values["arm_up"] * turned[..., 1]
    return turned, _position(values) + (tilt @ pylon - pylon) + arm


def _six_error(values: Values, azimuth: FloatArray, elevation: FloatArray) -> tuple[FloatArray, FloatArray]:
    # Section 1.13: n = Rz(azimuth) Rx(tau) Ry(elevation) (cos mu, sin mu, 0) with axes north, east, up, under a tilt.
    tau, canting = values["non_orthogonality"], values["canting"]
    cos_e, sin_e = np.cos(elevation), np.sin(elevation)
    zero, one = np.zeros_like(elevation), np.ones_like(elevation)
    # Columns are the images of the mirror's axis 1 (its heading), 2 and 3; Ry lifts axis 1 towards axis 3.
    lift = np.stack([cos_e, zero, -sin_e, zero, one, zero, sin_e, zero, cos_e], axis=-1).reshape(-1, 3, 3)
    skew = np.array([[1, 0, 0], [0, np.cos(tau), -np.sin(tau)], [0, np.sin(tau), np.cos(tau)]])
    cos_a, sin_a = np.cos(azimuth), np.sin(azimuth)
    turn = np.stack([cos_a, -sin_a, zero, sin_a, cos_a, zero, zero, zero, one], axis=-1).reshape(-1, 3, 3)
    canted = np.array([[np.cos(canting), -np.sin(canting), 0], [np.sin(canting), np.cos(canting), 0], [0, 0, 1]])
    north_east_up = turn @ skew @ lift @ canted
    world = north_east_up[:, [1, 0, 2], :]
    tilt = rotation_about(EAST, -values["tilt_north"]) @ rotation_about(NORTH, values["tilt_east"])
    # The mirror's right as seen from the front is minus axis 2 (east of a mirror that faces north).
    turned = tilt @ np.stack([-world[..., 1], world[..., 2], world[..., 0]], axis=-1)
    return turned, _position(values) + values["arm_normal"] * turned[..., 2]


def _linear_actuators(values: Values, first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
    # The chain of the Juelich files: two tilts, axis 1 about east, two tilts, axis 2 about up, normal (0, -1, 0).
    lower = rotation_about(NORTH, values["tilt_1_n"]) @ rotation_about(UP, values["tilt_1_u"])
    upper = rotation_about(EAST, values["tilt_2_e"]) @ rotation_about(NORTH, values["tilt_2_n"])
    raised = lower @ rotation_about(np.broadcast_to(EAST, (len(first), 3)), first)
    turned = raised @ upper @ rotation_about(np.broadcast_to(UP, (len(first), 3)), second)
    joint_1, joint_2, concentrator = (
        np.array([values[f"{part}_{axis}"] for axis in "enu"]) for part in ("joint_1", "joint_2", "concentrator")
    )
    center = _position(values) + lower @ joint_1 + raised @ (upper @ joint_2) + turned @ concentrator
    # Mirror axes in the frame whose mirror looks south: right is east, above is up, the normal is south.
    return turned[..., [0, 2, 1]] * [1.0, 1.0, -1.0], center


@dataclass(frozen=True, slots=True, eq=False)
class TrueHeliostat:
    """A heliostat as it really is.

    values: Every number of its kind, by name.
    flaws: What the two drives do beside.
    rad_per_reading: Angle of one count of a rotary drive [rad].
    clockwise: Sense of each linear actuator.
    limits: Lowest and highest reading of each drive; azimuth and elevation by default [rad].
    InputError: There is no such kind.
    """

    name: str
    kind: str
    values: Values
    flaws: tuple[DriveFlaws, DriveFlaws] = (DriveFlaws(), DriveFlaws())
    rad_per_reading: tuple[float, float] = (1.0, 1.0)
    clockwise: tuple[bool, bool] = (True, True)
    limits: tuple[tuple[float, float], tuple[float, float]] = field(
        default=((-np.pi, np.pi), (0.0, np.pi / 2)), repr=False
    )

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"kind {self.kind!r} of a heliostat: {', '.join(KINDS)} are known")

    def with_values(self, values: Values) -> "TrueHeliostat":
        """Return the same heliostat with some values replaced by name."""
        unknown = set(values) - set(self.values)
        if unknown:
            raise InputError(f"{self.name}: a heliostat of kind {self.kind} has no {', '.join(sorted(unknown))}")
        return replace(self, values={**self.values, **values})

    @property
    def position_m(self) -> FloatArray:
        """Where it stands, shape (3,) [m]."""
        return _position(self.values)

    def angles(self, readings: FloatArray, approach: FloatArray | None = None) -> FloatArray:
        """Return the angles of both axes.

        Shapes: readings (n, 2), result (n, 2).
        approach (n, 2): Direction of the last move of each drive: -1, 0 or +1.
        """
        moves = np.zeros_like(readings) if approach is None else approach
        angles = []
        for axis in (0, 1):
            angle, turning = KINDS[self.kind].drive(self, axis, readings[:, axis])
            angles.append(angle + self.flaws[axis].added(turning, angle, moves[:, axis]))
        return np.stack(angles, axis=1)

    def poses(self, readings: FloatArray, approach: FloatArray | None = None) -> Poses:
        """Return the mirror's poses at readings, both of shape (n, 2), see `angles`."""
        angles = self.angles(np.asarray(readings, dtype=np.float64), approach)
        rotation, center = KINDS[self.kind].motion(self.values, angles[:, 0], angles[:, 1])
        return Poses(rotation, center)

    def aim(self, source: FloatArray, aim_points_m: FloatArray, *, at_infinity: bool = True) -> FloatArray:
        """Find the readings that throw the light of a source to a point, the drives at rest (approach 0).

        source (n, 3): Unit vectors to the sun, or points [m].
        aim_points_m (n, 3): Where the beam shall go [m].
        Returns (n, 2): Readings; NaN where the heliostat cannot reach.
        """
        readings = self._near(source, aim_points_m, at_infinity)
        span = np.array([high - low for low, high in self.limits])
        step = _STEP_RAD * span
        for _ in range(_MOST_STEPS):
            miss = self._miss(readings, source, aim_points_m, at_infinity)
            slopes = [
                (self._miss(readings + step * one, source, aim_points_m, at_infinity) - miss) / step[axis]
                for axis, one in enumerate(np.eye(2))
            ]
            (a, c), (b, d) = slopes[0].T, slopes[1].T
            determinant = a * d - b * c
            change = np.stack([d * miss[:, 0] - b * miss[:, 1], a * miss[:, 1] - c * miss[:, 0]], axis=1)
            change /= determinant[:, None]
            # A step of a tenth of the range at most keeps the triangles of linear actuators closed.
            change = np.clip(change, -0.1 * span, 0.1 * span)
            readings = readings - change
            if not (np.abs(change) > 1e-15 * span).any():
                break
        low, high = np.array(self.limits).T
        reached = (np.abs(self._miss(readings, source, aim_points_m, at_infinity)) < 1e-12).all(axis=1)
        reached &= ((readings >= low) & (readings <= high)).all(axis=1)
        return np.where(reached[:, None], readings, np.nan)

    def _miss(
        self, readings: FloatArray, source: FloatArray, aim_points_m: FloatArray, at_infinity: bool
    ) -> FloatArray:
        poses = self.poses(readings)
        wanted = _unit(aim_points_m - poses.center_m) + _unit(source if at_infinity else source - poses.center_m)
        wanted = _unit(wanted)
        return np.asarray(np.einsum("nij,ni->nj", poses.rotation[..., :2], wanted))

    def _near(self, source: FloatArray, aim_points_m: FloatArray, at_infinity: bool) -> FloatArray:
        # The best of a 41 by 21 grid of readings: the inverse of any kind starts within its basin.
        first, second = (np.linspace(*limit, count) for limit, count in zip(self.limits, (41, 21), strict=True))
        grid = np.stack([part.ravel() for part in np.meshgrid(first, second)], axis=1)
        poses = self.poses(grid)
        center = poses.center_m.mean(axis=0)
        wanted = _unit(_unit(aim_points_m - center) + _unit(source if at_infinity else source - center))
        with np.errstate(invalid="ignore"):
            likeness = np.nan_to_num(wanted @ poses.normals.T, nan=-2.0)
        return np.asarray(grid[np.argmax(likeness, axis=1)])


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of heliostat: how its drives turn and what the two angles do to the mirror."""

    drive: Callable[[TrueHeliostat, int, FloatArray], tuple[FloatArray, FloatArray]]
    motion: _Motion


def _forwards(heliostat: TrueHeliostat, axis: int, readings: FloatArray) -> tuple[FloatArray, FloatArray]:
    nominal = readings * heliostat.rad_per_reading[axis]
    return nominal + heliostat.values[_OFFSETS[axis]], nominal


def _backwards(heliostat: TrueHeliostat, axis: int, readings: FloatArray) -> tuple[FloatArray, FloatArray]:
    nominal = readings * heliostat.rad_per_reading[axis]
    return nominal - heliostat.values[_OFFSETS[axis]], nominal


def _triangle(heliostat: TrueHeliostat, axis: int, readings: FloatArray) -> tuple[FloatArray, FloatArray]:
    names = ("initial_angle", "initial_stroke", "offset", "pivot_radius", "increment")
    begin, stroke, offset, radius, increment = (heliostat.values[f"{name}_{axis + 1}"] for name in names)

    def inner(length: FloatArray | float) -> FloatArray:
        with np.errstate(invalid="ignore"):
            return np.asarray(np.arccos((offset**2 + radius**2 - np.square(length)) / (2 * offset * radius)))

    sign = 1.0 if heliostat.clockwise[axis] else -1.0
    extension = readings / increment
    angle = begin + sign * (inner(stroke) - inner(stroke + extension))
    # Axis 1 is counted from the mirror that looks at the zenith.
    return angle - (np.pi / 2 if axis == 0 else 0.0), 2 * np.pi * extension


_OFFSETS = ("azimuth_offset", "elevation_offset")
KINDS: Mapping[str, Kind] = {
    "azimuth-elevation": Kind(_forwards, _azimuth_elevation),
    "drone": Kind(_backwards, _drone),
    "six-error": Kind(_backwards, _six_error),
    "linear-actuators": Kind(_triangle, _linear_actuators),
}


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.sqrt(np.einsum("...i,...i->...", vectors, vectors))[..., None])
