"""How noisy one heliostat is, by the evidence of its own observations."""

from typing import NamedTuple

import numpy as np

from calibration.heliostat.fitting.drift_noise import NormalEquations
from heliogauge.validate import FloatArray

#: A heliostat's noise differs from the usual one by a factor of e^0.5 (one sigma): that of 17 real ones lies between
#: 0.5 and 2 times their middle, and by marginal likelihood 0.2 to 0.7 are within a factor of e^4 of the most probable
#: e^0.37. A narrower one overstates the errors of records that are better than usual.
_LOG_SIGMA = 0.5
_LOGS = np.linspace(-1.6, 3.0, 93)


class UnitNoise(NamedTuple):
    """What the observations of a heliostat say of its noise.

    factor: Root mean square of the factor on the usual noise: of few rows the most probable one is too small.
    log_evidence: Log of their probability; factor and parameters are integrated out.
    """

    factor: float
    log_evidence: float


def unit_noise(found: NormalEquations, mean: FloatArray, covariance: FloatArray) -> UnitNoise:
    """Return the size of a heliostat's noise.

    found: Its observations, under the usual noise.
    mean (p,), covariance (p, p): What is known of its parameters before.

    With ``A = C^1/2 N C^1/2`` and the pull b about the mean, the offsets integrate to ``square - b . (1 + A)^-1 . b +
    log det(1 + A)``; the eigenvalues of A give that for every size of the noise at once.
    """
    at_mean = found.rhs - found.matrix @ mean
    square = found.square - 2 * float(found.rhs @ mean) + float(mean @ found.matrix @ mean)
    root = np.linalg.cholesky(covariance)
    values, axes = np.linalg.eigh(root.T @ found.matrix @ root)
    values = np.maximum(values, 0.0)
    pulls = (axes.T @ (root.T @ at_mean)) ** 2
    over = np.exp(-2 * _LOGS)[:, None]
    shrunk = 1 + values * over
    twice = square * over[:, 0] - np.sum(pulls * over**2 / shrunk, axis=1) + np.sum(np.log(shrunk), axis=1)
    twice = twice + 2 * found.count * _LOGS + (_LOGS / _LOG_SIGMA) ** 2
    least = float(twice.min())
    chance = np.exp(-0.5 * (twice - least))
    total = float(chance.sum())
    factor = float(np.sqrt(chance @ np.exp(2 * _LOGS) / total))
    density = np.log(total * (_LOGS[1] - _LOGS[0]) / (_LOG_SIGMA * np.sqrt(2 * np.pi)))
    return UnitNoise(factor, float(density) - 0.5 * (least + found.log_determinant))
