"""Ellipses: axes and points, eccentricity against circles sent point by point through the camera."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliogauge.camera.distortion import BrownDistortion, DistortionDirection
from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from photogrammetry.centers.ellipse import Ellipse, circle_image_center_px, eccentricity_px


def camera(k1: float = 0.0) -> Camera:
    lens = BrownDistortion(k1, 0.0, 0.0, 0.0, 0.0, DistortionDirection.IDEAL_TO_MEASURED)
    return Camera(4000, 3000, 3500.0, 3500.0, 2000.0, 1500.0, distortion=lens)


@given(a=st.floats(2, 50), ratio=st.floats(0.3, 1), angle=st.floats(0, 3))
def test_axes_and_points_of_an_ellipse(a: float, ratio: float, angle: float) -> None:
    axes = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) * [a, a * ratio]
    ellipse = Ellipse(np.array([3.0, -7.0]), axes @ axes.T)
    assert ellipse.semi_axes_px == pytest.approx((a, a * ratio), rel=1e-6)
    assert ellipse.radius_px == pytest.approx(a * np.sqrt(ratio))
    off = ellipse.points_px(np.linspace(0, 6, 7)) - ellipse.center_px
    assert np.einsum("ni,ij,nj->n", off, np.linalg.inv(ellipse.shape_px2), off) == pytest.approx(np.ones(7))


def test_what_is_no_ellipse_is_refused() -> None:
    with pytest.raises(InputError, match="positive definite"):
        Ellipse(np.zeros(2), np.diag([1.0, -1.0]))


def conic_center(points: np.ndarray) -> np.ndarray:
    """Centre of the conic A x^2 + B x y + C y^2 + D x + E y = 1 through points, by least squares."""
    middle = points.mean(axis=0)
    x, y = (points - middle).T
    a, b, c, d, e = np.linalg.lstsq(np.stack([x * x, x * y, y * y, x, y], axis=1), np.ones(x.size), rcond=None)[0]
    return middle - np.linalg.solve([[2 * a, b], [b, 2 * c]], [d, e])


@pytest.mark.parametrize("k1", [0.0, -0.12])
def test_eccentricity_is_that_of_circles_drawn_point_by_point(k1: float) -> None:
    eye = camera(k1)
    center = np.array([0.5, -0.35, 2.0])
    normal = np.array([0.5, 0.3, -0.8]) / np.linalg.norm([0.5, 0.3, -0.8])
    u = np.cross(normal, [1.0, 0.0, 0.0])
    u /= np.linalg.norm(u)
    v = np.cross(normal, u)
    t = np.linspace(0, 2 * np.pi, 400, endpoint=False)[:, None]
    radius = 0.03
    outline = eye.project(center + radius * (np.cos(t) * u + np.sin(t) * v))
    found = conic_center(outline)
    offset = eccentricity_px(eye, center[None], normal[None], radius)[0]
    assert np.hypot(*offset) > 0.2
    assert found - eye.project(center) == pytest.approx(offset, abs=2e-3 if k1 else 1e-6)


def test_eccentricity_vanishes_for_points_and_frontal_circles() -> None:
    centers, normals = np.array([[0.3, 0.1, 2.0], [0.0, 0.0, 2.0]]), np.array([[0.6, 0.0, 0.8], [0.0, 0.0, 1.0]])
    assert eccentricity_px(camera(), centers, normals, [0.0, 0.05]) == pytest.approx(np.zeros((2, 2)), abs=1e-9)


def test_the_nearer_half_of_a_circle_looks_larger() -> None:
    """The right half is nearer: the ellipse's centre lies to the right of the circle's centre."""
    offset = eccentricity_px(camera(), [[0.0, 0.0, 2.0]], [[0.6, 0.0, 0.8]], 0.05)[0]
    assert offset[0] > 0.5
    assert offset[1] == pytest.approx(0, abs=1e-9)


def test_circles_behind_the_camera_have_no_image() -> None:
    assert np.isnan(circle_image_center_px(camera(), [[0.0, 0.0, -1.0]], [[0.0, 0.0, 1.0]], 0.1)).all()
