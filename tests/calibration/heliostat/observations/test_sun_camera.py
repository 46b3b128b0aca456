"""The sun in a camera on the mirror: sub-pixel centre, honest sigma, angles, clouds."""

import cv2
import numpy as np
import pytest

from calibration.heliostat.observations.sun_camera import sun_disc, sun_shifts_rad
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError


def _sun(center: tuple[float, float], radius: float = 20.0, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    finer = 8
    y, x = (np.mgrid[: 120 * finer, : 160 * finer] + 0.5) / finer - 0.5
    far = np.hypot(x - center[0], y - center[1]) / radius
    limb = np.where(far < 1, 0.4 + 0.6 * np.sqrt(np.clip(1 - far**2, 0, 1)), 0.0)
    values = 8 + 180 * cv2.resize(limb, (160, 120), interpolation=cv2.INTER_AREA)
    return values + np.random.default_rng(seed).normal(0, noise, values.shape) if noise else values


@pytest.mark.parametrize("center", [(80.0, 60.0), (71.37, 52.81)])
def test_center(center: tuple[float, float]) -> None:
    disc = sun_disc(_sun(center))
    assert disc.center_px == pytest.approx(center, abs=0.02)
    assert disc.radius_px == pytest.approx(20.0, rel=0.03)
    assert disc.roundness == pytest.approx(1.0, abs=0.01)
    # Overexposed, the disc is larger by its blur, not elsewhere.
    assert sun_disc(np.minimum(2 * _sun(center), 255)).center_px == pytest.approx(center, abs=0.03)


def test_sigma_is_the_scatter() -> None:
    clean = _sun((71.37, 52.81))
    rng = np.random.default_rng(3)
    discs = [sun_disc(clean + rng.normal(0, 3.0, clean.shape)) for _ in range(200)]
    scatter = np.std([disc.center_px for disc in discs], axis=0)
    assert scatter / np.mean([disc.sigma_px for disc in discs]) == pytest.approx([1, 1], abs=0.2)


def test_shifts_are_angles_of_the_normal() -> None:
    camera = Camera(160, 120, 1500.0, 1500.0, 79.5, 59.5)
    centers = [sun_disc(_sun((79.5 + 3 * k, 59.5 - 1.5 * k))).center_px for k in range(4)]
    shifts = sun_shifts_rad(camera, centers)
    assert shifts == pytest.approx(np.arange(4)[:, None] * [3 / 1500, 1.5 / 1500], abs=3e-5)
    with pytest.raises(InputError, match="at least one"):
        sun_shifts_rad(camera, np.zeros((0, 2)))


def test_clouds_and_borders() -> None:
    covered = _sun((80.0, 60.0))
    covered[:, 80:] = 8
    assert sun_disc(covered).roundness < 0.6
    with pytest.raises(EstimationError, match="border"):
        sun_disc(_sun((5.0, 60.0)))
    with pytest.raises(EstimationError, match="no sun"):
        sun_disc(np.random.default_rng(1).normal(10, 2, (120, 160)))
    with pytest.raises(InputError, match="grey"):
        sun_disc(np.zeros((10, 10, 3)))
