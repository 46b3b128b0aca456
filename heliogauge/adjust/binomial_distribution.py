"""Tail of the binomial distribution, in plain Python, for numbers of trials that overflow binomial coefficients."""

from heliogauge.adjust.f_distribution import f_tail


def binomial_tail(hits: int, trials: int, chance: float) -> float:
    """Return the probability of so many hits or more.

    hits, trials: Numbers, trials above 0.
    chance: Of a hit in one trial, 0 to 1.
    Returns: Regularised incomplete beta function I_chance(hits, trials - hits + 1) (NIST Digital Library of
        Mathematical Functions, 8.17.5), which a thousand trials do not overflow.

    >>> round(binomial_tail(2, 5, 0.1), 12)
    0.08146
    """
    if hits <= 0:
        return 1.0
    if hits > trials or chance <= 0:
        return 0.0
    if chance >= 1:
        return 1.0
    misses = trials - hits + 1
    return f_tail(hits * (1 - chance) / (chance * misses), 2 * misses, 2 * hits)
