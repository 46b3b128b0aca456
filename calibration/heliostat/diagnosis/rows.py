"""Single rows that are wrong: what each would have to be instead, repeats, columns that never change."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.heliostat.diagnosis.findings import Finding, Severity, dates_of
from calibration.heliostat.fitting.fit_result import HeliostatFit
from calibration.heliostat.kinematic_model.design import PlaneTarget
from calibration.heliostat.kinematic_model.kinematics import mirror_poses
from calibration.heliostat.observations.beam_observations import BeamSpots
from calibration.heliostat.observations.observations import Observations
from heliogauge.geometry.rays import intersect_plane, reflect
from heliogauge.validate import BoolArray, FloatArray

# A row is explained by another reading of it when it then lies within this of the fit [sigma of the beam].
_EXPLAINED = 4.0
# Spots that differ by less were not measured one by one.
SAME_SPOT_M = 1e-6
_ENOUGH_SPOTS = 5
# Real heliostats fit to 1 to 2 mrad of the beam.
_STEERED_RAD = 3e-3
# An explanation that would fit by chance more often than this is none.
_BY_CHANCE = 0.05
# Outliers up to this share (and number) are of single rows; more of them have one cause. Of six healthy real
# heliostats 1.4 % of the rows are outliers at most.
_MANY, _MANY_SHARE = 4, 0.035


@dataclass(frozen=True, slots=True, eq=False)
class Records:
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
    found: dict[str, list[tuple[str, BoolArray]]] = {}
    for ways in (_other_targets(fit, targets), _other_units(fit, targets)):
        for kind, text, fits in ways:
            fits = fits & ~explained & fit.rejected
            if not fits.any():
                continue
            explained |= fits
            found.setdefault(kind, []).append((text, fits))
    findings = []
    for kind, parts in found.items():
        rows = np.asarray(np.any([fits for _, fits in parts], axis=0))
        said = "; ".join(f"{int(fits.sum())} {text}" for text, fits in parts)
        severity: Severity = "fault" if rows.sum() >= 2 else "rows"
        findings.append(_row_finding(fit, rows, kind, severity, f"{int(rows.sum())} of {rows.size} rows: {said}."))
    return findings, explained


def outlier_finding(
    fit: HeliostatFit, rows: BoolArray, images: Sequence[str], ids: Sequence[str] = ()
) -> Finding | None:
    """Return the rows that nothing explains, or None without any.

    Shapes: rows (n,), images length n.
    ids: What a person calls each row of the table.
    Returns: With date and photo; a fault of the records if there are many.
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
    many = count >= _MANY and count > _MANY_SHARE * len(rows)
    return _row_finding(fit, rows, "outliers", "fault" if many else "rows", text, images)


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

_Way = tuple[str, str, BoolArray]


def _other_targets(fit: HeliostatFit, targets: Mapping[str, PlaneTarget]) -> list[_Way]:
    found = []
    labels = np.array(fit.observations.label, dtype=np.str_)
    xy, limit = coordinates_on_targets(fit, targets), _limits(fit)
    for name, target in targets.items():
        hits = _hits(fit, target, fit.observations.readings)
        near = np.linalg.norm(hits - xy, axis=1) < limit
        chance = np.pi * limit**2 / (target.width_m * target.height_m)
        fits = near & (chance < _BY_CHANCE) & (labels != name)
        for said in dict.fromkeys(labels[fits & fit.rejected].tolist()):
            text = f"that name target {said} fit target {name}"
            found += [("wrong_target", text, fits & (labels == said))]
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
    for text, change in readings.items():
        near = np.zeros(len(labels), dtype=np.bool_)
        for name, target in targets.items():
            hits = _hits(fit, target, change(fit.observations.readings))
            near |= (labels == name) & (np.linalg.norm(hits - xy, axis=1) < limit)
        found.append(("units", text, near))
    for text, factor in (("have millimetres among metres", 1e-3), ("have centimetres among metres", 1e-2)):
        near = np.zeros(len(labels), dtype=np.bool_)
        for name, target in targets.items():
            hits = _hits(fit, target, fit.observations.readings)
            outside = (np.abs(xy) > [target.width_m, target.height_m]).any(axis=1)
            near |= (labels == name) & outside & (np.linalg.norm(hits - factor * xy, axis=1) < limit)
        found.append(("units", text, near))
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
    return np.asarray(_EXPLAINED * residuals.sigma_beam_rad * fit.factor * residuals.distance_m)


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
