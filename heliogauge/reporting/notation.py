"""Numbers as people read them: to the digits that the standard deviation allows."""

import math

from heliogauge.results.folder import unit_of


def number_text(value: float, sigma: float | None, unit: str, name: str = "") -> str:
    """Print a number with its standard deviation, both to the digits that the latter allows.

    unit: Its unit; rad is printed in mrad, lengths below 0.1 m in mm.
    name: A name ending with ``_share`` is printed in per cent.

    >>> number_text(1.23456e-3, 1.2e-6, "rad")
    '1.2346 ± 0.0012 mrad'
    >>> number_text(0.98765, None, "", "measured_share")
    '98.77 %'
    >>> number_text(-1e-9, 1e-4, "rad")
    '0.00 ± 0.10 mrad'
    """
    if name.endswith("_share"):
        return f"{100 * value:.2f} %"
    if unit == "rad" or (unit == "m" and abs(value) < 0.1):
        value, unit = 1e3 * value, "m" + unit
        sigma = None if sigma is None else 1e3 * sigma
    if isinstance(value, int):
        return f"{value} {unit}".strip()
    if sigma is None or not math.isfinite(sigma) or sigma <= 0:
        return f"{value:.4g} {unit}".strip()
    digits = max(0, 1 - math.floor(math.log10(sigma)))
    return f"{value:z.{digits}f} \u00b1 {sigma:.{digits}f} {unit}".strip()


def quantity_text(key: str, value: float, sigma: float | None) -> str:
    """Print a number whose key ends with its unit (`heliogauge.results.folder.UNITS`); shares in per cent with sigma.

    >>> quantity_text("intercept_share", 0.96854, 0.00048)
    '96.854 ± 0.048 %'
    >>> quantity_text("beam_rms_rad", 8.1e-4, 2e-5)
    '0.810 ± 0.020 mrad'
    """
    name, unit = unit_of(key)
    if name.endswith("_share"):
        return number_text(100 * value, None if sigma is None else 100 * sigma, "%")
    return number_text(value, sigma, unit, name)


def light_text(gain_ratio: float, sigma_ratio: float | None) -> str:
    """Print a share of the light.

    >>> light_text(2.12e-5, 4.8e-6)
    '0.00212 ± 0.00048 % of the light'
    """
    return number_text(100 * gain_ratio, None if sigma_ratio is None else 100 * sigma_ratio, "% of the light")


def turn_text(turn_rad: float, sigma_rad: float) -> str:
    """Print how far the normal of a panel is to be turned, and which way.

    >>> turn_text(-1.651e-3, 8.8e-5)
    '1.651 ± 0.088 mrad towards -x'
    """
    return f"{number_text(abs(turn_rad), sigma_rad, 'rad', 'turn_rad')} towards {'-' if turn_rad < 0 else '+'}x"


def height_text(offset_m: float, sigma_m: float | None) -> str:
    """Print how far the axis lies off the focal line along the optical axis.

    >>> height_text(-3.96e-3, 4.3e-4)
    '3.96 ± 0.43 mm below the focal line (towards the mirror)'
    """
    side = "below the focal line (towards the mirror)" if offset_m < 0 else "above the focal line (off the mirror)"
    return f"{number_text(abs(offset_m), sigma_m, 'm')} {side}"
