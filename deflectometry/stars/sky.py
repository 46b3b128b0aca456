"""Where the stars stand: directions in the field's frame (east, north, up) from a catalogue, time and place."""

from dataclasses import dataclass

import numpy as np

from heliogauge.errors import InputError
from heliogauge.files.extras import of_extra
from heliogauge.geometry.sun import Site
from heliogauge.validate import BoolArray, FloatArray, IntArray

#: Below, refraction changes by more than 0.05 mrad with the weather.
_LOWEST_RAD = np.radians(10.0)
#: Wavelength at which cameras see stars best [um]; refraction differs by 0.5 % between 0.45 and 0.65.
_WAVELENGTH_UM = 0.55
#: Year of the catalogue's places.
_EPOCH_JD = 2448349.0625
_RAD_PER_MAS = np.pi / (180 * 3600e3)


@dataclass(frozen=True, slots=True, eq=False)
class Catalogue:
    """Stars of the Hipparcos catalogue, the new reduction (van Leeuwen 2007), at epoch 1991.25 in the ICRS.

    number (n,): HIP numbers. right_ascension_rad, declination_rad (n,): Places.
    motion_ra, motion_dec (n,): Proper motions [rad/year]; that in right ascension without its cosine.
    parallax_as (n,): Parallaxes [arc second]. magnitude (n,): Hp magnitudes.
    """

    number: IntArray
    right_ascension_rad: FloatArray
    declination_rad: FloatArray
    motion_ra: FloatArray
    motion_dec: FloatArray
    parallax_as: FloatArray
    magnitude: FloatArray

    def brighter(self, magnitude: float) -> "Catalogue":
        """Return the stars up to a magnitude."""
        kept = self.magnitude <= magnitude
        return Catalogue(*(getattr(self, name)[kept] for name in self.__slots__))


@dataclass(frozen=True, slots=True, eq=False)
class StarsAbove:
    """Stars above the horizon at one instant.

    number (n,): HIP numbers. directions (n, 3): Unit vectors, east, north, up, as seen through the air.
    magnitude (n,): Hp magnitudes, dimmed by the air.
    """

    number: IntArray
    directions: FloatArray
    magnitude: FloatArray

    def chosen(self, which: BoolArray) -> "StarsAbove":
        """Return some of the stars."""
        return StarsAbove(self.number[which], self.directions[which], self.magnitude[which])


def stars_above(catalogue: Catalogue, time: np.datetime64, site: Site) -> StarsAbove:
    """Return the stars that stand 10 degrees and more above the horizon.

    time: Instant in UTC.
    InputError: pyerfa is not installed.

    ERFA's ``apco13``, ``atciq``, ``atioq`` (the SOFA routines of the IAU): proper motion, parallax, aberration, light
    deflection, precession and nutation (IAU 2006/2000A), the Earth's rotation, refraction. UT1 - UTC is taken as zero:
    below 0.9 s it turns the sky by at most 0.066 mrad about the pole, and every normal by half of that.
    """
    erfa = of_extra("erfa")
    unix = float(time.astype("datetime64[ms]").astype(np.int64)) / 1e3
    utc1, utc2 = 2440587.5, unix / 86400.0
    # The catalogue's epoch is 1991.25; atciq moves stars from 2000.0: carried there first.
    to_2000 = (2451545.0 - _EPOCH_JD) / 365.25
    astrometry, _ = erfa.apco13(
        utc1,
        utc2,
        0.0,
        np.radians(site.longitude_deg),
        np.radians(site.latitude_deg),
        site.altitude_m,
        0.0,
        0.0,
        site.air_pressure_hpa,
        site.temperature_c,
        0.3,
        _WAVELENGTH_UM,
    )
    right, up_angle = erfa.atciq(
        catalogue.right_ascension_rad + to_2000 * catalogue.motion_ra,
        catalogue.declination_rad + to_2000 * catalogue.motion_dec,
        catalogue.motion_ra,
        catalogue.motion_dec,
        np.maximum(catalogue.parallax_as, 0.0),
        0.0,
        astrometry,
    )
    azimuth, zenith, *_ = erfa.atioq(right, up_angle, astrometry)
    elevation = 0.5 * np.pi - np.asarray(zenith)
    up = elevation >= _LOWEST_RAD
    azimuth, elevation = np.asarray(azimuth)[up], elevation[up]
    level = np.cos(elevation)
    directions = np.stack([level * np.sin(azimuth), level * np.cos(azimuth), np.sin(elevation)], axis=1)
    # Two tenths of a magnitude for each mass of air.
    return StarsAbove(catalogue.number[up], directions, catalogue.magnitude[up] + 0.2 / np.sin(elevation))


def parse_catalogue(content: bytes) -> Catalogue:
    """Read the fixed columns of ``hip2.dat`` (CDS I/311).

    InputError: Lines of another length than the catalogue's.
    """
    lines = content.splitlines()
    if not lines or len(lines[0]) < 160:
        raise InputError("the star catalogue is not hip2.dat of CDS I/311")
    table = np.array(lines)
    letters = table.view("S1").reshape(len(lines), -1)

    def column(first: int, last: int) -> FloatArray:
        """Return the numbers in columns first to last, counted from 1."""
        cut = np.ascontiguousarray(letters[:, first - 1 : last]).view(f"S{last - first + 1}").ravel()
        return np.asarray(cut.astype(np.float64))

    declination = column(30, 42)
    motion_dec = column(61, 68) * _RAD_PER_MAS
    motion_ra = column(52, 59) * _RAD_PER_MAS / np.cos(declination)
    return Catalogue(
        column(1, 6).astype(np.intp),
        column(16, 28),
        declination,
        motion_ra,
        motion_dec,
        1e-3 * column(44, 50),
        column(130, 136),
    )
