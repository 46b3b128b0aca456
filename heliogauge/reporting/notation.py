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
