"""From a heliostat's numbers to the residuals of its observations, with derivatives, whitened and in radians."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from calibration.heliostat.design import HeliostatDesign, PlaneTarget
from calibration.heliostat.directions import cross_columns, stereographic, stereographic_derivatives, tangents
from calibration.heliostat.kinematics import mirror_poses, pose_derivatives
from calibration.heliostat.observations import (
    BeamSpots,
    DroneSightings,
    LampSightings,
    MirrorNormals,
    MirrorPoints,
    Observations,
    SunInCamera,
)
from heliogauge.errors import InputError
from heliogauge.rays import intersect_plane, reflect
from heliogauge.rigid import rotation_from_vector, skew
from heliogauge.validate import BoolArray, FloatArray, freeze

IndexArray = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Residuals of observations at given numbers of a heliostat.

    Parameters
    ----------
    whitened : ndarray, shape (m,)
        Predicted minus measured in sigma; 0 for rows that cannot be computed.
    jacobian : ndarray, shape (m, k)
        Derivatives by the wanted parameters.
    owner : ndarray of int, shape (m,)
        Row that each component belongs to; the two or three components of a row follow one another.
    beam_rad : ndarray, shape (n, 2)
        Measured minus predicted direction of the beam (for a drone: of the line of sight), right and up as seen from
        the mirror along it [rad]; NaN for kinds without a beam.
    normal_rad : ndarray, shape (n, 2)
        The mirror's normal that would explain the measurement minus the predicted one, right and up as seen along it
        [rad]; for lamps the turn of the structure across the line of sight, for points NaN.
    sigma_beam_rad : ndarray, shape (n,)
        Stated sigma per axis of the beam or line of sight (root mean of both axes), of the normal for kinds that
        measure it [rad]; NaN for points.
    distance_m : ndarray, shape (n,)
        From the mirror to what was observed [m]; NaN for normals.
    computable : ndarray of bool, shape (n,)
        Whether the readings lie within the geometry of the actuators.
    """

    whitened: FloatArray
    jacobian: FloatArray
    owner: IndexArray
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


def evaluate(
    design: HeliostatDesign,
    values: npt.ArrayLike,
    observations: Observations,
    *,
    columns: Sequence[int] | IndexArray | None = None,
) -> Residuals:
    """Return the residuals of observations.

    Parameters
    ----------
    design : HeliostatDesign
        The heliostat; its parameters hold what the observations bring with them (`Observations.extra_parameters`).
    values : array_like, shape (p,)
        Numbers in the order of ``design.parameters``; the design's own only choose the axes of the components.
    observations : Observations
        What was seen.
    columns : sequence of int, optional
        Positions of the parameters to differentiate by; all of them if not given.

    Returns
    -------
    Residuals
        Rows in the order of the observations.

    Raises
    ------
    InputError
        A parameter of the observations is missing, or shapes do not fit.

    Notes
    -----
    Directions are compared in stereographic coordinates about the measured one: angles when they are close, and still
    growing when they are far apart, so that a mirror that looks the other way is no false minimum.
    """
    numbers = np.asarray(values, dtype=np.float64)
    moved = pose_derivatives(
        design, numbers, observations.readings, observations.approach, columns=columns, outside="nan"
    )
    finite = np.isfinite(moved.poses.rotation).all(axis=(1, 2)) & np.isfinite(moved.poses.centre_m).all(axis=1)
    computable: BoolArray = np.asarray(finite, dtype=np.bool_)
    place = {design.parameters.names[index]: column for column, index in enumerate(moved.columns)}
    parts, first = [], 0
    for group in observations.groups:
        rows = slice(first, first + len(group))
        first += len(group)
        view = _View(
            design, numbers, place, moved.poses.rotation[rows], moved.poses.centre_m[rows],
            moved.omega[rows], moved.shift[rows],
        )  # fmt: skip
        parts.append(_EVALUATIONS[type(group)](view, group))
    owners = np.repeat(np.arange(len(observations)), observations.n_components)
    whitened = np.concatenate([part.whitened.ravel() for part in parts])
    jacobian = np.concatenate([part.jacobian.reshape(-1, moved.columns.size) for part in parts])
    if not computable.all():
        lost = ~computable[owners]
        whitened[lost], jacobian[lost] = 0.0, 0.0
    beam, normal, sigma, distance = (
        np.concatenate(one) for one in zip(*(part.physical for part in parts), strict=True)
    )
    return Residuals(whitened, jacobian, owners, beam, normal, sigma, distance, computable)


