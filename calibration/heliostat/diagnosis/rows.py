"""Single rows that are wrong: what each would have to be instead, repeats, columns that never change."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.heliostat.diagnosis.episodes import Episode, episode_finding, find_episodes
from calibration.heliostat.diagnosis.findings import SURE, Finding, Severity, dates_of
from calibration.heliostat.diagnosis.linear_model import EXPLAINED_SIGMAS
from calibration.heliostat.fitting.fit_result import FitOptions, HeliostatFit
from calibration.heliostat.kinematic_model.design import PlaneTarget
from calibration.heliostat.kinematic_model.kinematics import mirror_poses
from calibration.heliostat.observations.beam_observations import BeamSpots
from calibration.heliostat.observations.observations import Observations
from heliogauge.geometry.rays import intersect_plane, reflect
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FloatArray

# Spots that differ by less were not measured one by one.
SAME_SPOT_M = 1e-6
_ENOUGH_SPOTS = 5
# Real heliostats fit to 1 to 2 mrad of the beam.
_STEERED_RAD = 3e-3
# A spot this many targets away was in no photo of the target: it is in another unit. Steered to the middle, any miss
# would pass for one in millimetres.
_BEYOND = 5.0
# An explanation that would fit by chance more often than this is none.
_BY_CHANCE = 0.05
_TOGETHER = 1e-3
# Names are exchanged where nearly every row of both targets has the other's.
_ALL = 0.9
# So many rejected rows of a target, apart from those of some days, are no matter of these days.
_MANY_OF_A_TARGET = 0.3
# The fit rejects any good row at all with this chance.
_REJECTED_BY_CHANCE = FitOptions().significance
# Of rows that are rejected one by one, a third at most, the newest five are all rejected in 0.4 % of the heliostats.
_NEWEST = 5
# Outliers up to this share (and number) are of single rows; more of them have one cause. Of six healthy real
# heliostats 1.4 % of the rows are outliers at most.
_MANY, _MANY_SHARE = 4, 0.035


@dataclass(frozen=True, slots=True, eq=False)
class Records(ShortRepr):
    """What the table of observations has beyond the observations: all its rows, those left out before the fit too.

    flags: Why each row was left out before the fit; empty if it was not.
    images: Photo of each row, as far as known.
    times (rows,): Time of each row.
    ids: What a person calls each row, such as "line 7"; else its number from 0.
    """

    flags: tuple[str, ...]
    images: tuple[str, ...]
    times: np.ndarray[tuple[int, ...], np.dtype[np.datetime64]]
    ids: tuple[str, ...] = ()


def explained_rows(fit: HeliostatFit, targets: Mapping[str, PlaneTarget]) -> tuple[list[Finding], BoolArray]:
    """Find rejected rows that fit when one thing in them is read differently.

    Shapes: rows (n,).
    fit: The fit; most of its rows are right.
    """
    explained = np.zeros(len(fit.observations), dtype=np.bool_)
    if not fit.rejected.any():
        return [], explained
    ways = (*_other_targets(fit, targets), *_other_units(fit, targets))
    findings = []
    for episode in _episodes(fit, ways):
        explained |= episode.members
        findings.append(episode_finding(fit, episode))
    found: dict[str, list[_Way]] = {}
    for way in ways:
        fits = way.fits & ~explained & fit.rejected
        if not fits.any():
            continue
        explained |= fits
        found.setdefault(way.kind, []).append(replace(way, fits=fits))
    for kind, parts in found.items():
        rows = np.asarray(np.any([part.fits for part in parts], axis=0))
        said = "; ".join(f"{int(part.fits.sum())} {part.text}" for part in parts)
        # Each of the rejected rows could have fitted any of the other places by chance.
        places = max(len(targets) - 1, 1) * max(part.chance for part in parts)
        chance = binomial_tail(int(rows.sum()), int(fit.rejected.sum()), places)
        severity: Severity = "fault" if rows.sum() >= 2 and chance < SURE else "rows"
        text = f"{int(rows.sum())} of {rows.size} rows: {said}."
        finding = replace(_row_finding(fit, rows, kind, severity, text), chance=chance)
        exchanged = _exchanged(fit, parts) if kind == "wrong_target" else ""
        findings.append(replace(finding, kind="target_names_exchanged", text=exchanged) if exchanged else finding)
    return findings, explained


def _exchanged(fit: HeliostatFit, parts: Sequence["_Way"]) -> str:
    """Say which two targets have each other's names in all rows; empty where none have."""
    labels = np.array(fit.observations.label, dtype=np.str_)
    fits = {part.names: part.fits for part in parts}
    for (one, other), rows in fits.items():
        back = fits.get((other, one))
        if back is None or len(fits) != 2:
            continue
        both = int(np.isin(labels, (one, other)).sum())
        if int((rows | back).sum()) >= _ALL * both:
            return (
                f"The targets {one} and {other} are taken for each other in {int((rows | back).sum())} of {both} rows."
            )
    return ""


