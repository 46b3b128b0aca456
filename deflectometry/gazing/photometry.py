"""From frames to light: dark frames, flat fields, saturation, exposure."""

from dataclasses import dataclass

import numpy as np

from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import BoolArray, FloatArray

#: A flat field in which pixels have less than this share of its middle is a picture of something.
_LEAST_FLAT = 0.1
#: Light that is lower than this many standard deviations of the dark frames below them comes from other dark frames.
_BELOW_DARK = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Exposure:
    """Frames of one scene with one exposure, and what corrects them.

    images_dn (n, h, w): The frames [DN].
    dark_dn (h, w): Mean of dark frames of the same exposure [DN].
    flat (h, w): Relative response of the pixels; 1 everywhere where it is not known.
    exposure_ms: Exposure time [ms].
    saturation_dn: Level from which a pixel is saturated [DN].
    """

    images_dn: FloatArray
    dark_dn: FloatArray
    flat: FloatArray
    exposure_ms: float
    saturation_dn: float


@dataclass(frozen=True, slots=True, eq=False)
class Light:
    """Light of each pixel.

    per_ms (h, w): Dark-corrected, over the pixel's response and the exposure time [DN/ms].
    saturated (h, w): Pixels of which a frame was saturated.
    """

    per_ms: FloatArray
    saturated: BoolArray

    @property
    def unsaturated(self) -> FloatArray:
        """The light with NaN where saturated, shape (h, w) [DN/ms]."""
        return np.where(self.saturated, np.nan, self.per_ms)


def mean_dark(images_dn: FloatArray) -> FloatArray:
    """Return the median over dark frames, shape (h, w): a cosmic ray in one of them does not count [DN]."""
    return np.asarray(np.median(images_dn, axis=0), dtype=np.float64)


def flat_response(images_dn: FloatArray, dark_dn: FloatArray, what: str) -> FloatArray:
    """Return the relative response of pixels from frames of an even source, mean 1, shape (h, w).

    InputError: A flat field that is dark.
    """
    signal = np.median(images_dn, axis=0) - dark_dn
    middle = float(np.median(signal))
    if not middle > 0:
        raise InputError(f"{what}: the flat field is not brighter than its dark frames")
    share = float(np.mean(signal < _LEAST_FLAT * middle))
    if share > 0.01:
        raise InputError(
            f"{what}: {100 * share:.0f} % of the flat field has less than a tenth of its middle's light; is it one?"
        )
    return np.asarray(np.maximum(signal, _LEAST_FLAT * middle) / middle)


def light_of(exposure: Exposure, what: str) -> Light:
    """Correct frames by dark and flat.

    what: Where they come from, for messages.
    EstimationError: Frames darker than their dark frames.
    """
    mean = exposure.images_dn.mean(axis=0)
    signal = mean - exposure.dark_dn
    noise = 1.4826 * float(np.median(np.abs(signal - np.median(signal))))
    darkest = float(np.percentile(signal, 10))
    if darkest < -_BELOW_DARK * max(noise, 1.0):
        raise EstimationError(
            f"{what}: its dark parts are {-darkest:.3g} DN below the dark frames; take dark frames with the same "
            "exposure time, gain and temperature"
        )
    saturated = (exposure.images_dn >= exposure.saturation_dn).any(axis=0)
    return Light(signal / exposure.flat / exposure.exposure_ms, np.asarray(saturated))
