"""The solar position algorithm of Reda and Andreas, Solar Energy 76 (2004) 577-589: 0.005 mrad from -2000 to 6000.

Steps are numbered as in the paper (section 3). The difference of terrestrial and universal time is that of Espenak and
Meeus (eclipse.gsfc.nasa.gov/SEcat5/deltatpoly.html).
"""

import numpy as np
import numpy.typing as npt
from numpy.polynomial import polynomial

from heliogauge.geometry.sun_series import LATITUDE, LONGITUDE, NUTATION, RADIUS
from heliogauge.validate import FloatArray

# Flattening and radius of the earth, as the paper has them.
_FLAT, _EARTH_M = 0.99664719, 6378140.0
_SUN_RADIUS_DEG = 0.26667

#: Angles that nutation depends on, as polynomials of Julian centuries [degree]: elongation of the moon, anomalies of
#: sun and moon, moon's argument of latitude and ascending node (eq. 15 to 19).
_MOON_AND_SUN = (
    (297.85036, 445267.111480, -0.0019142, 1 / 189474),
    (357.52772, 35999.050340, -0.0001603, -1 / 300000),
    (134.96298, 477198.867398, 0.0086972, 1 / 56250),
    (93.27191, 483202.017538, -0.0036825, 1 / 327270),
    (125.04452, -1934.136261, 0.0020708, 1 / 450000),
)
#: Mean obliquity of the ecliptic as a polynomial of 10,000 years [arcsec] (eq. 24).
_OBLIQUITY = (84381.448, -4680.93, -1.55, 1999.25, -51.38, -249.67, -39.05, 7.12, 27.87, 5.79, 2.45)
#: Difference of terrestrial and universal time [s]: from which year, origin and unit of the polynomial [year], and its
#: coefficients.
_DELTA_T: tuple[tuple[float, float, float, tuple[float, ...]], ...] = (
    (-np.inf, 1820, 100, (-20, 0, 32)),
    (-500, 0, 100, (10583.6, -1014.41, 33.78311, -5.952053, -0.1798452, 0.022174192, 0.0090316521)),
    (500, 1000, 100, (1574.2, -556.01, 71.23472, 0.319781, -0.8503463, -0.005050998, 0.0083572073)),
    (1600, 1600, 1, (120, -0.9808, -0.01532, 1 / 7129)),
    (1700, 1700, 1, (8.83, 0.1603, -0.0059285, 0.00013336, -1 / 1174000)),
    (
        1800,
        1800,
        1,
        (13.72, -0.332447, 0.0068612, 0.0041116, -0.00037436, 0.0000121272, -0.0000001699, 0.000000000875),
    ),
    (1860, 1860, 1, (7.62, 0.5737, -0.251754, 0.01680668, -0.0004473624, 1 / 233174)),
    (1900, 1900, 1, (-2.79, 1.494119, -0.0598939, 0.0061966, -0.000197)),
    (1920, 1920, 1, (21.20, 0.84493, -0.076100, 0.0020936)),
    (1941, 1950, 1, (29.07, 0.407, -1 / 233, 1 / 2547)),
    (1961, 1975, 1, (45.45, 1.067, -1 / 260, -1 / 718)),
    (1986, 2000, 1, (63.86, 0.3345, -0.060374, 0.0017275, 0.000651814, 0.00002373599)),
    (2005, 2000, 1, (62.92, 0.32217, 0.005589)),
    (2050, 1820, 100, (-20 - 0.5628 * 330, 56.28, 32)),
    (2150, 1820, 100, (-20, 0, 32)),
)


def time_difference_s(years: npt.NDArray[np.int64], months: npt.NDArray[np.int64]) -> FloatArray:
    """Return terrestrial minus universal time in the middle of months [s].

    years (n,): Years of the calendar.
    months (n,): Months of the year, from 1.
    """
    fraction = years + (months - 0.5) / 12
    difference = np.empty_like(fraction)
    for start, origin, unit, coefficients in _DELTA_T:
        inside = years >= start
        difference[inside] = polynomial.polyval((fraction[inside] - origin) / unit, coefficients)
    return difference


