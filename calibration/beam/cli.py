"""``heliogauge beam``: photos of beams on targets to centres, sizes and flux."""

from pathlib import Path
from typing import Annotated

import typer

from heliogauge.running.commands import (
    AsJson,
    Force,
    Jobs,
    NoReport,
    OutFolder,
    Quiet,
    Verbose,
    deliver,
    make_app,
)

app = make_app("Photos of beams on a target -> centres, sizes, flux with sigma.")

BeamFolder = Annotated[
    Path,
    typer.Argument(
        metavar="FOLDER",
        help="Folder with measurement.toml, or with records and pictures as of the PAINT database.",
        show_default=False,
    ),
]


@app.command("measure")
def measure_command(
    folder: BeamFolder,
    out: OutFolder,
    jobs: Jobs = None,
    force: Force = False,
    no_report: NoReport = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Measure beams in photos: beams.csv, contours.csv, flux.nc, summary.json, report.html."""
    from calibration.beam.keys import load_beams
    from calibration.beam.pipeline.measure import Options, run
    from heliogauge.running.terminal import terminal_progress

    progress = terminal_progress(quiet=quiet, verbose=verbose)
    deliver(
        out,
        lambda: run(load_beams(folder), Options(jobs=jobs), progress),
        progress,
        force=force,
        quiet=quiet,
        report=not no_report,
        as_json=as_json,
    )
