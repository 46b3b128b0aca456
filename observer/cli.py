"""``heliogauge observer``: photos of a trough to slope errors, absorber position and intercept factor."""

import typer

from heliogauge.commands import Force, Jobs, MeasurementFolder, NoReport, OutFolder, Quiet, Verbose, make_app

app = make_app("Photos of the absorber's reflection in a trough -> slope errors, absorber position, intercept factor.")


@app.command("run")
def run_command(
    folder: MeasurementFolder,
    out: OutFolder,
    jobs: Jobs = None,
    force: Force = False,
    no_report: NoReport = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Evaluate a measurement folder: slope_map.nc, absorber.csv, cameras.json, summary.json, report.html."""
    from heliogauge.measurement import load_observer
    from heliogauge.store import ResultFolder
    from heliogauge.terminal import terminal_progress
    from observer.pipeline import Options, run, summarise, write
    from observer.pipeline_headline import headline_text

    progress = terminal_progress(quiet=quiet, verbose=verbose)
    with ResultFolder(out, force=force) as working:
        result = run(load_observer(folder), Options(jobs=jobs), progress)
        with progress.stage("write results"):
            write(result, working)
        if not no_report:
            from heliogauge.report import build_report

            with progress.stage("report"):
                build_report(working)
    for text in result.warnings:
        typer.echo(f"warning: {text}", err=True)
    if not quiet:
        typer.echo(headline_text(summarise(result)))
        typer.echo(f"results: {out}")
