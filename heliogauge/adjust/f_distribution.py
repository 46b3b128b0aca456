"""Tail of the F distribution, in plain Python: a diagnosis of a heliostat in milliseconds needs no scipy.special."""

import math

_TINY = 1e-300


def f_tail(value: float, freedom: float, spare: float) -> float:
    """Return the probability that a ratio of two variances is larger than a value.

    value: Ratio of the mean squares.
    freedom, spare: Degrees of freedom of numerator and denominator, above 0.
    Returns: Regularised incomplete beta function I_x(spare / 2, freedom / 2) with x = spare / (spare + freedom value),
        by its continued fraction (NIST Digital Library of Mathematical Functions, 8.17.22).

    >>> round(f_tail(4.0, 2, 10), 12)
    0.052922149401
    """
    if value <= 0:
        return 1.0
    a, b = 0.5 * spare, 0.5 * freedom
    x = spare / (spare + freedom * value)
    rest = freedom * value / (spare + freedom * value)
    both = math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b) + a * math.log(x) + b * math.log(rest)
    if x < (a + 1) / (a + b + 2):
        return math.exp(both) * _fraction(a, b, x) / a
    return 1.0 - math.exp(both) * _fraction(b, a, rest) / b


def _fraction(a: float, b: float, x: float) -> float:
    """Continued fraction of the incomplete beta function, by Lentz's method."""
    c, d = 1.0, 1 / _away(1 - (a + b) * x / (a + 1))
    result = d
    for m in range(1, 1000):
        for numerator in (
            m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m)),
            -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1)),
        ):
            d = 1 / _away(1 + numerator * d)
            c = _away(1 + numerator / c)
            result *= c * d
        if abs(c * d - 1) < 1e-15:
            break
    return result


def _away(value: float) -> float:
    return value if abs(value) > _TINY else _TINY
