"""A laboratory setup that the tests of this package share."""

import numpy as np
import pytest

from deflectometry.setup.camera_and_screen import RectangularScreen, Setup
from heliogauge.camera.distortion import BrownDistortion
from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform


@pytest.fixture(scope="package")
def laboratory() -> Setup:
    """A camera beside a wall that shows the pattern, both looking at a mirror 10 m away."""
    camera = Camera(
        width_px=400,
        height_px=300,
        focal_x_px=1200.0,
        focal_y_px=1198.0,
        center_x_px=201.0,
        center_y_px=148.0,
        distortion=BrownDistortion(k1=-0.1, k2=0.05, p1=1e-4, p2=-2e-4),
    )
    cam_from_screen = RigidTransform.from_rotation_vector([0.02, -0.03, 0.01], [0.3, -1.2, 0.1])
    turned = RigidTransform(cam_from_screen.rotation @ np.diag([-1.0, -1.0, 1.0]), cam_from_screen.translation_m)
    covariance = np.diag([2e-4, 2e-4, 2e-4, 1e-3, 1e-3, 2e-3]) ** 2
    return Setup(camera, RectangularScreen(9.0, 9.0), turned, covariance)


@pytest.fixture(scope="package")
def cam_from_mirror() -> RigidTransform:
    """A mirror 10 m in front of the camera, about upright, that shows the wall."""
    facing = RigidTransform.from_rotation_vector([np.pi, 0.0, 0.0], [0.0, 0.0, 0.0])
    return RigidTransform.from_rotation_vector([0.05, 0.02, 0.03], [0.05, 0.02, 10.0]) @ facing
