"""Ellipses: conics, fits with honest precision, eccentricity against circles sent point by point through the camera."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliogauge.camera.distortion import BrownDistortion, DistortionDirection
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError
from photogrammetry.centers.ellipse import Ellipse, circle_image_center_px, eccentricity_px, fit_ellipse


def camera(k1: float = 0.0) -> Camera:
    lens = BrownDistortion(k1, 0.0, 0.0, 0.0, 0.0, DistortionDirection.IDEAL_TO_MEASURED)
    return Camera(4000, 3000, 3500.0, 3500.0, 2000.0, 1500.0, distortion=lens)


@given(a=st.floats(2, 50), ratio=st.floats(0.3, 1), angle=st.floats(0, 3), x=st.floats(-50, 50), y=st.floats(-50, 50))
def test_dual_conic_and_back(a: float, ratio: float, angle: float, x: float, y: float) -> None:
    ellipse = Ellipse.from_axes((x, y), (a, a * ratio), angle)
    back = Ellipse.from_dual_conic(-3.0 * ellipse.dual_conic)
    assert back.center_px == pytest.approx([x, y], abs=1e-9)
    assert back.semi_axes_px == pytest.approx((a, a * ratio), rel=1e-6)
    angles = np.linspace(0, 6, 7)
    off = ellipse.points_px(angles) - ellipse.center_px
    assert np.einsum("ni,ij,nj->n", off, np.linalg.inv(ellipse.shape_px2), off) == pytest.approx(np.ones(7))


def test_first_axis_turns_from_x_towards_y() -> None:
    ellipse = Ellipse.from_axes((0, 0), (5.0, 1.0), 0.3)
    assert ellipse.shape_px2[0, 1] > 0
    assert ellipse.axis_ratio == pytest.approx(0.2)


def test_what_is_no_ellipse_is_refused() -> None:
    with pytest.raises(InputError, match="positive definite"):
        Ellipse(np.zeros(2), np.diag([1.0, -1.0]))
    line = np.stack([np.arange(8.0), np.arange(8.0) ** 2], axis=1)
    with pytest.raises(EstimationError):
        fit_ellipse(line * [1, -1])
    with pytest.raises(EstimationError, match="6 points"):
        fit_ellipse(line[:5])


def test_fit_finds_exact_points() -> None:
    truth = Ellipse.from_axes((100.3, 50.7), (20.0, 9.0), 0.7)
    fit = fit_ellipse(truth.points_px(np.linspace(0, 2 * np.pi, 40, endpoint=False)))
    assert fit.ellipse.center_px == pytest.approx(truth.center_px, abs=1e-9)
    assert fit.ellipse.semi_axes_px == pytest.approx((20.0, 9.0), abs=1e-9)
    assert fit.rms_px < 1e-9


def test_fit_covariance_is_honest() -> None:
    rng = np.random.default_rng(3)
    truth = Ellipse.from_axes((100.3, 50.7), (20.0, 9.0), 0.7)
    points = truth.points_px(np.linspace(0, 2 * np.pi, 40, endpoint=False))
    square = []
    for _ in range(300):
        fit = fit_ellipse(points + rng.normal(0, 0.05, points.shape))
        error = fit.ellipse.center_px - truth.center_px
        square.append(error @ np.linalg.solve(fit.covariance_px2, error))
    # chi-square with 2 degrees of freedom: mean 2, sigma of the mean 2 / sqrt(300) = 0.12 (and t-tails add 6 %)
    assert 1.7 < np.mean(square) < 2.5


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
    found = fit_ellipse(outline).ellipse.center_px
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
