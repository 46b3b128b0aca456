"""Stars over a place by the classical formulas of Meeus, Astronomical Algorithms (1998): good to a few microradian."""

import numpy as np

from heliogauge.validate import FloatArray

_ARC_SECOND = np.pi / 648000


def apparent_places(right_ascension: FloatArray, declination: FloatArray, julian_date: float) -> FloatArray:
    """Return unit vectors of stars in the equator and equinox of a date, from places at 2000.0, shape (n, 3).

    Precession (ch. 21), nutation by its four largest terms (ch. 22), aberration by the Earth's motion (ch. 23).
    """
    t = (julian_date - 2451545.0) / 36525
    zeta = (2306.2181 * t + 0.30188 * t**2) * _ARC_SECOND
    z = (2306.2181 * t + 1.09468 * t**2) * _ARC_SECOND
    theta = (2004.3109 * t - 0.42665 * t**2) * _ARC_SECOND
    star = np.stack(
        [
            np.cos(declination) * np.cos(right_ascension),
            np.cos(declination) * np.sin(right_ascension),
            np.sin(declination),
        ],
        axis=1,
    )
    # Towards the Earth's motion, by 20.5 arc seconds (eccentricity 0.0167).
    sun_longitude, obliquity = _sun_longitude(t), np.radians(23.4392911 - 0.0130042 * t)
    perihelion = np.radians(102.93735)
    along = np.array(
        [np.sin(sun_longitude) - 0.016708 * np.sin(perihelion), -np.cos(sun_longitude) + 0.016708 * np.cos(perihelion)]
    )
    ecliptic = 20.49552 * _ARC_SECOND * np.array([along[0], along[1] * np.cos(obliquity), along[1] * np.sin(obliquity)])
    star = star + ecliptic
    star /= np.linalg.norm(star, axis=1, keepdims=True)
    star = star @ _about_z(zeta).T @ _about_y(-theta).T @ _about_z(z).T
    node = np.radians(125.04452 - 1934.136261 * t)
    moon_longitude = np.radians(218.3165 + 481267.8813 * t)
    longitude = -17.20 * np.sin(node) - 1.32 * np.sin(2 * sun_longitude) - 0.23 * np.sin(2 * moon_longitude)
    longitude = (longitude + 0.21 * np.sin(2 * node)) * _ARC_SECOND
    oblique = 9.20 * np.cos(node) + 0.57 * np.cos(2 * sun_longitude) + 0.10 * np.cos(2 * moon_longitude)
    oblique = (oblique - 0.09 * np.cos(2 * node)) * _ARC_SECOND
    return np.asarray(star @ _about_x(-obliquity).T @ _about_z(longitude).T @ _about_x(obliquity + oblique).T)


def _sun_longitude(t: float) -> float:
    mean, anomaly = np.radians(280.46646 + 36000.76983 * t), np.radians(357.52911 + 35999.05029 * t)
    return float(mean + np.radians(1.914602 * np.sin(anomaly) + 0.019993 * np.sin(2 * anomaly)))


def _about_x(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def _about_y(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def _about_z(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def over_place(
    of_date: FloatArray, julian_date: float, latitude_rad: float, longitude_rad: float, pressure_hpa: float
) -> FloatArray:
    """Return unit vectors east, north, up of stars as seen through the air at 12 degrees, shape (n, 3).

    Sidereal time (ch. 12), refraction by Saemundsson's formula (ch. 16).
    """
    t = (julian_date - 2451545.0) / 36525
    sidereal = 280.46061837 + 360.98564736629 * (julian_date - 2451545.0) + 0.000387933 * t**2
    node, sun = np.radians(125.04452 - 1934.136261 * t), 2 * _sun_longitude(t)
    equation = (-17.20 * np.sin(node) - 1.32 * np.sin(sun)) * np.cos(np.radians(23.4393)) / 3600
    hour = np.radians((sidereal + equation) % 360) + longitude_rad - np.arctan2(of_date[:, 1], of_date[:, 0])
    level = np.hypot(of_date[:, 0], of_date[:, 1])
    east = -level * np.sin(hour)
    north = np.cos(latitude_rad) * of_date[:, 2] - np.sin(latitude_rad) * level * np.cos(hour)
    up = np.sin(latitude_rad) * of_date[:, 2] + np.cos(latitude_rad) * level * np.cos(hour)
    height = np.degrees(np.arctan2(up, np.hypot(east, north)))
    safe = np.maximum(height, 1.0)
    minutes = 1.02 / np.tan(np.radians(safe + 10.3 / (safe + 5.11))) * pressure_hpa / 1010 * 283 / (273 + 12.0)
    seen = np.radians(height + minutes / 60)
    azimuth = np.arctan2(east, north)
    return np.stack([np.cos(seen) * np.sin(azimuth), np.cos(seen) * np.cos(azimuth), np.sin(seen)], axis=1)
