"""From results to the next measurements: what each heliostat needs, and when whose turn it is."""

import datetime
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration.heliostat.files.store_field import failed_heliostats
from calibration.heliostat.files.store_heliostat import read_results, stored_site
from calibration.heliostat.fitting.prediction import sun_positions_of_year
from calibration.heliostat.kinematic_model.design import PlaneTarget
from calibration.heliostat.kinematic_model.store_design import design_from
from calibration.heliostat.observations.observations import Observations
from calibration.heliostat.planning.measurement_plan import (
    Knowledge,
    MeasurementPlan,
    PlanOptions,
    beam_candidates,
    plan_measurements,
)
from calibration.heliostat.planning.schedule import Need, Schedule, ScheduleOptions, propose_schedule
from heliogauge.errors import EstimationError, InputError
from heliogauge.files.faults import explain_faults
from heliogauge.geometry.sun import Site, angles_from_direction
from heliogauge.results.folder import write_json, write_table_csv
from heliogauge.results.whole_folder import FolderKind, WholeFolder
from heliogauge.validate import FloatArray

PLAN_FILE, NEEDS_FILE, SCHEDULE_FILE, MARK = "measurements.csv", "heliostats.csv", "schedule.csv", "plan.json"
PLAN = FolderKind(content="plans", mark=MARK)
# The sun's way changes by less than 2 degrees in 5 days: more dates add no other positions.
_DATES, _STEP_MINUTES = 8, 30
_PER_DAY_OF_YEAR = 12


@dataclass(frozen=True, slots=True)
class NextOptions:
    """What to plan.

    first_day: First day of the measurements; today without.
    days: How many days there are.
    goal_rad: Sigma of the beam over a year that shall be reached [rad].
    sigma_m: Of a measured centre of a beam, each axis [m].
    most: Measurements of one heliostat at most.
    per_day: Heliostats a day at most; 0 for as many as there is room for.
    slot_minutes: How long a beam keeps a target busy [min].
    target: Target whose centre stands for where the beam shall go; the first one if None.
    force: Replace an earlier plan.
    InputError: Days that cannot be.
    """

    first_day: datetime.date | None = None
    days: int = 30
    goal_rad: float = 1e-3
    sigma_m: float = 0.02
    most: int = 12
    per_day: int = 0
    slot_minutes: float = 3.0
    target: str | None = None
    force: bool = False

    def __post_init__(self) -> None:
        if not 1 <= self.days <= 366:
            raise InputError(f"days={self.days}: between 1 and 366 days are needed")

    @property
    def dates(self) -> "np.ndarray[tuple[int, ...], np.dtype[np.datetime64]]":
        """The days, shape (days,)."""
        first = datetime.datetime.now(datetime.UTC).date() if self.first_day is None else self.first_day
        return np.datetime64(first, "D") + np.arange(self.days)


@dataclass(frozen=True, slots=True, eq=False)
class Planned:
    """What one heliostat needs.

    plan: Its measurements; None where nothing could be planned.
    candidates: What the plan chose from.
    reason: The plan in one sentence, or why there is none.
    faults: Kinds of its faults.
    error_rad: Its error of the beam: in rows held out if known, else as predicted; inf if never calibrated [rad].
    reading_unit: Unit of its readings.
    """

    name: str
    plan: MeasurementPlan | None
    candidates: Observations | None
    reason: str
    faults: tuple[str, ...]
    error_rad: float
    reading_unit: str


def run(result: Path, out: Path, options: NextOptions | None = None) -> list[str]:
    """Plan the next measurements of calibrated heliostats.

    result: Folder with ``heliostat.json``, or one with a folder for each heliostat.
    Returns: A sentence for each heliostat, the worst first, and one for the schedule.
    InputError: No results there, the folder cannot be used, or no such target.
    """
    options = options or NextOptions()
    with explain_faults(result, "a folder of results as heliogauge wrote it"):
        contents = list(read_results(result))
        site = stored_site(contents[0])
        targets = {name: _target(name, one) for name, one in contents[0]["targets"].items()}
        aim_point = _aim_point(targets, options.target)
        suns = sun_positions_of_year(site, int(str(options.dates[0])[:4]), per_day=_PER_DAY_OF_YEAR)[0]
        planned = [_planned(content, site, targets, (suns, aim_point), options) for content in contents]
        planned += [_never(name, reason) for name, reason in failed_heliostats(result)]
    planned.sort(key=lambda one: (-one.error_rad, one.name))
    schedule = _scheduled(planned, site, tuple(targets), options)
    with WholeFolder(out, PLAN, force=options.force) as folder:
        write_table_csv(folder / PLAN_FILE, _measurement_columns(planned))
        write_table_csv(folder / NEEDS_FILE, _need_columns(planned))
        write_table_csv(folder / SCHEDULE_FILE, _schedule_columns(schedule))
        write_json(folder / MARK, _content(planned, schedule, options))
    return [f"{one.name}: {one.reason}" for one in planned] + [_schedule_text(schedule)]


