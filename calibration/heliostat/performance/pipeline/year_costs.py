"""What errors cost over a year: from entries of other tests, the aperture and the weather."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibration.heliostat.performance.beam_series import Estimate
from calibration.heliostat.performance.entries import Entry
from calibration.heliostat.performance.field_sizing import clear_sky_dni
from calibration.heliostat.performance.keys import HeliostatTests, YearSection
from calibration.heliostat.performance.pipeline.beam_tests import site_of
from calibration.heliostat.performance.pipeline.outcome import Maker, Outcome
from calibration.heliostat.performance.pipeline.read_tables import numbers_of, read_times
from calibration.heliostat.performance.year import CAUSES, Aperture, Errors, Mirror, SunYear, YearTrace, gather
from heliogauge.doubts import Doubt
from heliogauge.errors import InputError
from heliogauge.geometry.sun import Site, sun_directions
from heliogauge.results.folder import read_table_csv
from heliogauge.sunlight.sun_shapes import BuieSun

#: Where each error comes from unless [year] states it.
_SOURCES = {
    "offset": ("day_beam_mean_right_rad", "day_beam_mean_up_rad"),
    "scatter": ("day_beam_spread_rad",),
    "slope": ("quality_sd_best_focus_rad", "quality_sd_rad"),
    "canting": ("quality_canting_rms_rad",),
}
_WORDS = {
    "offset": "Systematic offset of the beam",
    "scatter": "Scatter of tracking, beam",
    "slope": "Slopes of the mirror, normal",
    "canting": "Canting of facets, normal",
}
_MRAD = 1e-3
#: Offsets of the beam for the curve of intercept over offset [rad].
_OFFSETS = np.arange(0.0, 5.01e-3, 1e-3)


def year_test(tests: HeliostatTests, section: YearSection, known: Sequence[Entry]) -> Outcome:
    """Intercept over a year and what each error costs.

    known: Entries of the other tests.
    InputError: An error that was neither measured nor stated, or weather that cannot be meant.
    """
    own = tests.model.heliostat
    if own.width_m is None or own.height_m is None:
        raise InputError(
            "[heliostat] width_m and height_m are needed for [year]: how much light there is, and from where"
        )
    errors, sigmas, said = _errors(section, known)
    site = site_of(tests)
    center = np.array(section.center_m)
    facing, tilt = np.radians(section.facing_azimuth_deg), np.radians(section.tilt_deg)
    normal = np.array([np.cos(tilt) * np.sin(facing), np.cos(tilt) * np.cos(facing), np.sin(tilt)])
    width, height = section.size_m
    aperture = Aperture(center, normal, width, height, section.diameter_m is not None)
    position = np.array(own.position_m)
    if float((position - center) @ normal) <= 0:
        raise InputError("year.facing_azimuth_deg, year.tilt_deg: the heliostat is behind the aperture")
    distance = float(np.linalg.norm(center - position))
    focal = own.focal_length_m or distance
    mirror = Mirror(position, own.width_m, own.height_m, focal, own.facets or 1)
    year = _sun_year(tests, section, site)
    trace = YearTrace(mirror, aperture, BuieSun.of_share(section.circumsolar_share), year)
    area = own.width_m * own.height_m
    offered = trace.energy_per_m2() * area * _reflectance(section, known)
    base = trace.intercepts(errors)[1]
    said = f"{year.name}; aperture {width:g} m x {height:g} m at {distance:.0f} m; {said}"
    make = Maker("year", tests.date, said, "rays through the year's suns; no shading or blocking")
    entries, variance = [], float(base.var(ddof=1)) / base.size
    rows: dict[str, list[object]] = {
        name: []
        for name in ("cause", "size_mrad", "lost_share", "lost_kwh", "next_mrad_share", "lost_text", "next_mrad_text")
    }
    for cause in CAUSES:
        size = errors.size(cause)
        without = trace.intercepts(errors.without(cause))[1] if size else base
        more = trace.intercepts(errors.with_size(cause, size + _MRAD))[1]
        lost, extra = without - base, base - more
        sigma = sigmas.get(cause, 0.0)
        change = sigma
        if sigma:
            # The loss bends with the error: its slope at the error itself, one sigma up and down.
            up = trace.intercepts(errors.with_size(cause, size + sigma))[1].mean()
            down = trace.intercepts(errors.with_size(cause, max(size - sigma, 0.0)))[1].mean()
            change = float(abs(up - down)) / (size + sigma - max(size - sigma, 0.0)) * sigma
            variance += change**2
        drawn = float(lost.std(ddof=1)) / np.sqrt(lost.size)
        found = Estimate(float(lost.mean()), float(np.hypot(drawn, change)))
        entries.append(
            make.entry(f"{cause}_lost_share", f"Energy lost over the year by: {_WORDS[cause].lower()}", found)
        )
        step = Estimate(float(extra.mean()), float(extra.std(ddof=1)) / np.sqrt(extra.size))
        entries.append(
            make.entry(
                f"{cause}_next_mrad_lost_share", f"Energy lost by one mrad more of: {_WORDS[cause].lower()}", step
            )
        )
        rows["cause"].append(_WORDS[cause])
        rows["size_mrad"].append(1e3 * size)
        rows["lost_share"].append(found.value)
        rows["lost_kwh"].append(found.value * offered / 1000)
        rows["next_mrad_share"].append(step.value)
        rows["lost_text"].append(f"{100 * found.value:.2f} % ({1e3 * size:.2f} mrad)")
        rows["next_mrad_text"].append(f"{100 * step.value:.2f} %, {step.value * offered / 1000:.0f} kWh")
    intercept = Estimate(float(base.mean()), float(np.sqrt(variance)))
    entries.insert(0, make.entry("intercept_share", "Intercept over the year", intercept))
    collected = Estimate(intercept.value * offered / 1000, intercept.sigma * offered / 1000)
    entries.insert(1, make.entry("collected_kwh", "Energy that enters the aperture over the year", collected))
    curve = [float(trace.intercepts(errors.with_size("offset", one))[1].mean()) for one in _OFFSETS.tolist()]
    tables = {"year_costs": rows, "year_offsets": {"offset_rad": _OFFSETS.tolist(), "intercept_share": curve}}
    return Outcome(tuple(entries), _doubts(errors, known, section), tables)


def _errors(section: YearSection, known: Sequence[Entry]) -> tuple[Errors, dict[str, float], str]:
    by_name = {entry.name: entry for entry in known if entry.value is not None}
    values: dict[str, float] = {}
    sigmas: dict[str, float] = {}
    origins: list[str] = []
    offset = (0.0, 0.0)
    for cause, names in _SOURCES.items():
        stated = getattr(section, f"{cause}_mrad")
        if stated is not None:
            values[cause] = _MRAD * stated
            offset = (_MRAD * stated, 0.0) if cause == "offset" else offset
            origins.append(f"{cause} stated")
            continue
        found = [by_name[name] for name in names if name in by_name]
        if cause == "offset" and len(found) == 2:
            offset = (float(found[0].value or 0.0), float(found[1].value or 0.0))
            sigmas[cause] = float(np.hypot(found[0].sigma or 0.0, found[1].sigma or 0.0)) / np.sqrt(2)
        elif found and cause != "offset":
            values[cause], sigmas[cause] = float(found[0].value or 0.0), float(found[0].sigma or 0.0)
        elif cause == "canting":
            origins.append("canting not measured, counted as none")
        else:
            raise InputError(
                f"year.{cause}_mrad: no test has measured it; state it, or add the section "
                f"[{'quality' if cause == 'slope' else 'day'}]"
            )
    errors = Errors(offset, values.get("scatter", 0.0), values.get("slope", 0.0), values.get("canting", 0.0))
    return errors, sigmas, "; ".join(origins)


def _reflectance(section: YearSection, known: Sequence[Entry]) -> float:
    for one in known:
        if one.name in ("reflectance_solar_weighted_share", "reflectance_reading_share") and one.value is not None:
            return one.value
    return section.reflectance_share


def _doubts(errors: Errors, known: Sequence[Entry], section: YearSection) -> tuple[Doubt, ...]:
    measured = {entry.name for entry in known if entry.value is not None}
    if section.canting_mrad is None and "quality_canting_rms_rad" not in measured:
        return (
            Doubt(
                "canting_not_measured",
                "year: the facets' canting was neither measured nor stated; the energy that it costs is not in the sum",
            ),
        )
    return ()


def _sun_year(tests: HeliostatTests, section: YearSection, site: Site) -> SunYear:
    latitude = float(np.radians(site.latitude_deg))
    if section.dni is None:
        begin = np.datetime64("2026-01-01T00:00", "ms")
        dates = np.arange(0, 365, 5)
        minutes = np.arange(0, 1440, 30)
        offsets = (dates[:, None] * 1440 + minutes).ravel()
        times = begin + offsets.astype(np.int64) * np.timedelta64(60_000, "ms")
        suns = sun_directions(times, site)
        # Each moment stands for half an hour of five days.
        return gather(suns, clear_sky_dni(suns) * 2.5, latitude, "every day clear (Meinel and Meinel 1976)")
    path: Path = tests.path(section.dni)
    table = read_table_csv(path, ("time_utc", "dni_w_m2"))
    times = read_times(path, table)
    dni = numbers_of(path, table, "dni_w_m2")
    order = np.argsort(times, kind="stable")
    times, dni = times[order], np.nan_to_num(dni[order])
    if times.size < 100:
        raise InputError(f"{path}: {times.size} rows; a year in steps of an hour or less is needed")
    if float(dni.max()) > 1400 or float(dni.min()) < -20:
        raise InputError(f"{path}: dni_w_m2 from {dni.min():g} to {dni.max():g}: 0 to 1400 W/m2 are needed")
    step_h = float(np.median(np.diff(times)) / np.timedelta64(1, "h"))
    suns = sun_directions(times, site)
    dark = float(dni[suns[:, 2] < np.sin(np.radians(-2.0))].clip(0).sum()) / max(float(dni.clip(0).sum()), 1e-300)
    if dark > 0.02:
        raise InputError(
            f"{path}: {100 * dark:.0f} % of the light comes while the sun is below the horizon: wrong time zone or site"
        )
    days = float((times[-1] - times[0]) / np.timedelta64(1, "D"))
    name = f"{path.name}, {days:.0f} days in steps of {60 * step_h:.0f} minutes, scaled to 365 days"
    return gather(suns, dni.clip(0) * step_h * 365 / max(days, 1.0), latitude, name)
