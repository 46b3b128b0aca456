"""What several heliostats have in common: the same target, clock or day wrong is one finding of the field."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import comb

import numpy as np

from calibration.heliostat.diagnosis.findings import REMEDIES, Check, Diagnosis, Finding
from heliogauge.doubts import Doubt, Severity
from heliogauge.validate import FloatArray

#: What a heliostat says of a target or of the clock, and what others on it must confirm.
_OF_TARGETS = ("target_place", "target_scale", "mirrored_spots")
#: What is wrong with a whole table or site is wrong for all that are in it.
_OF_TABLES = ("sun_convention", "site", "units", "target_names_exchanged", "swapped_axes", "half_turn", "inverted_axis")
_OF_DAYS = ("change_point", "episode")
# Opinions agree within three sigmas, or within this share of what is meant: models differ by as much.
_SIGMAS, _SHARE = 3.0, 0.5
# Clocks agree within a minute, or within a tenth: what a model leaves of a real heliostat moves it by as much.
_SAME_CLOCK_S, _CLOCK_SHARE = 60.0, 0.1
# Days that would agree by chance more often than this are no common day.
_BY_CHANCE = 0.01
# Campaigns are compared over a year at least.
_YEAR_DAYS = 365.0


@dataclass(frozen=True, slots=True, eq=False)
class FieldFinding:
    """One thing that is wrong for several heliostats.

    kind: As that of the heliostats' findings.
    text: The finding in one sentence.
    heliostats: Whom it concerns.
    chance: Probability of as much by chance; NaN where it is no matter of chance.
    """

    kind: str
    text: str
    heliostats: tuple[str, ...]
    chance: float = float("nan")

    @property
    def doubt(self) -> Doubt:
        """The finding as a doubt of the field."""
        count = len(self.heliostats)
        names = ", ".join(self.heliostats[:8]) + (f" and {count - 8} more" if count > 8 else "")
        sure = f" (chance {self.chance:.1g})" if np.isfinite(self.chance) else ""
        text = f"{self.text}, for {count} heliostats ({names}){sure}. {REMEDIES[self.kind]}"
        return Doubt("field_finding", text, {"heliostats_count": count}, Severity.SERIOUS)


@dataclass(frozen=True, slots=True, eq=False)
class FieldJudgement:
    """What came of comparing the heliostats of a field.

    findings: Of the field.
    changed: Diagnoses of heliostats that read otherwise beside the others, by name; their findings stand where they
        stood.
    """

    findings: tuple[FieldFinding, ...]
    changed: Mapping[str, Diagnosis]


def judge_field(diagnoses: Mapping[str, Diagnosis]) -> FieldJudgement:
    """Compare the diagnoses of the heliostats of a field.

    diagnoses: By the names of the heliostats.
    Returns: What several share, and what others do not confirm: a target that is out of place for one heliostat alone,
        while others that would see it do not, is a doubt of that one.
    """
    changes: dict[str, dict[int, Finding]] = {}
    findings = [
        *_targets(diagnoses, changes),
        *_clocks(diagnoses, changes),
        *_tables(diagnoses, changes),
        *_days(diagnoses, changes),
    ]
    changed = {}
    for name, new in changes.items():
        old = diagnoses[name]
        listed = [new.get(place, finding) for place, finding in enumerate(old.findings)]
        changed[name] = replace(old, findings=tuple(listed))
    return FieldJudgement(tuple(findings), changed)


_Changes = dict[str, dict[int, Finding]]


def _accused(diagnoses: Mapping[str, Diagnosis], kinds: Sequence[str]) -> list[tuple[str, int, Finding]]:
    """Return the faults of some kinds: heliostat, place among its findings, finding."""
    return [
        (name, place, finding)
        for name, diagnosis in diagnoses.items()
        for place, finding in enumerate(diagnosis.findings)
        if finding.severity == "fault" and finding.kind in kinds
    ]


def _share(changes: _Changes, members: Sequence[tuple[str, int, Finding]]) -> None:
    """Make findings of heliostats part of one of the field."""
    count = len({name for name, _, _ in members})
    for name, place, finding in members:
        text = f"{finding.text} The same is wrong for {count - 1} other heliostats: a finding of the field."
        changes.setdefault(name, {})[place] = replace(finding, severity="field", text=text)


def _opinions(diagnoses: Mapping[str, Diagnosis], kind: str, subject: str) -> dict[str, Check]:
    """Return what each heliostat says of a target (or of all of them)."""
    term = "target_scale" if kind == "mirrored_spots" else kind
    return {
        name: check
        for name, diagnosis in diagnoses.items()
        for check in diagnosis.checks
        if check.kind == term and check.name == subject and check.values.size
    }


def _agrees(one: Check, value: FloatArray) -> bool:
    limit = np.maximum(_SIGMAS * one.sigmas, _SHARE * float(np.linalg.norm(value)))
    return bool((np.abs(one.values - value) <= limit).all())


def _targets(diagnoses: Mapping[str, Diagnosis], changes: _Changes) -> list[FieldFinding]:
    accused = _accused(diagnoses, _OF_TARGETS)
    findings = []
    subjects = dict.fromkeys((finding.kind, finding.subject) for _, _, finding in accused)
    for kind, subject in subjects:
        own = [one for one in accused if (one[2].kind, one[2].subject) == (kind, subject)]
        said = _opinions(diagnoses, kind, subject)
        values = [said[name].values for name, _, _ in own if name in said]
        if not values:
            continue
        value = np.median(values, axis=0)
        size = float(np.linalg.norm(value))
        names = {name for name, _, _ in own}
        could = [name for name, one in said.items() if name not in names and size > _SIGMAS * float(one.sigmas.max())]
        agree = [name for name in could if _agrees(said[name], value)]
        together = sorted(names | set(agree))
        if len(together) >= 2 and (len(agree) >= 0.5 * len(could)):
            amount = ", ".join(f"{one:+.2f}" for one in value)
            what = "m to the right and up" if kind == "target_place" else "of width and height"
            findings.append(FieldFinding(kind, f"{subject}: off by {amount} {what}", tuple(together)))
            _share(changes, own)
        elif could:
            for name, place, finding in own:
                text = (
                    f"{finding.text} {len(could) - len(agree)} of {len(could)} other heliostats that would see it do "
                    "not: it is open what is wrong."
                )
                changes.setdefault(name, {})[place] = replace(finding, severity="doubt", text=text)
    return findings


def _clocks(diagnoses: Mapping[str, Diagnosis], changes: _Changes) -> list[FieldFinding]:
    left = _accused(diagnoses, ("time_offset",))
    findings = []
    while left:
        seconds = left[0][2].evidence.get("offset_s", np.nan)
        sigma = left[0][2].evidence.get("sigma_offset_s", 0.0)
        same = [
            one
            for one in left
            if abs(one[2].evidence.get("offset_s", np.nan) - seconds)
            <= max(
                _SAME_CLOCK_S,
                _CLOCK_SHARE * abs(seconds),
                _SIGMAS * np.hypot(sigma, one[2].evidence.get("sigma_offset_s", 0.0)),
            )
        ]
        left = [one for one in left[1:] if not any(one is other for other in same)]
        if len(same) >= 2:
            middle = float(np.median([one[2].evidence["offset_s"] for one in same]))
            names = tuple(name for name, _, _ in same)
            findings.append(FieldFinding("time_offset", f"The clock: {middle:+.0f} s have to be added", names))
            _share(changes, same)
    return findings


def _tables(diagnoses: Mapping[str, Diagnosis], changes: _Changes) -> list[FieldFinding]:
    accused = _accused(diagnoses, _OF_TABLES)
    findings = []
    for kind, subject in dict.fromkeys((one.kind, one.subject) for _, _, one in accused):
        same = [one for one in accused if (one[2].kind, one[2].subject) == (kind, subject)]
        if len(same) >= 2 and subject:
            findings.append(FieldFinding(kind, subject, tuple(name for name, _, _ in same)))
            _share(changes, same)
    return findings


def _days(diagnoses: Mapping[str, Diagnosis], changes: _Changes) -> list[FieldFinding]:
    """Find days on which several heliostats changed: so many in windows this narrow are no chance."""
    accused = [one for one in _accused(diagnoses, _OF_DAYS) if one[2].dates]
    if len(accused) < 2:
        return []
    windows = np.array([(one[2].dates[0], one[2].dates[-1]) for one in accused], dtype="datetime64[D]").astype(np.int64)
    whole = float(windows.max() - windows.min()) + 1
    findings = []
    left = list(range(len(accused)))
    while left:
        counts = [sum(windows[b, 0] <= windows[a, 0] <= windows[b, 1] for b in left) for a in left]
        day = windows[left[int(np.argmax(counts))], 0]
        same = [b for b in left if windows[b, 0] <= day <= windows[b, 1]]
        names = tuple(dict.fromkeys(accused[b][0] for b in same))
        widths = sorted(float(windows[b, 1] - windows[b, 0]) + 1 for b in same)
        # The first window may be anywhere; each other must lie over it.
        overlaps = [min(1.0, (width + widths[0]) / max(whole, _YEAR_DAYS)) for width in widths[1:]]
        chance = min(1.0, comb(len(accused), len(same)) * float(np.prod(overlaps))) if overlaps else 1.0
        if len(names) >= 2 and chance < _BY_CHANCE:
            kind = accused[same[0]][2].kind
            said = f"About {np.datetime64(int(day), 'D')} the level of the axes changed"
            findings.append(FieldFinding(kind, said, names, chance))
            _share(changes, [accused[b] for b in same])
        left = [b for b in left if b not in same]
    return findings
