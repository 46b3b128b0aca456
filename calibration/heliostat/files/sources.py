"""From a measurement to one task for each heliostat: what is known of it, and its observations as text.

A task holds everything that is needed for one heliostat, so that it can be worked on in another process or on another
machine; tasks are made one at a time, so that a field of any size fits into memory.
"""

import hashlib
import math
from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np

from calibration.heliostat.files.store_paint import (
    TIMES_FILE,
    TOWER_FILES,
    PaintUnit,
    Tower,
    find_beside,
    find_units,
    read_tower,
)
from calibration.heliostat.keys import HeliostatMeasurement, HeliostatTargetSection, SiteSection
from calibration.heliostat.kinematic_model.design import PlaneTarget
from calibration.heliostat.observations.plant import Plant
from calibration.heliostat.observations.rows import NUMBER_COLUMNS, TEXT_COLUMNS, check_header, split_line
from heliogauge.doubts import Doubt
from heliogauge.errors import InputError
from heliogauge.files.regular import open_regular
from heliogauge.files.texts import read_text
from heliogauge.formula_cells import plain_cell
from heliogauge.geometry.sun import Site
from heliogauge.results.json_file import read_json
from heliogauge.results.tables import read_table_csv
from heliogauge.validate import FloatArray

#: Longest line of a table of observations, and largest record of one: real ones have some 100 B and 2 KiB.
_LONGEST_LINE, _MOST_RECORD_BYTES = 1 << 20, 16 << 20
_POSITION = ("e_m", "n_m", "u_m")
_GEODETIC = ("lat_deg", "lon_deg", "alt_m")


@dataclass(frozen=True, slots=True)
class HeliostatTask:
    """One heliostat with its observations, as text.

    cells: Its row in the table of heliostats; empty with PAINT.
    properties: Its properties file of PAINT; empty with tables.
    header: Columns of the table of observations; empty with PAINT.
    records: Line number (or number of the calibration record) and text of each observation.
    times: Times of the calibration records of PAINT, empty where not known.
    fault: Why nothing can be read of it; empty where all could.
    """

    name: str
    cells: dict[str, str] = field(default_factory=dict)
    properties: str = ""
    header: tuple[str, ...] = ()
    records: tuple[tuple[str, str], ...] = ()
    times: tuple[str, ...] = ()
    fault: str = ""

    def digest(self, shared: str) -> str:
        """Return a hash of the task and of what it shares with others."""
        return hashlib.sha256(f"{shared}\n{self!r}".encode()).hexdigest()

    def observations_digest(self) -> str:
        """Return a hash of the observations alone, in whatever order and lines they stand.

        What is known of the heliostat besides may be corrected: the measurement stays the same.
        """
        said = (self.name, self.header, sorted(text for _, text in self.records))
        return hashlib.sha256(repr(said).encode()).hexdigest()


def digest_of_all(observations: Mapping[str, str]) -> str:
    """Return a hash of the observations of a field.

    observations: Hash of each heliostat's, by its name.
    """
    return hashlib.sha256(repr(sorted(observations.items())).encode()).hexdigest()


class Source(Protocol):
    """Where heliostats come from; ``doubts`` are about rows that belong to none of them."""

    plant: Plant
    names: tuple[str, ...]
    files: tuple[Path, ...]
    doubts: tuple[Doubt, ...]

    def tasks(self, names: tuple[str, ...]) -> Iterator[HeliostatTask]:
        """Yield the task of each of these heliostats."""


def open_source(measurement: HeliostatMeasurement) -> Source:
    """Look at a measurement's tables, or at its PAINT folders.

    Returns: Names of the heliostats and a task for each.
    InputError: A file that cannot be read, a column or key that is missing or unknown, a heliostat that is listed
        twice.
    """
    return _TableSource(measurement) if measurement.model.paint is None else _PaintSource(measurement)


# --- tables -----------------------------------------------------------------------------------------------------------


class _TableSource:
    """Heliostats and observations in two tables; the second is read line by line, when a heliostat's turn comes."""

    def __init__(self, measurement: HeliostatMeasurement) -> None:
        model = measurement.model
        if model.site is None:
            raise InputError(f"{measurement.folder}: [site] is missing")
        if not model.target:
            raise InputError(
                f"{measurement.path('measurement.toml')}: [[target]] is missing: where the beams were seen"
            )
        site = model.site
        origin = (site.latitude_deg, site.longitude_deg, site.altitude_m)
        self.plant = Plant(origin, _site(site), {one.name: _target(one) for one in model.target})
        self.files = measurement.input_files
        self._observations = measurement.path(model.observations.file)
        self._cells, self._repeated = _read_heliostats(measurement.path(model.heliostats.file))
        only = next(iter(self._cells)) if len(self._cells) == 1 else None
        self._index, nameless = _index_lines(self._observations, self.header, only)
        self.names = tuple(dict.fromkeys((*self._cells, *self._index)))
        self.doubts = _doubts_of_nameless(self._observations, nameless)

    @cached_property
    def header(self) -> tuple[str, ...]:
        """Columns of the table of observations."""
        return _read_header(self._observations)

    def tasks(self, names: tuple[str, ...]) -> Iterator[HeliostatTask]:
        with open_regular(self._observations, "a CSV file") as file:
            for name in names:
                places = self._index.get(name, array("Q"))
                records = []
                for offset, number in zip(places[::2], places[1::2], strict=True):
                    file.seek(offset)
                    records.append((str(number), file.readline().decode("utf-8", "replace").rstrip("\r\n")))
                fault = self._repeated.get(name, "")
                if name not in self._cells:
                    fault = "it has observations, but no row in the table of heliostats"
                yield HeliostatTask(
                    name, self._cells.get(name, {}), header=self.header, records=tuple(records), fault=fault
                )


