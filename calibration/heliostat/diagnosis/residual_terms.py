"""Looks at a fit's residuals for terms that do not belong there, the clearest first, each explained before the next."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.heliostat.diagnosis.bounds import beyond_text, is_physical, prior_of
from calibration.heliostat.diagnosis.drift import date_range, in_time, jumped
from calibration.heliostat.diagnosis.evidence import BlamedTerm
from calibration.heliostat.diagnosis.findings import Check, Finding, Severity, dates_of
from calibration.heliostat.diagnosis.linear_model import Extension, LinearFit, linear_fit
from calibration.heliostat.diagnosis.misfit import ODDS_OF_A_FAULT, chance_in_sound
from calibration.heliostat.diagnosis.numbers import DEPARTED, FAR_SIGMAS
from calibration.heliostat.diagnosis.rivals import Rival, rival_of
from calibration.heliostat.diagnosis.terms import Term, Terms, approaches
from calibration.heliostat.fitting.fit_result import HeliostatFit
from calibration.heliostat.kinematic_model.design import PlaneTarget
from heliogauge.adjust.chi_square import chi_square_cdf
from heliogauge.geometry.sun import Site
from heliogauge.validate import BoolArray, FloatArray, IntArray, TimeArray

#: Terms that other heliostats can confirm.
CONFIRMED = ("target_place", "target_scale", "time_offset")
#: Terms of time.
IN_TIME = ("change_point", "drift", "episode")
# Corners in photos err by 0.5 % together, in clean photos more than all else; 1 % is 0.1 mrad at 100 m, 1 m off centre.
_SCALE_FAULT = 0.01
# Priors are loosened so far to see whether they are what is wrong.
_WIDE = 100.0
#: So many faults of one heliostat are looked for.
_MOST_FAULTS = 3


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """The best look for a term.

    looks: Among how many it was chosen.
    freedom: Coefficients that the observations determine.
    chance: Of as much by scatter alone, all looks counted.
    clear: As the Bayesian information criterion weighs it against other terms.
    """

    term: Term
    index: int
    statistics: FloatArray
    looks: int
    freedom: int
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
    lengths (n,): Length of each row's residual once faults and hint are explained [sigma]; NaN for rows that were
        not looked at.
    model: What was left of the rows before anything was explained.
    terms: Makes terms of the same rows.
    blamed: The terms that are faults.
    """

    findings: tuple[Finding, ...]
    checks: tuple[Check, ...]
    lengths: FloatArray
    model: LinearFit
    terms: Terms
    blamed: tuple[BlamedTerm, ...]


def residual_findings(
    fit: HeliostatFit, targets: Mapping[str, PlaneTarget], site: Site | None, significance: float, excluded: BoolArray
) -> Looked:
    """Look for terms in the residuals of a fit.

    site: Where the plant is, for the sky's rotation.
    significance: Chance of any finding with a healthy heliostat.
    excluded (n,): Rows that are known to be wrong.
    """
    groups = _candidates(fit, targets, site, fit.residuals.computable & ~excluded)
    first = groups[0]
    count = max(sum(len(group.terms) for group in groups), 1)
    findings: list[Finding] = []
    blamed: list[BlamedTerm] = []
    checks: list[Check] = []
    for turn in range(_MOST_FAULTS):
        looks = [(group, look) for group in groups for look in _looks(group.model, group.terms)]
        if turn == 0:
            checks = [_check(group.model, look) for group, look in looks]
        # As many as are found already may be false discoveries of as many more (Benjamini and Hochberg).
        level = significance * (1 + sum(one.severity == "fault" for one in findings)) / count
        clear = [pair for pair in looks if pair[1].chance < level]
        if not clear:
            break
        # The clearest may be part of something larger: the first that explains most of it is taken.
        clear.sort(key=lambda pair: -pair[1].clear)
        clear = [(group, _closer(group.model, look)) for group, look in clear]
        tried = (_tried(fit, group, look, level) for group, look in clear)
        found = next((one for one in tried if one.severity != "hint"), None)
        if found is None and findings:
            break
        found = found or _tried(fit, *clear[0], level)
        chance = min(max(found.look.chance, found.chance) * count, 1.0)
        findings.append(_finding(fit, found, chance))
        if found.severity == "fault":
            blamed.append(_blamed(fit, found))
        if turn == 0:
            checks = [_explained(check, found.look, found.extension) for check in checks]
        if found.severity == "hint":
            # No fault, and yet what makes rows far off.
            groups = [replace(found.group, model=found.extension.model)]
            break
        if found.severity == "doubt":
            # What is open may be something else: the others are looked at without it.
            groups = [group.without(found.look.term.kind) for group in groups]
            continue
        # Where rows without a time stand apart the others no longer speak for the same heliostat.
        groups = [replace(found.group, model=found.extension.model)]
    return Looked(tuple(findings), tuple(checks), _lengths(fit, groups), first.model, first.maker, tuple(blamed))


