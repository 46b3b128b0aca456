"""``heliogauge deflectometry``: images of fringes seen in a mirror to its slope map; patterns to display."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from heliogauge.running.commands import (
    EitherFolder,
    ForceMeasurement,
    Job,
    Jobs,
    MeasurementFolder,
    OutFolder,
    OutMeasurement,
    Quiet,
    Verbose,
    add_formats,
    make_app,
    parse_periods,
    say_doubts,
    writes_results,
)
from heliogauge.running.slope_commands import add_slope_exports

app = make_app("Images of fringes seen in a mirror -> slope map with uncertainty.")
imports = add_formats(app, "import")
add_slope_exports(add_formats(app, "export"))
screens = make_app("Screens and walls that show the pattern.")
app.add_typer(screens, name="screen", help="Screens and walls that show the pattern.")


@app.command("measure")
@writes_results()
def measure_command(
    folder: MeasurementFolder,
    out: OutFolder,
    align: Annotated[
        Literal["normal", "outline"] | None,
        typer.Option("--align", help="Orientation the slopes refer to.  [default: as measurement.toml says]"),
    ] = None,
    grid_step_mm: Annotated[
        float | None,
        typer.Option("--grid-step-mm", help="Grid step of the maps.  [default: 0.4 to 1 of the pixel spacing]"),
    ] = None,
    remove: Annotated[
        Literal["nothing", "tilt", "focus", "quadratic"] | None,
        typer.Option("--remove", help="What is taken out of the maps.  [default: as measurement.toml says]"),
    ] = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Refuse frames that would have to be mended or left out.")
    ] = False,
    jobs: Jobs = None,
) -> Job:
    """Evaluate a measurement folder: slope_map.nc, pixels.nc, cameras.json, summary.json, report.html."""
    from heliogauge.errors import InputError
    from heliogauge.instruments import resolve
    from heliogauge.measurement.load import kind_of
    from heliogauge.slopes.removal import Removal

    kind = kind_of(folder)
    removal = None if remove is None else Removal(remove)
    if kind.name == "slopes":
        if (align, grid_step_mm) != (None, None):
            raise InputError(f"{folder}: slopes have no alignment, and their grid is in measurement.toml; leave it out")
        from deflectometry.exchange.measure_slopes import load_slopes
        from deflectometry.exchange.measure_slopes import run as run_slopes

        return Job(out, lambda progress: run_slopes(load_slopes(folder), progress, removal), measured=folder)
    if kind.name == "overlay":
        if (align, grid_step_mm, remove) != (None, None, None):
            raise InputError(f"{folder}: an overlay has no map to align, grid or take something out of; leave it out")
        from deflectometry.overlay.keys import load_overlay
        from deflectometry.overlay.pipeline.measure import run as run_overlay

        return Job(out, lambda progress: run_overlay(load_overlay(folder), progress), measured=folder)
    from deflectometry.instrument import INSTRUMENT
    from deflectometry.pipeline.choices import Options
    from deflectometry.shape.smooth_shape import Align

    options = Options(None if align is None else Align(align), grid_step_mm, removal, strict, jobs)
    # Another command's kind goes to the reader of fringes, which names that command.
    one = kind if kind.command == "deflectometry measure" else INSTRUMENT.kinds[0]
    job = resolve(one.run)
    return Job(out, lambda progress: job(resolve(one.load)(folder), options, progress), measured=folder)


@app.command("plan")
@writes_results()
def plan_command(
    folder: EitherFolder,
    out: OutFolder,
) -> Job:
    """Say what a measurement will be worth, what limits it and what would better it, before there are images."""
    from deflectometry.instrument import INSTRUMENT
    from heliogauge.errors import InputError
    from heliogauge.instruments import resolve
    from heliogauge.measurement.load import kind_of
    from heliogauge.running.either_folder import measurement_of

    place = measurement_of(folder)
    kind = kind_of(place)
    if not kind.plan:
        known = ", ".join(f'"{one.name}"' for one in INSTRUMENT.kinds if one.plan)
        raise InputError(f'{place}: kind = "{kind.name}" has no plan; those that have: {known}')
    return Job(out, lambda progress: resolve(kind.plan)(place, progress), measured=place)


@imports.command("opencsp")
def import_opencsp_command(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE",
            help="HDF5 and JSON files of one OpenCSP/SOFAST measurement, in any order: measurement (fringes or dots), "
            "camera, display or places of the dots, spatial orientation, facet; image calibration, ensemble and result "
            "file where there are any. A result file alone gives its slopes.",
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
    known_dot: Annotated[
        list[str] | None,
        typer.Option(
            metavar="X,Y,COLUMN,ROW",
            help="Dot whose place in the photo is known [px], one for each facet of an ensemble; may be given again.",
            show_default=False,
        ),
    ] = None,
    sigmas: Annotated[
        Literal["laboratory", "hand", "unknown"],
        typer.Option(
            "--sigmas",
            help="How camera and screen were measured, for usual sigmas: laboratory (camera 0.1 % of its focal length, "
            "screen 1 mrad, 5 mm), hand (0.5 %, 5 mrad, 20 mm); unknown: as well as the images know them.",
        ),
    ] = "unknown",
    sigma_focal_px: Annotated[
        float | None,
        typer.Option("--sigma-focal-px", help="Standard deviation of the focal length.", show_default=False),
    ] = None,
    sigma_center_px: Annotated[
        float | None,
        typer.Option("--sigma-center-px", help="Of each coordinate of the principal point.", show_default=False),
    ] = None,
    sigma_screen_mrad: Annotated[
        float | None,
        typer.Option("--sigma-screen-mrad", help="Of the screen's rotation about each axis.", show_default=False),
    ] = None,
    sigma_screen_mm: Annotated[
        float | None,
        typer.Option("--sigma-screen-mm", help="Of the screen's place, width, height and sag.", show_default=False),
    ] = None,
    force: ForceMeasurement = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Write a measurement folder from files made with OpenCSP (SOFAST)."""
    from deflectometry.exchange.opencsp_import import OpencspOptions, SetupSigmas, import_opencsp, parse_known_dot

    options = OpencspOptions(
        pose_from=pose_from,
        correct_principal_point=correct_principal_point,
        focal_length_m=focal_length_m,
        sigma_distance_mm=sigma_distance_mm,
        known_dots=tuple(parse_known_dot(text) for text in known_dot or ()),
        sigmas=SetupSigmas(sigmas, sigma_focal_px, sigma_center_px, sigma_screen_mrad, sigma_screen_mm),
    )
    imported = import_opencsp(files, out, options, force=force)
    say_doubts(imported.doubts)
    if not quiet:
        for line in imported.taken:
            typer.echo(line)
        typer.echo(f"measurement folder: {out}; evaluate it with `heliogauge deflectometry measure {out} -o RESULT`")


