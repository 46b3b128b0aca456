"""Numbers of a heliostat that differ from those given."""

from collections.abc import Sequence
from dataclasses import replace
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from calibration.heliostat.diagnosis.findings import Finding, Severity, dates_of
from calibration.heliostat.diagnosis.terms import actuator_names
from calibration.heliostat.fitting.fit_result import FitOptions, HeliostatFit
from calibration.heliostat.fitting.observability import plausible_scales
from calibration.heliostat.fitting.priors import prior_sigma
from calibration.heliostat.fitting.robust_fit import fit as refit
from calibration.heliostat.kinematic_model.design import POSITION
from heliogauge.errors import EstimationError
from heliogauge.validate import BoolArray, FloatArray

#: A number this many prior sigmas away was not drawn from that prior, whatever a model's misfit adds to it.
FAR_SIGMAS = 6.0
#: From here on it is reported.
TOLD_SIGMAS = 3.5
#: Other numbers are a fault when they explain this share of what is unexplained: of six healthy real heliostats they
#: explain 6 % (actuators) and 18 % (place) at most, of wrong strokes by 6 mm 45 % beside wind of 0.3 mrad.
NUMBERS_EXPLAIN = {"actuator_numbers": 0.25, "position": 0.35}
#: Priors are loosened by this factor to see where the numbers go.
LOOSE = 100.0
# A row's share in what is unexplained is cut here [sigma].
_CUT = 5.0
#: The findings in words.
DEPARTED = {
    "actuator_numbers": "The actuators' numbers are not those given",
    "position": "The heliostat does not stand at its stated place",
    "nominal_angles": "Angles are far from nominal",
}
# Readings beyond an actuator's geometry: single ones can be slips of the log.
_FEW_BEYOND, _SHARE_BEYOND = 3, 0.02


def number_findings(fit: HeliostatFit, significance: float) -> list[Finding]:
    """Judge fitted numbers against the nominal ones.

    significance: Chance that a heliostat whose numbers come from its priors gets any finding.
    Returns: One for the actuators, one for the place, one for other angles, as far as there is something.
    """
    findings = _beyond(fit)
    names, moved, prior, chance = _departures(fit)
    if not names:
        return findings
    chance = np.minimum(chance * len(names), 1.0)
    clear = chance < significance
    clear &= np.abs(moved) > TOLD_SIGMAS * prior
    far: BoolArray = np.asarray(clear & (np.abs(moved) > FAR_SIGMAS * prior))
    groups = {"actuator_numbers": actuator_names(fit.design), "position": POSITION}
    listed = {name for group in groups.values() for name in group}
    groups["nominal_angles"] = tuple(name for name in names if name not in listed and _unit(fit, name) == "rad")
    for kind, members in groups.items():
        own = np.array([name in members for name in names], dtype=np.bool_)
        if not (clear & own).any() or any(one.kind == kind for one in findings):
            continue
        # Angles that are not as drawn are what a calibration is for: reported, not accused.
        grave = bool((far & own).any()) and kind != "nominal_angles"
        shown = np.flatnonzero(own & (far if grave else clear))
        shown = shown[np.argsort(-np.abs(moved[shown] / prior[shown]))]
        findings.append(_finding(fit, kind, "fault" if grave else "hint", [names[i] for i in shown], chance[shown]))
    return findings


class Loosened(NamedTuple):
    """A fault of numbers, the fit that leaves them free, and their names."""

    finding: Finding
    fit: HeliostatFit
    names: tuple[str, ...]


