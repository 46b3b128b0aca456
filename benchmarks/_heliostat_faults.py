"""Faults drawn into the records of real heliostats, with sizes from stated sources, and whether they can be seen.

A fault is what a real heliostat's own model says that it does to the spots, added to the spots as they were measured:
all that is unexplained of a real heliostat stays in them.
"""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.stats import f as f_distribution
from scipy.stats import ncf

from calibration.heliostat import Options, run
from calibration.heliostat.diagnosis import (
    GAINS,
    ODDS_OF_A_FAULT,
    Records,
    Terms,
    class_of,
    diagnose,
    further_numbers,
    linear_fit,
)
from calibration.heliostat.fitting import FitOptions, fit, with_priors
from calibration.heliostat.kinematic_model import mirror_poses
from calibration.heliostat.observations import BeamSpots, Observations, Pointings, evaluate, predicted_spots
from heliogauge.geometry.rigid import rotation_from_vector
from heliogauge.geometry.sun import sun_directions
from heliogauge.measurement.load import load

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "csp"
FAULTY = ("BF41",)
ESTIMATED = FitOptions(sigma="estimated")


@cache
def units():
    """Return design, observations, plant and fit of each real heliostat that has its files."""
    found = {}
    for folder in ("juelich_calibration", "juelich_calibration_short"):
        result = run(load(DATA / folder), Options(thorough=False, model="8", jobs=1))
        for one in result.heliostats:
            found[one.name] = (with_priors(one.nominal), one.seen.observations, result.shared.plant)
    return found


def sound():
    """Return the names of the heliostats without a fault."""
    return [name for name in units() if name not in FAULTY]


@cache
def fitted(name):
    design, seen, _ = units()[name]
    return fit(design, seen, ESTIMATED)


def judged(design, seen, plant):
    """Return the diagnosis as the command makes it."""
    count = int(seen.row.max()) + 1
    times = np.full(count, np.datetime64("NaT", "ms"))
    times[seen.row] = seen.time
    records = Records(("",) * count, ("",) * count, times)
    return diagnose(fit(design, seen, ESTIMATED), targets=plant.targets, site=plant.site, records=records)


# --- sizes ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sizes:
    """Sizes of a fault: each order of magnitude is as likely, from what is usual to what can be.

    low, high: Of the amount, in its unit.
    source: Where both come from.
    """

    low: float
    high: float
    source: str

    def draw(self, rng, count=None):
        return np.exp(rng.uniform(np.log(self.low), np.log(self.high), count))

    def signed(self, rng, count=None):
        return self.draw(rng, count) * rng.choice([-1.0, 1.0], count)


#: Fixed before the test seeds were drawn. "Bound" is `calibration.heliostat.diagnosis.bounds`, "prior" the prior sigma
#: of a sound heliostat (`calibration.heliostat.fitting.priors`, with sources).
SIZES = {
    "backlash": Sizes(1.5e-3, 14e-3, "measured: slew drive (Gouws, section 4.3); heliostat (Stage-STE 12.6, table 3)"),
    "worm_gear": Sizes(1.5e-3, 20e-3, "Malan, section 6.4: what explains a measured residual; ten data sheets (bound)"),
    "sag": Sizes(3e-3, 40e-3, "frames bend by some milliradians (prior); an edge that hangs by 6 cm (bound)"),
    "drift": Sizes(1e-3, 20e-3, "a post leaves EN 1090-2 in five years; sinks by 2 cm in a year (bound) [rad a year]"),
    "target_place": Sizes(0.1, 3.0, "satellite survey (prior); half a target: beyond, beams miss it [m]"),
    "target_scale": Sizes(0.01, 0.25, "corners in photos err by half a percent; tapes by a quarter (bound)"),
    "position": Sizes(0.1, 15.0, "satellite survey (prior); the place of a heliostat a few rows on [m]"),
    "time_offset": Sizes(1.0, 3600.0, "a clock that is not set for days; an hour, beyond which it is the zone [s]"),
    "wrong_target": Sizes(0.03, 0.3, "share of rows: a slip of the log; every third (no published figures)"),
    "outliers": Sizes(0.03, 0.3, "share of rows: other heliostats' beams (no published figures)"),
    "duplicates": Sizes(0.02, 0.3, "share of rows: a file read twice in part (no published figures)"),
}
#: A zero that was lost and found again is off as any: half a degree of a limit switch (prior) [rad].
ZERO_RAD = 10e-3


# --- faults -----------------------------------------------------------------------------------------------------------


def beams(seen):
    (group,) = seen.groups
    return group


