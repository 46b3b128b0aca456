"""A screen that was measured: where its points are, and which errors points and the camera's pose share."""

from dataclasses import dataclass

import numpy as np

from deflectometry.setup.dot_screen import DotScreen
from deflectometry.setup.smooth_screen import SharedStep, SmoothScreen
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredScreen(ShortRepr):
    """A measured screen in its frame.

    screen: Its surface, or its dots with what is each dot's own error.
    shared: Independent errors of its points and of the measuring camera's pose together, one sigma each.
    cam_from_screen: Pose of the measuring camera; None where no photo of it was among the photos.
    sigma_surface_m: How far the points are off the surface beyond their own noise, RMS [m].
    """

    screen: SmoothScreen | DotScreen
    shared: tuple[SharedStep, ...]
    cam_from_screen: RigidTransform | None
    sigma_surface_m: float = 0.0

    @property
    def covariance_pose(self) -> FloatArray:
        """Covariance of the camera's pose, shape (6, 6), for the steps of `RigidTransform.moved`."""
        steps = np.array([one.cam_from_screen for one in self.shared]).reshape(-1, 6)
        return np.asarray(steps.T @ steps)

    def sigma_points_m(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Return the standard deviations of the points at fractions of the field or display, shape (..., 3) [m]."""
        variance = np.zeros((*np.shape(u), 3))
        for one in self.shared:
            variance += one.warp.shifts_m(u, v) ** 2
        if isinstance(self.screen, DotScreen):
            variance += self.screen.sigma_at(u, v) ** 2
        return np.sqrt(variance)
