"""Where the sun stands: directions in the field's frame (east, north, up) from UTC and place, refracted by the air."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.geometry.sun_position import geocentric_sun, refraction_rad, seen_from, time_difference_s
from heliogauge.validate import BoolArray, FloatArray, TimeArray, float_array, freeze, positive

# The series of the solar position take 0.5 kB an instant and term: 100 MB at a time.
_INSTANTS_AT_A_TIME = 20_000
# Refraction where the sun rises, used only to decide below which elevation none is applied [degree].
_HORIZON_REFRACTION_DEG = 0.5667


@dataclass(frozen=True, slots=True)
class Site:
    """A place on earth and the air over it.

    latitude_deg, longitude_deg: Geodetic latitude (north positive) and longitude (east positive) [degree].
    altitude_m: Height above sea level [m].
    pressure_hpa: Air pressure at the site, not reduced to sea level; the standard atmosphere's at that altitude if
        None [hPa].
    InputError: Numbers that cannot be.

    At 10 degrees of elevation refraction is 1.6 mrad; 10 hPa change it by 0.016 mrad, 10 K by 0.055 mrad.
    """

    latitude_deg: float
    longitude_deg: float
    altitude_m: float = 0.0
    pressure_hpa: float | None = None
    temperature_c: float = 12.0

    def __post_init__(self) -> None:
        ranges = {
            "latitude_deg": (-90.0, 90.0),
            "longitude_deg": (-180.0, 360.0),
            "altitude_m": (-450.0, 9000.0),
            "temperature_c": (-90.0, 70.0),
        }
        for name, (low, high) in ranges.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError(f"site: {name} must lie between {low:g} and {high:g}, not {value:g}")
        if self.pressure_hpa is not None and not 200 <= positive("pressure_hpa", self.pressure_hpa, "hPa") <= 1100:
            raise InputError(f"site: pressure_hpa {self.pressure_hpa:g}: hPa between 200 and 1100 are needed")

    @property
    def air_pressure_hpa(self) -> float:
        """Pressure given, or that of the standard atmosphere at this altitude [hPa]."""
        if self.pressure_hpa is not None:
            return self.pressure_hpa
        return float(((44331.514 - self.altitude_m) / 11880.516) ** (1 / 0.1902632))


def utc_times(times: Sequence[str | datetime]) -> TimeArray:
    """Read instants that say their time zone.

    Shapes: result (n,).
    times: ISO 8601 with zone, such as ``2023-09-11T09:56:19Z`` or ``2023-09-11 11:56:19+02:00``, or aware
        datetimes.
    InputError: An instant cannot be read or has no zone; the message names the row, counted from 0.

    >>> utc_times(["2023-09-11T11:56:19+02:00"])
    array(['2023-09-11T09:56:19.000'], dtype='datetime64[ms]')
    """
    return np.array([_instant(row, time) for row, time in enumerate(times)], dtype="datetime64[ms]")


def _instant(row: int, time: str | datetime) -> np.datetime64:
    try:
        moment = time if isinstance(time, datetime) else datetime.fromisoformat(time.strip())
    except (ValueError, AttributeError):
        raise InputError(f"row {row}: {time!r} is not an ISO 8601 time such as 2023-09-11T09:56:19Z") from None
    if moment.utcoffset() is None:
        raise InputError(
            f"row {row}: time {time!s} says no zone; append Z for UTC or an offset such as +02:00 "
            "(an hour off is 260 mrad of sun)"
        )
    return np.datetime64(moment.astimezone(UTC).replace(tzinfo=None), "ms")


def sun_angles(times: npt.ArrayLike, site: Site, *, refracted: bool = True) -> tuple[FloatArray, FloatArray]:
    """Return azimuth and elevation of the sun's centre.

    times (n,): Instants in UTC.
    refracted: Apparent elevation, as the mirror sees the sun; False for the geometric one.
    azimuth, elevation (n,): Azimuth from north, clockwise, in [0, 2 pi); elevation above the horizon [rad].
    InputError: Not instants, or one is missing.

    The solar position algorithm of Reda and Andreas (2004), 0.005 mrad from -2000 to 6000.
    """
    instants = _checked_times(times)
    unix = instants.astype("datetime64[ms]").astype(np.int64) / 1e3
    months = instants.astype("datetime64[M]").astype(np.int64)
    latitude, longitude = np.deg2rad((site.latitude_deg, site.longitude_deg))
    azimuth, elevation = np.empty(len(unix)), np.empty(len(unix))
    for start in range(0, len(unix), _INSTANTS_AT_A_TIME):
        part = slice(start, start + _INSTANTS_AT_A_TIME)
        difference = time_difference_s(1970 + months[part] // 12, 1 + months[part] % 12)
        sun = geocentric_sun(unix[part], difference)
        azimuth[part], elevation[part] = seen_from(sun, latitude, longitude, site.altitude_m)
        if refracted:
            elevation[part] += refraction_rad(
                elevation[part], site.air_pressure_hpa, site.temperature_c, _HORIZON_REFRACTION_DEG
            )
    return np.asarray(freeze(azimuth)), np.asarray(freeze(elevation))


def sun_directions(times: npt.ArrayLike, site: Site, *, refracted: bool = True) -> FloatArray:
    """Return unit vectors toward the sun's centre in the frame east, north, up.

    Shapes: result (n, 3).
    times (n,): Instants in UTC.
    refracted: As the mirror sees the sun; False without the air.
    InputError: Not instants, or one is missing.
    """
    return direction_from_angles(*sun_angles(times, site, refracted=refracted))


def direction_from_angles(azimuth_rad: npt.ArrayLike, elevation_rad: npt.ArrayLike) -> FloatArray:
    """Return unit vectors (..., 3), east, north, up, from azimuth (0 = north, clockwise) and elevation [rad]."""
    azimuth, elevation = np.asarray(azimuth_rad, dtype=np.float64), np.asarray(elevation_rad, dtype=np.float64)
    level = np.cos(elevation)
    return np.stack([level * np.sin(azimuth), level * np.cos(azimuth), np.sin(elevation)], axis=-1)


def angles_from_direction(directions: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return azimuth (0 = north, clockwise, in [0, 2 pi)) and elevation [rad] of vectors (..., 3) of any length."""
    vector = np.asarray(directions, dtype=np.float64)
    azimuth = np.arctan2(vector[..., 0], vector[..., 1]) % (2 * np.pi)
    return np.asarray(azimuth), np.arctan2(vector[..., 2], np.hypot(vector[..., 0], vector[..., 1]))


