"""Where a beam went over a time: accuracy and precision of tracking, repeatability, what wind adds; each with sigma.

Angles are of the beam, seen from the mirror, right and up; those of the normal are named so. What is said of a series
is said of its own moments: the sigma of an RMS is what the centroids leave open. Where it stands for more than its
moments (wind, repetitions), the moments' own scatter is counted as well.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import BoolArray, FloatArray, float_array, freeze

#: Sun's hour angle about culmination that counts as noon: 15 minutes, as test 3 of Stage-STE 12.6 [s].
NOON_S = 900.0


@dataclass(frozen=True, slots=True, eq=False)
class BeamSeries:
    """Errors of a beam at several moments.

    times_s (n,): From any origin, ascending [s].
    beam_rad (n, 2): Beam minus aim, right and up, seen from the mirror [rad].
    sigma_rad (n, 2): Of each place on its own [rad].
    sigma_common_rad (2,): Of what all places share: the aim point, the target's marks [rad].
    sigma_scale: Relative uncertainty of the distance, which scales all angles.
    """

    times_s: FloatArray
    beam_rad: FloatArray
    sigma_rad: FloatArray
    sigma_common_rad: FloatArray
    sigma_scale: float = 0.0

    def __post_init__(self) -> None:
        times = float_array("times_s", self.times_s, (None,))
        if (np.diff(times) <= 0).any():
            raise InputError("times_s: ascending moments are needed, each once")
        object.__setattr__(self, "times_s", times)
        object.__setattr__(self, "beam_rad", float_array("beam_rad", self.beam_rad, (times.size, 2)))
        object.__setattr__(self, "sigma_rad", float_array("sigma_rad", self.sigma_rad, (times.size, 2)))
        object.__setattr__(self, "sigma_common_rad", float_array("sigma_common_rad", self.sigma_common_rad, (2,)))

    def __len__(self) -> int:
        return int(self.times_s.size)

    def select(self, rows: BoolArray) -> "BeamSeries":
        """Return some of its moments."""
        return BeamSeries(
            self.times_s[rows], self.beam_rad[rows], self.sigma_rad[rows], self.sigma_common_rad, self.sigma_scale
        )


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number with its standard deviation.

    degrees: Degrees of freedom of `sigma`.
    """

    value: float
    sigma: float
    degrees: float = np.inf


@dataclass(frozen=True, slots=True, eq=False)
class Accuracy:
    """Accuracy and precision of tracking over a series (Stage-STE 12.6, 1.2.4.1 and 1.3.1.4).

    rms: Root mean square of the beam's error in both directions: accuracy [rad].
    mean: Systematic offset, right and up [rad].
    spread: Standard deviation about it, both directions together: precision [rad].
    spread_each: The same, right and up [rad].
    average: Mean size of the error [rad].
    """

    rms: Estimate
    mean: tuple[Estimate, Estimate]
    spread: Estimate
    spread_each: tuple[Estimate, Estimate]
    average: Estimate


def accuracy(series: BeamSeries, *, of_the_process: bool = False) -> Accuracy:
    """Summarise the errors of a beam.

    of_the_process: The series stands for more than its own moments, so that their scatter adds to the sigma of the RMS.
    Returns: Accuracy and precision, the noise of the centroids taken off.
    EstimationError: Fewer than three moments.
    """
    count = len(series)
    if count < 3:
        raise EstimationError(f"tracking: {count} beams, at least 3 are needed")
    error, sigma, common = series.beam_rad, series.sigma_rad, series.sigma_common_rad
    mean = error.mean(axis=0)
    own_mean = np.sqrt((sigma**2).sum(axis=0)) / count
    mean_sigma = np.sqrt(own_mean**2 + common**2 + (series.sigma_scale * mean) ** 2)
    noise = (sigma**2).mean(axis=0)
    rms = _root(
        float((error**2).mean(axis=0).sum() - noise.sum()),
        float(_variance_of_squares(error, sigma).sum())
        + 4 * float(np.sum((mean * common) ** 2))
        + (_variance_of_mean((error**2).sum(axis=1)) if of_the_process else 0.0),
        float(np.hypot(*common)),
        series.sigma_scale,
    )
    about = error - mean
    shares = (about**2).sum(axis=0) / (count - 1) - noise
    variances = _variance_of_squares(about, sigma)
    each = [_root(float(shares[k]), float(variances[k]), 0.0, series.sigma_scale) for k in (0, 1)]
    spread = _root(float(shares.sum()), float(variances.sum()), 0.0, series.sigma_scale)
    size = np.hypot(error[:, 0], error[:, 1])
    toward = error / np.maximum(size, 1e-300)[:, None]
    along = np.sqrt(((toward * sigma) ** 2).sum(axis=1))
    # The part of the noise across the error makes every size larger.
    across = ((toward[:, ::-1] * sigma) ** 2).sum(axis=1)
    taken = np.minimum(across / np.maximum(2 * size, 1e-300), 0.5 * size)
    plain = size - taken
    # First order only: where errors are near the noise, half of what is taken off is open.
    open_part = 0.5 * float(taken.mean())
    shared = float(np.hypot(*(toward.mean(axis=0) * common)))
    average = Estimate(
        float(plain.mean()),
        float(
            np.sqrt((along**2).sum() / count**2 + open_part**2 + shared**2 + (series.sigma_scale * plain.mean()) ** 2)
        ),
    )
    return Accuracy(
        rms,
        (Estimate(float(mean[0]), float(mean_sigma[0])), Estimate(float(mean[1]), float(mean_sigma[1]))),
        spread,
        (each[0], each[1]),
        average,
    )


