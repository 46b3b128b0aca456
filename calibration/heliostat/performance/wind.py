"""Wind classes of heliostats and the beam accuracy that each asks for (Stage-STE 12.6, 1.1, table 1).

The report gives ranges of the mean wind at 10 m within which a plant sets its own limits. Here the upper ends are the
default: up to 8 m/s full operation with 3 mrad of the beam, up to 14 m/s operation with 5 mrad, beyond it no operation.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.validate import IntArray, float_array


@dataclass(frozen=True, slots=True)
class WindClass:
    """A class of wind.

    name: As the report calls it.
    meaning: What a heliostat does in it.
    most_m_s: Largest mean wind at 10 m [m/s].
    beam_limit_rad: Accuracy of the beam asked for; None: none [rad].
    """

    name: str
    meaning: str
    most_m_s: float
    beam_limit_rad: float | None


def wind_classes(full_m_s: float = 8.0, reduced_m_s: float = 14.0, stow_m_s: float = 22.0) -> tuple[WindClass, ...]:
    """Return the classes of a plant.

    full_m_s, reduced_m_s: Largest wind of full operation and of operation with reduced accuracy [m/s].
    stow_m_s: Wind at which a heliostat must have left operation [m/s].
    InputError: They do not ascend.
    """
    if not 0 < full_m_s < reduced_m_s < stow_m_s:
        raise InputError(
            f"wind classes: {full_m_s:g}, {reduced_m_s:g} and {stow_m_s:g} m/s must ascend from above zero"
        )
    return (
        WindClass("W1.1", "full operation", full_m_s, 3e-3),
        WindClass("W1.2", "reduced accuracy", reduced_m_s, 5e-3),
        WindClass("W2", "leaving operation", stow_m_s, None),
        WindClass("W3/W4", "survival", float("inf"), None),
    )


def class_of_wind(wind_m_s: npt.ArrayLike, classes: tuple[WindClass, ...]) -> IntArray:
    """Return the class of each mean wind: its place among the classes, -1 where the wind is not known.

    Shapes: result (n,).
    wind_m_s (n,): Mean wind at 10 m; NaN: not known [m/s].
    InputError: Wind below zero or above 90 m/s (in km/h?).
    """
    wind = float_array("wind_m_s", wind_m_s, (None,), finite=False)
    known = np.isfinite(wind)
    if (wind[known] < 0).any() or (wind[known] > 90).any():
        raise InputError(
            f"wind_m_s: {wind[known].min():g} to {wind[known].max():g}: 0 to 90 m/s are needed (km/h are 3.6 times)"
        )
    ends = np.array([one.most_m_s for one in classes])
    return np.where(known, np.searchsorted(ends, np.where(known, wind, 0.0)), -1)
