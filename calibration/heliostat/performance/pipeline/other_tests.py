"""Tests without a series of beams: play, camera at the sun, reflectance, controller, energy, given numbers."""

import datetime
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibration.heliostat.diagnosis.backlash import (
    Backlash,
    backlash_from_marks,
    backlash_from_normals,
    normals_from_spots,
)
from calibration.heliostat.performance.beam_series import BeamSeries, Estimate, accuracy
from calibration.heliostat.performance.control_log import FAULTS, TIMES_EACH, answers
from calibration.heliostat.performance.entries import Entry
from calibration.heliostat.performance.files.limits import in_entry_unit
from calibration.heliostat.performance.keys import (
    BacklashSection,
    ControlSection,
    GivenSection,
    HeliostatTests,
    PowerSection,
    ReflectanceSection,
    SunCameraSection,
    files_of,
)
from calibration.heliostat.performance.pipeline.beam_tests import line_of_sight, site_of
from calibration.heliostat.performance.pipeline.outcome import Maker, Outcome
from calibration.heliostat.performance.pipeline.read_tables import (
    ANGLES,
    numbers_of,
    order_of_times,
    read_times,
    same_heliostat,
    scaled_column,
    suns_of,
)
from calibration.heliostat.performance.reflectance import SolarSpectrum, SolarWeighted, air_mass_1_5, solar_weighted
from calibration.heliostat.performance.wander import wander
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.sun import direction_from_angles
from heliogauge.results.folder import read_table_csv, unit_of
from heliogauge.validate import BoolArray, FloatArray

#: Mean below which a mirror is to be washed before optical tests (test 3 of Stage-STE 12.6).
WASH_BELOW = 0.89
#: Uncertainty by a gap beyond which the spectrum is doubted: what good reflectometers reach themselves (0.5 %).
GAP_THAT_COUNTS = 0.005
#: A gap with less of the sun's energy would be named with 0.00 %; it counts in the sigma all the same.
_GAP_TO_NAME = 5e-5
#: A disc of the sun less round than this is cut by a cloud or by the border.
LEAST_ROUNDNESS = 0.9
_SECOND = np.timedelta64(1, "s")


def _said(section_text: str, more: str = "") -> str:
    return "; ".join(text for text in (more, section_text) if text)


def backlash_test(tests: HeliostatTests, section: BacklashSection) -> Outcome:
    """Play of the axes: laser on the mirror (C-19), normals of beams at both ends (C-22)."""
    entries: list[Entry] = []
    doubts: list[Doubt] = []
    if section.marks is not None and section.distance_m is not None:
        path = tests.path(section.marks)
        table = read_table_csv(path, ("axis",))
        same_heliostat(path, table, tests.model.name)
        ends = []
        for stem in ("mark_1", "mark_2"):
            found = scaled_column(path, table, stem, {"_m": 1.0, "_mm": 1e-3})
            if found is None:
                raise InputError(f"{path}: the column {stem}_m is missing; there are: {', '.join(table)}")
            ends.append(found[0])
        marks = np.stack(ends, axis=1)
        make = Maker("backlash", tests.date, section.conditions, "laser on the mirror, marks on a wall")
        for axis in dict.fromkeys(table["axis"]):
            if axis not in ("azimuth", "elevation"):
                raise InputError(f"{path}: axis {axis!r}: azimuth or elevation is needed")
            chosen = marks[[one == axis for one in table["axis"]]]
            play = backlash_from_marks(chosen, section.distance_m, sigma_mark_m=section.sigma_mark_m)
            entries += _play_entries(make, axis, play, len(chosen), section.sigma_distance_m / section.distance_m)
    if section.spots is not None:
        entries += _play_of_spots(tests, section, section.spots, doubts)
    return Outcome(tuple(entries), tuple(doubts))


def _play_entries(make: Maker, axis: str, play: Backlash, count: int, share: float = 0.0, key: str = "") -> list[Entry]:
    sigma = float(np.hypot(play.sigma_full_rad, share * play.full_rad))
    note = f"{count} repetitions" if np.isfinite(sigma) else "one repetition: no scatter, no uncertainty"
    found = Estimate(play.full_rad, sigma, max(count - 1, 1) if count > 1 else np.inf)
    half = Estimate(play.half_rad, sigma / 2, found.degrees)
    return [
        make.entry(f"{axis}{key}_axis_rad", f"Backlash of the {axis} axis, end to end", found, note),
        make.entry(f"{axis}{key}_half_axis_rad", f"Backlash of the {axis} axis, plus or minus", half, note),
    ]


