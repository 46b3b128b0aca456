"""How two photos stand to each other, from targets that both show; safe for targets in one plane."""

from dataclasses import dataclass

import cv2
import numpy as np

from heliogauge.adjust.gauss_newton import Options
from heliogauge.adjust.robust_loss import Cauchy
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform, nearest_rotation
from heliogauge.validate import BoolArray, FloatArray, IntArray
from photogrammetry.bundle.adjustment import BundleOptions, descend
from photogrammetry.bundle.problem import BundleProblem, CameraModel
from photogrammetry.bundle.state import BundleState
from photogrammetry.image_points import ImagePoints
from photogrammetry.start_values.triangulation import Triangulation, intersect_lines, ray_sigma_rad

LEAST_COMMON = 6

#: A true solution settles in some steps; a false one may crawl for ever.
_OPTIONS = BundleOptions(loss=Cauchy(), descent=Options(tolerance=1e-2, max_iterations=25))


@dataclass(frozen=True, slots=True, eq=False)
class SharedTargets:
    """Image points of the same targets in two photos.

    cameras: Cameras of the first and the second photo.
    pixels_px (2, n, 2): Image points [px].
    covariance_px2 (2, n, 2, 2): Their covariances [px^2].
    """

    cameras: tuple[Camera, Camera]
    pixels_px: FloatArray
    covariance_px2: FloatArray

    @property
    def rays(self) -> FloatArray:
        """Unit lines of sight in each camera's frame, shape (2, n, 3)."""
        return np.stack([camera.cast_rays(own) for camera, own in zip(self.cameras, self.pixels_px, strict=True)])

    @property
    def sigma_rad(self) -> FloatArray:
        """Angular uncertainty of the lines of sight, shape (2, n) [rad]."""
        pairs = zip(self.cameras, self.covariance_px2, strict=True)
        return np.stack([ray_sigma_rad(camera, own) for camera, own in pairs])


@dataclass(frozen=True, slots=True, eq=False)
class RelativePose:
    """One way in which two photos may stand to each other; the distance between them is 1.

    second_from_first: First camera's frame to the second's.
    points_m (n, 3): Targets in the first camera's frame, in units of the distance; NaN where not found.
    inliers (n,): Targets whose four image coordinates agree with it.
    misfit: Sum of squared residuals, each cut off at the tolerance, over what is expected of good image points.
    angle_rad: Median angle between the two lines of sight [rad].
    """

    second_from_first: RigidTransform
    points_m: FloatArray
    inliers: BoolArray
    misfit: float
    angle_rad: float


def parallax_rad(rays: FloatArray) -> float:
    """Return what is left of the angle between lines of sight after the best rotation, shape (2, n, 3) [rad].

    rays (2, n, 3): Unit lines of sight of the same targets in two camera frames.
    Returns: Median angle [rad]; near the noise for two photos from one place.
    """
    rotation = nearest_rotation(rays[1].T @ rays[0])
    return float(np.median(np.linalg.norm(rays[0] @ rotation.T - rays[1], axis=1)))


def relate(shared: SharedTargets, *, tolerance: float = 5.0) -> tuple[RelativePose, ...]:
    """Find how two photos stand to each other.

    shared: What both photos show.
    tolerance: Residuals up to so many sigma are good.
    Returns: Different solutions, the best first, without such as cannot be rivals of it. Targets in one plane have two
        that fit equally well; a third photo decides.
    EstimationError: Fewer than six common targets, or no solution with the targets in front of both cameras.

    Candidates come from the essential matrix (five points, RANSAC) and from the decomposition of a homography; each
    is refined by an adjustment of both photos with Cauchy's loss and judged by its residuals.
    """
    count = shared.pixels_px.shape[1]
    if count < LEAST_COMMON:
        raise EstimationError(f"relative orientation: {count} common targets, {LEAST_COMMON} are needed")
    found: list[RelativePose] = []
    intersected = [(one, _intersected(shared, one)) for one in _candidates(shared, tolerance)]
    # Those with most targets in front of both cameras first: they tell which others can be rivals at all.
    for candidate, first in sorted(intersected, key=lambda pair: -int(pair[1].found.sum())):
        least = tolerance**2 * int((~first.found).sum()) / max(count - 5, 1)
        if found and least >= rival_misfit(min(one.misfit for one in found)):
            continue
        refined = _refined(shared, candidate, first, tolerance)
        if refined is not None and all(_differ(refined, other) for other in found):
            found.append(refined)
    if not found:
        raise EstimationError(
            f"relative orientation: no solution has {LEAST_COMMON} of the {count} common targets in front of both "
            "cameras with an angle between the lines of sight"
        )
    return tuple(sorted(found, key=lambda one: one.misfit))


