"""``heliogauge heliostat``: beams and drive readings to tracking models; plans of measurements; exports."""

import datetime
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from calibration.heliostat.performance.cli import add_performance
from heliogauge.running.commands import (
    AsJson,
    Force,
    FoundAsJson,
    Jobs,
    NoReport,
    OutFolder,
    Quiet,
    Scheduler,
    Verbose,
    add_formats,
    make_app,
    say_doubts,
    say_ending,
)

if TYPE_CHECKING:
    from calibration.heliostat.pipeline.export import Exported

app = make_app("Where beams were seen and the drive readings -> tracking models of heliostats.")
exports = add_formats(app, "export")
add_performance(app)

#: Heliostats of which a command says something on the terminal; its files have all.
_MOST_SENTENCES = 20
TableDay = Annotated[
    str | None, typer.Option(metavar="YYYY-MM-DD", help="The day; default: today.", show_default=False)
]
TableStep = Annotated[float, typer.Option(help="Step of the table.")]
AimedTarget = Annotated[
    str | None, typer.Option(help="Target whose centre is aimed at; default: the first.", show_default=False)
]
OnlyNames = Annotated[
    str | None, typer.Option(metavar="NAMES", help="Only these heliostats; * stands for any text, commas separate.")
]
HeliostatResults = Annotated[
    Path,
    typer.Argument(metavar="OUT", help="Results of `heliogauge heliostat measure`.", show_default=False),
]


@app.command("measure")
def measure_command(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER", help="Folder with measurement.toml, or one as of the PAINT database.", show_default=False
        ),
    ],
    out: OutFolder,
    split: Annotated[
        Literal["chronological", "random", "azimuth", "azimuth-reversed", "high-variance", "column"] | None,
        typer.Option(help="What is held out; default: as measurement.toml says."),
    ] = None,
    model: Annotated[
        str | None, typer.Option(help='Free parameters: "auto", or a usual choice of the preset, such as 4, 8, 15.')
    ] = None,
    label: Annotated[
        Literal["UTIS", "HeliOS"] | None, typer.Option(help="Centres of beams in PAINT's records.")
    ] = None,
    only: OnlyNames = None,
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
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Estimate tracking models: heliostat.json, residuals.csv, field.csv, report.html.

    An interrupted field is continued by the same command; --force begins anew.
    """
    from calibration.heliostat.keys import load_heliostat
    from calibration.heliostat.pipeline.field import run_into
    from calibration.heliostat.pipeline.measure import Options
    from heliogauge.running.terminal import terminal_progress

    progress = terminal_progress(quiet=quiet, verbose=verbose)
    options = Options(split, model, label, only, thorough, jobs, scheduler)
    result = run_into(load_heliostat(folder), out, options, progress, force=force, report=not no_report)
    say_ending(result, out, quiet=quiet, as_json=as_json)


@exports.command("controllers")
def export_controllers_command(
    result: HeliostatResults, out: OutFolder, force: Force = False, quiet: Quiet = False, verbose: Verbose = False
) -> None:
    """Write controllers.csv: every number that controllers of azimuth-elevation heliostats need."""
    from calibration.heliostat.pipeline.export import ExportOptions, run

    _say_files(out, run(result, out, "controllers", ExportOptions(force=force)), quiet=quiet)


@exports.command("artist")
def export_artist_command(
    result: HeliostatResults,
    out: OutFolder,
    limit_mrad: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="Largest loss (RMS of the beam) of a file; default: the calibration's own expected error.",
            show_default=False,
        ),
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Write heliostats with linear actuators as ARTIST reads them, with what each file loses.

    Groups of a scenario (HDF5), and properties files as of the PAINT database where those lose little.
    """
    from calibration.heliostat.pipeline.export import ExportOptions, run

    limit_rad = None if limit_mrad is None else 1e-3 * limit_mrad
    _say_files(out, run(result, out, "artist", ExportOptions(limit_rad=limit_rad, force=force)), quiet=quiet)


