"""Small photo networks with known truth, drawn here and not by the code under test."""

import numpy as np

from heliogauge.camera.distortion import BrownDistortion, DistortionDirection
from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from photogrammetry.bundle.state import BundleState
from photogrammetry.image_points import ImagePoints


def look_at(center_m, target_m, roll_rad=0.0):
    """Pose of a camera at a place that looks at another, rolled about its axis."""
    forward = np.asarray(target_m, float) - center_m
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.1, 0.9, 0.2])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    cosine, sine = np.cos(roll_rad), np.sin(roll_rad)
    rotation = np.stack([cosine * right + sine * down, -sine * right + cosine * down, forward])
    return RigidTransform(rotation, -rotation @ center_m)


def camera_of(direction=DistortionDirection.IDEAL_TO_MEASURED):
    lens = BrownDistortion(k1=-0.12, k2=0.08, k3=-0.02, p1=3e-4, p2=-2e-4, direction=direction)
    return Camera(6000, 4000, 6100.0, 6103.0, 3010.0, 1990.0, distortion=lens)


def network(
    rng, n_photos=40, n_points=300, *, sigma_px=0.05, direction=DistortionDirection.IDEAL_TO_MEASURED, size_m=4.0
):
    """Photos all round above an uneven panel of twice ``size_m``; returns truth and image points with noise."""
    points = np.column_stack([rng.uniform(-size_m, size_m, (n_points, 2)), rng.uniform(-0.15, 0.15, n_points) * size_m])
    camera = camera_of(direction)
    poses = []
    for i in range(n_photos):
        angle, height = 2 * np.pi * i / n_photos * 3, (1.2 + 0.5 * (i % 3)) * size_m
        center = np.array([1.7 * size_m * np.cos(angle), 1.7 * size_m * np.sin(angle), height])
        poses.append(look_at(center, rng.uniform(-0.2, 0.2, 3) * size_m, (i % 4) * np.pi / 2))
    truth = BundleState.from_poses([camera], poses, points)
    return truth, observe(truth, rng, sigma_px)


def observe(truth, rng, sigma_px=0.05, *, covariances=None):
    """Image points of everything inside the images, with normal errors."""
    photo, target, pixels = [], [], []
    for i in range(len(truth.rotations)):
        seen = truth.cameras[0].project(truth.cam_from_world(i).apply(truth.points_m))
        inside = (np.abs(seen - [2999.5, 1999.5]) < [3000, 2000]).all(axis=1)
        photo += [i] * int(inside.sum())
        target += np.nonzero(inside)[0].tolist()
        pixels.append(seen[inside])
    pixels = np.concatenate(pixels)
    covariance = np.broadcast_to(np.eye(2) * sigma_px**2, (len(pixels), 2, 2)) if covariances is None else covariances
    noise = (np.linalg.cholesky(covariance) @ rng.normal(size=(len(pixels), 2, 1)))[:, :, 0]
    return ImagePoints(
        tuple(f"photo{i}" for i in range(len(truth.rotations))),
        tuple(f"t{i}" for i in range(len(truth.points_m))),
        np.array(photo),
        np.array(target),
        pixels + noise,
        covariance,
    )


def disturbed(truth, rng, share=1.0):
    """A start some way off the truth."""
    poses = [
        truth.cam_from_world(i).moved(np.concatenate([rng.normal(0, 0.005, 3), rng.normal(0, 0.02, 3)]) * share)
        for i in range(len(truth.rotations))
    ]
    points = truth.points_m + rng.normal(0, 0.02 * share, truth.points_m.shape)
    return BundleState.from_poses(truth.cameras, poses, points)
