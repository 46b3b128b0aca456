"""The suns of one day, from sunrise to sunset."""

import datetime
from dataclasses import dataclass

import numpy as np

from heliogauge.errors import InputError
from heliogauge.geometry.sun import Site, sun_directions
from heliogauge.validate import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SunsOfDay:
    """Directions to the sun at even times of a day.

    times_utc length n: Such as ``2026-06-21T10:00:00Z``.
    suns (n, 3): Directions to the sun.
    """

    times_utc: tuple[str, ...]
    suns: FloatArray

    @classmethod
    def of(cls, date: datetime.date, step_minutes: float, site: Site) -> "SunsOfDay":
        """Collect the suns of a day of the place, not of Greenwich's.

        step_minutes: Step [min].
        InputError: A step that cannot be, or the sun does not rise.
        """
        if not 0.1 <= step_minutes <= 240:
            raise InputError(f"step_minutes={step_minutes:g}: between 0.1 and 240 minutes are needed")
        noon = np.datetime64(f"{date}T12:00:00", "ms") - np.timedelta64(int(site.longitude_deg * 240_000), "ms")
        half = int(720 / step_minutes)
        step = np.timedelta64(round(step_minutes * 60_000), "ms")
        times = noon.astype("datetime64[m]").astype("datetime64[ms]") + np.arange(-half, half + 1) * step
        suns = sun_directions(times, site)
        up = suns[:, 2] > 0
        if not up.any():
            raise InputError(f"date={date}: the sun does not rise there on that day")
        return cls(tuple(f"{time}Z" for time in times[up].astype("datetime64[s]")), np.asarray(suns[up]))
