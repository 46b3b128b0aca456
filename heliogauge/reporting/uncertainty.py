"""Where the uncertainty of a slope map comes from."""

import numpy as np
import numpy.typing as npt

from heliogauge.slopes.map import SlopeMap, monomials


def uncertainty_shares(slope_map: SlopeMap) -> dict[str, tuple[float, float]]:
    """Return the RMS over the measured nodes of each share of the uncertainty, in x and in y.

    Returns: "random noise", then each common source [rad].
    """
    valid, common = slope_map.valid, slope_map.common
    count = max(int(np.count_nonzero(valid)), 1)
    x, y = np.meshgrid(slope_map.x_m, slope_map.y_m)
    scaled = ((x[valid] - common.center_m[0]) / common.scale_m, (y[valid] - common.center_m[1]) / common.scale_m)
    terms = monomials(*scaled, common.degree)
    # Mean square of a mode from the mean products of its terms: no mode is evaluated at every node.
    squares = np.einsum("kai,ij,kaj->ka", common.coefficients, terms @ terms.T / count, common.coefficients)
    shares = {"random noise": (_rms(slope_map.sigma_random_x[valid]), _rms(slope_map.sigma_random_y[valid]))}
    for source in dict.fromkeys(common.sources):
        chosen = [index for index, name in enumerate(common.sources) if name == source]
        sigma_x, sigma_y = np.sqrt(squares[chosen].sum(axis=0))
        shares[source] = (float(sigma_x), float(sigma_y))
    return shares


def _rms(values: npt.NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
