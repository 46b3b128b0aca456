"""Commands of calibration: camera; response of camera and display."""

from pathlib import Path
from typing import Annotated

import typer

from heliogauge.commands import (
    Force,
    Jobs,
    MeasurementFolder,
    NoReport,
    OutFolder,
    Quiet,
    Verbose,
    into_folder,
    make_app,
    tell,
)

app = make_app("Calibration of what measures: camera; response of camera and display.")


@app.command("response")
def response_command(
    folder: MeasurementFolder,
    out: OutFolder,
    jobs: Jobs = None,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Photographs of uniform grey levels -> response.csv, response.png, summary.json in the folder OUT."""
    from calibration.screen.pipeline import Options, headline_text, run, write
    from heliogauge.errors import InputError
    from heliogauge.measurement import load_response
    from heliogauge.terminal import terminal_progress

    if out.suffix == ".csv":
        raise InputError(f"--out {out}: give a folder, such as {out.with_suffix('')}; response.csv is written into it")
    progress = terminal_progress(quiet=quiet, verbose=verbose)
    result = into_folder(
        out, lambda: run(load_response(folder), Options(jobs=jobs), progress), write, force=force, progress=progress
    )
    tell(
        result.warnings,
        lambda: headline_text(result),
        f"results: {out}; use it with response_file in [screen] of measurement.toml",
        quiet=quiet,
    )


@app.command("camera")
def camera_command(
    folder: MeasurementFolder,
    out: OutFolder,
    compare: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Compare with an earlier camera.json or cameras.json.")
    ] = None,
    refine_board: Annotated[
        bool, typer.Option("--refine-board/--board-as-drawn", help="Estimate the board's shape, or hold it.")
    ] = True,
    hold_out: Annotated[
        str | None,
        typer.Option(metavar="PATTERN", help="Photos to check with, such as 'check_*': only their pose is fitted."),
    ] = None,
    leave_one_out: Annotated[
        bool,
        typer.Option("--leave-one-out/--no-leave-one-out", help="Also calibrate without each photo, as a check."),
    ] = True,
    jobs: Jobs = None,
    force: Force = False,
    no_report: NoReport = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Photos of a board or targets -> cameras.json, camera_opencv.yaml, points.csv (its shape), report.html in OUT."""
    from calibration.camera.pipeline import Options, run, write
    from calibration.camera.report_summary import headline_text
    from heliogauge.measurement import load_camera_calibration
    from heliogauge.terminal import terminal_progress

    progress = terminal_progress(quiet=quiet, verbose=verbose)
    options = Options(compare, hold_out, refine_board, leave_one_out, jobs)
    result = into_folder(
        out,
        lambda: run(load_camera_calibration(folder), options, progress),
        write,
        force=force,
        progress=progress,
        report=not no_report,
    )
    tell(
        result.warnings,
        lambda: headline_text(result),
        f'results: {out}; use it with file = "cameras.json" in [camera] of another measurement',
        quiet=quiet,
    )
