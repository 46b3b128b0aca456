"""``heliogauge screen``: photographs of grey levels to the response of camera and display."""

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

app = make_app("Photographs of uniform grey levels -> response of camera and display.")


@app.command("measure")
def measure_command(
    folder: MeasurementFolder,
    out: OutFolder,
    jobs: Jobs = None,
    force: Force = False,
    no_report: NoReport = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Evaluate photographs of uniform grey levels: response.csv, summary.json, report.html."""
    from calibration.screen.keys import load_response
    from calibration.screen.pipeline import Options, run
    from heliogauge.errors import InputError
    from heliogauge.running.terminal import terminal_progress

    if out.suffix == ".csv":
        raise InputError(f"--out {out}: give a folder, such as {out.with_suffix('')}; response.csv is written into it")
    progress = terminal_progress(quiet=quiet, verbose=verbose)
    deliver(
        out,
        lambda: run(load_response(folder), Options(jobs=jobs), progress),
        progress,
        force=force,
        quiet=quiet,
        report=not no_report,
        as_json=as_json,
        hint="; use it with response_file in [screen] of measurement.toml",
    )
