"""Tests with beams on a target: tracking over days, drift, repeated approaches, wind."""

from dataclasses import dataclass

import numpy as np

from calibration.heliostat.performance.beam_series import (
    BeamSeries,
    Estimate,
    accuracy,
    near_noon,
    repeated,
)
from calibration.heliostat.performance.entries import BOUND_PROBABILITY, Entry
from calibration.heliostat.performance.extremes import CHANCE
from calibration.heliostat.performance.keys import BeamSection, HeliostatTests, files_of
from calibration.heliostat.performance.mirror_angles import LineOfSight
from calibration.heliostat.performance.pipeline.outcome import Maker, Outcome
from calibration.heliostat.performance.pipeline.read_tables import MOST_BEAM_RAD, read_beams, suns_of
from calibration.heliostat.performance.wander import Sawtooth, sawtooth, wander
from calibration.heliostat.performance.wind import class_of_wind, wind_classes
from heliogauge.adjust.f_distribution import f_tail
from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.sun import Site, angles_from_direction, sun_directions
from heliogauge.validate import FloatArray, TimeArray

_SECOND = np.timedelta64(1, "s")


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """Beams of a test with their geometry.

    series: Errors of the beam.
    places_m (n, 2): On the target [m].
    suns (n, 3): Directions to the sun.
    normal_rad (n,): Error of the normal [rad].
    """

    series: BeamSeries
    times: TimeArray
    places_m: FloatArray
    suns: FloatArray
    normal_rad: FloatArray
    wind_m_s: FloatArray
    approach: tuple[str, ...]
    line: LineOfSight
    site: Site
    doubts: tuple[Doubt, ...]
    table: dict[str, list[object]]

    def days(self) -> list[str]:
        """Return the local solar day of each beam."""
        shift = np.timedelta64(round(self.site.longitude_deg * 240), "s")
        return [str(one) for one in (self.times + shift).astype("datetime64[D]")]

    def date(self) -> str:
        """Return the days in words."""
        days = sorted(set(self.days()))
        return days[0] if len(days) == 1 else f"{days[0]} to {days[-1]}"

    def said(self, section: BeamSection) -> str:
        """Return number, time and distance of the beams in words, with the conditions given."""
        first, last = (str(one.astype("datetime64[m]"))[11:] for one in (self.times[0], self.times[-1]))
        words = [f"{len(self.times)} beams, {first} to {last} UTC, slant range {self.line.slant_range_m:.1f} m"]
        if np.isfinite(self.wind_m_s).any():
            words.append(f"wind {np.nanmin(self.wind_m_s):.1f} to {np.nanmax(self.wind_m_s):.1f} m/s")
        return "; ".join([*words, section.conditions] if section.conditions else words)


def site_of(tests: HeliostatTests) -> Site:
    """Return the site.

    InputError: There is none.
    """
    site = tests.model.site
    if site is None:
        raise InputError("[site] is needed: the sun's place is known by it")
    return Site(site.latitude_deg, site.longitude_deg, site.altitude_m, site.pressure_hpa, site.temperature_c)


def line_of_sight(tests: HeliostatTests) -> LineOfSight:
    """Return heliostat and target.

    InputError: There is no target, or the heliostat stands behind it.
    """
    target = tests.model.target
    if target is None:
        raise InputError("[target] is needed: beams were seen on it")
    return LineOfSight(
        np.array(tests.model.heliostat.position_m),
        np.array(target.center_m),
        np.radians(target.facing_azimuth_deg),
        np.radians(target.tilt_deg),
        np.array(target.aim_m),
    )


