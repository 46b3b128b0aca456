"""Closed forms for sizing a field and its control (Malan 2014, chapter 3)."""

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.geometry.sun import angles_from_direction
from heliogauge.validate import FloatArray, float_array, positive

#: Turn of the earth [rad/s].
_EARTH_RAD_S = 2 * np.pi / 86_400
#: Mirror area for each MW of two plants: Sierra SunTower without storage, Gemasolar with 15 hours [m^2/MW].
AREA_WITHOUT_STORAGE, AREA_WITH_STORAGE, STORAGE_H = 27_670 / 5, 304_750 / 19.9, 15.0


def intercept_of_discs(error_rad: npt.ArrayLike, half_width_rad: float) -> FloatArray:
    """Return the share of an even round beam that meets an equal round target, over the tracking error of the normal.

    error_rad (n,): Tracking error of the normal [rad].
    half_width_rad: Angular radius of beam and target over two: of the normal, as the error [rad].
    Returns (n,): Between 0 and 1.

    Two equal circles of radius ``2 R b`` whose centres are ``2 R e`` apart (Malan 2014, 3.2 and 3.3). The thesis takes
    ``b = sun / 2 + slope``; an image of radius ``R (sun / 2 + 2 slope)`` has ``b = sun / 4 + slope``.

    >>> float(100 * intercept_of_discs([0.75e-3], 9.3e-3 / 2 + 1.5e-3)[0]).__round__(2)
    92.24
    >>> float(100 * intercept_of_discs([0.75e-3], 9.3e-3 / 4 + 1.5e-3)[0]).__round__(2)
    87.54
    """
    radius = positive("half_width_rad", half_width_rad, "radians")
    apart = np.minimum(np.abs(float_array("error_rad", error_rad, (None,))) / (2 * radius), 1.0)
    return np.asarray(2 / np.pi * (np.arccos(apart) - apart * np.sqrt(1 - apart**2)))


def mirror_area_m2_per_mw(storage_h: float) -> float:
    """Return the mirror area that a tower plant needs for each MW, by its hours of storage (Malan 2014, 3.1).

    InputError: Hours outside 0 to 15, between the two plants that it rests on.

    >>> round(mirror_area_m2_per_mw(7.0))
    10098
    """
    if not 0 <= storage_h <= STORAGE_H:
        raise InputError(f"storage_h = {storage_h:g}: 0 to {STORAGE_H:g} hours are needed")
    return AREA_WITHOUT_STORAGE + storage_h * (AREA_WITH_STORAGE - AREA_WITHOUT_STORAGE) / STORAGE_H


def control_interval_s(allowed_rad: float) -> float:
    """Return how long drives may stand still until the sun has moved by an angle [s].

    >>> round(control_interval_s(1e-3), 2)
    13.75
    """
    return positive("allowed_rad", allowed_rad, "radians") / _EARTH_RAD_S


def clear_sky_dni(suns: FloatArray) -> FloatArray:
    """Return direct irradiance under a clear sky (Meinel and Meinel 1976; air mass of Kasten and Young 1989).

    Shapes: result (n,).
    suns (n, 3): Directions to the sun.
    Returns (n,): Zero below the horizon [W/m^2].
    """
    elevation = angles_from_direction(suns)[1]
    degrees = np.degrees(np.maximum(elevation, 0.0))
    mass = 1 / (np.sin(np.radians(degrees)) + 0.50572 * (degrees + 6.07995) ** -1.6364)
    return np.where(elevation > 0, 1353.0 * 0.7 ** (mass**0.678), 0.0)
