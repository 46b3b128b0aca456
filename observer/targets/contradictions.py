"""Which entries of a list of targets the others contradict, and whether it can be told which (Baarda's w-test)."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.validate import FloatArray, IntArray
from observer.doubts.by_chance import contradicting_sigmas

#: A coordinate of which a smaller share of an error shows in its residual is not checked: thirty sigma show as three.
_LEAST_REDUNDANCY = 0.01
#: So many entries of a list may be wrong together and be told from the others; more are named, and all are used.
_MOST_WRONG = 3
#: At most this share of all is left out: more are another list.
_MOST_SHARE = 0.25
#: Fewest targets that determine a frame.
_FEWEST = 3


@dataclass(frozen=True, slots=True)
class Contradiction:
    """Entries of a list that contradict each other by more than chance.

    targets: Each that may be wrong.
    told: Whether all of them are wrong: without them the others agree by their stated sigmas, and no others explain the
        contradiction.
    """

    targets: tuple[str, ...]
    told: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Left:
    """Coordinates of a list without some targets.

    gain: Squared residuals that go with these: chi-square if they are right.
    tests (n,): Baarda's w of the other coordinates; 0 where it cannot be checked.
    """

    gain: float
    tests: FloatArray

    @classmethod
    def without(cls, rows: IntArray, over_sigma: FloatArray, redundancy: FloatArray) -> "_Left":
        """Leave some coordinates out of an adjustment without adjusting again.

        rows (k,): Coordinates that are left out.
        """
        # What the others do not control of these takes up no contradiction.
        values, vectors = np.linalg.eigh(redundancy[np.ix_(rows, rows)])
        controlled = values > _LEAST_REDUNDANCY
        inverse = vectors[:, controlled] / values[controlled] @ vectors[:, controlled].T
        across = redundancy[:, rows] @ inverse
        own = np.diag(redundancy) - np.sum(across * redundancy[:, rows], axis=1)
        checked = own > _LEAST_REDUNDANCY
        checked[rows] = False
        rest = over_sigma - across @ over_sigma[rows]
        tests = np.where(checked, rest / np.sqrt(np.where(checked, own, 1.0)), 0.0)
        return cls(float(over_sigma[rows] @ inverse @ over_sigma[rows]), tests)


def find_contradiction(
    names: Sequence[str], over_sigma: FloatArray, redundancy: FloatArray, n_out: int = 0
) -> Contradiction | None:
    """Return which listed targets contradict the others, as few of them as explain it.

    names: Target of each listed coordinate.
    over_sigma (n,): Residuals of the adjusted coordinates over their stated sigmas. Where all scatter by more than
        stated that counts.
    redundancy (n, n): Cofactor of these residuals, ``I - H``.
    n_out: Targets that were left out before.
    Returns: None where the list agrees with itself.

    The residual of an adjusted coordinate has the variance ``1 - h``, not 1, and an error shows in those of its
    neighbours: which target is wrong is asked of the residuals ``r`` of each target, or of a few together, by
    ``r^T R^-1 r``, what the sum of squares loses without them. Others explain the contradiction as well where that is
    less by no more than the square of the limit: their likelihood is then not small against the number of choices.
    """
    listed = list(dict.fromkeys(names))
    rows = {name: np.flatnonzero([own == name for own in names]) for name in listed}
    most = min(int(_MOST_SHARE * (len(listed) + n_out)) - n_out, len(listed) - _FEWEST - 1, _MOST_WRONG)
    sigmas = contradicting_sigmas(len(names))

    def left(out: Sequence[str]) -> _Left:
        own = np.concatenate([np.zeros(0, np.intp), *(rows[name] for name in out)])
        return _Left.without(own, over_sigma, redundancy)

    def limit(out: Sequence[str], tests: FloatArray) -> float:
        """Return from how many sigmas on a test contradicts, by the scatter without the worst, which moves others."""
        worst = names[int(np.argmax(np.abs(tests)))]
        rest = left(list(dict.fromkeys([*out, worst]))).tests
        return sigmas * max(1.0, robust_scale(rest[rest != 0])) if rest.any() else sigmas

    all_used = left(()).tests
    limit_all = limit((), all_used)
    if np.abs(all_used).max(initial=0.0) <= limit_all:
        return None
    for count in range(1, 1 + max(most, 1)):
        sets = list(combinations(listed, count))
        gains = np.array([left(out).gain for out in sets])
        best = sets[int(np.argmax(gains))]
        tests = left(best).tests
        own_limit = limit(best, tests)
        if np.abs(tests).max() <= own_limit:
            may_be = [sets[k] for k in np.flatnonzero(gains >= gains.max() - own_limit**2)]
            targets = tuple(name for name in listed if any(name in out for out in may_be))
            # Of a list that scatters by more than stated nobody knows that the others agree.
            told = len(may_be) == 1 and count <= most and np.abs(tests).max() <= sigmas
            return Contradiction(targets, bool(told))
    strange = {name for name, size in zip(names, np.abs(all_used), strict=True) if size > limit_all}
    return Contradiction(tuple(name for name in listed if name in strange), told=False)
