"""From a heliostat's numbers to the residuals of its observations, with derivatives, whitened and in radians."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from calibration.heliostat.kinematic_model.design import HeliostatDesign, PlaneTarget
from calibration.heliostat.kinematic_model.directions import Sights, unit_with_length
from calibration.heliostat.kinematic_model.kinematics import MirrorPoses, mirror_poses, pose_derivatives
from calibration.heliostat.observations.observations import BeamSpots, Observations
from calibration.heliostat.observations.residual_kinds import Equations, Posed, Prepared, equations, in_metres, prepare
from heliogauge.errors import InputError
from heliogauge.geometry.rays import intersect_plane, reflect
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FloatArray, IntArray, freeze

# Of the heliostat as given, and as found.
_MOST_KEPT = 2


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Residuals of observations at given numbers of a heliostat.

    whitened (m,): Predicted minus measured in sigma; 0 for rows that cannot be computed.
    jacobian (m, k): Derivatives by the wanted parameters.
    owner (m,): Row that each component belongs to; the two or three components of a row follow one another.
    beam_rad (n, 2): Measured minus predicted direction of the beam (for a drone: of the line of sight), right and
        up as seen from the mirror along it [rad]; NaN for kinds without a beam.
    normal_rad (n, 2): The mirror's normal that would explain the measurement minus the predicted one, right and up
        as seen along it [rad]; for lamps the turn of the structure across the line of sight, for points NaN.
    sigma_beam_rad (n,): Stated sigma per axis of the beam or line of sight (root mean of both axes), of the normal
        for kinds that measure it [rad]; NaN for points.
    distance_m (n,): From the mirror to what was observed [m]; NaN for normals.
    computable (n,): Whether the readings lie within the geometry of the actuators.
    """

    whitened: FloatArray
    jacobian: FloatArray
    owner: IntArray
    beam_rad: FloatArray
    normal_rad: FloatArray
    sigma_beam_rad: FloatArray
    distance_m: FloatArray
    computable: BoolArray

    def __post_init__(self) -> None:
        for array in (self.whitened, self.jacobian, self.owner, self.beam_rad, self.normal_rad):
            freeze(array)

    @property
    def beam_angle_rad(self) -> FloatArray:
        """Angle between measured and predicted beam, shape (n,) [rad of the beam]."""
        return np.asarray(np.hypot(self.beam_rad[:, 0], self.beam_rad[:, 1]))

    @property
    def normal_angle_rad(self) -> FloatArray:
        """Angle between the normals, shape (n,) [rad of the normal]."""
        return np.asarray(np.hypot(self.normal_rad[:, 0], self.normal_rad[:, 1]))

    @property
    def lengths(self) -> FloatArray:
        """Length of each row's whitened residual, shape (n,) [sigma]."""
        return np.sqrt(np.bincount(self.owner, self.whitened**2, minlength=len(self.beam_rad)))


class Whitened(NamedTuple):
    """Residuals (m,), derivatives (m, k) and which rows can be computed (n,), as `Residuals` has them."""

    residuals: FloatArray
    jacobian: FloatArray
    computable: BoolArray


class _Evaluated(NamedTuple):
    """Whitened residuals, for each group its equations and normals, and all in radians once that was asked for."""

    whitened: Whitened
    parts: list[Equations]
    normals: list[FloatArray]
    in_radians: list["Residuals"]


