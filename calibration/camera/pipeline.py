"""Photos of a board to a calibrated camera: find the board, start, adjust camera, poses and board together, write."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from calibration.camera.boards import Board, CharucoBoard, Chessboard, CircleGrid, TargetField, board_warnings
from calibration.camera.detect import BoardPoints, find_charuco, find_chessboard, find_circles
from calibration.camera.intrinsics import homography, start_camera, start_pose
from calibration.camera.pipeline_inputs import described_board, different_photos
from calibration.camera.projection_sigma import compare, coverage, network_warnings, radial_profile, sigma_map
from calibration.camera.result import BoardShape, Intrinsic, PhotoResult, Quality, Result, rms_length, sigma_of_shape
from heliogauge.camera import Camera
from heliogauge.errors import EstimationError, InputError
from heliogauge.images import read_image
from heliogauge.measurement import CameraCalibrationMeasurement
from heliogauge.measurement_models import CameraCalibrationModel
from heliogauge.progress import Progress, SilentProgress
from heliogauge.rigid import RigidTransform
from heliogauge.store import hash_files, read_camera_json
from heliogauge.validate import BoolArray, FloatArray
from photogrammetry.bundle import BundleProblem, BundleResult, BundleState, CameraModel, adjust, bundle_state
from photogrammetry.bundle_diagnosis import require
from photogrammetry.bundle_statistics import examine_image_points, examine_intrinsics
from photogrammetry.coded_targets import ring_dictionary
from photogrammetry.constraints import ControlPoint
from photogrammetry.detect import measure_center
from photogrammetry.ellipse import Ellipse, eccentricity_px
from photogrammetry.observations import ImagePoints
from photogrammetry.photo_targets import TargetSearch, measure_targets
from photogrammetry.template_center import template_center

#: Two tilted photos determine a camera with square pixels and nothing to spare; three have something to spare.
LEAST_PHOTOS = 3
#: A board is taken to be as drawn to 2 % of its pitch in its plane and 10 % across it, until its departure is seen.
_FIRST_PRIOR = np.array([0.02, 0.02, 0.1])
#: Then to twice the departure that was found (smooth departures are not independent), never better than this.
_PRIOR_FACTOR, _LEAST_PRIOR = 2.0, 2e-4
#: Points farther off than this many sigmas of what is usual here are left out; 1 in 10^7 good ones is.
_REJECTED_SIGMAS = 6.0
#: A photo this many times worse than the middle one, and by pixels, shows something else than the board.
_WORSE_PHOTO, _WORSE_PHOTO_PX = 8.0, 2.0
_STEPS = (("focal_px",), ("focal_px", "center_x_px", "center_y_px", "k1", "k2"))


@dataclass(frozen=True, slots=True)
class Options:
    """Choices of the evaluation.

    Parameters
    ----------
    compare : Path or None
        A camera.json or cameras.json of an earlier calibration of this camera.
    refine_board : bool
        Estimate the board's shape; otherwise it is held as drawn.
    held_out : bool
        Calibrate again without each photo, to see how the others predict it.
    jobs : int or None
        Photos that are searched side by side; None for all processors.
    """

    compare: Path | None = None
    refine_board: bool = True
    held_out: bool = True
    jobs: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class _Network:
    """Photos with the board found, and start values; ``seen`` are points of the board in at least one photo."""

    board: Board
    points: tuple[BoardPoints, ...]
    free: tuple[str, ...]
    camera: Camera
    poses: tuple[RigidTransform, ...]

    @property
    def seen(self) -> npt.NDArray[np.intp]:
        return np.unique(np.concatenate([one.index for one in self.points]))

    @property
    def names(self) -> tuple[str, ...]:
        names = self.board.names
        return tuple(names[i] for i in self.seen)

    def observations(self) -> ImagePoints:
        """Gather all photos in one table."""
        place = np.full(len(self.board.names), -1, dtype=np.intp)
        place[self.seen] = np.arange(self.seen.size)
        return ImagePoints(
            tuple(one.photo for one in self.points),
            self.names,
            np.repeat(np.arange(len(self.points)), [one.n for one in self.points]),
            np.concatenate([place[one.index] for one in self.points]),
            np.concatenate([one.pixels_px for one in self.points]),
            np.concatenate([one.covariance_px2 for one in self.points]),
        )

    def start(self) -> BundleState:
        """Return the state to start from: the board as drawn."""
        return bundle_state([self.camera], self.poses, self.board.points_m[self.seen])

    def without(self, photo: int) -> "_Network":
        """Return the network without one photo."""
        rest = [i for i in range(len(self.points)) if i != photo]
        return replace(self, points=tuple(self.points[i] for i in rest), poses=tuple(self.poses[i] for i in rest))


@dataclass(frozen=True, slots=True, eq=False)
class _Adjusted:
    """The last adjustment: ``kept`` marks the image points used, ``factor`` the residuals over the stated sigmas."""

    bundle: BundleResult
    kept: BoolArray
    factor: float
    prior_sigma_m: FloatArray
    rms_as_drawn_px: float
    rejected: tuple[str, ...] = ()


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
        Photos that cannot be read or differ in size, or a calibration to compare with that does not fit.
    EstimationError
        Too few photos show the board, or they do not determine the camera.
    """
    options, progress = options or Options(), progress or SilentProgress()
    model = measurement.model
    board = described_board(measurement)
    other = None if options.compare is None else read_camera_json(options.compare)
    with progress.stage("hash inputs"):
        hashes = hash_files(measurement.input_files, measurement.folder)
    left_out: dict[str, str] = {}
    files = different_photos(measurement.photo_files, measurement.folder, hashes, left_out)
    found, size = _found(files, board, model, options, progress)
    with progress.stage("start values"):
        network, doubt = _started(found, board, size, tuple(model.camera.free), left_out)
    with progress.stage("adjust"):
        network, first = _as_drawn(network, left_out)
        raw = network.points
        network = _eccentricity_corrected(network, raw, first.state)
        adjusted = _adjusted(network, first, options.refine_board)
        if isinstance(board, CircleGrid):
            # The first correction took the poses on a board as drawn.
            network = _eccentricity_corrected(network, raw, adjusted.bundle.state)
            adjusted = _adjusted(network, first, options.refine_board)
    apart = np.full(len(network.points), np.nan)
    if options.held_out and len(network.points) > LEAST_PHOTOS:
        with progress.stage("keep photos apart", len(network.points)) as stage:
            for photo in range(len(network.points)):
                apart[photo] = _kept_apart(network, adjusted, photo)
                stage.advance()
    with progress.stage("uncertainty"):
        result = _result(model, network, adjusted, apart)
        said = [doubt] if doubt else []
        said += [f"photo left out: {reason}" for reason in left_out.values()]
        said += list(network_warnings([photo.cam_from_board for photo in result.photos], result.coverage))
        said += board_warnings(board)
        comparison = None if other is None else compare(result.camera, other)
    return replace(
        result,
        left_out=left_out,
        comparison=comparison,
        warnings=tuple(said),
        durations_s=dict(progress.durations_s),
        input_sha256=hashes,
    )


