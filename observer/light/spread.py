"""The same intercept factor by the two ways of the textbook: one beam spread for the whole aperture, Gaussians only.

Both leave out that errors and acceptance belong to the same mirror point; the difference to
`observer.light.intercept` is what that costs.
"""

from dataclasses import dataclass

import numpy as np

from heliogauge.validate import FloatArray
from observer.light.beam import BeamProfile, beam_profile
from observer.light.intercept import TroughOptics
from observer.trough.collector import Collector

#: Bins of the error distribution: 0.02 mrad for errors of up to 40 mrad.
_BINS = 4096
#: Points of the integral over half the aperture; Gauss's rule is exact to 1e-12 from 24 on.
_POINTS = 40


@dataclass(frozen=True, slots=True, eq=False)
class BeamSpread:
    """Light about the direction to the absorber, pooled over the aperture, and what the tube accepts of it.

    angle_rad (n,): Angles across the trough [rad].
    error_density (n,): Distribution of the mirror's and absorber's error of the beam, twice theta_ra [1/rad].
    beam_density (n,): The same with sun shape, specularity and tracking error [1/rad].
    acceptance (n,): Share of the aperture whose light meets the tube under each angle.
    """

    angle_rad: FloatArray
    error_density: FloatArray
    beam_density: FloatArray
    acceptance: FloatArray

    @property
    def ratio(self) -> float:
        """Intercept factor: the integral of beam density times acceptance (Owkes 2012, eqs 5.13 to 5.15)."""
        return float(self.beam_density @ self.acceptance * (self.angle_rad[1] - self.angle_rad[0]))


def beam_spread(optics: TroughOptics) -> BeamSpread:
    """Pool the errors of the whole aperture.

    optics: Mirror, tube and light.
    """
    windows, light, profile = optics.windows, optics.light(0.0), optics.profile
    error = 0.5 * (windows.upper_rad + windows.lower_rad)
    half = 0.5 * (windows.upper_rad - windows.lower_rad)
    reach = max(float(np.abs(error).max() + profile.angle_rad[-1]), float(half.max())) * (1 + 2 / _BINS)
    edges = np.linspace(-reach, reach, _BINS + 1)
    angle, step = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0]
    share = np.histogram(error, edges, weights=light)[0]
    # The light between the edges of bins k steps away; an odd number of bins keeps the convolution centred.
    away = np.arange(-_BINS, _BINS + 1) * step
    kernel = profile.below(away + step / 2) - profile.below(away - step / 2)
    beam = np.convolve(share, kernel, mode="full")[_BINS : 2 * _BINS]
    order = np.argsort(half)
    below = np.concatenate([[0.0], np.cumsum(light[order])])
    acceptance = 1.0 - below[np.searchsorted(half[order], np.abs(angle))]
    return BeamSpread(angle, share / step, beam / step, acceptance)


def gaussian_short_form(
    collector: Collector,
    sun: BeamProfile,
    *,
    sigma_r_rad: float,
    sigma_a_rad: float = 0.0,
    specularity_rad: float = 0.0,
    tracking_error_rad: float = 0.0,
) -> float:
    """Return the intercept factor of a design with Gaussian errors.

    sun: The sun, from `observer.light.beam.sun_profile`.
    sigma_r_rad: Slope error of the mirror's normal across, RMS [rad].
    sigma_a_rad: Absorber displacement as a slope error (theta_a), RMS [rad].
    specularity_rad, tracking_error_rad: Of the beam, 1 sigma [rad].

    ``sigma_tot^2 = 4 sigma_r^2 + 4 sigma_a^2 + sigma_spec^2 + sigma_track^2`` (Owkes 2012, eq. 5.16) widens the sun;
    at each distance from the vertex the share within the acceptance ``asin(a / R)`` (5.4) counts, and the mean over
    the aperture is taken.
    """
    total = float(np.sqrt(4 * sigma_r_rad**2 + 4 * sigma_a_rad**2 + specularity_rad**2 + tracking_error_rad**2))
    profile = beam_profile(sun, specularity_rad=total)
    node, weight = np.polynomial.legendre.leggauss(_POINTS)
    x = 0.25 * collector.aperture_width_m * (node + 1.0)
    # A parabola's distance from its focus: f + x^2 / (4 f).
    reach = collector.focal_length_m + x**2 / (4 * collector.focal_length_m)
    half = np.arcsin(collector.absorber_diameter_m / 2 / reach)
    return float(0.5 * weight @ (profile.below(half) - profile.below(-half)))
