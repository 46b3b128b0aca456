"""Adjustments of a calibration: the board as drawn, how it was counted, its own shape."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calibration.camera.adjustment.mixed_adjustment import MixedAdjustment, adjust_mixed
from calibration.camera.boards import Chessboard, CircleGrid, renumbering
from calibration.camera.corners.detection import BoardPoints
from calibration.camera.files.findings import rms_length
from calibration.camera.start_values.board_network import LEAST_PHOTOS, BoardNetwork
from calibration.camera.start_values.orientation import Orientations, find_orientations
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import BoolArray, FloatArray
from photogrammetry import ImagePoints
from photogrammetry.bundle import BundleProblem, BundleResult, BundleState, CameraModel, adjust, constraints, statistics

#: To see outliers, a board is taken to be as drawn to 2 % of its pitch in its plane and 10 % across it.
_FIRST_PRIOR = np.array([0.02, 0.02, 0.1])
#: Points farther off than this many sigmas of what is usual here are left out; 1 in 10^7 good ones is.
_REJECTED_SIGMAS = 6.0
#: A photo this many times worse than the middle one, and by pixels, shows something else than the board.
_WORSE_PHOTO, _WORSE_PHOTO_PX = 8.0, 2.0
_STEPS = (("focal_px",), ("focal_px", "center_x_px", "center_y_px", "k1", "k2"))


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    """The last adjustment.

    mixed: What was estimated.
    kept (m,): Image points of the network that were used.
    rms_as_drawn_px: Residuals with the board as drawn; NaN where there is no drawing [px].
    refined: Whether the board's shape was estimated.
    rejected: Image points left out.
    """

    mixed: MixedAdjustment
    kept: BoolArray
    rms_as_drawn_px: float
    refined: bool
    rejected: tuple[str, ...] = ()

    @property
    def state(self) -> BundleState:
        """Camera, poses and points."""
        return self.mixed.state

    @property
    def factor(self) -> float:
        """Noise of the image points over what their fits let expect, RMS over the photos."""
        return float(np.sqrt((self.mixed.sizes.components.noise**2).mean()))


class AsDrawn(NamedTuple):
    """Camera and poses with the board held as drawn.

    network: With the camera and the poses found.
    rms_px: Its residuals [px].
    aside: Photos that do not agree with it; the board's own shape is not known yet, so they may be right.
    """

    network: BoardNetwork
    rms_px: float
    aside: tuple[BoardPoints, ...]


def adjust_as_drawn(network: BoardNetwork) -> AsDrawn:
    """Adjust with the board held as drawn, more intrinsics at each step; photos of something else are put aside.

    network: Photos with start values.
    EstimationError: The photos do not agree.
    """
    aside: list[BoardPoints] = []
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
        residuals = result.residuals_px
        rms = np.array([rms_length(residuals[table.photo_index == i]) for i in range(len(table.photos))])
        worst, usual = int(np.argmax(rms)), float(np.median(rms))
        if rms[worst] < max(_WORSE_PHOTO * usual, _WORSE_PHOTO_PX) or len(rms) <= LEAST_PHOTOS:
            poses = tuple(state.cam_from_world(i) for i in range(len(rms)))
            return AsDrawn(replace(network, camera=state.cameras[0], poses=poses), rms_length(residuals), tuple(aside))
        aside.append(network.points[worst])
        network = network.without(worst)
    raise EstimationError("no set of photos agrees on one camera and one board")


def counted_alike(network: BoardNetwork) -> tuple[BoardNetwork, Orientations | None]:
    """Count the board from the same corner in all photos, where its print looks the same turned.

    network: Adjusted with the board as drawn.
    """
    board = network.board
    if not isinstance(board, Chessboard | CircleGrid) or not board.looks_the_same_turned:
        return network, None
    found = find_orientations(board, network.points, network.poses, network.camera)
    points, poses = list(network.points), list(network.poses)
    for photo in found.turned:
        points[photo], poses[photo] = turned(board, points[photo], poses[photo], found.quarter_turns[photo])
    return replace(network, points=tuple(points), poses=tuple(poses)), found


def turned(
    board: Chessboard | CircleGrid, points: BoardPoints, pose: RigidTransform, quarter_turns: int
) -> tuple[BoardPoints, RigidTransform]:
    """Count the board of a photo from another corner: the same image with other numbers and another pose."""
    back = RigidTransform.from_rotation_vector([0.0, 0.0, -0.5 * np.pi * quarter_turns], np.zeros(3))
    return replace(points, index=renumbering(board, quarter_turns)[points.index]), pose @ back


def posed(free: tuple[str, ...], table: ImagePoints, drawn_m: FloatArray, sigma_m: FloatArray) -> BundleProblem:
    """Pose the adjustment: the drawing is knowledge with a sigma, exact where that is 0, nothing where infinite.

    free: Intrinsics that are estimated.
    table: The image points.
    drawn_m (k, 3): Where its targets were drawn [m].
    sigma_m (3,): How far they may be from there [m].
    """
    model = (CameraModel("camera", free),)
    if not sigma_m.any():
        return BundleProblem(table, model, fixed=table.targets)
    if np.isinf(sigma_m).all():
        return BundleProblem(table, model)
    covariance = np.diag(sigma_m**2)
    known = tuple(
        constraints.ControlPoint(name, place, covariance) for name, place in zip(table.targets, drawn_m, strict=True)
    )
    return BundleProblem(table, model, constraints=known)


def within_usual(length_squared: FloatArray) -> BoolArray:
    """Return which image points (n,) are no farther off than good ones can be, by their squared lengths in sigmas.

    A squared length is a chi-square with two degrees of freedom times the square of what is usual: its median is
    2 log 2 of that.
    """
    usual = float(np.median(length_squared)) / (2 * np.log(2.0))
    return np.asarray(length_squared <= _REJECTED_SIGMAS**2 * usual)


def adjust_with_shape(network: BoardNetwork, rms_as_drawn_px: float, *, refine_board: bool) -> Adjusted:
    """See outliers with every point free, then adjust with random effects.

    network: Photos with start values.
    refine_board: Estimate the board's shape; otherwise it is held as drawn.
    EstimationError: The photos do not determine the camera.
    """
    table, drawn = network.observations(), network.board.points_m[network.seen]
    prior = _FIRST_PRIOR * network.board.pitch_m if refine_board else np.zeros(3)
    if not network.places_known:
        prior = np.full(3, np.inf)
    bundle = adjust(posed(network.free, table, drawn, prior), network.start())
    if bundle.defects:
        bundle.require("calibration")
    tests = statistics.examine_image_points(bundle)
    kept = within_usual(tests.length_squared)
    rejected = tuple(
        f"{table.label(int(row))}: {np.hypot(*bundle.residuals_px[row]):.3f} px" for row in np.nonzero(~kept)[0]
    )
    start = bundle.state if bundle.converged else network.start()
    mixed = adjust_mixed(network, table.subset(kept), start, refine_board=refine_board)
    return Adjusted(mixed, kept, rms_as_drawn_px, refine_board, rejected)
