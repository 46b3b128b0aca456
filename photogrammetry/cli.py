"""``heliogauge photogrammetry``: photos of targets to coordinates; targets to print."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from heliogauge.running.commands import (
    EitherFolder,
    Force,
    ForceMeasurement,
    Job,
    Jobs,
    MeasurementFolder,
    OutFolder,
    OutMeasurement,
    Quiet,
    ResultsFolder,
    Verbose,
    add_formats,
    make_app,
    writes_results,
)
from heliogauge.running.progress import Progress
from heliogauge.running.slope_commands import add_slope_exports

app = make_app("Photos of coded targets -> coordinates with uncertainty; targets and boards to print.")
imports = add_formats(app, "import")
exports = add_formats(app, "export")
add_slope_exports(exports)


@app.command("measure")
@writes_results()
def measure_command(
    folder: MeasurementFolder,
    out: OutFolder,
    jobs: Jobs = None,
) -> Job:
    """Evaluate a measurement folder: points.csv, cameras.json, residuals.csv, summary.json, report.html."""
    from photogrammetry.keys.load import load_photogrammetry
    from photogrammetry.pipeline.measure import Options, run

    return Job(out, lambda progress: run(load_photogrammetry(folder), Options(jobs=jobs), progress), measured=folder)


@imports.command("colmap")
def import_colmap_command(
    model: Annotated[
        Path,
        typer.Argument(metavar="MODEL", help="Folder with cameras, images, points3D (.bin/.txt).", show_default=False),
    ],
    out: OutMeasurement,
    force: ForceMeasurement = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Write a measurement folder from a COLMAP model, with its poses and points as start values."""
    from photogrammetry.exchange.colmap import import_colmap

    lines = import_colmap(model, out, force=force)
    if not quiet:
        for line in lines:
            typer.echo(line)
        typer.echo(f"measurement folder: {out}; evaluate it with `heliogauge photogrammetry measure {out} -o RESULT`")


