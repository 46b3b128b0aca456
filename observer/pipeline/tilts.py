"""Readings of an inclinometer on a collector that turns before a fixed camera: from the table to where it stood."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from heliogauge.doubts import Doubt
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import rotation_from_vector
from heliogauge.images.photo_times import photo_time_s, seconds_of
from heliogauge.results.tables import read_table_csv
from heliogauge.validate import FloatArray
from observer.files import number_in_cell
from observer.keys import ObserverMeasurement, TiltsSection
from observer.turning.far_camera import FarCamera, KnownFarCamera, TiltReadings

#: Fewest readings: a straight line, one that tests it, and one that may be wrong.
LEAST_READINGS = 4
#: Variance of a place that is anywhere between two readings, over the square of their distance.
_EVENLY = 1 / 12


@dataclass(frozen=True, slots=True, eq=False)
class Tilts:
    """Readings of all photos, and the camera as surveyed.

    by_photo: Reading and sigma of each photo that has one [rad].
    camera: The camera before the collector.
    cam_up: Direction of the world's up in the frame of the collector at the middle reading, for upright cameras.
    roll_rad: Turn of the camera about its line of sight [rad].
    doubts: Readings without photos.
    file, left_handed: As stated, for messages.
    """

    by_photo: Mapping[str, tuple[float, float]]
    camera: KnownFarCamera
    cam_up: FloatArray
    roll_rad: float
    doubts: tuple[Doubt, ...]
    file: str
    left_handed: bool

    def of(self, names: Sequence[str]) -> TiltReadings:
        """Return the readings of photos in their order."""
        rows = np.array([self.by_photo.get(name, (np.nan, np.nan)) for name in names])
        return TiltReadings(rows[:, 0], rows[:, 1])

    def places(self) -> "FarPlaces":
        """Return where the readings have the camera in each photo."""
        names = tuple(self.by_photo)
        return FarPlaces(names, self.camera.camera.eyes_m(self.of(names).tilt_rad), self.camera.sigma_m(), self)


@dataclass(frozen=True, slots=True, eq=False)
class FarPlaces:
    """Places and turns of the camera in the frame of the collector, as drones say them in that of the Earth.

    photos: Names of the photos that have a reading.
    enu_m (n, 3): Place of each, in the frame of the collector [m].
    common_sigma_m (3,): How well they are known [m].
    tilts: What tells the turns.
    """

    photos: tuple[str, ...]
    enu_m: FloatArray
    common_sigma_m: FloatArray
    tilts: Tilts

    @property
    def sigma_m(self) -> FloatArray:
        """Standard deviations of the places, shape (n, 3) [m]."""
        return np.broadcast_to(self.common_sigma_m, self.enu_m.shape)

    def enu_from_camera(self, number: int) -> FloatArray:
        """Return the rotation of a camera that looks at the collector, upright but for its roll."""
        forward = -self.enu_m[number] / np.linalg.norm(self.enu_m[number])
        right = np.cross(forward, self.tilts.cam_up)
        right /= np.linalg.norm(right)
        upright = np.stack([right, np.cross(forward, right), forward], axis=1)
        return np.asarray(upright @ rotation_from_vector(np.array([0.0, 0.0, self.tilts.roll_rad])))


def read_tilts(measurement: ObserverMeasurement) -> Tilts | None:
    """Read the tilts of all photos; None where measurement.toml names none.

    InputError: A table that cannot be read, no photo in it, photos without times, or a collector whose orientation
        leaves open which way is up in the photos.
    """
    section = measurement.model.tilts
    if section is None:
        return None
    path, files = measurement.folder / section.file, measurement.all_photos
    needed = "image" if section.time_column is None else section.time_column
    table = read_table_csv(path, (needed, *section.column))
    degrees, sigma_rad = _cells(table, path, section)
    if section.time_column is None:
        rows, strange = _by_name(table["image"], degrees, sigma_rad, path, files)
    else:
        rows, strange = _by_time(table[section.time_column], degrees, sigma_rad, path, files, section)
    if len(rows) < LEAST_READINGS:
        raise InputError(
            f"{path}: {len(rows)} of {len(files)} photos have a reading, {LEAST_READINGS} are needed; do the names (or "
            "times) of the table belong to these photos?"
        )
    sign = -1.0 if section.left_handed else 1.0
    known = {name: (sign * tilt, sigma) for name, (tilt, sigma) in rows.items()}
    camera = _camera(section, np.array([tilt for tilt, _ in known.values()]), sign)
    up = _up(np.radians(measurement.model.collector.orientation_deg))
    return Tilts(
        known, camera, up, float(np.radians(section.camera_roll_deg)), strange, section.file, section.left_handed
    )


def _up(orientation_rad: float) -> FloatArray:
    up = rotation_from_vector(np.array([0.0, -orientation_rad, 0.0])) @ np.array([0.0, 0.0, 1.0])
    # A camera that the collector faces looks along z: near zenith nothing says how it is turned about that.
    if float(np.hypot(up[0], up[1])) < np.sin(np.radians(_STEEPEST_DEG)):
        raise InputError(
            f"tilts: collector.orientation_deg = {float(np.degrees(orientation_rad)):g}: a collector that faces a "
            "camera on the ground stands near 90 or -90; the orientation says which way is up in the photos"
        )
    return np.asarray(up)


#: Nearer to zenith than this the collector faces no camera on the ground or on a mast [deg].
_STEEPEST_DEG = 20.0


def _camera(section: TiltsSection, tilt_rad: FloatArray, sign: float) -> KnownFarCamera:
    middle = float(tilt_rad.min() + tilt_rad.max()) / 2
    facing = middle if section.facing_deg is None else sign * float(np.radians(section.facing_deg))
    axis = 1e-3 * section.axis_sigma_mm
    facing_sigma = float(np.radians(section.facing_sigma_deg))
    return KnownFarCamera(
        FarCamera(facing, section.distance_m, section.along_m, *section.axis_m),
        np.array([facing_sigma, section.distance_sigma_m, section.along_sigma_m, axis, axis, section.scale_sigma]),
    )


def _cells(table: Mapping[str, Sequence[str]], path: Path, section: TiltsSection) -> tuple[FloatArray, FloatArray]:
    """Return readings [deg] and their sigmas [rad], NaN for empty cells."""

    def column(name: str) -> FloatArray:
        cells = (number_in_cell(path, line, name, cell) for line, cell in enumerate(table[name], start=2))
        return np.array([np.nan if value is None else value for value in cells])

    degrees = np.mean([column(name) for name in section.column], axis=0)
    sigma_mrad = np.full(degrees.shape, section.sigma_mrad)
    if "sigma_mrad" in table:
        own = column("sigma_mrad")
        sigma_mrad = np.where(np.isfinite(own), own, sigma_mrad)
    if (sigma_mrad <= 0).any():
        line = int(np.argmax(sigma_mrad <= 0)) + 2
        raise InputError(f"{path}, line {line}: sigma_mrad: a value above 0 is needed")
    return degrees, 1e-3 * sigma_mrad


def _by_name(
    names: Sequence[str], degrees: FloatArray, sigma_rad: FloatArray, path: Path, files: Sequence[Path]
) -> tuple[dict[str, tuple[float, float]], tuple[Doubt, ...]]:
    photos, rows, strange = {file.name for file in files}, {}, []
    for line, (name, value, sigma) in enumerate(zip(names, degrees, sigma_rad, strict=True), start=2):
        if name in rows:
            raise InputError(f"{path}, line {line}: {name} is given twice; keep one reading")
        if name not in photos:
            strange.append(name)
        elif np.isfinite(value):
            rows[name] = (float(np.radians(value)), float(sigma))
    if not strange:
        return rows, ()
    some = ", ".join(strange[:3]) + (" ..." if len(strange) > 3 else "")
    text = f"tilts.file: {len(strange)} of {len(names)} readings belong to no photo: {some}; are photos missing?"
    return rows, (Doubt("tilts_without_photo", text, {"readings_count": len(strange)}),)


def _by_time(
    times: Sequence[str],
    degrees: FloatArray,
    sigma_rad: FloatArray,
    path: Path,
    files: Sequence[Path],
    section: TiltsSection,
) -> tuple[dict[str, tuple[float, float]], tuple[Doubt, ...]]:
    """Interpolate readings at the times of the photos; the collector may be anywhere between two of them."""
    known = np.isfinite(degrees)
    when = np.array([seconds_of(cell, f"{path}, line {line}") for line, cell in enumerate(times, start=2)])[known]
    read, sigma_rad = np.radians(degrees[known]), sigma_rad[known]
    if when.size < 2 or (np.diff(when) <= 0).any():
        raise InputError(f"{path}: two readings or more are needed, one after the other in time")
    rows, outside = {}, []
    for file in files:
        taken = photo_time_s(file)
        if taken is None:
            raise InputError(f"{file.name}: it does not say when it was taken; give tilts.file the column image")
        at = taken[0] - section.time_offset_s
        if not when[0] <= at <= when[-1]:
            outside.append(file.name)
            continue
        after = int(np.clip(np.searchsorted(when, at), 1, when.size - 1))
        share = (at - when[after - 1]) / (when[after] - when[after - 1])
        ends = read[after - 1 : after + 1]
        # A time of whole seconds leaves open how far it has turned since.
        rate = (ends[1] - ends[0]) / (when[after] - when[after - 1])
        spread = float(sigma_rad[after] ** 2 + _EVENLY * (ends[1] - ends[0]) ** 2 + (rate * taken[1]) ** 2)
        rows[file.name] = (float((1 - share) * ends[0] + share * ends[1]), float(np.sqrt(spread)))
    if outside and not rows:
        raise InputError(
            f"{path}: no photo was taken between its first and its last reading ({times[0]} to {times[-1]}; "
            f"{outside[0]} was not); is time_offset_s right, or the clock's zone?"
        )
    if not outside:
        return rows, ()
    text = f"tilts.file: {len(outside)} of {len(files)} photos were taken before its first or after its last reading"
    return rows, (Doubt("photos_outside_tilts", text, {"photos_count": len(outside)}),)
