"""Noise of one camera reading."""

import math
from dataclasses import dataclass

import numpy as np

from heliogauge.errors import InputError
from heliogauge.validate import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class NoiseModel:
    """Noise of one camera reading: ``variance = sigma_read_dn**2 + gain_dn * signal_dn``.

    sigma_read_dn: Share that does not depend on the signal; includes rounding to whole numbers (0.29 DN) [DN].
    gain_dn: Photon share, digital numbers per electron [DN].
    InputError: Negative, not finite, or both zero.
    """

    sigma_read_dn: float
    gain_dn: float = 0.0

    def __post_init__(self) -> None:
        values = (self.sigma_read_dn, self.gain_dn)
        if not all(math.isfinite(value) and value >= 0 for value in values) or not any(values):
            raise InputError(f"pixel noise: numbers >= 0, not both 0, are needed, not {values} DN")

    def variance(self, signal_dn: FloatArray) -> FloatArray:
        """Return the variance of readings [DN^2]; negative readings count as dark."""
        return np.asarray(self.sigma_read_dn**2 + self.gain_dn * np.maximum(signal_dn, 0.0))