def open_beams(tests: HeliostatTests, section: BeamSection, name: str) -> Beams:
    """Read the beams of a test and turn them into angles.

    name: Of the section, for messages.
    InputError: Tables that cannot be meant, or no uncertainty of the places.
    """
    paths = [tests.path(one) for one in files_of(section.file)]
    table = read_beams(paths, tests.model.name)
    line, site, target = line_of_sight(tests), site_of(tests), tests.model.target
    scale = line.angle_scale()
    used = np.array([not reason for reason in table.reasons])
    if used.sum() < 3:
        raise InputError(f"{paths[0]}: {int(used.sum())} of {used.size} beams can be used, 3 are needed at least")
    values, sigma = table.values[used], table.sigma[used]
    if table.is_angle:
        angles, places = values, line.aim_m + values @ np.linalg.inv(scale).T
    else:
        angles, places = line.beam_angles(values), values
    if float(np.median(np.abs(angles))) > MOST_BEAM_RAD:
        raise InputError(
            f"{paths[0]}: beams are {1e3 * np.median(np.abs(angles)):.0f} mrad from their aim in the median: a "
            "unit or an "
            "origin is wrong (places are from the target's centre; columns end with _m, _mm, _mrad or _deg)"
        )
    lacking = ~np.isfinite(sigma)
    if lacking.any():
        if target is None or target.sigma_place_m is None:
            raise InputError(
                f"{paths[0]}: no uncertainty of the places: give columns sigma_x_m and sigma_y_m, or "
                "target.sigma_place_m"
            )
        sigma = np.where(lacking, target.sigma_place_m / (line.slant_range_m if table.is_angle else 1.0), sigma)
    sigma_rad = sigma if table.is_angle else np.sqrt(sigma**2 @ (scale**2).T)
    common = np.sqrt((scale**2).sum(axis=1)) * (0.0 if target is None else target.sigma_aim_m)
    times = table.times[used]
    suns = suns_of(paths[0], times, site, table.sun_seen[used])
    normals = line.normal_errors(places, suns)
    seconds = np.asarray((times - times[0]) / _SECOND, dtype=np.float64)
    share = 0.0 if target is None else target.sigma_distance_share
    series = BeamSeries(seconds, angles, sigma_rad, common, share)
    left = int(np.count_nonzero(~used))
    few = None
    if left:
        first = next(reason for reason in table.reasons if reason)
        few = Doubt(
            "beams_left_out",
            f"{name}: {left} of {used.size} beams are left out (the first: {first}); {name}_rows.csv has all reasons",
            {"left_out_count": left, "beams_count": used.size},
        )
    rows: dict[str, list[object]] = {"time_utc": [f"{one}Z" for one in table.times], "flag": list(table.reasons)}
    for key, column in (
        ("beam_right_rad", angles[:, 0]),
        ("beam_up_rad", angles[:, 1]),
        ("sigma_right_rad", sigma_rad[:, 0]),
        ("sigma_up_rad", sigma_rad[:, 1]),
        ("normal_rad", normals),
        ("wind_m_s", table.wind_m_s[used]),
    ):
        whole = np.full(used.size, np.nan)
        whole[used] = column
        rows[key] = whole.tolist()
    approach = tuple(side for side, one in zip(table.approach, used, strict=True) if one)
    doubts = gather_doubts(table.doubts, few)
    return Beams(series, times, places, suns, normals, table.wind_m_s[used], approach, line, site, doubts, rows)


