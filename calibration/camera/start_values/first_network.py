"""Camera and poses to start from: from views of a plane, or from targets in space."""

from calibration.camera.boards import Board, TargetField, UnknownField
from calibration.camera.corners.detection import FoundBoards
from calibration.camera.start_values.board_network import LEAST_PHOTOS, BoardNetwork
from calibration.camera.start_values.intrinsics import homography, start_camera, start_pose
from calibration.camera.start_values.target_field import network_from_targets
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError


def first_network(
    found: FoundBoards, board: Board | UnknownField, free: tuple[str, ...], left_out: dict[str, str]
) -> tuple[BoardNetwork, Doubt | None]:
    """Find camera and poses to start from.

    free: Intrinsics that are estimated.
    left_out: Takes photos without start values, with the reason.
    Returns: The network, and a doubt where the photos hardly determine the focal length.
    EstimationError: Too few photos show the board, or they do not hang together.
    """
    if isinstance(board, UnknownField | TargetField):
        _require_photos(len(found.points), left_out)
        return network_from_targets(found, board, free, left_out), None
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
