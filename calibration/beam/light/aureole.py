"""Light of a beam as wide as its target: what the background may have taken for daylight.

The sun's aureole under haze, dirt on the mirror and the camera's own halo surround a beam with light that falls with a
power of the distance and still has some per cent of the peak at the target's edge. A background that is estimated
around the beam takes it for its own. Its shape differs from the background's functions, so a fit tells whether there is
one; how much it is, a photo without a frame of the empty target does not tell, for daylight bends across a target, too.
In 137 real photos under a clear sky it bends as much as an aureole of 0.2 to 1.3 times the beam's peak would, whether
the beam is bright or faint: what bends alone is therefore no sign of an aureole.
"""

from dataclasses import dataclass

import numpy as np

from calibration.beam.light.background import Background, projection, taken_by_background
from calibration.beam.light.beam_centroids import block_sums
from heliogauge.validate import BoolArray, FloatArray

__all__ = ["Aureole", "find_aureole"]

#: Height over its uncertainty from which on an aureole is seen: by chance in 2 % of photos without one.
_SEEN = 2.0
#: Power with which an aureole falls: radiance of Buie's sun falls with 1.9 to 2.6 for circumsolar ratios of 0.02 to
#: 0.25 (-gamma), the halo of a lens with up to 3: between the two.
_POWER = 2.75


@dataclass(frozen=True, slots=True, eq=False)
class Aureole:
    """An aureole on the grid of the beam's region.

    light_dn (h, w): It, as high as the photo leaves open [DN].
    taken_dn (h, w): What the background has taken of it [DN].
    is_seen: Whether the photo shows it beyond daylight that bends.
    """

    light_dn: FloatArray
    taken_dn: FloatArray
    is_seen: bool


def find_aureole(background: Background, free: BoolArray, light_dn: FloatArray, skirts_dn: FloatArray) -> Aureole:
    """Fit an aureole to what a background leaves around a beam.

    background: Of the target.
    free (h, w): Pixels without a beam.
    light_dn (h, w): The beam inside its outline, 0 elsewhere [DN].
    skirts_dn (h, w): The beam beyond it, as its bell continues it [DN].
    Returns: Where it is seen, the aureole that there is if all that bends is its; else one as high as its uncertainty.
    """
    shape = aureole_shape(light_dn)
    height, sigma = _height(background, background.basis, free, shape, skirts_dn)
    is_seen = height > _SEEN * sigma
    if is_seen and background.bending.any():
        # Daylight that bends and an aureole look alike; only a frame without a beam tells them apart for sure.
        height = max(height, _height(background, background.basis[..., ~background.bending], free, shape, skirts_dn)[0])
    open_dn = height if is_seen else float(np.hypot(max(height, 0.0), sigma))
    taken = taken_by_background(free, background)(open_dn * shape)
    return Aureole(open_dn * shape, taken, is_seen)


def aureole_shape(light_dn: FloatArray) -> FloatArray:
    """Return an aureole of height 1 around a beam, (h, w): flat within its size, with a power of the distance beyond.

    light_dn (h, w): The beam [DN]. Its size is the root of its variances along both axes together.
    """
    rows, columns = light_dn.shape
    total = float(light_dn.sum())
    across, up = light_dn.sum(axis=0) / total, light_dn.sum(axis=1) / total
    x, y = np.arange(columns, dtype=np.float64), np.arange(rows, dtype=np.float64)
    x, y = x - float(across @ x), y - float(up @ y)
    square = max(float(across @ x**2) + float(up @ y**2), 1.0)
    return np.asarray(((x[None, :] ** 2 + y[:, None] ** 2) / square + 1) ** (-0.5 * _POWER))


def _height(
    background: Background, basis: FloatArray, free: BoolArray, shape: FloatArray, skirts_dn: FloatArray
) -> tuple[float, float]:
    """Fit the height of an aureole beside functions of the background; return it and its sigma [DN]."""
    project = projection(free, basis)

    def left(light: FloatArray) -> FloatArray:
        return (light - project(light)) * free

    seen = left(shape)
    strength = float(np.vdot(seen, seen))
    residuals = left(background.smooth_dn + background.residuals_dn - skirts_dn)
    height = float(np.sum(seen * residuals)) / strength
    scores = block_sums(seen * (residuals - height * seen))
    return height, max(float(np.sqrt(np.sum(one**2))) for one in scores) / strength
