"""Pose of one photo from targets with known coordinates: three-point solutions, robust choice, refinement."""

from dataclasses import dataclass

import cv2
import numpy as np

from heliogauge.adjust.least_squares import POSE, POSE_NAMES, Options, Problem, Tukey, solve, whitened
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import BoolArray, FloatArray, IntArray, float_array
from photogrammetry.bundle.state import rotations_from_vectors

LEAST_TARGETS = 4
_TRIALS = 60
# A start value: a hundredth of its own sigma is enough.
_QUICK = Options(tolerance=1e-2)


@dataclass(frozen=True, slots=True, eq=False)
class Resection:
    """Pose of a photo.

    covariance (6, 6): Covariance of the steps of `RigidTransform.moved` for exact targets [rad, m].
    inliers (n,): Image points that agree with the pose.
    misses (n,): Length of each residual in sigma; infinite behind the camera.
    rival: Misfit of the next best different pose over that of this one; near 1 the pose is ambiguous (a small or
        distant plane can be turned either way).
    """

    cam_from_world: RigidTransform
    covariance: FloatArray
    inliers: BoolArray
    misses: FloatArray
    rival: float


def resect(
    camera: Camera,
    points_m: FloatArray,
    pixels_px: FloatArray,
    covariance_px2: FloatArray,
    *,
    tolerance: float = 5.0,
) -> Resection:
    """Find the pose of a photo.

    points_m (n, 3): Targets in the world frame [m].
    pixels_px (n, 2): Their image points [px].
    covariance_px2 (n, 2, 2): Covariance of each residual; add that of the target's coordinates where it matters
        [px^2].
    tolerance: Residuals up to so many sigma agree with a pose.
    Returns: The pose that most image points agree with, refined.
    InputError: Lengths differ.
    EstimationError: Fewer than four targets, or no pose that four of them agree with.

    Up to 60 triples of targets, spread first, by the three-point solution of OpenCV; every pose is judged by the sum
    of squared residuals cut off at the tolerance; the best different ones are refined with Tukey's loss.
    """
    points, pixels = float_array("points_m", points_m, (None, 3)), float_array("pixels_px", pixels_px, (None, 2))
    covariance = float_array("covariance_px2", covariance_px2, (len(points), 2, 2))
    if len(points) != len(pixels):
        raise InputError(f"resection: {len(points)} targets and {len(pixels)} image points")
    if len(points) < LEAST_TARGETS:
        raise EstimationError(f"resection: {len(points)} targets with known coordinates, {LEAST_TARGETS} are needed")
    roots = np.linalg.inv(np.linalg.cholesky(covariance))
    turns, shifts = _three_point_poses(camera, points, pixels)
    costs = (np.minimum(_misses(camera, turns, shifts, points, pixels, roots), tolerance) ** 2).sum(axis=1)
    refined = [
        _refine(camera, RigidTransform(turns[i], shifts[i]), points, pixels, covariance, tolerance)
        for i in _promising(turns, costs, 2 * len(points))
    ]
    found = [one for one in refined if one is not None]
    if not found:
        raise EstimationError(f"resection: no pose explains {LEAST_TARGETS} of the {len(points)} image points")
    judged = []
    for pose, matrix in found:
        miss = _misses(camera, pose.rotation[None], pose.translation_m[None], points, pixels, roots)[0]
        judged.append((float((np.minimum(miss, tolerance) ** 2).sum()), pose, matrix, miss))
    judged.sort(key=lambda one: one[0])
    cost, pose, matrix, miss = judged[0]
    inliers = miss <= tolerance
    if inliers.sum() < LEAST_TARGETS:
        raise EstimationError(
            f"resection: only {int(inliers.sum())} of {len(points)} image points agree with the best pose, "
            f"{LEAST_TARGETS} are needed"
        )
    others = [one[0] for one in judged[1:] if _turn(one[1], pose) > 0.02]
    freedom = max(2 * len(points) - 6, 1)
    rival = (min(others) + freedom) / (cost + freedom) if others else float("inf")
    return Resection(pose, matrix, inliers, miss, rival)


