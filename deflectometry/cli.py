"""``heliogauge deflectometry``: images of fringes seen in a mirror to its slope map; patterns to display."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from heliogauge.running.commands import (
    AsJson,
    Force,
    ForceMeasurement,
    Jobs,
    MeasurementFolder,
    NoReport,
    OutFolder,
    OutMeasurement,
    Quiet,
    Verbose,
    add_formats,
    deliver,
    make_app,
    parse_periods,
    say_doubts,
)
from heliogauge.running.slope_commands import add_slope_exports

app = make_app("Images of fringes seen in a mirror -> slope map with uncertainty.")
imports = add_formats(app, "import")
add_slope_exports(add_formats(app, "export"))


@app.command("measure")
def measure_command(
    folder: MeasurementFolder,
    out: OutFolder,
    align: Annotated[
        Literal["normal", "outline"] | None,
        typer.Option("--align", help="Orientation the slopes refer to.  [default: as measurement.toml says]"),
    ] = None,
    grid_step_mm: Annotated[
        float | None, typer.Option("--grid-step-mm", help="Grid step of the maps.  [default: 0.4 of the pixel spacing]")
    ] = None,
    remove: Annotated[
        Literal["nothing", "tilt", "focus", "quadratic"] | None,
        typer.Option("--remove", help="What is taken out of the maps.  [default: as measurement.toml says]"),
    ] = None,
    jobs: Jobs = None,
    force: Force = False,
    no_report: NoReport = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Evaluate a measurement folder: slope_map.nc, pixels.nc, cameras.json, summary.json, report.html."""
    from deflectometry.keys import load_deflectometry
    from deflectometry.pipeline.choices import Options
    from deflectometry.pipeline.measure import run
    from deflectometry.shape.smooth_shape import Align
    from heliogauge.running.terminal import terminal_progress
    from heliogauge.slopes.removal import Removal

    progress = terminal_progress(quiet=quiet, verbose=verbose)
    options = Options(
        align=None if align is None else Align(align),
        grid_step_mm=grid_step_mm,
        remove=None if remove is None else Removal(remove),
        jobs=jobs,
    )
    deliver(
        out,
        lambda: run(load_deflectometry(folder), options, progress),
        progress,
        force=force,
        quiet=quiet,
        report=not no_report,
        as_json=as_json,
    )


@imports.command("opencsp")
def import_opencsp_command(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE",
            help="HDF5 and JSON files of one OpenCSP/SOFAST fringe measurement, in any order: measurement, camera, "
            "display, spatial orientation, facet; image calibration, ensemble and result file where there are any.",
            show_default=False,
        ),
    ],
    out: OutMeasurement,
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
    force: ForceMeasurement = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Write a measurement folder from files made with OpenCSP (SOFAST)."""
    from deflectometry.exchange.opencsp_import import OpencspOptions, import_opencsp

    options = OpencspOptions(
        pose_from=pose_from,
        correct_principal_point=correct_principal_point,
        focal_length_m=focal_length_m,
        sigma_distance_mm=sigma_distance_mm,
    )
    imported = import_opencsp(files, out, options, force=force)
    say_doubts(imported.doubts)
    if not quiet:
        for line in imported.taken:
            typer.echo(line)
        typer.echo(f"measurement folder: {out}; evaluate it with `heliogauge deflectometry measure {out} -o RESULT`")


@app.command("patterns")
def patterns_command(
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Folder to write.", show_default=False)],
    width_px: Annotated[int, typer.Option("--width-px", min=1, help="Width of the displayed image.")],
    height_px: Annotated[int, typer.Option("--height-px", min=1, help="Height of the displayed image.")],
    periods: Annotated[
        str, typer.Option("--periods", help="Periods over the displayed image, both directions, with commas.")
    ] = "0.9,3.9,15.9,63.9",
    steps: Annotated[int, typer.Option("--steps", min=3, help="Frames of each period, 360 deg / steps apart.")] = 4,
    first: Annotated[Literal["y", "x"], typer.Option("--first", help="Direction that comes first.")] = "y",
    bits: Annotated[Literal["8", "16"], typer.Option("--bits", help="Bit depth of the frames.")] = "8",
    level_min: Annotated[
        float | None,
        typer.Option("--level-min", min=0.0, max=1.0, help="Darkest level, share of the range.  [default: all of it]"),
    ] = None,
    level_max: Annotated[
        float | None,
        typer.Option(
            "--level-max", min=0.0, max=1.0, help="Brightest level, share of the range.  [default: all of it]"
        ),
    ] = None,
    response: Annotated[
        Path | None,
        typer.Option("--response", metavar="CSV", help="Compensate, so that the camera sees sinusoids: response.csv."),
    ] = None,
    response_full_level: Annotated[
        float, typer.Option("--response-full-level", min=0.0, help="Its display_level that is full range.")
    ] = 1.0,
    grey_steps: Annotated[
        int, typer.Option("--grey-steps", min=3, max=256, help="Grey levels to calibrate the response.")
    ] = 33,
    force: Annotated[bool, typer.Option("--force", help="Replace earlier patterns.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Write the frames to display, pattern.toml for measurement.toml, and grey steps to calibrate the response."""
    from deflectometry.pipeline.write_patterns import DisplayOptions, PatternOptions, write_patterns
    from deflectometry.setup.patterns import Axis
    from heliogauge.running.terminal import terminal_progress

    display = DisplayOptions(width_px, height_px, int(bits), level_min, level_max, response, response_full_level)
    options = PatternOptions(parse_periods(periods), steps, Axis(first), grey_steps)
    progress = terminal_progress(quiet=quiet, verbose=verbose)
    pattern = write_patterns(out, display, options, force=force, progress=progress)
    if not quiet:
        typer.echo(f"{pattern.n_frames} fringe frames, bright.png, dark.png and {grey_steps} grey levels: {out}")