# --- photos ---------------------------------------------------------------------------------------------------------


def _found(
    files: Sequence[Path], board: Board, model: CameraCalibrationModel, options: Options, progress: Progress
) -> tuple[list[BoardPoints | EstimationError], tuple[int, int]]:
    """Search all photos; where the board is not found, the reason stands in its place."""
    found: list[BoardPoints | EstimationError] = []
    asked = (model.camera.width_px, model.camera.height_px)
    size: tuple[int, int] | None = None
    with progress.stage("find the board", len(files)) as stage, ThreadPoolExecutor(options.jobs) as pool:
        for file, (points, own) in zip(files, pool.map(lambda path: _search(path, board), files), strict=True):
            size = size or own
            if own != size:
                raise InputError(
                    f"{file.name} has {own[0]} x {own[1]} px, but {files[0].name} {size[0]} x {size[1]}; photos of one "
                    "camera at one resolution, all upright or all on their side in the file, are needed"
                )
            if any(want is not None and want != got for want, got in zip(asked, own, strict=True)):
                raise InputError(
                    f"{file.name} has {own[0]} x {own[1]} px, but measurement.toml says camera.width_px = {asked[0]}, "
                    f"camera.height_px = {asked[1]}"
                )
            found.append(points)
            stage.advance()
    return found, size or (0, 0)


