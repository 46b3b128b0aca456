"""Chi-square distribution and the test of a variance factor, in plain Python.

Importing scipy.special takes 0.18 s of CPU: 13 % of the whole command on a small facet, which needs nothing else of it
(benchmarks/facet_command.py, median of 9 pairs).
"""

import math
from functools import lru_cache
from statistics import NormalDist

from heliogauge.errors import InputError


def chi_square_cdf(value: float, freedom: float) -> float:
    """Return the probability that a chi-square variable stays below a value.

    value: Upper limit.
    freedom: Degrees of freedom, above 0.
    Returns: Regularised incomplete gamma function P(freedom / 2, value / 2): series below the mean, continued
        fraction above (Abramowitz and Stegun 6.5.29, 6.5.31).

    >>> round(chi_square_cdf(3.841458820694124, 1), 12)
    0.95
    """
    a, x = 0.5 * freedom, 0.5 * value
    if x <= 0:
        return 0.0
    scale = math.exp(a * math.log(x) - x - math.lgamma(a))
    if x < a + 1:
        term = total = 1.0 / a
        n = a
        while term > total * 1e-16:
            n += 1
            term *= x / n
            total += term
        return scale * total
    return 1.0 - scale * _upper_fraction(a, x)


def _upper_fraction(a: float, x: float) -> float:
    """Continued fraction of the upper incomplete gamma function, by Lentz's method."""
    b = x + 1 - a
    c, d = 1e300, 1 / b
    result = d
    # 10,000 terms serve up to 10 million degrees of freedom; the loop ends after about sqrt(a) of them.
    for i in range(1, 10_000):
        numerator = -i * (i - a)
        b += 2
        d = 1 / (numerator * d + b)
        c = b + numerator / c
        result *= c * d
        if abs(c * d - 1) < 1e-15:
            break
    return result


@lru_cache(maxsize=1024)
def chi_square_quantile(probability: float, freedom: float) -> float:
    """Return the value below which a chi-square variable stays with a given probability.

    probability: Between 0 and 1.
    freedom: Degrees of freedom, above 0.
    Returns: The quantile: Wilson and Hilferty's start, then bisection to 1e-12.
    InputError: The probability is not between 0 and 1, or there is no freedom.

    >>> round(chi_square_quantile(0.95, 10), 9)
    18.307038053
    """
    if not (0 < probability < 1 and freedom > 0):
        raise InputError(f"chi-square: probability {probability} in (0, 1) and freedom {freedom} > 0 are needed")
    spread = 2 / (9 * freedom)
    start = freedom * max(1 - spread + NormalDist().inv_cdf(probability) * math.sqrt(spread), 0.05) ** 3
    low, high = start, start
    while chi_square_cdf(low, freedom) > probability:
        low *= 0.9
    while chi_square_cdf(high, freedom) < probability:
        high *= 1.1
    while high - low > 1e-12 * high:
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        low, high = (middle, high) if chi_square_cdf(middle, freedom) < probability else (low, middle)
    return 0.5 * (low + high)


def chi_square_limit(probability: float, freedom: float) -> float:
    """Return the value that a chi-square variable exceeds with a given (small) probability.

    >>> round(chi_square_limit(0.05, 1), 4), round(chi_square_limit(0.01, 8), 4)
    (3.8415, 20.0902)
    """
    return chi_square_quantile(1 - probability, freedom)


@lru_cache(maxsize=1024)
def chi_square_noncentrality(value: float, freedom: float, probability: float) -> float:
    """Return the noncentrality with which a chi-square variable stays below a value with a given probability.

    value: Limit, above 0.
    freedom: Degrees of freedom, above 0.
    probability: Below that of a central variable, above 0.
    Returns: The noncentrality by bisection to 1e-12; its distribution is the mean of central ones with freedom + 2 j,
        j from Poisson's distribution of mean noncentrality / 2 (Abramowitz and Stegun 26.4.25).
    InputError: A probability that no noncentrality has.

    >>> round(chi_square_noncentrality(3.841458820694124, 1, 0.1), 4)
    10.5074
    """
    if not 0 < probability < chi_square_cdf(value, freedom):
        raise InputError(
            f"chi-square: a probability between 0 and {chi_square_cdf(value, freedom):.6g} is needed, not {probability}"
        )
    central: list[float] = []
    while not central or central[-1] > 1e-17:
        central.append(chi_square_cdf(value, freedom + 2 * len(central)))

    def below(noncentrality: float) -> float:
        mean = 0.5 * noncentrality
        return math.fsum(
            one * math.exp(j * math.log(mean) - mean - math.lgamma(j + 1)) for j, one in enumerate(central)
        )

    low, high = 0.0, 1.0
    while below(high) > probability:
        low, high = high, 2 * high
    while high - low > 1e-12 * high:
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        low, high = (middle, high) if below(middle) > probability else (low, middle)
    return 0.5 * (low + high)


def two_sided_probability(value: float, freedom: float) -> float:
    """Return the probability that a chi-square variable is at least this far in its tail, on either side."""
    below = chi_square_cdf(value, freedom)
    return 2 * min(below, 1 - below)


class VarianceFactorTests:
    """Tests of a variance factor, exact for normal errors and plain least squares, a guide with a robust loss."""

    __slots__ = ()
    variance_factor: float
    redundancy: int

    def variance_factor_interval(self, confidence: float = 0.95) -> tuple[float, float]:
        """Return the interval in which the variance factor lies if the stated sigmas are right; NaN if untested."""
        if self.redundancy <= 0:
            return float("nan"), float("nan")
        tail = 0.5 * (1 - confidence)
        low, high = (chi_square_quantile(p, self.redundancy) / self.redundancy for p in (tail, 1 - tail))
        return low, high

    def variance_factor_probability(self) -> float:
        """Return the probability that the variance factor is at least this far in its tail (two-sided) by chance."""
        if self.redundancy <= 0:
            return float("nan")
        return two_sided_probability(self.variance_factor * self.redundancy, self.redundancy)