def loosened_finding(fit: HeliostatFit, kind: str) -> Loosened | None:
    """Fit again without the priors of the actuators or the place, and judge where the numbers go.

    fit: A fit whose residuals contradict these priors.
    Returns: A fault, if they explain it and leave their priors far behind.

    A wrong stroke of some millimetres turns the axis by tens of milliradians: a linear look at the residuals of a fit
    that is held by its priors does not find the way there.
    """
    parameters = fit.nominal.parameters
    members = actuator_names(fit.design) if kind == "actuator_numbers" else POSITION
    # What the fit held is known as well as is usual.
    usual = {name: prior_sigma(fit.nominal, name) for name in members if name in parameters.names}
    priors = {name: sigma for name, sigma in usual.items() if 0 < sigma < np.inf}
    names = list(priors)
    if not names:
        return None
    parameters = parameters.with_sigmas(priors)
    wide = parameters.with_sigmas({name: LOOSE * sigma for name, sigma in priors.items()})
    try:
        other = refit(fit.nominal.with_parameters(wide), fit.observations, FitOptions(restarts=0))
    except EstimationError:
        return None
    before, after = (np.minimum(one.residuals.lengths / fit.factor, _CUT) for one in (fit, other))
    share = 1 - float(after @ after) / max(float(before @ before), 1e-300)
    shifts = (other.values - parameters.values)[parameters.indices(names)]
    prior = parameters.sigmas[parameters.indices(names)]
    # With 95 %: of few rows more is asked.
    spare = max(int(fit.observations.n_components.sum()) - fit.n_free, 1)
    surely = 1 - (1 - share) * (1 + 2 * np.sqrt(2 / spare))
    if surely < NUMBERS_EXPLAIN[kind] or not (np.abs(shifts) > FAR_SIGMAS * prior).any():
        return None
    order = np.argsort(-np.abs(shifts / prior))
    compared = replace(other, nominal=fit.nominal.with_parameters(parameters))
    # The bound of Markov on the likelihood ratio.
    chance = np.array([np.exp(0.5 * spare * np.log(max(1 - share, 1e-300)))])
    found = _finding(compared, kind, "fault", [names[i] for i in order], chance)
    evidence = {**found.evidence, "explained_share": share}
    text = f"{found.text[:-1]}; this explains {100 * share:.0f} % of what is unexplained."
    return Loosened(replace(found, evidence=evidence, text=text), other, tuple(names))


class _Departures(NamedTuple):
    """Free parameters, their shifts from nominal, what could be wrong of them, and the chance of such shifts."""

    names: list[str]
    moved: FloatArray
    prior: FloatArray
    chance: FloatArray


def _departures(fit: HeliostatFit) -> _Departures:
    parameters = fit.nominal.parameters
    free = np.flatnonzero(parameters.free)
    names = [parameters.names[i] for i in free]
    moved = fit.values[free] - parameters.values[free]
    stated = parameters.sigmas[free]
    scales = plausible_scales(parameters.values[free], names, [parameters.units[i] for i in free])
    prior = np.where(np.isfinite(stated), stated, scales)
    # The shift of a number that really comes from its prior has the variance that the observations took away.
    own = np.sqrt(np.maximum(prior**2 - fit.sigma[free] ** 2, (0.1 * prior) ** 2))
    chance = np.array([2 * NormalDist().cdf(-abs(value)) for value in (moved / own).tolist()])
    # Without a prior nothing can be contradicted, short of the impossible.
    chance = np.where(np.isfinite(stated) | (np.abs(moved) > FAR_SIGMAS * prior), chance, 1.0)
    return _Departures(names, moved, prior, chance)


def _unit(fit: HeliostatFit, name: str) -> str:
    return fit.design.parameters.units[fit.design.parameters.index(name)]


def _beyond(fit: HeliostatFit) -> list[Finding]:
    """Find readings that the actuators as given cannot have."""
    from calibration.heliostat.kinematic_model.kinematics import mirror_poses

    seen = fit.observations
    poses = mirror_poses(fit.nominal, fit.nominal.parameters.values, seen.readings, seen.approach, outside="nan")
    lost = ~np.isfinite(poses.rotation.sum(axis=(1, 2)))
    count = int(lost.sum())
    if count < max(_FEW_BEYOND, _SHARE_BEYOND * len(lost)):
        return []
    text = (
        f"The triangle of an actuator does not close at {count} of {len(lost)} readings: its numbers (stroke, offset, "
        "pivot radius, increment) are not this heliostat's."
    )
    evidence = {"readings_beyond_count": float(count), "readings_count": float(len(lost))}
    rows = tuple(seen.row[lost].tolist())
    return [Finding("actuator_numbers", "fault", text, evidence, rows=rows, dates=dates_of(seen.time[lost]))]


def _finding(fit: HeliostatFit, kind: str, severity: Severity, names: Sequence[str], chances: FloatArray) -> Finding:
    evidence, parts = {}, []
    nominal = fit.nominal.parameters
    for name in names[:4]:
        index = nominal.index(name)
        shift, sigma = float(fit.values[index] - nominal.values[index]), float(fit.sigma[index])
        unit, stated = nominal.units[index], float(nominal.sigmas[index])
        evidence[f"{name}_shift"], evidence[f"{name}_sigma"] = shift, sigma
        evidence[f"{name}_prior_sigma"] = stated
        factor, shown = {"rad": (1e3, "mrad"), "m": (1e3, "mm")}.get(unit, (1.0, unit))
        known = f", {abs(shift) / stated:.0f} prior sigmas" if np.isfinite(stated) else ""
        parts.append(f"{name} {factor * shift:+.3g} +- {factor * sigma:.2g} {shown}{known}")
    return Finding(kind, severity, f"{DEPARTED[kind]}: {'; '.join(parts)}.", evidence, float(chances.min()))
