"""Phase from a single image of close fringes: the Fourier method of Takeda, with its two limits."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.validate import BoolArray, FloatArray, float_array, freeze


@dataclass(frozen=True, slots=True, eq=False)
class FourierPhase:
    """Phase from a single image with a carrier.

    phase_rad (h, w): Whole phase, carrier included, in (-pi, pi] [rad].
    sigma_rad (h, w): Standard deviation from white pixel noise [rad]; neighbours within the filter's width are
        correlated.
    modulation_dn (h, w): Amplitude of the fringes [DN].
    trusted (h, w): False within one filter length of the two borders that the fringes run across.
    """

    phase_rad: FloatArray
    sigma_rad: FloatArray
    modulation_dn: FloatArray
    trusted: BoolArray


def fourier_phase(
    image_dn: npt.ArrayLike, carrier_per_px: float, *, sigma_dn: float, along_x: bool = True, half_width: float = 0.5
) -> FourierPhase:
    """Find the phase of one image of close fringes by the Fourier method.

    image_dn (h, w): One image, ``a + b cos(2 pi f0 x + phi)`` with x across the columns [DN].
    carrier_per_px: Carrier f0, 0.02 to 0.4 [periods per pixel].
    sigma_dn: Noise of a reading [DN].
    along_x: Whether the fringes vary along the columns' index; along the rows' index otherwise.
    half_width: Half width of the pass band as a share of the carrier, up to 1.
    Returns: Phase, sigma, modulation and where they may be used.
    InputError: Not an image of finite numbers, or carrier and band impossible.

    Spec 003 C-31, Takeda: spectrum along the carrier, Hann-shaped band around f0, inverse transform, argument. Two
    limits. Band: the local frequency ``f0 + dphi/dx / 2 pi`` must stay within ``f0 (1 +- half_width)`` and the
    background's variation below it, else phase is lost without a sign of it. Border: the image is not periodic, so
    one filter length ``1 / (half_width f0)`` from each border is disturbed (`trusted` is False there), and each
    fringe defect smears as far. A band that keeps the share W of the noise power gives ``sigma_phi = sqrt(2 W) sigma
    / b``, the bound of a fit to 1 / W pixels.
    """
    image = float_array("image_dn", image_dn, (None, None))
    if not (0.02 <= carrier_per_px <= 0.4 and 0 < half_width <= 1 and carrier_per_px * (1 + half_width) < 0.5):
        raise InputError(
            f"fourier_phase: carrier {carrier_per_px} per px with half width {half_width} is impossible; "
            "0.02 <= carrier <= 0.4 and carrier * (1 + half_width) < 0.5 are needed"
        )
    lines = image if along_x else image.T
    length = lines.shape[1]
    frequency = np.fft.fftfreq(length)
    distance = np.abs(frequency - carrier_per_px) / (half_width * carrier_per_px)
    band = np.where(distance < 1, 0.5 + 0.5 * np.cos(np.pi * np.minimum(distance, 1.0)), 0.0)
    analytic = np.fft.ifft(np.fft.fft(lines - lines.mean(axis=1, keepdims=True), axis=1) * band, axis=1)
    modulation = 2 * np.abs(analytic)
    with np.errstate(divide="ignore"):
        sigma = np.sqrt(2 * np.mean(band**2)) * sigma_dn / modulation
    border = math.ceil(1 / (half_width * carrier_per_px))
    column = np.arange(length)
    trusted = np.broadcast_to((column >= border) & (column < length - border), lines.shape)
    parts = (np.angle(analytic), sigma, modulation)
    phase, sigma, modulation = (freeze(part if along_x else part.T) for part in parts)
    return FourierPhase(phase, sigma, modulation, np.ascontiguousarray(trusted if along_x else trusted.T))
