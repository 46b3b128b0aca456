"""Findings of a diagnosis with evidence, the rows they concern, and what to do."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np

from calibration.heliostat.fitting.fit_result import HeliostatFit
from heliogauge import doubts
from heliogauge.doubts import Doubt
from heliogauge.validate import FloatArray, TimeArray

#: How a finding stands to the heliostat: it or its records as a whole are wrong ("fault"), single rows were wrong and
#: are left out ("rows"), something may be wrong but sound heliostats show as much ("hint"), the
#: observations are too few to decide ("doubt"), or the same is wrong for several heliostats ("field").
Severity: TypeAlias = Literal["fault", "rows", "hint", "doubt", "field"]

#: What to do about each kind.
#: Rows that fit otherwise by chance less often than this are a fault of the records.
SURE = 0.01
#: Kinds whose remedy changes what was recorded.
_OF_RECORDS = ("wrong_target", "target_names_exchanged", "units")
REMEDIES: Mapping[str, str] = {
    "actuator_numbers": "Compare the actuators' numbers with the type plate and with other units of the same type.",
    "position": "Survey the heliostat's place again, and check that the row of the table is this heliostat's.",
    "nominal_angles": "Check offsets and tilts in the table of heliostats; if they are right, widen their prior sigma.",
    "sun_convention": "Convert the sun's azimuth to 0 = north, clockwise (degrees) before the calibration.",
    "time_offset": "Correct the times, or state their zone; check the clock of the camera or of the controller.",
    "refraction": "Give apparent (refracted) elevations of the sun, refracted once.",
    "site": "Check the site: latitude is positive in the north, longitude in the east (degrees).",
    "swapped_axes": "Exchange the columns of axis 1 and axis 2.",
    "inverted_axis": "Turn the sign of this axis' readings (of a linear actuator: its sense of rotation).",
    "half_turn": "Count this axis' angles from where the model does: azimuths are 0 in the north, clockwise.",
    "mirrored_spots": "Turn the sign: x runs right, y up, as seen from the field; check the azimuth the target faces.",
    "wrong_target": "Correct the target's name in these rows.",
    "target_names_exchanged": "Exchange the names of these targets.",
    "target_place": "Survey this target's centre again.",
    "target_scale": "Check the target's width and height (the scale of the photos).",
    "change_point": "Calibrate with the rows after the change only, and ask what was done on that date.",
    "episode": "Ask what was done on these dates; the rows are left out, before and after them nothing changed.",
    "drift": "Calibrate more often, use the latest rows only, and look at foundation, drives and references.",
    "backlash": "Free the backlash of this axis and record the direction of the last move, or approach from one side.",
    "worm_gear": "Free the periodic error of this axis with this period.",
    "sag": "Free the sag of this axis.",
    "scale": "Free the scale of this axis' readings, or check its gear ratio.",
    "outliers": "Look at the photos and logs of these rows; they are left out of the fit.",
    "units": "Convert these rows to the column's unit.",
    "duplicates": "Record each measurement once; repeats are left out.",
    "constant_column": "Check that the column is recorded.",
    "too_few": "Measure more, at other positions of the sun; until then the answer is what was known beforehand.",
    "unexplained": "Check the input: readings, sun, targets and numbers do not fit together in any known way.",
}


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """One thing that is, or may be, wrong with a heliostat or its records.

    kind: A key of `REMEDIES`.
    severity: How it stands to the heliostat.
    text: The finding in one sentence, with its numbers.
    evidence: Numbers with their unit in the name.
    chance: Probability of as much by chance, all looks counted; NaN where it is no matter of chance.
    rows: Rows of the observations' table concerned; empty where it is all of them.
    dates: Their dates, each once.
    images: Their photos, as far as known.
    subject: Which target, axis or thing it is about, where there are several.
    """

    kind: str
    severity: Severity
    text: str
    evidence: Mapping[str, float]
    chance: float = float("nan")
    rows: tuple[int, ...] = ()
    dates: tuple[str, ...] = ()
    images: tuple[str, ...] = ()
    subject: str = ""

    @property
    def remedy(self) -> str:
        """What to do, in one sentence."""
        if self.kind in _OF_RECORDS and self.chance >= SURE:
            return "It may be chance: look at the photos of these rows before their records are changed."
        return REMEDIES[self.kind]

    @property
    def significance(self) -> str:
        """How sure it is, in words."""
        if not np.isfinite(self.chance):
            return "no matter of chance"
        return "chance below 1e-15" if self.chance < 1e-15 else f"chance {self.chance:.1g}"

    @property
    def doubt(self) -> Doubt:
        """The finding as a doubt: its kind is the code."""
        weight = doubts.Severity.SERIOUS if self.severity == "fault" else doubts.Severity.DOUBT
        return Doubt(
            self.kind, f"{self.text.removesuffix('.')} ({self.significance}). {self.remedy}", self.evidence, weight
        )

    def content(self) -> dict[str, Any]:
        """Return the finding as JSON has it."""
        return {
            "kind": self.kind,
            "severity": self.severity,
            "text": self.text,
            "evidence": {name: _plain(value) for name, value in self.evidence.items()},
            "chance": _plain(self.chance),
            "significance": self.significance,
            "rows": list(self.rows),
            "dates": list(self.dates),
            "images": list(self.images),
            "remedy": self.remedy,
            "subject": self.subject,
        }

    @classmethod
    def from_content(cls, content: Mapping[str, Any]) -> "Finding":
        """Return a finding from what `content` returned."""
        return cls(
            content["kind"],
            content["severity"],
            content["text"],
            {name: _number(value) for name, value in content["evidence"].items()},
            _number(content["chance"]),
            tuple(content["rows"]),
            tuple(content["dates"]),
            tuple(content["images"]),
            content["subject"],
        )


@dataclass(frozen=True, slots=True, eq=False)
class Check:
    """One look at the residuals.

    kind, name: What was looked for: the kind of term, and which one.
    chance: Probability of as much by chance in this look alone.
    explained: Share of the residuals' variance that it explains; NaN where it was not significant.
    values, sigmas (q,): What the residuals say of its coefficients, significant or not; for targets and clock, which
        other heliostats can confirm; else empty.
    """

    kind: str
    name: str
    chance: float
    explained: float = float("nan")
    values: FloatArray = field(default_factory=lambda: np.empty(0))
    sigmas: FloatArray = field(default_factory=lambda: np.empty(0))

    def content(self) -> dict[str, Any]:
        """Return the check as JSON has it."""
        found: dict[str, Any] = {
            "name": f"{self.kind}: {self.name}",
            "chance": _plain(self.chance),
            "explained_share": _plain(self.explained),
        }
        if self.values.size:
            found |= {"values": self.values.tolist(), "sigmas": self.sigmas.tolist()}
        return found

    @classmethod
    def from_content(cls, content: Mapping[str, Any]) -> "Check":
        """Return a check from what `content` returned."""
        kind, _, name = content["name"].partition(": ")
        values, sigmas = (np.array(content.get(key, ()), dtype=np.float64) for key in ("values", "sigmas"))
        return cls(kind, name, _number(content["chance"]), _number(content["explained_share"]), values, sigmas)


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """What is wrong with a heliostat, and what was looked at.

    findings: Faults first.
    checks: All looks at the residuals, significant or not.
    significance: Chance that a healthy heliostat gets any finding that is a matter of chance.
    remedied: The fit with the remedy of the fault that is wrong with heliostat or records as a whole; None where there
        is no such fault, or nothing that can be undone by calculation.
    """

    findings: tuple[Finding, ...]
    checks: tuple[Check, ...]
    significance: float
    remedied: HeliostatFit | None = None

    @property
    def faults(self) -> tuple[Finding, ...]:
        """Findings that accuse the heliostat or its records."""
        return tuple(one for one in self.findings if one.severity == "fault")

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of the faults."""
        return tuple(one.kind for one in self.faults)

    @property
    def named(self) -> tuple[str, ...]:
        """Kinds of the faults, and of what is not decided with a question mark, each once."""
        marks = {"fault": "", "field": "", "doubt": "?"}
        named = (one for one in self.findings if one.severity in marks)
        # That there are too few observations is decided.
        return tuple(dict.fromkeys(one.kind + (marks[one.severity] if one.kind != "too_few" else "") for one in named))

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """Faults, wrong rows and doubts, with their remedy."""
        return tuple(one.doubt for one in self.findings if one.severity != "hint")

    def content(self) -> dict[str, Any]:
        """Return the diagnosis as JSON has it."""
        return {
            "findings": [one.content() for one in self.findings],
            "checks": [one.content() for one in self.checks],
            "significance": self.significance,
        }

    @classmethod
    def from_content(cls, content: Mapping[str, Any]) -> "Diagnosis":
        """Return a diagnosis from what `content` returned; the fit with a remedy is not part of it."""
        findings = tuple(Finding.from_content(one) for one in content["findings"])
        return cls(findings, tuple(Check.from_content(one) for one in content["checks"]), content["significance"])


def coefficients_of(finding: Finding) -> int:
    """Return how many coefficients a term in the residuals has: each has a sigma."""
    return sum(name.startswith("sigma_") for name in finding.evidence)


_ORDER = {"fault": 0, "field": 1, "rows": 2, "doubt": 3, "hint": 4}


def ordered(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return findings with the gravest first."""
    return tuple(sorted(findings, key=lambda one: _ORDER[one.severity]))


def dates_of(times: TimeArray) -> tuple[str, ...]:
    """Return the dates of times, each once; unknown times are passed over."""
    known = np.unique(times[~np.isnat(times)].astype("datetime64[D]"))
    return tuple(str(day) for day in known)


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)


def _plain(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
