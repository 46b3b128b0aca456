"""Pose of one photo from targets with known coordinates: three-point solutions, robust choice, refinement."""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from heliogauge.adjust.least_squares import POSE, POSE_NAMES, Options, Problem, Tukey, solve
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform, skew
from heliogauge.validate import BoolArray, FloatArray, IntArray, float_array
from photogrammetry.bundle.state import rotations_from_vectors

LEAST_TARGETS = 4
_TRIALS = 60
#: Targets of one rim lie within a thousandth of their distance on a line; square markers there within a twentieth.
_LEAST_SPREAD = 0.02
# A start value: a hundredth of its own sigma is enough.
_QUICK = Options(tolerance=1e-2)


def spans_an_area(places_m: FloatArray) -> bool:
    """Return whether targets determine the pose of a photo that shows them.

    Shapes: places_m (n, 3).
    Returns: Whether they spread across the line that they lie along: those of one rim leave the camera's turn about
        that rim open.
    """
    if len(places_m) < 3:
        return False
    spread = np.linalg.svd(places_m - places_m.mean(axis=0), compute_uv=False)
    return bool(spread[1] > _LEAST_SPREAD * spread[0])


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
    of squared residuals cut off at the tolerance; the best different ones are refined with Tukey's loss. Until then
    residuals are linear in the ideal image about each image point: what is left out is the change of the distortion
    over a residual, below 0.0001 of it for residuals of some pixels.
    """
    points, pixels = float_array("points_m", points_m, (None, 3)), float_array("pixels_px", pixels_px, (None, 2))
    covariance = float_array("covariance_px2", covariance_px2, (len(points), 2, 2))
    if len(points) != len(pixels):
        raise InputError(f"resection: {len(points)} targets and {len(pixels)} image points")
    if len(points) < LEAST_TARGETS:
        raise EstimationError(f"resection: {len(points)} targets with known coordinates, {LEAST_TARGETS} are needed")
    image = _IdealImage.of(camera, pixels, covariance)
    turns, shifts = _three_point_poses(image, points)
    costs = (np.minimum(image.misses(turns, shifts, points), tolerance) ** 2).sum(axis=1)
    refined = [
        _refine(image, RigidTransform(turns[i], shifts[i]), points, tolerance)
        for i in _promising(turns, costs, 2 * len(points))
    ]
    found = [one for one in refined if one is not None]
    if not found:
        raise EstimationError(f"resection: no pose explains {LEAST_TARGETS} of the {len(points)} image points")
    judged = []
    for pose, matrix in found:
        miss = _misses(camera, pose, points, pixels, covariance)
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


class _IdealImage(NamedTuple):
    """Image points where a camera without distortion would have them.

    places (n, 2): x/z and y/z of the lines of sight; NaN where the lens is not one-to-one.
    roots (n, 2, 2): Take a difference of places to a residual in sigma.
    """

    places: FloatArray
    roots: FloatArray

    @classmethod
    def of(cls, camera: Camera, pixels: FloatArray, covariance: FloatArray) -> "_IdealImage":
        rays = camera.cast_rays(pixels)
        with np.errstate(divide="ignore", invalid="ignore"):
            ahead = np.where(rays[:, 2:] > 0, rays / rays[:, 2:], np.nan)
        change = camera.project_with_jacobians(ahead).d_pixel_d_point[..., :2]
        return cls(ahead[:, :2], np.linalg.inv(np.linalg.cholesky(covariance)) @ change)

    @property
    def usable(self) -> BoolArray:
        """Image points with a line of sight."""
        return np.asarray(np.isfinite(self.places).all(axis=1))

    def misses(self, turns: FloatArray, shifts: FloatArray, points: FloatArray) -> FloatArray:
        """Length of each residual for each pose, shape (k, n), in sigma; infinite behind the camera."""
        seen = points @ turns.swapaxes(1, 2) + shifts[:, None]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            difference = (seen[..., :2] / seen[..., 2:] - self.places)[..., None]
            squares = ((self.roots @ difference)[..., 0] ** 2).sum(axis=2)
        return np.sqrt(np.where((seen[..., 2] > 0) & np.isfinite(squares), squares, np.inf))


def _three_point_poses(image: _IdealImage, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the solutions of all chosen triples, rotations (k, 3, 3) and translations (k, 3)."""
    usable = np.nonzero(image.usable)[0]
    vectors: list[FloatArray] = []
    if usable.size >= 3:
        matrix, none = np.eye(3), np.zeros(4)
        triples = _triples(points, usable)
        for three, places in zip(points[triples], image.places[triples], strict=True):
            _, turns, shifts = cv2.solveP3P(three, places, matrix, none, flags=cv2.SOLVEPNP_AP3P)
            pairs = zip(turns, shifts, strict=True)
            vectors += [np.concatenate([turn, shift]).ravel() for turn, shift in pairs]
    poses = np.array(vectors).reshape(-1, 6)
    poses = poses[np.isfinite(poses).all(axis=1)]
    return rotations_from_vectors(poses[:, :3]), poses[:, 3:]


