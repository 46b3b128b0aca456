"""``heliogauge camera``: photos of a board or targets to a calibrated camera."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from heliogauge.running.commands import (
    AsJson,
    Force,
    ForceMeasurement,
    Job,
    Jobs,
    MeasurementFolder,
    OutFolder,
    OutMeasurement,
    OutPath,
    Quiet,
    Verbose,
    add_formats,
    make_app,
    writes_results,
)

app = make_app("Photos of a calibration board or of targets -> calibrated camera, with covariance.")
imports = add_formats(app, "import")
exports = add_formats(app, "export")

CameraPath = Annotated[
    Path,
    typer.Argument(metavar="OUT", help="Results of `heliogauge camera measure`, or cameras.json.", show_default=False),
]
CameraName = Annotated[
    str | None, typer.Option("--camera", metavar="NAME", help="Which of several cameras.", show_default=False)
]
Replace = Annotated[bool, typer.Option("--force", help="Replace an existing file.")]


@app.command("measure")
@writes_results()
def measure_command(
    folder: MeasurementFolder,
    out: OutFolder,
    compare: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Compare with an earlier camera.json or cameras.json.")
    ] = None,
    refine_board: Annotated[
        bool, typer.Option("--refine-board/--board-as-drawn", help="Estimate the board's shape, or hold it.")
    ] = True,
    hold_out: Annotated[
        str | None,
        typer.Option(metavar="PATTERN", help="Photos to check with, such as 'check_*': only their pose is fitted."),
    ] = None,
    leave_one_out: Annotated[
        bool, typer.Option("--leave-one-out/--no-leave-one-out", help="Also calibrate without each photo, as a check.")
    ] = True,
    jobs: Jobs = None,
) -> Job:
    """Calibrate a camera: cameras.json, camera_opencv.yaml, points.csv (the board's shape), report.html."""
    from calibration.camera.keys import load_camera_calibration
    from calibration.camera.pipeline.measure import Options, run

    options = Options(compare, hold_out, refine_board, leave_one_out, jobs)
    return Job(
        out,
        lambda progress: run(load_camera_calibration(folder), options, progress),
        measured=folder,
        hint='; use it with file = "cameras.json" in [camera] of another measurement',
    )


@app.command("plan")
@writes_results()
def plan_command(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER",
            help="Folder with measurement.toml, which is calibrated first, or results of `heliogauge camera measure`.",
            show_default=False,
        ),
    ],
    out: OutFolder,
    photos: Annotated[int, typer.Option(min=1, help="Photos to propose at most.")] = 4,
    wanted_mrad: Annotated[
        float | None, typer.Option(help="Sigma of lines of sight that is enough; default: all photos are proposed.")
    ] = None,
    parameter: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Intrinsic whose sigma shall become small, such as focal_px (repeatable); default: lines of sight.",
        ),
    ] = None,
    nearest: Annotated[
        float | None, typer.Option(help="Nearest the camera can be, as distances of photos.csv; default: 2/3 of them.")
    ] = None,
    farthest: Annotated[
        float | None, typer.Option(help="Farthest it can be; default: 3/2 of the largest in photos.csv.")
    ] = None,
) -> Job:
    """Propose the photos that a calibration needs next: next_photos.csv, how the board should look, the new sigma."""
    from calibration.camera.planning.plan import NextPhotosResult, PlanOptions, run
    from heliogauge.running.either_folder import results_of
    from heliogauge.running.progress import Progress

    wanted_rad = None if wanted_mrad is None else 1e-3 * wanted_mrad
    options = PlanOptions(photos, wanted_rad, tuple(parameter or ()), nearest, farthest)

    def planned(progress: Progress) -> NextPhotosResult:
        with results_of(folder, "camera", progress) as results:
            return run(results, options, progress)

    return Job(out, planned, measured=folder)


@app.command("compare")
def compare_command(
    camera: CameraPath,
    other: Annotated[
        Path, typer.Argument(metavar="OTHER", help="Another calibration of the same camera.", show_default=False)
    ],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="DIR", help="Folder for the results; default: they are only said."),
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Say how far two calibrations differ, as angles between their lines of sight, and whether by more than chance."""
    from calibration.camera.files.compared import Compared
    from calibration.camera.files.opencv_files import read_calibrated
    from calibration.camera.judgement.comparison import compare
    from heliogauge.results.folder import summary_content
    from heliogauge.results.frame import into_folder
    from heliogauge.results.json_file import json_text
    from heliogauge.running.terminal import terminal_progress

    both = [read_calibrated(path) for path in (camera, other)]
    result = Compared(name=f"{camera.name} and {other.name}", comparison=compare(*both))
    if out is not None:
        progress = terminal_progress(quiet=quiet, verbose=verbose)
        into_folder(out, lambda: result, progress, force=force, report=False)
    if as_json:
        typer.echo(json_text("summary", summary_content(result.summarise())).rstrip())
    elif not quiet:
        typer.echo(result.headline())
        if out is not None:
            typer.echo(f"results: {out}")


@imports.command("opencv")
def import_opencv_command(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE",
            help="Calibrations that OpenCV wrote (YAML, XML, JSON), one for each camera.",
            show_default=False,
        ),
    ],
    out: OutMeasurement,
    width_px: Annotated[
        int | None, typer.Option(min=1, help="Width of the images, where the files do not have it.")
    ] = None,
    height_px: Annotated[
        int | None, typer.Option(min=1, help="Height of the images, where the files do not have it.")
    ] = None,
    force: ForceMeasurement = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Write a folder with cameras.json from calibrations made with OpenCV."""
    from calibration.camera.files.opencv_files import import_opencv
    from heliogauge.errors import InputError

    if (width_px is None) != (height_px is None):
        raise InputError("width_px and height_px belong together; give both or none")
    size = None if width_px is None or height_px is None else (width_px, height_px)
    lines = import_opencv(files, out, size_px=size, force=force)
    if not quiet:
        for line in lines:
            typer.echo(line)
        typer.echo(f'{out / "cameras.json"}: use it with file = "cameras.json" in [camera] of a measurement')


def _export(form: str) -> Callable[..., None]:
    def export_command(
        result: CameraPath,
        out: OutPath,
        camera: CameraName = None,
        force: Replace = False,
        quiet: Quiet = False,
        verbose: Verbose = False,
    ) -> None:
        from calibration.camera.files.opencv_files import export_camera

        export_camera(result, out, form, name=camera, force=force)
        if not quiet:
            typer.echo(out)

    return export_command


exports.command("opencv", help="Write a camera as OpenCV reads it (YAML of cv2.FileStorage).")(_export("opencv"))
exports.command("colmap", help="Write a camera as COLMAP reads it (cameras.txt).")(_export("colmap"))