def _search(path: Path, board: Board) -> tuple[BoardPoints | EstimationError, tuple[int, int]]:
    image = read_image(path)
    size = (int(image.shape[1]), int(image.shape[0]))
    try:
        return _measured(path.name, image, board), size
    except EstimationError as error:
        return error, size


def _measured(photo: str, image: npt.NDArray[Any], board: Board) -> BoardPoints:
    if isinstance(board, Chessboard):
        return find_chessboard(photo, image, board)
    if isinstance(board, CharucoBoard):
        return find_charuco(photo, image, board)
    if isinstance(board, CircleGrid):
        return _with_centers(image, find_circles(photo, image, board), board)
    if isinstance(board, TargetField):
        return _target_points(photo, image, board)
    raise InputError(f"{photo}: boards of the kind {type(board).__name__} are not known")


def _with_centers(image: npt.NDArray[Any], rough: BoardPoints, board: CircleGrid) -> BoardPoints:
    """Measure the centres of dots that were found roughly."""
    shape = homography(rough, board.points_m)
    radius = 0.5 * board.diameter_share * board.pitch_m
    places, pixels, covariances = [], [], []
    for place, rough_px in zip(rough.index.tolist(), rough.pixels_px, strict=True):
        plane = board.points_m[place, :2]
        ends = np.column_stack([np.vstack([plane, plane + radius * np.eye(2)]), np.ones(3)]) @ shape.T
        ends = ends[:, :2] / ends[:, 2:]
        frame = (ends[1:] - ends[0]).T
        try:
            center = measure_center(image, Ellipse(rough_px, frame @ frame.T), template_center)
        except EstimationError:
            continue
        places.append(place)
        pixels.append(center.center_px)
        covariances.append(0.5 * (center.covariance_px2 + center.covariance_px2.T))
    if len(places) < 0.5 * rough.n:
        raise EstimationError(f"{rough.photo}: only {len(places)} of {rough.n} dots can be measured as blurred discs")
    return BoardPoints(rough.photo, np.array(places, dtype=np.intp), np.array(pixels), np.array(covariances))


def _target_points(photo: str, image: npt.NDArray[Any], board: TargetField) -> BoardPoints:
    search = TargetSearch(dictionary=ring_dictionary(board.dictionary), with_uncoded=False)
    found = measure_targets(image, photo, search).detections
    twice = set(found.duplicated)
    place = {name: i for i, name in enumerate(board.names)}
    usable = found.usable
    chosen = [k for k, name in enumerate(found.names) if name in place and name not in twice and usable[k]]
    index = np.array([place[found.names[k]] for k in chosen], dtype=np.intp)
    covariance = found.covariance_px2[chosen]
    return BoardPoints(photo, index, found.pixels_px[chosen], 0.5 * (covariance + np.swapaxes(covariance, 1, 2)))


# --- start and adjustment -------------------------------------------------------------------------------------------


def _started(
    found: Sequence[BoardPoints | EstimationError],
    board: Board,
    size: tuple[int, int],
    free: tuple[str, ...],
    left_out: dict[str, str],
) -> tuple[_Network, str]:
    good, homographies = [], []
    for one in found:
        try:
            if isinstance(one, EstimationError):
                raise one
            homographies.append(homography(one, board.points_m))
            good.append(one)
        except EstimationError as error:
            left_out[str(error).split(":", 1)[0]] = str(error)
    if len(good) < LEAST_PHOTOS:
        why = "; ".join(left_out.values())
        raise EstimationError(
            f"{len(good)} photos show the board, at least {LEAST_PHOTOS} different ones are needed (10 or more are "
            f"better)" + (f": {why}" if why else "")
        )
    camera, doubt = start_camera(homographies, *size)
    poses = tuple(start_pose(matrix, camera) for matrix in homographies)
    return _Network(board, tuple(good), free, camera, poses), doubt


