"""How large slopes along the trough are, from the reflection itself.

One pass does not determine the slope along the trough at a point, but how large such slopes are on the whole: both
edges of the tube are seen through one mirror point by cameras some 0.6 m apart, and where the line of sight is oblique
along the trough a slope along it moves them differently, by ``2 tan(incidence) w`` of it, w the half width of the tube
as the mirror point sees it. At 15 degrees this is a fortieth: 0.05 mrad for 2 mrad, below the noise of an edge, but all
edges of the mirror together determine the standard deviation.
"""

from dataclasses import replace

import numpy as np

from observer.slopes.common_elimination import Reduction
from observer.slopes.row_spline import Roughness, RowGrid, TouchingLines

#: Standard deviations that are compared: this factor apart, from what does not matter any more to what no mirror has.
_FACTOR = float(np.sqrt(2.0))
_RANGE_RAD = (0.05e-3, 6e-3)
#: Lengths over which such slopes stay alike, from single waves to whole panels [m].
_LENGTHS_M = (0.3, 1.0, 3.0)
#: The largest value that is still believed has a likelihood of exp(-2) of the best one's: two standard deviations.
_EVIDENCE_LOSS = 2.0
#: There clearly are such slopes from this gain of evidence on: 1.8 mrad gain 600 in a pass over an LS-2, systematic
#: errors of edges under clouds up to 40 where there are none.
_CLEAR_EVIDENCE = 100.0


def find_along(lines: TouchingLines, grid: RowGrid, prior: Roughness) -> Roughness:
    """Return the largest standard deviation of slopes along the trough that the edges allow.

    lines: Observations of slope errors from zero, with what rows have in common already taken off their misfits.
    prior: How slopes may vary, with the standard deviation that was assumed.
    Returns: With the upper bound of two standard deviations, but what was assumed where the photos say nothing, as
        from straight above; and where there clearly are such slopes 1.4 times the most probable value, because
        panels differ, or what was assumed if that is more and better than none. And with the length over which they
        are alike.
    """
    lowest, highest = (round(float(np.log(end / prior.along_rad) / np.log(_FACTOR))) for end in _RANGE_RAD)
    known: dict[tuple[int, float], float] = {}
    reduction = Reduction(lines, grid, np.zeros((0, 0)))

    def trial(power: int, length_m: float) -> Roughness:
        return replace(prior, along_rad=prior.along_rad * _FACTOR**power, along_length_m=length_m)

    def evidence(power: int, length_m: float) -> float:
        if (power, length_m) not in known:
            known[power, length_m] = reduction.under(trial(power, length_m)).evidence
        return known[power, length_m]

    # There is one maximum: uphill from what was assumed in factors of two, then with the best length in single ones.
    best, length = 0, prior.along_length_m
    for stride in (2, 1):
        for way in (-stride, stride):
            while lowest <= best + way <= highest and evidence(best + way, length) > evidence(best, length):
                best += way
        # Slopes that do not matter have no length either.
        if stride == 2 and best > lowest + 1:
            likely = max(_LENGTHS_M, key=lambda each: evidence(best, each))
            # What hardly any edge determines is not believed: along 3 m slopes of chance would move the whole map.
            length = likely if evidence(best, likely) > evidence(best, length) + _EVIDENCE_LOSS else length
    largest = best
    while largest < max(best, 0) and evidence(largest + 1, length) > evidence(best, length) - _EVIDENCE_LOSS:
        largest += 1
    if evidence(best, length) - evidence(lowest, length) > _CLEAR_EVIDENCE:
        # There are such slopes: single panels may have more of them than the mean, and not less than was assumed where
        # that explains the edges better than none; what is left of edges' own errors looks like 0.2 mrad.
        largest = max(largest, best + 1, 0 if evidence(0, length) > evidence(lowest, length) else lowest)
    return trial(largest, length)