def _episodes(fit: HeliostatFit, ways: Sequence["_Way"]) -> tuple[Episode, ...]:
    """Return episodes that explain their rows better than another target or unit does."""
    none = np.zeros(len(fit.observations), dtype=np.bool_)
    best = np.fmin.reduce([way.lengths for way in ways]) if ways else np.full(len(none), np.nan)
    found = (one for one in find_episodes(fit, none) if one.likelier_than(best))
    return tuple(one for one in found if not _is_of_a_target(fit, one))


def _is_of_a_target(fit: HeliostatFit, episode: Episode) -> bool:
    """Whether rows on the same target are wrong before and after an episode as well: it is the target then."""
    labels = np.array(fit.observations.label, dtype=np.str_)
    others = np.isin(labels, labels[episode.members]) & ~episode.members & fit.residuals.computable
    return bool(others.any()) and float(fit.rejected[others].mean()) > _MANY_OF_A_TARGET


def binomial_tail(count: int, tries: int, chance: float) -> float:
    """Return the probability of at least so many hits in so many tries."""
    if not 0 < chance < 1 or count < 1:
        return float(chance >= 1 or count < 1)
    hits = range(count, tries + 1)
    whole = math.lgamma(tries + 1)
    logarithms = [
        whole
        - math.lgamma(k + 1)
        - math.lgamma(tries - k + 1)
        + k * math.log(chance)
        + (tries - k) * math.log1p(-chance)
        for k in hits
    ]
    return min(1.0, math.fsum(math.exp(one) for one in logarithms))


def outlier_finding(
    fit: HeliostatFit, rows: BoolArray, images: Sequence[str], ids: Sequence[str], accusing: BoolArray
) -> Finding | None:
    """Return the rows that nothing explains, or None without any.

    Shapes: rows (n,), images length n.
    ids: What a person calls each row of the table.
    accusing (n,): Those of the rows that count as a fault of the records if they are many.
    Returns: With date and photo.
    """
    count = int(rows.sum())
    if not count:
        return None
    worst = np.flatnonzero(rows)[np.argsort(-fit.residuals.lengths[rows])][0]
    when = fit.observations.time[worst]
    photo = f", photo {images[worst]}" if images[worst] else ""
    first = "" if np.isnat(when) else f", {str(when)[:16]}Z"
    row = int(fit.observations.row[worst])
    name = ids[row] if ids else str(row)
    where = f"{f'row {name}' if name.isdecimal() else name}{first}{photo}"
    text = (
        f"{count} of {len(rows)} rows contradict the others; the worst is {where}: "
        f"{fit.reason[worst] or 'far from the fit'}."
    )
    accused = int(accusing.sum())
    many = accused >= _MANY and accused > _MANY_SHARE * len(rows)
    finding = _row_finding(fit, rows, "outliers", "fault" if many else "rows", text, images)
    return replace(finding, chance=binomial_tail(count, len(rows), _REJECTED_BY_CHANCE / len(rows)))