def _as_drawn(network: _Network, left_out: dict[str, str]) -> tuple[_Network, BundleResult]:
    """Adjust with the board held as drawn, more intrinsics at each step; photos of something else are left out."""
    for _ in range(len(network.points)):
        state, table = network.start(), network.observations()
        result: BundleResult | None = None
        for step in (*_STEPS, network.free):
            names = tuple(name for name in step if name in network.free)
            model = CameraModel("camera", names)
            result = adjust(BundleProblem(table, (model,), fixed=network.names), state)
            state = result.state
        if result is None:
            break
        rms = np.array([rms_length(result.residuals_px[table.photo_index == i]) for i in range(len(table.photos))])
        worst, usual = int(np.argmax(rms)), float(np.median(rms))
        if rms[worst] < max(_WORSE_PHOTO * usual, _WORSE_PHOTO_PX) or len(rms) <= LEAST_PHOTOS:
            poses = tuple(state.cam_from_world(i) for i in range(len(rms)))
            return replace(network, camera=state.cameras[0], poses=poses), result
        name = network.points[worst].photo
        left_out[name] = f"{name}: its points miss the board by {rms[worst]:.1f} px RMS, those of others by {usual:.2g}"
        network = network.without(worst)
    raise EstimationError("no set of photos agrees on one camera and one board")


def _eccentricity_corrected(network: _Network, measured: Sequence[BoardPoints], state: BundleState) -> _Network:
    """Move centres of circles' images to the images of their centres, seen as the state says."""
    board = network.board
    if not isinstance(board, CircleGrid):
        return network
    places_m, normals = board.points_m.copy(), np.tile([0.0, 0.0, 1.0], (len(board.names), 1))
    places_m[network.seen] = state.points_m
    x, y = places_m[:, 0], places_m[:, 1]
    # A print is bent smoothly: its normals come from a quadratic.
    terms = np.stack([np.ones(x.size), x, y, x * x, x * y, y * y], axis=1)
    bent = np.linalg.lstsq(terms[network.seen], places_m[network.seen, 2], rcond=None)[0]
    normals[:, 0] = -(bent[1] + 2 * bent[3] * x + bent[4] * y)
    normals[:, 1] = -(bent[2] + bent[4] * x + 2 * bent[5] * y)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    radius, points = 0.5 * board.diameter_share * board.pitch_m, []
    for i, one in enumerate(measured):
        pose = state.cam_from_world(i)
        shift = eccentricity_px(
            state.cameras[0], pose.apply(places_m[one.index]), pose.rotate(normals[one.index]), radius
        )
        points.append(replace(one, pixels_px=one.pixels_px - shift))
    return replace(network, points=tuple(points))


def _problem(free: tuple[str, ...], table: ImagePoints, drawn_m: FloatArray, sigma_m: FloatArray) -> BundleProblem:
    """Pose the adjustment: the drawing is knowledge with a sigma, or exact where that is 0."""
    model = (CameraModel("camera", free),)
    if not sigma_m.any():
        return BundleProblem(table, model, fixed=table.targets)
    covariance = np.diag(sigma_m**2)
    known = tuple(ControlPoint(name, place, covariance) for name, place in zip(table.targets, drawn_m, strict=True))
    return BundleProblem(table, model, constraints=known)


