"""``heliogauge beam``: photos of beams on targets to centres, sizes and flux."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from heliogauge.running.commands import Job, Jobs, OutFolder, make_app, writes_results

app = make_app("Photos of beams on a target -> centres, sizes, flux with sigma.")

BeamFolder = Annotated[
    Path,
    typer.Argument(
        metavar="FOLDER",
        help="Folder with measurement.toml, or with records and pictures as of the PAINT database.",
        show_default=False,
    ),
]


@app.command("measure")
@writes_results()
def measure_command(
    folder: BeamFolder,
    out: OutFolder,
    jobs: Jobs = None,
) -> Job:
    """Measure beams in photos: beams.csv, contours.csv, flux.nc, summary.json, report.html."""
    from calibration.beam.keys import load_beams
    from calibration.beam.pipeline.measure import Options, run

    return Job(out, lambda progress: run(load_beams(folder), Options(jobs=jobs), progress))


@app.command("compare")
@writes_results()
def compare_command(
    folder: BeamFolder,
    out: OutFolder,
    surface: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Surface of the mirror: slope_map.nc, a file of ARTIST (.h5), or points (.csv).",
            show_default=False,
        ),
    ] = None,
    heliostat: Annotated[str | None, typer.Option(help="Its name in a file of ARTIST.", show_default=False)] = None,
    position_m: Annotated[
        tuple[float, float, float] | None,
        typer.Option("--position", metavar="E N U", help="Its middle in the field [m].", show_default=False),
    ] = None,
    mount: Annotated[
        Literal["azimuth-elevation", "east-axis"] | None,
        typer.Option(help="How it turns; default: as [mirror] says, or by the files.", show_default=False),
    ] = None,
    fit: Annotated[
        bool, typer.Option("--fit/--no-fit", help="Estimate canting, focus and scatter from the flux.")
    ] = True,
) -> Job:
    """Compare beams with the mirror that made them: expected flux, correlation, canting from flux."""
    from calibration.beam.keys import load_beams
    from calibration.beam.pipeline.compare import CompareOptions, run

    options = CompareOptions(surface, heliostat, position_m, mount, fit)
    return Job(out, lambda progress: run(load_beams(folder), options, progress))
