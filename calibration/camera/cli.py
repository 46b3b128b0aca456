"""``heliogauge camera``: photos of a board or targets to a calibrated camera."""

from pathlib import Path
from typing import Annotated

import typer

from heliogauge.running.commands import (
    AsJson,
    Force,
    Jobs,
    MeasurementFolder,
    NoReport,
    OutFolder,
    Quiet,
    Verbose,
    deliver,
    make_app,
)

app = make_app("Photos of a calibration board or of targets -> calibrated camera, with covariance.")


@app.command("measure")
def measure_command(
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
        bool, typer.Option("--leave-one-out/--no-leave-one-out", help="Also calibrate without each photo, as a check.")
    ] = True,
    jobs: Jobs = None,
    force: Force = False,
    no_report: NoReport = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Calibrate a camera: cameras.json, camera_opencv.yaml, points.csv (the board's shape), report.html."""
    from calibration.camera.keys import load_camera_calibration
    from calibration.camera.pipeline.measure import Options, run
    from heliogauge.running.terminal import terminal_progress

    progress = terminal_progress(quiet=quiet, verbose=verbose)
    options = Options(compare, hold_out, refine_board, leave_one_out, jobs)
    deliver(
        out,
        lambda: run(load_camera_calibration(folder), options, progress),
        progress,
        force=force,
        quiet=quiet,
        report=not no_report,
        as_json=as_json,
        hint='; use it with file = "cameras.json" in [camera] of another measurement',
    )
