"""Commands of heliostats: calibrate, export, plan the next measurements."""

import datetime
from pathlib import Path
from typing import Annotated

import typer

from heliogauge.running.commands import Force, Jobs, NoReport, OutFolder, Quiet, Scheduler, Verbose, say_ending


def heliostat_command(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER", help="Folder with measurement.toml, or one as of the PAINT database.", show_default=False
        ),
    ],
    out: OutFolder,
    split: Annotated[
        str | None,
        typer.Option(help="What is held out: chronological, random, azimuth, azimuth-reversed, high-variance, column."),
    ] = None,
    model: Annotated[
        str | None, typer.Option(help='Free parameters: "auto", or a usual choice of the preset, such as 4, 8, 15.')
    ] = None,
    label: Annotated[str | None, typer.Option(help="Centres of beams in PAINT's records: UTIS or HeliOS.")] = None,
    only: Annotated[
        str | None, typer.Option(metavar="NAMES", help="Only these heliostats; * stands for any text, commas separate.")
    ] = None,
    thorough: Annotated[
        bool | None,
        typer.Option(
            "--thorough/--quick", help="Make every split and choose the model by trial; default: up to 25 heliostats."
        ),
    ] = None,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    force: Force = False,
    no_report: NoReport = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Where beams were seen and the drive readings -> tracking models: heliostat.json, residuals.csv, field.csv in OUT.

    An interrupted field is continued by the same command; --force begins anew.
    """
    from calibration.heliostat.keys import load_heliostat
    from calibration.heliostat.pipeline.field import run_into
    from calibration.heliostat.pipeline.measure import Options
    from heliogauge.running.terminal import terminal_progress

    progress = terminal_progress(quiet=quiet, verbose=verbose)
    options = Options(split, model, label, only, thorough, jobs, scheduler)
    result = run_into(load_heliostat(folder), out, options, progress, force=force, report=not no_report)
    say_ending(result.doubts, result.headline(), f"results: {out}", quiet=quiet)


def heliostat_export_command(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="Results of `heliogauge calibrate heliostat`.")],
    out: OutFolder,
    date: Annotated[
        str | None, typer.Option(metavar="YYYY-MM-DD", help="Also tables of corrections over this day.")
    ] = None,
    step_minutes: Annotated[float, typer.Option(help="Step of the tables of corrections.")] = 10.0,
    target: Annotated[
        str | None, typer.Option(help="Target whose centre the tables aim at; default: the first.")
    ] = None,
    force: Force = False,
) -> None:
    """Calibrated heliostats -> parameters for controllers, tables of corrections, properties as of PAINT and ARTIST."""
    from calibration.heliostat.pipeline.export import ExportOptions, run

    for name in run(result, out, ExportOptions(_day("--date", date), step_minutes, target, force)):
        typer.echo(out / name)


def heliostat_plan_command(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="Results of `heliogauge calibrate heliostat`.")],
    out: OutFolder,
    first_day: Annotated[
        str | None, typer.Option(metavar="YYYY-MM-DD", help="First day of the measurements; default: today.")
    ] = None,
    days: Annotated[int, typer.Option(help="How many days there are.")] = 30,
    goal_mrad: Annotated[float, typer.Option(help="Sigma of the beam over a year that shall be reached.")] = 1.0,
    sigma_mm: Annotated[float, typer.Option(help="Of a measured centre of a beam, each axis.")] = 20.0,
    most: Annotated[int, typer.Option(help="Measurements of one heliostat at most.")] = 12,
    per_day: Annotated[int, typer.Option(help="Heliostats a day at most; 0: as many as there is room for.")] = 0,
    slot_minutes: Annotated[float, typer.Option(help="How long a beam keeps a target busy.")] = 3.0,
    target: Annotated[
        str | None, typer.Option(help="Target whose centre stands for where the beam shall go; default: the first.")
    ] = None,
    force: Force = False,
) -> None:
    """Calibrated heliostats -> what to measure next, at which suns, and a schedule, the worst first."""
    from calibration.heliostat.planning.plan import NextOptions, run

    first, goal_rad, sigma_m = _day("--first-day", first_day), 1e-3 * goal_mrad, 1e-3 * sigma_mm
    options = NextOptions(first, days, goal_rad, sigma_m, most, per_day, slot_minutes, target, force)
    sentences = run(result, out, options)
    # Of thousands the worst are enough to read; heliostats.csv has all.
    for text in [*sentences[:-1][:20], sentences[-1]]:
        typer.echo(text)
    typer.echo(f"results: {out}")


def _day(flag: str, text: str | None) -> datetime.date | None:
    """Return the day that a flag names; None without it."""
    from heliogauge.errors import InputError

    try:
        return None if text is None else datetime.date.fromisoformat(text)
    except ValueError as error:
        raise InputError(f"{flag} {text}: a day such as 2026-06-21 is needed ({error})") from error


#: Commands by the names that they have in the group ``calibrate``.
COMMANDS = {
    "heliostat": heliostat_command,
    "heliostat-export": heliostat_export_command,
    "heliostat-plan": heliostat_plan_command,
}