SlopeDesign = Annotated[
    Literal["plane", "paraboloid", "trough", "sphere"] | None,
    typer.Option(
        help="Design that the slopes are compared with; default: plane. Edit measurement.toml for others.",
        show_default=False,
    ),
]
FocalLength = Annotated[
    float | None, typer.Option(min=0.0, help="Focal length of the paraboloid or trough.", show_default=False)
]
Radius = Annotated[float | None, typer.Option(min=0.0, help="Radius of the sphere.", show_default=False)]


def _import_slopes(form: str, help_of_file: str) -> Callable[..., None]:
    def import_command(
        file: Annotated[Path, typer.Argument(metavar="FILE", help=help_of_file, show_default=False)],
        out: OutMeasurement,
        design: SlopeDesign = None,
        focal_length_m: FocalLength = None,
        radius_m: Radius = None,
        force: ForceMeasurement = False,
        quiet: Quiet = False,
        verbose: Verbose = False,
    ) -> None:
        from deflectometry.exchange.slope_files import import_slopes

        keys = _design_keys(design, focal_length_m, radius_m)
        _say_imported(import_slopes(file, out, form, keys, force=force), out, quiet=quiet)

    return import_command


@imports.command("soltrace")
def import_soltrace_command(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="VSHOT file (.sht), or a system (.stinput) with such files.", show_default=False
        ),
    ],
    out: OutMeasurement,
    element: Annotated[
        int | None,
        typer.Option(min=1, help="Which of a system's elements with measured slopes, from 1.", show_default=False),
    ] = None,
    design: SlopeDesign = None,
    focal_length_m: FocalLength = None,
    radius_m: Radius = None,
    force: ForceMeasurement = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Write a measurement folder from measured slopes of SolTrace: a VSHOT file, or that of a system's element."""
    from deflectometry.exchange.slope_files import import_slopes
    from deflectometry.exchange.soltrace_import import slope_file_of_system
    from heliogauge.errors import InputError

    if file.suffix.lower() == ".stinput":
        file = slope_file_of_system(file, element)
    elif element is not None:
        raise InputError("element: only a system (.stinput) has elements; leave it out")
    keys = _design_keys(design, focal_length_m, radius_m)
    _say_imported(import_slopes(file, out, "soltrace", keys, force=force), out, quiet=quiet)


