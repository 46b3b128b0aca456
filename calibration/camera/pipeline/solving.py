"""The network is adjusted, and every photo tried against the others; photos that were held out against all."""

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calibration.camera.adjustment.another_photo import predict_photo
from calibration.camera.adjustment.board_adjustment import Adjusted, adjust_as_drawn, adjust_with_shape, counted_alike
from calibration.camera.adjustment.mixed_adjustment import MixedAdjustment
from calibration.camera.adjustment.other_photos import (
    PhotoFit,
    adjust_others,
    fit_any_turn,
    fit_mirrored,
    fit_pose,
    known_from_all,
    known_from_others,
)
from calibration.camera.adjustment.true_centers import with_true_centers
from calibration.camera.boards import Board, CircleGrid, TargetField
from calibration.camera.corners.detection import BoardPoints
from calibration.camera.files.findings import HeldOutPhoto
from calibration.camera.judgement.network import CONTRADICTS, alike_text
from calibration.camera.start_values.board_network import LEAST_PHOTOS, BoardNetwork
from calibration.camera.start_values.orientation import Orientations
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.running.progress import Progress, Stage
from heliogauge.validate import FloatArray

#: A photo that fits this many times better as a mirror image may be one: worth another adjustment of the others.
_MIRROR_GAIN = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """An adjusted network, how its photos were counted, and how others predict each photo.

    measured: The network with image points as they were measured; circles' centres are corrected in ``network``.
    apart_px, apart_expected_px (p,): RMS of a photo's residuals when the others predict it, and what their covariance
        lets expect. The second is infinite where the others alone determine no camera, the first where no pose explains
        the photo by what they gave. NaN where that was not asked [px].
    """

    measured: BoardNetwork
    network: BoardNetwork
    adjusted: Adjusted
    orientations: Orientations | None
    apart_px: FloatArray
    apart_expected_px: FloatArray


def solve_network(
    network: BoardNetwork, contradicting: dict[str, str], progress: Progress, *, refine_board: bool, leave_one_out: bool
) -> Solved:
    """Adjust; photos that the others predict otherwise, or as mirror images, are left out.

    contradicting: Takes these photos, with the reason.
    refine_board: Estimate the board's shape; otherwise it is held as drawn.
    leave_one_out: Calibrate again without each photo.
    EstimationError: The photos do not determine the camera.
    """
    with progress.stage("adjust"):
        try:
            solved = _adjusted(network, contradicting, refine_board=refine_board)
        except EstimationError as error:
            raise type(error)(f"{error}{alike_text(network.points)}") from error
    if not leave_one_out or len(solved.network.points) <= LEAST_PHOTOS:
        return solved
    with progress.stage("keep photos apart", len(solved.network.points)) as stage:
        solved, mirrored = _kept_apart(solved, stage)
    # One mirrored photo spoils what the others are compared with: the worst first. That they are right themselves is
    # checked where they still determine each other; with fewer photos it is left to the user.
    if not mirrored or len(solved.network.points) - 2 < LEAST_PHOTOS:
        return solved
    worst = max(mirrored, key=lambda photo: float(solved.apart_px[photo]))
    name = solved.network.points[worst].photo
    contradicting[name] = (
        f"{name}: fits the others as a mirror image only ({mirrored[worst]:.2f} px; as it is "
        f"{solved.apart_px[worst]:.2f} px, where {solved.apart_expected_px[worst]:.2f} are expected): the file is the "
        "wrong way round"
    )
    return solve_network(
        solved.measured.without(worst), contradicting, progress, refine_board=refine_board, leave_one_out=leave_one_out
    )


def _adjusted(network: BoardNetwork, contradicting: dict[str, str], *, refine_board: bool) -> Solved:
    """Adjust; photos that were put aside when the board's shape was not known come back if they fit as predicted."""
    aside: tuple[BoardPoints, ...] = ()
    drawn_rms, orientations = float("nan"), None
    measured = network
    if network.places_known:
        order = [one.photo for one in network.points]
        measured, drawn_rms, aside = adjust_as_drawn(network)
        measured, orientations = counted_alike(measured)
    network, adjusted = _with_shape(measured, drawn_rms, refine_board=refine_board)
    back = []
    for raw in aside:
        try:
            outside = _fit_outside(network, adjusted, raw)
        except EstimationError as error:
            contradicting[raw.photo] = str(error)
            continue
        fit = outside.fit
        expected_px = predict_photo(adjusted.mixed, fit.points, fit.cam_from_board).expected_rms_px
        if fit.rms_px <= CONTRADICTS * expected_px:
            back.append((outside.measured, fit.cam_from_board))
        else:
            contradicting[raw.photo] = (
                f"{raw.photo}: its points miss the board by {fit.rms_px:.1f} px, where {expected_px:.2g} px are "
                "expected from the other photos: it shows another board, or its points are mixed up"
            )
    if back:
        photos = [*zip(measured.points, measured.poses, strict=True), *back]
        photos.sort(key=lambda one: order.index(one[0].photo))
        points, poses = zip(*photos, strict=True)
        measured = replace(measured, points=points, poses=poses)
        network, adjusted = _with_shape(measured, drawn_rms, refine_board=refine_board)
    unknown = np.full((2, len(network.points)), np.nan)
    return Solved(measured, network, adjusted, orientations, *unknown)


