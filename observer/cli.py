"""``heliogauge observer``: photos of a trough to slope errors, absorber position and intercept factor."""

from pathlib import Path
from typing import Annotated

import typer

from heliogauge.running.commands import (
    AsJson,
    EitherFolder,
    Force,
    Job,
    Jobs,
    MeasurementFolder,
    NoReport,
    OutFolder,
    Quiet,
    Verbose,
    add_formats,
    make_app,
    say_ending,
    writes_results,
)
from heliogauge.running.slope_commands import add_slope_exports

app = make_app("Photos of the absorber's reflection in a trough -> slope errors, absorber position, intercept factor.")
add_slope_exports(add_formats(app, "export"))


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
    """Evaluate a measurement folder: slope_map.nc, angles.nc, absorber.csv, summary.json, report.html.

    A folder that names several modules gives a folder of results for each, and an overview.
    """
    from heliogauge.running.terminal import terminal_progress
    from observer.keys import load_observer
    from observer.pipeline.measure import Options
    from observer.pipeline.measure_folder import run_into

    progress, options = terminal_progress(quiet=quiet, verbose=verbose), Options(jobs=jobs)
    result = run_into(load_observer(folder), out, options, progress, force=force, report=not no_report)
    say_ending(result, out, quiet=quiet, as_json=as_json)


@app.command("align")
@writes_results()
def align_command(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER",
            help="Results of `heliogauge observer measure`, or a measurement folder with a few photos of one module.",
            show_default=False,
        ),
    ],
    out: OutFolder,
    mounts: Annotated[
        Path | None, typer.Option("--mounts", metavar="FILE", help="Table of the mounts: columns x_m, y_m.")
    ] = None,
    jobs: Jobs = None,
) -> Job:
    """Prescribe how panels are to be aligned to the absorber: mounts.csv, overlay.csv, report.html.

    From results, or from a few photos of a module alone (TOPCAT): one before each row of panels is enough.
    """
    from heliogauge.measurement.load import MEASUREMENT_FILE
    from observer.keys import load_observer
    from observer.studies.align import run
    from observer.studies.align_photos import Options, run_on_photos

    is_measurement = (folder / MEASUREMENT_FILE).is_file()
    return Job(
        out,
        lambda progress: (
            run_on_photos(load_observer(folder), mounts, Options(jobs=jobs), progress)
            if is_measurement
            else run(folder, mounts)
        ),
    )


@app.command("overview")
@writes_results()
def overview_command(
    results: Annotated[list[Path], typer.Argument(metavar="RESULT", help="Results of the modules.")],
    out: OutFolder,
) -> Job:
    """Put the results of several modules beside each other: overview.csv, report.html."""
    from observer.studies.overview import run

    return Job(out, lambda progress: run(results))


@app.command("absorber")
@writes_results()
def absorber_command(
    folder: MeasurementFolder,
    out: OutFolder,
    jobs: Jobs = None,
) -> Job:
    """Measure the absorber alone, from two photos or more: absorber.csv, absorber_spans.csv, report.html."""
    from observer.keys import load_observer
    from observer.pipeline.absorber_alone import Options, run

    return Job(out, lambda progress: run(load_observer(folder), Options(jobs=jobs), progress), measured=folder)


@app.command("plan")
@writes_results()
def plan_command(
    folder: EitherFolder,
    out: OutFolder,
) -> Job:
    """Plan a pass: sigmas to be expected, what will be missing, where to fly; stations.csv, report.html.

    Of a measurement, or its results, the collector, camera and targets are taken, with the usual pass.
    """
    from observer.pipeline.plan_again import planned_measurement
    from observer.planning.plan import run

    return Job(out, lambda progress: run(planned_measurement(folder, progress), progress), measured=folder)


@app.command("compare")
@writes_results()
def compare_command(
    results: Annotated[list[Path], typer.Argument(metavar="RESULT", help="Results at other orientations or dates.")],
    out: OutFolder,
) -> Job:
    """Compare results of one trough: which panels turned, what changed; at several orientations what weight does.

    Two results of the same modules (a field at two dates): which panels of which module turned, changed_panels.csv.
    """
    from observer.files import is_field
    from observer.studies import compare, compare_fields

    study = compare_fields if all(is_field(folder) for folder in results) else compare
    return Job(out, lambda progress: study.run(results))
