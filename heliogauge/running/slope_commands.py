"""The commands ``export soltrace | ply | csv``, which all instruments with slope maps have."""

from collections.abc import Callable
from typing import Annotated

import typer

from heliogauge.running.commands import OutPath, Quiet, ResultsFolder, Verbose

_SENTENCES = {
    "soltrace": "Write for SolTrace: a surface file (.sht), or a system (.stinput) with sun, optics, tube or target.",
    "ply": "Write a mesh with heights and normals (.ply).",
    "csv": "Write a table with a row for each node: place, slopes, design, sigma, height, flag (.csv).",
}

Facet = Annotated[
    str | None,
    typer.Option("--facet", metavar="NAME", help="One facet of several; default: all together.", show_default=False),
]
Replace = Annotated[bool, typer.Option("--force", help="Replace an existing file.")]


def add_slope_exports(exports: typer.Typer) -> None:
    """Add the forms of slope maps to an instrument's ``export``."""
    for form, sentence in _SENTENCES.items():
        exports.command(form, help=sentence)(_export_soltrace if form == "soltrace" else _command(form))


def _export_soltrace(
    result: ResultsFolder,
    out: OutPath,
    facet: Facet = None,
    sun: Annotated[
        str, typer.Option(metavar="SHAPE", help="Of a system: pillbox:MRAD, gaussian:MRAD, or a file .sun.")
    ] = "pillbox:4.65",
    sun_direction: Annotated[
        str, typer.Option(metavar="X,Y,Z", help="Of a system: direction to the sun in the frame of the map.")
    ] = "0,0,1",
    reflectance: Annotated[float, typer.Option(min=0.0, max=1.0, help="Of a system: of the mirror.")] = 1.0,
    specularity_mrad: Annotated[
        float, typer.Option(min=0.0, help="Of a system: RMS of the reflected beam in one direction.")
    ] = 0.0,
    tube_diameter_mm: Annotated[float, typer.Option(min=0.0, help="Of a system: black tube along y.")] = 0.0,
    tube_height_m: Annotated[float, typer.Option(min=0.0, help="Height of the tube's axis over the vertex.")] = 0.0,
    target_distance_m: Annotated[float, typer.Option(min=0.0, help="Of a system: square target across z.")] = 0.0,
    target_size_m: Annotated[float, typer.Option(min=0.0, help="Its side.")] = 0.0,
    points: Annotated[int, typer.Option(min=100, help="Of a system: most points of each slope file.")] = 4000,
    force: Replace = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    from heliogauge.errors import InputError

    if out.suffix.lower() != ".stinput":
        _command("soltrace")(result, out, facet, force, quiet, verbose)
        return
    if facet is not None:
        raise InputError("facet: a system (.stinput) holds all facets; for one of them write a slope file (.sht)")
    from heliogauge.results.soltrace_export import SystemChoices, export_system

    cells = sun_direction.split(",")
    try:
        x, y, z = (float(cell) for cell in cells)
    except ValueError:
        raise InputError(f"sun_direction={sun_direction}: three numbers with commas are needed") from None
    choices = SystemChoices(
        sun,
        (x, y, z),
        reflectance,
        1e-3 * specularity_mrad,
        1e-3 * tube_diameter_mm,
        tube_height_m,
        target_distance_m,
        target_size_m,
        points,
    )
    for line in export_system(result, out, choices, force=force):
        if not quiet:
            typer.echo(line)


def _command(form: str) -> Callable[..., None]:
    def export(
        result: ResultsFolder,
        out: OutPath,
        facet: Facet = None,
        force: Replace = False,
        quiet: Quiet = False,
        verbose: Verbose = False,
    ) -> None:
        from heliogauge.results.slope_export import export_slope_map

        said = export_slope_map(result, out, form, facet=facet, force=force)
        if not quiet:
            typer.echo(said)

    return export