def _with_shape(measured: BoardNetwork, drawn_rms: float, *, refine_board: bool) -> tuple[BoardNetwork, Adjusted]:
    """Adjust with the board's shape; return the network with the corrected centres of circles, too."""
    network, state = measured, measured.start()
    # The first correction of centres takes the poses on a board as drawn, the second those on the board as it is.
    for _ in range(2 if isinstance(network.board, CircleGrid | TargetField) else 1):
        network = with_true_centers(network, measured.points, state)
        adjusted = adjust_with_shape(network, drawn_rms, refine_board=refine_board)
        state = adjusted.state
    return network, adjusted


class _Apart(NamedTuple):
    """A photo as the others predict it: what they gave, its fit, and that of its mirror image."""

    others: MixedAdjustment
    fit: PhotoFit
    mirrored: PhotoFit | None


def _fit_apart(board: Board, others: MixedAdjustment, points: BoardPoints, pose: RigidTransform) -> _Apart:
    known = known_from_others(others)
    return _Apart(others, fit_pose(known, points, pose), fit_mirrored(known, board, points))


def _kept_apart(solved: Solved, stage: Stage) -> tuple[Solved, dict[int, float]]:
    """Predict each photo from the others; return also those that fit as mirror images, with their residuals [px]."""
    network, adjusted = solved.network, solved.adjusted
    apart, expected = np.full((2, len(network.points)), np.nan)
    mirrored: dict[int, float] = {}
    for photo, points in enumerate(network.points):
        stage.advance()
        try:
            others = adjust_others(network, adjusted, photo)
        except EstimationError:
            expected[photo] = np.inf
            continue
        try:
            found = _fit_apart(network.board, others, points, adjusted.state.cam_from_world(photo))
        except EstimationError:
            apart[photo] = np.inf
            continue
        if found.mirrored is not None and _MIRROR_GAIN * found.mirrored.rms_px < found.fit.rms_px:
            # Where the others do not give the sizes of the effects, those of all photos stay.
            with suppress(EstimationError):
                others = adjust_others(network, adjusted, photo, own_sizes=True)
                found = _fit_apart(network.board, others, points, found.fit.cam_from_board)
        apart[photo] = found.fit.rms_px
        expected[photo] = predict_photo(found.others, points, found.fit.cam_from_board).expected_rms_px
        if found.mirrored is not None and found.fit.rms_px > CONTRADICTS * expected[photo]:
            as_mirrored = predict_photo(found.others, found.mirrored.points, found.mirrored.cam_from_board)
            if found.mirrored.rms_px <= CONTRADICTS * as_mirrored.expected_rms_px:
                mirrored[photo] = found.mirrored.rms_px
    return replace(solved, apart_px=apart, apart_expected_px=expected), mirrored


class _Outside(NamedTuple):
    """A photo outside the network: its points as they were measured, counted as the network's, and the fit."""

    measured: BoardPoints
    fit: PhotoFit


def _fit_outside(network: BoardNetwork, adjusted: Adjusted, raw: BoardPoints) -> _Outside:
    """Fit the pose of a photo outside the network, counted from whichever corner fits best.

    EstimationError: No pose explains the photo.
    """
    known = known_from_all(network, adjusted)
    found = fit_any_turn(known, network.board, raw)
    # Circles' centres are corrected as those of the photos used; so near a pose the first one does.
    alone = replace(network, points=(found.points,))
    pose = found.cam_from_board
    state = replace(adjusted.state, rotations=pose.rotation[None], translations_m=pose.translation_m[None])
    points = with_true_centers(alone, (found.points,), state).points[0]
    return _Outside(found.points, fit_pose(known, points, pose))


def check_held_out(solved: Solved, held: tuple[BoardPoints, ...], left_out: dict[str, str]) -> tuple[HeldOutPhoto, ...]:
    """Fit the poses of the photos that were held out."""
    checks = []
    for raw in held:
        try:
            found = _fit_outside(solved.network, solved.adjusted, raw).fit
        except EstimationError as error:
            left_out[raw.photo] = f"{raw.photo}: held out, and {error}"
            continue
        checks.append(HeldOutPhoto(raw.photo, found.cam_from_board, raw.n, found.rms_px))
    return tuple(checks)