def newest_finding(fit: HeliostatFit, rows: BoolArray) -> Finding | None:
    """Return that something changed before the newest rows; None where one of the newest five agrees with the others.

    rows (n,): Rejected rows that nothing else explains.
    Returns: The days between which it changed, and all rows since.
    """
    times = fit.observations.time
    asked = fit.residuals.computable & ~np.isnat(times) & (rows | ~fit.rejected)
    order = np.flatnonzero(asked)[np.argsort(times[asked], kind="stable")]
    good = np.flatnonzero(~rows[order])
    if not good.size or order.size - good[-1] - 1 < _NEWEST:
        return None
    since = np.zeros(rows.size, dtype=np.bool_)
    since[order[good[-1] + 1 :]] = True
    count = int(since.sum())
    before, after = times[order[good[-1]]], times[since].min()
    dates = (str(before.astype("datetime64[D]")), str(after.astype("datetime64[D]")))
    angles = fit.residuals.beam_angle_rad[since]
    angles = np.where(np.isfinite(angles), angles, fit.residuals.normal_angle_rad[since])
    known = angles[np.isfinite(angles)]
    far = f", {1e3 * float(np.median(known)):.1f} mrad in the median" if known.size else ""
    text = (
        f"Between {dates[0]} and {dates[1]} something changed: all {count} rows since then, the newest of {rows.size}, "
        f"contradict the earlier ones{far}; they are left out."
    )
    share = (float(np.count_nonzero(rows & ~since)) + 1) / (good[-1] + 2)
    found = _row_finding(fit, since, "change_point", "fault", text)
    return replace(found, chance=min(1.0, share**count), dates=dates)


def record_findings(fit: HeliostatFit, records: Records | None, targets: Mapping[str, PlaneTarget]) -> list[Finding]:
    """Find repeats, mixed units and columns that never change.

    records: Verdicts on all rows of the table.
    Returns: What was left out before the fit, and what is still in it.
    """
    findings = _flagged(records) if records is not None else []
    repeated = _repeats(fit.observations)
    if repeated.any() and not any(one.kind == "duplicates" for one in findings):
        count = int(repeated.sum())
        text = f"{count} of {len(repeated)} rows repeat an earlier one and count twice."
        findings.append(_row_finding(fit, repeated, "duplicates", "fault", text))
    return findings + _constants(fit) + _constant_spots(fit, targets)


def _flagged(records: Records) -> list[Finding]:
    findings = []
    said = {"duplicate": ("duplicates", "repeat an earlier one"), "units": ("units", "are in another unit")}
    for flag, (kind, text) in said.items():
        rows = [row for row, one in enumerate(records.flags) if one == flag]
        if rows:
            share = len(rows) / len(records.flags)
            severity: Severity = "fault" if len(rows) >= 2 else "rows"
            findings.append(
                Finding(
                    kind,
                    severity,
                    f"{len(rows)} of {len(records.flags)} rows {text}; they are left out.",
                    {"rows": float(len(rows)), "share": share},
                    rows=tuple(rows),
                    dates=dates_of(records.times[rows]),
                    images=tuple(records.images[row] for row in rows if records.images[row]),
                )
            )
    return findings


def _repeats(observations: Observations) -> BoolArray:
    """Rows whose readings, sun, time and spot are those of an earlier row."""
    parts = []
    for group in observations.groups:
        own = [group.pointings.readings, group.pointings.time.astype(np.int64)[:, None].astype(np.float64)]
        own += [group.spot_m if isinstance(group, BeamSpots) else np.full((len(group), 3), np.nan), group.sun_or_nan]
        parts.append(np.concatenate(own, axis=1))
    table = np.concatenate(parts)
    # Without a place that was seen equal rows may be two looks at a resting mirror.
    known = np.isfinite(table[:, 3:6]).all(axis=1)
    _, first, inverse = np.unique(np.nan_to_num(table), axis=0, return_index=True, return_inverse=True)
    return np.asarray(known & (first[inverse.ravel()] != np.arange(len(table))))


