"""What could be wrong with records as a whole, tried out one by one where a fit ends far from the observations."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations

import numpy as np

from calibration.heliostat.diagnosis.findings import Finding, coefficients_of
from calibration.heliostat.diagnosis.linear_model import linear_fit
from calibration.heliostat.diagnosis.misfit import criterion, effective_components
from calibration.heliostat.diagnosis.residual_terms import Looked
from calibration.heliostat.diagnosis.terms import SPOTS, Terms, turned_sky, with_suns
from calibration.heliostat.fitting.fit_result import FitOptions, HeliostatFit
from calibration.heliostat.fitting.robust_fit import fit as fit_heliostat
from calibration.heliostat.kinematic_model.design import (
    POSITION,
    HeliostatDesign,
    LinearActuator,
    PlaneTarget,
    RotaryDrive,
)
from calibration.heliostat.kinematic_model.kinematics import mirror_poses
from calibration.heliostat.observations.beam_observations import BeamSpots, SunInCamera
from calibration.heliostat.observations.observations import Group, Observations, Pointings
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.sun import Site, sun_directions
from heliogauge.validate import FloatArray

#: Median angle between beams and fit beyond which no heliostat with its numbers is explained [rad of the beam].
FAR_RAD = 0.010
#: A heliostat that loses more rows than this is not the one described.
REJECTED = 0.3
# What is believed brings the median down by this factor.
_BETTER = 4.0
# Many free numbers must be so much better than a changed sign, and their triangles than where the actuators start.
_WORTH, _MORE_WORTH = 2.0, 1.3
# A row's share in what is unexplained is cut here [sigma].
_CUT = 5.0
# Rows that decide between hypotheses; the winner is fitted to all.
_ROWS = 40
# Computed and recorded suns agree to this where the suns are those of the times.
_SAME_SUN_RAD = 1e-3
# So many of the hypotheses that fail are named, the nearest first.
_NAMED = 6
_HOURS = (*range(-14, 0), *range(1, 15))


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """Records as they would be without a fault.

    kind: The fault: a key of `REMEDIES`.
    text: The fault in words.
    design: The heliostat.
    change: Makes observations as they should have been.
    """

    kind: str
    text: str
    design: HeliostatDesign
    change: Callable[[Observations], Observations]
    evidence: Mapping[str, float] = field(default_factory=dict)


def is_far(fit: HeliostatFit) -> bool:
    """Return whether a fit ends so far from its observations that these must be wrong as a whole."""
    return _median(fit) > FAR_RAD


def hypothesis_finding(
    fit: HeliostatFit, targets: Mapping[str, PlaneTarget], site: Site | None
) -> tuple[Finding, HeliostatFit | None]:
    """Find what, if undone, would make a heliostat's observations fit.

    site: Where the plant is; without, times are not questioned.
    Returns: The fault whose undoing explains the observations, or that none does.
    Returns: The fit without the fault; None where none explains them.
    """
    before = _median(fit)
    few = _some(fit.observations)
    tried = [(_tried(one, few), one) for one in _all(fit, targets, site)]
    best, hypothesis = min(tried, key=lambda pair: pair[0], default=(np.inf, None))
    worth = _WORTH
    for numbers in _free_actuators(fit):
        # Many free numbers fit more than one changed sign does, and more of them more.
        freed = _tried(numbers, fit.observations)
        tried.append((freed, numbers))
        if worth * freed < best:
            best, hypothesis, worth = freed, numbers, _MORE_WORTH
    if hypothesis is None or best > max(before / _BETTER, 1e-4) or best > FAR_RAD:
        return _unexplained(fit, before, tried), None
    corrected = _fitted(hypothesis, fit.observations)
    if hypothesis.kind == "time_offset" and corrected is not None and site is not None:
        return _time_finding(fit, hypothesis, site, before)
    after = np.inf if corrected is None else _median(corrected)
    evidence = {"median_before_mrad": 1e3 * before, "median_after_mrad": 1e3 * after, **hypothesis.evidence}
    freed = int(hypothesis.design.parameters.free.sum()) - int(fit.nominal.parameters.free.sum())
    evidence |= {"freed_count": float(freed)} if freed else {}
    chance = _chance(fit, after / before, len(tried) + 1)
    fall = f"from {1e3 * before:.1f} to {1e3 * after:.2f} mrad of the beam"
    text = f"{hypothesis.text}: without that the median residual falls {fall}."
    return Finding(hypothesis.kind, "fault", text, evidence, chance, subject=hypothesis.text), corrected


def _chance(fit: HeliostatFit, ratio: float, tried: int) -> float:
    """Return the bound of Markov on a likelihood ratio this large if nothing of what was tried is true."""
    spare = int(fit.observations.n_components.sum()) - fit.n_free
    return float(min(1.0, tried * np.exp(spare * np.log(max(ratio, 1e-300)))))


def _unexplained(fit: HeliostatFit, before: float, tried: Sequence[tuple[float, Hypothesis]]) -> Finding:
    nearest = sorted(tried, key=lambda pair: pair[0])
    names = "; ".join(
        f"{one.text[0].lower()}{one.text[1:]}: {f'{1e3 * after:.0f} mrad' if np.isfinite(after) else 'no fit'}"
        for after, one in nearest[:_NAMED]
    )
    share = float(fit.rejected.mean())
    text = (
        f"Observations lie {1e3 * before:.1f} mrad (median) from the best fit and {100 * share:.0f} % of them "
        f"contradict the others; no known fault explains it. {len(tried)} were tried, the nearest: {names}."
    )
    evidence = {"median_before_mrad": 1e3 * before, "rejected_share": share}
    return Finding("unexplained", "fault", text, evidence)


def _time_finding(
    fit: HeliostatFit, hypothesis: Hypothesis, site: Site, before: float
) -> tuple[Finding, HeliostatFit | None]:
    """Refine an offset of the times from the nearest hour."""
    seconds, sigma, corrected = hypothesis.evidence["offset_s"], np.inf, None
    for _ in range(4):
        later = turned_sky(fit.observations, site, seconds)
        corrected = fit_heliostat(fit.nominal, later, FitOptions(sigma="estimated"))
        rows = corrected.residuals.computable
        clock = next(one for one in Terms(corrected, rows).sun(site) if one.kind == "time_offset")
        extension = linear_fit(corrected, rows).extended(clock.columns[0])
        step, sigma = float(extension.coefficients[0]), float(extension.sigmas[0])
        seconds += step
        if abs(step) < 0.1 * sigma:
            break
    after = np.inf if corrected is None else _median(corrected)
    text = (
        f"Times are wrong by {seconds / 3600:+.4f} h ({sigma:.0f} s sigma), to be added: the median residual falls "
        f"from {1e3 * before:.1f} to {1e3 * after:.2f} mrad of the beam."
    )
    evidence = {
        "offset_s": seconds,
        "sigma_offset_s": sigma,
        "median_before_mrad": 1e3 * before,
        "median_after_mrad": 1e3 * after,
    }
    chance = _chance(fit, after / before, len(_HOURS))
    return Finding("time_offset", "fault", text, evidence, chance), corrected


# --- trying -----------------------------------------------------------------------------------------------------------


def _median(fit: HeliostatFit) -> float:
    """Median angle between observation and fit of all rows [rad]."""
    residuals = fit.residuals
    angles = np.where(np.isfinite(residuals.beam_angle_rad), residuals.beam_angle_rad, residuals.normal_angle_rad)
    angles = angles[np.isfinite(angles) | ~residuals.computable]
    angles = np.where(np.isfinite(angles), angles, np.pi)
    return float(np.median(angles)) if angles.size else 0.0


def _fitted(hypothesis: Hypothesis, observations: Observations) -> HeliostatFit | None:
    try:
        options = FitOptions(sigma="estimated", restarts=0)
        found = fit_heliostat(hypothesis.design, hypothesis.change(observations), options)
    except (EstimationError, InputError):
        return None
    return restarted(found)


def restarted(found: HeliostatFit) -> HeliostatFit:
    """Fit again from where numbers without a prior went: readings that the first numbers could not have count then.

    found: A fit; what has a prior starts from there again.
    """
    parameters = found.nominal.parameters
    free = {
        name: float(value)
        for name, value, sigma in zip(parameters.names, found.values, parameters.sigmas, strict=True)
        if np.isinf(sigma)
    }
    if not free:
        return found
    nominal = found.nominal.with_value(free)
    return fit_heliostat(nominal, found.observations, FitOptions(sigma="estimated", restarts=0))


def _tried(hypothesis: Hypothesis, observations: Observations) -> float:
    found = _fitted(hypothesis, observations)
    return np.inf if found is None or _looks_away(found) else _median(found)


def _looks_away(fit: HeliostatFit) -> bool:
    """Whether the mirror turns its back to the sun: that reflects alike on paper, and nowhere else."""
    seen = fit.observations
    poses = mirror_poses(fit.design, fit.values, seen.readings, seen.approach, outside="nan")
    facing = np.einsum("ni,ni->n", poses.normals(fit.design), seen.sun)
    facing = facing[np.isfinite(facing)]
    return bool(facing.size and np.median(facing) < 0)


def _some(observations: Observations) -> Observations:
    count = len(observations)
    chosen = np.zeros(count, dtype=np.bool_)
    chosen[np.linspace(0, count - 1, min(_ROWS, count)).round().astype(np.intp)] = True
    return observations.select(chosen)


# --- what could be wrong ----------------------------------------------------------------------------------------------


def _all(fit: HeliostatFit, targets: Mapping[str, PlaneTarget], site: Site | None) -> Iterator[Hypothesis]:
    yield from _suns(fit)
    if site is not None:
        yield from _sites(fit, site)
    yield from _axes(fit)
    yield from _numbers(fit)
    yield from _spots(fit, targets)
    if site is not None and np.isfinite(fit.observations.sun).any():
        for hours in _HOURS:
            yield Hypothesis(
                "time_offset",
                f"times are {hours} h off",
                fit.nominal,
                partial(turned_sky, site=site, seconds=3600.0 * hours),
                {"offset_s": 3600.0 * hours},
            )


def _suns(fit: HeliostatFit) -> Iterator[Hypothesis]:
    if not np.isfinite(fit.observations.sun).any():
        return
    forms = {
        "The sun's azimuth is counted from south, positive to the east": np.diag([1.0, -1.0, 1.0]),
        "The sun's azimuth is counted from south, positive to the west": np.diag([-1.0, -1.0, 1.0]),
        "The sun's azimuth is counted counter-clockwise from north": np.diag([-1.0, 1.0, 1.0]),
        "The sun's azimuth is counted counter-clockwise from east": np.eye(3)[[1, 0, 2]],
    }
    for text, form in forms.items():
        yield Hypothesis("sun_convention", text, fit.nominal, partial(with_suns, change=partial(_turned, form)), {})
    yield Hypothesis(
        "sun_convention",
        "The sun's elevation is the angle from the zenith",
        fit.nominal,
        partial(with_suns, change=_from_zenith),
    )


def _sites(fit: HeliostatFit, site: Site) -> Iterator[Hypothesis]:
    """Yield other places of the plant, where suns were computed from the times."""
    seen = fit.observations
    known = np.isfinite(seen.sun).all(axis=1) & ~np.isnat(seen.time)
    if not known.any():
        return
    apart = np.linalg.norm(seen.sun[known] - sun_directions(seen.time[known], site), axis=1)
    if np.median(apart) > _SAME_SUN_RAD:
        return
    signs = {
        "The site's latitude has the wrong sign": {"latitude_deg": -site.latitude_deg},
        "The site's longitude has the wrong sign": {"longitude_deg": -site.longitude_deg},
        "Latitude and longitude of the site have the wrong sign": {
            "latitude_deg": -site.latitude_deg,
            "longitude_deg": -site.longitude_deg,
        },
    }
    for text, change in signs.items():
        yield Hypothesis("site", text, fit.nominal, partial(_at_site, site=replace(site, **change)))


def _at_site(observations: Observations, site: Site) -> Observations:
    groups: list[Group] = []
    for group in observations.groups:
        if isinstance(group, (BeamSpots, SunInCamera)) and len(group):
            group = replace(group, sun=sun_directions(group.pointings.time, site))
        groups.append(group)
    return Observations(tuple(groups))


def _numbers(fit: HeliostatFit) -> Iterator[Hypothesis]:
    """Yield the heliostat with its place or its angles read otherwise."""
    design = fit.nominal
    east, north, up = design.position_m.tolist()
    place = dict(zip(POSITION, (north, east, up), strict=True))
    yield Hypothesis(
        "position", "East and north of the heliostat are exchanged", design.with_value(place), lambda seen: seen
    )
    if design.reading_unit == "rad":
        for text, factor in (("degrees for radians", np.pi / 180), ("radians for degrees", 180 / np.pi)):
            yield Hypothesis(
                "units",
                f"Readings are {text}",
                design,
                partial(_with_readings, change=partial(np.multiply, factor)),
            )
    parameters = design.parameters
    drives = {name for drive in design.drives for name in drive.terms.names}
    angles = {
        name: value
        for name, value, unit in zip(parameters.names, parameters.values.tolist(), parameters.units, strict=True)
        if unit == "rad" and value != 0 and name not in drives
    }
    for text, factor in (("degrees for radians", np.pi / 180), ("radians for degrees", 180 / np.pi)):
        if angles:
            changed = design.with_value({name: factor * value for name, value in angles.items()})
            yield Hypothesis("units", f"Angles among the heliostat's numbers are {text}", changed, lambda seen: seen)


def _turned(form: FloatArray, suns: FloatArray) -> FloatArray:
    return np.asarray(suns @ form.T)


def _from_zenith(suns: FloatArray) -> FloatArray:
    flat = np.hypot(suns[:, 0], suns[:, 1])
    level = suns[:, :2] / np.maximum(flat, 1e-12)[:, None]
    return np.column_stack([level * suns[:, 2:], flat])


def _axes(fit: HeliostatFit) -> Iterator[Hypothesis]:
    yield Hypothesis(
        "swapped_axes",
        "The readings of the two axes are exchanged",
        fit.nominal,
        lambda seen: _with_readings(seen, lambda readings: readings[:, ::-1]),
    )
    for axis in (0, 1):
        yield Hypothesis(
            "inverted_axis",
            f"Axis {axis + 1} runs against its stated direction",
            _inverted(fit.nominal, axis),
            lambda seen: seen,
            {"axis_number": axis + 1.0},
        )
    drive = fit.nominal.drives[0]
    if isinstance(drive, RotaryDrive):
        # Azimuths from the south, clockwise and not; half a turn of axis 2 as well would be the same pose over the top.
        half = np.array([np.pi / drive.rad_per_reading, 0.0])
        for design, also in ((fit.nominal, ""), (_inverted(fit.nominal, 0), " and runs the other way")):
            yield Hypothesis(
                "half_turn",
                f"Axis 1 is read half a turn off{also} (an azimuth from the south?)",
                design,
                partial(_with_readings, change=partial(np.add, half)),
                {"axis_number": 1.0},
            )


def _inverted(design: HeliostatDesign, axis: int) -> HeliostatDesign:
    drive = design.drives[axis]
    if isinstance(drive, RotaryDrive):
        turned: RotaryDrive | LinearActuator = replace(drive, rad_per_reading=-drive.rad_per_reading)
    else:
        turned = replace(drive, clockwise=not drive.clockwise)
    drives = (turned, design.drives[1]) if axis == 0 else (design.drives[0], turned)
    return replace(design, drives=drives)


def _spots(fit: HeliostatFit, targets: Mapping[str, PlaneTarget]) -> Iterator[Hypothesis]:
    beams = [group for group in fit.observations.groups if isinstance(group, BeamSpots) and len(group)]
    used = [name for name in dict.fromkeys(name for group in beams for name in group.target) if name in targets]
    if not used:
        return
    yield from mirrored(fit, targets)
    for one, other in combinations(used, 2):
        yield Hypothesis(
            "target_names_exchanged",
            f"The targets {one} and {other} are taken for each other",
            fit.nominal,
            partial(_with_spots, targets=targets, names={one: other, other: one}, signs=(1.0, 1.0)),
        )


def mirrored(fit: HeliostatFit, targets: Mapping[str, PlaneTarget]) -> Iterator[Hypothesis]:
    """Yield the spots with one coordinate on the targets of the other sign."""
    texts = {
        (-1.0, 1.0): "x on the targets runs to the left as seen from the field",
        (1.0, -1.0): "y on the targets runs downwards",
    }
    for signs, text in texts.items():
        change = partial(_with_spots, targets=targets, names={}, signs=signs)
        yield Hypothesis("mirrored_spots", text, fit.nominal, change)


def mirrored_finding(
    fit: HeliostatFit,
    targets: Mapping[str, PlaneTarget],
    looked: Looked,
    level: float,
) -> tuple[Finding, HeliostatFit] | None:
    """Ask whether the spots fit better with one coordinate on the targets of the other sign.

    looked: What else the residuals of the same rows show: it may be the better explanation.
    level: Chance from which on it is no fault.
    Returns: The fault and the fit without it, or None.

    Both readings have the same numbers: their likelihood ratio is that of what they leave, with two independent
    components for each day, because rows of a day share their errors. Its chance is at most its inverse (Markov).
    """
    if not any(set(group.target) & set(targets) for group in fit.observations.groups if isinstance(group, BeamSpots)):
        return None
    model, terms = looked.model, looked.terms
    days = fit.observations.time[terms.rows].astype("datetime64[D]")
    independent = 2 * (np.unique(days[~np.isnat(days)]).size + int(np.isnat(days).sum()))
    for one in mirrored(fit, targets):
        other = model.shifted(terms.moved(one.change(fit.observations), 1.0))
        ratio = float(other.squares(model.scale).sum() / max(model.squares(model.scale).sum(), 1e-300))
        chance = min(1.0, 2 * ratio ** (0.5 * independent))
        others = (
            criterion(1 - found.evidence["explained_share"], coefficients_of(found), independent)
            for found in looked.findings
            # A scale of -1 is what mirrored spots look like.
            if found.kind != "target_scale"
        )
        if chance > level or criterion(ratio, 0.0, independent) > min(others, default=np.inf):
            continue
        corrected = _fitted(one, fit.observations)
        if corrected is None or _is_stretched(corrected, targets):
            continue
        evidence = {
            "explained_share": 1 - ratio,
            "median_before_mrad": 1e3 * _median(fit),
            "median_after_mrad": 1e3 * _median(corrected),
        }
        text = f"{one.text}: without that {100 * (1 - ratio):.0f} % less is left of the squares."
        return Finding("mirrored_spots", "fault", text, evidence, chance, subject=SPOTS), corrected
    return None


def site_finding(fit: HeliostatFit, site: Site, of_time: Finding) -> tuple[Finding, HeliostatFit] | None:
    """Ask whether the site explains what looks like a wrong clock: a longitude of the wrong sign is an hour or so.

    of_time: The clock's finding.
    Returns: The fault and the fit without it, or None where the clock, a number of its own, explains it better.
    """
    before, count = _median(fit), effective_components(float(fit.observations.n_components.sum()) - fit.n_free)
    theirs = criterion(1 - of_time.evidence["explained_share"], 1.0, count)
    tried = [(_fitted(one, fit.observations), one) for one in _sites(fit, site)]
    fits = [(_median(found), found, one) for found, one in tried if found is not None and not _looks_away(found)]
    if not fits:
        return None
    after, corrected, hypothesis = min(fits, key=lambda one: one[0])
    squares = [np.minimum(one.residuals.lengths / fit.factor, _CUT) ** 2 for one in (fit, corrected)]
    if criterion(float(squares[1].sum() / max(squares[0].sum(), 1e-300)), 0.0, count) > theirs:
        return None
    evidence = {"median_before_mrad": 1e3 * before, "median_after_mrad": 1e3 * after}
    fall = f"from {1e3 * before:.1f} to {1e3 * after:.2f} mrad of the beam"
    text = f"{hypothesis.text}: without that the median residual falls {fall}."
    chance = _chance(fit, after / before, len(tried))
    return Finding("site", "fault", text, evidence, chance, subject=hypothesis.text), corrected


def _is_stretched(fit: HeliostatFit, targets: Mapping[str, PlaneTarget]) -> bool:
    """Return whether spots are nearer to a scale of -1, or of 3, than to their own: then they are not what is wrong."""
    model = linear_fit(fit)
    found = (
        model.estimate(term.columns[0])
        for term in Terms(fit, fit.residuals.computable).targets(targets)
        if term.kind == "target_scale"
    )
    return any(bool((np.abs(one.values) > 1).any()) for one in found)


def _free_actuators(fit: HeliostatFit) -> Iterator[Hypothesis]:
    """Yield the heliostat with numbers of its linear actuators free: where they start, and then their triangles too."""
    drives = [drive for drive in fit.nominal.drives if isinstance(drive, LinearActuator)]
    if not drives or len(fit.observations) < 20:
        return
    starts = [name for drive in drives for name in (drive.initial_angle, drive.initial_stroke)]
    sides = [name for drive in drives for name in (drive.offset, drive.pivot_radius)]
    for names in (starts, starts + sides):
        parameters = fit.nominal.parameters.with_sigmas(dict.fromkeys(names, np.inf))
        free = fit.nominal.with_parameters(parameters)
        yield Hypothesis("actuator_numbers", "The actuators' numbers are not this heliostat's", free, lambda seen: seen)


def _with_readings(observations: Observations, change: Callable[[FloatArray], FloatArray]) -> Observations:
    groups: list[Group] = []
    for group in observations.groups:
        old = group.pointings
        groups.append(replace(group, pointings=Pointings(change(old.readings), old.row, old.time, old.approach)))
    return Observations(tuple(groups))


def _with_spots(
    observations: Observations,
    targets: Mapping[str, PlaneTarget],
    names: Mapping[str, str],
    signs: tuple[float, float],
) -> Observations:
    groups: list[Group] = []
    for group in observations.groups:
        if isinstance(group, BeamSpots) and len(group):
            spots = group.spot_m.copy()
            for name in set(group.target) & set(targets):
                mine = np.array([one == name for one in group.target], dtype=np.bool_)
                xy = targets[name].coordinates(spots[mine]) * signs
                spots[mine] = targets[names.get(name, name)].points(xy)
            group = replace(group, spot_m=spots)
        groups.append(group)
    return Observations(tuple(groups))