@exports.command("colmap")
def export_colmap_command(
    result: ResultsFolder,
    out: OutFolder,
    binary: Annotated[bool, typer.Option("--binary", help="Write .bin files instead of .txt.")] = False,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Write a COLMAP model of cameras, photos and points; covariances have no place in it."""
    from photogrammetry.exchange.colmap import export_colmap

    lines = export_colmap(result, out, binary=binary, force=force)
    if not quiet:
        for line in lines:
            typer.echo(line)
        typer.echo(f"COLMAP model: {out}")


@app.command("plan")
@writes_results()
def plan_command(
    folder: EitherFolder,
    out: OutFolder,
    sigma_mm: Annotated[
        float | None,
        typer.Option(
            min=1e-6, help="Sigma that is wanted, in place of [goal]; default for results: half of what they have."
        ),
    ] = None,
) -> Job:
    """Plan a network: how many photos from where for a wanted sigma; stations.csv, points.csv, report.html.

    Results (a measurement is evaluated first) are planned again: their targets, camera and image sigma.
    """
    from photogrammetry.pipeline.plan_again import planned_measurement
    from photogrammetry.planning.plan import PlanResult, run

    def planned(progress: Progress) -> PlanResult:
        with planned_measurement(folder, sigma_mm, progress) as measurement:
            return run(measurement, progress)

    return Job(out, planned, measured=folder)


@app.command("targets")
@writes_results()
def targets_command(
    photos: Annotated[
        list[Path], typer.Argument(metavar="PHOTO...", help="Photos, or folders of them.", show_default=False)
    ],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for the results.")] = Path(
        "targets-read"
    ),
    dictionary: Annotated[
        str,
        typer.Option(
            help="Ring codes aicon-N or metashape-N (N bits), a file with your own (CSV, TOML), or OpenCV's marker "
            "dictionary DICT_..."
        ),
    ] = "aicon-12",
    sense: Annotated[
        Literal["clockwise", "counterclockwise"] | None,
        typer.Option(help="Sense of the printed codes; default: the dictionary's."),
    ] = None,
    polarity: Annotated[
        Literal["black-on-white", "white-on-black", "both"], typer.Option(help="Which is printed on which.")
    ] = "both",
    smallest_px: Annotated[float, typer.Option(min=3.0, help="Smallest diameter of a dot.")] = 6.0,
    largest_px: Annotated[float, typer.Option(min=6.0, help="Largest diameter of a dot.")] = 300.0,
    jobs: Jobs = None,
) -> Job:
    """Read the targets of single photos, without a network: targets.csv, overlays with what was read and refused."""
    from photogrammetry.keys.targets import TargetsSection
    from photogrammetry.pipeline.single_photos import read_single_photos

    section = TargetsSection(
        dictionary=dictionary, sense=sense, polarity=polarity, smallest_px=smallest_px, largest_px=largest_px
    )
    return Job(out, lambda progress: read_single_photos(photos, section, jobs=jobs, progress=progress))


@app.command("sheets")
def sheets_command(
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Folder to write.", show_default=False)],
    dictionary: Annotated[
        str,
        typer.Option(
            help="Ring codes aicon-N or metashape-N (N bits), a file with your own (CSV, TOML), or OpenCV's marker "
            "dictionary DICT_..."
        ),
    ] = "aicon-12",
    first: Annotated[int, typer.Option(min=0, help="Number of the first target.")] = 1,
    last: Annotated[int | None, typer.Option(min=0, help="Number of the last one; default: 40 targets.")] = None,
    dot_mm: Annotated[float, typer.Option(min=0.5, help="Diameter of the dot; a marker's side is five times it.")] = 10,
    light_on_dark: Annotated[bool, typer.Option("--light-on-dark", help="Ring codes white on black.")] = False,
    board: Annotated[
        Literal["chessboard", "charuco", "circles", "circles-asymmetric"] | None,
        typer.Option(help="A calibration board instead of targets."),
    ] = None,
    columns: Annotated[int, typer.Option(min=3, help="Columns of the board.")] = 7,
    rows: Annotated[int, typer.Option(min=3, help="Rows of the board.")] = 10,
    pitch_mm: Annotated[float, typer.Option(min=1, help="Squares' side or circles' distance of the board.")] = 22,
    paper: Annotated[Literal["A4", "A3", "letter"], typer.Option(help="Size of the paper.")] = "A4",
    landscape: Annotated[bool, typer.Option("--landscape", help="Paper on its side.")] = False,
    no_svg: Annotated[bool, typer.Option("--no-svg", help="Write the PDF only.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace earlier sheets.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Write sheets of coded targets or a calibration board, in true scale with rulers to check the printer."""
    from photogrammetry.targets.ring_codes import Polarity, RingCode
    from photogrammetry.targets.sheet_layout import Paper, board_page, marker_pages, ring_pages
    from photogrammetry.targets.store_ring_codes import load_dictionary
    from photogrammetry.targets.target_sheets import write_sheets

    sheet = Paper(paper, landscape)
    codes: list[RingCode] = []
    numbers = range(first, (first + 39 if last is None else last) + 1)
    if board is not None:
        markers = dictionary if dictionary.startswith("DICT_") else "DICT_5X5_100"
        pages = [board_page(board, columns, rows, pitch_mm, sheet, dictionary=markers)]
    elif dictionary.startswith("DICT_"):
        pages = marker_pages(dictionary, numbers, 5 * dot_mm, sheet)
    else:
        known = load_dictionary(dictionary, Path())
        # Codes of one's own have any names: they are counted in the file's order.
        listed = known.codes[max(first - 1, 0) : last] if Path(dictionary).suffix else None
        codes = [known.code(number) for number in numbers] if listed is None else list(listed)
        polarity = Polarity.WHITE_ON_BLACK if light_on_dark else Polarity.BLACK_ON_WHITE
        pages = ring_pages(codes, dot_mm, sheet, title=known.name, polarity=polarity)
    write_sheets(out, pages, codes, svg=not no_svg, force=force)
    if not quiet:
        typer.echo(out)