def _planned(
    content: Mapping[str, Any],
    site: Site,
    targets: Mapping[str, PlaneTarget],
    year: tuple[FloatArray, FloatArray],
    options: NextOptions,
) -> Planned:
    name, faults = str(content["heliostat"]), _faults(content)
    unit = str(content["design"]["reading_unit"])
    try:
        knowledge = _knowledge(content, options.sigma_m, year[1])
        candidates = beam_candidates(knowledge, site, targets, _times(site, options), sigma_m=options.sigma_m)
        plan = plan_measurements(
            knowledge, candidates, year[0], year[1], goal_rad=options.goal_rad, options=PlanOptions(most=options.most)
        )
    except (EstimationError, InputError) as error:
        return Planned(name, None, None, str(error), faults, _held_out(content), unit)
    known = _held_out(content)
    error_rad = known if np.isfinite(known) else float(plan.sigma_beam_rad[0])
    warned = f"{plan.text}; first look into: {', '.join(faults)}" if faults else plan.text
    return Planned(name, plan, candidates, warned, faults, error_rad, unit)


def _never(name: str, reason: str) -> Planned:
    return Planned(name, None, None, f"not calibrated: {reason}", (), float("inf"), "")


def _knowledge(content: Mapping[str, Any], sigma_m: float, aim_point: FloatArray) -> Knowledge:
    design = design_from(content["design"], content["parameters"], key="value")
    covariance = content["covariance"]
    matrix = np.array(covariance["matrix"], dtype=np.float64)
    rms = content["fit_to_all"]["beam_rms_mrad"]
    noise = sigma_m / float(np.linalg.norm(aim_point - design.position_m))
    misfit = 0.0 if rms is None else float(np.sqrt(max((1e-3 * rms) ** 2 / 2 - noise**2, 0.0)))
    return Knowledge(design, tuple(covariance["names"]), matrix, misfit)


def _held_out(content: Mapping[str, Any]) -> float:
    """RMS of the beam in rows held out [rad]; inf where there are none."""
    split = content["splits"].get(content["split"])
    found = None if split is None else split["test"]["beam_rms_mrad"]
    return float("inf") if found is None else 1e-3 * float(found)


def _faults(content: Mapping[str, Any]) -> tuple[str, ...]:
    findings = (content.get("diagnosis") or {}).get("findings", [])
    return tuple(dict.fromkeys(one["kind"] for one in findings if one["severity"] == "fault"))


def _target(name: str, one: Mapping[str, Any]) -> PlaneTarget:
    return PlaneTarget(
        name, np.array(one["center_m"]), np.array(one["right"]), np.array(one["up"]), one["width_m"], one["height_m"]
    )


def _aim_point(targets: Mapping[str, PlaneTarget], name: str | None) -> FloatArray:
    if name is not None and name not in targets:
        raise InputError(f"target={name}: no such target; there are {', '.join(targets)}")
    return (next(iter(targets.values())) if name is None else targets[name]).center_m


def _times(site: Site, options: NextOptions) -> "np.ndarray[tuple[int, ...], np.dtype[np.datetime64]]":
    chosen = np.unique(np.linspace(0, options.days - 1, min(_DATES, options.days)).round().astype(np.intp))
    midnights = options.dates[chosen].astype("datetime64[ms]")
    midnights = midnights - np.timedelta64(round(site.longitude_deg / 15 * 60), "m")
    return np.asarray((midnights[:, None] + np.arange(0, 1440, _STEP_MINUTES) * np.timedelta64(1, "m")).ravel())


def _scheduled(planned: list[Planned], site: Site, targets: tuple[str, ...], options: NextOptions) -> Schedule:
    needs = []
    for one in planned:
        count = options.most if one.plan is None else len(one.plan.chosen)
        # What cannot serve a target is no matter of turns.
        if one.plan is None and np.isfinite(one.error_rad):
            continue
        served = targets if one.candidates is None else tuple(dict.fromkeys(one.candidates.label))
        reason = f"first look into: {', '.join(one.faults)}" if one.faults else one.reason if one.plan is None else ""
        if count:
            needs.append(Need(one.name, one.error_rad, count, served, reason=reason))
    if not needs:
        return Schedule((), {})
    chosen = ScheduleOptions(slot_minutes=options.slot_minutes, per_day=options.per_day)
    return propose_schedule(needs, site, options.dates, chosen)


