"""Photos of a board to a calibrated camera: find the board, start, adjust camera, poses and board together, write."""

from dataclasses import dataclass, replace
from pathlib import Path

from calibration.camera.boards import UnknownField
from calibration.camera.files.result import Result
from calibration.camera.judgement.comparison import compare
from calibration.camera.judgement.network import check_network, check_orientations, check_photos, check_predictions
from calibration.camera.keys import CameraCalibrationMeasurement
from calibration.camera.pipeline.assembly import assemble_result
from calibration.camera.pipeline.inputs import described_board, known_codes
from calibration.camera.pipeline.photos import left_out_doubts, pictures_of_boards, put_aside, search_photos
from calibration.camera.pipeline.solving import check_held_out, solve_network
from calibration.camera.start_values.first_network import first_network
from heliogauge.doubts import Severity, gather_doubts
from heliogauge.errors import InputError, showing
from heliogauge.results.folder import find_copies, hash_files, read_camera_json
from heliogauge.running.progress import Progress, SilentProgress


@dataclass(frozen=True, slots=True)
class Options:
    """Choices of the evaluation.

    Parameters
    ----------
    compare : Path or None
        A camera.json or cameras.json of an earlier calibration of this camera.
    hold_out : str or None
        Photos to check with, by name, a text with ``*``: only their pose is fitted. Several texts with commas.
    refine_board : bool
        Estimate the board's shape; otherwise it is held as drawn.
    leave_one_out : bool
        Calibrate again without each photo, to see how the others predict it.
    jobs : int or None
        Photos that are searched side by side; None for all processors.
    """

    compare: Path | None = None
    hold_out: str | None = None
    refine_board: bool = True
    leave_one_out: bool = True
    jobs: int | None = None


def run(
    measurement: CameraCalibrationMeasurement, options: Options | None = None, progress: Progress | None = None
) -> Result:
    """Calibrate a camera.

    Parameters
    ----------
    measurement : CameraCalibrationMeasurement
        From `heliogauge.load`.
    options : Options, optional
        Choices.
    progress : Progress, optional
        Notified of each stage.

    Returns
    -------
    Result
        The camera with its covariance, poses, the board's shape, and what is doubtful.

    Raises
    ------
    InputError
        Photos that cannot be read or differ in size, photos to hold out that are not there, or a calibration to
        compare with that does not fit.
    EstimationError
        Too few photos show the board, or they do not determine the camera.
    """
    options, progress = options or Options(), progress or SilentProgress()
    model = measurement.model
    board = described_board(measurement)
    if isinstance(board, UnknownField) and not options.refine_board:
        raise InputError("refine_board=False: the places of the targets are not given; give [board] file")
    other = None if options.compare is None else read_camera_json(options.compare)
    with progress.stage("hash inputs"):
        hashes = hash_files(measurement.input_files, measurement.folder)
    left_out: dict[str, str] = {}
    copies = find_copies(measurement.photo_files, hashes, measurement.folder)
    left_out |= {copy.name: f"{copy.name} is a copy of {one.name}" for copy, one in copies.items()}
    files = [file for file in measurement.photo_files if file not in copies]
    found = search_photos(
        files, board, model.camera, known=known_codes(measurement), jobs=options.jobs, progress=progress
    )
    left_out |= found.failures
    found, held = put_aside(found, options.hold_out)
    with progress.stage("start values"), showing(lambda: pictures_of_boards(found)):
        network, doubt = first_network(found, board, tuple(model.camera.free), left_out)
    contradicting: dict[str, str] = {}
    with showing(lambda: pictures_of_boards(found)):
        solved = solve_network(
            network, contradicting, progress, refine_board=options.refine_board, leave_one_out=options.leave_one_out
        )
    with progress.stage("uncertainty"):
        result = replace(
            assemble_result(model.name, model.camera.name, solved), held_out=check_held_out(solved, held, left_out)
        )
        doubts = gather_doubts(
            doubt,
            left_out_doubts(left_out.values()),
            left_out_doubts(contradicting.values(), Severity.DOUBT),
            check_network([photo.cam_from_board for photo in result.photos], result.coverage),
            check_photos(solved.network.points, result.camera),
            check_predictions([photo.name for photo in result.photos], solved.apart_px, solved.apart_expected_px),
            check_orientations(solved.network, solved.orientations),
        )
        comparison = None if other is None else compare(result.camera, other)
    return replace(
        result,
        left_out=left_out | contradicting,
        comparison=comparison,
        compared_with=other,
        thumbnails=found.thumbnails,
        doubts=doubts,
        durations_s=dict(progress.durations_s),
        input_sha256=hashes,
    )
