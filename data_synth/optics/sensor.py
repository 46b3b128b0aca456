"""From light on the pixels to digital numbers: exposure, noise, saturation, quantisation."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.validate import Float32Array, positive

UnsignedArray = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]


@dataclass(frozen=True, slots=True, eq=False)
class Sensor:
    """A sensor with a linear response.

    bits: Bit depth of the files, 8 or 16 (or less than 16, stored in 16).
    exposure: Share of the full range that light of 1 (a white display, fully reflected) fills; above 1 it
        saturates.
    offset_dn: Black level [DN].
    read_noise_dn: Noise that does not depend on the signal [DN].
    shot_gain_dn: Digital numbers per electron; variance ``shot_gain_dn * signal_dn`` is added. 0: no shot noise
        [DN].
    InputError: A bit depth that no file has, or a negative number.
    """

    bits: int = 8
    exposure: float = 0.95
    offset_dn: float = 4.0
    read_noise_dn: float = 1.0
    shot_gain_dn: float = 0.0

    def __post_init__(self) -> None:
        if not 8 <= self.bits <= 16:
            raise InputError(f"sensor bits: 8 to 16 are needed, not {self.bits}")
        positive("sensor exposure", self.exposure, "the full range")
        for name in ("offset_dn", "read_noise_dn", "shot_gain_dn"):
            if not getattr(self, name) >= 0:
                raise InputError(f"sensor {name}: 0 or more is needed, not {getattr(self, name)}")

    @property
    def saturation_dn(self) -> int:
        """Largest number a pixel can have [DN]."""
        return int(2**self.bits - 1)

    def expected_dn(self, light: Float32Array, exposure_factor: float = 1.0) -> Float32Array:
        """Return the digital numbers without noise, rounding and clipping.

        light: Light on the pixels, 1 for a fully reflected white display.
        exposure_factor: Relative exposure of this frame.
        """
        scale = np.float32(self.exposure * exposure_factor * self.saturation_dn)
        return np.asarray(light * scale + np.float32(self.offset_dn), dtype=np.float32)

    def expose(self, light: Float32Array, rng: np.random.Generator, exposure_factor: float = 1.0) -> UnsignedArray:
        """Take one frame.

        light (h, w): Light on the pixels, 1 for a fully reflected white display.
        Returns (h, w): The frame as a file holds it.

        Shot noise is taken as Gaussian: at 20 electrons, 0.2 % of full well, its skewness is already below 0.23.
        """
        dn = self.expected_dn(light, exposure_factor)
        noise = rng.standard_normal(dn.shape, dtype=np.float32)
        if self.shot_gain_dn:
            signal = np.maximum(dn - np.float32(self.offset_dn), 0)
            noise *= np.sqrt(np.float32(self.read_noise_dn**2) + np.float32(self.shot_gain_dn) * signal)
        else:
            noise *= np.float32(self.read_noise_dn)
        dn += noise
        np.rint(dn, out=dn)
        np.clip(dn, 0, self.saturation_dn, out=dn)
        return dn.astype(np.uint8) if self.bits == 8 else dn.astype(np.uint16)