def predicted_spots(
    design: HeliostatDesign, values: npt.ArrayLike, spots: BeamSpots, targets: Mapping[str, PlaneTarget]
) -> FloatArray:
    """Return where the beams should meet their targets.

    Parameters
    ----------
    design : HeliostatDesign
        The heliostat.
    values : array_like, shape (p,)
        Its numbers, in the order of ``design.parameters``.
    spots : BeamSpots
        Readings, sun and target of each row.
    targets : mapping
        The targets by name.

    Returns
    -------
    ndarray, shape (n, 2)
        Coordinates on the target, right and up as seen from the field [m]; NaN where the beam goes elsewhere.

    Raises
    ------
    InputError
        A target is unknown, or shapes do not fit.
    """
    missing = sorted(set(spots.target) - set(targets))
    if missing:
        raise InputError(f"target {', '.join(missing)}: no such target; there are {', '.join(targets)}")
    poses = mirror_poses(design, values, spots.pointings.readings, spots.pointings.approach, outside="nan")
    beams = reflect(-spots.sun, poses.normals(design))
    found = np.full((len(spots), 2), np.nan)
    for i, name in enumerate(spots.target):
        target = targets[name]
        along = float(intersect_plane(poses.centre_m[i], beams[i], target.center_m, target.normal))
        if along > 0:
            found[i] = target.coordinates(poses.centre_m[i] + along * beams[i])
    return found


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """Poses and derivatives of one group's rows."""

    design: HeliostatDesign
    numbers: FloatArray
    place: Mapping[str, int]
    rotation: FloatArray
    centre: FloatArray
    omega: FloatArray
    shift: FloatArray

    @property
    def normal(self) -> FloatArray:
        return np.asarray(self.rotation @ self.design.normal)

    @property
    def origin(self) -> FloatArray:
        """Where the heliostat stands in the design: fixed, so that axes and weights do not move with the fit."""
        return self.design.position_m

    def value(self, name: str) -> float:
        return float(self.numbers[self.design.parameters.index(name)])

    def values(self, names: Sequence[str]) -> FloatArray:
        return np.array([self.value(name) for name in names])

    def place_of(self, prefix: str, name: str) -> FloatArray:
        return self.values([f"{prefix}_{name}_{axis}" for axis in "enu"])

    def add(self, jacobian: FloatArray, names: Sequence[str], rows: npt.NDArray[Any], derivative: FloatArray) -> None:
        """Add ``derivative``, shape (r, c, len(names)), to the columns of some parameters where they are wanted."""
        for k, name in enumerate(names):
            if name in self.place:
                jacobian[rows, :, self.place[name]] += derivative[..., k]


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Residuals of one group: (n, c) whitened, (n, c, k) derivatives, then what is told in radians and metres."""

    whitened: FloatArray
    jacobian: FloatArray
    physical: tuple[FloatArray, FloatArray, FloatArray, FloatArray]


def _whiten(residual: FloatArray, jacobian: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    try:
        root = np.linalg.inv(np.linalg.cholesky(covariance)) if len(covariance) else covariance
    except np.linalg.LinAlgError as error:
        raise InputError(
            "observations: a covariance vanishes across the line of sight; give every row a sigma"
        ) from error
    return np.asarray((root @ residual[..., None])[..., 0]), np.asarray(root @ jacobian)


def _line_covariance(covariance_m2: FloatArray, towards: FloatArray, distance: FloatArray) -> FloatArray:
    """Covariance of a direction, (n, 2, 2) [rad^2], from that of the point it goes to, (n, 3, 3) [m^2]."""
    axes = np.stack(tangents(towards), axis=1)
    return np.asarray(axes @ covariance_m2 @ axes.transpose(0, 2, 1) / (distance**2)[:, None, None])


def _isotropic(sigma: FloatArray) -> FloatArray:
    return np.asarray(np.eye(2) * (sigma**2)[:, None, None])


def _unit_with_length(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    length = np.sqrt(np.einsum("ni,ni->n", vectors, vectors))
    return vectors / length[:, None], length


def _unit_derivative(unit: FloatArray, length: FloatArray, changes: FloatArray) -> FloatArray:
    """Turn derivatives of vectors, (n, 3, k), into those of their unit vectors."""
    along = unit[:, None, :] @ changes
    return np.asarray((changes - unit[..., None] * along) / length[:, None, None])


def _reflected(view: _View, towards: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Reflection of directions that point away from the mirror, and its derivative at a fixed direction."""
    normal = view.normal
    cosine = np.einsum("ni,ni->n", towards, normal)
    turned = cross_columns(view.omega, normal)
    along = towards[:, None, :] @ turned
    beam = 2 * cosine[:, None] * normal - towards
    return beam, np.asarray(2 * (normal[..., None] * along + cosine[:, None, None] * turned))


