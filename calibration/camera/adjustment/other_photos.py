"""Photos that did not help to calibrate, explained by those that did: only their pose is fitted."""

from dataclasses import dataclass, replace

import numpy as np

from calibration.camera.adjustment.board_adjustment import Adjusted, turned
from calibration.camera.adjustment.mixed_adjustment import MixedAdjustment, Sizes, adjust_mixed
from calibration.camera.boards import Board, Chessboard, CircleGrid
from calibration.camera.corners.detection import BoardPoints
from calibration.camera.files.findings import rms_length
from calibration.camera.start_values.board_network import BoardNetwork
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import FloatArray, IntArray
from photogrammetry import ImagePoints
from photogrammetry.bundle import BundleProblem, BundleState, CameraModel, adjust
from photogrammetry.start_values import resect


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """Camera and board from some photos, to test another one with.

    index (k,): Points of the board that were measured.
    points_m (k, 3): Their places [m].
    """

    camera: Camera
    index: IntArray
    points_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PhotoFit:
    """The pose of a photo alone, and how well it explains the points."""

    rms_px: float
    cam_from_board: RigidTransform
    points: BoardPoints


def known_from_all(network: BoardNetwork, adjusted: Adjusted) -> Known:
    """Return what all photos of the network gave."""
    return _known(network, adjusted.mixed)


def adjust_others(network: BoardNetwork, adjusted: Adjusted, photo: int, *, own_sizes: bool = False) -> MixedAdjustment:
    """Adjust again without one photo, with sizes of random effects as all photos gave them.

    photo: The one to leave out.
    own_sizes: Estimate the sizes from the others alone: a photo that is wrong makes those of all photos so large that
        it seems right.
    EstimationError: The others do not determine the camera.
    """
    mixed = adjusted.mixed
    others = mixed.table.subset(mixed.table.photo_index != photo).compacted()
    rest = network.without(photo)
    kept = [i for i in range(len(network.points)) if i != photo]
    place = {name: i for i, name in enumerate(network.names)}
    rows = np.array([place[name] for name in rest.names], dtype=np.intp)
    state = replace(
        mixed.state,
        rotations=mixed.state.rotations[kept],
        translations_m=mixed.state.translations_m[kept],
        points_m=mixed.state.points_m[rows],
    )
    found = mixed.sizes.components
    sizes = replace(found, noise=found.noise[kept])
    table = _with_targets_of(others, rest)
    if own_sizes:
        return adjust_mixed(rest, table, state, refine_board=adjusted.refined)
    return adjust_mixed(
        rest, table, state, refine_board=adjusted.refined, sizes=Sizes(mixed.sizes.names, sizes), settled=True
    )


def _with_targets_of(table: ImagePoints, network: BoardNetwork) -> ImagePoints:
    """Return a table whose targets are all those of a network, in its order."""
    place = {name: i for i, name in enumerate(network.names)}
    index = np.array([place[name] for name in table.targets], dtype=np.intp)
    return replace(table, targets=network.names, target_index=index[table.target_index])


def known_from_others(others: MixedAdjustment) -> Known:
    """Return what the other photos gave."""
    return _known(others.network, others)


def _known(network: BoardNetwork, mixed: MixedAdjustment) -> Known:
    return Known(mixed.state.cameras[0], network.seen, mixed.state.points_m)


def fit_pose(known: Known, points: BoardPoints, pose: RigidTransform | None = None) -> PhotoFit:
    """Fit the pose of a photo alone, with camera and board as they are.

    pose: Where to start; found without it.
    EstimationError: No pose explains the photo.
    """
    _, own, place = np.intersect1d(points.index, known.index, return_indices=True)
    places, pixels, covariance = known.points_m[place], points.pixels_px[own], points.covariance_px2[own]
    if pose is None:
        # Half a pixel: what camera and board may be off by at the start, far more than a corner's noise.
        pose = resect(known.camera, places, pixels, covariance + 0.25 * np.eye(2)).cam_from_world
    names = tuple(str(i) for i in range(own.size))
    photo = np.zeros(own.size, dtype=np.intp)
    table = ImagePoints((points.photo,), names, photo, np.arange(own.size), pixels, covariance)
    start = BundleState.from_poses([known.camera], [pose], places)
    fitted = adjust(BundleProblem(table, (CameraModel("camera"),), fixed=names), start)
    return PhotoFit(rms_length(fitted.residuals_px), fitted.state.cam_from_world(0), points)


def fit_any_turn(known: Known, board: Board, points: BoardPoints) -> PhotoFit:
    """Fit the pose of a photo counted from whichever corner fits best.

    known: Camera and board.
    EstimationError: No pose explains the photo.
    """
    found = [fit_pose(known, points)]
    if isinstance(board, Chessboard | CircleGrid):
        for turns in board.same_turns[1:]:
            found.append(fit_pose(known, *turned(board, points, found[0].cam_from_board, turns)))
    return min(found, key=lambda one: one.rms_px)


def fit_mirrored(known: Known, board: Board, points: BoardPoints) -> PhotoFit | None:
    """Fit the pose that a photo would have if its file were mirrored: with its columns reversed.

    known: Camera and board.
    board: What the board is; only prints that look alike in a mirror are found in mirrored photos.
    Returns: None where that cannot be asked, or no pose explains it.
    """
    if not isinstance(board, Chessboard | CircleGrid):
        return None
    pixels = points.pixels_px.copy()
    pixels[:, 0] = known.camera.width_px - 1 - pixels[:, 0]
    numbers = np.arange(board.columns * board.rows).reshape(board.rows, board.columns)
    found = []
    for flipped in (numbers[::-1], numbers[:, ::-1]):
        other = replace(points, pixels_px=pixels, index=flipped.ravel()[points.index])
        try:
            found.append(fit_any_turn(known, board, other))
        except EstimationError:
            continue
    return min(found, key=lambda one: one.rms_px, default=None)
