"""``heliogauge beam``: photos of beams on targets to centres, sizes and flux."""

import datetime
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
HeliostatName = Annotated[str | None, typer.Option(help="Its name in a file of ARTIST.", show_default=False)]
Position = Annotated[
    tuple[float, float, float] | None,
    typer.Option("--position", metavar="E N U", help="Its middle in the field [m].", show_default=False),
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

    return Job(out, lambda progress: run(load_beams(folder), Options(jobs=jobs), progress), measured=folder)


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
    heliostat: HeliostatName = None,
    position_m: Position = None,
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
    return Job(out, lambda progress: run(load_beams(folder), options, progress), measured=folder)


@app.command("plan")
@writes_results(report=False)
def plan_command(
    folder: Annotated[
        Path,
        typer.Argument(metavar="FOLDER", help="A trial: a folder as for `beam measure`, or its results."),
    ],
    out: OutFolder,
    wanted_mrad: Annotated[
        float, typer.Option(help="Sigma of a facet's canting that is wanted, RMS over the facets.")
    ] = 0.1,
    day: Annotated[
        list[str] | None,
        typer.Option(
            metavar="YYYY-MM-DD", help="Day on which photos can be taken (repeatable); default: equinox and solstices."
        ),
    ] = None,
    most: Annotated[int, typer.Option(min=1, help="Suns at most.")] = 20,
    surface: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Surface of the mirror, as for `beam compare`.", show_default=False),
    ] = None,
    heliostat: HeliostatName = None,
    position_m: Position = None,
) -> Job:
    """Plan photos from a trial of two or three: which suns and how many frames tell the canting: plan.csv."""
    from calibration.beam.keys import load_beams
    from calibration.beam.pipeline.compare import CompareOptions
    from calibration.beam.planning.plan import BeamPlanOptions, run
    from heliogauge.running.either_folder import measurement_of

    days, place = tuple(_day(text) for text in day or ()), measurement_of(folder)
    trial = CompareOptions(surface, heliostat, position_m)
    options = BeamPlanOptions(1e-3 * wanted_mrad, days, most, trial)
    return Job(out, lambda progress: run(load_beams(place), options, progress), measured=place)


def _day(text: str) -> datetime.date:
    """Return the day that an argument names."""
    from heliogauge.errors import InputError

    try:
        return datetime.date.fromisoformat(text)
    except ValueError as error:
        raise InputError(f"day={text}: a day such as 2026-06-21 is needed ({error})") from error
