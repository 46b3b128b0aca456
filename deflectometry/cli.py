"""Commands of deflectometry: evaluate a measurement folder, import one made with OpenCSP."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from heliogauge.commands import Force, Jobs, MeasurementFolder, NoReport, OutFolder, Quiet, Verbose, make_app

app = make_app("Images of fringes seen in a mirror -> slope map with uncertainty.")


@app.command("run")
def run_command(
    folder: MeasurementFolder,
    out: OutFolder,
    align: Annotated[
        Literal["normal", "outline"] | None,
        typer.Option("--align", help="Orientation the slopes refer to.  [default: as measurement.toml says]"),
    ] = None,
    grid_step_mm: Annotated[
        float | None, typer.Option("--grid-step-mm", help="Grid step of the maps.  [default: half the pixel spacing]")
    ] = None,
    remove: Annotated[
        Literal["nothing", "tilt", "focus", "quadratic"] | None,
        typer.Option("--remove", help="What is taken out of the maps.  [default: as measurement.toml says]"),
    ] = None,
    jobs: Jobs = None,
    force: Force = False,
    no_report: NoReport = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Evaluate a measurement folder: slope_map.nc, pixels.nc, cameras.json, summary.json, report.html."""
    from deflectometry.evaluate import Align
    from deflectometry.headline import headline_text
    from deflectometry.pipeline import Options, run, summarise, write
    from heliogauge.measurement import load_measurement
    from heliogauge.slope_removal import Removal
    from heliogauge.store import ResultFolder
    from heliogauge.terminal import terminal_progress

    progress = terminal_progress(quiet=quiet, verbose=verbose)
    options = Options(
        align=None if align is None else Align(align),
        grid_step_mm=grid_step_mm,
        remove=None if remove is None else Removal(remove),
        jobs=jobs,
    )
    with ResultFolder(out, force=force) as working:
        result = run(load_measurement(folder), options, progress)
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


@app.command("import-opencsp")
def import_opencsp_command(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILES...",
            help="HDF5 and JSON files of one OpenCSP/SOFAST fringe measurement, in any order: measurement, camera, "
            "display, spatial orientation, facet; image calibration, ensemble and result file where there are any.",
            show_default=False,
        ),
    ],
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Measurement folder to write.", show_default=False)],
    pose_from: Annotated[
        Path | None, typer.Option("--pose-from", help="Result file whose pose of the mirror is taken over.")
    ] = None,
    focal_length_m: Annotated[
        float | None, typer.Option("--focal-length-m", help="Focal length of the design paraboloid.")
    ] = None,
    sigma_distance_mm: Annotated[
        float, typer.Option("--sigma-distance-mm", help="Standard deviation of the measured distance.")
    ] = 10.0,
    correct_principal_point: Annotated[
        bool,
        typer.Option("--correct-principal-point", help="Move the principal point to where averaging pixels put it."),
    ] = False,
) -> None:
    """Write a measurement folder from files made with OpenCSP (SOFAST)."""
    import warnings

    from deflectometry.opencsp_import import OpencspOptions, import_opencsp
    from heliogauge.errors import QualityWarning

    options = OpencspOptions(
        pose_from=pose_from,
        correct_principal_point=correct_principal_point,
        focal_length_m=focal_length_m,
        sigma_distance_mm=sigma_distance_mm,
    )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", QualityWarning)
        taken = import_opencsp(files, folder, options)
    for line in taken:
        typer.echo(line)
    for one in caught:
        typer.echo(f"warning: {one.message}", err=True)
    typer.echo(f"measurement folder: {folder}; evaluate it with `heliogauge deflectometry {folder} -o RESULT`")
