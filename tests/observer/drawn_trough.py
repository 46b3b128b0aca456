"""Slope maps of troughs with known errors, for tests of what they collect."""

import numpy as np

from heliogauge.slopes.map import SlopeMap, no_common_modes
from observer.trough.collector import Collector

#: The trough of the SolTrace reference: f = 1.71 m, aperture 5.774 m, tube 70 mm.
SOLTRACE = Collector(5.774, 4.0, 1.71, 0.070)


def slope_map(
    error_rad: np.ndarray, collector: Collector = SOLTRACE, *, sigma: float = 0.0, along: float | np.ndarray = 0.0
) -> SlopeMap:
    """Return a map with theta_r, shape (ny, nx), everywhere measured."""
    ny, nx = error_rad.shape
    x = ((np.arange(nx) + 0.5) / nx - 0.5) * collector.aperture_width_m
    y = ((np.arange(ny) + 0.5) / ny - 0.5) * collector.length_m
    zero = np.zeros((ny, nx))
    design = zero + x / (2 * collector.focal_length_m)
    return SlopeMap(
        x_m=x,
        y_m=y,
        slope_x=np.tan(np.arctan(design) - error_rad),
        slope_y=zero + along,
        design_slope_x=design,
        design_slope_y=zero,
        sigma_random_x=zero + sigma,
        sigma_random_y=zero,
        noise_correlation=1.0,
        common=no_common_modes(),
        height_m=zero + np.nan,
        flags=zero,
        aperture=zero == 0,
        design="trough",
        frame="trough",
        removed="nothing",
    )


def gaussian_errors(sigma_rad: float, shape: tuple[int, int], seed: int = 0) -> np.ndarray:
    """Return errors that are exactly Gaussian in each column: its quantiles in random order."""
    from scipy.special import ndtri

    quantiles = sigma_rad * ndtri((np.arange(shape[0]) + 0.5) / shape[0])
    return np.random.default_rng(seed).permuted(np.tile(quantiles[:, None], (1, shape[1])), axis=0)
