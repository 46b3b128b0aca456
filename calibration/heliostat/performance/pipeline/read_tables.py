"""Tables of tests: times, places of beams, and what is wrong with them, said in sentences."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from heliogauge.doubts import Doubt
from heliogauge.errors import InputError
from heliogauge.geometry.sun import Site, angles_from_direction, sun_directions, utc_times
from heliogauge.measurement.load import load
from heliogauge.results.folder import read_table_csv
from heliogauge.validate import FloatArray, IntArray, TimeArray

#: A beam further from its aim than this cannot be seen on a target; a column of another unit can be read so [rad].
MOST_BEAM_RAD = 0.1
#: A table's own sun further than this from the computed one is of another time or place [rad].
MOST_SUN_RAD = np.radians(0.5)
#: What a unit at the end of a column's name means in rad.
ANGLES = {"_rad": 1.0, "_mrad": 1e-3, "_deg": np.pi / 180, "_urad": 1e-6}
LENGTHS = {"_m": 1.0, "_mm": 1e-3}
_USED = ""
#: Table of measured beams in a folder of results of `heliogauge beam measure`.
BEAMS_FILE = "beams.csv"


@dataclass(frozen=True, slots=True, eq=False)
class BeamTable:
    """Beams of a table in the order of time.

    times (n,): UTC.
    values (n, 2): Right and up: places on the target [m], or angles from the aim [rad].
    is_angle: Which of both.
    sigma (n, 2): Of them; NaN where the table has none.
    wind_m_s (n,): NaN where not known [m/s].
    approach: From where each aim was approached; empty where not said.
    reasons: Why a row is not used; empty where it is.
    file: Where each row comes from.
    """

    times: TimeArray
    values: FloatArray
    is_angle: bool
    sigma: FloatArray
    wind_m_s: FloatArray
    approach: tuple[str, ...]
    reasons: tuple[str, ...]
    sun_seen: FloatArray
    doubts: tuple[Doubt, ...]


def numbers_of(path: Path, table: dict[str, list[str]], name: str) -> FloatArray:
    """Return a column as numbers, NaN for empty cells.

    InputError: A cell that is no number; the message names the row.
    """
    values = np.full(len(table[name]), np.nan)
    for row, cell in enumerate(table[name]):
        if cell:
            try:
                values[row] = float(cell)
            except ValueError:
                raise InputError(f"{path}: {name}, row {row + 1}: {cell!r} is no number") from None
            if np.isinf(values[row]):
                raise InputError(f"{path}, row {row + 1}: {name} = {cell} is not finite; leave the cell empty")
    return values


def scaled_column(
    path: Path, table: dict[str, list[str]], stem: str, units: dict[str, float]
) -> tuple[FloatArray, str] | None:
    """Return the column of a quantity in SI units with the unit of its name; None where there is none.

    InputError: It is there without a unit, or in two.
    """
    found = [unit for unit in units if stem + unit in table]
    if len(found) > 1:
        raise InputError(f"{path}: the columns {stem}{found[0]} and {stem}{found[1]} say the same; keep one")
    if not found:
        if stem in table:
            raise InputError(f"{path}: the column {stem!r} has no unit; name it {', '.join(stem + u for u in units)}")
        return None
    return units[found[0]] * numbers_of(path, table, stem + found[0]), found[0]


def read_times(path: Path, table: dict[str, list[str]], name: str = "time_utc") -> TimeArray:
    """Return instants of a table; each says its time zone.

    InputError: One that cannot be read or says none.
    """
    if name not in table:
        raise InputError(f"{path}: the column {name} is missing; there are: {', '.join(table)}")
    try:
        return utc_times(table[name])
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def order_of_times(path: Path, times: TimeArray) -> tuple[IntArray, Doubt | None]:
    """Return the order of time, and a doubt where the table has another."""
    order = np.argsort(times, kind="stable")
    back = int(np.count_nonzero(np.diff(times) < np.timedelta64(0)))
    if not back:
        return order, None
    at = int(np.argmax(np.diff(times) < np.timedelta64(0)))
    return order, Doubt(
        "log_out_of_order",
        f"{path.name}: {back} rows are earlier than the row before them (the first is row {at + 2}, {times[at + 1]}); "
        "they are put in the order of time: look whether clocks were set or files joined",
        {"rows_count": back},
    )


def same_heliostat(path: Path, table: dict[str, list[str]], name: str) -> None:
    """Check that a table with a column of heliostats is of one.

    InputError: Rows of another heliostat.
    """
    others = sorted({one for one in table.get("heliostat", []) if one and one != name})
    if others:
        raise InputError(
            f"{path}: rows of {', '.join(others[:3])}, but name = {name!r}: results of another heliostat; keep "
            "its own rows"
        )


def read_beams(paths: Sequence[Path], heliostat: str) -> BeamTable:
    """Read beams of tables, or of folders of results of ``heliogauge beam measure``.

    heliostat: Its name; rows of another one are refused.
    InputError: Columns that are missing or of no unit, rows of another heliostat.
    """
    tables = [_read_one(path, heliostat) for path in paths]
    if len({one.is_angle for one in tables}) > 1:
        raise InputError(f"{paths[0].name} ...: some tables have x_m, others angles; give all in one way")
    if len(tables) == 1:
        return tables[0]
    times = np.concatenate([one.times for one in tables])
    order = np.argsort(times, kind="stable")

    def joined(parts: list[FloatArray]) -> FloatArray:
        return np.asarray(np.concatenate(parts)[order])

    reasons = [reason for one in tables for reason in one.reasons]
    approach = [side for one in tables for side in one.approach]
    return BeamTable(
        times[order],
        joined([one.values for one in tables]),
        tables[0].is_angle,
        joined([one.sigma for one in tables]),
        joined([one.wind_m_s for one in tables]),
        tuple(approach[i] for i in order),
        _without_twins(times[order], [reasons[i] for i in order]),
        joined([one.sun_seen for one in tables]),
        tuple(doubt for one in tables for doubt in one.doubts),
    )


def _table_of(path: Path) -> dict[str, list[str]]:
    """Return a table of beams: a CSV file, that of measured beams, or that of photos which are measured now."""
    if not path.is_dir():
        return read_table_csv(path)
    if (path / BEAMS_FILE).is_file():
        return read_table_csv(path / BEAMS_FILE)
    from calibration.beam import run
    from calibration.beam.pipeline import write_beams

    with TemporaryDirectory() as place:
        measured = run(load(path))
        file = Path(place) / BEAMS_FILE
        write_beams(file, measured.beams, measured.columns())
        return read_table_csv(file)


def _read_one(path: Path, heliostat: str) -> BeamTable:
    table = _table_of(path)
    same_heliostat(path, table, heliostat)
    if path.is_dir() and "time_utc" not in table:
        raise InputError(f"{path}: beams without times: give the column time_utc in the table of its photos")
    times = read_times(path, table)
    order, doubt = order_of_times(path, times)
    doubts = [] if doubt is None else [doubt]
    columns, units = [], []
    is_angle = False
    for stem in ("x", "y"):
        found = scaled_column(path, table, stem, LENGTHS) or scaled_column(path, table, stem, ANGLES)
        if found is None:
            raise InputError(f"{path}: the column {stem}_m or {stem}_mrad is missing; there are: {', '.join(table)}")
        columns.append(found[0])
        units.append(found[1])
    if (units[0] in LENGTHS) != (units[1] in LENGTHS):
        raise InputError(f"{path}: x{units[0]} and y{units[1]}: both as lengths or both as angles are needed")
    is_angle = units[0] in ANGLES
    if "_deg" in units:
        doubts.append(
            Doubt(
                "beams_in_degrees",
                f"{path.name}: x{units[0]} and y{units[1]} are read as degrees and turned into mrad (1 deg = "
                "17.45 mrad); "
                "look whether mrad were meant",
            )
        )
    sigma = np.full((times.size, 2), np.nan)
    for k, stem in enumerate(("sigma_x", "sigma_y")):
        found = scaled_column(path, table, stem, ANGLES if is_angle else LENGTHS)
        if found is not None:
            sigma[:, k] = found[0]
    wind = numbers_of(path, table, "wind_m_s") if "wind_m_s" in table else np.full(times.size, np.nan)
    approach = table.get("approach", [""] * times.size)
    seen = np.full((times.size, 2), np.nan)
    for k, name in enumerate(("sun_azimuth_deg", "sun_elevation_deg")):
        if name in table:
            seen[:, k] = np.radians(numbers_of(path, table, name))
    values = np.stack(columns, axis=1)
    reasons = [_USED if one else "no place of the beam" for one in np.isfinite(values.sum(axis=1)).tolist()]
    for row, flag in enumerate(table.get("flag", [])):
        if flag not in ("", "0", "used"):
            reasons[row] = reasons[row] or f"flagged: {flag}"
    for row, rejected in enumerate(table.get("rejected", [])):
        if rejected not in ("", "0"):
            reasons[row] = table["reason"][row] if table.get("reason") else "rejected"
    return BeamTable(
        times[order],
        values[order],
        is_angle,
        sigma[order],
        wind[order],
        tuple(approach[i] for i in order),
        _without_twins(times[order], [reasons[i] for i in order]),
        seen[order],
        tuple(doubts),
    )


def _without_twins(times: TimeArray, reasons: list[str]) -> tuple[str, ...]:
    """Give a reason to rows that have the time of an earlier one that is used."""
    last = None
    for row, (time, reason) in enumerate(zip(times, reasons, strict=True)):
        if reason == _USED:
            if last is not None and time == last:
                reasons[row] = "the same time as the row before"
            last = time
    return tuple(reasons)


def suns_of(path: Path, times: TimeArray, site: Site, seen: FloatArray | None = None) -> FloatArray:
    """Return directions to the sun, checked.

    Shapes: result (n, 3).
    seen (n, 2): The table's own azimuth and elevation; NaN where it has none [rad].
    InputError: The sun is below the horizon, or not where the table says: a wrong time zone or place.
    """
    suns = sun_directions(times, site)
    azimuth, elevation = angles_from_direction(suns)
    hours = np.arange(-12, 13)
    if (elevation < 0).any():
        row = int(np.argmax(elevation < 0))
        # Other files of the test may have sound clocks.
        near_it = np.abs(times - times[row]) < np.timedelta64(12, "h")
        fitting = [int(h) for h in hours if h and (_elevation(times[near_it], int(h), site) > 0).all()]
        near = sorted(fitting, key=abs)[:1]
        hint = (
            f"; clocks that are {abs(near[0])} h {'behind' if near[0] > 0 else 'ahead'} would explain it"
            if near
            else ""
        )
        raise InputError(
            f"{path}: at {times[row]} UTC the sun is {-np.degrees(elevation[row]):.1f} degrees below the "
            "horizon of the "
            f"site: wrong time zone, date or site{hint}; write times with their zone, such as 2026-06-21T12:00:00+02:00"
        )
    if seen is not None and np.isfinite(seen).all(axis=1).any():
        rows = np.isfinite(seen).all(axis=1)
        apart = _apart(seen[rows], np.stack([azimuth[rows], elevation[rows]], axis=1))
        if float(np.median(apart)) > MOST_SUN_RAD:
            tries = [float(np.median(_apart(seen[rows], _angles(times[rows], int(h), site)))) for h in hours]
            best = int(hours[int(np.argmin(tries))])
            hint = (
                f"; clocks set {abs(best)} h {'behind' if best > 0 else 'ahead'} would explain it"
                if min(tries) < MOST_SUN_RAD
                else ""
            )
            raise InputError(
                f"{path}: the table's sun is {np.degrees(np.median(apart)):.1f} degrees from the computed one: "
                "wrong time "
                f"zone or site{hint}"
            )
    return suns


def _angles(times: TimeArray, hours: int, site: Site) -> FloatArray:
    return np.stack(angles_from_direction(sun_directions(times + np.timedelta64(hours, "h"), site)), axis=1)


def _elevation(times: TimeArray, hours: int, site: Site) -> FloatArray:
    return _angles(times, hours, site)[:, 1]


def _apart(one: FloatArray, other: FloatArray) -> FloatArray:
    across = (one[:, 0] - other[:, 0] + np.pi) % (2 * np.pi) - np.pi
    return np.asarray(np.hypot(across * np.cos(one[:, 1]), one[:, 1] - other[:, 1]))
