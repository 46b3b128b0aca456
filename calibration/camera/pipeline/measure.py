"""Photos of a board to a calibrated camera: find the board, start, adjust camera, poses and board together, write."""

from dataclasses import dataclass, replace
from fnmatch import fnmatch
from pathlib import Path

import numpy as np

from calibration.camera.adjustment.board_adjustment import (
    LEAST_PHOTOS,
    Adjusted,
    BoardNetwork,
    adjust_as_drawn,
    adjust_with_shape,
    counted_alike,
    with_true_centers,
)
from calibration.camera.adjustment.other_photos import (
    fit_any_turn,
    fit_pose,
    known_from_all,
    known_from_others,
    mirrored_rms_px,
)
from calibration.camera.boards import Board, CircleGrid, TargetField
from calibration.camera.corners.detection import BoardPoints
from calibration.camera.files.result import (
    BoardShape,
    HeldOutPhoto,
    Intrinsic,
    PhotoResult,
    Quality,
    Result,
    rms_length,
    sigma_of_shape,
)
from calibration.camera.judgement.comparison import compare
from calibration.camera.judgement.network import check_network, check_photos, coverage
from calibration.camera.judgement.projection_sigma import radial_profile, sigma_map
from calibration.camera.keys import CameraCalibrationMeasurement, CameraCalibrationModel
from calibration.camera.pipeline.inputs import described_board, known_codes
from calibration.camera.pipeline.photos import FoundBoards, UnknownField, search_photos
from calibration.camera.start_values.intrinsics import homography, start_camera, start_pose
from calibration.camera.start_values.orientation import Orientations
from calibration.camera.start_values.target_field import started_from_targets
from heliogauge.doubts import Doubt, Severity, gather_doubts
from heliogauge.errors import EstimationError, InputError
from heliogauge.results.folder import find_copies, hash_files, read_camera_json
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.validate import FloatArray
from photogrammetry.bundle import statistics

#: A photo that fits this many times better as a mirror image, and was this many times worse than others, is one.
_MIRROR_GAIN = 3.0


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


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    """An adjusted network, how its photos were counted, and how others predict each photo."""

    network: BoardNetwork
    adjusted: Adjusted
    orientations: Orientations | None
    apart_px: FloatArray


