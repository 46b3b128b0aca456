"""Files of the PAINT database (and of ARTIST, which reads the same): heliostats, targets, calibration records.

Several generations of keys are about: ``kinematics_properties`` and ``kinematic_properties``, ``joint_translation_e_1``
and ``first_joint_translation_e``, ``axis_1_motor_position`` and ``Axis1MotorPosition``, one flat table with
``B_axis_1``. In all of them the sun's azimuth is 0 in the south and positive to the east, its elevation as seen.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from calibration.heliostat.keys import properties_files
from calibration.heliostat.kinematic_model.design import PlaneTarget
from calibration.heliostat.observations.rows import NO_TIME, Rows, Verdicts, parse_times, rows_of
from heliogauge.doubts import Doubt
from heliogauge.errors import InputError
from heliogauge.files.texts import parse_json
from heliogauge.geometry.geodesy import enu_from_geodetic
from heliogauge.measurement.files import natural_order
from heliogauge.results.json_file import read_json
from heliogauge.validate import FloatArray

TOWER_FILES = ("tower_measurements.json", "*tower-measurements.json", "*tower_measurements.json", "tower.json")
TIMES_FILE = "timestamps.json"
KINEMATICS = ("kinematics_properties", "kinematic_properties")
_CORNERS = ("upper_left", "upper_right", "lower_right", "lower_left")
#: Numbers of an actuator: our name, key of today's files, letter of the oldest ones.
ACTUATOR_KEYS = {
    "increment": ("increment", "PulseRatio_axis_"),
    "initial_stroke": ("initial_stroke_length", "B_axis_"),
    "offset": ("offset", "C_axis_"),
    "pivot_radius": ("pivot_radius", "D_axis_"),
    "initial_angle": ("initial_angle", "AngleK_axis_"),
    "clockwise": ("clockwise_axis_movement", "Reversed_axis_"),
    "lowest": ("min_increment", "MinCounts_axis_"),
    "highest": ("max_increment", "MaxCounts_axis_"),
}
TRANSLATIONS = {
    "joint_1": ("joint_translation_{}_1", "first_joint_translation_{}"),
    "joint_2": ("joint_translation_{}_2", "second_joint_translation_{}"),
    "concentrator": ("concentrator_translation_{}", "concentrator_translation_{}"),
}
SOUTH = (0.0, -1.0, 0.0)
_LINEAR, _IDEAL = "linear", "ideal"
#: An axis turns by less than this either way; motor positions of linear actuators are counts, some ten thousand [rad].
TURN_RAD = 2 * np.pi


@dataclass(frozen=True, slots=True)
class PaintUnit:
    """Files of one heliostat.

    calibrations: Its calibration records, in the order of their numbers.
    fault: Why it cannot be calibrated; empty where its files are as they should be.
    """

    name: str
    properties: Path
    calibrations: tuple[Path, ...]
    fault: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Tower:
    """Where the plant is, and its flat targets.

    origin: Latitude [deg], longitude [deg], altitude [m] of the plant: the origin of the field's frame.
    targets: Targets by name.
    others: Names of targets that are not flat.
    """

    origin: tuple[float, float, float]
    targets: dict[str, PlaneTarget]
    others: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class PaintProperties:
    """The content of a properties file.

    position: Latitude [deg], longitude [deg], altitude [m].
    actuators: Numbers of both actuators, by the names of `ACTUATOR_KEYS`; empty where they are ideal and have none.
    is_ideal: Whether both are ideal: a motor position may then be the angle of the axis itself [rad].
    translations_m: East, north, up of ``joint_1``, ``joint_2``, ``concentrator`` [m].
    size_m: Width and height of the mirror [m]; NaN where not given.
    doubts: What was assumed.
    """

    position: FloatArray
    actuators: tuple[dict[str, float], dict[str, float]]
    is_ideal: bool
    translations_m: dict[str, tuple[float, ...]]
    size_m: tuple[float, float]
    doubts: tuple[Doubt, ...]
    content: dict[str, Any]


# --- where the files are ----------------------------------------------------------------------------------------------


def find_units(folder: Path, names: Sequence[str] = ()) -> tuple[PaintUnit, ...]:
    """Find the heliostats of a folder.

    names: Only these heliostats.
    Returns: Heliostats in natural order; those without calibration records or without properties, and those that
        are there twice, too, so that they can be named.
    InputError: No heliostat, or none of a name that is asked for.
    """
    units: dict[str, PaintUnit] = {}
    for file in properties_files(folder):
        name = _unit_name(file)
        first = units.setdefault(name, PaintUnit(name, file, _calibrations(_home(file))))
        if first.properties != file and not first.fault:
            units[name] = replace(first, fault=f"it is there twice, {first.properties} and {file}: keep one")
    if not units:
        raise InputError(f"{folder}: no heliostat's properties (*_properties.json) are here or in a folder below")
    homes = {_home(unit.properties).resolve() for unit in units.values()}
    for place in _homes_of_records(folder):
        if place.resolve() not in homes and place.name not in units:
            stated = place / f"{place.name}_properties.json"
            fault = f"no properties (*_properties.json) beside its calibration records in {place}"
            units[place.name] = PaintUnit(place.name, stated, _calibrations(place), fault)
    missing = [name for name in names if name not in units]
    if missing:
        raise InputError(f"{folder}: no heliostat {missing[0]!r}; there are {', '.join(list(units)[:8])}")
    chosen = [units[name] for name in names] if names else list(units.values())
    return tuple(sorted(chosen, key=lambda unit: natural_order(unit.name)))


def _unit_name(file: Path) -> str:
    name = re.sub(r"[-_]?(heliostat[-_])?properties$", "", file.stem, flags=re.IGNORECASE)
    if name:
        return name
    return _home(file).resolve().name


def _home(properties: Path) -> Path:
    return properties.parent.parent if properties.parent.name == "Properties" else properties.parent


def _homes_of_records(folder: Path) -> tuple[Path, ...]:
    """Return the folders, this one or below, that have a folder with calibration records."""
    found = [place.parent for pattern in ("calibration", "*/calibration") for place in sorted(folder.glob(pattern))]
    found += [place.parent for pattern in ("Calibration", "*/Calibration") for place in sorted(folder.glob(pattern))]
    return tuple(place for place in dict.fromkeys(found) if place.is_dir())


def _calibrations(home: Path) -> tuple[Path, ...]:
    for place in ("calibration", "Calibration", "."):
        found = [
            file for file in (home / place).glob("*calibration*propert*.json") if "stac" not in file.name.casefold()
        ]
        if found:
            return tuple(sorted(found, key=lambda file: natural_order(file.name)))
    return ()


def find_beside(folder: Path, patterns: Iterable[str], places: Sequence[str] = (".", "tower")) -> Path | None:
    """Find a file that heliostats share: in a folder, or in one of the two above, or in ``tower`` there."""
    start = folder.resolve()
    for home in (start, *list(start.parents)[:2]):
        for place in places:
            for pattern in patterns:
                found = sorted((home / place).glob(pattern))
                if found:
                    return found[0]
    return None


# --- content of the files ---------------------------------------------------------------------------------------------


def read_tower(file: Path) -> Tower:
    """Read the file of the tower.

    file: Such as ``tower_measurements.json``.
    Returns: Origin and flat targets.
    InputError: Not JSON, or a key is missing.
    """
    content = read_json(file)
    try:
        latitude, longitude, altitude = (float(one) for one in content["power_plant_properties"]["coordinates"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{file}: power_plant_properties.coordinates (lat, lon, alt) are needed ({error})") from error
    origin = (latitude, longitude, altitude)
    targets, others = {}, []
    for name, target in content.items():
        if name == "power_plant_properties":
            continue
        if not isinstance(target, dict) or target.get("type", "planar") != "planar":
            others.append(name)
            continue
        try:
            corners = np.array([target["coordinates"][corner] for corner in _CORNERS], dtype=np.float64)
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{file}: target {name}: the corner {error} is needed as lat, lon, alt") from error
        targets[name] = PlaneTarget.from_corners(name, _in_field(corners, origin))
    return Tower(origin, targets, tuple(others))


def _in_field(places: FloatArray, origin: tuple[float, float, float]) -> FloatArray:
    """Return east, north, up (n, 3) [m] of latitude, longitude, altitude (n, 3)."""
    return enu_from_geodetic(places[:, 0], places[:, 1], places[:, 2], origin)


def parse_properties(text: str, where: str) -> PaintProperties:
    """Read the properties of a heliostat.

    text: The file's content.
    where: The file, for messages.
    InputError: Not JSON, a key is missing, a number that cannot be meant, or drives of another kind or of two kinds.
    """
    content = _parsed(text, where)
    kinematics = next((content[key] for key in KINEMATICS if isinstance(content.get(key), dict)), None)
    if kinematics is None:
        raise InputError(f"{where}: the key {' or '.join(KINEMATICS)} is missing")
    doubts = []
    orientation = content.get("initial_orientation")
    facing = tuple(orientation[:3]) if isinstance(orientation, list) else None
    translations = {name: _translation(kinematics, keys) for name, keys in TRANSLATIONS.items()}
    if facing != SOUTH:
        stated = "no initial_orientation" if facing is None else f"initial_orientation {list(facing)}"
        if any(any(shift) for shift in translations.values()):
            text = (
                f"{where}: {stated}: an older convention, in which its joint translations have other axes; they are "
                "left out"
            )
            doubts.append(Doubt("paint_translations_left_out", text))
        translations = dict.fromkeys(TRANSLATIONS, (0.0, 0.0, 0.0))
    (first_kind, first), (second_kind, second) = (_actuator(kinematics, axis, where) for axis in (1, 2))
    if first_kind != second_kind:
        raise InputError(f"{where}: one actuator is {first_kind}, the other {second_kind}; two of a kind can be read")
    return PaintProperties(
        position=_position(content, where),
        actuators=(first, second),
        is_ideal=first_kind == _IDEAL,
        translations_m=translations,
        size_m=(float(content.get("width", np.nan)), float(content.get("height", np.nan))),
        doubts=tuple(doubts),
        content=content,
    )


def _parsed(text: str, where: str) -> dict[str, Any]:
    content = parse_json(text, where, nan=True)
    if not isinstance(content, dict):
        raise InputError(f"{where}: a JSON object is needed, not a {type(content).__name__}")
    return content


def _finite(value: Any, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise InputError(f"{what} = {value!r}: a finite number is needed")
    return float(value)


def _position(content: Mapping[str, Any], where: str) -> FloatArray:
    value = content.get("heliostat_position")
    if not isinstance(value, list) or len(value) < 3:
        raise InputError(f"{where}: heliostat_position = {value!r}: latitude, longitude and altitude are needed")
    latitude, longitude, altitude = (_finite(one, f"{where}: heliostat_position") for one in value[:3])
    if abs(latitude) > 90 or abs(longitude) > 360:
        raise InputError(f"{where}: heliostat_position {value}: latitude [deg], longitude [deg], altitude [m] in order")
    return np.array([latitude, longitude, altitude])


def _translation(kinematics: Mapping[str, Any], keys: tuple[str, str]) -> tuple[float, ...]:
    found = []
    for axis in "enu":
        names = [key.format(axis) for key in keys]
        value = next((kinematics[name] for name in names if name in kinematics), 0.0)
        found.append(_finite(value, names[0]))
    return tuple(found)


def _actuator(kinematics: Mapping[str, Any], axis: int, where: str) -> tuple[str, dict[str, float]]:
    """Return the kind of an actuator and its numbers; of an ideal one only if it has all of them."""
    listed = kinematics.get("actuators")
    if listed is not None and (not isinstance(listed, list) or len(listed) != 2):
        raise InputError(f"{where}: actuators: two are needed")
    table = kinematics if listed is None else listed[axis - 1]
    kind = str(table.get("type_axis", table.get(f"Type_axis_{axis}", _LINEAR))).casefold()
    if kind not in (_LINEAR, _IDEAL):
        raise InputError(f"{where}: actuator {axis} is of type {kind!r}; linear and ideal ones can be read")
    chosen = {name: key if listed is not None else f"{letter}{axis}" for name, (key, letter) in ACTUATOR_KEYS.items()}
    missing = [key for key in chosen.values() if key not in table]
    if missing and kind == _IDEAL:
        return kind, {}
    if missing:
        raise InputError(f"{where}: actuator {axis}: the key {missing[0]!r} is missing")
    numbers = {name: _finite(table[key], f"{where}: actuator {axis}: {key}") for name, key in chosen.items()}
    for name in ("increment", "initial_stroke", "offset", "pivot_radius"):
        if numbers[name] <= 0:
            raise InputError(f"{where}: actuator {axis}: {name} = {numbers[name]:g}: a positive number is needed")
    return kind, numbers


def parse_calibrations(
    records: Sequence[tuple[str, str]],
    times: Sequence[str],
    *,
    label: str,
    origin: tuple[float, float, float],
    is_ideal: bool = False,
) -> Rows:
    """Read calibration records of a heliostat.

    records: Number and content of each file.
    times: Time of each (ISO 8601 with zone), empty where not known.
    label: Method of the beam's centre: "UTIS" or "HeliOS".
    origin: Latitude [deg], longitude [deg], altitude [m] of the field's frame.
    is_ideal: Whether its actuators are ideal: motor positions are angles then, unless the median of an axis is larger
        than those are.
    """
    names = ("axis_1_counts", "axis_2_counts", "sun_azimuth_deg", "sun_elevation_deg", "lat", "lon", "alt")
    values, targets, verdicts = np.full((len(records), len(names)), np.nan), [""] * len(records), []
    for row, (number, text) in enumerate(records):
        try:
            values[row], targets[row] = _calibration(_parsed(text, f"record {number}"), label)
            verdicts.append(("", ""))
        except _NoLabelError as error:
            values[row], targets[row] = error.values, error.target
            verdicts.append(("label", str(error)))
        except InputError as error:
            verdicts.append(("unreadable", str(error)))
    readings = np.abs(values[np.isfinite(values[:, :2]).all(axis=1), :2])
    # The middle of each axis: one reading that is wrong does not change what the others are.
    is_angle = is_ideal and len(readings) > 0 and bool((np.median(readings, axis=0) <= TURN_RAD).all())
    unit = "rad" if is_angle else "counts"
    columns: dict[str, Any] = {f"axis_{axis}_{unit}": values[:, axis - 1] for axis in (1, 2)}
    columns |= dict(zip(names[2:4], values[:, 2:4].T, strict=True))
    if len(records):
        columns |= dict(zip(("e_m", "n_m", "u_m"), _in_field(values[:, 4:], origin).T, strict=True))
    columns["target"] = targets
    rows = rows_of([number for number, _ in records], columns, np.full(len(records), NO_TIME), verdicts)
    said = Verdicts(rows)
    stamped = parse_times(times, said)
    return said.judged(Rows(rows.ids, rows.numbers, rows.texts, stamped, rows.flags, rows.reasons))


class _NoLabelError(InputError):
    """The record is whole but for the centre by the chosen method."""

    def __init__(self, reason: str, values: list[float], target: str) -> None:
        super().__init__(reason)
        self.values = values
        self.target = target


def _calibration(content: Mapping[str, Any], label: str) -> tuple[list[float], str]:
    motors = content.get("motor_position")
    if not isinstance(motors, dict):
        raise InputError("the key motor_position is missing")
    values = [_of(motors, (f"axis_{axis}_motor_position", f"Axis{axis}MotorPosition")) for axis in (1, 2)]
    # 0 in the south and positive to the east becomes 0 in the north and clockwise.
    values += [180.0 - _of(content, ("sun_azimuth", "Sun_azimuth")), _of(content, ("sun_elevation", "Sun_elevation"))]
    target = content.get("target_name")
    if not isinstance(target, str):
        raise InputError("the key target_name is missing")
    spots = content.get("focal_spot")
    if not isinstance(spots, dict):
        raise InputError("the key focal_spot is missing")
    spot = spots.get(label)
    if spot is None:
        others = ", ".join(spots) or "none"
        raise _NoLabelError(f"no centre by {label}; there is {others}", [*values, *[np.nan] * 3], target)
    if not isinstance(spot, list) or len(spot) < 3:
        raise InputError(f"focal_spot.{label} = {spot!r}: latitude, longitude and altitude are needed")
    place = [_finite(one, f"focal_spot.{label}") for one in spot[:3]]
    if abs(place[0]) > 90:
        raise InputError(f"focal_spot.{label} = {spot}: latitude, longitude, altitude in this order are needed")
    return [*values, *place], target


def _of(table: Mapping[str, Any], keys: tuple[str, str]) -> float:
    for key in keys:
        if key in table:
            return _finite(table[key], key)
    raise InputError(f"the key {keys[0]} is missing")
