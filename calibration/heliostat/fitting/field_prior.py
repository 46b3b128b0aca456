"""What is known of one heliostat before it is measured, and how its own observations correct that."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calibration.heliostat.fitting.drift_noise import NoiseShape, NormalEquations
from calibration.heliostat.fitting.unit_noise import unit_noise
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray

#: Degrees of freedom of each parameter's distribution over heliostats: what Lange, Little and Taylor (1989) recommend
#: where they are not estimated. One post that was set askew then counts little, and its other numbers count in full.
_FREEDOM = 4.0
_ROUNDS = 8


@dataclass(frozen=True, slots=True, eq=False)
class FieldPrior(ShortRepr):
    """What is known of one heliostat before it is measured.

    names length p: Parameters.
    mean (p,): Expected offsets from the nominal values.
    scatter (p,): By how much heliostats most probably differ from it, scale of Student's t; standard deviations of
        general priors.
    variance (p,): Mean of its square: few heliostats leave open how large it is, and the most probable one may be
        nothing at all.
    mean_covariance (p, p): What is not known of the mean.
    noise: How observations scatter.
    heliostats: How many others that rests on; 0 for general priors.
    """

    names: tuple[str, ...]
    mean: FloatArray
    scatter: FloatArray
    variance: FloatArray
    mean_covariance: FloatArray
    noise: NoiseShape
    heliostats: int

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the offsets of one more heliostat, shape (p, p)."""
        return np.diag(self.scatter**2) + self.mean_covariance


class Settled(NamedTuple):
    """What is known of a heliostat, in the light of its own observations.

    covariance (p, p): Of its offsets about the expected ones, for the estimate: wider where it is unlike the others.
    spread (p, p): Their covariance with the mean squared scatter and the tails of Student's t, for what the estimate
        may be wrong by.
    noise: Size of its noise.
    log_evidence: Log of the probability of the observations.
    """

    covariance: FloatArray
    spread: FloatArray
    noise: float
    log_evidence: float


def student_weights(distances: FloatArray) -> FloatArray:
    """Return the weights of Student's t for squared distances over the scatter's variance, any shape."""
    return np.asarray((_FREEDOM + 1) / (_FREEDOM + distances))


def settle(found: NormalEquations, prior: FieldPrior) -> Settled:
    """Correct what is known of a heliostat where its own observations contradict it.

    found: Its observations under the prior's noise, misfit included.
    Returns: Each parameter is distributed as Student's t about the field's mean, a normal distribution of variance
        ``scatter^2 / w``. EM finds the weight for the estimate, 1 where the observations say nothing; the mean of
        1 / w is larger than its inverse by (f + 1) / (f - 1). General priors are normal and stay as they are.
    """
    size = np.sqrt(np.diag(prior.covariance))
    matrix, rhs = found.matrix * size[:, None] * size, found.rhs * size
    mean, scatter = prior.mean / size, prior.scatter / size
    shared = prior.mean_covariance / size[:, None] / size
    weights = np.ones(size.size)
    covariance = np.diag(scatter**2) + shared
    scaled = NormalEquations(matrix, rhs, found.square, found.log_determinant, found.count)
    own = unit_noise(scaled, mean, covariance)
    for _ in range(_ROUNDS if prior.heliostats else 0):
        over = own.factor**-2
        inverse = np.linalg.inv(covariance)
        after = np.linalg.inv(matrix * over + inverse)
        offsets = after @ (rhs * over + inverse @ mean) - mean
        # The deviation from the field's mean, which is uncertain itself, is a part of the offset.
        variance = scatter**2 / weights
        part = variance[:, None] * inverse
        spread = (part @ offsets) ** 2 + variance
        spread = spread + np.einsum("ij,jk,ik->i", part, after, part) - np.diag(part) * variance
        before, weights = weights, student_weights(spread / scatter**2)
        covariance = np.diag(scatter**2 / weights) + shared
        own = unit_noise(scaled, mean, covariance)
        if np.abs(weights / before - 1).max() < 0.02:
            break
    tails = (_FREEDOM + 1) / (_FREEDOM - 1) if prior.heliostats else 1.0
    wide = np.diag(tails * prior.variance / size**2 / weights) + shared
    # The density of the weights, Gamma(f / 2, f / 2), in their logarithms and over that at 1.
    penalty = 0.5 * _FREEDOM * float(np.sum(weights - 1 - np.log(weights)))
    units = size[:, None] * size
    return Settled(covariance * units, wide * units, own.factor, own.log_evidence - penalty)