def moved(seen, plant, by_xy):
    """Return observations whose spots are moved on their targets (n, 2) [m]."""
    group = beams(seen)
    spots = group.spot_m.copy()
    for row, name in enumerate(group.target):
        spots[row] += by_xy[row] @ np.asarray(plant.targets[name].axes)
    return Observations((replace(group, spot_m=spots),))


def by_values(name, changes, rows):
    """Return what other numbers do to the spots of some rows (n, 2) [m]."""
    found, (_, seen, plant) = fitted(name), units()[name]
    values = found.values.copy()
    for parameter, step in changes.items():
        values[found.design.parameters.index(parameter)] += step
    group = beams(seen)
    moves = predicted_spots(found.design, values, group, plant.targets)
    moves = np.nan_to_num(moves - predicted_spots(found.design, found.values, group, plant.targets))
    return np.where(np.asarray(rows)[:, None], moves, 0.0)


def by_angles(name, angles):
    """Return what angles of the axes (n, 2) [rad] do to the spots, to first order (n, 2) [m]."""
    step, everywhere = 1e-4, np.ones(len(units()[name][1]), dtype=bool)
    parts = [by_values(name, {f"initial_angle_{axis}": step}, everywhere) / step for axis in (1, 2)]
    return parts[0] * angles[:, :1] + parts[1] * angles[:, 1:]


def azimuths(name):
    """Return the azimuths of the normal: of the second axis but for the tilts."""
    found = fitted(name)
    normals = mirror_poses(found.design, found.values, found.observations.readings).normals(found.design)
    return np.arctan2(normals[:, 0], normals[:, 1])


def approaches(seen):
    """Return the directions of the last moves, from the reading before on the same day (n, 2)."""
    moves, order = np.zeros((len(seen), 2)), np.argsort(seen.time, kind="stable")
    recent = np.diff(seen.time[order]) <= np.timedelta64(12, "h")
    moves[order[1:][recent]] = np.sign(np.diff(seen.readings[order], axis=0))[recent]
    return moves


def with_suns(seen, change):
    group = beams(seen)
    return Observations((replace(group, sun=change(group.sun)),))


def turned_sky(seen, site, seconds):
    """Return the observations with the sun so much later: it turns about the pole."""
    latitude = np.radians(site.latitude_deg)
    pole = np.array([0.0, np.cos(latitude), np.sin(latitude)])
    turn = rotation_from_vector(-2 * np.pi / 86400 * seconds * pole)
    return with_suns(seen, lambda suns: suns @ turn.T)


def episode(name, rng):
    """Another level for up to two days, as many rows as there are."""
    design, seen, plant = units()[name]
    days = seen.time.astype("datetime64[D]")
    inner = np.unique(days)[3:-3]
    counts = [((days >= day) & (days <= day + 1)).sum() for day in inner]
    day = rng.choice(inner[np.array(counts) >= max(4, np.median(counts))])
    rows = (days >= day) & (days <= day + 1)
    level = rng.normal(0, ZERO_RAD, 2)
    return (
        design,
        moved(seen, plant, by_values(name, {"initial_angle_1": level[0], "initial_angle_2": level[1]}, rows)),
        plant,
    )


def change_point(name, rng):
    design, seen, plant = units()[name]
    days = np.sort(seen.time)
    rows = seen.time >= days[int(rng.uniform(0.3, 0.7) * len(days))]
    size = rng.normal(0, ZERO_RAD, 2)
    changes = {"initial_angle_1": size[0], "initial_angle_2": size[1]}
    return design, moved(seen, plant, by_values(name, changes, rows)), plant


def drift(name, rng):
    design, seen, plant = units()[name]
    years = np.nan_to_num((seen.time - np.nanmin(seen.time)) / np.timedelta64(31_557_600, "s"))
    rate = SIZES["drift"].signed(rng, 2)
    one = by_values(name, {"tilt_1_u": 1e-4 * np.sign(rate[0])}, np.ones(len(seen), dtype=bool)) / 1e-4 * abs(rate[0])
    two = by_values(name, {"initial_angle_1": 1e-4 * np.sign(rate[1])}, np.ones(len(seen), dtype=bool))
    return design, moved(seen, plant, years[:, None] * (one + two / 1e-4 * abs(rate[1]))), plant


def backlash(name, rng):
    design, seen, plant = units()[name]
    play = SIZES["backlash"].draw(rng, 2)
    return design, moved(seen, plant, by_angles(name, approaches(seen) / 2 * play)), plant


