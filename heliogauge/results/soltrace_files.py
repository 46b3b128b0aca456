"""Files of SolTrace: whole systems (``.stinput``) and sun shapes (``.sun``), read and written."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from heliogauge.errors import InputError
from heliogauge.files.texts import read_text
from heliogauge.measurement.writer import write_text
from heliogauge.sunlight.soltrace_system import (
    APERTURES,
    SURFACES,
    Optic,
    OpticPair,
    SolTraceSystem,
    SystemElement,
    SystemStage,
    SystemSun,
    sun_of_letter,
    sun_table,
)
from heliogauge.sunlight.sun_shapes import GaussianSun, PillboxSun, SunShape

#: SolTrace takes files of versions up to its own.
_VERSION = "# SOLTRACE VERSION 3.0.0 INPUT FILE"
#: Cells of a line; the comment of an element, its last cell, may be missing.
_ELEMENT_CELLS, _OPTIC_CELLS = 29, 15
#: Beyond this many digits a count is none.
_MOST_DIGITS = 9
#: Grating, surface number and order of an optic as SolTrace writes them anew, and imaginary index and grating lines.
_PLAIN_OPTIC = ("3", "1", "4", "0", "1.1", "1.2", "1.3", "1.4")


def write_sun(path: Path, shape: SunShape) -> None:
    """Write a sun shape; what is no table is sampled to where it ends.

    InputError: Another ending, or the file cannot be written.
    """
    if path.suffix.lower() != ".sun":
        raise InputError(f"{path}: SolTrace knows a sun shape by its ending; name it {path.with_suffix('.sun').name}")
    write_text(path, "".join(f"{angle:.6g}\t{radiance:.6g}\n" for angle, radiance in sun_table(shape).tolist()))


class _Lines:
    """Lines of a file one after the other, with their numbers for messages."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lines = read_text(path, "a system of SolTrace").splitlines()
        self.number = 0

    def peek(self) -> str:
        return self._lines[self.number] if self.number < len(self._lines) else ""

    def next(self) -> str:
        if self.number >= len(self._lines):
            raise self.fault("the file ends too early")
        self.number += 1
        return self._lines[self.number - 1]

    def fault(self, what: str) -> InputError:
        return InputError(f"{self.path}, line {self.number}: {what}")

    def starting(self, *starts: str) -> str:
        """Return the next line, which must begin with one of some words."""
        line = self.next()
        if not line.startswith(starts):
            raise self.fault(f"{starts[0]!r} is needed here, not {line[:40]!r}; is this a system of SolTrace?")
        return line

    def words(self, start: str) -> list[str]:
        """Return the words of the next line, which must begin with one; SolTrace takes any spaces between these."""
        return self.starting(start).split()

    def count(self, start: str) -> int:
        line = self.next()
        text = line.removeprefix(start).strip()
        if not line.startswith(start) or not text.isdecimal() or len(text) > _MOST_DIGITS:
            raise self.fault(f"{start!r} and a number are needed here, not {line[:40]!r}")
        return int(text)

    def numbers(self, cells: list[str]) -> list[float]:
        """Return cells as numbers; an empty one is 0, as SolTrace reads it."""
        try:
            found = [float(cell) if cell.strip() else 0.0 for cell in cells]
        except ValueError as error:
            raise self.fault(str(error)) from None
        if not np.isfinite(found).all():
            raise self.fault("a number is not finite")
        return found


def read_system(path: Path) -> SolTraceSystem:
    """Read a system of SolTrace.

    path: ``.stinput`` of any version since the tables of optics stand in lines of cells.
    InputError: The file cannot be read, is none, or names optics that it does not hold.
    """
    lines = _Lines(path)
    if lines.peek().startswith("#"):
        lines.next()
    sun = _read_sun(lines)
    optics = tuple(_read_pair(lines) for _ in range(lines.count("OPTICS LIST COUNT")))
    stages = tuple(_read_stage(lines) for _ in range(lines.count("STAGE LIST COUNT")))
    known = {one.name for one in optics}
    for stage in stages:
        for element in stage.elements:
            # Rays pass a virtual stage, and an element that is off, without any optics: their cell is empty, or old.
            if element.is_on and not stage.is_virtual and element.optics not in known:
                raise InputError(f"{path}: {element.describe()} has the optics {element.optics!r}, which are not there")
    return SolTraceSystem(sun, optics, stages)