def _mirrored(
    view: _View,
    beam: tuple[FloatArray, FloatArray],
    seen: tuple[FloatArray, FloatArray, FloatArray],
    *,
    source: FloatArray,
    covariance: FloatArray,
    towards: FloatArray,
) -> _Part:
    """Compare a reflected beam with the direction (and length) it was seen to take; both with derivatives."""
    residual = stereographic(beam[0], towards) - stereographic(seen[0], towards)
    jacobian = stereographic_derivatives(beam[0], beam[1], towards) - stereographic_derivatives(*seen[:2], towards)
    needed, _ = _unit_with_length(source + seen[0])
    normal = stereographic(needed, view.normal)
    sigma = np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 2)
    whitened = _whiten(residual, jacobian, covariance)
    return _Part(*whitened, (-residual, normal, sigma, seen[2]))


def _to_point(view: _View, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Direction from the mirror to points, its derivative while the points stay, and the distance."""
    direction, length = _unit_with_length(points - view.centre)
    return direction, _unit_derivative(direction, length, -view.shift), length


def _beam(view: _View, spots: BeamSpots) -> _Part:
    direction, change, length = _to_point(view, spots.spot_m)
    towards, distance = _unit_with_length(spots.spot_m - view.origin)
    covariance = _line_covariance(spots.covariance_m2, towards, distance)
    return _mirrored(
        view,
        _reflected(view, spots.sun),
        (direction, change, length),
        source=spots.sun,
        covariance=covariance,
        towards=towards,
    )


def _camera(view: _View, seen: SunInCamera) -> _Part:
    points = np.empty((len(seen), 3))
    nominal = {place.name: place.center_m for place in seen.cameras}
    towards, _ = _unit_with_length(np.array([nominal[name] for name in seen.camera]).reshape(-1, 3) - view.origin)
    rows = {name: np.array([one == name for one in seen.camera], dtype=np.bool_) for name in set(seen.camera)}
    for name, chosen in rows.items():
        points[chosen] = view.place_of("camera", name)
    direction, change, length = _to_point(view, points)
    for name, chosen in rows.items():
        across = _unit_derivative(direction[chosen], length[chosen], np.broadcast_to(np.eye(3), (chosen.sum(), 3, 3)))
        view.add(change, [f"camera_{name}_{axis}" for axis in "enu"], chosen, across)
    return _mirrored(
        view,
        _reflected(view, seen.sun),
        (direction, change, length),
        source=seen.sun,
        covariance=_isotropic(seen.sigma_rad),
        towards=towards,
    )


def _drone(view: _View, seen: DroneSightings) -> _Part:
    count = len(seen)
    rows = {name: np.array([one == name for one in seen.target], dtype=np.bool_) for name in set(seen.target)}
    points = np.empty((count, 3))
    for name, chosen in rows.items():
        points[chosen] = view.place_of("target", name)
    offset_names = [f"drone_offset_{axis}" for axis in "enu"]
    source = seen.source_m + view.values(offset_names)
    to_target, target_change, target_length = _to_point(view, points)
    to_drone, drone_change, drone_length = _to_point(view, source)
    identity = np.broadcast_to(np.eye(3), (count, 3, 3))
    view.add(drone_change, offset_names, np.arange(count), _unit_derivative(to_drone, drone_length, identity))
    for name, chosen in rows.items():
        across = _unit_derivative(to_target[chosen], target_length[chosen], identity[chosen])
        view.add(target_change, [f"target_{name}_{axis}" for axis in "enu"], chosen, across)
    beam, turned = _reflected(view, to_target)
    # The reflection of a changing direction: 2 n (n . dt) - dt.
    along = view.normal[:, None, :] @ target_change
    turned = turned + 2 * view.normal[..., None] * along - target_change
    towards, distance = _unit_with_length(seen.source_m - view.origin)
    covariance = _line_covariance(seen.source_covariance_m2, towards, distance)
    return _mirrored(
        view,
        (beam, turned),
        (to_drone, drone_change, drone_length),
        source=to_target,
        covariance=covariance,
        towards=towards,
    )


def _lamp(view: _View, seen: LampSightings) -> _Part:
    count = len(seen)
    names = [f"mounted_{axis}" for axis in "xyz"]
    from_centre = seen.lamp_m - view.centre
    inverse = view.rotation.transpose(0, 2, 1)
    line = (inverse @ from_centre[..., None])[..., 0] - view.values(names)
    change = inverse @ (-view.shift - cross_columns(view.omega, from_centre))
    view.add(change, names, np.arange(count), np.broadcast_to(-np.eye(3), (count, 3, 3)))
    direction, length = _unit_with_length(line)
    change = _unit_derivative(direction, length, change)
    if seen.direction_camera is None:
        residual, jacobian = _shared_direction(view, seen.position or (), seen.camera.axis, direction, change)
    else:
        residual, jacobian = _calibrated_direction(view, seen, seen.direction_camera, direction, change)
    whitened = _whiten(residual, jacobian, _isotropic(seen.sigma_rad))
    return _Part(*whitened, (np.full((count, 2), np.nan), -residual, np.array(seen.sigma_rad), length))


def _shared_direction(
    view: _View, labels: tuple[str, ...], axis: FloatArray, direction: FloatArray, change: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Compare lines of sight with the unknown direction that all rows of a label share."""
    count = len(labels)
    towards = np.broadcast_to(axis, (count, 3))
    pairs = [[f"direction_{label}_{letter}" for letter in "ab"] for label in labels]
    shared = np.array([view.values(pair) for pair in pairs]).reshape(count, 2)
    # The map stretches away from the camera's axis, 4 % at 0.4 rad: undone at the design's own numbers.
    own = view.design.parameters
    nominal = np.array([[own.value(name) for name in pair] for pair in pairs]).reshape(count, 2)
    stretch = 1.0 + 0.25 * np.sum(nominal**2, axis=1)
    residual = (stereographic(direction, towards) - shared) / stretch[:, None]
    jacobian = stereographic_derivatives(direction, change, towards)
    for i, pair in enumerate(pairs):
        view.add(jacobian, pair, np.array([i]), -np.eye(2)[None])
    return residual, jacobian / stretch[:, None, None]


def _calibrated_direction(
    view: _View, seen: LampSightings, direction_camera: FloatArray, direction: FloatArray, change: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Compare lines of sight with what a calibrated camera saw, carried to the mirror's frame."""
    names = [f"mounted_turn_{axis}" for axis in "xyz"]
    turn = view.values(names)
    planned = direction_camera @ seen.camera.mirror_from_camera.T
    turned = planned @ rotation_from_vector(turn).T
    residual = stereographic(direction, planned) - stereographic(turned, planned)
    jacobian = stereographic_derivatives(direction, change, planned)
    by_turn = stereographic_derivatives(turned, -skew(turned) @ _left_jacobian(turn), planned)
    view.add(jacobian, names, np.arange(len(seen)), -by_turn)
    return residual, jacobian


def _left_jacobian(vector: FloatArray) -> FloatArray:
    """Rotation that a change of a rotation vector adds on the left, by its series (exact to rounding below 3 rad)."""
    matrix, term = np.eye(3), np.eye(3)
    for k in range(2, 40):
        term = term @ skew(vector) / k
        matrix = matrix + term
    return np.asarray(matrix)


def _normal(view: _View, seen: MirrorNormals) -> _Part:
    residual = stereographic(view.normal, seen.normal)
    jacobian = stereographic_derivatives(view.normal, cross_columns(view.omega, view.normal), seen.normal)
    whitened = _whiten(residual, jacobian, _isotropic(seen.sigma_rad))
    nothing = np.full((len(seen), 2), np.nan)
    return _Part(*whitened, (nothing, -residual, np.array(seen.sigma_rad), np.full(len(seen), np.nan)))


def _point(view: _View, seen: MirrorPoints) -> _Part:
    arm = (view.rotation @ seen.point_mirror_m[..., None])[..., 0]
    residual = view.centre + arm - seen.point_m
    jacobian = view.shift + cross_columns(view.omega, arm)
    whitened = _whiten(residual, jacobian, seen.covariance_m2)
    nothing = np.full((len(seen), 2), np.nan)
    length = np.sqrt(np.einsum("ni,ni->n", arm, arm))
    return _Part(*whitened, (nothing, nothing.copy(), np.full(len(seen), np.nan), length))


_EVALUATIONS: dict[type, Callable[[_View, Any], _Part]] = {
    BeamSpots: _beam,
    SunInCamera: _camera,
    DroneSightings: _drone,
    LampSightings: _lamp,
    MirrorNormals: _normal,
    MirrorPoints: _point,
}