def worm_gear(name, rng):
    design, seen, plant = units()[name]
    stroke = seen.readings[:, 1] / design.parameters.value("increment_2")
    wave = SIZES["worm_gear"].draw(rng) * np.sin(2 * np.pi * rng.uniform(15, 60) * stroke + rng.uniform(0, 6))
    return design, moved(seen, plant, by_angles(name, np.column_stack([0 * wave, wave]))), plant


def sag(name, rng):
    design, seen, plant = units()[name]
    angle = azimuths(name)
    bent = SIZES["sag"].draw(rng) * np.cos(angle + rng.uniform(0, 6))
    return design, moved(seen, plant, by_angles(name, np.column_stack([0 * bent, bent]))), plant


def target_place(name, rng):
    design, seen, plant = units()[name]
    labels = np.array(beams(seen).target)
    names, counts = np.unique(labels, return_counts=True)
    wrong = rng.choice(names[counts >= 20])
    way = rng.uniform(0, 2 * np.pi)
    step = SIZES["target_place"].draw(rng) * np.array([np.cos(way), np.sin(way)])
    return design, moved(seen, plant, np.where((labels == wrong)[:, None], step, 0.0)), plant


def target_scale(name, rng):
    """Spots far from the middle of the targets, as few plants have them, and targets larger or smaller than stated."""
    design, seen, plant = units()[name]
    away = rng.normal(0, 250.0, (len(seen), 2))
    group = beams(seen)
    found = fitted(name)
    pointings = [
        Pointings(group.pointings.readings + one, group.pointings.row, group.pointings.time) for one in (0 * away, away)
    ]
    before, after = (
        predicted_spots(found.design, found.values, replace(group, pointings=one), plant.targets) for one in pointings
    )
    steered = moved(seen, plant, np.nan_to_num(after - before))
    group = replace(beams(steered), pointings=pointings[1])
    xy = np.array([plant.targets[n].coordinates(s[None])[0] for n, s in zip(group.target, group.spot_m, strict=True)])
    half = np.array([(plant.targets[n].width_m / 2, plant.targets[n].height_m / 2) for n in group.target])
    near = (np.abs(xy) < 0.8 * half).all(axis=1)
    seen = Observations((group,)).select(near)
    return design, moved(seen, plant, SIZES["target_scale"].signed(rng) * xy[near]), plant, seen


def wrong_target(name, rng):
    design, seen, plant = units()[name]
    group = beams(seen)
    names, spots = np.array(group.target, dtype=object), group.spot_m.copy()
    used = sorted(set(group.target))
    for row in np.flatnonzero(rng.random(len(seen)) < SIZES["wrong_target"].draw(rng)):
        other = rng.choice([one for one in used if one != names[row]])
        spots[row] = plant.targets[other].points(plant.targets[names[row]].coordinates(spots[row][None]))[0]
        names[row] = other
    return design, Observations((replace(group, spot_m=spots, target=tuple(names)),)), plant


def outliers(name, rng):
    """Beams of others: anywhere on the target."""
    design, seen, plant = units()[name]
    group = beams(seen)
    rows = rng.random(len(seen)) < SIZES["outliers"].draw(rng)
    xy = np.array([plant.targets[n].coordinates(s[None])[0] for n, s in zip(group.target, group.spot_m, strict=True)])
    half = np.array([(plant.targets[n].width_m / 2, plant.targets[n].height_m / 2) for n in group.target])
    return design, moved(seen, plant, np.where(rows[:, None], rng.uniform(-1, 1, xy.shape) * half - xy, 0.0)), plant


def duplicates(name, rng):
    design, seen, plant = units()[name]
    group = beams(seen)
    again = np.concatenate(
        [
            np.arange(len(seen)),
            rng.choice(len(seen), max(2, round(SIZES["duplicates"].draw(rng) * len(seen))), replace=False),
        ]
    )
    points = group.pointings
    pointings = Pointings(points.readings[again], np.arange(again.size), points.time[again])
    return (
        design,
        Observations(
            (
                BeamSpots(
                    pointings,
                    group.sun[again],
                    group.spot_m[again],
                    group.covariance_m2[again],
                    tuple(group.target[row] for row in again),
                ),
            )
        ),
        plant,
    )


def actuator_numbers(name, rng):
    """Actuators' numbers of another heliostat of the field, as BF41 at Juelich has them."""
    design, seen, plant = units()[name]
    other = units()[str(rng.choice([one for one in units() if one != name]))][0].parameters
    numbers = ("initial_stroke", "initial_angle", "offset", "pivot_radius", "increment")
    return (
        design.with_value({f"{one}_{axis}": other.value(f"{one}_{axis}") for one in numbers for axis in (1, 2)}),
        seen,
        plant,
    )


