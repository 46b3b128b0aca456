"""How well an RTK-GPS receiver at rest knows where it is: the sigmas that sightings from a drone are weighted with."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import FloatArray, float_array, positive

#: Fewer epochs do not give a spread to 10 %.
_FEWEST = 20


@dataclass(frozen=True, slots=True, eq=False)
class RtkStatistics:
    """Spread of the positions of a receiver that did not move; components are north, east, down.

    mean_m, range_m, sigma_m (3,): Mean, largest minus smallest, standard deviation (n - 1) [m].
    drms_m, mrse_m: Root mean square deviation in the horizontal plane and in space, over n [m].
    correlation_time_s: Integrated autocorrelation time, the longest of the three components: how far apart epochs
        are independent [s].
    """

    n_epochs: int
    mean_m: FloatArray
    range_m: FloatArray
    sigma_m: FloatArray
    drms_m: float
    mrse_m: float
    correlation_time_s: float

    def sigma_of_mean_m(self, duration_s: float, interval_s: float) -> FloatArray:
        """Return the standard deviation of a mean over some time of such a receiver, shape (3,) [m].

        duration_s: How long is averaged [s].
        interval_s: Time between epochs [s].
        """
        positive("interval_s", interval_s, "seconds")
        independent = max(1.0, duration_s / max(interval_s, self.correlation_time_s))
        return np.asarray(self.sigma_m / np.sqrt(independent))


def rtk_statistics(
    positions_m: npt.ArrayLike, *, interval_s: float = 0.1, is_fixed: npt.ArrayLike | None = None
) -> RtkStatistics:
    """Summarise the log of an RTK-GPS receiver that did not move.

    positions_m (n, 3): North, east and down of the base station [m].
    interval_s: Time between epochs [s].
    is_fixed (n,): Epochs with resolved ambiguities; the others are left out. All of them without.
    Returns: Spread, and how long it keeps its direction.
    InputError: Wrong shapes.
    EstimationError: Fewer than 20 epochs are fixed.

    Gouws (2018), eqs. 3.13 and 3.14. For errors that are equal and normal in all directions 63.2 % of them are within
    DRMS and 60.8 % within MRSE. The autocorrelation time sums the correlation until it first falls below zero; white
    noise has that of one epoch. Epochs that are left out in between are not bridged.
    """
    positive("interval_s", interval_s, "seconds")
    positions = float_array("positions_m", positions_m, (None, 3))
    if is_fixed is not None:
        fixed = np.asarray(is_fixed, dtype=np.bool_)
        if fixed.shape != (len(positions),):
            raise InputError(f"is_fixed: {len(positions)} values are needed, not {fixed.shape}")
        positions = positions[fixed]
    if len(positions) < _FEWEST:
        raise EstimationError(f"RTK log: {len(positions)} fixed epochs; {_FEWEST} are needed, log for longer")
    off = positions - positions.mean(axis=0)
    square = np.mean(off**2, axis=0)
    epochs = max(_correlation_epochs(off[:, axis]) for axis in range(3))
    return RtkStatistics(
        len(positions),
        positions.mean(axis=0),
        np.ptp(positions, axis=0),
        positions.std(axis=0, ddof=1),
        float(np.sqrt(square[0] + square[1])),
        float(np.sqrt(square.sum())),
        interval_s * epochs,
    )


def _correlation_epochs(off: FloatArray) -> float:
    power = np.abs(np.fft.rfft(off, 2 * len(off))) ** 2
    covariance = np.fft.irfft(power)[: len(off)]
    if covariance[0] == 0:
        return 1.0
    correlation = covariance / covariance[0]
    below = np.flatnonzero(correlation <= 0)
    last = below[0] if below.size else len(correlation)
    return float(1 + 2 * correlation[1:last].sum())
