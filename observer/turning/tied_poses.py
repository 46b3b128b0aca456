"""Poses of photos tied to the readings of an inclinometer: one fixed camera, a collector that turns before it.

From far away corners of panels tell the direction of a camera against the collector to some tenths of a milliradian,
each photo for itself. The readings tell how it changes from photo to photo. Both together are a linear estimate with
the joint covariance of all poses (Kalman's update, relinearised): unknown besides are where the camera stands, the
axis of rotation and the inclinometer's scale, each with what is known of it beforehand.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from heliogauge.geometry.rigid import RigidTransform, skew
from heliogauge.validate import BoolArray, FloatArray
from observer.slopes.pose_modes import Photos
from observer.turning.far_camera import FarCamera, KnownFarCamera, TiltReadings

#: Tripod and bearings hold the camera and the axis so well [m]; at 100 focal lengths it is 0.007 mrad.
_PLAY_M = 1e-3
#: A reading contradicts the photos from so many sigmas on: by chance one in 10^6.
CONTRADICTED = 4.9
#: Rounds of the update; corners alone are within some mrad, so that each gains three digits.
_ROUNDS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Turning:
    """How the collector turns by the photos alone, against its readings.

    scale, sigma_scale: Turn in the photos for one of the readings'.
    used (n,): Photos whose reading is used.
    over_sigma (n,): By how many sigmas each reading differs from the others and the photos; NaN without a reading.
    """

    scale: float
    sigma_scale: float
    used: BoolArray
    over_sigma: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class TiedPoses:
    """Poses with the readings.

    photos: Poses with their joint covariance.
    camera: The far camera as adjusted.
    sigma (6,): Standard deviations of its unknowns.
    turning: What the photos alone say of the readings.
    """

    photos: Photos
    camera: FarCamera
    sigma: FloatArray
    turning: Turning


def compare_turning(photos: Photos, readings: TiltReadings, camera: FarCamera) -> Turning:
    """Compare how the collector turned by the corners of its panels with what was read.

    camera: Gives the axis of rotation.

    A straight line through the directions of the camera over the readings, weighted with the joint covariance of both;
    readings that contradict it are left out, the worst one first.
    """
    angle, with_steps = _directions(photos, camera)
    covariance = with_steps @ photos.covariance @ with_steps.T + np.diag(readings.sigma_rad**2)
    used = np.isfinite(readings.tilt_rad)
    over = np.full(used.shape, np.nan)
    while True:
        number = np.flatnonzero(used)
        weight = np.linalg.inv(covariance[np.ix_(number, number)])
        design = np.stack([np.ones(number.size), -readings.tilt_rad[number]], axis=1)
        line_covariance = np.linalg.inv(design.T @ weight @ design)
        line = line_covariance @ (design.T @ (weight @ angle[number]))
        left = weight @ (angle[number] - design @ line)
        # The test of an observation against all others (Baarda): exact for correlated ones, too.
        spread = np.diag(weight - weight @ design @ line_covariance @ design.T @ weight)
        over[number] = left / np.sqrt(np.maximum(spread, np.finfo(float).tiny))
        worst = int(np.argmax(np.abs(over[number])))
        if abs(over[number][worst]) < CONTRADICTED or number.size <= _FEWEST:
            return Turning(float(line[1]), float(np.sqrt(line_covariance[1, 1])), used, over)
        used = used.copy()
        used[number[worst]] = False


#: A line with one reading to spare.
_FEWEST = 3


def _directions(photos: Photos, camera: FarCamera) -> tuple[FloatArray, FloatArray]:
    """Return the camera's angle from the collector's z axis in each photo, and what steps of all poses do to it."""
    away = photos.eyes_m - [camera.axis_x_m, 0.0, camera.axis_z_m]
    square = away[:, 0] ** 2 + away[:, 2] ** 2
    gradient = np.stack([away[:, 2], np.zeros_like(square), -away[:, 0]], axis=1) / square[:, None]
    by_step = np.zeros((len(photos.poses), 6 * len(photos.poses)))
    for k, moves in enumerate(_eye_moves(photos.poses)):
        by_step[k, 6 * k : 6 * k + 6] = gradient[k] @ moves
    return np.arctan2(away[:, 0], away[:, 2]), by_step


def _eye_moves(poses: Sequence[RigidTransform]) -> FloatArray:
    """Return what a step (w, d) of each pose does to its eye: -R^T ([t]x w + d), shape (n, 3, 6)."""
    return np.array([-pose.rotation.T @ np.hstack([skew(pose.translation_m), np.eye(3)]) for pose in poses])


def tie_poses(photos: Photos, readings: TiltReadings, known: KnownFarCamera, turning: Turning) -> TiedPoses:
    """Adjust poses and camera to the readings.

    turning: Says which readings are used.
    """
    number = np.flatnonzero(turning.used)
    state = _State(np.zeros(photos.covariance.shape[0]), known.camera)
    prior = np.zeros((state.size, state.size))
    prior[: state.steps.size, : state.steps.size] = photos.covariance
    prior[state.steps.size :, state.steps.size :] = np.diag(known.sigma**2)
    covariance = prior
    for _ in range(_ROUNDS):
        moved = _moved(photos, state.steps)
        tilt, sigma = readings.tilt_rad[number], readings.sigma_rad[number]
        miss = moved.eyes_m[number] - state.camera.eyes_m(tilt)
        design = np.zeros((3 * number.size, state.size))
        for k, (photo, moves) in enumerate(zip(number, _eye_moves(moved.poses)[number], strict=True)):
            design[3 * k : 3 * k + 3, 6 * photo : 6 * photo + 6] = moves
        design[:, state.steps.size :] = -state.camera.derivatives(tilt).reshape(-1, known.sigma.size)
        noise = _noise(state.camera.tangents_m(tilt), sigma)
        since = np.concatenate([state.steps, state.camera.unknowns - known.camera.unknowns])
        gain = np.linalg.solve(design @ prior @ design.T + noise, design @ prior).T
        step = -gain @ (miss.ravel() - design @ since)
        state = _State(
            step[: state.steps.size], FarCamera(*(known.camera.unknowns + step[state.steps.size :]).tolist())
        )
        covariance = prior - gain @ design @ prior
    covariance = 0.5 * (covariance + covariance.T)
    size = state.steps.size
    tied = replace(_moved(photos, state.steps), covariance=np.ascontiguousarray(covariance[:size, :size]))
    return TiedPoses(tied, state.camera, np.sqrt(np.diag(covariance)[size:]), turning)


class _State(NamedTuple):
    """Steps of all poses from those by the corners, and the camera."""

    steps: FloatArray
    camera: FarCamera

    @property
    def size(self) -> int:
        return int(self.steps.size + self.camera.unknowns.size)


def _moved(photos: Photos, steps: FloatArray) -> Photos:
    poses = tuple(pose.moved(step) for pose, step in zip(photos.poses, steps.reshape(-1, 6), strict=True))
    return replace(photos, poses=poses)


def _noise(tangents_m: FloatArray, sigma_rad: FloatArray) -> FloatArray:
    """Return the covariance of the places by the readings, shape (3 n, 3 n) [m^2]."""
    found = _PLAY_M**2 * np.eye(tangents_m.size)
    for k, (tangent, sigma) in enumerate(zip(tangents_m, sigma_rad, strict=True)):
        found[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += sigma**2 * np.outer(tangent, tangent)
    return found
