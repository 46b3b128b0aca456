"""Faulty heliostats and faulty records of them, each with the name under which it is reported."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from data_synth.heliostats.campaign import Changes, Disturbances
from data_synth.heliostats.mechanics import TrueHeliostat
from heliogauge.errors import InputError

#: What each fault does; the keys are what ``--fault`` takes.
FAULTS: Mapping[str, str] = {
    "wrong-actuator": "heliostats.csv holds another actuator's numbers",
    "moved": "heliostats.csv has it 2 m from where it stands",
    "change-point": "something gave way: its zero references jump by some milliradians on a day",
    "drift": "its zero references drift by 8 mrad in a year",
    "backlash": "play of 4 mrad in both drives",
    "outliers": "a tenth of its spots are someone else's beam",
    "wrong-target": "a fifth of its rows name another target",
    "south-azimuth": "its sun azimuths are counted from south, positive to the east",
    "local-time": "its times are local (two hours ahead) but say UTC",
    "stuck-reading": "the second drive's logged reading never changes",
    "duplicates": "a tenth of its rows are there twice",
    "few": "only two observations",
}
_JUMP_RAD = 4e-3
_DRIFT_RAD = 8e-3
_PLAY_RAD = 4e-3
_MOVED_M = (1.6, -1.2, 0.0)
#: Another unit's stroke at reading 0 differs by some millimetres.
_STROKE_M = 6e-3

Columns = dict[str, list[Any]]


@dataclass(frozen=True, slots=True, eq=False)
class Unit:
    """A heliostat as it is, as it is described, and what befalls it.

    true: As it is at first.
    stated: Its numbers as heliostats.csv has them.
    disturbances: Of its measurements.
    changes: In time.
    faults: Names of its faults.
    """

    true: TrueHeliostat
    stated: Mapping[str, float]
    disturbances: Disturbances
    changes: Changes = field(default_factory=Changes)
    faults: tuple[str, ...] = ()


def spoiled(unit: Unit, fault: str, days: tuple[str, ...]) -> Unit:
    """Give a heliostat a fault.

    InputError: There is no such fault, or this kind of heliostat cannot have it.
    """
    if fault not in FAULTS:
        raise InputError(f"fault {fault!r} of a heliostat: {', '.join(FAULTS)} are known")
    made = replace(unit, faults=(*unit.faults, fault))
    if fault == "wrong-actuator":
        if unit.true.kind != "linear-actuators":
            raise InputError(f"fault wrong-actuator: a heliostat of kind {unit.true.kind} has no linear actuators")
        stroke = {"initial_stroke_1": unit.stated["initial_stroke_1"] + _STROKE_M}
        return replace(made, stated={**unit.stated, **stroke})
    if fault == "moved":
        away = zip(("position_e", "position_n", "position_u"), _MOVED_M, strict=True)
        return replace(made, stated={**unit.stated, **{name: unit.stated[name] + step for name, step in away}})
    if fault == "change-point":
        return replace(made, changes=Changes(_zeros(unit.true, _JUMP_RAD), days[len(days) // 2]))
    if fault == "drift":
        return replace(made, changes=Changes(per_year=_zeros(unit.true, _DRIFT_RAD)))
    if fault == "backlash":
        first, second = (replace(flaw, backlash_rad=_PLAY_RAD) for flaw in unit.true.flaws)
        return replace(made, true=replace(unit.true, flaws=(first, second)))
    if fault == "outliers":
        return replace(made, disturbances=replace(unit.disturbances, outliers=0.1, outlier_m=1.0))
    return made


def _zeros(true: TrueHeliostat, size: float) -> dict[str, float]:
    names = ("azimuth_offset", "elevation_offset") if "azimuth_offset" in true.values else ("tilt_1_u", "tilt_2_e")
    return {names[0]: size, names[1]: -0.5 * size}


def spoil_rows(
    columns: Columns, faults: tuple[str, ...], targets: tuple[str, ...], rng: np.random.Generator
) -> tuple[Columns, dict[str, list[int]]]:
    """Spoil the records of a heliostat.

    faults: Its faults; those that leave the records as they are are passed over.
    Returns: For each of these faults the rows concerned, counted from 0 among those of the heliostat.
    """
    touched: dict[str, list[int]] = {}
    for fault in faults:
        if fault in _ROW_FAULTS:
            columns, touched[fault] = _ROW_FAULTS[fault](columns, targets, rng)
    return columns, touched


def _wrong_target(columns: Columns, targets: tuple[str, ...], rng: np.random.Generator) -> tuple[Columns, list[int]]:
    if len(targets) < 2:
        raise InputError("fault wrong-target: two targets are needed")
    rows = _some(columns, 0.2, rng)
    names = list(columns["target"])
    for row in rows:
        others = [name for name in targets if name != names[row]]
        names[row] = others[int(rng.integers(len(others)))]
    return {**columns, "target": names}, rows


def _south_azimuth(columns: Columns, targets: tuple[str, ...], rng: np.random.Generator) -> tuple[Columns, list[int]]:
    azimuths = [round((180.0 - value + 180) % 360 - 180, 6) for value in columns["sun_azimuth_deg"]]
    return {**columns, "sun_azimuth_deg": azimuths}, list(range(len(azimuths)))


def _local_time(columns: Columns, targets: tuple[str, ...], rng: np.random.Generator) -> tuple[Columns, list[int]]:
    times = [datetime.fromisoformat(text) + timedelta(hours=2) for text in columns["time_utc"]]
    texts = [time.isoformat(timespec="milliseconds").replace("+00:00", "Z") for time in times]
    return {**columns, "time_utc": texts}, list(range(len(times)))


def _stuck_reading(columns: Columns, targets: tuple[str, ...], rng: np.random.Generator) -> tuple[Columns, list[int]]:
    name = next(name for name in columns if name.startswith("axis_2_"))
    return {**columns, name: columns[name][:1] * len(columns[name])}, list(range(1, len(columns[name])))


def _duplicates(columns: Columns, targets: tuple[str, ...], rng: np.random.Generator) -> tuple[Columns, list[int]]:
    rows = _some(columns, 0.1, rng)
    count = len(columns["time_utc"])
    doubled = {name: column + [column[row] for row in rows] for name, column in columns.items()}
    return doubled, list(range(count, count + len(rows)))


def _few(columns: Columns, targets: tuple[str, ...], rng: np.random.Generator) -> tuple[Columns, list[int]]:
    return {name: column[:2] for name, column in columns.items()}, []


def _some(columns: Columns, share: float, rng: np.random.Generator) -> list[int]:
    count = len(columns["time_utc"])
    return sorted(int(row) for row in rng.choice(count, max(1, round(share * count)), replace=False))


_ROW_FAULTS: Mapping[str, Callable[[Columns, tuple[str, ...], np.random.Generator], tuple[Columns, list[int]]]] = {
    "wrong-target": _wrong_target,
    "south-azimuth": _south_azimuth,
    "local-time": _local_time,
    "stuck-reading": _stuck_reading,
    "duplicates": _duplicates,
    "few": _few,
}
