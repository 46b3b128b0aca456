"""What a test gives: entries, doubts, tables of its rows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from calibration.heliostat.performance.beam_series import Estimate
from calibration.heliostat.performance.entries import Entry
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

    def missing(self, key: str, label: str, reason: str) -> Entry:
        """Return an entry without a value."""
        return Entry(
            self.test, key, label, None, None, method="", date=self.date, conditions=self.conditions, note=reason
        )
