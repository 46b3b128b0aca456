"""Command of the response of camera and display."""

from heliogauge.running.commands import Force, Jobs, MeasurementFolder, OutFolder, Quiet, Verbose, deliver


def response_command(
    folder: MeasurementFolder,
    out: OutFolder,
    jobs: Jobs = None,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Photographs of uniform grey levels -> response.csv, response.png, summary.json in the folder OUT."""
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
        report=False,
        hint="; use it with response_file in [screen] of measurement.toml",
    )


#: Commands by the names that they have in the group ``calibrate``.
COMMANDS = {"response": response_command}