def day_test(tests: HeliostatTests, section: BeamSection) -> Outcome:
    """Accuracy and precision of tracking over one or several days (C-06, C-17, C-25)."""
    beams = open_beams(tests, section, "day")
    make = Maker("day", beams.date(), beams.said(section), "beams on the target over the day")
    found = accuracy(beams.series)
    entries = [
        make.entry("beam_rms_rad", "Tracking accuracy, RMS of the beam's error", found.rms),
        make.entry("normal_rms_rad", "Tracking accuracy, RMS of the normal's error", _of_normal(beams, found.rms)),
        make.entry("beam_spread_rad", "Tracking precision, beam about its mean", found.spread),
        make.entry("beam_spread_right_rad", "Precision to the right", found.spread_each[0]),
        make.entry("beam_spread_up_rad", "Precision upwards", found.spread_each[1]),
        make.entry("beam_mean_right_rad", "Systematic offset of the beam to the right", found.mean[0]),
        make.entry("beam_mean_up_rad", "Systematic offset of the beam upwards", found.mean[1]),
        make.entry("beam_average_rad", "Mean size of the beam's error", found.average),
        make.largest("beam_largest_rad", "Largest error of the beam", beams.series),
    ]
    entries += _noon(beams, make)
    days = beams.days()
    several = sorted(set(days))
    tables = {"day_rows": beams.table}
    if len(several) > 1:
        each = []
        for one in several:
            chosen = np.array([day == one for day in days])
            if chosen.sum() >= 3:
                each.append((one, int(chosen.sum()), accuracy(beams.series.select(chosen))))
        values = np.array([result.rms.value for _, _, result in each])
        short = len(several) - len(each)
        note = f"{short} of {len(several)} days left out: fewer than 3 beams" if short else ""
        if len(each) > 1:
            spread = float(values.std(ddof=1))
            entries.append(
                make.entry(
                    "daily_rms_spread_rad",
                    f"Standard deviation of the daily accuracy over {len(each)} days",
                    Estimate(spread, spread / np.sqrt(2 * (len(each) - 1)), len(each) - 1),
                    note,
                )
            )
        tables["day_each"] = {
            "day": [one for one, _, _ in each],
            "beams_count": [count for _, count, _ in each],
            "beam_rms_rad": values.tolist(),
            "sigma_beam_rms_rad": [result.rms.sigma for _, _, result in each],
        }
    return Outcome(tuple(entries), beams.doubts, tables)


def _of_normal(beams: Beams, rms: Estimate) -> Estimate:
    """Return the normal's RMS, the noise of the centroids taken off as from the beam's."""
    raw = float(np.sqrt((beams.series.beam_rad**2).sum(axis=1).mean()))
    ratio = float(np.sqrt((beams.normal_rad**2).mean())) / max(raw, 1e-300)
    return Estimate(ratio * rms.value, ratio * rms.sigma)


def _noon(beams: Beams, make: Maker) -> list[Entry]:
    labels = (
        ("beam_noon_right_rad", "Beam at solar noon, to the right"),
        ("beam_noon_up_rad", "Beam at solar noon, up"),
    )
    method = "mean of beams within 15 minutes of culmination"
    try:
        found = near_noon(beams.series, float(np.asarray((culmination(beams) - beams.times[0]) / _SECOND)))
    except EstimationError as error:
        return [make.missing(key, label, str(error)) for key, label in labels]
    return [make.entry(key, label, one, method=method) for (key, label), one in zip(labels, found, strict=True)]


def culmination(beams: Beams) -> np.datetime64:
    """Return when the sun stands highest on the day of the first beam, to the second."""
    middle = np.datetime64(beams.days()[0], "ms") + np.timedelta64(
        round(43_200_000 - beams.site.longitude_deg * 240_000), "ms"
    )
    for reach, step in ((1800, 60), (60, 1)):
        tries = middle + np.arange(-reach, reach + 1, step) * np.timedelta64(1000, "ms")
        middle = tries[int(np.argmax(angles_from_direction(sun_directions(tries, beams.site))[1]))]
    return middle