def _read_sun(lines: _Lines) -> SystemSun:
    cells = lines.words("SUN")
    places = lines.words("XYZ")
    if len(cells) < 9 or len(places) < 10:
        raise lines.fault("the two lines of the sun have too few cells")
    sigma, half_width = lines.numbers([cells[6], cells[8]])
    place = lines.numbers(places[1:4])
    use, *by_place = lines.numbers([places[5], *places[7:10]])
    count = lines.count("USER SHAPE DATA")
    rows = [lines.numbers(lines.next().split()) for _ in range(count)]
    if any(len(row) != 2 for row in rows):
        raise lines.fault("rows of USER SHAPE DATA have two numbers")
    table = np.array(rows).reshape(count, 2)
    try:
        shape = sun_of_letter(cells[4].strip().lower(), sigma, half_width, table)
    except InputError as error:
        raise lines.fault(str(error)) from None
    where = (by_place[0], by_place[1], by_place[2]) if use else None
    return SystemSun(shape, np.array(place), cells[2].strip() != "0", where)


def _read_pair(lines: _Lines) -> OpticPair:
    name = lines.starting("OPTICAL PAIR").removeprefix("OPTICAL PAIR").strip()
    return OpticPair(name, _read_optic(lines), _read_optic(lines))


def _read_optic(lines: _Lines) -> Optic:
    cells = lines.starting("OPTICAL\t", "OPTICAL.v2\t").split("\t")
    if len(cells) < _OPTIC_CELLS:
        raise lines.fault(f"a line of optics has {len(cells)} cells, {_OPTIC_CELLS} are needed")
    reflectance, transmittance, slope, specularity, index = lines.numbers(cells[5:10])
    tables: list[str] = []
    for use, count in zip(cells[15::2], cells[16::2], strict=False):
        used, rows = lines.numbers([use, count])
        tables += [lines.next() for _ in range(int(rows) if used > 0 else 0)]
    more = (*cells[2:5], *cells[10:], *tables)
    return Optic(reflectance, transmittance, 1e-3 * slope, 1e-3 * specularity, cells[1].strip() or "g", index, more)


def _read_stage(lines: _Lines) -> SystemStage:
    cells = lines.words("STAGE")
    try:
        at = {word: cells.index(word) for word in ("XYZ", "AIM", "ZROT", "VIRTUAL", "MULTIHIT", "ELEMENTS")}
        origin, aim = (lines.numbers(cells[at[word] + 1 : at[word] + 4]) for word in ("XYZ", "AIM"))
        turn = lines.numbers([cells[at["ZROT"] + 1]])[0]
        flags = [int(cells[at[word] + 1]) for word in ("VIRTUAL", "MULTIHIT", "ELEMENTS")]
        through = int(cells[cells.index("TRACETHROUGH") + 1]) if "TRACETHROUGH" in cells else 0
    except (ValueError, IndexError) as error:
        raise lines.fault(f"a stage as SolTrace writes it is needed ({error})") from None
    name = lines.next().strip()
    elements = tuple(_read_element(lines) for _ in range(flags[2]))
    return SystemStage(
        name, elements, np.array(origin), np.array(aim), turn, bool(flags[0]), bool(flags[1]), bool(through)
    )


def _read_element(lines: _Lines) -> SystemElement:
    cells = lines.next().split("\t")
    if len(cells) < _ELEMENT_CELLS:
        raise lines.fault(f"an element has {len(cells)} cells, {_ELEMENT_CELLS} are needed")
    on, *place = lines.numbers(cells[:8])
    # Empty cells are what a new element of SolTrace has.
    aperture, surface = cells[8].strip() or "r", cells[17].strip() or "f"
    if aperture not in APERTURES or surface not in SURFACES:
        raise lines.fault(f"aperture {aperture!r} and surface {surface!r}: one of them is none of SolTrace's")
    if on and place[:3] == place[3:6]:
        raise lines.fault("origin and aim point of an element are one point")
    return SystemElement(
        np.array(place[:3]),
        np.array(place[3:6]),
        place[6],
        aperture,
        tuple(lines.numbers(cells[9:17])),
        surface,
        tuple(lines.numbers(cells[18:26])),
        cells[26].strip(),
        cells[27].strip(),
        cells[28].strip() == "2",
        on != 0,
        cells[29].strip() if len(cells) > _ELEMENT_CELLS else "",
    )


