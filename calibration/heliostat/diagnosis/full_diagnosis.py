"""What is wrong with a heliostat or its records, judged from a fit and its residuals."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calibration.heliostat.diagnosis.evidence import Explanation, log_evidences
from calibration.heliostat.diagnosis.findings import Diagnosis, Finding, coefficients_of, ordered
from calibration.heliostat.diagnosis.hypotheses import (
    FAR_RAD,
    REJECTED,
    hypothesis_finding,
    is_far,
    mirrored_finding,
    site_finding,
)
from calibration.heliostat.diagnosis.kinds import contradiction_finding
from calibration.heliostat.diagnosis.misfit import ODDS_OF_A_FAULT, criterion, effective_components
from calibration.heliostat.diagnosis.numbers import Loosened, loosened_finding, number_findings
from calibration.heliostat.diagnosis.residual_terms import Looked, residual_findings
from calibration.heliostat.diagnosis.rivals import STRONG
from calibration.heliostat.diagnosis.rows import (
    Records,
    explained_rows,
    newest_finding,
    outlier_finding,
    record_findings,
)
from calibration.heliostat.fitting.fit_result import HeliostatFit
from calibration.heliostat.kinematic_model.design import PlaneTarget
from heliogauge.errors import InputError
from heliogauge.geometry.sun import Site
from heliogauge.validate import FloatArray

__all__ = ["Diagnosis", "Finding", "Records", "diagnose"]

#: With fewer rows than this nothing is a fault that records alone do not show: freed numbers explain as much.
FEW_ROWS = 20
# What is wrong with single rows or days shows once the whole is mended; what that model lacks is no further fault.
_OF_ROWS = ("episode", "wrong_target", "outliers")
# What is said of single rows, whichever kind of observation they are.
_OF_SINGLE_ROWS = ("wrong_target", "outliers")
# What the records show by themselves, whatever the heliostat.
_OF_RECORDS = ("duplicates", "constant_column", "units")
#: Faults of heliostat or records as a whole, which can be undone by calculation.
REMEDIED = (
    *("actuator_numbers", "position", "sun_convention", "site", "time_offset", "units"),
    *("swapped_axes", "inverted_axis", "half_turn", "mirrored_spots", "target_names_exchanged"),
)
# What decides where numbers and terms explain the same.
_DECIDES = {
    "actuator_numbers": "The type plates of the actuators decide, or their strokes measured at a known reading.",
    "position": "A survey of the heliostat's place decides.",
}
# What numbers of an actuator that are not its own look like while they are held.
_LIKE_ACTUATORS = {"sag", "scale", "time_offset", "refraction", "target_scale", "worm_gear"}
#: A heliostat with fewer spare components than this cannot be distinguished from a faulty one.
_FEWEST_SPARE = 8
# A rejected row is no outlier any more where a fault's term brings it back within this [sigma].
_UNDONE = 4.0


def diagnose(
    fit: HeliostatFit,
    *,
    targets: Mapping[str, PlaneTarget] | None = None,
    site: Site | None = None,
    records: Records | None = None,
    significance: float = 0.01,
) -> Diagnosis:
    """Judge a heliostat and its records.

    targets: Targets by name; without, names and places of targets are not questioned.
    site: Where the plant is; without, times are not questioned.
    records: Verdicts, photos and times of all rows of the table.
    significance: Chance that a healthy heliostat gets any finding.
    Returns: Findings, the gravest first, and all that was looked at.
    InputError: `significance` is no probability.

    In this order, because each step would be misled by what the one before it finds: readings and columns that cannot
    be; records that are wrong as a whole, where the fit is far off; rows that are right when read otherwise; terms in
    the residuals of the rest; what is left of the outliers. The chance is shared between numbers and residuals, and
    there by Bonferroni's bound between all terms, dates and periods. A term whose significance is beyond doubt but
    that smooth errors of sound heliostats may pass for is a hint, no fault: real heliostats follow no rigid model to
    better than a milliradian of the beam.
    """
    if not 0 < significance < 1:
        raise InputError(f"significance: a probability between 0 and 1 is needed, not {significance:g}")
    known = {} if targets is None else dict(targets)
    found = _diagnosed(fit, known, site, records, significance)
    if found.remedied is not None:
        behind = _diagnosed(found.remedied, known, site, records, significance)
        kinds = {one.kind for one in found.findings}
        more = [one for one in behind.findings if one.kind in _OF_ROWS and one.kind not in kinds]
        found = replace(found, findings=(*found.findings, *more))
    rows = int((fit.used | fit.rejected).sum())
    apart = contradiction_finding(fit, significance)
    listed = found.findings if apart is None else [_while_apart(one) for one in found.findings]
    findings = ordered([_by_few(one, rows) for one in listed])
    if apart is not None:
        # What all else rests on is said first.
        findings = (_by_few(apart, rows), *findings)
    # What is not decided is not undone.
    sure = any(one.severity == "fault" and one.kind in REMEDIED for one in findings)
    return replace(found, findings=findings, remedied=found.remedied if sure else None)


def _by_few(finding: Finding, rows: int) -> Finding:
    """Return a finding as so many rows allow it."""
    if rows >= FEW_ROWS or finding.severity != "fault" or finding.kind in _OF_RECORDS:
        return finding
    text = f"{finding.text} {rows} rows are too few to decide it: {FEW_ROWS} are needed."
    return replace(finding, severity="doubt", text=text)


def _while_apart(finding: Finding) -> Finding:
    """Return a finding as it stands while kinds of observation contradict each other."""
    if finding.severity != "fault" or finding.kind in (*_OF_RECORDS, *_OF_SINGLE_ROWS):
        return finding
    text = f"{finding.text} It is open, because kinds of observation contradict each other."
    return replace(finding, severity="doubt", text=text)


def _diagnosed(
    fit: HeliostatFit,
    known: dict[str, PlaneTarget],
    site: Site | None,
    records: Records | None,
    significance: float,
) -> Diagnosis:
    findings = record_findings(fit, records, known)
    stuck = any(one.kind == "constant_column" and one.severity == "fault" for one in findings)
    few = _too_few(fit)
    if few is not None or stuck:
        return Diagnosis(ordered([*findings, *([few] if few is not None else [])]), (), significance)
    numbers = number_findings(fit, significance / 2)
    images = _images(fit, records)
    if is_far(fit):
        far = _of_far(fit, known, site, numbers, significance)
        return Diagnosis(ordered([*findings, *far.findings]), (), significance, far.remedied)
    if any(one.kind == "actuator_numbers" and one.rows for one in numbers):
        # Free numbers bend as far as they can: what is left shows nothing of rows or time.
        return Diagnosis(ordered([*findings, *numbers]), (), significance)
    explained_findings, explained = explained_rows(fit, known)
    looked = residual_findings(fit, known, site, significance / 2, explained)
    mirrored = mirrored_finding(fit, known, looked, ODDS_OF_A_FAULT * significance / 2) if known else None
    of_time = next((one for one in looked.findings if (one.kind, one.severity) == ("time_offset", "fault")), None)
    elsewhere = None if mirrored is not None or of_time is None or site is None else site_finding(fit, site, of_time)
    whole = mirrored or elsewhere
    if whole is not None:
        # What records that are wrong as a whole did to rows and numbers is no finding of its own.
        return Diagnosis(ordered([*findings, whole[0]]), looked.checks, significance, whole[1])
    decided = _decided(fit, looked, _followed(fit, looked, significance))
    found = decided.findings
    if decided.remedied is not None:
        numbers = [one for one in numbers if one.kind != found[0].kind]
    left, undone = fit.rejected & ~explained & fit.residuals.computable, looked.lengths < _UNDONE
    if any(one.severity == "fault" for one in looked.findings):
        left &= ~undone
    newest = newest_finding(fit, left)
    if newest is not None:
        left &= ~np.isin(fit.observations.row, newest.rows)
    # All are counted; those that a hint brings back accuse nobody.
    outliers = outlier_finding(fit, left, images, () if records is None else records.ids, accusing=left & ~undone)
    findings += [*numbers, *explained_findings, *found]
    findings += [one for one in (newest, outliers) if one is not None]
    if fit.rejected.mean() > REJECTED and not any(one.severity == "fault" for one in [*found, *explained_findings]):
        found_by_trial, remedied = hypothesis_finding(fit, known, site)
        return Diagnosis(ordered([*findings, found_by_trial]), looked.checks, significance, remedied)
    return Diagnosis(ordered(findings), looked.checks, significance, decided.remedied)


def _followed(fit: HeliostatFit, looked: Looked, significance: float) -> list[Loosened]:
    """Follow numbers of which the residuals contradict what was known, or that a term may imitate."""
    faults = {one.kind for one in looked.blamed}
    found = []
    for kind in ("position", "actuator_numbers"):
        doubted = [check for check in looked.checks if check.kind == kind]
        imitated = kind == "actuator_numbers" and bool(faults & _LIKE_ACTUATORS)
        if imitated or any(check.chance * len(looked.checks) < significance for check in doubted):
            loosened = loosened_finding(fit, kind)
            found += [loosened] if loosened is not None else []
    return found


class _Decided(NamedTuple):
    """What the residuals show once it is decided between terms and numbers, and the fit with other numbers."""

    findings: list[Finding]
    remedied: HeliostatFit | None = None


def _decided(fit: HeliostatFit, looked: Looked, numbers: list[Loosened]) -> _Decided:
    """Decide by their probability between terms and numbers that explain the same, or say all that it may be.

    numbers: That explain the residuals; wrong ones look like sag, scale or targets out of place.
    """
    kinds = {one.finding.kind for one in numbers}
    terms = tuple(one for one in looked.blamed if one.kind not in kinds)
    said = [[one.finding] for one in numbers]
    explanations = [Explanation(one.fit, one.names) for one in numbers]
    if terms:
        said.append([one for one in looked.findings if one.severity == "fault" and one.kind not in kinds])
        explanations.append(Explanation(fit, terms=terms))
    if not numbers:
        return _Decided(list(looked.findings))
    logs = log_evidences(explanations, fit.nominal) if len(explanations) > 1 else np.zeros(1)
    best = int(np.argmax(logs))
    behind = 2 * (logs[best] - logs)
    likely = [k for k in np.argsort(behind, kind="stable").tolist() if behind[k] <= STRONG]
    if len(likely) == 1 and best < len(numbers):
        return _Decided(said[best], numbers[best].fit)
    if len(likely) == 1:
        return _Decided(list(looked.findings))
    rest = [one for one in looked.findings if one.severity != "fault"]
    return _Decided([*(_open(one, said, likely, behind) for k in likely for one in said[k]), *rest])


def _open(finding: Finding, said: list[list[Finding]], likely: list[int], behind: FloatArray) -> Finding:
    """Return a fault as a doubt, beside what may be wrong instead.

    likely: Which of what is said it may be, the most probable first.
    behind: Twice the logarithm of how much less probable each is than the most probable.
    """
    names = [" and ".join(dict.fromkeys(one.kind.replace("_", " ") for one in said[k])) for k in likely]
    odds = " : ".join(f"{np.exp(-behind[k] / 2):.2g}" for k in likely)
    deciding = " ".join(dict.fromkeys(_DECIDES[one.kind] for k in likely for one in said[k] if one.kind in _DECIDES))
    text = f"{finding.text} It is open which it is, {' or '.join(names)} (odds {odds}). {deciding}"
    evidence = {**finding.evidence, "twice_log_odds": float(behind[likely[1]])}
    return replace(finding, severity="doubt", text=text, evidence=evidence)


def _spare(fit: HeliostatFit) -> float:
    return float(max(int(fit.observations.n_components.sum()) - fit.n_free, 1))


def _of_far(
    fit: HeliostatFit,
    targets: Mapping[str, PlaneTarget],
    site: Site | None,
    numbers: list[Finding],
    significance: float,
) -> "_Far":
    found, remedied = hypothesis_finding(fit, targets, site)
    actuators = [one for one in numbers if one.kind == "actuator_numbers"]
    beyond = next((one for one in actuators if one.rows), None)
    if beyond is None:
        none = np.zeros(len(fit.observations), dtype=np.bool_)
        terms = [
            one for one in residual_findings(fit, targets, site, significance / 2, none).findings if _is_grave(one)
        ]
        before = found.evidence["median_before_mrad"]
        # Where no hypothesis helps, a term must bring the heliostat as near as one would have to.
        after = found.evidence.get("median_after_mrad", 1e3 * FAR_RAD)
        count, is_open = effective_components(_spare(fit)), found.kind == "unexplained"
        theirs = criterion((after / before) ** 2, found.evidence.get("freed_count", 0.0), count)
        own = (
            criterion(1 - one.evidence["explained_share"], 0 if is_open else coefficients_of(one), count)
            for one in terms
        )
        if min(own, default=np.inf) < theirs:
            # One term of a drive or of time explains as much as a hypothesis about everything.
            return _Far(terms)
    if found.kind == "actuator_numbers" and beyond is not None:
        evidence = {**beyond.evidence, **found.evidence}
        text = f"{beyond.text} {found.text}"
        return _Far([replace(beyond, text=text, evidence=evidence, chance=found.chance)], remedied)
    if found.kind == "unexplained" and actuators:
        # Readings that cannot be are more specific than that nothing fits.
        return _Far(actuators)
    # What a wrong record did to the numbers is no finding of its own.
    return _Far([found], remedied)


class _Far(NamedTuple):
    """What is found where a fit ends far from its observations, and the fit without the fault."""

    findings: list[Finding]
    remedied: HeliostatFit | None = None


def _is_grave(finding: Finding) -> bool:
    return finding.severity == "fault"


def _images(fit: HeliostatFit, records: Records | None) -> tuple[str, ...]:
    if records is None:
        return ("",) * len(fit.observations)
    return tuple(records.images[row] for row in fit.observations.row.tolist())


def _too_few(fit: HeliostatFit) -> Finding | None:
    count = int(fit.used.sum())
    components = int(fit.observations.n_components[fit.used].sum())
    decided = fit.rank
    # Far from its observations a fit weighs them so little that they decide nothing: not for want of them.
    prior_only = fit.n_free > 0 and decided == 0 and not is_far(fit)
    if components - decided >= _FEWEST_SPARE and not prior_only:
        return None
    what = (
        "the answer is what was known beforehand"
        if prior_only or components <= fit.n_free
        else "nothing is left to judge it by"
    )
    text = f"{count} usable observations for {fit.n_free} free numbers: {what}."
    evidence = {"observations_count": float(count), "free_count": float(fit.n_free), "rank_count": float(decided)}
    return Finding("too_few", "doubt", text, evidence, rows=tuple(fit.observations.row[np.asarray(fit.used)].tolist()))
