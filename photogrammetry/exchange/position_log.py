"""A drone's log by time, as flight controllers and receivers write it: where it was when each photo was taken."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from heliogauge.errors import InputError
from heliogauge.geometry.geodesy import enu_from_geodetic
from heliogauge.images.photo_times import photo_time_s, seconds_of
from heliogauge.results.tables import read_table_csv
from heliogauge.validate import FloatArray
from photogrammetry.exchange.drone_positions import (
    GEODETIC_COLUMNS,
    LOCAL_COLUMNS,
    SIGMA_COLUMNS,
    TURN_COLUMNS,
    DronePositions,
)

#: Drones change their speed by up to so much; between two lines they leave the straight line by an eighth of it times
#: the square of the time between them [m/s^2].
_ACCELERATION_M_S2 = 2.0


@dataclass(frozen=True, slots=True)
class LogClock:
    """How the times of a log belong to those of the photos.

    column: Column of the log with the times.
    offset_s: Clock of the camera less that of the log [s].
    sigma_s: Its standard deviation [s].
    """

    column: str
    offset_s: float
    sigma_s: float


def read_position_log(path: Path, files: Sequence[Path], default_sigma_m: float, clock: LogClock) -> DronePositions:
    """Read positions by time, interpolated at the times of the photos.

    path: Table with a column of times and latitude_deg, longitude_deg, altitude_m or east_m, north_m, up_m; with
        sigma_east_mm, sigma_north_mm, sigma_up_mm and yaw_deg, pitch_deg, roll_deg of the camera where they are known.
    files: The photos; their EXIF says when they were taken.
    default_sigma_m: Standard deviation where the log says none [m].
    Returns: Of the photos between its first and its last line. What the clock's error makes at the drone's speed, and
        what it may leave a straight line by, is in their sigmas.
    InputError: Cells that are no numbers or times, times that do not rise, photos without a time, or no photo within.
    """
    table = read_table_csv(path, (clock.column,))
    columns = next((one[1:] for one in (GEODETIC_COLUMNS, LOCAL_COLUMNS) if set(one[1:]) <= set(table)), None)
    if columns is None:
        raise InputError(
            f"{path}: columns {', '.join(GEODETIC_COLUMNS[1:])} or {', '.join(LOCAL_COLUMNS[1:])} are needed"
        )
    when = np.array(
        [seconds_of(cell, f"{path}, line {line}") for line, cell in enumerate(table[clock.column], start=2)]
    )
    if when.size < 2 or (np.diff(when) <= 0).any():
        raise InputError(f"{path}: two lines or more are needed, one after the other in time")
    place = _numbers(table, columns, path)
    if columns == GEODETIC_COLUMNS[1:]:
        origin = np.median(place, axis=0).tolist()
        place = enu_from_geodetic(place[:, 0], place[:, 1], place[:, 2], origin)
    sigma = np.full(place.shape, default_sigma_m)
    if set(SIGMA_COLUMNS) <= set(table):
        sigma = 1e-3 * _numbers(table, SIGMA_COLUMNS, path)
    turns = np.full(place.shape, np.nan)
    if set(TURN_COLUMNS) <= set(table):
        turns = np.unwrap(_numbers(table, TURN_COLUMNS, path), period=360.0, axis=0)
    names, rows = [], []
    for file in files:
        taken = photo_time_s(file)
        if taken is None:
            raise InputError(f"{file.name}: it does not say when it was taken; give {path.name} a column image instead")
        at = taken[0] - clock.offset_s
        if when[0] <= at <= when[-1]:
            names.append(file.name)
            rows.append(_at(at, float(np.hypot(taken[1], clock.sigma_s)), when, (place, sigma, turns)))
    if not names:
        raise InputError(
            f"{path}: no photo was taken between its first and its last line ({table[clock.column][0]} to "
            f"{table[clock.column][-1]}); is time_offset_s right, or the clock's zone?"
        )
    values = np.array(rows)
    return DronePositions(tuple(names), values[:, 0], values[:, 1], values[:, 2])


def _at(
    at_s: float, sigma_s: float, when_s: FloatArray, values: tuple[FloatArray, FloatArray, FloatArray]
) -> FloatArray:
    """Return place, sigma and turns at a time, shape (3, 3)."""
    place, sigma, turns = values
    after = int(np.clip(np.searchsorted(when_s, at_s), 1, when_s.size - 1))
    step = float(when_s[after] - when_s[after - 1])
    share = (at_s - when_s[after - 1]) / step
    between = [(1 - share) * one[after - 1] + share * one[after] for one in (place, sigma, turns)]
    speed = (place[after] - place[after - 1]) / step
    bent = _ACCELERATION_M_S2 * step**2 / 8
    return np.array([between[0], np.sqrt(between[1] ** 2 + (speed * sigma_s) ** 2 + bent**2), between[2]])


def _numbers(table: dict[str, list[str]], names: Sequence[str], path: Path) -> FloatArray:
    """Return columns of numbers, shape (n, k)."""
    found = np.full((len(table[names[0]]), len(names)), np.nan)
    for k, name in enumerate(names):
        for row, cell in enumerate(table[name]):
            try:
                found[row, k] = float(cell)
            except ValueError:
                found[row, k] = np.nan
            if not np.isfinite(found[row, k]):
                raise InputError(f"{path}, line {row + 2}, {name}: {cell!r} is not a number")
    return found