@dataclass(frozen=True, slots=True, eq=False)
class ObservationModel(ShortRepr):
    """Observations of a heliostat made ready to be evaluated at many numbers.

    design: The heliostat; its parameters hold what the observations bring with them
        (`Observations.extra_parameters`). Its own numbers choose the axes of the components and the weights.
    observations: What was seen.
    columns (k,): Positions of the parameters to differentiate by; all of them if not given.
    InputError: A covariance vanishes across its line of sight.
    """

    design: HeliostatDesign
    observations: Observations
    columns: IntArray | None = None
    readings: FloatArray = field(init=False)
    approach: FloatArray | None = field(init=False)
    owners: IntArray = field(init=False)
    prepared: tuple[Prepared, ...] = field(init=False)
    _last: dict[bytes, "_Evaluated"] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        seen = self.observations
        object.__setattr__(self, "readings", seen.readings)
        object.__setattr__(self, "approach", seen.approach)
        object.__setattr__(self, "owners", np.repeat(np.arange(len(seen)), seen.n_components))
        object.__setattr__(self, "prepared", _prepared(self.design, seen))

    def whitened(self, values: FloatArray) -> "Whitened":
        """Return the residuals at some numbers."""
        return self._evaluated(values).whitened

    def evaluate(self, values: FloatArray) -> "Residuals":
        """Return the residuals at some numbers, also in radians."""
        found = self._evaluated(values)
        if not found.in_radians:
            whitened, jacobian, computable = found.whitened
            angles = [_in_radians(*one) for one in zip(self.prepared, found.parts, found.normals, strict=True)]
            beam, normal, sigma, distance = (np.concatenate(one) for one in zip(*angles, strict=True))
            known = Residuals(whitened, jacobian, self.owners, beam, normal, sigma, distance, computable)
            found.in_radians.append(known)
        return found.in_radians[0]

    def miss_rad(self, values: FloatArray) -> FloatArray:
        """Return the angle between what each row saw and what is predicted, shape (n,); NaN for points [rad]."""
        parts = zip(self.prepared, self._evaluated(values).parts, strict=True)
        lengths = [
            np.full(len(part.residual), np.nan) if prepared.sights is None else np.hypot(*part.residual.T)
            for prepared, part in parts
        ]
        return np.concatenate(lengths)

    def _evaluated(self, values: FloatArray) -> "_Evaluated":
        """Evaluate, or give the last answer again: a fit asks two or three times at the same numbers."""
        key = values.tobytes()
        if key not in self._last:
            self._last.clear()
            self._last[key] = self._evaluated_anew(values)
        return self._last[key]

    def _evaluated_anew(self, values: FloatArray) -> "_Evaluated":
        moved = pose_derivatives(self.design, values, self.readings, self.approach, columns=self.columns, outside="nan")
        poses = moved.poses
        sums = poses.rotation.sum(axis=(1, 2)) + poses.centre_m.sum(axis=1)
        computable = np.asarray(np.isfinite(sums))
        place = {self.design.parameters.names[index]: column for column, index in enumerate(moved.columns)}
        numbers = dict(zip(self.design.parameters.names, values.tolist(), strict=True))
        normals, whitened, jacobians, parts, first = poses.normals(self.design), [], [], [], 0
        own_normals = []
        for group, prepared in zip(self.observations.groups, self.prepared, strict=True):
            rows = slice(first, first + len(group))
            first += len(group)
            here = Posed(poses.rotation[rows], poses.centre_m[rows], normals[rows], numbers)
            part = equations(here, group, prepared)
            weighed, root = in_metres(part, prepared), prepared.root
            jacobian = (root @ weighed.by_turn) @ moved.omega[rows] + (root @ weighed.by_shift) @ moved.shift[rows]
            for names, own, derivative in weighed.extra:
                for k, name in enumerate(names):
                    if name in place:
                        jacobian[own, :, place[name]] += (root[own] @ derivative[:, :, k, None])[..., 0]
            whitened.append((root @ weighed.residual[..., None]).ravel())
            jacobians.append(jacobian.reshape(root.shape[0] * root.shape[1], len(place)))
            parts.append(part)
            own_normals.append(normals[rows])
        residuals, derivatives = np.concatenate(whitened), np.concatenate(jacobians)
        if not computable.all():
            lost = ~computable[self.owners]
            residuals[lost], derivatives[lost] = 0.0, 0.0
        return _Evaluated(Whitened(freeze(residuals), freeze(derivatives), computable), parts, own_normals, [])


def _prepared(design: HeliostatDesign, seen: Observations) -> tuple[Prepared, ...]:
    """Make observations ready, or take what was made ready for the same numbers: a heliostat is fitted some times."""
    key = design.parameters.values.tobytes()
    if key not in seen.kept:
        if len(seen.kept) >= _MOST_KEPT:
            seen.kept.clear()
        seen.kept[key] = tuple(prepare(design, group) for group in seen.groups)
    found: tuple[Prepared, ...] = seen.kept[key]
    return found


