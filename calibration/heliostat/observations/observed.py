"""Rows become observations: geometry by kind, sigmas, and a verdict on each row that cannot be used."""

from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np

from calibration.heliostat.kinematic_model.design import HeliostatDesign, PlaneTarget
from calibration.heliostat.observations.observations import (
    BeamSpots,
    DroneSightings,
    Group,
    LampSightings,
    MirrorNormals,
    MirrorPoints,
    Observations,
    Place,
    Pointings,
    SunInCamera,
)
from calibration.heliostat.observations.plant import Plant
from calibration.heliostat.observations.row_checks import readings_of, refuse_constants, refuse_repeats, suns_of
from calibration.heliostat.observations.rows import Rows, Verdicts
from heliogauge.validate import BoolArray, FloatArray

KINDS = ("beam", "drone", "camera", "normal", "point", "lamp")
_WITH_SUN = ("beam", "camera")
#: Of a direction, where the table gives no sigma_mrad; the fit then estimates a common factor.
_DIRECTION_SIGMA_RAD = 1e-3
#: Of a drone or a point of the mirror, where the table gives none [m].
_PLACE_SIGMA_M = 0.02
#: A sigma beyond these, in metres or radians, is no knowledge, and its square soon 0 or no number.
_LEAST_SIGMA, _MOST_SIGMA = 1e-9, 1e3
#: A beam's centre given in space may be this far off its target's plane [m].
_OFF_PLANE_M = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Observed:
    """Observations of a heliostat, and what became of each row.

    rows: All rows, with the verdict on each.
    observations: Those that can be used; ``observations.row`` counts rows of `rows`. None without any.
    readings (n, 2): Readings of all rows in the design's unit; NaN where there are none.
    suns (n, 3): Directions to the sun; NaN where there is none.
    spots_m (n, 3): Where the beams' centres were seen [m]; NaN for other kinds.
    sun_check_rad: Median angle between suns as recorded and as SPA has them [rad]; NaN where not both are there.
    has_sigmas: Whether the table itself has sigmas.
    """

    rows: Rows
    observations: Observations | None
    readings: FloatArray
    suns: FloatArray
    spots_m: FloatArray
    sun_check_rad: float
    has_sigmas: bool


def observed(
    rows: Rows, design: HeliostatDesign, plant: Plant, cameras: Sequence[Place], spot_sigma_m: float
) -> Observed:
    """Turn rows into observations.

    rows: As they were read.
    design: The heliostat as it is known.
    plant: Targets and site.
    cameras: Cameras in which the sun is seen reflected.
    spot_sigma_m: Sigma of a beam's centre where the table gives none [m].
    InputError: A whole column is in another unit or convention, or never changes.
    """
    verdicts = Verdicts(rows)
    kinds = rows.text("kind", "beam")
    _refuse_names("unreadable", "kind", kinds, KINDS, verdicts)
    needs_sun = np.array([kind in _WITH_SUN for kind in kinds], dtype=np.bool_)
    readings = readings_of(rows, design, verdicts)
    suns, check = suns_of(rows, plant.site, verdicts, needs_sun)
    spots = _spots(rows, kinds, plant, verdicts)
    refuse_repeats(rows, verdicts)
    building = _Building(rows, kinds, readings, suns, spots, verdicts)
    groups = [group for kind in KINDS if (group := _group(building, kind, plant, cameras, spot_sigma_m)) is not None]
    refuse_constants(readings, suns, verdicts.usable & needs_sun, design.name)
    given = any(name in rows.numbers for name in ("sigma_mm", "sigma_x_mm", "sigma_mrad", "sigma_drone_e_mm"))
    return Observed(
        verdicts.judged(rows), Observations(tuple(groups)) if groups else None, readings, suns, spots, check, given
    )