imports.command("slopes", help="Write a measurement folder from a slope map: NetCDF of heliogauge, or a table.")(
    _import_slopes(
        "slopes", "slope_map.nc, or CSV with columns x_m, y_m, slope_x, slope_y and, if known, their sigmas."
    )
)


@imports.command("surface")
def import_surface_command(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="NURBS as ARTIST writes them (.h5), PLY with normals (.ply), or points with normals (.csv).",
            show_default=False,
        ),
    ],
    out: OutMeasurement,
    heliostat: Annotated[
        str | None, typer.Option(help="Which heliostat of an .h5 file with several.", show_default=False)
    ] = None,
    facet: Annotated[
        str | None, typer.Option(help="Which facet of an .h5 file; default: all.", show_default=False)
    ] = None,
    without_canting: Annotated[
        bool, typer.Option("--without-canting", help="Turn facets of an .h5 file back by the canting that it gives.")
    ] = False,
    design: SlopeDesign = None,
    focal_length_m: FocalLength = None,
    radius_m: Radius = None,
    force: ForceMeasurement = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Write a measurement folder from a measured surface."""
    from deflectometry.exchange.slope_files import import_slopes

    keys = _design_keys(design, focal_length_m, radius_m)
    said = import_slopes(
        file, out, "surface", keys, heliostat=heliostat, facet=facet, without_canting=without_canting, force=force
    )
    _say_imported(said, out, quiet=quiet)


def _design_keys(design: str | None, focal_length_m: float | None, radius_m: float | None) -> dict[str, Any]:
    """Return the keys of [mirror] that were given; what does not belong together is refused in words of the options."""
    from heliogauge.errors import InputError
    from heliogauge.measurement.models import DESIGN_KEYS

    lengths = {"focal_length_m": focal_length_m, "radius_m": radius_m}
    given = {name: value for name, value in lengths.items() if value is not None}
    if design is None and not given:
        return {}
    needed = DESIGN_KEYS.get(design or "plane", ())
    for name in (name for name in given if name not in needed):
        shapes = " or ".join(shape for shape, keys in DESIGN_KEYS.items() if name in keys)
        raise InputError(f"{_option(name)} belongs to a {shapes}; add --design {shapes}, or leave it out")
    for name in (name for name in needed if name not in given):
        raise InputError(f"--design {design} needs {_option(name)}")
    return {"design": design or "plane", **given}


def _option(key: str) -> str:
    """Return the option that gives a key of [mirror]."""
    return f"--{key.replace('_', '-')}"


def _say_imported(said: str, out: Path, *, quiet: bool) -> None:
    if not quiet:
        typer.echo(said)
        typer.echo(f"measurement folder: {out}; evaluate it with `heliogauge deflectometry measure {out} -o RESULT`")


@screens.command("geometry")
@writes_results()
def screen_geometry_command(
    folder: MeasurementFolder,
    out: OutFolder,
) -> Job:
    """Photos of a screen or wall to its points, shape and pose: screen.nc, screen.csv, summary.json, report.html."""
    from deflectometry.screen_geometry.keys import load_screen
    from deflectometry.screen_geometry.pipeline.geometry import run

    return Job(
        out,
        lambda progress: run(load_screen(folder), progress),
        hint='; use it with shape = "measured" and file in [screen] of measurement.toml',
    )


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
    dots: Annotated[
        Literal["dark", "light"] | None,
        typer.Option("--dots", help="A field of dots to print or project instead of fringes, marked by two sizes."),
    ] = None,
    pitch_mm: Annotated[
        float | None, typer.Option("--pitch-mm", min=0.0, help="With --dots: distance of two dots on the wall.")
    ] = None,
    width_mm: Annotated[
        float | None, typer.Option("--width-mm", min=0.0, help="With --dots: width of the image on the wall.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace earlier patterns.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Write what is to be displayed or printed, with pattern.toml for measurement.toml: fringes, or a field of dots."""
    from heliogauge.errors import InputError

    if dots is not None:
        from deflectometry.pipeline.write_dots import DotFieldOptions, write_dot_pattern

        if pitch_mm is None or width_mm is None:
            raise InputError("--dots: --pitch-mm and --width-mm are needed")
        if (level_min, level_max, response) != (None, None, None):
            raise InputError("--dots: levels and response are for fringes; leave them out")
        options = DotFieldOptions(width_px, height_px, width_mm, pitch_mm, dots)
        columns, rows = write_dot_pattern(out, options, force=force)
        if not quiet:
            typer.echo(f"dots.png, dots.svg and dots.csv with {columns} x {rows} {dots} dots: {out}")
        return
    if (pitch_mm, width_mm) != (None, None):
        raise InputError("--pitch-mm, --width-mm: for --dots; leave them out")
    from deflectometry.pipeline.write_patterns import DisplayOptions, PatternOptions, write_patterns
    from deflectometry.setup.patterns import Axis
    from heliogauge.running.terminal import terminal_progress

    display = DisplayOptions(width_px, height_px, int(bits), level_min, level_max, response, response_full_level)
    fringes = PatternOptions(parse_periods(periods), steps, Axis(first), grey_steps)
    progress = terminal_progress(quiet=quiet, verbose=verbose)
    pattern = write_patterns(out, display, fringes, force=force, progress=progress)
    if not quiet:
        typer.echo(f"{pattern.n_frames} fringe frames, bright.png, dark.png and {grey_steps} grey levels: {out}")


@app.command("compare")
@writes_results()
def compare_command(
    first: Annotated[Path, typer.Argument(metavar="A", help="Results with a slope map.", show_default=False)],
    second: Annotated[
        Path, typer.Argument(metavar="B", help="Results of the same mirror, of any instrument.", show_default=False)
    ],
    out: OutFolder,
    shared: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SOURCE",
            help='Common source whose error is the same in both, such as "mirror pose"; may be given again.',
            show_default=False,
        ),
    ] = None,
    as_placed: Annotated[
        bool, typer.Option("--as-placed", help="Take both frames as they are; default: placed by the slopes.")
    ] = False,
) -> Job:
    """Compare two results of one mirror: A minus B with its sigma, and which contradicts its own data.

    Exit code 1 where they contradict each other.
    """
    from deflectometry.comparison.pipeline.compare import compare_results

    return Job(out, lambda progress: compare_results(first, second, shared=tuple(shared or ()), as_placed=as_placed))