def _target(section: HeliostatTargetSection) -> PlaneTarget:
    if section.corners_m is not None:
        return PlaneTarget.from_corners(section.name, np.array(section.corners_m))
    return PlaneTarget.facing(
        section.name,
        np.array(section.center_m),
        np.deg2rad(section.facing_azimuth_deg or 0.0),
        float(section.width_m or 0.0),
        float(section.height_m or 0.0),
    )


def _read_heliostats(file: Path) -> tuple[dict[str, dict[str, str]], dict[str, str]]:
    """Return the row of each heliostat, and why some cannot be used: they are listed twice."""
    table = read_table_csv(file, ("heliostat",))
    if not any(all(name in table for name in names) for names in (_POSITION, _GEODETIC)):
        raise InputError(
            f"{file}: the position is missing: columns {', '.join(_POSITION)} or {', '.join(_GEODETIC)}; there are: "
            f"{', '.join(table)}"
        )
    found: dict[str, dict[str, str]] = {}
    lines: dict[str, list[int]] = {}
    for line, row in enumerate(zip(*table.values(), strict=True), start=2):
        cells = dict(zip(table, row, strict=True))
        name = cells.pop("heliostat")
        if not name:
            raise InputError(f"{file}, line {line}: the heliostat's name is missing")
        found.setdefault(name, cells)
        lines.setdefault(name, []).append(line)
    if not found:
        raise InputError(f"{file}: no heliostat is listed")
    repeated = {
        name: f"{file}: it is listed {len(own)} times, in lines {', '.join(map(str, own))}; keep one row"
        for name, own in lines.items()
        if len(own) > 1
    }
    return found, repeated


def _read_header(file: Path) -> tuple[str, ...]:
    with open_regular(file, "a CSV file") as opened:
        line = opened.readline(_LONGEST_LINE)
    try:
        first = line.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{file}: cannot be read as CSV ({error}); save it as UTF-8") from error
    header = tuple(name.strip() for name in split_line(first))
    if len(header) == 1 and (";" in first or "\t" in first):
        raise InputError(f"{file}: columns are separated by ';' or tabs; commas are needed")
    check_header(header, str(file), (*TEXT_COLUMNS, *NUMBER_COLUMNS))
    units = [unit for unit in ("counts", "deg", "rad") if f"axis_1_{unit}" in header and f"axis_2_{unit}" in header]
    if len(units) != 1:
        raise InputError(
            f"{file}: the readings of both axes are needed in one unit: axis_1_counts and axis_2_counts, or _deg, or "
            f"_rad; there are: {', '.join(header)}"
        )
    sun = [name for name in ("sun_azimuth_deg", "sun_elevation_deg") if name in header]
    if len(sun) == 1:
        raise InputError(f"{file}: {sun[0]} is alone; sun_azimuth_deg and sun_elevation_deg belong together")
    sigma = [name for name in ("sigma_x_mm", "sigma_y_mm") if name in header]
    if len(sigma) == 1:
        raise InputError(
            f"{file}: {sigma[0]} is alone; sigma_x_mm and sigma_y_mm belong together, or sigma_mm for both"
        )
    # Drones, normals and points do without the sun: with kinds it is asked for row by row.
    if not sun and "time_utc" not in header and "kind" not in header:
        raise InputError(f"{file}: where the sun was is missing: time_utc, or sun_azimuth_deg and sun_elevation_deg")
    return header


def _index_lines(
    file: Path, header: tuple[str, ...], only: str | None
) -> "tuple[dict[str, array[int]], dict[int, str]]":
    """Return where the lines of each heliostat begin and their numbers, two entries for each line.

    Returns: Why other lines belong to no heliostat, by their numbers: cut off, too long, unreadable.
    """
    if "heliostat" not in header and only is None:
        raise InputError(f"{file}: the column heliostat is missing; there are several heliostats")
    column = header.index("heliostat") if "heliostat" in header else -1
    index: dict[str, array[int]] = {}
    nameless: dict[int, str] = {}
    offset = 0
    with open_regular(file, "a CSV file") as opened:
        lines = iter(lambda: opened.readline(_LONGEST_LINE), b"")
        for number, line in enumerate(lines, start=1):
            length = len(line)
            if length == _LONGEST_LINE:
                nameless[number] = f"longer than {_LONGEST_LINE} bytes"
                while line and not line.endswith(b"\n"):
                    line = opened.readline(_LONGEST_LINE)  # the rest of the same line
                    length += len(line)
            elif number > 1 and line.strip():
                name = str(only) if column < 0 else _cell(line, column)
                if name:
                    index.setdefault(name, array("Q")).extend((offset, number))
                else:
                    nameless[number] = "the heliostat's name is missing or no UTF-8"
            offset += length
    return index, nameless


