"""Drift, oscillation and sawtooth of a beam (Stage-STE 12.6, 1.3.6.2 and 2.4).

The report fits a cubic to the beam's place over time: its range is the drift, the scatter about it the oscillation. The
scatter of a tracking heliostat is not white: it remembers, which makes the drift's sigma several times that of white
noise. Here the oscillation is a process with a memory (Ornstein and Uhlenbeck) plus the known noise of the centroids,
and both are found together (restricted likelihood).
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calibration.heliostat.performance.beam_series import Estimate
from calibration.heliostat.performance.extremes import BOUND
from heliogauge.adjust.chi_square import chi_square_cdf
from heliogauge.errors import EstimationError
from heliogauge.validate import FloatArray, float_array, freeze, positive

#: Degree of the drift, as the report has it.
DEGREE = 3
#: Least share of the scatter that counts as the centroids' noise: the likelihood needs some.
_LEAST_NOISE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Wander:
    """Drift and oscillation in one direction, in the unit of the values.

    drift: Largest minus smallest value of the cubic.
    p_chance: Probability that noise alone gives a cubic so large.
    oscillation: Standard deviation of what remains, without the noise of the centroids.
    memory_s: After so long the oscillation is forgotten to 1/e [s].
    trend (n,), sigma_trend (n,): The cubic at each time.
    """

    drift: Estimate
    p_chance: float
    oscillation: Estimate
    memory_s: float
    trend: FloatArray
    sigma_trend: FloatArray


def wander(times_s: npt.ArrayLike, values: npt.ArrayLike, sigma: npt.ArrayLike, *, degree: int = DEGREE) -> Wander:
    """Separate drift from oscillation.

    times_s (n,): Ascending [s].
    values (n,): The beam's place in one direction.
    sigma (n,): Noise of each.
    degree: Of the drift.
    EstimationError: Fewer than twice as many places as the drift has coefficients.
    """
    times = float_array("times_s", times_s, (None,))
    y = float_array("values", values, (times.size,))
    noise = float_array("sigma", sigma, (times.size,))
    if times.size < 2 * (degree + 1):
        raise EstimationError(f"drift: {times.size} places, {2 * (degree + 1)} are needed for degree {degree}")
    scaled = 2 * (times - times[0]) / (times[-1] - times[0]) - 1
    basis = np.polynomial.legendre.legvander(scaled, degree)
    rough = y - basis @ np.linalg.lstsq(basis, y, rcond=None)[0]
    scatter = max(float(np.sqrt(rough @ rough / (times.size - degree - 1))), 1e-300)
    model = _Likelihood(np.diff(times), y, np.maximum(noise, _LEAST_NOISE * scatter), basis)
    step, span = float(np.median(np.diff(times))), float(times[-1] - times[0])
    best = model.best(scatter, step, span)
    _, solution, covariance = model.at(best)
    fine = np.polynomial.legendre.legvander(np.linspace(-1, 1, 1001), degree)
    curve = fine @ solution
    ends = fine[int(np.argmax(curve))] - fine[int(np.argmin(curve))]
    drift = Estimate(float(np.ptp(curve)), float(np.sqrt(ends @ covariance @ ends)))
    # The two moments are those of all pairs that are farthest apart: of any difference of the curve (Scheffe 1959).
    p_chance = 1.0 - chi_square_cdf((drift.value / max(drift.sigma, 1e-300)) ** 2, degree)
    size, memory = np.exp(best)
    # What an oscillation of this memory shows about a cubic over this span: the process' own scatter.
    oscillation = Estimate(float(size), float(size) * model.sigma_log_size(best))
    trend = basis @ solution
    sigma_trend = np.sqrt(np.einsum("ni,ij,nj->n", basis, covariance, basis))
    return Wander(drift, p_chance, oscillation, float(memory), freeze(trend), freeze(sigma_trend))


class _Likelihood:
    """Restricted likelihood of a process with memory about a polynomial, in a time proportional to the places.

    The inverse of the process' covariance has three diagonals, so that nothing larger is ever solved.
    """

    def __init__(self, steps_s: FloatArray, values: FloatArray, noise: FloatArray, basis: FloatArray) -> None:
        self._steps, self._values, self._basis = steps_s, values, basis
        self._precision = 1 / noise**2

    def best(self, scatter: float, step_s: float, span_s: float) -> FloatArray:
        """Return log of size and memory where the likelihood is largest."""
        from scipy.optimize import minimize

        bounds = [(np.log(scatter * 0.01), np.log(scatter * 10)), (np.log(0.2 * step_s), np.log(0.5 * span_s))]
        starts = [np.array([np.log(scatter), np.log(m)]) for m in (step_s, np.sqrt(step_s * 0.2 * span_s))]
        found = [
            minimize(lambda p: self.at(p)[0], start, method="Nelder-Mead", bounds=bounds, options={"xatol": 1e-3})
            for start in starts
        ]
        return np.asarray(min(found, key=lambda one: one.fun).x)

    def at(self, logs: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Return minus twice the log likelihood, the polynomial's coefficients and their covariance."""
        from scipy.linalg import cho_solve_banded, cholesky_banded

        size, memory = np.exp(logs)
        keep = np.exp(-self._steps / memory)
        lost = -np.expm1(-2 * self._steps / memory)
        inverse = np.zeros((2, self._values.size))
        inverse[1, 0] = 1.0
        inverse[1, 1:] = 1 / lost
        inverse[1, :-1] += keep**2 / lost
        inverse[0, 1:] = -keep / lost
        inverse /= size**2
        inverse[1] += self._precision
        factor = cholesky_banded(inverse)
        log_determinant = (
            2 * float(np.log(factor[1]).sum())
            + float(np.log(lost).sum())
            + 2 * self._values.size * float(np.log(size))
            - float(np.log(self._precision).sum())
        )

        def whiten(columns: FloatArray) -> FloatArray:
            weighted = self._precision[:, None] * columns
            return np.asarray(weighted - self._precision[:, None] * cho_solve_banded((factor, False), weighted))

        weighted = whiten(self._basis)
        normal = self._basis.T @ weighted
        covariance = np.linalg.inv(normal)
        solution = covariance @ (weighted.T @ self._values)
        rest = (self._values - self._basis @ solution)[:, None]
        square = float(rest[:, 0] @ whiten(rest)[:, 0])
        return log_determinant + float(np.linalg.slogdet(normal)[1]) + square, solution, np.asarray(covariance)

    def sigma_log_size(self, best: FloatArray) -> float:
        """Return the sigma of the log of the size, the memory being unknown too; infinite where it has no end."""
        step = 0.1
        moves = step * np.eye(2)
        value = {(i, j): self.at(best + i * moves[0] + j * moves[1])[0] for i in (-1, 0, 1) for j in (-1, 0, 1)}
        first = (value[1, 0] - 2 * value[0, 0] + value[-1, 0]) / step**2
        second = (value[0, 1] - 2 * value[0, 0] + value[0, -1]) / step**2
        both = (value[1, 1] - value[1, -1] - value[-1, 1] + value[-1, -1]) / (4 * step**2)
        # At the end of the range of memories (white, or as slow as the series) there is nothing to share with it.
        if second <= 0 or first * second <= both**2:
            return float(np.sqrt(2 / first)) if first > 0 else float("inf")
        return float(np.sqrt(2 / (first - both**2 / second)))