def write_system(path: Path, system: SolTraceSystem) -> None:
    """Write a system as SolTrace reads it; files of surfaces are named, not written.

    InputError: Another ending, or the file cannot be written.
    """
    if path.suffix.lower() != ".stinput":
        raise InputError(f"{path}: SolTrace knows a system by its ending; name it {path.with_suffix('.stinput').name}")
    write_text(path, "\n".join(_system_lines(system)) + "\n")


def _system_lines(system: SolTraceSystem) -> Iterator[str]:
    yield _VERSION
    yield from _sun_lines(system.sun)
    yield f"OPTICS LIST COUNT\t{len(system.optics)}"
    for pair in system.optics:
        yield f"OPTICAL PAIR\t{pair.name}"
        for side in (pair.front, pair.back):
            yield from _optic_lines(side)
    yield f"STAGE LIST COUNT\t{len(system.stages)}"
    for stage in system.stages:
        flags = (("VIRTUAL", stage.is_virtual), ("MULTIHIT", stage.multiple_hits))
        words = "\t".join(f"{word}\t{int(value)}" for word, value in flags)
        yield (
            f"STAGE\tXYZ\t{_cells(stage.origin_m)}\tAIM\t{_cells(stage.aim_m)}\tZROT\t{stage.turn_deg:.12g}\t{words}\t"
            f"ELEMENTS\t{len(stage.elements)}\tTRACETHROUGH\t{int(stage.trace_through)}"
        )
        yield stage.name
        for element in stage.elements:
            yield _element_line(element)


def _sun_lines(sun: SystemSun) -> Iterator[str]:
    shape, table = sun.shape, np.zeros((0, 2))
    letter, sigma, half_width = "d", 2.73, 4.65
    if isinstance(shape, GaussianSun):
        letter, sigma = "g", 1e3 * shape.sigma_rad
    elif isinstance(shape, PillboxSun):
        letter, half_width = "p", 1e3 * shape.half_angle_rad
    else:
        table = sun_table(shape)
    use, where = (0, (39.5, 90.0, 10.0)) if sun.by_place is None else (1, sun.by_place)
    yield f"SUN\tPTSRC\t{int(sun.point_source)}\tSHAPE\t{letter}\tSIGMA\t{sigma:.12g}\tHALFWIDTH\t{half_width:.12g}"
    yield f"XYZ\t{_cells(sun.towards_m)}\tUSELDH\t{use}\tLDH\t{_cells(where)}"
    yield f"USER SHAPE DATA\t{len(table)}"
    for row in table.tolist():
        yield _cells(row)


def _optic_lines(side: Optic) -> Iterator[str]:
    more = side.more or _PLAIN_OPTIC
    cells, rest = more[:3], more[3:]
    numbers = (
        side.reflectance,
        side.transmittance,
        1e3 * side.slope_error_rad,
        1e3 * side.specularity_rad,
        side.index,
    )
    # Of the rest the first five are in every line; flags and numbers of rows of tables follow, then these rows.
    own, tables = rest[:5], rest[5:]
    counts = [cell for cell in tables if "\t" not in cell and " " not in cell.strip()][:4]
    name = "OPTICAL.v2" if counts else "OPTICAL"
    yield "\t".join([name, side.distribution, *cells, _cells(numbers), *own, *counts])
    yield from tables[len(counts) :]


def _element_line(one: SystemElement) -> str:
    cells = [
        str(int(one.is_on)),
        _cells(one.origin_m),
        _cells(one.aim_m),
        f"{one.turn_deg:.12g}",
        one.aperture,
        _cells(one.padded(one.aperture_m)),
        one.surface,
        _cells(one.padded(one.surface_numbers)),
        one.surface_file,
        one.optics,
        "2" if one.is_mirror else "1",
        one.comment,
    ]
    return "\t".join(cells)


def _cells(values: object) -> str:
    return "\t".join(f"{value:.12g}" for value in np.asarray(values, dtype=np.float64).tolist())