# --- tables -----------------------------------------------------------------------------------------------------------


def _measurement_columns(planned: list[Planned]) -> dict[str, list[Any]]:
    names = (
        "heliostat",
        "measurement",
        "time_utc",
        "target",
        "sun_azimuth_deg",
        "sun_elevation_deg",
        "reading_1",
        "reading_2",
        "reading_unit",
        "sigma_beam_mrad",
    )
    rows: list[tuple[Any, ...]] = []
    for one in planned:
        if one.plan is None or one.candidates is None or not one.plan.chosen.size:
            continue
        seen, chosen = one.candidates, one.plan.chosen
        azimuth, elevation = (np.rad2deg(angle)[chosen] for angle in angles_from_direction(seen.sun))
        for place, row in enumerate(chosen.tolist()):
            first, second = seen.readings[row].tolist()
            rows.append(
                (
                    one.name,
                    place + 1,
                    f"{seen.time[row].astype('datetime64[s]')}Z",
                    seen.label[row],
                    round(float(azimuth[place]), 3),
                    round(float(elevation[place]), 3),
                    first,
                    second,
                    one.reading_unit,
                    round(1e3 * float(one.plan.sigma_beam_rad[place + 1]), 4),
                )
            )
    return {name: [row[place] for row in rows] for place, name in enumerate(names)}


def _need_columns(planned: list[Planned]) -> dict[str, list[Any]]:
    plans = [one.plan for one in planned]
    return {
        "heliostat": [one.name for one in planned],
        "beam_error_mrad": ["" if np.isinf(one.error_rad) else round(1e3 * one.error_rad, 4) for one in planned],
        "sigma_beam_now_mrad": ["" if p is None else round(1e3 * float(p.sigma_beam_rad[0]), 4) for p in plans],
        "sigma_normal_now_mrad": ["" if p is None else round(500 * float(p.sigma_beam_rad[0]), 4) for p in plans],
        "sigma_beam_then_mrad": ["" if p is None else round(1e3 * float(p.sigma_beam_rad[-1]), 4) for p in plans],
        "floor_beam_mrad": ["" if p is None else round(1e3 * p.floor_rad, 4) for p in plans],
        "measurements_needed": ["" if p is None or p.needed is None else p.needed for p in plans],
        "measurements_planned": [0 if p is None else len(p.chosen) for p in plans],
        "faults": [", ".join(one.faults) for one in planned],
        "reason": [one.reason for one in planned],
    }


def _schedule_columns(schedule: Schedule) -> dict[str, list[Any]]:
    slots = schedule.slots
    suns = np.array([slot.sun for slot in slots]).reshape(-1, 3)
    azimuth, elevation = (np.rad2deg(angle).round(3).tolist() for angle in angles_from_direction(suns))
    return {
        "time_utc": [f"{slot.time.astype('datetime64[s]')}Z" for slot in slots],
        "target": [slot.target for slot in slots],
        "heliostat": [slot.heliostat for slot in slots],
        "beam": [slot.number for slot in slots],
        "sun_azimuth_deg": azimuth,
        "sun_elevation_deg": elevation,
        "reason": [slot.reason for slot in slots],
    }


def _schedule_text(schedule: Schedule) -> str:
    days = {str(slot.time)[:10] for slot in schedule.slots}
    heliostats = {slot.heliostat for slot in schedule.slots}
    text = f"schedule: {len(schedule.slots)} beams of {len(heliostats)} heliostats on {len(days)} days"
    if schedule.unserved:
        text += f"; no room for {sum(schedule.unserved.values())} beams of {len(schedule.unserved)} heliostats"
    return text


def _content(planned: list[Planned], schedule: Schedule, options: NextOptions) -> dict[str, Any]:
    return {
        "first_day": str(options.dates[0]),
        "days": options.days,
        "goal_beam_mrad": 1e3 * options.goal_rad,
        "sigma_mm": 1e3 * options.sigma_m,
        "heliostats": len(planned),
        "beams_scheduled": len(schedule.slots),
        "beams_without_room": schedule.unserved,
        "schedule": _schedule_text(schedule),
        "needs": {one.name: one.reason for one in planned},
    }
