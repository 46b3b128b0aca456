"""Centres of the light of small dots: errors as stated, blur or not; what has something else beside it has none."""

import cv2
import numpy as np
import pytest

from heliogauge.validate import FloatArray
from photogrammetry.centers import has_free_ground, light_centers

#: Rays across a pixel, and distance of the dots [px].
_RAYS, _PITCH = 16, 24
_TILT = 0.5


def _drawn(
    radius_px: float, blur_px: float, noise_dn: float, rng: np.random.Generator, slope_dn: float = 0.0, count: int = 8
) -> tuple[np.ndarray, FloatArray, FloatArray]:
    """Return a photo of dark ellipses, their centres and shapes: rays over each pixel, blur, noise, whole values."""
    size = count * _PITCH
    column, row = (one.ravel() for one in np.meshgrid(np.arange(count), np.arange(count)))
    centers = np.stack([column, row], axis=1) * _PITCH + _PITCH / 2 + rng.uniform(-0.5, 0.5, (count**2, 2))
    axes = np.array([radius_px, radius_px * np.cos(_TILT)])
    fine = (np.arange(_PITCH * _RAYS) + 0.5) / _RAYS - 0.5
    light = np.zeros((size, size), dtype=np.float32)
    for (x, y), left, top in zip(centers, column * _PITCH, row * _PITCH, strict=True):
        inside = ((fine + left - x) / axes[0]) ** 2 + (((fine + top - y) / axes[1]) ** 2)[:, None] < 1
        one = inside.astype(np.float32)
        if blur_px:
            one = np.asarray(cv2.GaussianBlur(one, (0, 0), blur_px * _RAYS), dtype=np.float32)
        part = one.reshape(_PITCH, _RAYS, _PITCH, _RAYS).mean(axis=(1, 3))
        light[top : top + _PITCH, left : left + _PITCH] = part
    image = 150 + slope_dn * np.arange(size) - 100 * light + noise_dn * rng.standard_normal(light.shape)
    shapes = np.tile(np.diag(axes**2), (count**2, 1, 1))
    return np.clip(np.rint(image), 0, 255).astype(np.uint8), centers, shapes


def test_errors_are_as_stated_whatever_the_blur() -> None:
    """Radii of 1.6 to 4 px, blurs of 0 to 0.8 px, starts 0.1 px off: chi-square of 128 numbers each, 1500 in all."""
    ratios = []
    for radius in (1.6, 2.0, 3.0, 4.0):
        for blur in (0.0, 0.5, 0.8):
            rng = np.random.default_rng([int(10 * radius), int(10 * blur)])
            image, truth, shapes = _drawn(radius, blur, 2.0, rng)
            start = truth + 0.1 * rng.standard_normal(truth.shape)
            found = light_centers(image, start, shapes, np.full(len(truth), _PITCH / 2))
            assert found.settled.all()
            ratio = (found.centers_px - truth) / np.sqrt(np.einsum("nii->ni", found.covariance_px2))
            ratios.append(float(np.mean(ratio**2)))
    assert 0.8 < np.mean(ratios) < 1.25
    assert max(ratios) < 1.6


def test_shading_does_not_shift_them() -> None:
    """A ground that rises by 0.2 DN a pixel would pull the centre by a hundredth of a pixel."""
    image, truth, shapes = _drawn(3.0, 0.5, 0.3, np.random.default_rng(5), slope_dn=0.2)
    found = light_centers(image, truth, shapes, np.full(len(truth), _PITCH / 2))
    assert np.abs((found.centers_px - truth)[found.settled].mean(axis=0)).max() < 1e-3


def test_what_lies_beside_a_dot_leaves_it_without_a_centre() -> None:
    image, truth, shapes = _drawn(2.0, 0.5, 1.0, np.random.default_rng(6))
    row = 19
    image[int(truth[row, 1]) + 5, :] = 20
    found = light_centers(image, truth, shapes, np.full(len(truth), _PITCH / 2))
    near = np.abs(truth[:, 1] - truth[row, 1] - 5) < 2
    assert not found.settled[near].any()
    far = np.abs(truth[:, 1] - truth[row, 1] - 5) > 12
    assert found.settled[far].all()


@pytest.mark.parametrize(("free_px", "enough"), [(3.0, False), (8.0, True)])
def test_dots_without_free_ground_are_known(free_px: float, enough: bool) -> None:
    shapes = np.diag([4.0, 4.0])[None]
    assert bool(has_free_ground(shapes, np.array([free_px]))[0]) is enough
