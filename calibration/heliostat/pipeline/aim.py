"""Readings of calibrated heliostats for a day and a target, and where the beams of given readings go."""

import datetime
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from calibration.beam.light import search_spiral
from calibration.heliostat.exports.aim_table import EXTRAPOLATED, GOOD, OUTSIDE, Calibrated, aim_columns, beam_columns
from calibration.heliostat.exports.days import SunsOfDay
from calibration.heliostat.files.store_field import failed_heliostats
from calibration.heliostat.files.store_heliostat import read_results, stored_site
from calibration.heliostat.observations.rows import parse_time
from heliogauge.errors import InputError
from heliogauge.files.faults import explain_faults
from heliogauge.geometry.sun import Site, direction_from_angles, sun_directions
from heliogauge.results.folder import write_table_csv
from heliogauge.results.tables import read_table_csv
from heliogauge.results.whole_folder import FolderKind, WholeFolder
from heliogauge.validate import FloatArray

_ANGLES = ("azimuth", "elevation")
AIM_FILE, BEAM_FILE, SEARCH_FILE, MARK = "aim.csv", "beams.csv", "search.csv", "aim.txt"
AIMED = FolderKind(content="tables of readings", mark=MARK)
_TEXT = """\
Written by heliogauge heliostat aim from calibrated heliostats.

aim.csv     readings of both drives that put the beam on the centre of the target, row by row of time (UTC).
beams.csv   where the beams of given readings meet the plane of the target: x_m to the right and y_m up as seen from the
            field, from its centre; off_centre_mrad is the angle at the mirror between beam and centre.
search.csv  readings that look for a beam that is not on its target, step by step: aim points on a square spiral around
            its centre (right_m, up_m), half of the target's shorter side apart.

sigma_beam_mrad   expected error of the beam (root of both axes' variances) at that sun, from the calibration's map over
                  the sky; sigma_across_m the same of one axis at the target, across the line of sight.
status            good; extrapolated: the sun stands beyond those of the calibration, the sigma says by how much that
                  counts; outside the range of the drives and no position does it: no readings are given; beside the
                  target, away from the target and no readings: of given readings.
"""


@dataclass(frozen=True, slots=True)
class AimOptions:
    """Choices.

    date: Day of the table; today if None.
    step_minutes: Step of the table [min].
    target: Whose centre is aimed at; the first one if None.
    only: Heliostats by name, a text with ``*``; several with commas; all if None.
    readings: Table of readings whose beams are asked for, in place of a day.
    search: Rings of a spiral of aim points that looks for a beam at one time, in place of a day.
    time: That time, with its zone.
    force: Replace an earlier table.
    """

    date: datetime.date | None = None
    step_minutes: float = 10.0
    target: str | None = None
    only: str | None = None
    readings: Path | None = None
    search: int | None = None
    time: str | None = None
    force: bool = False


def run(result: Path, out: Path, options: AimOptions | None = None) -> list[str]:
    """Write the readings of a day, or the beams of given readings.

    result: Folder with ``heliostat.json``, or one with a folder for each heliostat.
    Returns: A sentence for each heliostat.
    InputError: No results there, no such heliostat or target, a table that cannot be read, or the folder cannot be
        used.
    """
    options = options or AimOptions()
    _refuse_both(options)
    tables, sentences = [], []
    with explain_faults(result, "a folder of results as heliogauge wrote it"):
        contents = list(chosen_heliostats(read_results(result), options.only))
        given = None if options.readings is None else _Given.read(options.readings, stored_site(contents[0]))
        if given is not None:
            given.check_names([str(content["heliostat"]) for content in contents])
        for content in contents:
            known = Calibrated.from_content(content)
            if given is not None:
                columns = given.columns(known, options.target)
            elif options.search is not None:
                columns = _of_search(known, stored_site(content), options)
            else:
                columns = _of_day(known, stored_site(content), options)
            if columns is not None:
                tables.append(columns)
                sentences.append(_sentence(known, columns))
        if given is None and options.only is None:
            sentences += [f"{name}: not calibrated: {reason}" for name, reason in failed_heliostats(result)]
    joined = {name: [cell for table in tables for cell in table[name]] for name in tables[0]}
    with WholeFolder(out, AIMED, force=options.force) as folder:
        name = SEARCH_FILE if options.search is not None else AIM_FILE if given is None else BEAM_FILE
        write_table_csv(folder / name, joined)
        (folder / MARK).write_text(_TEXT, encoding="utf-8")
    return sentences


def chosen_heliostats(contents: Iterable[Mapping[str, Any]], only: str | None) -> Iterable[Mapping[str, Any]]:
    """Return the heliostats whose names fit a text with ``*``; InputError where none does."""
    found = list(contents)
    names = [str(content["heliostat"]) for content in found]
    patterns = ["*"] if only is None else [text.strip() for text in only.split(",")]
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise InputError(f"only={pattern}: no heliostat of that name; there are {', '.join(names[:8])}")
    return [
        content for content, name in zip(found, names, strict=True) if any(fnmatchcase(name, one) for one in patterns)
    ]


def _of_day(known: Calibrated, site: Site, options: AimOptions) -> dict[str, Any]:
    date = options.date or datetime.datetime.now(datetime.UTC).date()
    day = SunsOfDay.of(date, options.step_minutes, site)
    columns = aim_columns(known, day.suns, known.target(options.target))
    return {"heliostat": columns.pop("heliostat"), "time_utc": list(day.times_utc), **columns}