def azimuth_from_south_east(azimuth_rad: npt.ArrayLike) -> FloatArray:
    """Return the azimuth (0 = north, clockwise) of one that is 0 in the south and positive to the east [rad].

    Examples
    --------
    >>> np.rad2deg(azimuth_from_south_east(np.deg2rad([0.0, 30.0, -48.9197]))).round(4)
    array([180.    , 150.    , 228.9197])
    """
    return np.asarray((np.pi - np.asarray(azimuth_rad, dtype=np.float64)) % (2 * np.pi))


def below_horizon(directions: npt.ArrayLike, lowest_rad: float = 0.0) -> BoolArray:
    """Return where the sun stands too low to be in an observation (wrong time, zone or sign), shape (n,).

    directions (n, 3): Directions to the sun, of any length.
    lowest_rad: Elevation below which it cannot have been seen [rad].
    Returns (n,): True where the elevation is below that or not a number.
    """
    vectors = float_array("directions", directions, (None, 3), finite=False)
    return np.asarray(~(angles_from_direction(vectors)[1] >= lowest_rad))


def _checked_times(times: npt.ArrayLike) -> TimeArray:
    instants = np.asarray(times)
    if instants.ndim != 1 or instants.dtype.kind != "M":
        raise InputError(
            f"times: datetime64 in UTC of shape (n,) are needed, not {instants.dtype} of shape {instants.shape}; "
            "heliogauge.geometry.sun.utc_times reads texts with their zone"
        )
    missing = np.isnat(instants)
    if missing.any():
        raise InputError(f"times: {missing.sum()} of {len(instants)} are missing, the first in row {missing.argmax()}")
    return instants