def _cell(line: bytes, column: int) -> str:
    """Return a cell; empty where the line is cut off before it or is no text."""
    try:
        if b'"' not in line:
            cells = line.split(b",", column + 1)
            return plain_cell(cells[column].decode("utf-8").strip())
        return plain_cell(split_line(line.decode("utf-8"))[column].strip())
    except (UnicodeDecodeError, IndexError):
        return ""


def _doubts_of_nameless(file: Path, nameless: dict[int, str]) -> tuple[Doubt, ...]:
    if not nameless:
        return ()
    first = next(iter(nameless))
    text = (
        f"{file.name}: {len(nameless)} rows belong to no heliostat and are left out, the first: line {first}: "
        f"{nameless[first]}"
    )
    return (Doubt("rows_without_heliostat", text, {"left_out_count": len(nameless)}),)


# --- PAINT ------------------------------------------------------------------------------------------------------------


class _PaintSource:
    """Folders of the PAINT database; files are read when a heliostat's turn comes."""

    def __init__(self, measurement: HeliostatMeasurement) -> None:
        paint = measurement.model.paint
        folder = measurement.path(paint.folder if paint is not None else ".")
        self._units = {unit.name: unit for unit in find_units(folder, () if paint is None else paint.heliostats)}
        self.names = tuple(self._units)
        self.doubts: tuple[Doubt, ...] = ()
        file = find_beside(folder, TOWER_FILES) if paint is None or paint.tower is None else folder / paint.tower
        if file is None:
            raise InputError(
                f"{folder}: the tower's file ({', '.join(TOWER_FILES[:2])}) is neither here, nor in tower/, nor above; "
                "it holds the targets' corners"
            )
        tower = read_tower(file)
        self.plant = _plant(tower, measurement.model.site)
        times = find_beside(folder, (TIMES_FILE,))
        self._times = {} if times is None else {key: str(value) for key, value in read_json(times).items()}
        self.files = (*measurement.input_files, file, *(() if times is None else (times,)))
        if len(self._units) == 1:
            # Of many, each heliostat's own hash shows what it was made from.
            (unit,) = self._units.values()
            own = () if unit.fault else (unit.properties,)
            self.files = (*self.files, *own, *unit.calibrations)

    def tasks(self, names: tuple[str, ...]) -> Iterator[HeliostatTask]:
        for name in names:
            yield self._task(self._units[name])

    def _task(self, unit: PaintUnit) -> HeliostatTask:
        faults = [unit.fault] if unit.fault else []
        properties = "" if unit.fault else _text(unit.properties, faults)
        # A record that cannot be read is a row that cannot be used, not the end of its heliostat.
        records = tuple((_number(file), _text(file, [])) for file in unit.calibrations)
        times = tuple(self._times.get(f"{unit.name}_{number}", "") for number, _ in records)
        if not records:
            faults.append(
                f"no calibration records (calibration/*_calibration_properties.json) in {unit.properties.parent}"
            )
        return HeliostatTask(
            unit.name, properties=properties, records=records, times=times, fault="; ".join(faults[:1])
        )


def _plant(tower: Tower, site: SiteSection | None) -> Plant:
    own = Site(*tower.origin) if site is None else _site(site)
    return Plant(tower.origin, own, tower.targets, tower.others)


def _site(section: SiteSection) -> Site:
    return Site(
        section.latitude_deg, section.longitude_deg, section.altitude_m, section.pressure_hpa, section.temperature_c
    )


def _text(file: Path, faults: list[str]) -> str:
    try:
        return read_text(file, "a JSON file", _MOST_RECORD_BYTES)
    except InputError as error:
        faults.append(str(error))
        return ""


def _number(file: Path) -> str:
    name = file.stem.casefold().split("calibration")[0].strip("-_")
    return name or file.stem


def position_of(cells: dict[str, str], plant: Plant) -> FloatArray:
    """Return east, north, up of a heliostat from its row of the table, shape (3,) [m].

    plant: Gives the origin where the row holds latitude, longitude and altitude.
    InputError: A cell that is empty or no finite number.
    """
    names = _POSITION if any(cells.get(name) for name in _POSITION) else _GEODETIC
    values = []
    for name in names:
        try:
            values.append(float(cells.get(name, "")))
        except ValueError:
            values.append(math.nan)
        if not math.isfinite(values[-1]):
            cell = cells.get(name, "")
            raise InputError(f"table of heliostats: {name} = {cell!r}: a finite number is needed for its position")
    if names is _GEODETIC:
        return plant.place_of(values[0], values[1], values[2], "table of heliostats: latitude_deg, longitude_deg")
    return np.array(values)