def rival_misfit(misfit: float) -> float:
    """Return up to which misfit another solution is a rival of one."""
    return 2 * misfit + 1


def _candidates(shared: SharedTargets, tolerance: float) -> list[RigidTransform]:
    rays = shared.rays
    usable = np.isfinite(rays).all(axis=(0, 2))
    first, second = (np.ascontiguousarray(own[usable, :2] / own[usable, 2:]) for own in rays)
    # In a network far from calibrated a sigma of 1/1000 of the focal length still finds the right one.
    limit = float(np.clip(tolerance * np.median(shared.sigma_rad), 1e-6, 5e-3))
    candidates = []
    essential, _ = cv2.findEssentialMat(first, second, np.eye(3), cv2.RANSAC, 0.9999, limit)
    if essential is not None:
        for matrix in essential.reshape(-1, 3, 3)[:10]:
            turn_a, turn_b, shift = cv2.decomposeEssentialMat(matrix)
            candidates += [(turn, sign * shift) for turn in (turn_a, turn_b) for sign in (1.0, -1.0)]
    homography, _ = cv2.findHomography(first, second, cv2.RANSAC, 3 * limit)
    if homography is not None:
        _, turns, shifts, _ = cv2.decomposeHomographyMat(homography, np.eye(3))
        candidates += list(zip(turns, shifts, strict=True))
    poses = []
    for turn, shift in candidates:
        length = float(np.linalg.norm(shift))
        if length > 1e-9 and np.isfinite(turn).all() and np.linalg.det(turn) > 0:
            poses.append(RigidTransform(nearest_rotation(turn), shift.ravel() / length))
    return poses


def _intersected(shared: SharedTargets, pose: RigidTransform) -> Triangulation:
    rays, count = shared.rays, shared.pixels_px.shape[1]
    back = pose.inverse()
    directions = np.concatenate([rays[0], back.rotate(rays[1])])
    origins = np.concatenate([np.zeros((count, 3)), np.broadcast_to(back.translation_m, (count, 3))])
    usable = np.isfinite(directions).all(axis=1)
    places = np.tile(np.arange(count), 2)
    return intersect_lines(origins[usable], directions[usable], shared.sigma_rad.ravel()[usable], places[usable], count)


def _refined(
    shared: SharedTargets, pose: RigidTransform, first: Triangulation, tolerance: float
) -> RelativePose | None:
    which = np.nonzero(first.found)[0]
    if which.size < LEAST_COMMON or which.size < 0.4 * len(first.points_m):
        return None
    table = _table(shared, which)
    problem = BundleProblem(table, (CameraModel("first"), CameraModel("second")), np.array([0, 1]))
    start = BundleState.from_poses(shared.cameras, [RigidTransform.identity(), pose], first.points_m[which])
    try:
        result = descend(problem, start, _OPTIONS)
    except (EstimationError, np.linalg.LinAlgError):
        return None
    moved = result.state.cam_from_world(1) @ result.state.cam_from_world(0).inverse()
    length = float(np.linalg.norm(moved.translation_m))
    if not result.converged or length < 1e-9:
        return None
    unit = RigidTransform(moved.rotation, moved.translation_m / length)
    points = np.full((shared.pixels_px.shape[1], 3), np.nan)
    points[which] = result.state.cam_from_world(0).apply(result.state.points_m) / length
    misses = np.linalg.norm(result.evaluation.whitened_residuals, axis=1).reshape(2, -1).max(axis=0)
    misses_all = np.full(len(points), np.inf)
    misses_all[which] = misses
    inliers = misses_all <= tolerance
    if inliers.sum() < LEAST_COMMON:
        return None
    angle = _intersected(shared, unit).angle_rad[which]
    # One of the four coordinates of a target is redundant.
    misfit = float((np.minimum(misses_all, tolerance) ** 2).sum()) / max(len(points) - 5, 1)
    return RelativePose(unit, points, inliers, misfit, float(np.median(angle)))


def _table(shared: SharedTargets, which: IntArray) -> ImagePoints:
    count = which.size
    return ImagePoints(
        ("first", "second"),
        tuple(str(i) for i in range(count)),
        np.repeat([0, 1], count),
        np.tile(np.arange(count), 2),
        shared.pixels_px[:, which].reshape(-1, 2),
        shared.covariance_px2[:, which].reshape(-1, 2, 2),
    )


def _differ(one: RelativePose, other: RelativePose) -> bool:
    turn = (one.second_from_first @ other.second_from_first.inverse()).rotation_vector_rad
    shift = one.second_from_first.translation_m - other.second_from_first.translation_m
    return bool(np.linalg.norm(turn) > 0.01 or np.linalg.norm(shift) > 0.05)