def _refuse_names(flag: str, column: str, names: Sequence[str], known: Sequence[str], verdicts: Verdicts) -> None:
    unknown = np.array([name not in known for name in names], dtype=np.bool_)

    def text(row: int) -> str:
        near = get_close_matches(names[row], known, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(known) or 'none'}"
        return f"{column} = {names[row]!r} is not known; {hint}"

    verdicts.refuse(unknown, flag, text)


def _spots(rows: Rows, kinds: Sequence[str], plant: Plant, verdicts: Verdicts) -> FloatArray:
    """Return where the beams' centres were seen, (n, 3) [m], and refuse those that are on no target."""
    spots = np.full((len(rows), 3), np.nan)
    is_beam = np.array([kind == "beam" for kind in kinds], dtype=np.bool_)
    names = rows.text("target")
    curved = np.array([name in plant.other_targets for name in names], dtype=np.bool_)
    verdicts.refuse(is_beam & curved, "target", lambda row: f"target {names[row]!r} is not flat: it cannot be used")
    checked = Verdicts(rows)
    _refuse_names("target", "target", names, tuple(plant.targets), checked)
    wrong = is_beam & np.array([flag == "target" for flag in checked.flags], dtype=np.bool_)
    verdicts.refuse(wrong, "target", lambda row: checked.reasons[row])
    flat, space = rows.vector("x_m", "y_m"), rows.vector("e_m", "n_m", "u_m")
    for name, target in plant.targets.items():
        here = is_beam & np.array([one == name for one in names], dtype=np.bool_)
        flat_here = here & np.isfinite(flat).all(axis=1)
        spots[flat_here] = target.points(flat[flat_here])
        spots[here & ~flat_here] = space[here & ~flat_here]
        _refuse_off_target(target, spots, here, verdicts)
    missing = is_beam & ~np.isfinite(spots).all(axis=1)
    verdicts.refuse(missing, "not_finite", "the beam's centre is missing: x_m, y_m (or e_m, n_m, u_m)")
    return spots


def _refuse_off_target(target: PlaneTarget, spots: FloatArray, here: BoolArray, verdicts: Verdicts) -> None:
    coordinates = target.coordinates(spots)
    aside = (spots - target.center_m) @ target.normal
    with np.errstate(invalid="ignore"):
        beyond = here & np.isfinite(spots).all(axis=1) & ~target.contains(coordinates)
        off_plane = here & (np.abs(aside) > _OFF_PLANE_M)

    def text(row: int) -> str:
        x, y = coordinates[row]
        hint = "; are these millimetres?" if max(abs(x), abs(y)) > 20 * max(target.width_m, target.height_m) else ""
        size = f"{target.width_m:.2f} x {target.height_m:.2f} m"
        return f"the centre at ({x:.2f}, {y:.2f}) m is off target {target.name!r} ({size}){hint}"

    verdicts.refuse(beyond, "off_target", text)
    verdicts.refuse(off_plane, "off_target", lambda row: f"the centre is {aside[row]:.2f} m off the target's plane")


@dataclass(frozen=True, slots=True, eq=False)
class _Building:
    """What all kinds of observations are built from."""

    rows: Rows
    kinds: tuple[str, ...]
    readings: FloatArray
    suns: FloatArray
    spots_m: FloatArray
    verdicts: Verdicts

    def numbers(self, kind: str, names: Sequence[str], what: str) -> FloatArray:
        """Return columns that a kind needs, and refuse its rows without them."""
        values = self.rows.vector(*names)
        missing = self.of(kind) & ~np.isfinite(values).all(axis=1)
        self.verdicts.refuse(missing, "not_finite", f"{what} is missing: {', '.join(names)}")
        return values

    def sigmas(self, kind: str, names: Sequence[str], otherwise: float, unit: float) -> FloatArray:
        """Return standard deviations (n, len(names)), and refuse rows whose are not positive."""
        values = self.rows.vector(*names) * unit
        values = np.where(np.isnan(values), otherwise, values)
        wrong = self.of(kind) & ~((values >= _LEAST_SIGMA) & (values < _MOST_SIGMA)).all(axis=1)
        self.verdicts.refuse(wrong, "not_finite", f"{names[0]}: a sigma must be positive, from 1e-6 to 1e6")
        return values

    def of(self, kind: str) -> BoolArray:
        """Whether each row is of a kind."""
        return np.array([one == kind for one in self.kinds], dtype=np.bool_)

    def usable(self, kind: str) -> BoolArray:
        """Whether each row is of a kind and can be used."""
        return np.asarray(self.of(kind) & self.verdicts.usable)

    def pointings(self, chosen: BoolArray) -> Pointings:
        """Return where the drives stood in some rows."""
        approach = np.nan_to_num(self.rows.vector("approach_1", "approach_2")[chosen])
        return Pointings(
            self.readings[chosen], np.nonzero(chosen)[0], self.rows.times[chosen], approach if approach.any() else None
        )

    def names(self, column: str, chosen: BoolArray) -> tuple[str, ...]:
        """Return a column of texts in some rows."""
        cells = self.rows.text(column)
        return tuple(cells[row] for row in np.nonzero(chosen)[0].tolist())