@dataclass(frozen=True, slots=True, eq=False)
class _Tried:
    """A term that was adjusted, and what it is worth.

    chance: That a sound heliostat's smooth errors pass for as much.
    rival: What explains the same without time; None for terms that are not of time.
    """

    group: _Group
    look: _Look
    extension: Extension
    severity: Severity
    chance: float
    rival: Rival | None = None


@dataclass(frozen=True, slots=True)
class TermGain:
    """What the best look for a term gains.

    kind: Of the term.
    gain, freedom, spare, looks, misfit: As `chance_in_sound` takes them.
    """

    kind: str
    gain: float
    freedom: int
    spare: float
    looks: int
    misfit: float


def term_gains(fit: HeliostatFit, targets: Mapping[str, PlaneTarget], site: Site | None) -> tuple[TermGain, ...]:
    """Return what each term gains that the observations determine: of sound heliostats what smooth errors give it."""
    return tuple(
        TermGain(look.term.kind, found.gain, look.freedom, found.spare, look.looks, found.misfit)
        for group in _candidates(fit, targets, site, fit.residuals.computable)
        for look in _looks(group.model, group.terms)
        if look.freedom
        for found in [_extended(fit, group, _closer(group.model, look))]
    )


def _tried(fit: HeliostatFit, group: _Group, look: _Look, level: float) -> _Tried:
    """Adjust a term and judge it: a fault, open, or a hint.

    level: Share of sound heliostats among the accused that may be.
    """
    extension = _extended(fit, group, look)
    chance = chance_in_sound(
        look.term.kind,
        extension.gain,
        look.freedom,
        spare=extension.spare,
        looks=look.looks,
        misfit=extension.misfit,
    )
    if chance > level * ODDS_OF_A_FAULT or not _can_be(fit, look, extension):
        return _Tried(group, look, extension, "hint", chance)
    if look.term.kind not in IN_TIME:
        return _Tried(group, look, extension, "fault", chance)
    rival = rival_of(group.model, group.maker, extension, look.looks)
    severity: Severity = "fault" if rival.is_decided else "doubt" if rival.is_open else "hint"
    return _Tried(group, look, extension, severity, chance, rival)


def _extended(fit: HeliostatFit, group: _Group, look: _Look) -> Extension:
    """Adjust a term; what priors hold stays within a hundred times of them, all else within its physical bounds."""
    columns = look.term.columns[look.index]
    if look.term.kind in ("actuator_numbers", "position"):
        return group.model.extended(columns, np.full(columns.shape[1], _WIDE))
    judged = look.term.voting
    if look.term.kind == "backlash":
        judged = (approaches(fit.observations)[group.rows] != 0).any(axis=1)
    return group.model.extended(columns, prior_of(look.term.kind, columns.shape[1]), judged=judged)


def _blamed(fit: HeliostatFit, found: _Tried) -> BlamedTerm:
    maker, columns = found.group.maker, found.look.term.columns[found.look.index]
    whole = np.zeros((fit.residuals.owner.size, columns.shape[1]))
    whole[maker.chosen] = columns * maker.factor[:, None]
    return BlamedTerm(found.look.term.kind, whole)


def _can_be(fit: HeliostatFit, look: _Look, extension: Extension) -> bool:
    """Return whether a term is as large as a fault of its kind is, and no larger than it can be."""
    kind, coefficients = look.term.kind, extension.coefficients
    if not is_physical(kind, coefficients, extension.sigmas):
        return False
    if kind == "target_scale":
        return bool(np.abs(coefficients).max() >= _SCALE_FAULT)
    if kind not in ("actuator_numbers", "position"):
        return True
    return bool((np.abs(_shifts(fit, look.term, coefficients)) > FAR_SIGMAS).any())


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
        index, own = _likeliest(statistics, freedom)
        chance = min(own * len(statistics), 1.0)
        # As the Bayesian information criterion weighs terms of different size against each other.
        rows = max(model.count, 2)
        clear = float(statistics[index]) - int(freedom[index]) * np.log(2 * rows) - 2 * np.log(len(statistics))
        free = int(freedom[index])
        found.append(_Look(term, index, statistics, len(statistics), free, chance, clear))
    return found


def _likeliest(statistics: FloatArray, freedom: IntArray) -> tuple[int, float]:
    """Return the look that is the least likely by chance, and that chance.

    Of looks with the same degrees of freedom it is the one with the largest statistic: only that one's chance is
    calculated. Where chances are zero to rounding the statistic decides.
    """
    found = []
    for free in np.unique(freedom).tolist():
        places = np.flatnonzero(freedom == free)[::-1]
        best = int(places[np.argmax(statistics[places])])
        chance = 1 - chi_square_cdf(float(statistics[best]), free) if free else 1.0
        found.append((chance, -float(statistics[best]), best))
    chance, _, index = min(found)
    return index, chance


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
    return Finding(term.kind, severity, f"{said}{share}.", evidence, chance, rows, dates, subject=term.name)


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
    return (
        f"Spots on the targets have to be stretched by {100 * width:+.1f} % and {100 * height:+.1f} % "
        f"(+- {100 * sigma:.2g} %)"
    )
