"""What the slopes themselves say of the instrument: errors that give them a curl, which no surface has."""

from dataclasses import dataclass, replace

import numpy as np

from deflectometry.laser.scan_slopes import ScanSlopes
from heliogauge.adjust.chi_square import chi_square_cdf
from heliogauge.slopes.curl_moments import curl_moments
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray

#: Source of the modes of what is left of all errors of the instrument: they hang together.
INSTRUMENT = "laser, target and place"
#: So much curl by chance once in ten thousand times: then something else is wrong, and nothing is corrected.
_LEAST_PROBABILITY = 1e-4
#: Below this share of its variance taken away an error is not determined: its sigma is a tenth smaller.
_LEAST_SHARE = 0.19


@dataclass(frozen=True, slots=True, eq=False)
class InstrumentByCurl:
    """A scan after its curl was heard.

    found: Slopes with the errors of the instrument that the curl shows taken out, and what is left of these.
    amounts (k,): Of each error, in its stated sigmas.
    shares (k,): Of the variance of each that the curl takes away.
    probability: Of so much curl, if noise and stated sigmas are right.
    """

    found: ScanSlopes
    amounts: FloatArray
    shares: FloatArray
    probability: float

    @property
    def contradicts(self) -> bool:
        """Whether noise and stated sigmas explain the curl no longer."""
        return self.probability < _LEAST_PROBABILITY

    def words(self, sources: tuple[str, ...]) -> str:
        """Say what the curl determined, or nothing; the errors by the names of their sources."""
        if self.contradicts:
            return ""
        told = [
            f"{source} ({amount:+.2f} of its sigma, known {(1 - share) ** -0.5:.1f} times better)"
            for source, amount, share in zip(sources, self.amounts, self.shares, strict=True)
            if share >= _LEAST_SHARE
        ]
        return f"corrected by the curl of the slopes, which no surface has: {', '.join(told)}" if told else ""


def hear_curl(found: ScanSlopes, slope_map: SlopeMap) -> InstrumentByCurl | None:
    """Estimate the errors that all beams share from the curl they make.

    slope_map: The map of the slopes, with their common modes.
    Returns: None where the map is too small, or no error has a sigma.

    A target turned against the beams' axes by r moves the spots across by r times their distance from the laser. On a
    trough that spreads its beams along its axis this makes slopes across that grow along it, and no slopes along it: a
    curl, where a twisted mirror has both. The means of the curl over the mirror with weights that vanish at its edge
    (`heliogauge.slopes.curl_moments`) are zero for every surface, and linear in the amounts a of all errors, whose
    prior is 0 +- 1: ``a = J^T C^-1 m`` with their covariance C, and ``I - J^T C^-1 J`` is left.
    """
    common = found.common
    moments = curl_moments(slope_map) if common.sources else None
    if moments is None:
        return None
    effects = moments.of_modes(common)
    gain = np.linalg.solve(moments.covariance, effects).T
    amounts, left = gain @ moments.values_per_m, np.eye(len(common.sources)) - gain @ effects
    shares = 1.0 - np.diag(left)
    probability = 1.0 - chi_square_cdf(moments.chi_square, float(len(moments.values_per_m)))
    if probability < _LEAST_PROBABILITY:
        return InstrumentByCurl(found, np.zeros_like(amounts), np.zeros_like(amounts), probability)
    size, directions = np.linalg.eigh(0.5 * (left + left.T))
    roots = (directions * np.sqrt(np.maximum(size, 0.0))).T
    modes = replace(
        common,
        sources=(INSTRUMENT,) * len(roots),
        coefficients=np.tensordot(roots, common.coefficients, axes=(1, 0)),
    )
    taken = np.tensordot(amounts, common.evaluate(*found.points_m), axes=(0, 0))
    return InstrumentByCurl(replace(found, slopes=found.slopes - taken, common=modes), amounts, shares, probability)
