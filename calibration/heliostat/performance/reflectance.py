"""Solar-weighted reflectance from spectra (Stage-STE 12.6, 1.2.1.1), with what gaps in them leave open."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from calibration.heliostat.performance.solar_spectrum import IRRADIANCE, WAVELENGTH_NM
from heliogauge.errors import InputError
from heliogauge.validate import FloatArray, float_array, freeze

#: Wavelengths further apart than this are a gap: twice the widest step of the SolarPACES guideline's instruments
#: (10 nm),
#: so that a table with a line missing has one and a table in steps of 10 nm has none.
WIDEST_STEP_NM = 20.0
#: The weights reach from here to there.
FIRST_NM, LAST_NM = 280.0, 2500.0


@dataclass(frozen=True, slots=True, eq=False)
class SolarSpectrum:
    """Sunlight by wavelength.

    wavelength_nm (n,): Ascending [nm].
    irradiance (n,): In any unit per nm.
    name: Where it comes from.
    InputError: Wavelengths that do not ascend or are not in nm, irradiance below zero, or none.
    """

    wavelength_nm: FloatArray
    irradiance: FloatArray
    name: str

    def __post_init__(self) -> None:
        waves = float_array("wavelength_nm", self.wavelength_nm, (None,))
        power = float_array("irradiance", self.irradiance, (waves.size,))
        check_wavelengths(waves)
        if (power < 0).any() or not power.any():
            raise InputError("irradiance: values of zero and above are needed, not all zero")
        object.__setattr__(self, "wavelength_nm", waves)
        object.__setattr__(self, "irradiance", power)


def air_mass_1_5() -> SolarSpectrum:
    """Return direct and circumsolar sunlight at air mass 1.5 (ASTM G173-03)."""
    return SolarSpectrum(WAVELENGTH_NM, IRRADIANCE, "ASTM G173-03 direct and circumsolar, AM 1.5")


@dataclass(frozen=True, slots=True)
class Gap:
    """Wavelengths at which a spectrum says nothing.

    first_nm, last_nm: Its ends [nm].
    share: Share of the sun's energy in it.
    reach: Half the range of the reflectance that may lie in it.
    """

    first_nm: float
    last_nm: float
    share: float
    reach: float


@dataclass(frozen=True, slots=True, eq=False)
class SolarWeighted:
    """Solar-weighted reflectance.

    value: Mean of all samples.
    sigma: Standard deviation of it: scatter between samples, instrument, gaps.
    degrees: Degrees of freedom of the scatter, infinite where it does not enter.
    each (n,): Of each sample.
    sigma_gaps, sigma_scatter: Shares of sigma.
    gaps: What was not measured.
    """

    value: float
    sigma: float
    degrees: float
    each: FloatArray
    sigma_gaps: float
    sigma_scatter: float
    gaps: tuple[Gap, ...]


def check_wavelengths(wavelength_nm: FloatArray) -> None:
    """Check that wavelengths are ascending and in nm.

    InputError: They are not.
    """
    if wavelength_nm.size < 2:
        raise InputError("wavelength_nm: at least two wavelengths are needed")
    steps = np.diff(wavelength_nm)
    if (steps <= 0).any():
        at = int(np.argmax(steps <= 0))
        raise InputError(
            f"wavelength_nm: {wavelength_nm[at]:g} is followed by {wavelength_nm[at + 1]:g}: ascending ones are needed"
        )
    if wavelength_nm[0] < 100 or wavelength_nm[-1] > 1e5:
        raise InputError(
            f"wavelength_nm: {wavelength_nm[0]:g} to {wavelength_nm[-1]:g}: nanometres are needed (1 µm is 1000)"
        )


def weights(spectrum: SolarSpectrum) -> FloatArray:
    """Return the share of the sun's energy of each wavelength of `WAVELENGTH_NM`; their sum is 1.

    Shapes: result (445,).
    """
    waves, power = spectrum.wavelength_nm, spectrum.irradiance
    inside = (waves >= FIRST_NM) & (waves <= LAST_NM)
    if np.array_equal(waves, WAVELENGTH_NM):
        # Means over the very steps that are wanted.
        return np.asarray(power / power.sum())
    if inside.sum() < 2:
        raise InputError(f"spectrum of the sun: it says nothing between {FIRST_NM:g} and {LAST_NM:g} nm")
    # Mean over each step of 5 nm, exact for a table that is straight between its points.
    sums = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(waves))])
    edges = np.clip(np.append(WAVELENGTH_NM - 2.5, LAST_NM + 2.5), waves[0], waves[-1])
    # The cumulative integral is quadratic between points: interpolate it with them.
    shares = np.diff(_integral_at(edges, waves, power, sums))
    total = float(shares.sum())
    if not total > 0:
        raise InputError("spectrum of the sun: no energy between 280 and 2500 nm")
    return np.asarray(shares / total)


def _integral_at(at: FloatArray, waves: FloatArray, power: FloatArray, sums: FloatArray) -> FloatArray:
    index = np.clip(np.searchsorted(waves, at, side="right") - 1, 0, waves.size - 2)
    step = at - waves[index]
    slope = (power[index + 1] - power[index]) / (waves[index + 1] - waves[index])
    return np.asarray(sums[index] + step * (power[index] + 0.5 * slope * step))


def solar_weighted(
    wavelength_nm: npt.ArrayLike,
    reflectance: npt.ArrayLike,
    *,
    spectrum: SolarSpectrum | None = None,
    sigma_instrument: float | None = None,
) -> SolarWeighted:
    """Weight spectra of reflectance with the sun's (Stage-STE 12.6, 1.2.1.1: F and rho_sw).

    wavelength_nm (w,): Ascending [nm].
    reflectance (n, w): Of n samples or places; NaN where nothing was measured.
    spectrum: The sun; AM 1.5 if absent.
    sigma_instrument: Uncertainty that all readings share (reference mirror); None: not known.
    Returns: Mean with sigma, gaps.
    InputError: Wavelengths that do not ascend, reflectance outside -0.02 to 1.05 (in per cent?), or nothing measured.

    Within a gap the reflectance may be anything between the least and the largest value that was read on a stretch of
    the gap's own width at either side: an even distribution, sigma = range / sqrt(12). Gaps of one spectrum are
    independent of each other; of several samples, which share the mirror, they are not.
    """
    waves = float_array("wavelength_nm", wavelength_nm, (None,))
    check_wavelengths(waves)
    values = float_array("reflectance", reflectance, (None, waves.size), finite=False)
    if values.shape[0] == 0:
        raise InputError("reflectance: at least one spectrum is needed")
    known = np.isfinite(values)
    if not known.any(axis=1).all():
        raise InputError("reflectance: a spectrum without any reading")
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if low < -0.02 or high > 1.05:
        raise InputError(
            f"reflectance: {low:g} to {high:g}: shares from 0 to 1 are needed; name columns in per cent ..._percent"
        )
    shares = weights(air_mass_1_5() if spectrum is None else spectrum)
    each = np.array(
        [float(shares @ np.interp(WAVELENGTH_NM, waves[k], row[k])) for row, k in zip(values, known, strict=True)]
    )
    every = known.all(axis=0)
    gaps = find_gaps(waves[every], values[:, every].mean(axis=0), shares) if every.sum() > 1 else ()
    sigma_gaps = float(np.sqrt(sum((gap.share * gap.reach) ** 2 / 3 for gap in gaps)))
    count = each.size
    sigma_scatter = float(each.std(ddof=1)) / np.sqrt(count) if count > 1 else float("nan")
    parts = [sigma_gaps, sigma_scatter if count > 1 else 0.0, sigma_instrument or 0.0]
    sigma = float(np.sqrt(np.sum(np.square(parts))))
    # Welch and Satterthwaite: only the scatter was estimated from few samples.
    degrees = (count - 1) * (sigma / sigma_scatter) ** 4 if count > 1 and sigma_scatter > 0 else np.inf
    is_known = count > 1 or sigma_instrument is not None
    return SolarWeighted(
        float(each.mean()),
        sigma if is_known else float("nan"),
        float(degrees),
        freeze(each),
        sigma_gaps,
        sigma_scatter,
        gaps,
    )


def find_gaps(wavelength_nm: FloatArray, reflectance: FloatArray, shares: FloatArray) -> tuple[Gap, ...]:
    """Return where a spectrum says nothing for more than `WIDEST_STEP_NM`, and how much that may matter.

    Shapes: wavelength_nm (w,), reflectance (w,), shares (445,).
    """
    edges = np.concatenate([[FIRST_NM - 2.5], wavelength_nm, [LAST_NM + 2.5]])
    found = []
    for first, last in pairwise(edges.tolist()):
        width = last - first
        if width <= WIDEST_STEP_NM:
            continue
        inside = (first < WAVELENGTH_NM) & (last > WAVELENGTH_NM)
        beside = (wavelength_nm >= first - width) & (wavelength_nm <= last + width)
        near = reflectance[beside] if beside.sum() > 1 else reflectance
        gap = Gap(
            float(max(first, FIRST_NM)),
            float(min(last, LAST_NM)),
            float(shares[inside].sum()),
            0.5 * float(np.ptp(near)),
        )
        if gap.share > 0:
            found.append(gap)
    return tuple(found)
