"""What a calibration is for: parameters for controllers, tables of corrections, files for other programs."""

import datetime
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from calibration.heliostat.exports.aim_table import Calibrated
from calibration.heliostat.exports.artist_model import artist_heliostat
from calibration.heliostat.exports.controllers import controller_row
from calibration.heliostat.exports.days import SunsOfDay
from calibration.heliostat.exports.working_range import Loss, WorkingRange
from calibration.heliostat.files.store_artist import SCENARIO_FILE, properties_content, write_scenario_groups
from calibration.heliostat.files.store_field import failed_heliostats
from calibration.heliostat.files.store_heliostat import read_results, stored_site
from calibration.heliostat.kinematic_model.aiming import aim
from calibration.heliostat.kinematic_model.design import HeliostatDesign, LinearActuator
from calibration.heliostat.kinematic_model.store_design import design_from
from heliogauge.doubts import Doubt
from heliogauge.errors import InputError
from heliogauge.files.faults import explain_faults
from heliogauge.geometry.sun import angles_from_direction
from heliogauge.results.folder import write_json, write_table_csv
from heliogauge.results.whole_folder import FolderKind, WholeFolder
from heliogauge.sunlight.sun_shapes import SOLAR_DISC_RAD

CONTROLLER_FILE = "controllers.csv"
#: One row for each heliostat and file: what is lost, or why it was refused.
LIST_FILE = "exported.csv"
EXPORT = FolderKind(content="exported files", mark="README.txt")
_READMES = {
    "controllers": """\
Exported from a heliostat calibration, for controllers of azimuth-elevation heliostats.

controllers.csv      every number of the model, one row for each heliostat. R = rm1..rm9 (row by row) turns vectors
                     (east, north, up) from the heliostat's own axes to the field's; e is the non-orthogonality, c the
                     canting; the axes meet at e_m, n_m, u_m. Below, azimuth_ or elevation_ goes before the names of
                     the drives' columns. Angles are radians.

From a reading r to the angle of an axis, d = 1 if the last move went to larger readings, -1 if to smaller ones:
    nominal = rad_per_reading r;  base = nominal + bias;  w = worm_ratio nominal
    angle = base + sag cos(base - sag_zero) + worm_sin sin w + worm_cos cos w + worm_sin2 sin 2w + worm_cos2 cos 2w
            + d backlash / 2
Back: start with r = (angle - bias) / rad_per_reading and repeat r += (angle - angle(r)) / rad_per_reading; the terms
are small and four or five passes are enough.

From a wanted normal h to the angles:
    g = R^T h;  elevation E = asin((g_z - sin c sin e) / (cos c cos e))
    x = sin c cos e - cos c sin E sin e;  y = cos c cos E;  azimuth A = atan2(g_x, g_y) - atan2(x, y)
The mirror's centre stands at (e_m, n_m, u_m) + R Z X a with a = (arm_x_m, arm_y_m, arm_z_m),
    X a = turn of a about (1, 0, 0) by E, then about (0, -1, 0) by e;  Z = turn about (0, 0, -1) by A.

exported.csv         heliostats without such a form, and why; nothing is left out of a row of controllers.csv.
""",
    "table": """\
Exported from a heliostat calibration: readings over a day that put the beam on the aim point.

corrections_*.csv    as without calibration, as with it, and the difference, every few minutes of UTC.
""",
    "artist": """\
Exported from a heliostat calibration, in the numbers of ARTIST (github.com/ARTIST-Association/ARTIST, as of 2026).

artist_heliostats.h5 position, kinematics and actuator of each heliostat as in a scenario of ARTIST: all that its
                     rigid-body kinematics has, tilts included, in its signs (its turn about north is left-handed). To
                     put them into a scenario that has these heliostats:

    import h5py
    with h5py.File("scenario.h5", "a") as scenario, h5py.File("artist_heliostats.h5") as calibrated:
        for name, one in calibrated["heliostats"].items():
            for part in one:
                place = scenario["heliostats"][name]
                if part in place:
                    del place[part]
                one.copy(part, place)

*_properties.json    the same for ARTIST's reader of PAINT's files, which sets all tilts to 0: only where what is lost
                     without them is within the limit.
exported.csv         what each file loses against the calibrated model over a year of suns on all targets (RMS and
                     largest, mrad of the beam), or why it was refused. What ARTIST has no place for (sag, worm,
                     backlash; in the properties file the tilts) was adjusted into its other numbers. Its single
                     precision adds some 0.001 mrad. Read motor positions with motor_positions_to_orientations: its
                     way back from suns to motor positions takes shifts of the second joint for angles and neglects
                     tilts.
""",
}


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Choices of an export.

    date: Day of the tables of corrections; today if None.
    step_minutes: Step of the tables [min].
    target: Target whose centre is aimed at; the first one if None.
    limit_rad: Largest loss (RMS of the beam) of a file for ARTIST; if None what the calibration itself expects to be
        wrong by, at most the sun's radius [rad].
    force: Replace earlier exported files.
    """

    date: datetime.date | None = None
    step_minutes: float = 10.0
    target: str | None = None
    limit_rad: float | None = None
    force: bool = False


@dataclass(frozen=True, slots=True)
class Exported:
    """What was exported.

    names: Names of the files, in order.
    doubts: What was refused.
    """

    names: tuple[str, ...]
    doubts: tuple[Doubt, ...]


def run(result: Path, out: Path, form: str, options: ExportOptions | None = None) -> Exported:
    """Export calibrated heliostats.

    result: Folder with ``heliostat.json``, or one with a folder for each heliostat.
    form: "controllers", "table" or "artist".
    InputError: No results there, none that have this form, the folder cannot be used, no such target, or a step that
        cannot be.
    """
    options = options or ExportOptions()
    with WholeFolder(out, EXPORT, force=options.force) as folder:
        with explain_faults(result, "a folder of results as heliogauge wrote it"):
            rows = _FORMS[form](folder, read_results(result), options)
            for name, reason in failed_heliostats(result):
                empty = dict.fromkeys(rows[0] if rows else (), "")
                rows.append(empty | _listed(name, "", reason=f"{name}: not calibrated: {reason}"))
        if rows:
            write_table_csv(folder / LIST_FILE, {key: [row[key] for row in rows] for key in rows[0]})
        (folder / "README.txt").write_text(_READMES[form], encoding="utf-8")
        names = tuple(sorted(file.name for file in folder.iterdir()))
    return Exported(names, _doubts(rows))


def _doubts(rows: list[dict[str, Any]]) -> tuple[Doubt, ...]:
    refused = [row for row in rows if row["status"] == "refused"]
    if not refused:
        return ()
    text = f"{len(refused)} of {len(rows)} exports were refused ({LIST_FILE}); the first: {refused[0]['reason']}"
    return (Doubt("export_refused", text, {"refused_count": len(refused)}),)


def _controllers(folder: Path, contents: Iterable[Mapping[str, Any]], options: ExportOptions) -> list[dict[str, Any]]:
    rows, listed = [], []
    for content in contents:
        design = design_from(content["design"], content["parameters"], key="value")
        try:
            rows.append(controller_row(design))
            listed.append(_listed(design.name, CONTROLLER_FILE))
        except InputError as error:
            listed.append(_listed(design.name, CONTROLLER_FILE, reason=str(error)))
    if not rows:
        raise InputError(f"none of {len(listed)} heliostats can be exported; the first: {listed[0]['reason']}")
    write_table_csv(folder / CONTROLLER_FILE, {key: [row[key] for row in rows] for key in rows[0]})
    return listed


def _listed(name: str, file: str, *, reason: str = "") -> dict[str, Any]:
    return {"heliostat": name, "file": file, "status": "refused" if reason else "exported", "reason": reason}


def _artist(folder: Path, contents: Iterable[Mapping[str, Any]], options: ExportOptions) -> list[dict[str, Any]]:
    scenario: dict[str, HeliostatDesign] = {}
    listed = []
    for content in contents:
        design = design_from(content["design"], content["parameters"], key="value")
        limit_rad = _limit_rad(content) if options.limit_rad is None else options.limit_rad
        properties = f"{design.name}_properties.json"
        try:
            fitted_on, judged_on = _working_ranges(design, content)
        except InputError as error:
            listed += [
                _listed(design.name, file, reason=str(error)) | _loss_columns(None, limit_rad)
                for file in (SCENARIO_FILE, properties)
            ]
            continue
        for file in (SCENARIO_FILE, properties):
            said = artist_heliostat(design, fitted_on, judged_on, with_tilts=file == SCENARIO_FILE)
            reason = _beyond(design.name, file, said.loss, limit_rad)
            listed.append(_listed(design.name, file, reason=reason) | _loss_columns(said.loss, limit_rad))
            if not reason and file == SCENARIO_FILE:
                scenario[design.name] = said.design
            elif not reason:
                write_json(folder / file, properties_content(content, said.design))
    if all(row["status"] == "refused" for row in listed):
        raise InputError(f"nothing can be exported; the first reason: {listed[0]['reason']}")
    write_scenario_groups(scenario, folder)
    return listed


def _working_ranges(design: HeliostatDesign, content: Mapping[str, Any]) -> tuple[WorkingRange, WorkingRange]:
    """Return the positions that an export is adjusted to, and others by which it is judged."""
    if not isinstance(design.drives[0], LinearActuator):
        raise InputError(
            f"{design.name}: no linear actuators, so it has no such numbers in ARTIST; export controllers (azimuth and "
            "elevation) or table (any)"
        )
    site = stored_site(content)
    points = [one["center_m"] for one in content["targets"].values()]
    return (
        WorkingRange.of(design, site, points),
        WorkingRange.of(design, site, points, day_of_month=25, per_day=11),
    )


def _limit_rad(content: Mapping[str, Any]) -> float:
    """Return what an export may lose: as much as the calibration itself expects to be wrong by.

    Both together are then 1.4 times the expected error at most. Beyond the sun's radius no beam is where it should be.
    """
    split = content["splits"].get(content["split"]) or {}
    known = (split.get("predicted_sigma_median_mrad"), content["fit_to_all"]["beam_rms_mrad"])
    expected = next((1e-3 * float(one) for one in known if one is not None), SOLAR_DISC_RAD)
    return min(expected, SOLAR_DISC_RAD)


def _beyond(name: str, file: str, loss: Loss, limit_rad: float) -> str:
    if loss.rms_rad <= limit_rad:
        return ""
    lacks = "the tilts" if file != SCENARIO_FILE else "this model"
    return (
        f"{name}: {file} would send its beam {1e3 * loss.rms_rad:.2f} mrad (RMS over a year) beside the calibrated "
        f"model, for ARTIST has no place in it for {lacks}; {1e3 * limit_rad:.2f} mrad is the limit "
        f"(--limit-mrad allows more)" + (f"; {SCENARIO_FILE} has all of it" if file != SCENARIO_FILE else "")
    )


def _loss_columns(loss: Loss | None, limit_rad: float) -> dict[str, Any]:
    return {
        "loss_rms_mrad": "" if loss is None else round(1e3 * loss.rms_rad, 6),
        "loss_largest_mrad": "" if loss is None else round(1e3 * loss.largest_rad, 6),
        "limit_mrad": round(1e3 * limit_rad, 4),
    }


def _table(folder: Path, contents: Iterable[Mapping[str, Any]], options: ExportOptions) -> list[dict[str, Any]]:
    dated = replace(options, date=options.date or datetime.datetime.now(datetime.UTC).date())
    for content in contents:
        write_table_csv(
            folder / f"corrections_{content['design']['name']}_{dated.date}.csv", correction_columns(content, dated)
        )
    return []


_FORMS = {"controllers": _controllers, "table": _table, "artist": _artist}


def correction_columns(content: Mapping[str, Any], options: ExportOptions) -> dict[str, Any]:
    """Return a day's readings without and with the calibration, and their difference.

    content: ``heliostat.json``.
    options: Date, step, target.
    Returns: Columns of the table; rows from sunrise to sunset, NaN where a drive cannot go there.
    InputError: No such target, or no date.
    """
    target = Calibrated.from_content(content).target(options.target)
    if options.date is None:
        raise InputError("date=None: a day is needed for the table of corrections")
    day = SunsOfDay.of(options.date, options.step_minutes, stored_site(content))
    readings = []
    for key in ("nominal", "value"):
        design = design_from(content["design"], content["parameters"], key=key)
        found = aim(design, design.parameters.values, day.suns, target.center_m)
        reachable = found.converged & found.within_limits
        readings.append(np.where(reachable[:, None], found.readings, np.nan))
    unit = content["design"]["reading_unit"]
    azimuth, elevation = angles_from_direction(day.suns)
    columns: dict[str, Any] = {
        "time_utc": list(day.times_utc),
        "sun_azimuth_deg": np.rad2deg(azimuth),
        "sun_elevation_deg": np.rad2deg(elevation),
    }
    for axis in (0, 1):
        columns[f"nominal_{axis + 1}_{unit}"] = readings[0][:, axis]
        columns[f"corrected_{axis + 1}_{unit}"] = readings[1][:, axis]
        columns[f"correction_{axis + 1}_{unit}"] = readings[1][:, axis] - readings[0][:, axis]
    return columns
