"""The network is adjusted, and every photo tried against the others; photos that were held out against all."""

from dataclasses import dataclass, replace

import numpy as np

from calibration.camera.adjustment.another_photo import predict_photo
from calibration.camera.adjustment.board_adjustment import Adjusted, adjust_as_drawn, adjust_with_shape, counted_alike
from calibration.camera.adjustment.other_photos import (
    adjust_others,
    fit_any_turn,
    fit_pose,
    known_from_all,
    known_from_others,
    mirrored_rms_px,
)
from calibration.camera.adjustment.true_centers import with_true_centers
from calibration.camera.boards import CircleGrid, TargetField
from calibration.camera.corners.detection import BoardPoints
from calibration.camera.files.findings import HeldOutPhoto
from calibration.camera.start_values.board_network import LEAST_PHOTOS, BoardNetwork
from calibration.camera.start_values.orientation import Orientations
from heliogauge.errors import EstimationError
from heliogauge.running.progress import Progress
from heliogauge.validate import FloatArray

#: A photo that fits this many times better as a mirror image, and was this many times worse than others, is one.
_MIRROR_GAIN = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """An adjusted network, how its photos were counted, and how others predict each photo.

    apart_px, apart_expected_px (p,): RMS of a photo's residuals when the others predict it, and what their covariance
        lets expect; NaN where that was not asked [px].
    """

    network: BoardNetwork
    adjusted: Adjusted
    orientations: Orientations | None
    apart_px: FloatArray
    apart_expected_px: FloatArray


def solve_network(
    network: BoardNetwork, left_out: dict[str, str], progress: Progress, *, refine_board: bool, leave_one_out: bool
) -> Solved:
    """Adjust; a photo that turns out to be mirrored is left out, and all is done again.

    left_out: Takes photos that do not agree with the others, with the reason.
    refine_board: Estimate the board's shape; otherwise it is held as drawn.
    leave_one_out: Calibrate again without each photo.
    """
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
            adjusted = adjust_with_shape(network, drawn_rms, refine_board=refine_board)
            state = adjusted.state
    apart, expected = np.full((2, len(network.points)), np.nan)
    if leave_one_out and len(network.points) > LEAST_PHOTOS:
        mirrored = []
        with progress.stage("keep photos apart", len(network.points)) as stage:
            for photo, points in enumerate(network.points):
                others = adjust_others(network, adjusted, photo)
                known = known_from_others(others)
                fit = fit_pose(known, points, adjusted.state.cam_from_world(photo))
                apart[photo] = fit.rms_px
                expected[photo] = predict_photo(others, points, fit.cam_from_board).expected_rms_px
                if _MIRROR_GAIN * mirrored_rms_px(known, network.board, points) < apart[photo]:
                    mirrored.append(photo)
                stage.advance()
        # One mirrored photo spoils what the others are compared with: the worst first.
        if mirrored and len(network.points) - 1 >= LEAST_PHOTOS:
            worst = max(mirrored, key=lambda photo: float(apart[photo]))
            name = network.points[worst].photo
            left_out[name] = f"{name}: fits the others as a mirror image only; the file is the wrong way round"
            return solve_network(
                network.without(worst), left_out, progress, refine_board=refine_board, leave_one_out=leave_one_out
            )
    return Solved(network, adjusted, orientations, apart, expected)


def check_held_out(solved: Solved, held: tuple[BoardPoints, ...], left_out: dict[str, str]) -> tuple[HeldOutPhoto, ...]:
    """Fit the poses of the photos that were held out."""
    network, checks = solved.network, []
    known = known_from_all(network, solved.adjusted)
    for raw in held:
        try:
            found = fit_any_turn(known, network.board, raw)
            # Circles' centres are corrected as those of the photos used; so near a pose the first one does.
            alone = replace(network, points=(found.points,))
            pose = found.cam_from_board
            state = replace(
                solved.adjusted.state, rotations=pose.rotation[None], translations_m=pose.translation_m[None]
            )
            points = with_true_centers(alone, (found.points,), state).points[0]
            found = fit_pose(known, points, pose)
        except EstimationError as error:
            left_out[raw.photo] = f"{raw.photo}: held out, and {error}"
            continue
        checks.append(HeldOutPhoto(raw.photo, found.cam_from_board, raw.n, found.rms_px))
    return tuple(checks)