def _constants(fit: HeliostatFit) -> list[Finding]:
    """Find drives whose readings are all the same although the sun moved."""
    seen = fit.observations
    suns = seen.sun[np.isfinite(seen.sun).all(axis=1)]
    # Half a degree of sky is a quarter of a degree of the mirror: a drive that is read moves by then.
    if len(suns) < 5 or np.ptp(suns, axis=0).max() < 0.01:
        return []
    findings = []
    for axis in (0, 1):
        readings = seen.readings[:, axis]
        values, counts = np.unique(readings, return_counts=True)
        most = int(counts.max())
        if most >= 5 and most > 0.5 * readings.size:
            value = values[np.argmax(counts)]
            text = f"Axis {axis + 1} reads {value:g} in {most} of {readings.size} rows, although the sun moved."
            evidence = {"axis_number": axis + 1.0, "rows_count": float(most)}
            stuck = readings == value
            found = _row_finding(fit, stuck, "constant_column", "fault", text)
            findings.append(replace(found, evidence=evidence))
    return findings


def _constant_spots(fit: HeliostatFit, targets: Mapping[str, PlaneTarget]) -> list[Finding]:
    """Find beams that were all seen at the same x or y: not recorded, or steered there."""
    xy = coordinates_on_targets(fit, targets)
    xy = xy[np.isfinite(xy).all(axis=1)]
    if len(xy) < _ENOUGH_SPOTS:
        return []
    same = np.flatnonzero(np.ptp(xy, axis=0) < SAME_SPOT_M).tolist()
    if not same:
        return []
    said = " and ".join(f"{'xy'[axis]} = {xy[0, axis]:.3f} m" for axis in same)
    text = (
        f"All {len(xy)} beams were seen at {said}: either each was steered there, or that was not recorded, and then "
        "the answer is wrong."
    )
    # Beams are steered to a point, and hardly to a line; and then they fit as well as others.
    steered = len(same) == 2 and float(np.nanmedian(fit.residuals.beam_angle_rad)) < _STEERED_RAD
    return [Finding("constant_column", "hint" if steered else "doubt", text, {"rows_count": float(len(xy))})]


# --- other ways to read a row -----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Way:
    """Another way to read rows.

    fits (n,): Rows that agree with the fit if read so.
    lengths (n,): How far each then is from the fit [sigma of the beam]; NaN where the way does not concern it.
    chance: Probability that a row which is wrong in some other way fits, at most.
    names: Of another target: the one that the rows name, and the one that they fit.
    """

    kind: str
    text: str
    fits: BoolArray
    lengths: FloatArray
    chance: float
    names: tuple[str, str] = ("", "")


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """Rows (n,) that name another target and lie near where they should on this one, and the chance of it."""

    name: str
    near: BoolArray
    lengths: FloatArray
    chance: FloatArray


def _other_targets(fit: HeliostatFit, targets: Mapping[str, PlaneTarget]) -> list[_Way]:
    found: list[_Way] = []
    places: list[_Place] = []
    labels = np.array(fit.observations.label, dtype=np.str_)
    xy, limit = coordinates_on_targets(fit, targets), _limits(fit)
    for name, target in targets.items():
        hits = _hits(fit, target, fit.observations.readings)
        away = np.linalg.norm(hits - xy, axis=1)
        chance = np.minimum(np.pi * limit**2 / (target.width_m * target.height_m), 1.0)
        near = (away < limit) & (labels != name)
        lengths = np.where(labels != name, EXPLAINED_SIGMAS * away / limit, np.nan)
        places.append(_Place(name, near, lengths, chance))
    # One row says little where the limit is a good part of a target; many together say more, whichever target they fit.
    hits = fit.rejected & np.asarray(np.sum([one.near for one in places], axis=0) > 0)
    worst = max((float(one.chance[one.near & fit.rejected].max(initial=0.0)) for one in places), default=1.0)
    tail = binomial_tail(int(hits.sum()), int(fit.rejected.sum()), min(1.0, worst * max(len(places) - 1, 1)))
    for one in places:
        certain = one.near & ((one.chance < _BY_CHANCE) | (tail < _TOGETHER))
        for said in dict.fromkeys(labels[certain & fit.rejected].tolist()):
            mine = certain & (labels == said)
            text = f"that name target {said} fit target {one.name}"
            share = float(one.chance[mine & fit.rejected].max())
            found.append(_Way("wrong_target", text, mine, one.lengths, share, (said, one.name)))
    return found


