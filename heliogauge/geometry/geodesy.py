"""Latitude, longitude and altitude to east, north, up about an origin, and back (WGS84)."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.validate import FloatArray, float_array

#: Semi-major axis [m] and flattening of the WGS84 ellipsoid.
WGS84_RADIUS_M, WGS84_FLATTENING = 6378137.0, 1 / 298.257223563
_ECCENTRICITY_2 = WGS84_FLATTENING * (2 - WGS84_FLATTENING)


class Geodetic(NamedTuple):
    """Geodetic coordinates, each of shape (...): north and east positive [degree], altitude [m]."""

    latitude_deg: FloatArray
    longitude_deg: FloatArray
    altitude_m: FloatArray


def enu_from_geodetic(
    latitude_deg: npt.ArrayLike, longitude_deg: npt.ArrayLike, altitude_m: npt.ArrayLike, origin: Sequence[float]
) -> FloatArray:
    """Return east, north, up about an origin.

    latitude_deg, longitude_deg (...): Geodetic coordinates (north, east positive) [degree].
    altitude_m (...): Altitude above the ellipsoid, or above sea level if the origin's is too [m].
    origin: Latitude [degree], longitude [degree], altitude [m] of the point (0, 0, 0).
    Returns (..., 3): East, north, up in the plane that touches the ellipsoid below the origin [m].
    InputError: A latitude beyond the poles (latitude and longitude exchanged?), or an origin that is not three
        numbers.

    Exact through earth-centred coordinates: at 1 km the ground has dropped 78 mm below the plane, which a map of
    degrees times metres per degree does not know.

    >>> enu_from_geodetic(50.9134, 6.3878, 87.0, (50.9134, 6.3878, 87.0)) + 0.0
    array([0., 0., 0.])
    """
    place = float_array("origin", origin, (3,))
    axes = _axes(place)
    centred = _centred(latitude_deg, longitude_deg, altitude_m) - _centred(*place)
    return np.asarray(centred @ axes.T)


def geodetic_from_enu(points_m: npt.ArrayLike, origin: Sequence[float]) -> Geodetic:
    """Return latitude, longitude and altitude of points given east, north, up about an origin.

    Shapes: points_m (..., 3).
    origin: Latitude [degree], longitude [degree], altitude [m] of the point (0, 0, 0).
    InputError: An origin that is not three numbers, or beyond the poles.

    Fixed point on the latitude: each pass gains a factor of 150, five reach rounding.
    """
    place = float_array("origin", origin, (3,))
    x, y, z = np.moveaxis(np.asarray(points_m, dtype=np.float64) @ _axes(place) + _centred(*place), -1, 0)
    distance = np.hypot(x, y)
    latitude = np.arctan2(z, distance * (1 - _ECCENTRICITY_2))
    for _ in range(8):
        curvature = _curvature_radius(latitude)
        latitude = np.arctan2(z + _ECCENTRICITY_2 * curvature * np.sin(latitude), distance)
    curvature = _curvature_radius(latitude)
    # Along the normal, in the form that also holds at the poles.
    altitude = distance * np.cos(latitude) + z * np.sin(latitude) - WGS84_RADIUS_M**2 / curvature
    return Geodetic(np.rad2deg(latitude), np.rad2deg(np.arctan2(y, x)), np.asarray(altitude))


def _curvature_radius(latitude_rad: FloatArray) -> FloatArray:
    return np.asarray(WGS84_RADIUS_M / np.sqrt(1 - _ECCENTRICITY_2 * np.sin(latitude_rad) ** 2))


def _centred(latitude_deg: npt.ArrayLike, longitude_deg: npt.ArrayLike, altitude_m: npt.ArrayLike) -> FloatArray:
    latitude = np.asarray(latitude_deg, dtype=np.float64)
    if (np.abs(latitude) > 90).any():
        raise InputError(f"latitude_deg: {np.abs(latitude).max():g} is beyond the pole; latitude precedes longitude")
    latitude, longitude = np.deg2rad(latitude), np.deg2rad(np.asarray(longitude_deg, dtype=np.float64))
    altitude = np.asarray(altitude_m, dtype=np.float64)
    radius = _curvature_radius(latitude)
    level, height = (radius + altitude) * np.cos(latitude), radius * (1 - _ECCENTRICITY_2) + altitude
    return np.stack([level * np.cos(longitude), level * np.sin(longitude), height * np.sin(latitude)], axis=-1)


def _axes(origin: FloatArray) -> FloatArray:
    """Return east, north and up at the origin as rows, in earth-centred coordinates."""
    (cos_lat, cos_lon), (sin_lat, sin_lon) = np.cos(np.deg2rad(origin[:2])), np.sin(np.deg2rad(origin[:2]))
    return np.array(
        [
            [-sin_lon, cos_lon, 0.0],
            [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
            [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
        ]
    )