def _group(building: _Building, kind: str, plant: Plant, cameras: Sequence[Place], spot_sigma_m: float) -> Group | None:
    if not building.of(kind).any():
        return None
    if kind == "beam":
        return _beams(building, plant, spot_sigma_m)
    if kind == "camera":
        return _cameras(building, cameras)
    if kind == "drone":
        return _drones(building, plant)
    if kind == "lamp":
        return _lamps(building)
    return _normals(building) if kind == "normal" else _points(building)


def _beams(building: _Building, plant: Plant, sigma_m: float) -> BeamSpots | None:
    both = building.sigmas("beam", ("sigma_mm", "sigma_mm"), sigma_m, 1e-3)
    own = building.rows.vector("sigma_x_mm", "sigma_y_mm") * 1e-3
    sigma = np.where(np.isnan(own), both, own)
    wrong = building.of("beam") & ~((sigma >= _LEAST_SIGMA) & (sigma < _MOST_SIGMA)).all(axis=1)
    building.verdicts.refuse(wrong, "not_finite", "a sigma must be positive, from 1e-6 to 1e6 mm")
    chosen = building.usable("beam")
    if not chosen.any():
        return None
    names = building.names("target", chosen)
    spots, named = building.spots_m[chosen], np.array(names, dtype=np.str_)
    flat = np.empty((len(spots), 2))
    for name in set(names):
        flat[named == name] = plant.targets[name].coordinates(spots[named == name])
    return BeamSpots.on_targets(
        building.pointings(chosen), building.suns[chosen], plant.targets, names, flat, sigma[chosen]
    )


def _cameras(building: _Building, cameras: Sequence[Place]) -> SunInCamera | None:
    known = tuple(place.name for place in cameras)
    checked = Verdicts(building.rows)
    _refuse_names("camera", "camera", building.rows.text("camera"), known, checked)
    wrong = building.of("camera") & np.array([flag == "camera" for flag in checked.flags], dtype=np.bool_)
    building.verdicts.refuse(wrong, "camera", lambda row: checked.reasons[row])
    sigma = building.sigmas("camera", ("sigma_mrad",), _DIRECTION_SIGMA_RAD, 1e-3)[:, 0]
    chosen = building.usable("camera")
    if not chosen.any():
        return None
    return SunInCamera(
        building.pointings(chosen),
        building.suns[chosen],
        building.names("camera", chosen),
        tuple(cameras),
        sigma[chosen],
    )


