"""A tube before a plain background, drawn from its definition: which sub-pixel rays meet the cylinder."""

from collections.abc import Callable

import cv2
import numpy as np

from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector
from observer.photo_edges.views import View

Axis = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def looking(eye_m: np.ndarray, target_m: np.ndarray, roll_rad: float = 0.05) -> RigidTransform:
    """Return ``cam_from_frame`` of a camera whose rows run across the trough, nearly."""
    forward = (target_m - eye_m) / np.linalg.norm(target_m - eye_m)
    right = np.cross(np.array([0.0, 1.0, 0.0]), forward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    rotation = rotation_from_vector(np.array([0.0, 0.0, roll_rad])) @ rotation
    return RigidTransform(rotation, -rotation @ eye_m)


def drawn_tube(view: View, axis: Axis, radius_m: float, *, tones: tuple[float, float] = (20.0, 180.0)) -> np.ndarray:
    """Draw a tube whose axis is given as (x, z) of y; brightness of the tube and of what is behind [DN]."""
    camera, pose = view
    fine = 6
    grid = (np.arange(fine) + 0.5) / fine - 0.5
    u, v = np.meshgrid(
        (np.arange(camera.width_px)[:, None] + grid).ravel(), (np.arange(camera.height_px)[:, None] + grid).ravel()
    )
    rays = (
        np.stack(
            [
                (u - camera.center_x_px) / camera.focal_x_px,
                (v - camera.center_y_px) / camera.focal_y_px,
                np.ones_like(u),
            ],
            axis=-1,
        )
        @ pose.rotation
    )
    eye = pose.inverse().translation_m
    x, z = np.zeros_like(u), np.full_like(u, float(axis(np.zeros(1))[1][0]))
    for _ in range(3):
        # Nearest to the axis across the trough; the axis there.
        square = rays[..., 0] ** 2 + rays[..., 2] ** 2
        length = ((x - eye[0]) * rays[..., 0] + (z - eye[2]) * rays[..., 2]) / square
        x, z = axis(eye[1] + length * rays[..., 1])
    beside = ((x - eye[0]) * rays[..., 2] - (z - eye[2]) * rays[..., 0]) / np.sqrt(square)
    light = np.where(np.abs(beside) < radius_m, *tones)
    image = light.reshape(camera.height_px, fine, camera.width_px, fine).mean(axis=(1, 3))
    return np.asarray(cv2.GaussianBlur(image.astype(np.float32), (0, 0), 0.7))
