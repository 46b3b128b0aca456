"""The synthetic camera's own Brown model: its inverse against brute force, its projection against its rays."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq, minimize

from data_synth.fringes.presets import FULL_CAMERA, SMALL_CAMERA
from data_synth.optics.pinhole import PinholeCamera
from heliogauge.errors import InputError

WIDE = PinholeCamera(800, 600, 420.0, 430.0, 395.0, 305.0, -0.28, 0.09, -0.012, 4e-4, -7e-4)


@pytest.mark.parametrize("camera", [FULL_CAMERA, WIDE], ids=["long lens", "wide lens"])
def test_projection_of_rays_returns_to_the_pixel(camera):
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-0.5, camera.width_px - 0.5, 500), rng.uniform(-0.5, camera.height_px - 0.5, 500)
    rays = camera.rays(x, y)
    assert_allclose(np.linalg.norm(rays, axis=1), 1, rtol=1e-15)
    assert_allclose(camera.project(3.7 * rays), np.column_stack([x, y]), atol=1e-9)


def test_inverse_of_pure_radial_distortion_against_bisection():
    camera = replace(WIDE, p1=0.0, p2=0.0)
    for measured in (0.1, 0.4, 0.7, 0.9):
        wanted = brentq(
            lambda r, m=measured: r * (1 - 0.28 * r**2 + 0.09 * r**4 - 0.012 * r**6) - m, 0, 1.5, xtol=1e-15
        )
        x, y = camera.undistort(np.array(0.6 * measured), np.array(-0.8 * measured))
        assert_allclose([x, y], [0.6 * wanted, -0.8 * wanted], atol=1e-14)


def test_inverse_against_a_search_that_uses_no_derivatives():
    target = np.array([0.55, -0.43])

    def miss(point):
        x, y = point
        r2 = x * x + y * y
        radial = 1 - 0.28 * r2 + 0.09 * r2**2 - 0.012 * r2**3
        seen = (
            x * radial + 2 * 4e-4 * x * y - 7e-4 * (r2 + 2 * x * x),
            y * radial + 4e-4 * (r2 + 2 * y * y) - 14e-4 * x * y,
        )
        return np.hypot(seen[0] - target[0], seen[1] - target[1])

    found = minimize(miss, target, method="Nelder-Mead", options={"xatol": 1e-13, "fatol": 1e-14, "maxiter": 2000}).x
    assert_allclose(WIDE.undistort(*target), found, atol=1e-10)


def test_points_behind_the_camera_have_no_image():
    assert np.isnan(WIDE.project(np.array([0.1, 0.1, -1.0]))).all()


def test_coarser_pixels_see_the_same_corner():
    corner = np.array([-0.5])
    assert_allclose(SMALL_CAMERA.rays(corner, corner), FULL_CAMERA.rays(corner, corner), atol=1e-15)
    assert (SMALL_CAMERA.width_px, SMALL_CAMERA.height_px) == (203, 154)


def test_a_lens_that_folds_the_image_is_refused():
    fold = replace(WIDE, k1=-1.0, k2=0.0, k3=0.0)
    with pytest.raises(InputError, match="folds"):
        fold.rays(np.array([0.0]), np.array([0.0]))