def position(name, rng):
    design, seen, plant = units()[name]
    way = rng.uniform(0, 2 * np.pi)
    away = SIZES["position"].draw(rng) * np.array([np.cos(way), np.sin(way)])
    place = {"position_e": design.position_m[0] + away[0], "position_n": design.position_m[1] + away[1]}
    return design.with_value(place), seen, plant


def time_offset(name, rng):
    design, seen, plant = units()[name]
    return design, turned_sky(seen, plant.site, float(SIZES["time_offset"].signed(rng))), plant


def hours_off(name, rng):
    """Local times taken for UTC or the other way round: an hour at Juelich, two in summer."""
    design, seen, plant = units()[name]
    return design, turned_sky(seen, plant.site, 3600.0 * rng.choice([-2, -1, 1, 2])), plant


def sun_convention(name, rng):
    design, seen, plant = units()[name]
    form = rng.choice(3)
    signs = ([1, -1, 1], [-1, -1, 1], [-1, 1, 1])[form]
    return design, with_suns(seen, lambda suns: suns * signs), plant


def swapped_axes(name, rng):
    design, seen, plant = units()[name]
    group = beams(seen)
    points = group.pointings
    return (
        design,
        Observations((replace(group, pointings=Pointings(points.readings[:, ::-1], points.row, points.time)),)),
        plant,
    )


def inverted_axis(name, rng):
    design, seen, plant = units()[name]
    axis = int(rng.integers(2))
    drives = list(design.drives)
    drives[axis] = replace(drives[axis], clockwise=not drives[axis].clockwise)
    return replace(design, drives=tuple(drives)), seen, plant


def mirrored_spots(name, rng):
    design, seen, plant = units()[name]
    group = beams(seen)
    xy = np.array([plant.targets[n].coordinates(s[None])[0] for n, s in zip(group.target, group.spot_m, strict=True)])
    signs = ([-2.0, 0.0], [0.0, -2.0])[rng.integers(2)]
    return design, moved(seen, plant, xy * signs), plant


def target_names_exchanged(name, rng):
    design, seen, plant = units()[name]
    group = beams(seen)
    one, other = rng.choice(sorted(set(group.target)), 2, replace=False)
    swap = {one: other, other: one}
    names, spots = list(group.target), group.spot_m.copy()
    for row, said in enumerate(group.target):
        if said in swap:
            names[row] = swap[said]
            spots[row] = plant.targets[swap[said]].points(plant.targets[said].coordinates(spots[row][None]))[0]
    return design, Observations((replace(group, spot_m=spots, target=tuple(names)),)), plant


def constant_column(name, rng):
    design, seen, plant = units()[name]
    group = beams(seen)
    readings = group.pointings.readings.copy()
    readings[:, 1] = readings[0, 1]
    points = group.pointings
    return design, Observations((replace(group, pointings=Pointings(readings, points.row, points.time)),)), plant


def site(name, rng):
    """Give the site a latitude or longitude of the wrong sign: the suns are those of the other hemisphere."""
    design, seen, plant = units()[name]
    wrong = [
        replace(plant.site, latitude_deg=-plant.site.latitude_deg),
        replace(plant.site, longitude_deg=-plant.site.longitude_deg),
    ]
    elsewhere = wrong[int(rng.integers(2))]
    group = beams(seen)
    known = ~np.isnat(seen.time)
    suns = group.sun.copy()
    suns[known] = sun_directions(seen.time[known], elsewhere)
    seen = Observations((replace(group, sun=suns),)).select(known & (suns[:, 2] > 0.05))
    return design, seen, replace(plant, site=elsewhere)


FAULTS = {
    "episode": episode,
    "change_point": change_point,
    "drift": drift,
    "backlash": backlash,
    "worm_gear": worm_gear,
    "sag": sag,
    "target_place": target_place,
    "target_scale": target_scale,
    "wrong_target": wrong_target,
    "outliers": outliers,
    "duplicates": duplicates,
    "constant_column": constant_column,
    "actuator_numbers": actuator_numbers,
    "position": position,
    "time_offset": time_offset,
    "time_offset (hours)": hours_off,
    "sun_convention": sun_convention,
    "site": site,
    "swapped_axes": swapped_axes,
    "inverted_axis": inverted_axis,
    "mirrored_spots": mirrored_spots,
    "target_names_exchanged": target_names_exchanged,
}