def _play_of_spots(tests: HeliostatTests, section: BacklashSection, name: str, doubts: list[Doubt]) -> list[Entry]:
    path = tests.path(name)
    table = read_table_csv(path, ("pair", "end"))
    same_heliostat(path, table, tests.model.name)
    places = []
    for stem in ("x", "y"):
        found = scaled_column(path, table, stem, {"_m": 1.0, "_mm": 1e-3})
        if found is None:
            raise InputError(f"{path}: the column {stem}_m is missing; there are: {', '.join(table)}")
        places.append(found[0])
    if "sun_azimuth_deg" in table and "sun_elevation_deg" in table and "time_utc" not in table:
        angles = [np.radians(numbers_of(path, table, key)) for key in ("sun_azimuth_deg", "sun_elevation_deg")]
        suns = direction_from_angles(*angles)
    else:
        suns = suns_of(path, read_times(path, table), site_of(tests))
    line = line_of_sight(tests)
    normals = normals_from_spots(line.points(np.stack(places, axis=1)), suns, line.heliostat_m)
    ends: dict[str, dict[str, int]] = {}
    for row, (pair, end) in enumerate(zip(table["pair"], table["end"], strict=True)):
        if end not in ("1", "2") or end in ends.get(pair, {}):
            raise InputError(f"{path}: row {row + 1}: pair {pair!r} needs each of the ends 1 and 2 once")
        ends.setdefault(pair, {})[end] = row
    halves = [pair for pair, both in ends.items() if len(both) < 2]
    if halves:
        doubts.append(
            Doubt("pairs_incomplete", f"{path.name}: pairs with one end only are left out: {', '.join(halves)}")
        )
    whole = [both for both in ends.values() if len(both) == 2]
    if not whole:
        raise InputError(f"{path}: no pair has both ends")
    one, other = ([both[end] for both in whole] for end in ("1", "2"))
    target = tests.model.target
    sigma = None
    if target is not None and target.sigma_place_m is not None:
        # A place on the target turns the normal by half its angle.
        sigma = 0.5 * target.sigma_place_m / line.slant_range_m
    elif len(whole) < 2:
        doubts.append(
            Doubt(
                "backlash_without_sigma",
                f"{path.name}: one pair and no target.sigma_place_m: the play has no uncertainty; repeat it",
            )
        )
    play = backlash_from_normals(normals[one], normals[other], sigma_normal_rad=sigma)
    make = Maker("backlash", tests.date, section.conditions, "normals of beams at both ends of the play")
    return _play_entries(make, "azimuth", play, len(whole), key="_by_beams")


def sun_camera_test(tests: HeliostatTests, section: SunCameraSection) -> Outcome:
    """Camera on the mirror that looks at the sun (C-20): errors of the normal."""
    doubts: list[Doubt] = []
    if section.photos is not None:
        times, angles, sigma, date = _sun_photos(tests, section, section.photos, doubts)
    else:
        times, angles, sigma, date = _sun_table(tests, section, doubts)
    # Shifts are from the first reading, whose error all of them share.
    series = BeamSeries(times, angles - angles[0], sigma, sigma[0])
    make = Maker("sun_camera", date, section.conditions, "camera on the mirror, sun's disc; angles since the start")
    found = accuracy(series)
    entries = [
        make.entry("normal_rms_rad", "Shift of the normal since the start while following the sun, RMS", found.rms),
        make.entry("normal_spread_rad", "The same about its mean", found.spread),
        make.largest("normal_largest_rad", "Largest shift of the normal since the start", series),
    ]
    try:
        for k, (key, word) in enumerate((("right", "to the right"), ("up", "upwards"))):
            one = wander(series.times_s, series.beam_rad[:, k], series.sigma_rad[:, k])
            entries.append(
                make.drift(f"drift_{key}_normal_rad", f"Drift of the normal {word}, range of the cubic", one)
            )
    except EstimationError as error:
        entries.append(make.missing("drift_right_normal_rad", "Drift of the normal", str(error)))
    rows = {
        "time_s": times.tolist(),
        "right_rad": series.beam_rad[:, 0].tolist(),
        "up_rad": series.beam_rad[:, 1].tolist(),
    }
    return Outcome(tuple(entries), tuple(doubts), {"sun_camera_rows": rows})


