"""The observation equations: each kind of observation against the pose of the mirror, to first order."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from calibration.heliostat.kinematic_model.design import HeliostatDesign
from calibration.heliostat.kinematic_model.directions import Sights, cross, dot, through_unit, unit_with_length
from calibration.heliostat.observations.observations import (
    BeamSpots,
    DroneSightings,
    Group,
    LampSightings,
    MirrorNormals,
    MirrorPoints,
    SunInCamera,
)
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import rotation_from_vector, skew
from heliogauge.validate import BoolArray, FloatArray

Rows = npt.NDArray[Any]


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """What does not change while the numbers do: axes of the components, weights, who is where.

    sights: Directions that the components are right and up of; None for points.
    root (n, c, c): Inverse root of the covariance of each row's components.
    sigma_rad (n,): Stated sigma per axis [rad]; NaN for points.
    rows: Rows of each camera, target or image position.
    stretch (n,): Divisor of the components: the stereographic map stretches away from its middle.
    distance_m (n,): Distance at which a sigma in metres was made an angle; NaN where it was given as an angle [m].
    """

    sights: Sights | None
    root: FloatArray
    sigma_rad: FloatArray
    rows: Mapping[str, Rows]
    stretch: FloatArray
    distance_m: FloatArray

    def select(self, mask: BoolArray) -> "Prepared":
        """Return the same for some rows, a mask (n,)."""
        number = np.cumsum(mask) - 1
        kept = {name: number[rows[mask[rows]]] for name, rows in self.rows.items()}
        return Prepared(
            None if self.sights is None else self.sights.select(mask),
            self.root[mask],
            self.sigma_rad[mask],
            {name: rows for name, rows in kept.items() if rows.size},
            self.stretch[mask],
            self.distance_m[mask],
        )


@dataclass(frozen=True, slots=True, eq=False)
class Posed:
    """Poses and numbers at which a group is evaluated.

    rotation (n, 3, 3): ``world_from_mirror``.
    centre (n, 3): The mirror's centre [m].
    normal (n, 3): Its normal.
    numbers: All parameters by name.
    """

    rotation: FloatArray
    centre: FloatArray
    normal: FloatArray
    numbers: Mapping[str, float]

    def values(self, names: Sequence[str]) -> FloatArray:
        """Return some parameters."""
        return np.array([self.numbers[name] for name in names])


@dataclass(frozen=True, slots=True, eq=False)
class Equations:
    """Components of a group (predicted minus observed), with derivatives by the pose and by its own parameters.

    residual (n, c): Components [rad or m].
    by_turn, by_shift (n, c, 3): Derivatives by a turn of the mirror [per rad] and a shift of its centre [per m],
        both in the field's frame.
    extra: Names, rows and derivatives (r, c, k) of further parameters.
    beam: Source and observed direction of the beam, from which the normal follows; None for kinds without.
    distance_m (n,): From the mirror to what was observed; NaN for normals [m].
    """

    residual: FloatArray
    by_turn: FloatArray
    by_shift: FloatArray
    extra: tuple[tuple[Sequence[str], Rows, FloatArray], ...]
    beam: tuple[FloatArray, FloatArray] | None
    distance_m: FloatArray


def prepare(design: HeliostatDesign, group: Group) -> Prepared:
    """Return what stays the same at all numbers.

    design: The heliostat; its own numbers choose axes and weights.
    group: Observations of one kind.
    Returns: Axes, weights and rows.
    InputError: A covariance vanishes across the line of sight.
    """
    return _PREPARATIONS[type(group)](design, group)


def equations(posed: Posed, group: Group, prepared: Prepared) -> Equations:
    """Return the components of a group with their derivatives."""
    return _EQUATIONS[type(group)](posed, group, prepared)


def in_metres(part: Equations, prepared: Prepared) -> Equations:
    """Return components as lengths at what was seen, over the distance at which their sigma was made an angle.

    prepared: What their weights rest on.

    Frozen weights of angles would reward a heliostat for standing farther away, where the same miss in metres is a
    smaller angle: 1178 components of 7.6 mm at 39 m move a place that is known to 0.6 m by 6 m along the line of
    sight.
    """
    if part.beam is None or np.isnan(prepared.distance_m).any():
        return part
    scale = part.distance_m / prepared.distance_m
    # The mirror that moves towards what is seen shortens the distance.
    away = part.residual[:, :, None] * (part.beam[1] / prepared.distance_m[:, None])[:, None, :]
    stretched = scale[:, None, None]
    extra = tuple(
        (names, rows, stretched[rows] * derivative + (away[rows] if names[0].startswith("drone_offset") else 0.0))
        for names, rows, derivative in part.extra
    )
    by_shift = stretched * part.by_shift - away
    residual, by_turn = scale[:, None] * part.residual, stretched * part.by_turn
    return replace(part, residual=residual, by_turn=by_turn, by_shift=by_shift, extra=extra)


def _rows_of(names: Sequence[str]) -> dict[str, Rows]:
    array = np.array(names, dtype=np.str_)
    return {name: np.flatnonzero(array == name) for name in dict.fromkeys(names)}


def _isotropic(sights: Sights, sigma: FloatArray, rows: Mapping[str, Rows]) -> Prepared:
    nowhere = np.full(sigma.size, np.nan)
    return Prepared(sights, np.eye(2) / sigma[:, None, None], sigma, rows, np.ones(sigma.size), nowhere)


def _inverse_root(covariance: FloatArray) -> FloatArray:
    """Return the inverse of the Cholesky factor of covariances (n, c, c), c being 2 or 3."""
    fault = "observations: a covariance vanishes across the line of sight; give every row a sigma"
    if covariance.shape[1] != 2 or not len(covariance):
        try:
            return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)) if len(covariance) else covariance)
        except np.linalg.LinAlgError as error:
            raise InputError(fault) from error
    # Two by two by hand: a third of the time.
    first, shared, second = covariance[:, 0, 0], covariance[:, 1, 0], covariance[:, 1, 1]
    left = first * second - shared**2
    if not ((first > 0) & (left > 0)).all():
        raise InputError(fault)
    root = np.zeros_like(covariance)
    root[:, 0, 0], root[:, 1, 1] = 1 / np.sqrt(first), np.sqrt(first / left)
    root[:, 1, 0] = -shared / first * root[:, 1, 1]
    return root


def _sighted(design: HeliostatDesign, points: FloatArray, covariance_m2: FloatArray, names: Sequence[str]) -> Prepared:
    """Prepare rows that see points whose covariance, (n, 3, 3) [m^2], makes that of the direction."""
    towards, distance = unit_with_length(points - design.position_m)
    sights = Sights.along(towards)
    across = sights.across / distance[:, None, None]
    covariance = across @ covariance_m2 @ across.transpose(0, 2, 1)
    sigma = np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 2)
    return Prepared(sights, _inverse_root(covariance), sigma, _rows_of(names), np.ones(len(points)), distance)


def _prepare_beam(design: HeliostatDesign, spots: BeamSpots) -> Prepared:
    return _sighted(design, spots.spot_m, spots.covariance_m2, spots.target)


def _prepare_drone(design: HeliostatDesign, seen: DroneSightings) -> Prepared:
    return _sighted(design, seen.source_m, seen.source_covariance_m2, seen.target)


def _prepare_camera(design: HeliostatDesign, seen: SunInCamera) -> Prepared:
    nominal = {camera.name: camera.center_m for camera in seen.cameras}
    points = np.array([nominal[name] for name in seen.camera]).reshape(-1, 3)
    towards, _ = unit_with_length(points - design.position_m)
    return _isotropic(Sights.along(towards), seen.sigma_rad, _rows_of(seen.camera))


def _prepare_lamp(design: HeliostatDesign, seen: LampSightings) -> Prepared:
    if seen.direction_camera is not None:
        planned = seen.direction_camera @ seen.camera.mirror_from_camera.T
        return _isotropic(Sights.along(planned), seen.sigma_rad, {})
    rows = _rows_of(seen.position or ())
    own, coordinates = design.parameters, np.zeros((len(seen), 2))
    for label, chosen in rows.items():
        coordinates[chosen] = [own.value(name) for name in _direction_names(label)]
    # 4 % at 0.4 rad from the camera's axis.
    stretch = 1.0 + 0.25 * (coordinates**2).sum(axis=1)
    sights = Sights.along(np.tile(seen.camera.axis, (len(seen), 1)))
    return replace(_isotropic(sights, seen.sigma_rad, rows), stretch=stretch)


def _prepare_normal(design: HeliostatDesign, seen: MirrorNormals) -> Prepared:
    del design
    return _isotropic(Sights.along(seen.normal), seen.sigma_rad, {})


def _prepare_point(design: HeliostatDesign, seen: MirrorPoints) -> Prepared:
    del design
    nothing = np.full(len(seen), np.nan)
    return Prepared(None, _inverse_root(seen.covariance_m2), nothing, {}, np.ones(len(seen)), nothing)


def _sights(prepared: Prepared) -> Sights:
    if prepared.sights is None:
        raise InputError("points have no line of sight")
    return prepared.sights


class _Reflected(NamedTuple):
    """Coordinates of the reflection of a source, their derivatives by the beam, and by a turn of the mirror."""

    coordinates: FloatArray
    by_beam: FloatArray
    by_turn: FloatArray


def _reflected(posed: Posed, source: FloatArray, sights: Sights) -> _Reflected:
    cosine = dot(source, posed.normal)
    beam = 2 * cosine[:, None] * posed.normal - source
    coordinates = sights.coordinates(beam)
    rows = sights.gradients(beam, coordinates)
    # d beam = 2 (n (s . dn) + (s . n) dn) and dn = turn x n.
    by_normal = 2 * (dot(rows, posed.normal[:, None, :])[..., None] * source[:, None, :] + cosine[:, None, None] * rows)
    return _Reflected(coordinates, rows, cross(posed.normal[:, None, :], by_normal))


class _ToPoint(NamedTuple):
    """Direction to points, their coordinates, the derivative of these by the point, and the distance [m]."""

    direction: FloatArray
    coordinates: FloatArray
    by_point: FloatArray
    distance_m: FloatArray


def _to_point(posed: Posed, points: FloatArray, sights: Sights) -> _ToPoint:
    direction, length = unit_with_length(points - posed.centre)
    coordinates = sights.coordinates(direction)
    by_point = through_unit(sights.gradients(direction, coordinates), direction, length)
    return _ToPoint(direction, coordinates, by_point, length)


def _beam(posed: Posed, spots: BeamSpots, prepared: Prepared) -> Equations:
    sights = _sights(prepared)
    reflected, _, by_turn = _reflected(posed, spots.sun, sights)
    direction, seen, by_point, length = _to_point(posed, spots.spot_m, sights)
    return Equations(reflected - seen, by_turn, by_point, (), (spots.sun, direction), length)


def _camera(posed: Posed, seen: SunInCamera, prepared: Prepared) -> Equations:
    sights = _sights(prepared)
    names = {name: [f"camera_{name}_{axis}" for axis in "enu"] for name in prepared.rows}
    points = np.empty((len(seen), 3))
    for name, rows in prepared.rows.items():
        points[rows] = posed.values(names[name])
    reflected, _, by_turn = _reflected(posed, seen.sun, sights)
    direction, observed, by_point, length = _to_point(posed, points, sights)
    extra = tuple((names[name], rows, -by_point[rows]) for name, rows in prepared.rows.items())
    return Equations(reflected - observed, by_turn, by_point, extra, (seen.sun, direction), length)


def _drone(posed: Posed, seen: DroneSightings, prepared: Prepared) -> Equations:
    sights = _sights(prepared)
    names = {name: [f"target_{name}_{axis}" for axis in "enu"] for name in prepared.rows}
    points = np.empty((len(seen), 3))
    for name, rows in prepared.rows.items():
        points[rows] = posed.values(names[name])
    offset_names = [f"drone_offset_{axis}" for axis in "enu"]
    to_target, target_length = unit_with_length(points - posed.centre)
    reflected, rows_beam, by_turn = _reflected(posed, to_target, sights)
    # The reflection of a changing direction is the reflected change: 2 n (n . dt) - dt.
    by_source = 2 * dot(rows_beam, posed.normal[:, None, :])[..., None] * posed.normal[:, None, :] - rows_beam
    by_target = through_unit(by_source, to_target, target_length)
    direction, observed, by_drone, length = _to_point(posed, seen.source_m + posed.values(offset_names), sights)
    extra = [(offset_names, np.arange(len(seen)), -by_drone)]
    extra += [(names[name], rows, by_target[rows]) for name, rows in prepared.rows.items()]
    return Equations(reflected - observed, by_turn, by_drone - by_target, tuple(extra), (to_target, direction), length)


def _direction_names(label: str) -> list[str]:
    return [f"direction_{label}_{letter}" for letter in "ab"]


def _lamp(posed: Posed, seen: LampSightings, prepared: Prepared) -> Equations:
    sights = _sights(prepared)
    names = [f"mounted_{axis}" for axis in "xyz"]
    from_centre = seen.lamp_m - posed.centre
    line = (posed.rotation.transpose(0, 2, 1) @ from_centre[..., None])[..., 0] - posed.values(names)
    direction, length = unit_with_length(line)
    coordinates = sights.coordinates(direction)
    by_line = through_unit(sights.gradients(direction, coordinates), direction, length)
    in_field = by_line @ posed.rotation.transpose(0, 2, 1)
    every = np.arange(len(seen))
    extra: list[tuple[Sequence[str], Rows, FloatArray]] = [(names, every, -by_line)]
    if seen.direction_camera is None:
        expected = np.empty((len(seen), 2))
        for label, rows in prepared.rows.items():
            expected[rows] = posed.values(_direction_names(label))
            extra.append((_direction_names(label), rows, np.tile(-np.eye(2), (rows.size, 1, 1))))
    else:
        turn_names = [f"mounted_turn_{axis}" for axis in "xyz"]
        turn = posed.values(turn_names)
        turned = sights.towards @ rotation_from_vector(turn).T
        expected = sights.coordinates(turned)
        extra.append((turn_names, every, sights.gradients(turned, expected) @ skew(turned) @ _left_jacobian(turn)))
    by_turn = -cross(from_centre[:, None, :], in_field)
    scaled = 1.0 / prepared.stretch[:, None]
    return Equations(
        (coordinates - expected) * scaled,
        by_turn * scaled[..., None],
        -in_field * scaled[..., None],
        tuple((own, rows, derivative * scaled[rows][..., None]) for own, rows, derivative in extra),
        None,
        length,
    )


def _left_jacobian(vector: FloatArray) -> FloatArray:
    """Rotation that a change of a rotation vector adds on the left, by its series (exact to rounding below 3 rad)."""
    matrix, term = np.eye(3), np.eye(3)
    for k in range(2, 40):
        term = term @ skew(vector) / k
        matrix = matrix + term
    return np.asarray(matrix)


def _normal(posed: Posed, seen: MirrorNormals, prepared: Prepared) -> Equations:
    sights = _sights(prepared)
    coordinates = sights.coordinates(posed.normal)
    rows = sights.gradients(posed.normal, coordinates)
    by_turn = cross(posed.normal[:, None, :], rows)
    return Equations(coordinates, by_turn, np.zeros_like(rows), (), None, np.full(len(seen), np.nan))


def _point(posed: Posed, seen: MirrorPoints, prepared: Prepared) -> Equations:
    del prepared
    arm = (posed.rotation @ seen.point_mirror_m[..., None])[..., 0]
    identity = np.tile(np.eye(3), (len(seen), 1, 1))
    by_turn = cross(arm[:, None, :], identity)
    return Equations(posed.centre + arm - seen.point_m, by_turn, identity, (), None, np.sqrt(dot(arm, arm)))


_PREPARATIONS: dict[type, Callable[[HeliostatDesign, Any], Prepared]] = {
    BeamSpots: _prepare_beam,
    SunInCamera: _prepare_camera,
    DroneSightings: _prepare_drone,
    LampSightings: _prepare_lamp,
    MirrorNormals: _prepare_normal,
    MirrorPoints: _prepare_point,
}
_EQUATIONS: dict[type, Callable[[Posed, Any, Prepared], Equations]] = {
    BeamSpots: _beam,
    SunInCamera: _camera,
    DroneSightings: _drone,
    LampSightings: _lamp,
    MirrorNormals: _normal,
    MirrorPoints: _point,
}
