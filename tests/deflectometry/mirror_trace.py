"""A second route for tests: trace lines of sight off a surface given by formulas, to the display."""

from collections.abc import Callable

import numpy as np

from deflectometry.setup.camera_and_screen import Setup
from heliogauge.geometry.rigid import RigidTransform

Height = Callable[[np.ndarray, np.ndarray], np.ndarray]
Gradient = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def trace_pixels(
    setup: Setup, pixels_px: np.ndarray, cam_from_facet: RigidTransform, height: Height, gradient: Gradient
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return display u, v and the mirror's x, y of each pixel; the screen is the rectangle of the setup."""
    facet_from_cam = cam_from_facet.inverse()
    start = facet_from_cam.translation_m
    rays = facet_from_cam.rotate(setup.camera.cast_rays(pixels_px))
    length = -start[2] / rays[:, 2]
    for _ in range(60):
        points = start + length[:, None] * rays
        slope_x, slope_y = gradient(points[:, 0], points[:, 1])
        missing = height(points[:, 0], points[:, 1]) - points[:, 2]
        length = length + missing / (rays[:, 2] - slope_x * rays[:, 0] - slope_y * rays[:, 1])
    points = start + length[:, None] * rays
    slope_x, slope_y = gradient(points[:, 0], points[:, 1])
    normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=1)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    reflected = rays - 2 * np.sum(rays * normal, axis=1)[:, None] * normal
    screen_from_facet = setup.cam_from_screen.inverse() @ cam_from_facet
    origin, direction = screen_from_facet.apply(points), screen_from_facet.rotate(reflected)
    hit = origin - (origin[:, 2] / direction[:, 2])[:, None] * direction
    return (
        hit[:, 0] / setup.screen.width_m + 0.5,  # type: ignore[attr-defined]
        0.5 - hit[:, 1] / setup.screen.height_m,  # type: ignore[attr-defined]
        points[:, 0],
        points[:, 1],
    )
