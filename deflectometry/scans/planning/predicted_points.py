"""Points that a scanner will measure on a mirror of design shape with waves."""

import numpy as np

from deflectometry.scans.planning.keys import SurfacePlanSection
from heliogauge.geometry.surfaces import Quadric
from heliogauge.validate import FloatArray

#: Waves in so many directions make slopes of both directions alike to a tenth.
_WAVES = 60


def predicted_points(
    plan: SurfacePlanSection, design: Quadric, sigma_m: float, sigma_normal_rad: float, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Return points (n, 3) [m] and normals (n, 3) as a scanner measures them, in the mirror's frame.

    sigma_m: Noise of each coordinate [m].
    sigma_normal_rad: Noise of a normal's angle in one direction [rad].
    """
    rng = np.random.default_rng(seed)
    width, height = plan.width_m, plan.height_m
    x, y = (
        one.ravel()
        for one in np.meshgrid(
            plan.center_m[0] + width * ((np.arange(plan.columns) + 0.5) / plan.columns - 0.5),
            plan.center_m[1] + height * ((np.arange(plan.rows) + 0.5) / plan.rows - 0.5),
        )
    )
    z, slopes = design.height(x, y), np.stack(design.gradient(x, y))
    if plan.wave_mrad is not None and plan.wave_length_m is not None:
        wave_z, wave_slopes = _waves(np.stack([x, y]), 1e-3 * plan.wave_mrad, plan.wave_length_m, rng)
        z, slopes = z + wave_z, slopes + wave_slopes
    slopes = slopes + sigma_normal_rad * (1 + slopes**2) * rng.standard_normal(slopes.shape)
    normals = np.stack([-slopes[0], -slopes[1], np.ones_like(x)])
    points = np.stack([x, y, z]) + sigma_m * rng.standard_normal((3, x.size))
    return np.ascontiguousarray(points.T), np.ascontiguousarray((normals / np.linalg.norm(normals, axis=0)).T)


def _waves(
    places_m: FloatArray, slope_rad: float, length_m: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return heights (n,) [m] and slopes (2, n) of waves of one length in all directions.

    slope_rad: RMS of their slopes in one direction.
    """
    number = 2 * np.pi / length_m
    turn, phase = 2 * np.pi * rng.random((2, _WAVES))
    vectors = number * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    # Each wave of amplitude a has slopes of a k / sqrt(2) RMS along itself, half of the square in one direction.
    amplitude = 2 * slope_rad / (number * np.sqrt(_WAVES))
    angle = vectors @ places_m + phase[:, None]
    return amplitude * np.sin(angle).sum(axis=0), amplitude * np.einsum("kd,kn->dn", vectors, np.cos(angle))
