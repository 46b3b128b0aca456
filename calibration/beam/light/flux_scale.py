"""From brightness to flux: relative, or absolute by the power of the beam or by a calorimeter in the target."""

from dataclasses import dataclass

import numpy as np

from calibration.beam.light.beam_size import BeamSize, LightPicture
from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import FloatArray

__all__ = ["FluxScale", "Gauge", "absolute_by_gauge", "absolute_by_power", "relative_flux", "unknown_flux"]


@dataclass(frozen=True, slots=True, eq=False)
class Gauge:
    """What a calorimeter in the target reads.

    flux_w_m2, sigma_flux_w_m2: Mean flux density over its opening, and its standard deviation [W/m^2].
    center_m (2,): Its centre on the target [m].
    diameter_m: Diameter of its opening [m].
    """

    flux_w_m2: float
    sigma_flux_w_m2: float
    center_m: FloatArray
    diameter_m: float


@dataclass(frozen=True, slots=True, eq=False)
class FluxScale:
    """What turns the brightness of one photo into flux.

    per_dn: Flux per brightness [unit/DN].
    sigma_share: Standard deviation of the scale, as a share of it.
    background_dn, white_dn: Standard deviations of a pixel: of the background, which neighbours share; of noise [DN].
    unit: "W/m2", or "1" for flux relative to the peak.
    of_beam: Peak flux and its sigma [unit], power and its sigma [W]; of relative flux the light over the peak [m^2].
    words: How the scale was found.
    """

    per_dn: float
    sigma_share: float
    background_dn: float
    white_dn: float
    unit: str
    of_beam: tuple[float, float, float, float]
    words: str


def relative_flux(size: BeamSize) -> FluxScale:
    """Return flux as a share of the beam's peak.

    The integral over the target is then an area: that of an even beam as bright as the peak.
    """
    if not size.peak_dn > 0:
        return _without_beam("1")
    share = size.sigma_peak_dn / size.peak_dn
    total = size.total_dn_m2 / size.peak_dn
    sigma = total * float(np.hypot(share, size.sigma_total_dn_m2 / size.total_dn_m2))
    return FluxScale(
        1 / size.peak_dn,
        share,
        size.background_dn,
        size.white_dn,
        "1",
        (1.0, share, total, sigma),
        "relative to the peak of each beam",
    )


def absolute_by_power(size: BeamSize, power_w: float, sigma_power_w: float) -> FluxScale:
    """Return the flux of a beam whose power on the target is known."""
    if not size.total_dn_m2 > 0:
        return _without_beam("W/m2")
    per_dn = power_w / size.total_dn_m2
    share = float(np.hypot(sigma_power_w / power_w, size.sigma_total_dn_m2 / size.total_dn_m2))
    peak = per_dn * size.peak_dn
    sigma = peak * float(np.hypot(share, size.sigma_peak_dn / size.peak_dn))
    words = "absolute, by the power of each beam on the target"
    return FluxScale(
        per_dn, share, size.background_dn, size.white_dn, "W/m2", (peak, sigma, power_w, sigma_power_w), words
    )


def absolute_by_gauge(size: BeamSize, picture: LightPicture, gauge: Gauge) -> FluxScale:
    """Return the flux of a beam that a calorimeter has measured at one place.

    InputError: The calorimeter's opening is not on the target.
    EstimationError: The beam does not light it.

    The brightness over the opening is that of the target around it where the opening itself is dark: the median of the
    ring of twice its diameter, through a plane, stands for it.
    """
    if not size.total_dn_m2 > 0:
        return _without_beam("W/m2")
    dx, dy = picture.x_m[None, :] - gauge.center_m[0], picture.y_m[:, None] - gauge.center_m[1]
    distance = np.hypot(dx, dy) / gauge.diameter_m
    ring = (distance > 0.6) & (distance < 1.2)
    if np.count_nonzero(ring) < 12:
        raise InputError(
            f"gauge_center_m = {gauge.center_m.tolist()}: fewer than 12 pixels of the target lie around the "
            f"calorimeter; is "
            "it on the target?"
        )
    shape = picture.values_dn.shape
    x, y = np.broadcast_to(dx, shape)[ring], np.broadcast_to(dy, shape)[ring]
    rows = np.stack([np.ones(x.size), x, y, x * x + y * y], axis=1)
    found, *_ = np.linalg.lstsq(rows, picture.values_dn[ring], rcond=None)
    residual = picture.values_dn[ring] - rows @ found
    # Over the opening the mean of x^2 + y^2 is d^2/8.
    pull = np.array([1.0, 0.0, 0.0, gauge.diameter_m**2 / 8])
    level = float(found @ pull)
    scatter = float(np.sqrt(residual @ residual / (x.size - 4)))
    sigma_level = float(np.hypot(scatter * np.sqrt(pull @ np.linalg.pinv(rows.T @ rows) @ pull), size.background_dn))
    if not level > 3 * sigma_level:
        raise EstimationError(
            f"gauge_center_m = {gauge.center_m.tolist()}: the beam is {level:.1f} \u00b1 {sigma_level:.1f} DN "
            f"bright around the "
            "calorimeter; put the beam onto it, or give power_w"
        )
    per_dn = gauge.flux_w_m2 / level
    share = float(np.hypot(gauge.sigma_flux_w_m2 / gauge.flux_w_m2, sigma_level / level))
    peak, power = per_dn * size.peak_dn, per_dn * size.total_dn_m2
    sigma_peak = peak * float(np.hypot(share, size.sigma_peak_dn / size.peak_dn))
    sigma_power = power * float(np.hypot(share, size.sigma_total_dn_m2 / size.total_dn_m2))
    words = "absolute, by a calorimeter in the target"
    return FluxScale(
        per_dn, share, size.background_dn, size.white_dn, "W/m2", (peak, sigma_peak, power, sigma_power), words
    )


def unknown_flux() -> FluxScale:
    """Return what stands for the flux of a beam that does not light the calorimeter: NaN."""
    return _without_beam("W/m2")


def _without_beam(unit: str) -> FluxScale:
    nan = float("nan")
    return FluxScale(nan, nan, nan, nan, unit, (nan, nan, nan, nan), "no beam")
