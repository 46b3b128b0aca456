"""Commands of calibration: the response of camera and display."""

import typer

from heliogauge.commands import Force, Jobs, MeasurementFolder, OutFolder, Quiet, Verbose, make_app

app = make_app("Calibration of what measures: the response of camera and display.")


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
    from heliogauge.store import ResultFolder
    from heliogauge.terminal import terminal_progress

    if out.suffix == ".csv":
        raise InputError(f"--out {out}: give a folder, such as {out.with_suffix('')}; response.csv is written into it")
    progress = terminal_progress(quiet=quiet, verbose=verbose)
    with ResultFolder(out, force=force) as working:
        result = run(load_response(folder), Options(jobs=jobs), progress)
        with progress.stage("write results"):
            write(result, working)
    for text in result.warnings:
        typer.echo(f"warning: {text}", err=True)
    if not quiet:
        typer.echo(headline_text(result))
        typer.echo(f"results: {out}; use it with response_file in [screen] of measurement.toml")