def _sun_table(
    tests: HeliostatTests, section: SunCameraSection, doubts: list[Doubt]
) -> tuple[FloatArray, FloatArray, FloatArray, str]:
    path = tests.path(section.file or "")
    table = read_table_csv(path)
    same_heliostat(path, table, tests.model.name)
    instants = read_times(path, table)
    order, doubt = order_of_times(path, instants)
    doubts += [] if doubt is None else [doubt]
    columns = []
    for stem in ("azimuth", "elevation"):
        found = scaled_column(path, table, stem, ANGLES)
        if found is None:
            raise InputError(f"{path}: the column {stem}_mrad is missing; there are: {', '.join(table)}")
        if found[1] == "_deg":
            doubts.append(
                Doubt(
                    "angles_in_degrees",
                    f"{path.name}: {stem}_deg is read as degrees and turned into mrad (1 deg = 17.45 mrad); "
                    "look whether "
                    "mrad were meant",
                )
            )
        columns.append(found[0][order])
    angles = np.stack(columns, axis=1)
    if section.sigma_mrad is None:
        raise InputError("sun_camera.sigma_mrad is needed with a table: the uncertainty of one reading")
    instants = instants[order]
    known = np.isfinite(angles).all(axis=1)
    keep: BoolArray = np.array(known)
    # Each time once: the first reading of it that has both angles.
    keep[np.flatnonzero(known)[1:]] = np.diff(instants[known]) > np.timedelta64(0)
    if not keep.any():
        raise InputError(f"{path}: no row has both angles; fill in azimuth and elevation")
    lost = int(np.count_nonzero(~keep))
    if lost:
        twice = lost - int(np.count_nonzero(~known))
        why = f"{lost - twice} without an angle, {twice} of the time of another"
        doubts.append(_left_out(lost, keep.size, "readings", why))
    times = np.asarray((instants[keep] - instants[keep][0]) / _SECOND, dtype=np.float64)
    sigma = np.full((times.size, 2), 1e-3 * section.sigma_mrad)
    return times, angles[keep], sigma, str(instants[0].astype("datetime64[D]"))


def _left_out(lost: int, count: int, what: str, why: str) -> Doubt:
    return Doubt(
        "sun_photos_left_out",
        f"sun_camera: {lost} of {count} {what} are left out ({why})",
        {"left_out_count": lost, "readings_count": count},
    )


def _sun_photos(
    tests: HeliostatTests, section: SunCameraSection, named: str, doubts: list[Doubt]
) -> tuple[FloatArray, FloatArray, FloatArray, str]:
    from calibration.heliostat.observations.sun_camera import sun_disc, sun_shifts_rad
    from heliogauge.images.photo_times import photo_time_s
    from heliogauge.images.photos import read_luma
    from heliogauge.measurement.files import image_files
    from heliogauge.results.folder import read_camera_json

    files = image_files(tests.folder, "sun_camera.photos", named)
    camera = read_camera_json(tests.path(section.camera or ""))
    times, discs, lost = [], [], []
    for number, file in enumerate(files):
        try:
            disc = sun_disc(read_luma(file))
        except EstimationError as error:
            lost.append(f"{file.name}: {error}")
            continue
        if disc.roundness < LEAST_ROUNDNESS:
            lost.append(f"{file.name}: the disc is {disc.roundness:.2f} as wide as long")
            continue
        if section.interval_s is not None:
            times.append(number * section.interval_s)
        else:
            time = photo_time_s(file)
            if time is None:
                raise InputError(f"{file}: no time in its EXIF; give sun_camera.interval_s")
            times.append(time[0])
        discs.append(disc)
    if lost:
        doubts.append(_left_out(len(lost), len(files), "photos", lost[0]))
    if len(discs) < 3:
        raise EstimationError(f"sun_camera: the sun is seen in {len(discs)} of {len(files)} photos, 3 are needed")
    seconds = np.array(times)
    order = np.argsort(seconds, kind="stable")
    seconds = seconds[order] - seconds[order][0]
    if (np.diff(seconds) <= 0).any():
        raise InputError("sun_camera: photos of the same time; give sun_camera.interval_s")
    centers = np.array([discs[i].center_px for i in order])
    # The camera turns with the mirror: the sun goes where the normal does not.
    angles = -sun_shifts_rad(camera, centers)
    # A centre of area knows its place to a few hundredths of a pixel at best, whatever its noise.
    sigma_px = np.array([max(discs[i].sigma_px, 0.02) for i in order])
    return seconds, angles, np.repeat((sigma_px / camera.focal_x_px)[:, None], 2, axis=1), tests.date