# --- whether a fault can be seen --------------------------------------------------------------------------------------

#: Numbers that a fault has, and dates or periods among which it is looked for; the others are in the records as a
#: whole, with none.
NUMBERS = {
    "episode": (2, 300),
    "change_point": (2, 70),
    "drift": (2, 1),
    "backlash": (2, 1),
    "worm_gear": (2, 116),
    "sag": (2, 1),
    "target_place": (2, 1),
    "target_scale": (2, 1),
    "actuator_numbers": (4, 1),
    "position": (2, 1),
    "time_offset": (1, 1),
}
#: Terms that share the chance of a false alarm, and that chance.
TERMS, SIGNIFICANCE, POWER = 15, 0.005, 0.95
#: Rows off are a fault of the records from so many and so large a share on; the fit rejects a row from here on.
ROWS, SHARE, REJECTED_SIGMAS = 4, 0.035, 6.7
#: What the records show by themselves.
RECORDED = ("duplicates", "constant_column", "site")
LINEAR = tuple(kind for kind in NUMBERS if kind not in ("actuator_numbers", "position", "time_offset"))


def is_detectable(name, kind, design, seen, plant, before):
    """Return whether a test at the significance in use sees a fault with a power of 95 %.

    Linear faults: what no number of the heliostat imitates of them (information matrix, priors included; for faults in
    time also numbers that have not been freed), against scatter and smooth errors of sound heliostats. Faults that are
    not linear: what the fit to the spoilt records leaves beyond that to the sound ones.
    before: The observations without the fault.
    """
    if kind in RECORDED:
        return True
    sound = fitted(name) if before is units()[name][1] else fit(units()[name][0], before, ESTIMATED)
    if kind in ("outliers", "wrong_target"):
        off = np.linalg.norm(differences(sound, seen).reshape(-1, 2), axis=1) > REJECTED_SIGMAS + 1.645
        return bool(off.sum() > max(ROWS, SHARE * len(seen)))
    level = SIGNIFICANCE * ODDS_OF_A_FAULT
    spare = 2 * len(seen) - sound.n_free
    if kind in LINEAR:
        excess = linear_excess(sound, kind, seen)
    else:
        spoilt = fit(design, seen, ESTIMATED)
        if not spoilt.residuals.computable.all():
            return True
        excess = float(np.mean(spoilt.residuals.lengths**2) / np.mean(sound.residuals.lengths**2)) - 1
    if kind not in NUMBERS:
        # Logarithms of likelihood ratios scatter by the root of twice themselves; rows of a day share their errors.
        evidence = np.unique(seen.time.astype("datetime64[D]")).size * np.log1p(max(excess, 0.0))
        return bool(evidence - 1.645 * np.sqrt(2 * evidence) > np.log(2 / level))
    numbers, looks = NUMBERS[kind]
    gains = GAINS[class_of(kind)]
    mean = (1 + 2 * np.log(looks) / numbers) / spare + gains.mean
    freedom = min(gains.freedom, spare)
    limit = f_distribution.isf(level / TERMS, numbers, freedom)
    return bool(ncf.sf(limit, numbers, freedom, max(excess, 0.0) / mean) >= POWER)


def differences(sound, seen):
    """Return what a fault adds to the residuals of the sound fit [scatter of the rows] (2 n,)."""
    added = evaluate(sound.nominal, sound.values, seen, columns=[0]).whitened - sound.residuals.whitened
    return np.nan_to_num(added / sound.factor[sound.residuals.owner])


def linear_excess(sound, kind, seen):
    """Return what no number imitates of a fault, over what is left of the sound heliostat (squares)."""
    model = linear_fit(sound)
    added = model.padded(differences(sound, seen)[:, None])[:, 0] / model.scale
    others = model.base / np.where(model.observed, model.scale, 1.0)[:, None]
    if kind in ("episode", "change_point", "drift"):
        columns, sigmas = further_numbers(Terms(sound, sound.residuals.computable))
        wide = np.concatenate([model.padded(columns) / model.scale, np.diag(1 / sigmas)])
        others = np.concatenate([np.concatenate([others, np.zeros((len(sigmas), others.shape[1]))]), wide], axis=1)
        added = np.append(added, np.zeros(len(sigmas)))
    size = np.linalg.norm(others, axis=0)
    others = others[:, size > 0] / size[size > 0]
    left = added - others @ np.linalg.lstsq(others, added, rcond=1e-9)[0]
    return float(left @ left) / float(np.sum((model.lengths() / model.scale) ** 2))
