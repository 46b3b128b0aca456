"""Extremes: the largest of many values, beside the largest that their noise alone gives.

The largest of n places about nothing is ``s sqrt(2 ln n)``, and no error of the heliostat: 3 sigma of 100 places.
What noise gives with more than `CHANCE` was not seen, and its upper bound is reported; what is seen is cleared of what
noise adds to a largest value.
"""

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from calibration.heliostat.performance.beam_series import Estimate
from calibration.heliostat.performance.entries import BOUND_PROBABILITY
from heliogauge.validate import FloatArray

#: Chance by noise from which on the largest of many tries counts as not seen.
CHANCE = 0.01
#: Standard deviations of an upper bound that holds with 95 %.
BOUND = NormalDist().inv_cdf(BOUND_PROBABILITY)
_DRAWS = 200


@dataclass(frozen=True, slots=True)
class Largest:
    """The largest of several angles in two directions [rad].

    index: Which one it is.
    found: Its size, without what noise adds to a largest one.
    chance: That noise alone gives one as large.
    below: With 95 % none is larger.
    """

    index: int
    found: Estimate
    chance: float
    below: float

    @property
    def is_seen(self) -> bool:
        """Whether it is more than noise."""
        return self.chance < CHANCE


def largest_of(errors_rad: FloatArray, sigma_rad: FloatArray, common_rad: FloatArray) -> Largest:
    """Find the largest of several angles.

    errors_rad, sigma_rad (n, 2): Angles with their noise.
    common_rad (2,): Uncertainty that all share.

    A size L of noise with the larger sigma s of both directions has a chance of at most ``exp(-L^2 / (2 s^2))``. What
    noise adds is that of draws about the angles brought as near to their mean as the noise makes them scatter.
    """
    size = np.hypot(errors_rad[:, 0], errors_rad[:, 1])
    reach = np.sqrt((sigma_rad**2 + common_rad**2).max(axis=1))
    index = int(np.argmax(size))
    most = float(size[index])
    each = np.exp(-0.5 * (most / np.maximum(reach, 1e-300)) ** 2)
    chance = float(-np.expm1(np.sum(np.log1p(-np.minimum(each, 1 - 1e-16)))))
    mean = errors_rad.mean(axis=0)
    spread, noise = errors_rad.var(axis=0), (sigma_rad**2).mean(axis=0)
    share = np.sqrt(np.clip(1 - noise / np.maximum(spread, 1e-300), 0.0, 1.0))
    true = mean + share * (errors_rad - mean)
    draws = true + sigma_rad * np.random.default_rng(0).standard_normal((_DRAWS, *true.shape))
    drawn = np.hypot(draws[..., 0], draws[..., 1]).max(axis=1)
    added = float(drawn.mean() - np.hypot(true[:, 0], true[:, 1]).max())
    toward = errors_rad[index] / max(most, 1e-300)
    own = float(np.sqrt(np.sum((toward * sigma_rad[index]) ** 2)))
    sigma = float(np.hypot(max(own, float(drawn.std())), np.hypot(*(toward * common_rad))))
    below = float((size + BOUND * reach).max())
    return Largest(index, Estimate(max(most - added, 0.0), sigma), chance, below)
