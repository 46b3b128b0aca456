"""Light of a beam as wide as its target: what the background may have taken for daylight.

The sun's aureole under haze, dirt on the mirror and the camera's own halo surround a beam with light that falls with a
power of the distance and still has some per cent of the peak at the target's edge. A background that is estimated
around the beam takes it for its own. Its shape differs from the background's functions, so a fit tells how much there
is at least; how much more, the photo does not tell.
"""

from dataclasses import dataclass

import numpy as np

from calibration.beam.light.background import Background, projected, taken_by_background
from calibration.beam.light.beam_centroids import block_sums
from heliogauge.validate import BoolArray, FloatArray

__all__ = ["Aureole", "find_aureole"]

#: Power with which an aureole falls: radiance of Buie's sun falls with 1.9 to 2.6 for circumsolar ratios of 0.02 to
#: 0.25 (-gamma), the halo of a lens with up to 3: between the two.
_POWER = 2.75


@dataclass(frozen=True, slots=True, eq=False)
class Aureole:
    """An aureole on the grid of the beam's region.

    light_dn (h, w): It [DN].
    taken_dn (h, w): What the background has taken of it [DN].
    sigmas: Its height over the height's uncertainty.
    """

    light_dn: FloatArray
    taken_dn: FloatArray
    sigmas: float


def find_aureole(background: Background, free: BoolArray, light_dn: FloatArray, skirts_dn: FloatArray) -> Aureole:
    """Fit an aureole to what a background leaves around a beam.

    background: Of the target.
    free (h, w): Pixels without a beam.
    light_dn (h, w): The beam inside its outline, 0 elsewhere [DN].
    skirts_dn (h, w): The beam beyond it, as its bell continues it [DN].
    Returns: The aureole; its height may be negative, where there is none.
    """
    rows, columns = free.shape
    total = float(light_dn.sum())
    across, up = light_dn.sum(axis=0) / total, light_dn.sum(axis=1) / total
    x, y = np.arange(columns, dtype=np.float64), np.arange(rows, dtype=np.float64)
    x, y = x - float(across @ x), y - float(up @ y)
    square = max(float(across @ x**2) + float(up @ y**2), 1.0)
    shape = ((x[None, :] ** 2 + y[:, None] ** 2) / square + 1) ** (-0.5 * _POWER)

    fits = [_height(background, background.basis, free, shape, skirts_dn)]
    if background.bending.any():
        # Daylight that bends and an aureole look alike; only a frame without a beam tells them apart for sure.
        fits.append(_height(background, background.basis[..., ~background.bending], free, shape, skirts_dn))
    height, sigma = max(fits, key=lambda one: one[0] - 2 * one[1])
    taken = taken_by_background(height * shape, free, background)
    return Aureole(height * shape, taken, height / max(sigma, 1e-300))


def _height(
    background: Background, basis: FloatArray, free: BoolArray, shape: FloatArray, skirts_dn: FloatArray
) -> tuple[float, float]:
    """Fit the height of an aureole beside functions of the background; return it and its sigma [DN]."""

    def left(light: FloatArray) -> FloatArray:
        return np.where(free, light - projected(light, free, basis), 0.0)

    seen = left(shape)
    strength = float(np.sum(seen * seen))
    residuals = left(background.smooth_dn + background.residuals_dn - skirts_dn)
    height = float(np.sum(seen * residuals)) / strength
    scores = block_sums(seen * (residuals - height * seen))
    return height, max(float(np.sqrt(np.sum(one**2))) for one in scores) / strength