@dataclass(frozen=True, slots=True, eq=False)
class Sawtooth:
    """A beam that creeps and is set back at each update of the drives.

    height: From the end of a creep to the beginning of the next, right and up, signed as the creep.
    period_s: Between updates [s].
    p_chance: Probability that noise alone looks like this, all periods tried counted.
    phase: Where in a period an update lies, as a share.
    tries: Periods and phases among which it was found.
    """

    height: tuple[Estimate, Estimate]
    period_s: float
    p_chance: float
    phase: float = 0.0
    tries: int = 1

    def at(self, times_s: FloatArray) -> FloatArray:
        """Return the sawtooth at times of the series, shape (n, 2)."""
        tooth = (times_s / self.period_s - self.phase) % 1.0 - 0.5
        return np.asarray(tooth[:, None] * [one.value for one in self.height])

    def below(self, chance: float) -> tuple[float, float]:
        """Return the heights, right and up, from which on it is seen with 95 % at a chance by noise."""
        reach = float(np.sqrt(2 * np.log(self.tries / chance))) + BOUND
        return reach * self.height[0].sigma, reach * self.height[1].sigma


_PHASES = 40


def sawtooth(
    times_s: npt.ArrayLike, values: npt.ArrayLike, *, period_s: float | None = None, degree: int = DEGREE
) -> Sawtooth:
    """Find the sawtooth of drives that are updated at intervals.

    times_s (n,): Ascending; at least four in each period [s].
    values (n, 2): The beam's place.
    period_s: Known interval of the updates; None: sought [s].
    degree: Degree of the drift under it.
    EstimationError: Too few places, or a period of which the series holds fewer than three.
    """
    times = float_array("times_s", times_s, (None,))
    y = float_array("values", values, (times.size, 2))
    if times.size < 4 * (degree + 1):
        raise EstimationError(f"sawtooth: {times.size} places, {4 * (degree + 1)} are needed")
    span, step = float(times[-1] - times[0]), float(np.median(np.diff(times)))
    if period_s is not None:
        positive("period_s", period_s, "seconds")
        if period_s * 3 > span or period_s < 4 * step:
            raise EstimationError(
                f"sawtooth: places every {step:g} s over {span:g} s cannot show a period of {period_s:g} s; at "
                "least four "
                "places in a period and three periods are needed"
            )
        periods = np.array([period_s])
    else:
        slow, fast = 3 / span, 1 / (4 * step)
        if fast <= slow:
            raise EstimationError(f"sawtooth: {times.size} places are too few to look for one")
        periods = 1 / np.arange(slow, fast, 0.2 / span)
    basis = np.polynomial.legendre.legvander(2 * (times - times[0]) / span - 1, degree)
    q = np.linalg.qr(basis)[0]
    rest = y - q @ (q.T @ y)
    phases = np.arange(_PHASES) / _PHASES
    best = (-1.0, periods[0], 0.0)
    for period in periods:
        teeth = (times / period - phases[:, None]) % 1.0 - 0.5
        teeth -= (teeth @ q) @ q.T
        gains = ((teeth @ rest) ** 2).sum(axis=1) / np.maximum((teeth**2).sum(axis=1), 1e-300)
        most = int(np.argmax(gains))
        if gains[most] > best[0]:
            best = (float(gains[most]), float(period), float(phases[most]))
    from scipy.optimize import minimize

    move = np.array([0.3 * best[1] ** 2 / span if period_s is None else 0.0, 0.5 / _PHASES])
    if period_s is None:
        start = np.array([best[1], best[2]])
        simplex = start + np.array([[0, 0], [move[0], 0], [0, move[1]]])
        found = minimize(
            lambda p: -_gain(times, q, rest, p[0], p[1]),
            start,
            method="Nelder-Mead",
            options={"initial_simplex": simplex},
        )
        period, phase = float(found.x[0]), float(found.x[1])
    else:
        near = np.linspace(best[2] - 1 / _PHASES, best[2] + 1 / _PHASES, 41)
        period = period_s
        phase = float(near[int(np.argmax([_gain(times, q, rest, period, p) for p in near]))])
    tooth = _tooth(times, q, period, phase)
    power = float(tooth @ tooth)
    heights = tooth @ rest / power
    left = rest - np.outer(tooth, heights)
    spare = times.size - degree - 4
    noise = np.sqrt((left**2).sum(axis=0) / spare)
    # What remains may remember: its neighbours' correlation makes the heights worse than white noise does.
    alike = np.clip((left[1:] * left[:-1]).sum(axis=0) / np.maximum((left**2).sum(axis=0), 1e-300), 0.0, 0.95)
    noise = noise * np.sqrt((1 + alike) / (1 - alike))
    sigma = noise / np.sqrt(power)
    statistic = float(np.sum((heights / np.maximum(sigma, 1e-300)) ** 2))
    tries = periods.size * _PHASES
    # Chi-square with two degrees; every period and phase that was tried counts.
    p_chance = float(min(1.0, tries * np.exp(-0.5 * statistic)))
    return Sawtooth(
        (Estimate(float(heights[0]), float(sigma[0])), Estimate(float(heights[1]), float(sigma[1]))),
        period,
        p_chance,
        phase,
        tries,
    )


def _tooth(times: FloatArray, q: FloatArray, period: float, phase: float) -> FloatArray:
    tooth = (times / period - phase) % 1.0 - 0.5
    return np.asarray(tooth - q @ (q.T @ tooth))


def _gain(times: FloatArray, q: FloatArray, rest: FloatArray, period: float, phase: float) -> float:
    tooth = _tooth(times, q, period, phase)
    return float(np.sum((tooth @ rest) ** 2)) / max(float(tooth @ tooth), 1e-300)