def drift_test(tests: HeliostatTests, section: BeamSection) -> Outcome:
    """Drift, oscillation and sawtooth (C-21)."""
    beams = open_beams(tests, section, "drift")
    update_s = getattr(section, "update_s", None)
    make = Maker("drift", beams.date(), beams.said(section), "cubic over time and process with a memory")
    series, entries, trends = beams.series, [], []
    values, tooth, reason = series.beam_rad, None, ""
    try:
        tooth = sawtooth(series.times_s, values, period_s=update_s)
        if tooth.p_chance < CHANCE:
            # What repeats with each update is no drift; left in, it would pull at the cubic.
            values = values - tooth.at(series.times_s)
    except EstimationError as error:
        reason = str(error)
    for k, (key, word) in enumerate((("right", "to the right"), ("up", "upwards"))):
        found = wander(series.times_s, values[:, k], series.sigma_rad[:, k])
        trends.append(found.trend)
        entries.append(make.drift(f"{key}_beam_rad", f"Drift of the beam {word}, range of the cubic", found))
        whole, note = found.oscillation, f"memory {found.memory_s:.3g} s"
        if tooth is not None and tooth.p_chance < CHANCE:
            whole = _with_teeth(whole, tooth.height[k])
            note += f"; {1e3 * found.oscillation.value:.3g} mrad of it without the sawtooth"
        label = f"Oscillation of the beam {word}, standard deviation about the cubic"
        entries.append(make.entry(f"oscillation_{key}_beam_rad", label, whole, note))
    if tooth is None:
        entries.append(make.missing("sawtooth_right_beam_rad", "Sawtooth of the beam between updates", reason))
    else:
        entries += _sawtooth_entries(beams, make, tooth)
    rows = dict(beams.table)
    for key, trend in zip(("trend_right_rad", "trend_up_rad"), trends, strict=True):
        column = np.full(len(rows["flag"]), np.nan)
        column[[not reason for reason in rows["flag"]]] = trend
        rows[key] = column.tolist()
    return Outcome(tuple(entries), beams.doubts, {"drift_rows": rows})


def _with_teeth(oscillation: Estimate, height: Estimate) -> Estimate:
    """Return the standard deviation of oscillation and sawtooth together (an even sawtooth has height / sqrt(12))."""
    value = float(np.sqrt(oscillation.value**2 + height.value**2 / 12))
    sigma = np.hypot(oscillation.value * oscillation.sigma, height.value * height.sigma / 12) / max(value, 1e-300)
    return Estimate(value, float(sigma))


def _sawtooth_entries(beams: Beams, make: Maker, tooth: Sawtooth) -> list[Entry]:
    middle = len(beams.times) // 2
    later = beams.times[middle] + np.timedelta64(round(1000 * tooth.period_s), "ms")
    still = beams.line.still_mirror_step(beams.suns[middle], sun_directions(np.array([later]), beams.site)[0])
    note = f"period {tooth.period_s:.4g} s; a mirror that stands still as long gives {1e3 * np.hypot(*still):.2f} mrad"
    method, words = "sawtooth and cubic", (("right", "to the right"), ("up", "upwards"))
    named = [(f"sawtooth_{key}_beam_rad", f"Sawtooth of the beam between updates, {word}") for key, word in words]
    if tooth.p_chance < CHANCE:
        return [make.entry(*name, one, note, method) for name, one in zip(named, tooth.height, strict=True)]
    note = f"chance {tooth.p_chance:.2g} by noise in {tooth.tries} periods and phases; the likeliest: {note}"
    bounds = tooth.below(CHANCE)
    return [make.none_seen(*name, below, note, method) for name, below in zip(named, bounds, strict=True)]


