"""How well the size of waviness is known: what a blur takes away from it, and what a wrong scale adds."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from deflectometry.pose.pose_observations import UncertainPose
from deflectometry.shape.common_modes import moved_inputs
from deflectometry.shape.facet_pixels import PixelSamples
from deflectometry.shape.fine_structure import fine_responses, fine_share
from deflectometry.shape.pixel_slopes import SlopeImage
from deflectometry.shape.smooth_shape import ShapeSolution, start_surface
from heliogauge.geometry.surfaces import Facet, plane

FACET = Facet("f", np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]), plane())


def waves(blur_px: float, noise: float = 0.0) -> SlopeImage:
    """Waves of 16 px in x and 40 px in y, photographed with a blur."""
    y, x = np.mgrid[:160, :160] * (1.0 / 160) - 0.5
    rng = np.random.default_rng(2)
    slopes = [
        gaussian_filter(1e-4 * np.sin(2 * np.pi * one / length), blur_px, mode="wrap")
        + noise * rng.standard_normal(x.shape)
        for one, length in ((x, 0.1), (y, 0.25))
    ]
    sigma = np.full(x.shape, max(noise, 1e-9), dtype=np.float32)
    return SlopeImage(0, 0, x, y, *slopes, sigma, sigma, np.zeros(x.shape, dtype=np.uint32))


def share(laboratory, cam_from_mirror, image: SlopeImage, width_px: float) -> np.ndarray:
    screen = np.linspace(0.45, 0.55, 40)
    pixels = np.stack([np.linspace(180, 220, 40), np.linspace(130, 170, 40)], axis=1)
    surface = start_surface(FACET)
    solution = ShapeSolution(cam_from_mirror, (surface,), np.zeros((1, 2)), 1)
    pose = UncertainPose(cam_from_mirror, np.zeros((6, 6)))
    sample = PixelSamples(FACET, pixels, screen, screen)
    inputs = tuple(moved_inputs(laboratory, cam_from_mirror, pose))
    return fine_share(fine_responses(laboratory, sample, solution, inputs, surface), image, width_px)


@pytest.mark.parametrize("noise", [0.0, 2e-5])
def test_what_blur_takes_away_is_found_from_the_width_of_the_edges(laboratory, cam_from_mirror, noise: float) -> None:
    exact = replace(laboratory, covariance_cam_from_screen=np.zeros((6, 6)))
    blur_px = 1.5
    width_px = np.sqrt(2 * np.pi * blur_px**2 + 1.6**2)
    found = share(exact, cam_from_mirror, waves(blur_px, noise), width_px)
    # A Gaussian leaves exp(-(2 pi s / length)^2 / 2) of a wave.
    expected = [1 - np.exp(-0.5 * (2 * np.pi * blur_px / length) ** 2) for length in (16, 40)]
    # The noise of 25,600 pixels gives a power of 1 to 0.4 %; edges of the image are less blurred.
    np.testing.assert_allclose(found, expected, rtol=0.06, atol=2e-3)
    assert share(exact, cam_from_mirror, waves(0.0), 1.6).max() == 0.0


def test_a_width_off_stretches_waviness_by_as_much(laboratory, cam_from_mirror) -> None:
    exact = replace(laboratory, covariance_cam_from_screen=np.zeros((6, 6)))
    wide = replace(exact, sigma_size_m=np.array([0.09, 0.0]))
    found = share(wide, cam_from_mirror, waves(0.0), float("nan"))
    # 0.09 m of 9 m, and nothing for the height; the screen is turned against the mirror by hundredths.
    np.testing.assert_allclose(found, [0.01, 0.0], rtol=0.02, atol=5e-5)
