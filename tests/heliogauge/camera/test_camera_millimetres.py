"""Cameras in millimetres: the printed formulas themselves, both ways, with covariance."""

import numpy as np
import pytest

from heliogauge.camera.distortion import BrownDistortion, DistortionDirection
from heliogauge.camera.millimetres import (
    LensForm,
    PrincipalOrigin,
    Sensor,
    SensorParameters,
    propagate_back,
    sensor_parameters,
)
from heliogauge.camera.model import Camera
from heliogauge.errors import InputError

AICON = np.array([24.5, 0.11, -0.07, -9e-5, 1.4e-7, -2e-11, 4e-6, -7e-6, 0.0, 0.0])
SIGMAS = np.array([1e-3, 2e-3, 2e-3, 1e-7, 1e-10, 1e-13, 1e-7, 1e-7, 1e-6, 1e-6])


def sensor(form=LensForm.AICON, direction=DistortionDirection.MEASURED_TO_IDEAL, **more):
    zero = {"zero_radius_mm": 14.0} if form is LensForm.AICON else {}
    return Sensor(6000, 4000, 0.006, form, direction=direction, **zero, **more)


def corrections(values, xy, zero_radius, sign):
    """Luhmann's formula, written out: what AICON's lens does to coordinates from the principal point, y up [mm]."""
    a1, a2, a3, b1, b2, c1, c2 = values[3:]
    x, y = xy.T
    r2 = x * x + y * y
    radial = a1 * (r2 - zero_radius**2) + a2 * (r2**2 - zero_radius**4) + a3 * (r2**3 - zero_radius**6)
    return sign * np.column_stack(
        [
            x * radial + b1 * (r2 + 2 * x * x) + 2 * b2 * x * y + c1 * x + c2 * y,
            y * radial + b2 * (r2 + 2 * y * y) + 2 * b1 * x * y,
        ]
    )


def sensor_mm(values, pixels):
    """Image points from the principal point, y up [mm]."""
    return (pixels + 0.5 - [3000, 2000]) * [0.006, -0.006] - values[1:3]


@pytest.mark.parametrize("affine", [(0.0, 0.0), (2e-4, -3e-4)])
def test_aicon_measured_to_ideal_is_its_formula(affine):
    values = np.array([*AICON[:8], *affine])
    pixels = np.random.default_rng(0).uniform([0, 0], [6000, 4000], (200, 2))
    measured = sensor_mm(values, pixels)
    ideal = measured + corrections(values, measured, 14.0, -1)
    rays = SensorParameters(sensor(), values).camera().cast_rays(pixels)
    found = rays[:, :2] / rays[:, 2:] * [24.5, -24.5]
    # The product of affine terms and a strong lens (2 %) is the only difference: 0.02 px (0.12 um) in the corners.
    np.testing.assert_allclose(found, ideal, rtol=0, atol=1e-12 if affine == (0.0, 0.0) else 1.2e-4)


def test_aicon_ideal_to_measured_is_its_formula():
    points = np.random.default_rng(0).uniform([-0.6, -0.4, 1], [0.6, 0.4, 1], (200, 3))
    ideal = points[:, :2] * [24.5, -24.5]
    measured = ideal + corrections(AICON, ideal, 14.0, 1)
    camera = SensorParameters(sensor(direction=DistortionDirection.IDEAL_TO_MEASURED), AICON).camera()
    np.testing.assert_allclose(sensor_mm(AICON, camera.project(points)), measured, atol=1e-12)


@pytest.mark.parametrize("direction", list(DistortionDirection))
@pytest.mark.parametrize("form", list(LensForm))
@pytest.mark.parametrize("origin", list(PrincipalOrigin))
@pytest.mark.parametrize("y_up", [True, False])
def test_there_and_back_with_covariance(direction, form, origin, y_up):
    values = np.array([*AICON[:8], 2e-4, -3e-4])
    mix = np.eye(10) + 0.3 * np.random.default_rng(1).normal(size=(10, 10))
    covariance = (mix @ mix.T) * SIGMAS[:, None] * SIGMAS
    given = SensorParameters(sensor(form, direction, principal_origin=origin, y_up=y_up), values, covariance)
    back = sensor_parameters(given.camera(), given.sensor)
    np.testing.assert_allclose(back.values, values, rtol=1e-9, atol=1e-22)
    np.testing.assert_allclose(back.covariance / SIGMAS[:, None] / SIGMAS, mix @ mix.T, atol=1e-7)


def test_an_aspect_that_was_held_has_no_variance():
    lens = BrownDistortion(k1=0.25, k2=-0.13, k3=-0.3, direction=DistortionDirection.MEASURED_TO_IDEAL)
    camera = Camera(2272, 1704, 2336.7, 2337.6, 1132.4, 818.5, distortion=lens)
    # One focal length was estimated: both move as one.
    root = np.zeros((10, 3))
    root[:2, 0], root[5, 1], root[5, 2] = [0.33 * 2336.7 / 2337.6, 0.33], 1e-3, 5e-4
    camera = camera.with_covariance(root @ root.T)
    for origin in PrincipalOrigin:
        found = sensor_parameters(camera, sensor(LensForm.BROWN, principal_origin=origin)).covariance[8]
        np.testing.assert_array_equal(found, 0.0)


def test_the_other_direction_is_refused():
    with pytest.raises(InputError, match="convert it first"):
        sensor_parameters(Camera(60, 40, 50.0, 50.0, 30.0, 20.0), sensor())
    with pytest.raises(InputError, match="only with AICON"):
        Sensor(60, 40, 0.01, zero_radius_mm=1.0)


def test_directions_nearly_without_variance_stay_a_covariance():
    # Two quantities known as one; rounding made one of their directions negative.
    covariance = np.array([[1.0, 1.0], [1.0, 1.0 - 1e-8]])
    found = propagate_back(np.eye(2), covariance)
    assert np.linalg.eigvalsh(covariance).min() < -1e-9
    assert np.linalg.eigvalsh(found).min() > -1e-15
    np.testing.assert_allclose(found, covariance, atol=1e-8)