@exports.command("table")
def export_table_command(
    result: HeliostatResults,
    out: OutFolder,
    date: TableDay = None,
    step_minutes: TableStep = 10.0,
    target: AimedTarget = None,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Write a table of each heliostat's readings over a day that put the beam on its target."""
    from calibration.heliostat.pipeline.export import ExportOptions, run

    options = ExportOptions(_day("date", date), step_minutes, target, force=force)
    _say_files(out, run(result, out, "table", options), quiet=quiet)


def _say_files(out: Path, exported: "Exported", *, quiet: bool) -> None:
    say_doubts(exported.doubts)
    if not quiet:
        for name in exported.names:
            typer.echo(out / name)


@app.command("aim")
def aim_command(
    result: HeliostatResults,
    out: OutFolder,
    date: TableDay = None,
    step_minutes: TableStep = 10.0,
    target: AimedTarget = None,
    only: OnlyNames = None,
    readings: Annotated[
        Path | None,
        typer.Option(
            metavar="CSV",
            help="The way back: where the beams of these readings go (heliostat, reading_1, reading_2, time_utc).",
            show_default=False,
        ),
    ] = None,
    search: Annotated[
        int | None,
        typer.Option(
            min=0,
            metavar="RINGS",
            help="Look for a lost beam at --time: aim points on a square spiral of so many rings, at most 100.",
        ),
    ] = None,
    time: Annotated[
        str | None,
        typer.Option(metavar="TIME", help="Time of the search with its zone, such as 2026-06-21T10:00:00Z."),
    ] = None,
    force: Force = False,
    as_json: FoundAsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Write the readings that put beams on a target over a day, with the sigma of the beam; or beams of readings."""
    from calibration.heliostat.pipeline.aim import AimOptions, run

    options = AimOptions(_day("date", date), step_minutes, target, only, readings, search, time, force)
    sentences = run(result, out, options)
    if as_json:
        _print_json({"results": str(out), "heliostats": sentences})
    elif not quiet:
        _say_heliostats(sentences, out)


@app.command("curves")
def curves_command(
    result: HeliostatResults,
    out: OutFolder,
    date: Annotated[
        list[str] | None,
        typer.Option(metavar="YYYY-MM-DD", help="Day (repeatable); default: March 20, June 21, December 21."),
    ] = None,
    step_minutes: TableStep = 30.0,
    target: AimedTarget = None,
    only: OnlyNames = None,
    change_mrad: Annotated[float, typer.Option(help="Error of an angle whose curve is wanted.")] = 1.0,
    change_mm: Annotated[float, typer.Option(help="Error of a length whose curve is wanted.")] = 10.0,
    draws: Annotated[
        int,
        typer.Option(min=0, help="Also estimate the model from the first day's beams so often, and predict all days."),
    ] = 0,
    sigma_mm: Annotated[float, typer.Option(help="Noise of those beams' centres, each axis.")] = 20.0,
    seed: Annotated[int, typer.Option(min=0, help="Of that noise.")] = 0,
    force: Force = False,
    as_json: FoundAsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Write what errors of the model do to the beam over days: daily curves of each, RMS, stability of an estimate."""
    from calibration.heliostat.pipeline.curves import CurvesOptions, run

    options = CurvesOptions(
        dates=tuple(day for text in date or () if (day := _day("date", text)) is not None),
        step_minutes=step_minutes,
        target=target,
        only=only,
        change_rad=1e-3 * change_mrad,
        change_m=1e-3 * change_mm,
        draws=draws,
        sigma_m=1e-3 * sigma_mm,
        seed=seed,
        force=force,
    )
    sentences = run(result, out, options)
    if as_json:
        _print_json({"results": str(out), "heliostats": sentences})
    elif not quiet:
        _say_heliostats(sentences, out)


@app.command("plan")
def plan_command(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER",
            help="Results of `heliogauge heliostat measure`, or a folder as for that, which is calibrated first.",
            show_default=False,
        ),
    ],
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
    as_json: FoundAsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Plan what to measure next of calibrated heliostats, at which suns, and a schedule, the worst first."""
    from calibration.heliostat.planning.plan import MARK, NextOptions, run
    from heliogauge.results.json_file import read_json
    from heliogauge.running.either_folder import results_of
    from heliogauge.running.terminal import terminal_progress

    first, goal_rad, sigma_m = _day("first_day", first_day), 1e-3 * goal_mrad, 1e-3 * sigma_mm
    options = NextOptions(first, days, goal_rad, sigma_m, most, per_day, slot_minutes, target, force)
    with results_of(folder, "heliostat", terminal_progress(quiet=quiet, verbose=verbose)) as results:
        sentences = run(results, out, options)
    # Of thousands the worst are enough to read; heliostats.csv has all.
    if as_json:
        _print_json(read_json(out / MARK))
    elif not quiet:
        _say_heliostats(sentences[:-1], out, sentences[-1])


def _print_json(content: Mapping[str, Any]) -> None:
    from heliogauge.results.json_file import json_text

    typer.echo(json_text("result", content).rstrip())


def _say_heliostats(sentences: Sequence[str], out: Path, last: str | None = None) -> None:
    """Print a sentence for each of the first heliostats, one on all of them, and where the results are."""
    for text in sentences[:_MOST_SENTENCES]:
        typer.echo(text)
    if len(sentences) > _MOST_SENTENCES:
        typer.echo(f"... and {len(sentences) - _MOST_SENTENCES} more heliostats")
    if last is not None:
        typer.echo(last)
    typer.echo(f"results: {out}")


def _day(name: str, text: str | None) -> datetime.date | None:
    """Return the day that an argument names; None without it."""
    from heliogauge.errors import InputError

    try:
        return None if text is None else datetime.date.fromisoformat(text)
    except ValueError as error:
        raise InputError(f"{name}={text}: a day such as 2026-06-21 is needed ({error})") from error