def reflectance_test(tests: HeliostatTests, section: ReflectanceSection) -> Outcome:
    """Solar-weighted reflectance of spectra (C-02), readings of a reflectometer."""
    entries: list[Entry] = []
    doubts: list[Doubt] = []
    tables: dict[str, Mapping[str, Sequence[object]]] = {}
    what = section.kind + (f" ({section.acceptance_mrad:g} mrad half angle)" if section.acceptance_mrad else "")
    if section.spectra is not None:
        spectrum = air_mass_1_5() if section.spectrum is None else _sun_of(tests.path(section.spectrum))
        for number, name in enumerate(files_of(section.spectra)):
            path = tests.path(name)
            waves, values, names = _spectra_of(path, tests.model.name)
            try:
                found = solar_weighted(waves, values, spectrum=spectrum, sigma_instrument=section.sigma_instrument)
            except InputError as error:
                raise InputError(f"{path}: {error}") from None
            doubts += _spectrum_doubts(path, found)
            make = Maker(
                "reflectance",
                tests.date,
                _said(section.conditions, f"{len(names)} spectra of {path.name}"),
                f"spectra weighted with {spectrum.name}",
            )
            key = "solar_weighted_share" if number == 0 else f"solar_weighted_{number + 1}_share"
            shown = found.sigma if np.isfinite(found.sigma) else float("nan")
            note = "" if np.isfinite(shown) else "one spectrum and no sigma_instrument: no uncertainty"
            entries.append(
                make.entry(key, f"Solar-weighted {what} reflectance", Estimate(found.value, shown, found.degrees), note)
            )
            tables["reflectance_samples" if number == 0 else f"reflectance_samples_{number + 1}"] = {
                "sample": list(names),
                "solar_weighted_share": found.each.tolist(),
            }
    if section.readings:
        values = np.array(section.readings)
        count = values.size
        scatter = float(values.std(ddof=1)) / np.sqrt(count) if count > 1 else float("nan")
        shared = section.sigma_reading or 0.0
        sigma = float(np.hypot(scatter, shared)) if count > 1 else (section.sigma_reading or float("nan"))
        degrees = (count - 1) * (sigma / scatter) ** 4 if count > 1 and scatter > 0 else np.inf
        make = Maker("reflectance", tests.date, _said(section.conditions, f"{count} readings"), "reflectometer")
        mean = float(values.mean())
        entries.append(
            make.entry(
                "reading_share", f"Mean {section.kind} reflectance, reflectometer", Estimate(mean, sigma, degrees)
            )
        )
        if count < 3:
            doubts.append(
                Doubt(
                    "readings_few",
                    f"reflectance: {count} readings; the test asks for 3 at least",
                    {"readings_count": count},
                )
            )
        if mean < WASH_BELOW:
            doubts.append(
                Doubt(
                    "mirror_dirty",
                    f"reflectance: {100 * mean:.1f} % in the mean; below {100 * WASH_BELOW:.0f} % the mirror is "
                    "to be washed "
                    "before optical tests",
                    {"reading_share": mean},
                )
            )
    return Outcome(tuple(entries), tuple(doubts), tables)


def _spectrum_doubts(path: Path, found: SolarWeighted) -> list[Doubt]:
    return [
        Doubt(
            "spectrum_gap",
            f"{path.name}: nothing from {gap.first_nm:g} to {gap.last_nm:g} nm, where {100 * gap.share:.2f} % of the "
            f"sun's energy is; interpolated, and {100 * gap.share * gap.reach / np.sqrt(3):.2g} % of reflectance added "
            "to the sigma",
            {"energy_share": gap.share, "first_um": gap.first_nm / 1000, "last_um": gap.last_nm / 1000},
            # The sigma has all that is lost; only a gap that outweighs what an instrument is good for is to be doubted.
            Severity.DOUBT if gap.share * gap.reach / np.sqrt(3) > GAP_THAT_COUNTS else Severity.NOTE,
        )
        for gap in found.gaps
        if gap.share > _GAP_TO_NAME
    ]


