"""How well the size of waviness is known: what a blur takes away from it, and what a wrong scale adds."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from deflectometry.pose.pose_observations import UncertainPose
from deflectometry.shape.common_modes import moved_inputs
from deflectometry.shape.facet_pixels import PixelSamples
from deflectometry.shape.fine_structure import fine_responses, fine_share, with_waviness_out_of_place
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


def wavy_slopes(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Waves of 0.13 and 0.25 m on a smooth shape, shape (2, ...)."""
    fine = [2e-4 * np.sin(2 * np.pi * (x * np.cos(0.6) + y * np.sin(0.6)) / 0.13) * part for part in (0.83, 0.56)]
    return np.stack([fine[0] + 1e-3 * x, fine[1] + 1e-4 * np.sin(2 * np.pi * y / 0.25)])


def test_waviness_that_stands_aside_is_in_the_sigma_of_samples() -> None:
    """Slopes measured where the mirror is not: errors over sigma jointly, with shifts of half a millimetre and more."""
    lattice = np.stack(np.meshgrid(*[np.arange(-0.48, 0.48, 0.024)] * 2))
    turn = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    x, y = np.einsum("ij,jkl->ikl", turn, lattice)
    noise, place = 2e-6, np.array([[6e-4, 0.0], [2e-4, 3e-4]])
    surface, with_it, without = start_surface(FACET), [], []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        off = place @ rng.normal(size=2)
        truth = wavy_slopes(x, y)
        slopes = wavy_slopes(x + off[0], y + off[1]) + noise * rng.normal(size=truth.shape)
        sigma = np.full(x.shape, noise, dtype=np.float32)
        image = SlopeImage(0, 0, x, y, *slopes, sigma, sigma, np.zeros(x.shape, dtype=np.uint32))
        told = with_waviness_out_of_place(image, surface, place @ place.T)
        error = slopes - truth
        error -= error.mean(axis=(1, 2), keepdims=True)
        with_it.append(np.mean((error / np.stack([told.sigma_x, told.sigma_y])) ** 2))
        without.append(np.mean((error / noise) ** 2))
    assert 0.8 < np.sqrt(np.mean(with_it)) < 1.25
    assert np.sqrt(np.mean(without)) > 1.5


def test_noise_alone_is_no_waviness() -> None:
    image = waves(0.0, 1e-4)
    rng = np.random.default_rng(1)
    slopes = 1e-4 * rng.standard_normal((2, *image.x_m.shape))
    even = replace(image, slope_x=slopes[0], slope_y=slopes[1])
    told = with_waviness_out_of_place(even, start_surface(FACET), (5e-4) ** 2 * np.eye(2))
    # A pixel is 6 mm: noise taken for waves would add a seventh in squares.
    assert float(np.median(told.sigma_x)) < 1.01e-4
