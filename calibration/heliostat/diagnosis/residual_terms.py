"""Looks at a fit's residuals for terms that do not belong there, the clearest first, each explained before the next."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.heliostat.diagnosis.bounds import MIRRORED, beyond_text, is_mirrored, is_physical, prior_of
from calibration.heliostat.diagnosis.drift import date_range, in_time, jumped
from calibration.heliostat.diagnosis.findings import Check, Finding, Severity, dates_of
from calibration.heliostat.diagnosis.linear_model import Extension, LinearFit, linear_fit
from calibration.heliostat.diagnosis.numbers import DEPARTED, FAR_SIGMAS
from calibration.heliostat.diagnosis.rivals import Rival, rival_of
from calibration.heliostat.diagnosis.terms import Term, Terms, approaches
from calibration.heliostat.fitting.fit_result import HeliostatFit
from calibration.heliostat.kinematic_model.design import PlaneTarget
from heliogauge.adjust.chi_square import chi_square_cdf
from heliogauge.geometry.sun import Site
from heliogauge.validate import BoolArray, FloatArray, TimeArray

#: A term is a fault when it explains at least this share of what the model leaves unexplained. Real heliostats keep
#: about 1 mrad of the beam that no rigid model has; any smooth term explains some of it, with great significance.
EXPLAINS = 0.6
#: For jumps and drifts, which have a date or several angles to choose: of six healthy real heliostats a drift explains
#: up to 51 % of what a rigid model leaves; a jump of 4 mrad explains over 90 %.
EXPLAINS_IN_TIME = 0.7
#: Terms that other heliostats can confirm.
CONFIRMED = ("target_place", "target_scale", "time_offset")
#: Terms of time.
IN_TIME = ("change_point", "drift", "episode")
#: A term is a fault, too, when with it the rows scatter by no more than this times their stated sigmas, and it is much
#: likelier than chance: then there is no misfit that it could be mistaken for.
AS_STATED = 1.15
#: Nothing else makes a scale of -1: beams steered to the middle are moved little by it, and it explains less of all.
_MIRRORED_EXPLAINS = 0.4
_MUCH_LIKELIER, _SOMETHING = 20.0, 0.3
# Corners in photos err by 0.5 % together, in clean photos more than all else; 1 % is 0.1 mrad at 100 m, 1 m off centre.
_SCALE_FAULT = 0.01
# Priors are loosened so far to see whether they are what is wrong.
_WIDE = 100.0
#: So many faults of one heliostat are looked for.
_MOST_FAULTS = 3


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """The best look for a term."""

    term: Term
    index: int
    statistics: FloatArray
    chance: float
    clear: float


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """Rows, what is left of them, and the terms to look for in it."""

    rows: BoolArray
    model: LinearFit
    terms: list[Term]
    maker: Terms

    def without(self, kind: str) -> "_Group":
        """Return the same without the terms of a kind."""
        return replace(self, terms=[term for term in self.terms if term.kind != kind])


@dataclass(frozen=True, slots=True, eq=False)
class Looked:
    """What the residuals show.

    findings: At most three faults, and one hint.
    checks: All looks of the first round.
    lengths (n,): Length of each row's residual once the faults are explained [sigma]; NaN for rows that were not
        looked at.
    """

    findings: tuple[Finding, ...]
    checks: tuple[Check, ...]
    lengths: FloatArray


def residual_findings(
    fit: HeliostatFit, targets: Mapping[str, PlaneTarget], site: Site | None, significance: float, excluded: BoolArray
) -> Looked:
    """Look for terms in the residuals of a fit.

    site: Where the plant is, for the sky's rotation.
    significance: Chance of any finding with a healthy heliostat.
    excluded (n,): Rows that are known to be wrong.
    """
    groups = _candidates(fit, targets, site, fit.residuals.computable & ~excluded)
    count = max(sum(len(group.terms) for group in groups), 1)
    findings: list[Finding] = []
    checks: list[Check] = []
    for turn in range(_MOST_FAULTS):
        looks = [(group, look) for group in groups for look in _looks(group.model, group.terms)]
        if turn == 0:
            checks = [_check(group.model, look) for group, look in looks]
        clear = [pair for pair in looks if pair[1].chance * count < significance]
        if not clear:
            break
        # The clearest may be part of something larger: the first that explains most of it is taken.
        clear.sort(key=lambda pair: -pair[1].clear)
        clear = [(group, _closer(group.model, look)) for group, look in clear]
        tried = (_tried(fit, group, look) for group, look in clear)
        found = next((one for one in tried if one.severity != "hint"), None)
        if found is None and findings:
            break
        found = found or _tried(fit, *clear[0])
        chance = min(found.look.chance * count, 1.0)
        findings.append(_finding(fit, found, chance))
        if turn == 0:
            checks = [_explained(check, found.look, found.extension) for check in checks]
        if found.severity == "hint":
            break
        if found.severity == "doubt":
            # What is open may be something else: the others are looked at without it.
            groups = [group.without(found.look.term.kind) for group in groups]
            continue
        # Where rows without a time stand apart the others no longer speak for the same heliostat.
        groups = [replace(found.group, model=found.extension.model)]
    return Looked(tuple(findings), tuple(checks), _lengths(fit, groups))


@dataclass(frozen=True, slots=True, eq=False)
class _Tried:
    """A term that was adjusted, and what it is worth.

    rival: What explains the same without time; None for terms that are not of time.
    """

    group: _Group
    look: _Look
    extension: Extension
    severity: Severity
    rival: Rival | None = None


def _tried(fit: HeliostatFit, group: _Group, look: _Look) -> _Tried:
    """Adjust a term and judge it: a fault, open, or a hint."""
    extension = _extended(fit, group, look)
    if not _is_fault(fit, group, look, extension):
        return _Tried(group, look, extension, "hint")
    if look.term.kind not in IN_TIME:
        return _Tried(group, look, extension, "fault")
    rival = rival_of(group.model, group.maker, extension, len(look.statistics))
    severity: Severity = "fault" if rival.is_decided else "doubt" if rival.is_open else "hint"
    return _Tried(group, look, extension, severity, rival)


def _extended(fit: HeliostatFit, group: _Group, look: _Look) -> Extension:
    """Adjust a term; what priors hold stays within a hundred times of them, all else within its physical bounds."""
    columns = look.term.columns[look.index]
    if look.term.kind in ("actuator_numbers", "position"):
        return group.model.extended(columns, np.full(columns.shape[1], _WIDE))
    judged = look.term.voting
    if look.term.kind == "backlash":
        judged = (approaches(fit.observations)[group.rows] != 0).any(axis=1)
    return group.model.extended(columns, prior_of(look.term.kind, columns.shape[1]), judged=judged)


def _is_fault(fit: HeliostatFit, group: _Group, look: _Look, extension: Extension) -> bool:
    if not is_physical(look.term.kind, extension.coefficients, extension.sigmas):
        return False
    if look.term.kind == "target_scale" and is_mirrored(extension.coefficients, extension.sigmas):
        return extension.explained > _MIRRORED_EXPLAINS
    before = group.model.scale * float(np.median(fit.factor))
    complete = before > AS_STATED > left_over(fit, extension) and look.clear > _MUCH_LIKELIER
    complete = complete and extension.explained > _SOMETHING
    if not complete and extension.surely < (EXPLAINS_IN_TIME if look.term.kind in IN_TIME else EXPLAINS):
        return False
    if look.term.kind == "target_scale":
        return bool(np.abs(extension.coefficients).max() >= _SCALE_FAULT)
    if look.term.kind not in ("actuator_numbers", "position"):
        return True
    return bool((np.abs(_shifts(fit, look.term, extension.coefficients)) > FAR_SIGMAS).any())


def left_over(fit: HeliostatFit, extension: Extension) -> float:
    """Return the scatter of the rows over their stated sigmas once a term is explained."""
    return extension.model.scale * float(np.median(fit.factor))


def _shifts(fit: HeliostatFit, term: Term, coefficients: FloatArray) -> FloatArray:
    """Return shifts of numbers from nominal in prior sigmas."""
    own = fit.nominal.parameters.indices(term.names)
    return np.asarray(
        (fit.values - fit.nominal.parameters.values)[own] / fit.nominal.parameters.sigmas[own] + coefficients
    )


def _lengths(fit: HeliostatFit, groups: Sequence[_Group]) -> FloatArray:
    lengths = np.full(len(fit.observations), np.nan)
    for group in groups:
        lengths[group.rows] = group.model.lengths() / group.model.scale
    return lengths


def _candidates(
    fit: HeliostatFit, targets: Mapping[str, PlaneTarget], site: Site | None, rows: BoolArray
) -> list[_Group]:
    """Return models and the terms to look for: rows without a time are left out where time matters."""
    timed = rows & ~np.isnat(fit.observations.time)
    terms = Terms(fit, rows)
    steady = [*terms.numbers(), *terms.drives(), *terms.sun(site), *terms.targets(targets)]
    if timed.all() or (timed == rows).all():
        return [_Group(rows, linear_fit(fit, rows), steady + in_time(terms), terms)]
    found = [_Group(rows, linear_fit(fit, rows), steady, terms)]
    if timed.sum() >= 8:
        of_time = Terms(fit, timed)
        found.append(_Group(timed, linear_fit(fit, timed), in_time(of_time), of_time))
    return found


def _looks(model: LinearFit, terms: Sequence[Term]) -> list[_Look]:
    found = []
    for term in terms:
        statistics, freedom = model.scores(term.columns)
        chances = np.array(
            [
                1 - chi_square_cdf(float(one), int(free)) if free else 1.0
                for one, free in zip(statistics, freedom, strict=True)
            ]
        )
        # Where chances are zero to rounding the statistic decides.
        index = int(np.lexsort((statistics, -chances))[-1])
        chance = min(float(chances[index]) * len(statistics), 1.0)
        # As the Bayesian information criterion weighs terms of different size against each other.
        rows = max(model.count, 2)
        clear = float(statistics[index]) - int(freedom[index]) * np.log(2 * rows) - 2 * np.log(len(statistics))
        found.append(_Look(term, index, statistics, chance, clear))
    return found


def _closer(model: LinearFit, look: _Look) -> _Look:
    """Look again about the best number of a term; what was significant stays so."""
    term = look.term
    if term.columns_at is None or len(term.at) < 2:
        return look
    # Two steps to either side: the steps miss a period by a sixth of a cycle at most, noise by a little more.
    at = term.at[look.index] + np.linspace(-2, 2, 41) * (term.at[1] - term.at[0])
    at = at[at > 0]
    finer = replace(term, columns=term.columns_at(at), at=at)
    statistics, _ = model.scores(finer.columns)
    return replace(look, term=finer, index=int(np.argmax(statistics)), statistics=statistics)


def _check(model: LinearFit, look: _Look) -> Check:
    if look.term.kind not in CONFIRMED:
        return Check(look.term.kind, look.term.name, look.chance)
    found = model.estimate(look.term.columns[look.index])
    return Check(look.term.kind, look.term.name, look.chance, float("nan"), found.values, found.sigmas)


def _explained(check: Check, look: _Look, extension: Extension) -> Check:
    same = (check.kind, check.name) == (look.term.kind, look.term.name)
    return replace(check, explained=extension.explained) if same else check


def _finding(fit: HeliostatFit, tried: _Tried, chance: float) -> Finding:
    look, extension, severity = tried.look, tried.extension, tried.severity
    term, values, sigmas = look.term, extension.coefficients, extension.sigmas
    evidence: dict[str, float] = {
        "explained_share": extension.explained,
        "left_over_stated": left_over(fit, extension),
        "statistic": float(look.statistics.max()),
    }
    for name, value, sigma in zip(term.names, values.tolist(), sigmas.tolist(), strict=True):
        evidence[name] = value
        evidence[f"sigma_{name}"] = sigma
    rows: tuple[int, ...] = ()
    dates: tuple[str, ...] = ()
    times = fit.observations.time
    if term.kind in ("actuator_numbers", "position"):
        values = _shifts(fit, term, values)
        said = _numbers_text(fit, term, values, evidence)
    elif term.kind == "change_point":
        before, after = date_range(term.at, look.statistics, times)
        said = f"Between {before} and {after} the angles jumped: {jumped(term.names, values, sigmas)}"
        dates = (str(before), str(after))
        late = ~np.isnat(times) & (times.astype("datetime64[D]") >= after)
        rows = tuple(fit.observations.row[late].tolist())
    elif term.kind == "episode":
        first, after = term.spans[look.index]
        inside = ~np.isnat(times) & (times >= first) & (times < after)
        levels = jumped(term.names, values, sigmas)
        said = f"{_during(times[inside])} the level of the axes was another and came back: {levels}"
        rows, dates = tuple(fit.observations.row[inside].tolist()), dates_of(times[inside])
    elif term.kind == "drift":
        said = f"The angles drift, per year: {jumped(term.names, values, sigmas)}"
    else:
        said = _sentence(term, look, values, sigmas, evidence)
    if term.kind == "target_place":
        mine = np.array([f"target {name}" == term.name for name in fit.observations.label], dtype=np.bool_)
        rows, dates = tuple(fit.observations.row[mine].tolist()), dates_of(times[mine])
    share = f"; this explains {100 * extension.explained:.0f} % of what is unexplained"
    if tried.rival is not None:
        evidence["rival_explained_share"] = tried.rival.explained
        evidence["evidence_for_time"] = tried.rival.evidence
        share += f"; {tried.rival.text}"
    beyond = beyond_text(term.kind, term.names, values, sigmas)
    share += f"; {beyond}" if beyond else ""
    mirrored = term.kind == "target_scale" and float(values.max()) > MIRRORED[0]
    kind = "mirrored_spots" if mirrored else term.kind
    return Finding(kind, severity, f"{said}{share}.", evidence, chance, rows, dates, subject=term.name)


def _during(times: TimeArray) -> str:
    """Name the first and the last day of times."""
    first, last = (str(one.astype("datetime64[D]")) for one in (times.min(), times.max()))
    return f"On {first}" if first == last else f"From {first} to {last}"


def _numbers_text(fit: HeliostatFit, term: Term, shifts: FloatArray, evidence: dict[str, float]) -> str:
    parameters = fit.nominal.parameters
    order = np.argsort(-np.abs(shifts))[:3]
    parts = []
    for i in order.tolist():
        name, prior = term.names[i], parameters.sigma(term.names[i])
        shift = float(shifts[i]) * prior
        evidence[f"{name}_shift"] = shift
        factor, unit = {"rad": (1e3, "mrad"), "m": (1e3, "mm")}.get(parameters.units[parameters.index(name)], (1.0, ""))
        parts.append(f"{name} {factor * shift:+.3g} {unit} ({abs(float(shifts[i])):.0f} prior sigmas)")
    return f"{DEPARTED[term.kind]}: {', '.join(parts)}"


def _sentence(term: Term, look: _Look, values: FloatArray, sigmas: FloatArray, evidence: dict[str, float]) -> str:
    if term.kind == "backlash":
        plays = ", ".join(f"{1e3 * v:.2f} +- {1e3 * g:.2f} mrad" for v, g in zip(values, sigmas, strict=True))
        return f"{term.name}: the beam depends on the direction of the last move, play {plays}"
    size, sigma = float(np.hypot(*values)) if values.size == 2 else float(values[0]), float(np.max(sigmas))
    where = term.name
    if term.kind == "worm_gear":
        evidence["cycles_per_turn_or_m"] = float(term.at[look.index])
        return (
            f"{where}: a periodic error of {1e3 * size:.2f} +- {1e3 * sigma:.2f} mrad, about "
            f"{term.at[look.index]:.3g} cycles per turn (per metre of a spindle)"
        )
    if term.kind == "sag":
        return f"{where}: bending that follows the angle, {1e3 * size:.2f} +- {1e3 * sigma:.2f} mrad"
    if term.kind == "scale":
        return f"{where}: readings are {100 * size:+.3g} +- {100 * sigma:.2g} % off in scale"
    if term.kind == "time_offset":
        return f"Times are wrong: {size:+.1f} +- {sigma:.1f} s have to be added"
    if term.kind == "refraction":
        return f"{size:+.2f} +- {sigma:.2f} times the refraction is missing in the sun's elevations"
    if term.kind == "target_place":
        right, up = values.tolist()
        return f"{where} stands {right:+.3f} m to the right and {up:+.3f} m up (+- {sigma:.3f} m) of its stated place"
    width, height = values.tolist()
    turned = [name for name, share in (("left and right", width), ("up and down", height)) if share > MIRRORED[0]]
    if turned:
        return f"Spots on the targets are mirrored {' and '.join(turned)}"
    return (
        f"Spots on the targets have to be stretched by {100 * width:+.1f} % and {100 * height:+.1f} % "
        f"(+- {100 * sigma:.2g} %)"
    )
