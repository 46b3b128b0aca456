"""What a test gives: entries, doubts, tables of its rows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calibration.heliostat.performance.beam_series import BeamSeries, Estimate
from calibration.heliostat.performance.entries import Entry
from calibration.heliostat.performance.extremes import BOUND, CHANCE, largest_of
from calibration.heliostat.performance.wander import Wander
from heliogauge.doubts import Doubt


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What a test gives.

    entries: Lines of the data sheet.
    doubts: What makes them doubtful.
    tables: Rows by the name of their file, columns by name.
    """

    entries: tuple[Entry, ...]
    doubts: tuple[Doubt, ...] = ()
    tables: Mapping[str, Mapping[str, Sequence[Any]]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Maker:
    """Makes entries of one test.

    test: Its name.
    date, conditions, method: In words.
    """

    test: str
    date: str
    conditions: str
    method: str

    def entry(self, key: str, label: str, found: Estimate, note: str = "", method: str = "") -> Entry:
        """Return an entry of an estimate; a sigma that is not finite is none."""
        from math import isfinite

        sigma = found.sigma if isfinite(found.sigma) else None
        return Entry(
            self.test,
            key,
            label,
            found.value,
            sigma,
            found.degrees,
            method or self.method,
            self.date,
            self.conditions,
            note,
        )

    def none_seen(self, key: str, label: str, below: float, note: str, method: str = "") -> Entry:
        """Return an entry of what was looked for in vain; `below`: it is smaller than that, with 95 %."""
        return Entry(
            self.test,
            key,
            label,
            None,
            method=method or self.method,
            date=self.date,
            conditions=self.conditions,
            note=note,
            below=below,
        )

    def largest(self, key: str, label: str, series: BeamSeries) -> Entry:
        """Return the largest error of a series, or that none is larger than the noise of so many places."""
        found = largest_of(series.beam_rad, series.sigma_rad, series.sigma_common_rad)
        if not found.is_seen:
            return self.none_seen(
                key, label, found.below, f"{len(series)} places: noise alone gives the largest of them"
            )
        scaled = float(np.hypot(found.found.sigma, series.sigma_scale * found.found.value))
        return self.entry(key, label, Estimate(found.found.value, scaled))

    def drift(self, key: str, label: str, found: Wander) -> Entry:
        """Return the range of a cubic, or that none is seen."""
        if found.p_chance < CHANCE:
            return self.entry(key, label, found.drift)
        below = found.drift.value + BOUND * found.drift.sigma
        return self.none_seen(key, label, below, f"not different from none (chance {found.p_chance:.2g})")

    def missing(self, key: str, label: str, reason: str) -> Entry:
        """Return an entry without a value."""
        return Entry(
            self.test, key, label, None, None, method="", date=self.date, conditions=self.conditions, note=reason
        )