def run(
    measurement: CameraCalibrationMeasurement, options: Options | None = None, progress: Progress | None = None
) -> Result:
    """Calibrate a camera.

    Parameters
    ----------
    measurement : CameraCalibrationMeasurement
        From `heliogauge.measurement.load_camera_calibration`.
    options : Options, optional
        Choices.
    progress : Progress, optional
        Told of each stage.

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
        raise InputError("--board-as-drawn: nothing says how the targets were drawn; give [board] file")
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
    found, held = _held_out(found, options.hold_out)
    with progress.stage("start values"):
        network, doubt = _started(found, board, tuple(model.camera.free), left_out)
    solved = _solved(network, options, left_out, progress)
    with progress.stage("uncertainty"):
        result = replace(_result(model, solved), held_out=_checks(solved, held, left_out))
        doubts = gather_doubts(
            doubt,
            (
                Doubt("photo_left_out", f"photo left out: {reason}", severity=Severity.NOTE)
                for reason in left_out.values()
            ),
            check_network([photo.cam_from_board for photo in result.photos], result.coverage),
            check_photos(solved.network.points, result.camera),
            _check_orientations(solved),
        )
        comparison = None if other is None else compare(result.camera, other)
    return replace(
        result,
        left_out=left_out,
        comparison=comparison,
        compared_with=other,
        doubts=doubts,
        durations_s=dict(progress.durations_s),
        input_sha256=hashes,
    )


def _held_out(found: FoundBoards, patterns: str | None) -> tuple[FoundBoards, tuple[BoardPoints, ...]]:
    """Put photos to check with aside."""
    if patterns is None:
        return found, ()
    texts = [text.strip() for text in patterns.split(",")]
    for text in texts:
        if not any(fnmatch(one.photo, text) for one in found.points):
            raise InputError(f"--hold-out {text}: no photo of that name shows the board; names as in [images] photos")
    aside = [any(fnmatch(one.photo, text) for text in texts) for one in found.points]
    used = tuple(one for one, away in zip(found.points, aside, strict=True) if not away)
    return replace(found, points=used), tuple(one for one, away in zip(found.points, aside, strict=True) if away)


def _started(
    found: FoundBoards, board: Board | UnknownField, free: tuple[str, ...], left_out: dict[str, str]
) -> tuple[BoardNetwork, Doubt | None]:
    if isinstance(board, UnknownField | TargetField):
        _require_photos(len(found.points), left_out)
        return started_from_targets(found, board, free, left_out), None
    good, homographies = [], []
    for one in found.points:
        try:
            homographies.append(homography(one, board.points_m))
            good.append(one)
        except EstimationError as error:
            left_out[one.photo] = str(error)
    _require_photos(len(good), left_out)
    camera, doubt = start_camera(homographies, *found.size_px)
    poses = tuple(start_pose(matrix, camera) for matrix in homographies)
    return BoardNetwork(board, tuple(good), free, camera, poses), doubt


def _require_photos(count: int, left_out: dict[str, str]) -> None:
    if count < LEAST_PHOTOS:
        reasons = list(left_out.values())
        why = "; ".join(reasons[:3]) + (f"; and {len(reasons) - 3} more" if len(reasons) > 3 else "")
        raise EstimationError(
            f"{count} photos show the board, at least {LEAST_PHOTOS} different ones are needed (10 or more are "
            f"better)" + (f": {why}" if why else "")
        )


def _solved(network: BoardNetwork, options: Options, left_out: dict[str, str], progress: Progress) -> _Solved:
    """Adjust; a photo that turns out to be mirrored is left out, and all is done again."""
    with progress.stage("adjust"):
        drawn_rms = float("nan")
        orientations = None
        if network.places_known:
            network, drawn_rms = adjust_as_drawn(network, left_out)
            network, orientations = counted_alike(network)
        raw, state = network.points, network.start()
        # The first correction of centres takes the poses on a board as drawn, the second those on the board as it is.
        for _ in range(2 if isinstance(network.board, CircleGrid | TargetField) else 1):
            network = with_true_centers(network, raw, state)
            adjusted = adjust_with_shape(network, drawn_rms, refine_board=options.refine_board)
            state = adjusted.bundle.state
    apart = np.full(len(network.points), np.nan)
    if options.leave_one_out and len(network.points) > LEAST_PHOTOS:
        mirrored = []
        with progress.stage("keep photos apart", len(network.points)) as stage:
            for photo, points in enumerate(network.points):
                known = known_from_others(network, adjusted, photo)
                apart[photo], _ = fit_pose(known, points, adjusted.bundle.state.cam_from_world(photo))
                if _MIRROR_GAIN * mirrored_rms_px(known, network.board, points) < apart[photo]:
                    mirrored.append(photo)
                stage.advance()
        # One mirrored photo spoils what the others are compared with: the worst first.
        if mirrored and len(network.points) - 1 >= LEAST_PHOTOS:
            worst = max(mirrored, key=lambda photo: float(apart[photo]))
            name = network.points[worst].photo
            left_out[name] = f"{name}: fits the others as a mirror image only; the file is the wrong way round"
            return _solved(network.without(worst), options, left_out, progress)
    return _Solved(network, adjusted, orientations, apart)


def _checks(solved: _Solved, held: tuple[BoardPoints, ...], left_out: dict[str, str]) -> tuple[HeldOutPhoto, ...]:
    """Fit the poses of the photos that were held out."""
    network, checks = solved.network, []
    known = known_from_all(network, solved.adjusted)
    for raw in held:
        try:
            rms, pose, points = fit_any_turn(known, network.board, raw)
            # Circles' centres are corrected as those of the photos used; so near a pose the first one does.
            alone = replace(network, points=(points,))
            state = replace(
                solved.adjusted.bundle.state, rotations=pose.rotation[None], translations_m=pose.translation_m[None]
            )
            points = with_true_centers(alone, (points,), state).points[0]
            rms, pose = fit_pose(known, points, pose)
        except EstimationError as error:
            left_out[raw.photo] = f"{raw.photo}: held out, and {error}"
            continue
        checks.append(HeldOutPhoto(raw.photo, pose, raw.n, rms))
    return tuple(checks)


def _check_orientations(solved: _Solved) -> Doubt | None:
    """Return a doubt where the print looks the same turned, and what that came to."""
    found, network = solved.orientations, solved.network
    if found is None:
        return None
    names = [one.photo for one in network.points]
    said = f"{network.board.describe()}: it looks the same turned, so only its own shape tells how photos are turned; "
    if found.open:
        listed = ", ".join(names[i] for i in found.open[:8]) + (" ..." if len(found.open) > 8 else "")
        said += (
            f"it does not in {len(found.open)} of {len(names)} photos ({listed}): there the points may be mixed up, "
            "which is harmless only on a flat and true board; "
        )
    else:
        said += f"it does so surely in all of them ({len(found.turned)} were turned); "
    return Doubt(
        "board_looks_the_same_turned",
        said + "better use one even and one odd number of corners, or an asymmetric grid with odd rows",
        {"open_count": len(found.open), "turned_count": len(found.turned), "photos_count": len(names)},
        Severity.DOUBT if found.open else Severity.NOTE,
    )


# --- result ---------------------------------------------------------------------------------------------------------


def _result(model: CameraCalibrationModel, solved: _Solved) -> Result:
    network, adjusted, apart = solved.network, solved.adjusted, solved.apart_px
    bundle = adjusted.bundle
    camera = bundle.cameras[0]
    whole = network.observations()
    residuals = np.full((whole.n, 2), np.nan)
    residuals[adjusted.kept] = bundle.residuals_px
    photos = tuple(
        PhotoResult(
            one.photo,
            bundle.state.cam_from_world(i),
            bundle.covariance.poses[i],
            one.index,
            one.pixels_px,
            residuals[whole.photo_index == i],
            float(apart[i]),
        )
        for i, one in enumerate(network.points)
    )
    joint = bundle.covariance.joint(targets=np.arange(network.seen.size))
    shape = BoardShape(
        network.board,
        network.seen,
        bundle.state.points_m,
        np.zeros((network.seen.size, 3))
        if not adjusted.prior_sigma_m.any()
        else sigma_of_shape(bundle.state.points_m, joint),
        bundle.problem.observations.n_rays,
        adjusted.prior_sigma_m,
        bundle.datum,
    )
    quality = Quality(
        rms_length(bundle.residuals_px), adjusted.rms_as_drawn_px, adjusted.factor, bundle.redundancy, adjusted.rejected
    )
    pixels = whole.pixels_px[adjusted.kept]
    distance = float(np.median([np.linalg.norm(photo.cam_from_board.translation_m) for photo in photos]))
    tests = tuple(
        Intrinsic(one.name, one.value, one.sigma, one.significance, one.rival, one.correlation)
        for one in statistics.examine_intrinsics(bundle)
    )
    return Result(
        model.camera.name,
        camera,
        tests,
        photos,
        {},
        shape,
        quality,
        sigma_map(camera, distance),
        radial_profile(camera, pixels),
        coverage(camera, pixels),
        name=model.name,
    )
