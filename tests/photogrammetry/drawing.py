"""Targets drawn by exact area: what a pixel sees is how much of it the disc covers, not a sample at its middle."""

import numpy as np
from scipy.ndimage import gaussian_filter

from heliogauge.validate import FloatArray

#: Scan lines per (fine) pixel; Gauss-Legendre, so the error of the area falls with the power 16.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


def ellipse_coverage(shape: tuple[int, int], center: FloatArray, form: FloatArray, *, fine: int = 1) -> FloatArray:
    """Share of each (fine) pixel inside (x - c)' form^-1 (x - c) = 1; exact along x, quadrature along y."""
    height, width = shape[0] * fine, shape[1] * fine
    conic = np.linalg.inv(form)
    left = np.arange(width) / fine - 0.5
    coverage = np.zeros((height, width))
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        y = (np.arange(height) + 0.5 + 0.5 * node) / fine - 0.5 - center[1]
        # conic00 x^2 + 2 conic01 x y + conic11 y^2 = 1
        discriminant = conic[0, 1] ** 2 * y**2 - conic[0, 0] * (conic[1, 1] * y**2 - 1)
        half = np.sqrt(np.maximum(discriminant, 0.0)) / conic[0, 0]
        middle = center[0] - conic[0, 1] / conic[0, 0] * y
        low = np.maximum(left[None, :], (middle - half)[:, None])
        high = np.minimum(left[None, :] + 1 / fine, (middle + half)[:, None])
        coverage += 0.5 * weight * np.maximum(high - low, 0.0) * fine
    return coverage


def blurred_coverage(shape: tuple[int, int], center: FloatArray, form: FloatArray, blur_px: float) -> FloatArray:
    """Coverage after a Gaussian blur, then integrated over the pixels."""
    if blur_px == 0:
        return ellipse_coverage(shape, center, form)
    fine = 5
    drawn = ellipse_coverage(shape, center, form, fine=fine)
    # The fine pixels' own width counts towards the blur.
    sigma = np.sqrt(blur_px**2 * fine**2 - 1 / 12)
    drawn = gaussian_filter(drawn, sigma, truncate=6, mode="nearest")
    return drawn.reshape(shape[0], fine, shape[1], fine).mean(axis=(1, 3))


def tilted(diameter_px: float, *, tilt_rad: float = 0.0, turn_rad: float = 0.0) -> FloatArray:
    """Form matrix of a circle seen under a tilt."""
    cosine, sine = np.cos(turn_rad), np.sin(turn_rad)
    axes = np.array([[cosine, -sine], [sine, cosine]]) * (0.5 * diameter_px * np.array([1.0, np.cos(tilt_rad)]))
    return axes @ axes.T


def target_window(
    form: FloatArray,
    center: FloatArray,
    *,
    size: int,
    blur_px: float = 0.5,
    inside: float = 40.0,
    outside: float = 200.0,
) -> FloatArray:
    """A disc on plain ground, noise free [DN]; the centre relative to the window's middle pixel."""
    middle = np.array([size // 2, size // 2], dtype=np.float64)
    coverage = blurred_coverage((size, size), middle + center, form, blur_px)
    return outside + (inside - outside) * coverage