def geocentric_sun(
    unix_s: FloatArray, difference_s: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the sun as the middle of the earth sees it (steps 3.2 to 3.10).

    unix_s (n,): Seconds since 1970 in universal time.
    difference_s (n,): Terrestrial minus universal time.
    ascension_rad, declination_rad, sidereal_rad, distance_au (n,): Right ascension, declination, apparent sidereal time
        in Greenwich, distance.
    """
    # Days from noon of 2000-01-01, formed without the large Julian day, which would cost 3e-9 rad of the earth's turn.
    days = unix_s / 86400 - 10957.5
    century = days / 36525
    ephemeris_century = (days + difference_s / 86400) / 36525
    millennium = ephemeris_century / 10
    longitude, latitude, distance = (1e-8 * _sum(series, millennium) for series in (LONGITUDE, LATITUDE, RADIUS))
    psi, epsilon = _nutation(ephemeris_century)
    obliquity = np.deg2rad(polynomial.polyval(millennium / 10, _OBLIQUITY) / 3600) + epsilon
    aberration = np.deg2rad(-20.4898 / 3600) / distance
    apparent, beta = longitude + np.pi + psi + aberration, -latitude
    sidereal = np.deg2rad(
        280.46061837 + 360 * np.mod(days, 1.0) + 0.98564736629 * days + 0.000387933 * century**2 - century**3 / 38710000
    ) + psi * np.cos(obliquity)
    ascension = np.arctan2(np.sin(apparent) * np.cos(obliquity) - np.tan(beta) * np.sin(obliquity), np.cos(apparent))
    declination = np.arcsin(np.sin(beta) * np.cos(obliquity) + np.cos(beta) * np.sin(obliquity) * np.sin(apparent))
    return ascension, declination, sidereal, distance


def seen_from(
    sun: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    latitude_rad: float,
    longitude_rad: float,
    altitude_m: float,
) -> tuple[FloatArray, FloatArray]:
    """Return the sun as a place on earth sees it, without air (steps 3.11 to 3.16).

    sun: From `geocentric_sun`.
    azimuth_rad, elevation_rad (n,): Azimuth from north, clockwise; elevation of the centre.
    """
    ascension, declination, sidereal, distance = sun
    hour = sidereal + longitude_rad - ascension
    parallax = np.sin(np.deg2rad(8.794 / 3600) / distance)
    u = np.arctan(_FLAT * np.tan(latitude_rad))
    x = np.cos(u) + altitude_m / _EARTH_M * np.cos(latitude_rad)
    y = _FLAT * np.sin(u) + altitude_m / _EARTH_M * np.sin(latitude_rad)
    across = np.cos(declination) - x * parallax * np.cos(hour)
    shift = np.arctan2(-x * parallax * np.sin(hour), across)
    declination = np.arctan2((np.sin(declination) - y * parallax) * np.cos(shift), across)
    hour = hour - shift
    elevation = np.arcsin(
        np.sin(latitude_rad) * np.sin(declination) + np.cos(latitude_rad) * np.cos(declination) * np.cos(hour)
    )
    astronomers = np.arctan2(
        np.sin(hour), np.cos(hour) * np.sin(latitude_rad) - np.tan(declination) * np.cos(latitude_rad)
    )
    return np.mod(astronomers + np.pi, 2 * np.pi), elevation


def refraction_rad(
    elevation_rad: FloatArray, pressure_hpa: float, temperature_c: float, horizon_refraction_deg: float
) -> FloatArray:
    """Return by how much the air lifts the sun; nothing where all of it is below the horizon (eq. 42).

    elevation_rad (n,): Elevation of the centre without air.
    horizon_refraction_deg: Refraction where the sun rises [degree].
    """
    elevation = np.rad2deg(elevation_rad)
    is_up = elevation >= -(_SUN_RADIUS_DEG + horizon_refraction_deg)
    with np.errstate(divide="ignore", invalid="ignore"):
        angle = np.deg2rad(elevation + 10.3 / (elevation + 5.11))
        lifted = pressure_hpa / 1010 * 283 / (273 + temperature_c) * 1.02 / (60 * np.tan(angle))
    return np.where(is_up, np.deg2rad(lifted), 0.0)


def _sum(series: tuple[FloatArray, ...], millennium: FloatArray) -> FloatArray:
    powers = [np.cos(b + np.multiply.outer(millennium, c)) @ a for a, b, c in (terms.T for terms in series)]
    total: FloatArray = polynomial.polyval(millennium, np.array(powers), tensor=False)
    return total


def _nutation(century: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return nutation in longitude and obliquity [rad]."""
    angles = np.deg2rad([polynomial.polyval(century, coefficients) for coefficients in _MOON_AND_SUN])
    argument = NUTATION[:, :5] @ angles
    a, b, c, d = (column[:, None] for column in NUTATION[:, 5:].T)
    longitude = ((a + b * century) * np.sin(argument)).sum(axis=0)
    obliquity = ((c + d * century) * np.cos(argument)).sum(axis=0)
    return np.deg2rad(longitude / 36e6), np.deg2rad(obliquity / 36e6)