def _three_point_poses(camera: Camera, points: FloatArray, pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the solutions of all chosen triples, rotations (k, 3, 3) and translations (k, 3)."""
    rays = camera.cast_rays(pixels)
    ideal = rays[:, :2] / rays[:, 2:]
    usable = np.nonzero(np.isfinite(ideal).all(axis=1))[0]
    vectors: list[FloatArray] = []
    if usable.size >= 3:
        for triple in _triples(points, usable):
            three = np.ascontiguousarray(points[triple])
            area = np.linalg.norm(np.cross(three[1] - three[0], three[2] - three[0]))
            if area < 1e-6 * float(((three - three.mean(axis=0)) ** 2).sum()):
                continue
            image = np.ascontiguousarray(ideal[triple])
            _, turns, shifts = cv2.solveP3P(three, image, np.eye(3), np.zeros(4), flags=cv2.SOLVEPNP_AP3P)
            pairs = zip(turns, shifts, strict=True)
            vectors += [np.concatenate([turn, shift]).ravel() for turn, shift in pairs]
    poses = np.array(vectors).reshape(-1, 6)
    poses = poses[np.isfinite(poses).all(axis=1)]
    return rotations_from_vectors(poses[:, :3]), poses[:, 3:]


def _triples(points: FloatArray, usable: IntArray) -> list[FloatArray]:
    """Choose triples of targets, all of few or a fixed random choice of many, the widest first."""
    rng = np.random.default_rng(0)
    chosen = {tuple(sorted(rng.choice(usable, 3, replace=False).tolist())) for _ in range(4 * _TRIALS)}
    triples = np.array(sorted(chosen))
    sides = points[triples]
    area = np.linalg.norm(np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]), axis=1)
    # Half the widest (precise), half at random (so that a few false wide ones do not take all places).
    widest = np.argsort(-area, kind="stable")[: _TRIALS // 2]
    others = rng.permutation(len(triples))[: _TRIALS // 2]
    return list(triples[np.unique(np.concatenate([widest, others]))])


def _misses(
    camera: Camera, turns: FloatArray, shifts: FloatArray, points: FloatArray, pixels: FloatArray, roots: FloatArray
) -> FloatArray:
    """Length of each residual for each pose, shape (k, n), in sigma; infinite where the target cannot be seen."""
    seen = np.einsum("kij,nj->kni", turns, points) + shifts[:, None]
    difference = camera.project(seen) - pixels
    misses = np.linalg.norm(np.einsum("nij,knj->kni", roots, difference), axis=2)
    return np.where(np.isfinite(misses), misses, np.inf)


def _turn(first: RigidTransform, second: RigidTransform) -> float:
    """Angle between two poses [rad]."""
    return float(np.linalg.norm((first @ second.inverse()).rotation_vector_rad))


def _promising(turns: FloatArray, costs: FloatArray, freedom: int) -> list[int]:
    """Choose the best poses that differ by more than 3 degrees from better ones, at most four."""
    kept: list[int] = []
    order = np.argsort(costs, kind="stable")[:40]
    for index in order.tolist():
        # cos of the angle between rotations from the trace of R_a R_b^T; 3 degrees are 0.0014 below 1.
        cosines = 0.5 * (np.einsum("ij,kij->k", turns[index], turns[kept]) - 1) if kept else np.zeros(0)
        if (cosines < 0.9986).all() and costs[index] <= 4 * costs[order[0]] + freedom:
            kept.append(index)
        if len(kept) == 4:
            break
    return kept


def _refine(
    camera: Camera,
    start: RigidTransform,
    points: FloatArray,
    pixels: FloatArray,
    covariance: FloatArray,
    tolerance: float,
) -> tuple[RigidTransform, FloatArray] | None:
    """Refine with the image points that the pose can see; None if that fails."""
    seen = np.isfinite(camera.project(start.apply(points))).all(axis=1)
    if seen.sum() < 3:
        return None

    def residuals(pose: RigidTransform) -> tuple[FloatArray, FloatArray]:
        projection = camera.project_posed(points[seen], pose)
        difference = (projection.pixels_px - pixels[seen]).ravel()
        return whitened(difference, projection.d_pixel_d_pose.reshape(-1, 6), covariance[seen])

    problem = Problem(POSE_NAMES, residuals, POSE)
    try:
        # Wide at first: a start from three noisy points may be tens of sigma off.
        start_cost = residuals(start)[0].reshape(-1, 2)
        typical = float(np.median(np.linalg.norm(start_cost, axis=1)))
        rough = solve(problem, start, loss=Tukey(max(2 * tolerance, 4 * typical)), block_size=2, options=_QUICK)
        fine = solve(problem, rough.state, loss=Tukey(tolerance), block_size=2, options=_QUICK)
    except EstimationError:
        return None
    return fine.state, fine.covariance
