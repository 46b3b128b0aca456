"""What a calibration is for: parameters for controllers, tables of corrections, files for other programs."""

import datetime
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from calibration.heliostat.files.store_heliostat import read_results, stored_site
from calibration.heliostat.files.store_paint import exported_properties
from calibration.heliostat.kinematic_model.aiming import aim
from calibration.heliostat.kinematic_model.design import Driven, HeliostatDesign, LinearActuator, RotaryDrive, Turn
from calibration.heliostat.kinematic_model.store_design import design_from
from heliogauge.errors import InputError
from heliogauge.files.faults import explain_faults
from heliogauge.geometry.rigid import rotation_from_vector
from heliogauge.geometry.sun import Site, angles_from_direction, sun_directions
from heliogauge.results.folder import write_json, write_table_csv
from heliogauge.results.whole_folder import FolderKind, WholeFolder
from heliogauge.validate import FloatArray

CONTROLLER_FILE = "controllers.csv"
EXPORT = FolderKind(content="exported files", mark="README.txt")
_READMES = {
    "controllers": """\
Exported from a heliostat calibration, for controllers of azimuth-elevation heliostats.

controllers.csv      base rotation R = rm1..rm9 (row by row; it turns vectors east, north, up from the heliostat's own
                     axes to the field's), biases [rad] and non-orthogonality e [rad].
                     Wanted normal h -> g = R^T h; elevation = asin(g_z / cos e), azimuth = atan2(g_e, g_n)
                     + atan2(sin(elevation) sin e, cos(elevation)); command = angle - bias.
""",
    "table": """\
Exported from a heliostat calibration: readings over a day that put the beam on the aim point.

corrections_*.csv    as without calibration, as with it, and the difference, every few minutes of UTC.
""",
    "artist": """\
Exported from a heliostat calibration, in the convention of the PAINT database, which ARTIST reads.

*_properties.json    heliostats with linear actuators. The tilts, which that convention has no place for, stand beside
                     as first_joint_tilt_n, first_joint_tilt_u, second_joint_tilt_e, second_joint_tilt_n [rad].
""",
}


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Choices of an export.

    date: Day of the tables of corrections; today if None.
    step_minutes: Step of the tables [min].
    target: Target whose centre is aimed at; the first one if None.
    force: Replace earlier exported files.
    """

    date: datetime.date | None = None
    step_minutes: float = 10.0
    target: str | None = None
    force: bool = False


def run(result: Path, out: Path, form: str, options: ExportOptions | None = None) -> list[str]:
    """Export calibrated heliostats.

    result: Folder with ``heliostat.json``, or one with a folder for each heliostat.
    form: "controllers", "table" or "artist".
    Returns: Names of the files, in order.
    InputError: No results there, none that have this form, the folder cannot be used, no such target, or a step that
        cannot be.
    """
    options = options or ExportOptions()
    if not 0.1 <= options.step_minutes <= 240:
        raise InputError(f"step_minutes={options.step_minutes:g}: between 0.1 and 240 minutes are needed")
    with WholeFolder(out, EXPORT, force=options.force) as folder:
        with explain_faults(result, "a folder of results as heliogauge wrote it"):
            _FORMS[form](folder, read_results(result), options, result)
        (folder / "README.txt").write_text(_READMES[form], encoding="utf-8")
        return sorted(file.name for file in folder.iterdir())


def _controllers(folder: Path, contents: Iterable[Mapping[str, Any]], options: ExportOptions, result: Path) -> None:
    designs = [design_from(content["design"], content["parameters"], key="value") for content in contents]
    rows = [row for row in map(controller_row, designs) if row is not None]
    if not rows:
        raise InputError(
            f"{result}: no heliostat turns about azimuth and elevation, so none has what controllers.csv holds; export "
            "artist (linear actuators) or table (any)"
        )
    write_table_csv(folder / CONTROLLER_FILE, {key: [row[key] for row in rows] for key in rows[0]})


def _artist(folder: Path, contents: Iterable[Mapping[str, Any]], options: ExportOptions, result: Path) -> None:
    count = 0
    for content in contents:
        design = design_from(content["design"], content["parameters"], key="value")
        if isinstance(design.drives[0], LinearActuator):
            write_json(folder / f"{design.name}_properties.json", exported_properties(content, design))
            count += 1
    if not count:
        raise InputError(
            f"{result}: no heliostat has linear actuators, so none has properties as of PAINT and ARTIST; export "
            "controllers (azimuth and elevation) or table (any)"
        )


def _table(folder: Path, contents: Iterable[Mapping[str, Any]], options: ExportOptions, result: Path) -> None:
    dated = replace(options, date=options.date or datetime.datetime.now(datetime.UTC).date())
    for content in contents:
        write_table_csv(
            folder / f"corrections_{content['design']['name']}_{dated.date}.csv", correction_columns(content, dated)
        )


_FORMS = {"controllers": _controllers, "table": _table, "artist": _artist}


def controller_row(design: HeliostatDesign) -> dict[str, Any] | None:
    """Return what a local controller of an azimuth-elevation heliostat stores (Malan 2014, section 5.4).

    Returns: Rotation ``rm1`` to ``rm9``, biases and non-orthogonality [rad], position [m]; None for a chain that
        has no such closed form.
    """
    numbers = dict(zip(design.parameters.names, design.parameters.values.tolist(), strict=True))
    drives = design.drives
    if not isinstance(drives[0], RotaryDrive) or not isinstance(drives[1], RotaryDrive):
        return None
    turns = [step for step in design.steps if isinstance(step, Turn | Driven)]
    places = [index for index, step in enumerate(turns) if isinstance(step, Driven)]
    between = turns[places[0] + 1 : places[1]]
    known = [step.angle for step in between if isinstance(step, Turn)]
    axes = np.stack([turns[place].axis for place in places] + [design.normal])
    if known != ["non_orthogonality"] or turns[places[1] + 1 :] or (axes != [[0, 0, -1], [1, 0, 0], [0, 1, 0]]).any():
        return None
    rotation = np.eye(3)
    for step in turns[: places[0]]:
        if isinstance(step, Turn):
            rotation = rotation @ rotation_from_vector(step.axis * numbers[step.angle])
    biases = [drive.offset_sign * numbers[drive.offset] for drive in drives if isinstance(drive, RotaryDrive)]
    east, north, up = design.position_m.tolist()
    return {
        "heliostat": design.name,
        **{f"rm{place + 1}": float(one) for place, one in enumerate(rotation.ravel())},
        "azimuth_bias_rad": biases[0],
        "elevation_bias_rad": biases[1],
        "non_orthogonality_rad": numbers["non_orthogonality"],
        "e_m": east,
        "n_m": north,
        "u_m": up,
    }


def correction_columns(content: Mapping[str, Any], options: ExportOptions) -> dict[str, Any]:
    """Return a day's readings without and with the calibration, and their difference.

    content: ``heliostat.json``.
    options: Date, step, target.
    Returns: Columns of the table; rows from sunrise to sunset, NaN where a drive cannot go there.
    InputError: No such target, or no date.
    """
    targets = content["targets"]
    name = next(iter(targets)) if options.target is None else options.target
    if name not in targets:
        raise InputError(f"target={name}: no such target; there are {', '.join(targets)}")
    if options.date is None:
        raise InputError("date=None: a day is needed for the table of corrections")
    times, suns = _day(options, stored_site(content))
    readings = []
    for key in ("nominal", "value"):
        design = design_from(content["design"], content["parameters"], key=key)
        found = aim(design, design.parameters.values, suns, np.array(targets[name]["center_m"]))
        reachable = found.converged & found.within_limits
        readings.append(np.where(reachable[:, None], found.readings, np.nan))
    unit = content["design"]["reading_unit"]
    azimuth, elevation = angles_from_direction(suns)
    columns: dict[str, Any] = {
        "time_utc": [f"{time}Z" for time in times.astype("datetime64[s]")],
        "sun_azimuth_deg": np.rad2deg(azimuth),
        "sun_elevation_deg": np.rad2deg(elevation),
    }
    for axis in (0, 1):
        columns[f"nominal_{axis + 1}_{unit}"] = readings[0][:, axis]
        columns[f"corrected_{axis + 1}_{unit}"] = readings[1][:, axis]
        columns[f"correction_{axis + 1}_{unit}"] = readings[1][:, axis] - readings[0][:, axis]
    return columns


def _day(options: ExportOptions, site: Site) -> tuple[Any, FloatArray]:
    # The solar day of the place, not that of Greenwich.
    noon = np.datetime64(f"{options.date}T12:00:00", "ms") - np.timedelta64(int(site.longitude_deg * 240_000), "ms")
    half = int(720 / options.step_minutes)
    step = np.timedelta64(round(options.step_minutes * 60_000), "ms")
    times = noon.astype("datetime64[m]").astype("datetime64[ms]") + np.arange(-half, half + 1) * step
    suns = sun_directions(times, site)
    up = suns[:, 2] > 0
    if not up.any():
        raise InputError(f"date={options.date}: the sun does not rise there on that day")
    return times[up], np.asarray(suns[up])