def near_noon(series: BeamSeries, noon_s: float, within_s: float = NOON_S) -> tuple[Estimate, Estimate]:
    """Return the mean error about culmination, right and up (Stage-STE 12.6, 1.3.1.4: accuracy at solar noon).

    noon_s: When the sun culminates, in the series' time [s].
    within_s: How far from it a beam counts [s].
    EstimationError: No beam was measured then.
    """
    near = np.abs(series.times_s - noon_s) <= within_s
    if not near.any():
        raise EstimationError(f"noon: no beam within {within_s / 60:g} minutes of culmination")
    chosen = series.select(near)
    mean = chosen.beam_rad.mean(axis=0)
    count = len(chosen)
    sigma = np.sqrt(
        (chosen.sigma_rad**2).sum(axis=0) / count**2 + series.sigma_common_rad**2 + (series.sigma_scale * mean) ** 2
    )
    return Estimate(float(mean[0]), float(sigma[0])), Estimate(float(mean[1]), float(sigma[1]))


@dataclass(frozen=True, slots=True, eq=False)
class Repeated:
    """Repeated approaches of one aim (Stage-STE 12.6, 1.3.1.4).

    scatter: Standard deviation within approaches from one side, right and up [rad]: what no model can correct.
    between: Root mean square of the differences between the sides' means and their mean, right and up [rad].
    means (k, 2), sigma_means (k, 2): Mean of each side [rad].
    sides: Their names, sorted.
    p_same: Probability of means this far apart where the start makes no difference (F test, both directions).
    """

    scatter: tuple[Estimate, Estimate]
    means: FloatArray
    sigma_means: FloatArray
    sides: tuple[str, ...]
    counts: tuple[int, ...]
    p_same: float


def repeated(series: BeamSeries, sides: npt.NDArray[np.str_]) -> Repeated:
    """Split repeated approaches into what depends on where they came from and what does not.

    sides (n,): From where the aim was approached.
    EstimationError: No side was repeated.
    """
    names, index = np.unique(np.asarray(sides), return_inverse=True)
    counts = np.bincount(index)
    spare = len(series) - names.size
    if spare < 1:
        raise EstimationError("repeatability: no approach was repeated; two beams after the same approach are needed")
    means = np.stack([np.bincount(index, weights=series.beam_rad[:, k]) / counts for k in (0, 1)], axis=1)
    within = ((series.beam_rad - means[index]) ** 2).sum(axis=0) / spare
    noise = (series.sigma_rad**2).mean(axis=0)
    scatter = []
    for k in (0, 1):
        # The relative uncertainty of the variance is that of chi-square; the noise of the centroids comes off.
        root = _root(float(within[k] - noise[k]), float(2 * within[k] ** 2 / spare), 0.0, series.sigma_scale)
        scatter.append(Estimate(root.value, root.sigma, float(spare)))
    p_same = float("nan")
    if names.size > 1:
        from scipy.special import chdtrc, fdtrc

        mean = series.beam_rad.mean(axis=0)
        between = (counts[:, None] * (means - mean) ** 2).sum(axis=0) / (names.size - 1)
        each = fdtrc(names.size - 1, spare, between / np.maximum(within, 1e-300))
        # Fisher: both directions in one probability.
        p_same = float(chdtrc(4, -2 * np.log(np.maximum(each, 1e-300)).sum()))
    return Repeated(
        (scatter[0], scatter[1]),
        freeze(means),
        freeze(np.sqrt(within / counts[:, None])),
        tuple(str(name) for name in names),
        tuple(int(count) for count in counts),
        p_same,
    )


def independent_count(values: FloatArray) -> float:
    """Return how many independent values a series is worth for its mean (Sokal's window of five memory times)."""
    about = values - values.mean()
    power = float(about @ about)
    count = values.size
    if not power > 0:
        return float(count)
    # Each lag misses the products that a series of this length has less of; the mean took one degree.
    memory = 1.0
    for lag in range(1, count // 2):
        memory += 2 * float(about[:-lag] @ about[lag:]) / power * count / (count - lag)
        if lag >= 5 * memory:
            break
    return float(np.clip(count / max(memory, 1.0), 2.0, count))


def _variance_of_mean(values: FloatArray) -> float:
    effective = independent_count(values)
    return float(values.var()) / max(effective - 1, 1.0)


def _variance_of_squares(measured: FloatArray, sigma: FloatArray) -> FloatArray:
    """Return the variance by noise of the mean square of each direction, shape (2,).

    ``(t + n)^2`` has the variance ``4 t^2 s^2 + 2 s^4``; what was measured stands for ``t^2 + s^2``.
    """
    least = 2 * sigma**4
    each = np.sum(4 * measured**2 * sigma**2 - least, axis=0)
    return np.asarray(np.maximum(each, least.sum(axis=0)) / len(sigma) ** 2)


def _root(square: float, variance: float, floor: float, scale: float) -> Estimate:
    """Return the root of an estimated square with its sigma; near zero the sigma is that of the square's own root."""
    value = float(np.sqrt(max(square, 0.0)))
    spread = float(np.sqrt(variance))
    # d sqrt(q) = dq / (2 sqrt q), which has no bound at zero; sqrt(dq) is the most that it can be there.
    sigma = min(spread / (2 * value), np.sqrt(spread)) if value > 0 else float(np.sqrt(spread))
    return Estimate(
        value, float(np.sqrt(max(sigma, 0.0) ** 2 + (scale * value) ** 2 + (floor**2 if value == 0 else 0.0)))
    )