def repeat_test(tests: HeliostatTests, section: BeamSection) -> Outcome:
    """Repeated approaches: what depends on where they came from, and what does not (C-06, C-17)."""
    beams = open_beams(tests, section, "repeat")
    make = Maker("repeat", beams.date(), beams.said(section), "repeated approaches of one aim")
    if not all(beams.approach):
        raise InputError(
            "[repeat] file: the column approach is missing or has empty cells: from where each aim was reached"
        )
    from scipy.special import stdtrit

    found = repeated(beams.series, np.array(beams.approach))
    entries = [
        make.entry("right_beam_rad", "Repeatability of the beam to the right, standard deviation", found.scatter[0]),
        make.entry("up_beam_rad", "Repeatability of the beam upwards, standard deviation", found.scatter[1]),
    ]
    doubts = list(beams.doubts)
    for k, (key, word) in enumerate((("right", "to the right"), ("up", "upwards"))):
        label = f"Difference of the beam between approaches, {word}"
        if len(found.sides) < 2:
            entries.append(make.missing(f"sides_{key}_beam_rad", label, "only one approach was tried"))
            continue
        high, low = int(np.argmax(found.means[:, k])), int(np.argmin(found.means[:, k]))
        size = float(found.means[high, k] - found.means[low, k])
        sigma = float(np.hypot(found.sigma_means[high, k], found.sigma_means[low, k]))
        spare = float(sum(found.counts) - len(found.sides))
        note = f"{found.sides[high]} against {found.sides[low]}; chance that the start makes none: {found.p_same:.2g}"
        # The two are those of all sides that lie farthest apart (Scheffe 1959).
        others = len(found.sides) - 1
        if f_tail((size / max(sigma, 1e-300)) ** 2 / others, others, spare) < CHANCE:
            entries.append(make.entry(f"sides_{key}_beam_rad", label, Estimate(size, sigma, spare), note))
        else:
            reach = float(stdtrit(spare, BOUND_PROBABILITY))
            entries.append(make.none_seen(f"sides_{key}_beam_rad", label, size + reach * sigma, note))
    if len(found.sides) > 1 and found.p_same < CHANCE:
        doubts.append(
            Doubt(
                "beam_depends_on_approach",
                f"repeat: where the beam lands depends on where it came from (chance {found.p_same:.2g}): play "
                "of a drive "
                "or a reference that slips",
                {"chance_probability": found.p_same},
            )
        )
    rows = dict(beams.table)
    whole = [""] * len(rows["flag"])
    for row, side in zip(np.flatnonzero([not reason for reason in rows["flag"]]), beams.approach, strict=True):
        whole[row] = side
    rows["approach"] = list(whole)
    return Outcome(tuple(entries), tuple(doubts), {"repeat_rows": rows})


def wind_test(tests: HeliostatTests, section: BeamSection) -> Outcome:
    """Beam accuracy in each class of wind (C-01, test 8)."""
    beams = open_beams(tests, section, "wind")
    limits = [getattr(section, name) for name in ("full_m_s", "reduced_m_s", "stow_m_s")]
    classes = wind_classes(*limits)
    index = class_of_wind(beams.wind_m_s, classes)
    unknown = int(np.count_nonzero(index < 0))
    if unknown == index.size:
        raise InputError("[wind] file: no row says wind_m_s; give the mean wind at 10 m beside each beam")
    entries, doubts = [], list(beams.doubts)
    if unknown:
        doubts.append(
            Doubt(
                "wind_not_known",
                f"wind: {unknown} of {index.size} beams have no wind and count in no class",
                {"beams_count": unknown},
            )
        )
    for place, one in enumerate(classes):
        key = one.name.lower().replace(".", "_").replace("/", "_")
        make = Maker("wind", beams.date(), beams.said(section), f"beams in wind up to {one.most_m_s:g} m/s")
        label = f"Beam accuracy in wind class {one.name} ({one.meaning}), RMS"
        chosen = index == place
        if chosen.sum() < 10:
            if one.beam_limit_rad is not None or chosen.any():
                reason = f"{int(chosen.sum())} beams in this class, at least 10 are needed"
                entries.append(make.missing(f"{key}_beam_rms_rad", label, reason))
            continue
        found = accuracy(beams.series.select(chosen), of_the_process=True)
        note = f"{int(chosen.sum())} beams, mean wind {float(np.mean(beams.wind_m_s[chosen])):.1f} m/s"
        entries.append(make.entry(f"{key}_beam_rms_rad", label, found.rms, note))
        entries.append(
            make.entry(f"{key}_beam_spread_rad", f"Beam about its mean in wind class {one.name}", found.spread, note)
        )
    return Outcome(tuple(entries), tuple(doubts), {"wind_rows": beams.table})
