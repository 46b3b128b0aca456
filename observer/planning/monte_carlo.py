"""How far simulated measurements scatter: the whole evaluation again and again with all its inputs disturbed.

Owkes (2012, chapter 7) disturbs targets, distances, calibration, image points and centrelines, and repeats the analysis
until the uncertainty has settled (some 500 runs). Here the evaluation states a sigma for every point as well; both must
agree.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from heliogauge.errors import EstimationError
from heliogauge.validate import FloatArray
from observer.planning.simulated_flight import Simulated

#: After so many runs the uncertainty is noted, to see it settle.
_NOTED = (10, 20, 50, 100, 200, 300, 400, 500, 1000, 2000)
#: The settled uncertainty changes by no more than this share when the runs double.
_SETTLED = 0.05
#: A point that fewer than half of the runs measured has no scatter worth stating.
_LEAST_SHARE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class MonteCarlo:
    """Scatter of simulated measurements.

    runs: Simulations that gave a result.
    failed: Why others did not.
    rms_slope_x (r, nx): RMS of estimated less true dz/dx at each node; NaN where half of the runs measured nothing
        [rad].
    stated_slope_x (r, nx): RMS of the standard deviations that the evaluation states there [rad].
    rms_absorber_m, stated_absorber_m (n, 2): The same of the absorber's x and z at its stations [m].
    percentile_95_rad: 95 % of all nodes of all runs lie within this error of dz/dx [rad].
    settling: Number of runs, and the RMS over the map after that many [rad].
    """

    runs: int
    failed: tuple[str, ...]
    rms_slope_x: FloatArray
    stated_slope_x: FloatArray
    rms_absorber_m: FloatArray
    stated_absorber_m: FloatArray
    percentile_95_rad: float
    settling: tuple[tuple[int, float], ...]

    @property
    def rms_rad(self) -> float:
        """RMS over the map [rad]."""
        return float(np.sqrt(np.nanmean(self.rms_slope_x**2)))

    @property
    def ratio(self) -> float:
        """Scatter over stated standard deviation, RMS over the map."""
        both = np.isfinite(self.rms_slope_x) & np.isfinite(self.stated_slope_x)
        return float(np.sqrt((self.rms_slope_x[both] ** 2).mean() / (self.stated_slope_x[both] ** 2).mean()))

    @property
    def ratio_absorber(self) -> tuple[float, float]:
        """Scatter over stated standard deviation of the absorber's x and z."""
        ratio = np.sqrt(np.mean(self.rms_absorber_m**2, axis=0) / np.mean(self.stated_absorber_m**2, axis=0))
        return float(ratio[0]), float(ratio[1])

    @property
    def has_settled(self) -> bool:
        """Whether the last doubling of the runs changed the RMS over the map by little."""
        earlier = [value for count, value in self.settling if 2 * count <= self.runs]
        return bool(earlier) and abs(self.settling[-1][1] / earlier[-1] - 1) <= _SETTLED


class _Sums:
    """Sums of squares, run by run."""

    def __init__(self) -> None:
        self.error: FloatArray = np.zeros(0)
        self.stated: FloatArray = np.zeros(0)
        self.count: FloatArray = np.zeros(0)

    def add(self, error: FloatArray, stated: FloatArray) -> None:
        if self.error.size == 0:
            self.error, self.stated, self.count = (np.zeros(error.shape) for _ in range(3))
        known = np.isfinite(error) & np.isfinite(stated)
        self.error += np.where(known, error, 0.0) ** 2
        self.stated += np.where(known, stated, 0.0) ** 2
        self.count += known

    def rms(self, runs: int) -> tuple[FloatArray, FloatArray]:
        """Return RMS error and RMS stated; NaN where too few runs know."""
        enough = self.count >= max(1.0, _LEAST_SHARE * runs)
        count = np.where(enough, self.count, 1.0)
        found = [np.where(enough, np.sqrt(part / count), np.nan) for part in (self.error, self.stated)]
        return found[0], found[1]


def monte_carlo(
    simulate: Callable[[np.random.Generator], Simulated],
    runs: int,
    seed: int = 0,
    advance: Callable[[], None] | None = None,
) -> MonteCarlo:
    """Repeat a simulated measurement.

    simulate: Draws everything that is uncertain, and evaluates.
    seed: Seed of the first run; each run has a generator of its own.
    advance: Called after each run.
    Returns: The scatter about the truth.
    EstimationError: No run gave a result.
    """
    slopes, absorber = _Sums(), _Sums()
    failed: list[str] = []
    settling: list[tuple[int, float]] = []
    inside: list[FloatArray] = []
    done = 0
    for run in range(runs):
        try:
            one = simulate(np.random.default_rng([seed, run]))
        except EstimationError as fault:
            failed.append(str(fault))
            continue
        finally:
            if advance is not None:
                advance()
        done += 1
        error = one.error_slope_x
        slopes.add(error, one.sigma_slope_x)
        path = one.absorber
        stated = np.stack(path.sigma_at(path.y_m), axis=1)
        absorber.add(np.stack([path.x_m - one.true_x_m, path.z_m - one.true_z_m], axis=1), stated)
        inside.append(np.abs(error[np.isfinite(error)]))
        if done in _NOTED or run == runs - 1:
            settling.append((done, float(np.sqrt(slopes.error.sum() / max(slopes.count.sum(), 1.0)))))
    if done == 0:
        raise EstimationError(f"Monte Carlo: none of {runs} simulations gave a result; the first: {failed[0]}")
    rms, stated_rms = slopes.rms(done)
    rms_absorber, stated_absorber = absorber.rms(done)
    return MonteCarlo(
        done,
        tuple(failed),
        rms,
        stated_rms,
        rms_absorber,
        stated_absorber,
        float(np.percentile(np.concatenate(inside), 95)),
        tuple(settling),
    )