def _triples(points: FloatArray, usable: IntArray) -> IntArray:
    """Choose triples of targets not in one line, all of few or a fixed random choice of many, shape (k, 3)."""
    rng = np.random.default_rng(0)
    drawn = np.sort(rng.integers(usable.size, size=(40 * _TRIALS, 3)), axis=1)
    drawn = drawn[(drawn[:, 0] < drawn[:, 1]) & (drawn[:, 1] < drawn[:, 2])][: 4 * _TRIALS]
    triples = usable[np.unique(drawn, axis=0)]
    sides = points[triples]
    first, second = sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]
    area = np.linalg.norm(np.cross(first, second), axis=1)
    # Half the widest (precise), half at random (so that a few false wide ones do not take all places).
    widest = np.argsort(-area, kind="stable")[: _TRIALS // 2]
    others = rng.permutation(len(triples))[: _TRIALS // 2]
    chosen = np.unique(np.concatenate([widest, others]))
    size = ((sides[chosen] - sides[chosen].mean(axis=1, keepdims=True)) ** 2).sum(axis=(1, 2))
    return np.asarray(triples[chosen[area[chosen] >= 1e-6 * size]])


def _misses(
    camera: Camera, pose: RigidTransform, points: FloatArray, pixels: FloatArray, covariance: FloatArray
) -> FloatArray:
    """Length of each residual, shape (n,), in sigma; infinite where the target cannot be seen."""
    difference = (camera.project(pose.apply(points)) - pixels)[..., None]
    lengths = np.linalg.norm((np.linalg.inv(np.linalg.cholesky(covariance)) @ difference)[..., 0], axis=1)
    return np.where(np.isfinite(lengths), lengths, np.inf)


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
    image: _IdealImage, start: RigidTransform, points: FloatArray, tolerance: float
) -> tuple[RigidTransform, FloatArray] | None:
    """Refine with the image points that the pose can see; None if that fails."""
    seen = np.isfinite(image.misses(start.rotation[None], start.translation_m[None], points)[0])
    if seen.sum() < 3:
        return None
    targets, places, roots = points[seen], image.places[seen], image.roots[seen]

    def residuals(pose: RigidTransform) -> tuple[FloatArray, FloatArray]:
        turned = pose.rotate(targets)
        x, y, z = (turned + pose.translation_m).T
        z = np.where(z > 0, z, np.nan)
        slopes = np.zeros((len(turned), 2, 3))
        slopes[:, 0, 0] = slopes[:, 1, 1] = 1 / z
        slopes[:, 0, 2], slopes[:, 1, 2] = -x / z**2, -y / z**2
        moved = roots @ slopes
        difference = roots @ (np.stack([x / z, y / z], axis=1) - places)[..., None]
        return difference.ravel(), np.concatenate([-moved @ skew(turned), moved], axis=2).reshape(-1, 6)

    problem = Problem(POSE_NAMES, residuals, POSE)
    try:
        # Wide at first: a start from three noisy points may be tens of sigma off.
        typical = float(np.median(np.linalg.norm(residuals(start)[0].reshape(-1, 2), axis=1)))
        if 2 * typical > tolerance:
            start = solve(problem, start, loss=Tukey(4 * typical), block_size=2, options=_QUICK).state
        fine = solve(problem, start, loss=Tukey(tolerance), block_size=2, options=_QUICK)
    except EstimationError:
        return None
    return fine.state, fine.covariance