def _refuse_both(options: AimOptions) -> None:
    if options.search is not None and options.readings is not None:
        raise InputError("search and readings: one of both; a search is made of aim points, readings are given")
    if (options.search is None) != (options.time is None):
        raise InputError("search and time belong together: aim points around the target at one time")


def _of_search(known: Calibrated, site: Site, options: AimOptions) -> dict[str, Any]:
    """Return readings for a spiral of aim points, all at one time."""
    target, time = known.target(options.target), parse_time(options.time or "")
    sun = sun_directions(np.array([time]), site)
    if not sun[0, 2] > 0:
        raise InputError(f"time={options.time}: the sun is below the horizon there; is it UTC?")
    offsets = search_spiral(min(target.width_m, target.height_m), options.search or 0)
    columns = aim_columns(known, np.repeat(sun, len(offsets), axis=0), target, offsets)
    name = columns.pop("heliostat")
    places = {"right_m": offsets[:, 0].tolist(), "up_m": offsets[:, 1].tolist()}
    return {
        "heliostat": name,
        "step": list(range(len(offsets))),
        "time_utc": [f"{time.astype('datetime64[s]')}Z"] * len(offsets),
        **places,
        **columns,
    }


@dataclass(frozen=True, slots=True, eq=False)
class _Given:
    """Readings that somebody asks about: rows of a table."""

    file: Path
    heliostats: tuple[str, ...]
    readings: FloatArray
    suns: FloatArray
    time_texts: tuple[str, ...]

    @classmethod
    def read(cls, file: Path, site: Site) -> "_Given":
        """Read ``heliostat, reading_1, reading_2`` with ``time_utc`` or ``sun_azimuth_deg, sun_elevation_deg``."""
        table = read_table_csv(file, ("heliostat", "reading_1", "reading_2"))
        count = len(table["heliostat"])
        if not count:
            raise InputError(f"{file}: no rows; give the readings whose beams are asked for")
        has_suns = {"sun_azimuth_deg", "sun_elevation_deg"} <= set(table)
        if not has_suns and "time_utc" not in table:
            raise InputError(f"{file}: the columns time_utc, or sun_azimuth_deg and sun_elevation_deg, are missing")
        texts = table.get("time_utc", [""] * count)
        if has_suns:
            azimuth, elevation = (np.deg2rad(_numbers(file, table, f"sun_{name}_deg")) for name in _ANGLES)
            suns = direction_from_angles(azimuth, elevation)
        else:
            suns = sun_directions(np.array([_time(file, row, text) for row, text in enumerate(texts)]), site)
        # The table of a day has no readings where the drives cannot go.
        readings = np.column_stack([_numbers(file, table, name, blank=True) for name in ("reading_1", "reading_2")])
        return cls(file, tuple(table["heliostat"]), readings, suns, tuple(texts))

    def check_names(self, known: list[str]) -> None:
        """Refuse rows of heliostats that are not calibrated."""
        for row, name in enumerate(self.heliostats):
            if name not in known:
                raise InputError(
                    f"{self.file}, row {row + 1}: heliostat {name!r} is not among the results; there are "
                    f"{', '.join(known[:8])}"
                )

    def columns(self, known: Calibrated, target: str | None) -> dict[str, Any] | None:
        """Return the beams of one heliostat's rows; None where it has none."""
        rows = np.flatnonzero([name == known.design.name for name in self.heliostats])
        if not rows.size:
            return None
        columns = beam_columns(known, self.readings[rows], self.suns[rows], known.target(target))
        texts = [self.time_texts[row] for row in rows.tolist()]
        return {"heliostat": columns.pop("heliostat"), "time_utc": texts, **columns}


def _time(file: Path, row: int, text: str) -> np.datetime64:
    if not text:
        raise InputError(f"{file}, row {row + 1}: time_utc is missing; without it nobody knows where the sun was")
    try:
        return parse_time(text)
    except InputError as error:
        raise InputError(f"{file}, row {row + 1}: {error}") from error


def _numbers(file: Path, table: Mapping[str, list[str]], name: str, *, blank: bool = False) -> FloatArray:
    """Return a column; NaN for empty cells where these may be."""
    values = np.full(len(table[name]), np.nan)
    for row, text in enumerate(table[name]):
        if blank and not text.strip():
            continue
        try:
            values[row] = float(text)
        except ValueError:
            values[row] = np.nan
        if not np.isfinite(values[row]):
            raise InputError(f"{file}, row {row + 1}: {name} = {text!r}: a finite number is needed")
    return values


def _sentence(known: Calibrated, columns: Mapping[str, list[Any]]) -> str:
    status = columns["status"]
    good = sum(one in (GOOD, EXTRAPOLATED) for one in status)
    parts = [f"{known.design.name}: {good} of {len(status)} positions on {columns['target'][0]}"]
    others = {one: status.count(one) for one in dict.fromkeys(status) if one not in (GOOD,)}
    parts += [f"{count} {name}" for name, count in others.items()]
    sigmas = [
        one for one, state in zip(columns["sigma_beam_mrad"], status, strict=True) if one != "" and state != OUTSIDE
    ]
    if sigmas:
        parts.append(f"sigma of the beam {min(sigmas):.2f} to {max(sigmas):.2f} mrad")
    else:
        parts.append("sigma of the beam not known: the results have no map over the sky")
    return "; ".join(parts)