def _drones(building: _Building, plant: Plant) -> DroneSightings | None:
    where = building.numbers("drone", ("drone_e_m", "drone_n_m", "drone_u_m"), "where the drone was")
    names = ("sigma_drone_e_mm", "sigma_drone_n_mm", "sigma_drone_u_mm")
    sigma = building.sigmas("drone", names, _PLACE_SIGMA_M, 1e-3)
    targets, space = building.rows.text("target"), building.rows.vector("e_m", "n_m", "u_m")
    flat = np.nan_to_num(building.rows.vector("x_m", "y_m"))
    places: dict[str, Place] = {}
    labels = [""] * len(targets)
    for row in np.nonzero(building.of("drone"))[0].tolist():
        point = space[row]
        if not np.isfinite(point).all():
            if targets[row] not in plant.targets:
                continue
            point = plant.targets[targets[row]].points(flat[row : row + 1])[0]
        key = repr(point.tolist())
        fresh = targets[row] or "point"
        label = next((name for name, place in places.items() if repr(place.center_m.tolist()) == key), "")
        if not label:
            taken = sum(name == fresh or name.startswith(f"{fresh}_") for name in places)
            label = f"{fresh}_{taken + 1}" if taken else fresh
            places[label] = Place(label, point)
        labels[row] = label
    unknown = building.of("drone") & np.array([not label for label in labels], dtype=np.bool_)
    building.verdicts.refuse(
        unknown, "target", lambda row: f"target = {targets[row]!r} is not known, nor e_m, n_m, u_m"
    )
    chosen = building.usable("drone")
    if not chosen.any():
        return None
    covariance = np.einsum("ni,ij->nij", sigma[chosen] ** 2, np.eye(3))
    seen = tuple(labels[row] for row in np.nonzero(chosen)[0].tolist())
    return DroneSightings(building.pointings(chosen), where[chosen], covariance, seen, tuple(places.values()))


def _lamps(building: _Building) -> LampSightings | None:
    where = building.numbers("lamp", ("lamp_e_m", "lamp_n_m", "lamp_u_m"), "where the lamp is")
    sigma = building.sigmas("lamp", ("sigma_mrad",), _DIRECTION_SIGMA_RAD, 1e-3)[:, 0]
    direction = building.rows.vector("direction_x", "direction_y", "direction_z")
    calibrated: BoolArray = np.asarray(np.isfinite(direction).all(axis=1))
    labels = building.rows.text("position")
    unplaced = building.of("lamp") & ~calibrated & np.array([not label for label in labels], dtype=np.bool_)
    building.verdicts.refuse(unplaced, "not_finite", "position (of the image) or direction_x, _y, _z is missing")
    mixed = building.of("lamp") & calibrated & ~calibrated[building.usable("lamp")].all()
    building.verdicts.refuse(mixed, "unreadable", "other lamps have a position and no direction; one form for all")
    chosen = building.usable("lamp")
    if not chosen.any():
        return None
    names = building.names("lamp", chosen)
    pointings = building.pointings(chosen)
    if calibrated[chosen].all():
        return LampSightings(pointings, where[chosen], names, sigma[chosen], direction_camera=direction[chosen])
    return LampSightings(pointings, where[chosen], names, sigma[chosen], building.names("position", chosen))


def _normals(building: _Building) -> MirrorNormals | None:
    normal = building.numbers("normal", ("normal_e", "normal_n", "normal_u"), "the normal")
    sigma = building.sigmas("normal", ("sigma_mrad",), _DIRECTION_SIGMA_RAD, 1e-3)[:, 0]
    chosen = building.usable("normal")
    return MirrorNormals(building.pointings(chosen), normal[chosen], sigma[chosen]) if chosen.any() else None


def _points(building: _Building) -> MirrorPoints | None:
    own = building.numbers("point", ("point_x_m", "point_y_m", "point_z_m"), "the point in the mirror's frame")
    seen = building.numbers("point", ("e_m", "n_m", "u_m"), "the point as measured")
    sigma = building.sigmas("point", ("sigma_mm",), _PLACE_SIGMA_M, 1e-3)[:, 0]
    chosen = building.usable("point")
    if not chosen.any():
        return None
    covariance = sigma[chosen, None, None] ** 2 * np.eye(3)
    names = building.names("point", chosen)
    return MirrorPoints(building.pointings(chosen), own[chosen], seen[chosen], covariance, names)