class _InRadians(NamedTuple):
    """Beam and normal, measured minus predicted (n, 2), stated sigma (n,) [rad], and distance (n,) [m]."""

    beam_rad: FloatArray
    normal_rad: FloatArray
    sigma_rad: FloatArray
    distance_m: FloatArray


def _in_radians(prepared: Prepared, part: Equations, normals: FloatArray) -> _InRadians:
    nothing = np.full((len(normals), 2), np.nan)
    if prepared.sights is None:
        return _InRadians(nothing, nothing.copy(), prepared.sigma_rad, part.distance_m)
    if part.beam is None:
        return _InRadians(nothing, -part.residual, prepared.sigma_rad, part.distance_m)
    needed, _ = unit_with_length(part.beam[0] + part.beam[1])
    deviation = Sights.along(normals).coordinates(needed)
    return _InRadians(-part.residual, deviation, prepared.sigma_rad, part.distance_m)


def evaluate(
    design: HeliostatDesign,
    values: npt.ArrayLike,
    observations: Observations,
    *,
    columns: Sequence[int] | IntArray | None = None,
) -> Residuals:
    """Return the residuals of observations.

    design: The heliostat; its parameters hold what the observations bring with them.
    values (p,): Numbers in the order of ``design.parameters``.
    observations: What was seen.
    columns: Positions of the parameters to differentiate by; all of them if not given.
    InputError: A parameter of the observations is missing, or shapes do not fit.

    Directions are compared in stereographic coordinates about the measured one: angles when they are close, and still
    growing when they are far apart, so that a mirror that looks the other way is no false minimum.
    """
    missing = observations.extra_parameters(design).names
    if missing:
        raise InputError(f"parameters {', '.join(missing)} of the observations are missing in {design.name}")
    chosen = None if columns is None else np.asarray(columns, dtype=np.intp)
    return ObservationModel(design, observations, chosen).evaluate(np.asarray(values, dtype=np.float64))


def whitened_at(
    design: HeliostatDesign, values: FloatArray, observations: Observations, poses: MirrorPoses
) -> FloatArray:
    """Return the whitened residuals (m,) alone, of observations of poses that are known.

    values (p,): Numbers in the order of ``design.parameters``.
    observations: What was seen; the design's parameters hold what they bring with them.
    poses: At their readings.
    """
    numbers, normals = dict(zip(design.parameters.names, values.tolist(), strict=True)), poses.normals(design)
    parts, first = [], 0
    for group, prepared in zip(observations.groups, _prepared(design, observations), strict=True):
        rows = slice(first, first + len(group))
        first += len(group)
        here = Posed(poses.rotation[rows], poses.centre_m[rows], normals[rows], numbers)
        part = in_metres(equations(here, group, prepared), prepared)
        whitened = (prepared.root @ part.residual[..., None])[..., 0]
        whitened[~np.isfinite(normals[rows].sum(axis=1))] = 0.0
        parts.append(whitened.ravel())
    return np.concatenate(parts)


def predicted_spots(
    design: HeliostatDesign, values: npt.ArrayLike, spots: BeamSpots, targets: Mapping[str, PlaneTarget]
) -> FloatArray:
    """Return where the beams should meet their targets.

    values (p,): Its numbers, in the order of ``design.parameters``.
    spots: Readings, sun and target of each row.
    Returns (n, 2): Coordinates on the target, right and up as seen from the field [m]; NaN where the beam goes
        elsewhere.
    InputError: A target is unknown, or shapes do not fit.
    """
    missing = sorted(set(spots.target) - set(targets))
    if missing:
        raise InputError(f"target {', '.join(missing)}: no such target; there are {', '.join(targets)}")
    poses = mirror_poses(design, values, spots.pointings.readings, spots.pointings.approach, outside="nan")
    beams = reflect(-spots.sun, poses.normals(design))
    found, names = np.full((len(spots), 2), np.nan), np.array(spots.target, dtype=np.str_)
    for name in dict.fromkeys(spots.target):
        target, rows = targets[name], np.flatnonzero(names == name)
        along = intersect_plane(poses.centre_m[rows], beams[rows], target.center_m, target.normal)
        ahead = along > 0
        hits = poses.centre_m[rows] + along[:, None] * beams[rows]
        found[rows[ahead]] = target.coordinates(hits[ahead])
    return found
