"""The point of the screen that each sample of the image sees."""

from dataclasses import dataclass, field

import numpy as np

from deflectometry.sources.noise_model import NoiseModel
from deflectometry.sources.sample_grid import PixelGrid, SampleGrid
from heliogauge.validate import FlagArray, Float32Array, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ScreenMap:
    """The point of the screen that each sample sees; (h, w) are the rows and columns of the sample grid.

    u, v (h, w): Fractions of the displayed image from its left and from its top edge; NaN where flagged.
    sigma_u, sigma_v (h, w): Standard deviations from pixel noise and the systematic phase; NaN where flagged.
    modulation_dn (h, w): Mean amplitude of all sets [DN, or the response's unit].
    flags (h, w): Bits of `heliogauge.flags.SampleFlag`.
    noise: Noise of the readings that the sigmas rest on.
    systematic_phase_rad (2,): Phase error beyond noise of every x set and every y set, from how well the periods
        agree; mostly 0 [rad].
    grid: Where the samples lie in the image.
    cells (2,): Width of the cells of a code along u and v, within which it leaves a point open; 0 without one.
    """

    u: Float32Array
    v: Float32Array
    sigma_u: Float32Array
    sigma_v: Float32Array
    modulation_dn: Float32Array
    flags: FlagArray
    noise: NoiseModel
    systematic_phase_rad: FloatArray = field(default_factory=lambda: np.zeros(2))
    grid: SampleGrid = field(default_factory=PixelGrid)
    cells: FloatArray = field(default_factory=lambda: np.zeros(2))

    def points_seen(self) -> tuple[Float32Array, Float32Array]:
        """Return u and v of the pixels without a flag, each of shape (n,)."""
        good = self.flags == 0
        return self.u[good], self.v[good]
