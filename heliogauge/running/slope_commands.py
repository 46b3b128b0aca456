"""The commands ``export soltrace | ply | csv``, which all instruments with slope maps have."""

from collections.abc import Callable
from typing import Annotated

import typer

from heliogauge.running.commands import OutPath, Quiet, ResultsFolder, Verbose

_SENTENCES = {
    "soltrace": "Write a surface file of SolTrace (.sht): measured slopes, and a polynomial for the height.",
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
        exports.command(form, help=sentence)(_command(form))


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
