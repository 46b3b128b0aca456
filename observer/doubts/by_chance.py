"""From how many sigmas on a contradiction is none of chance, where many modules or spans are judged alike."""

from statistics import NormalDist

#: A measurement of one module contradicts what was stated from so many sigmas on: by chance one in 370.
_TIMES_SIGMA = 3.0


def chance(n_alike: int) -> float:
    """Return how improbable something is that is not of chance: on either side of three sigma, in none of n modules."""
    return 2 * NormalDist().cdf(-_TIMES_SIGMA) / n_alike


def contradicting_sigmas(n_alike: int) -> float:
    """Return from how many sigmas on a module contradicts what was stated, or a span of its tube surely hangs.

    n_alike: Modules, or spans, that are judged alike.
    Returns: 3 for one; for more so many that one of them all does so by chance as seldom as one alone would
        (Bonferroni): of a hundred modules at three sigma one in four flights would have a false alarm.
    """
    return -NormalDist().inv_cdf(0.5 * chance(n_alike))