def _adjusted(network: _Network, first: BundleResult, refine_board: bool) -> _Adjusted:
    """Adjust three times: see outliers, then the size of residuals and of the board's departure, then for good."""
    table, drawn = network.observations(), network.board.points_m[network.seen]
    drawn_rms = rms_length(first.residuals_px)
    pitch = network.board.pitch_m
    prior = _FIRST_PRIOR * pitch if refine_board else np.zeros(3)
    bundle = adjust(_problem(network.free, table, drawn, prior), network.start())
    tests = examine_image_points(bundle)
    usual = float(np.median(tests.length_squared)) / (2 * np.log(2.0))
    kept = tests.length_squared <= _REJECTED_SIGMAS**2 * usual
    rejected = tuple(
        f"{table.label(int(row))}: {np.hypot(*bundle.residuals_px[row]):.3f} px" for row in np.nonzero(~kept)[0]
    )
    factor = 1.0
    for _ in range(2):
        used = kept if bundle.problem.observations.n == kept.size else np.ones(np.count_nonzero(kept), np.bool_)
        factor *= _variance_share(bundle, used)
        if refine_board:
            departure = bundle.state.points_m - drawn
            seen = np.sqrt((departure**2).mean(axis=0))
            in_plane = float(np.hypot(seen[0], seen[1])) * np.sqrt(0.5)
            prior = np.maximum(_PRIOR_FACTOR * np.array([in_plane, in_plane, seen[2]]), _LEAST_PRIOR * pitch)
        scaled = replace(table, covariance_px2=table.covariance_px2 * factor).subset(kept)
        bundle = adjust(_problem(network.free, scaled, drawn, prior), bundle.state)
    require(bundle, "calibration")
    return _Adjusted(bundle, kept, float(np.sqrt(factor)), prior, drawn_rms, rejected)


def _variance_share(bundle: BundleResult, kept: BoolArray) -> float:
    """Squared residuals of image points over their own redundancy (the drawing's knowledge left aside)."""
    redundancy = np.einsum("mii->m", examine_image_points(bundle).redundancy)[kept].sum()
    return float((bundle.whitened_residuals[kept] ** 2).sum() / max(redundancy, 1.0))


def _kept_apart(network: _Network, adjusted: _Adjusted, photo: int) -> float:
    """RMS of one photo's residuals when the others gave camera and board and only its pose is fitted."""
    table, state = adjusted.bundle.problem.observations, adjusted.bundle.state
    others = table.subset(table.photo_index != photo).compacted()
    place = {name: i for i, name in enumerate(network.names)}
    drawn = network.board.points_m[network.seen][[place[name] for name in others.targets]]
    poses = [state.cam_from_world(i) for i in range(len(network.points)) if i != photo]
    problem = _problem(network.free, others, drawn, adjusted.prior_sigma_m)
    bundle = adjust(problem, bundle_state(state.cameras, poses, drawn))
    at = {name: i for i, name in enumerate(others.targets)}
    whole = network.observations()
    known = np.array([whole.targets[i] in at for i in whole.target_index])
    own = whole.subset((whole.photo_index == photo) & known).compacted()
    points = bundle.state.points_m[[at[name] for name in own.targets]]
    alone = bundle_state(bundle.state.cameras, [state.cam_from_world(photo)], points)
    fitted = adjust(BundleProblem(own, (CameraModel("camera"),), fixed=own.targets), alone)
    return rms_length(fitted.residuals_px)


# --- result ---------------------------------------------------------------------------------------------------------


def _result(model: CameraCalibrationModel, network: _Network, adjusted: _Adjusted, apart: FloatArray) -> Result:
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
        for one in examine_intrinsics(bundle)
    )
    return Result(
        model.name, model.camera.name, camera, tests, photos, {}, shape, quality, sigma_map(camera, distance),
        radial_profile(camera, pixels), coverage(camera, pixels), None, (), {},
    )  # fmt: skip


def write(result: Result, folder: Path) -> None:
    """Write cameras.json, points.csv, summary.json and figures into an existing folder.

    Parameters
    ----------
    result : Result
        What `run` returned.
    folder : Path
        Where to; usually the folder that `heliogauge.store.ResultFolder` gives.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    from calibration.camera.figures import all_figures
    from calibration.camera.report_summary import write_tables
    from heliogauge.figures_canvas import png_of

    write_tables(result, folder)
    for name, figure in all_figures(result).items():
        (folder / f"{name}.png").write_bytes(png_of(figure))
