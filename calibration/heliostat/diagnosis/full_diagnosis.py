"""What is wrong with a heliostat or its records, judged from a fit and its residuals."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calibration.heliostat.diagnosis.findings import Diagnosis, Finding, ordered
from calibration.heliostat.diagnosis.hypotheses import REJECTED, hypothesis_finding, is_far
from calibration.heliostat.diagnosis.numbers import loosened_finding, number_findings
from calibration.heliostat.diagnosis.residual_terms import AS_STATED, Looked, residual_findings
from calibration.heliostat.diagnosis.rows import Records, explained_rows, outlier_finding, record_findings
from calibration.heliostat.fitting.fit_result import HeliostatFit
from calibration.heliostat.kinematic_model.design import PlaneTarget
from heliogauge.errors import InputError
from heliogauge.geometry.sun import Site

__all__ = ["Diagnosis", "Finding", "Records", "diagnose"]

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
    that explains less than 60 % of what is unexplained is a hint, no fault: real heliostats follow no rigid model to
    better than a milliradian of the beam. Unless, with the term, the rows scatter no more than their stated sigmas.
    """
    if not 0 < significance < 1:
        raise InputError(f"significance: a probability between 0 and 1 is needed, not {significance:g}")
    known = {} if targets is None else dict(targets)
    findings = record_findings(fit, records, known)
    stuck = any(one.kind == "constant_column" and one.severity == "fault" for one in findings)
    few = _too_few(fit)
    if few is not None or stuck:
        return Diagnosis(ordered([*findings, *([few] if few is not None else [])]), (), significance)
    numbers = number_findings(fit, significance / 2)
    images = _images(fit, records)
    if is_far(fit):
        return Diagnosis(ordered([*findings, *_of_far(fit, known, site, numbers)]), (), significance)
    if any(one.kind == "actuator_numbers" and one.rows for one in numbers):
        # Free numbers bend as far as they can: what is left shows nothing of rows or time.
        return Diagnosis(ordered([*findings, *numbers]), (), significance)
    explained_findings, explained = explained_rows(fit, known)
    looked = residual_findings(fit, known, site, significance / 2, explained)
    found = list(looked.findings)
    followed = _of_numbers(fit, looked, significance)
    if followed is not None:
        # Wrong numbers look like sag, scale or targets out of place.
        found = [followed]
        numbers = [one for one in numbers if one.kind != followed.kind]
    left = fit.rejected & ~explained & fit.residuals.computable & ~(looked.lengths < _UNDONE)
    outliers = outlier_finding(fit, left, images, () if records is None else records.ids)
    findings += [*numbers, *explained_findings, *found, *([outliers] if outliers is not None else [])]
    if fit.rejected.mean() > REJECTED and not any(one.severity == "fault" for one in [*found, *explained_findings]):
        findings.append(hypothesis_finding(fit, known, site)[0])
    return Diagnosis(ordered(findings), looked.checks, significance)


def _of_numbers(fit: HeliostatFit, looked: Looked, significance: float) -> Finding | None:
    """Follow numbers of which the residuals contradict what was known."""
    found = []
    for kind in ("position", "actuator_numbers"):
        doubted = [check for check in looked.checks if check.kind == kind]
        if any(check.chance * len(looked.checks) < significance for check in doubted):
            finding = loosened_finding(fit, kind)
            if finding is not None and not _much_better(looked, finding):
                found.append(finding)
    return max(found, key=lambda one: one.evidence["explained_share"], default=None)


def _much_better(looked: Looked, finding: Finding) -> bool:
    """Return whether a term explains all, or leaves less than half of what many other numbers leave."""
    faults = [one.evidence for one in looked.findings if one.severity == "fault"]
    if any(one["left_over_stated"] < AS_STATED for one in faults):
        return True
    shares = [one["explained_share"] for one in faults]
    return bool(shares) and 1 - max(shares) < 0.5 * (1 - finding.evidence["explained_share"])


def _of_far(
    fit: HeliostatFit, targets: Mapping[str, PlaneTarget], site: Site | None, numbers: list[Finding]
) -> list[Finding]:
    found, _ = hypothesis_finding(fit, targets, site)
    actuators = [one for one in numbers if one.kind == "actuator_numbers"]
    beyond = next((one for one in actuators if one.rows), None)
    if found.kind == "actuator_numbers" and beyond is not None:
        evidence = {**beyond.evidence, **found.evidence}
        return [replace(beyond, text=f"{beyond.text} {found.text}", evidence=evidence)]
    if found.kind == "unexplained" and actuators:
        # Readings that cannot be are more specific than that nothing fits.
        return actuators
    # What a wrong record did to the numbers is no finding of its own.
    return [found]


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