def _sun_of(path: Path) -> SolarSpectrum:
    table = read_table_csv(path, ("wavelength_nm", "irradiance"))
    try:
        return SolarSpectrum(numbers_of(path, table, "wavelength_nm"), numbers_of(path, table, "irradiance"), path.stem)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _spectra_of(path: Path, heliostat: str) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    table = read_table_csv(path, ("wavelength_nm",))
    same_heliostat(path, table, heliostat)
    names = [name for name in table if name not in ("wavelength_nm", "heliostat")]
    if not names:
        raise InputError(f"{path}: no column beside wavelength_nm; one for each sample is needed")
    scale = np.array([0.01 if name.endswith("_percent") else 1.0 for name in names])
    values = np.stack([numbers_of(path, table, name) for name in names]) * scale[:, None]
    waves = numbers_of(path, table, "wavelength_nm")
    if waves.size > 1 and (np.diff(waves) < 0).all():
        # Many spectrometers write from long to short waves.
        waves, values = waves[::-1], values[:, ::-1]
    return waves, values, tuple(names)


def control_test(tests: HeliostatTests, section: ControlSection) -> Outcome:
    """Log of the controller against what is due (C-07, tests 1 and 2)."""
    path = tests.path(section.file)
    table = read_table_csv(path, ("time_utc", "event", "state"))
    same_heliostat(path, table, tests.model.name)
    instants = read_times(path, table)
    order, doubt = order_of_times(path, instants)
    seconds = np.asarray((instants[order] - instants[order][0]) / _SECOND, dtype=np.float64)
    try:
        found = answers(
            seconds, [table["event"][i] for i in order], [table["state"][i] for i in order], section.within_s
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    if not found:
        raise InputError(f"{path}: no row has an event")
    doubts = [] if doubt is None else [doubt]
    few = [one.event for one in found if one.tried < TIMES_EACH]
    if few:
        doubts.append(
            Doubt(
                "events_tried_rarely",
                f"control: each command and fault is to be tried {TIMES_EACH} times; fewer: {', '.join(few)}",
                {"events_count": len(few)},
            )
        )
    date = str(instants[order][0].astype("datetime64[D]"))
    method = f"log of the controller, state due within {section.within_s:g} s"
    make = Maker("control", date, section.conditions, method)
    entries = []
    for key, label, is_fault in (
        ("commands", "Commands answered in time (test 1)", False),
        ("faults", "Faults answered in time (test 2)", True),
    ):
        chosen = [one for one in found if (one.event in FAULTS) is is_fault]
        tried = sum(one.tried for one in chosen)
        if not tried:
            entries.append(make.missing(f"{key}_answered_share", label, "none was tried"))
            continue
        passed = int(sum(int(one.passed.sum()) for one in chosen))
        bad = [
            f"{one.event}: {one.tried - int(one.passed.sum())} of {one.tried}" for one in chosen if not one.passed.all()
        ]
        # Bayes with an even prior: what so many trials say of the next one.
        sigma = float(np.sqrt((passed + 1) * (tried - passed + 1) / ((tried + 2) ** 2 * (tried + 3))))
        note = f"{passed} of {tried}" + (f"; not in time: {', '.join(bad)}" if bad else "")
        entries.append(make.entry(f"{key}_answered_share", label, Estimate(passed / tried, sigma), note))
        if bad:
            doubts.append(Doubt("events_not_answered", f"control: {label.lower()}: not in time {', '.join(bad)}"))
    rows: dict[str, Sequence[object]] = {
        "event": [one.event for one in found],
        "due": [one.due for one in found],
        "tried_count": [one.tried for one in found],
        "passed_count": [int(one.passed.sum()) for one in found],
        "longest_delay_s": [
            float(np.nanmax(one.delay_s)) if np.isfinite(one.delay_s).any() else float("nan") for one in found
        ],
    }
    return Outcome(tuple(entries), tuple(doubts), {"control_rows": rows})


def power_test(tests: HeliostatTests, section: PowerSection) -> Outcome:
    """Energy that the heliostat used (test 7)."""
    path = tests.path(section.file)
    table = read_table_csv(path)
    same_heliostat(path, table, tests.model.name)
    instants = read_times(path, table)
    order, doubt = order_of_times(path, instants)
    found = scaled_column(path, table, "energy", {"_kwh": 1000.0, "_wh": 1.0})
    if found is None:
        raise InputError(f"{path}: the column energy_kwh or energy_wh is missing; there are: {', '.join(table)}")
    energy, instants = found[0][order], instants[order]
    if energy.size < 2 or not np.isfinite(energy[[0, -1]]).all():
        raise InputError(f"{path}: readings at the beginning and at the end are needed")
    if (np.diff(energy[np.isfinite(energy)]) < 0).any():
        raise InputError(f"{path}: the meter runs backwards; give its reading, not the use of each interval")
    used = float(energy[-1] - energy[0])
    hours = float((instants[-1] - instants[0]) / np.timedelta64(1, "h"))
    if not hours > 0:
        raise InputError(f"{path}: all readings are of one time")
    sigma = float(np.hypot(section.sigma_share * used, section.resolution_wh / np.sqrt(6)))
    date = str(instants[0].astype("datetime64[D]"))
    make = Maker(
        "power", date, _said(section.conditions, f"{hours:.1f} h, {energy.size} readings"), "electricity meter"
    )
    entries = (
        make.entry("energy_wh", "Energy used during the test", Estimate(used, sigma)),
        make.entry("mean_w", "Mean power", Estimate(used / hours, sigma / hours)),
    )
    rows = {"time_utc": [f"{one}Z" for one in instants], "energy_wh": energy.tolist()}
    return Outcome(entries, () if doubt is None else (doubt,), {"power_rows": rows})


def given_test(tests: HeliostatTests, section: GivenSection) -> Outcome:
    """Numbers measured elsewhere, such as star reflection (C-10), as they are given.

    InputError: No row, a name without a unit or given twice, a number or a day that cannot be meant.
    """
    path = tests.path(section.file)
    table = read_table_csv(path, ("key", "value", "sigma", "method"))
    same_heliostat(path, table, tests.model.name)
    if not table["key"]:
        raise InputError(f"{path}: there is no row; a key, value, sigma and method are needed, such as sd_mrad, 1.2")
    values, sigmas = numbers_of(path, table, "value"), numbers_of(path, table, "sigma")
    entries = tuple(_given(path, table, row, values[row], sigmas[row]) for row in range(values.size))
    keys = [one.key for one in entries]
    twice = next((key for key in keys if keys.count(key) > 1), None)
    if twice is not None:
        raise InputError(f"{path}: {twice} is given {keys.count(twice)} times; keep one or give each its own name")
    return Outcome(tuple(one if one.date else replace(one, date=tests.date) for one in entries))


def _given(path: Path, table: Mapping[str, Sequence[str]], row: int, value: float, sigma: float) -> Entry:
    """Return the entry of a row; an empty value was not measured, an empty sigma is not known."""
    where = f"{path}, row {row + 1}"
    try:
        key, factor = in_entry_unit(table["key"][row])
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    for name, number in (("value", value), ("sigma", sigma)):
        if table[name][row] and not np.isfinite(number):
            raise InputError(f"{where}: {name} = {table[name][row]} is not finite; leave it empty where not known")
    if sigma <= 0:
        raise InputError(f"{where}: sigma = {sigma:g}: a positive number is needed; empty where not known")
    label, date, conditions = (table[name][row] if name in table else "" for name in ("label", "date", "conditions"))
    if date and not _is_day(date):
        raise InputError(f"{where}: date = {date!r}: a day such as 2026-06-21 is needed")
    known = np.isfinite(value)
    return Entry(
        "given",
        key,
        label or unit_of(key)[0].removesuffix("_share").replace("_", " "),
        float(factor * value) if known else None,
        float(factor * sigma) if known and np.isfinite(sigma) else None,
        method=table["method"][row],
        date=date,
        conditions=conditions,
        note="measured elsewhere" if known else "not measured",
    )


def _is_day(text: str) -> bool:
    try:
        datetime.date.fromisoformat(text)
    except ValueError:
        return False
    return True