def _other_units(fit: HeliostatFit, targets: Mapping[str, PlaneTarget]) -> list[_Way]:
    found: list[_Way] = []
    xy, limit = coordinates_on_targets(fit, targets), _limits(fit)
    labels = np.array(fit.observations.label, dtype=np.str_)
    readings: dict[str, Callable[[FloatArray], FloatArray]] = {}
    if fit.design.reading_unit == "rad":
        readings = {
            "have readings in degrees among radians": np.radians,
            "have readings in radians among degrees": np.degrees,
        }
    metres = (("have millimetres among metres", 1e-3), ("have centimetres among metres", 1e-2))
    for text, change, factor in (
        *((text, change, 1.0) for text, change in readings.items()),
        *((text, None, factor) for text, factor in metres),
    ):
        lengths, chance = np.full(len(labels), np.nan), 0.0
        for name, target in targets.items():
            own = labels == name
            if not own.any():
                continue
            hits = _hits(
                fit, target, fit.observations.readings if change is None else change(fit.observations.readings)
            )
            if change is None:
                own &= (np.abs(xy) > _BEYOND * np.array([target.width_m, target.height_m])).any(axis=1)
            away = EXPLAINED_SIGMAS * np.linalg.norm(hits - factor * xy, axis=1) / limit
            lengths[own] = away[own]
            size = np.where(own & np.isfinite(limit), limit, 0.0).max()
            chance = max(chance, float(np.pi * size**2 / (target.width_m * target.height_m)))
        found.append(
            _Way("units", text, np.nan_to_num(lengths, nan=np.inf) < EXPLAINED_SIGMAS, lengths, min(chance, 1.0))
        )
    return found


def coordinates_on_targets(fit: HeliostatFit, targets: Mapping[str, PlaneTarget]) -> FloatArray:
    """Return where spots were seen on the targets that they name.

    Returns (n, 2): To the right and up [m]; NaN for other observations.
    """
    found = []
    for group in fit.observations.groups:
        xy = np.full((len(group), 2), np.nan)
        if isinstance(group, BeamSpots):
            names = np.array(group.target, dtype=np.str_)
            for name in set(group.target) & set(targets):
                xy[names == name] = targets[name].coordinates(group.spot_m[names == name])
        found.append(xy)
    return np.concatenate(found)


def _limits(fit: HeliostatFit) -> FloatArray:
    """How near a spot has to be to be explained (n,) [m]."""
    residuals = fit.residuals
    return np.asarray(EXPLAINED_SIGMAS * residuals.sigma_beam_rad * fit.factor * residuals.distance_m)


def _hits(fit: HeliostatFit, target: PlaneTarget, readings: FloatArray) -> FloatArray:
    """Where the fit has the beams on a target (n, 2) [m]; NaN where it has none."""
    seen = fit.observations
    poses = mirror_poses(fit.design, fit.values, readings, seen.approach, outside="nan")
    beams = reflect(-seen.sun, poses.normals(fit.design))
    with np.errstate(invalid="ignore", divide="ignore"):
        along = intersect_plane(poses.centre_m, beams, target.center_m, target.normal)
    hits = target.coordinates(poses.centre_m + along[:, None] * beams)
    return np.where((along > 0)[:, None], hits, np.nan)


def _row_finding(
    fit: HeliostatFit, rows: BoolArray, kind: str, severity: Severity, text: str, images: Sequence[str] = ()
) -> Finding:
    seen = fit.observations
    numbers = {"rows_count": float(rows.sum()), "rows_share": float(rows.mean())}
    photos = tuple(images[i] for i in np.flatnonzero(rows).tolist() if images[i]) if images else ()
    chosen = tuple(seen.row[rows].tolist())
    return Finding(kind, severity, text, numbers, rows=chosen, dates=dates_of(seen.time[rows]), images=photos)
