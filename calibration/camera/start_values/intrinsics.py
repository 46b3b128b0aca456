"""Start values of a calibration: homographies, focal length in closed form, pose of every photo."""

from collections.abc import Sequence

import cv2
import numpy as np

from calibration.camera.boards import LEAST_POINTS
from calibration.camera.corners.detection import BoardPoints
from heliogauge.camera.model import Camera
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform, nearest_rotation
from heliogauge.validate import FloatArray

#: Focal lengths of real lenses over the image's longer side: fisheye to long telephoto.
_SHORTEST, _LONGEST = 0.3, 20.0
#: A homography cannot follow distortion; points this share of the board's image away from it are misread.
_MISREAD_SHARE = 0.05


def homography(points: BoardPoints, board_m: FloatArray) -> FloatArray:
    """Find the homography from the board's plane to a photo.

    board_m (n, 3): The board's nominal points, near the plane z = 0 [m].
    Returns (3, 3): ``pixel ~ H (x, y, 1)``, with the board in front of the camera: H (x, y, 1) has a positive last
        element.
    EstimationError: Too few points, points on a line, or many that no homography explains.
    """
    if points.n < LEAST_POINTS:
        raise EstimationError(f"{points.photo}: {points.n} points of the board, {LEAST_POINTS} are needed")
    plane = board_m[points.index, :2]
    # Numbers near 1 on both sides: otherwise the normal equations lose half of their digits.
    to_unit = [_to_unit(plane), _to_unit(points.pixels_px)]
    unit = [
        np.column_stack([p, np.ones(len(p))]) @ m.T for p, m in zip((plane, points.pixels_px), to_unit, strict=True)
    ]
    spread = np.linalg.svd(unit[0][:, :2], compute_uv=False)
    if spread[1] < 1e-3 * spread[0]:
        raise EstimationError(f"{points.photo}: the points found lie on one line of the board")
    found, _ = cv2.findHomography(unit[0][:, :2], unit[1][:, :2], cv2.LMEDS)
    if found is None:
        raise EstimationError(f"{points.photo}: no view of a plane explains the points found")
    matrix = np.linalg.inv(to_unit[1]) @ np.asarray(found, dtype=np.float64) @ to_unit[0]
    image = np.column_stack([plane, np.ones(len(plane))]) @ matrix.T
    if np.median(image[:, 2]) < 0:
        matrix, image = -matrix, -image
    misses = np.linalg.norm(image[:, :2] / image[:, 2:] - points.pixels_px, axis=1)
    size = float(np.linalg.norm(np.ptp(points.pixels_px, axis=0)))
    wrong = int(np.count_nonzero((misses > _MISREAD_SHARE * size) | (image[:, 2] <= 0)))
    if wrong > 0.2 * points.n:
        raise EstimationError(
            f"{points.photo}: {wrong} of {points.n} points are far from where a view of the board would have them"
        )
    return np.asarray(matrix / np.linalg.norm(matrix))


def _to_unit(points: FloatArray) -> FloatArray:
    middle, size = points.mean(axis=0), max(float(points.std()), 1e-12)
    return np.array([[1 / size, 0, -middle[0] / size], [0, 1 / size, -middle[1] / size], [0, 0, 1]])


def start_focal_px(homographies: Sequence[FloatArray], width_px: int, height_px: int) -> float:
    """Find the focal length of square pixels with the principal point in the middle of the image.

    Shapes: homographies (3, 3).
    Returns: Focal length; NaN where the photos do not show it (none is tilted) [px].

    Zhang (2000), eqs 3 and 4: with ``a, b`` the first two columns of H, moved to the principal point,
    ``a^T W b = 0`` and ``a^T W a = b^T W b`` with ``W = diag(1/f^2, 1/f^2, 1)``: two linear equations in 1/f^2.
    The median over the photos survives a few misread ones.
    """
    shift = np.array([[1, 0, -0.5 * (width_px - 1)], [0, 1, -0.5 * (height_px - 1)], [0, 0, 1]])
    longer = max(width_px, height_px)
    found, weights = [], []
    for matrix in homographies:
        h = shift @ matrix
        a, b = h[:, 0].copy(), h[:, 1].copy()
        for column in (a, b):
            column[:2] /= longer
        factor = 1 / max(float(np.linalg.norm(a)) * float(np.linalg.norm(b)), 1e-300)
        left = np.array([a[0] * b[0] + a[1] * b[1], 0.5 * (a[0] ** 2 + a[1] ** 2 - b[0] ** 2 - b[1] ** 2)]) * factor
        right = -np.array([a[2] * b[2], 0.5 * (a[2] ** 2 - b[2] ** 2)]) * factor
        squared = float(left @ left)
        inverse = float(left @ right) / squared if squared > 0 else -1.0
        if _LONGEST**-2 < inverse < _SHORTEST**-2:
            found.append(inverse**-0.5)
            # Tilted photos determine the focal length, fronto-parallel ones do not.
            weights.append(float(np.linalg.norm(right)))
    if not found:
        return float("nan")
    order = np.argsort(found)
    share = np.cumsum(np.array(weights)[order])
    return longer * float(np.array(found)[order][np.searchsorted(share, 0.5 * share[-1])])


def start_camera(homographies: Sequence[FloatArray], width_px: int, height_px: int) -> tuple[Camera, Doubt | None]:
    """Build a camera to start from.

    Shapes: homographies (3, 3).
    width_px, height_px: Size of the image [px].
    camera: Square pixels, principal point in the middle, no distortion.
    doubt: Why the focal length is a guess; None where it is not.
    """
    focal, doubt = start_focal_px(homographies, width_px, height_px), None
    if not np.isfinite(focal):
        focal = 1.2 * max(width_px, height_px)
        doubt = Doubt(
            "board_never_tilted",
            "no photo shows the board tilted: focal length and distance cannot be separated",
            severity=Severity.SERIOUS,
        )
    center = (0.5 * (width_px - 1), 0.5 * (height_px - 1))
    return Camera(width_px, height_px, focal, focal, *center), doubt


def start_pose(matrix: FloatArray, camera: Camera) -> RigidTransform:
    """Find the pose of the board from its homography.

    Shapes: matrix (3, 3).
    camera: Without distortion.
    """
    columns = np.linalg.solve(camera.matrix, matrix)
    columns /= np.sqrt(np.linalg.norm(columns[:, 0]) * np.linalg.norm(columns[:, 1]))
    raw = np.column_stack([columns[:, 0], columns[:, 1], np.cross(columns[:, 0], columns[:, 1])])
    return RigidTransform(nearest_rotation(raw), np.asarray(columns[:, 2]))


def tilt_and_roll(pose: RigidTransform) -> tuple[float, float]:
    """Return how far a photo is from fronto-parallel, and its roll about the optical axis [rad].

    pose: ``cam_from_board``.
    Returns: Angle between the board's normal and the optical axis, 0 to pi/2, and direction of the board's x axis
        in the image, -pi to pi [rad].
    """
    normal = pose.rotation[:, 2]
    return float(np.arccos(np.clip(abs(normal[2]), 0, 1))), float(np.arctan2(pose.rotation[1, 0], pose.rotation[0, 0]))
