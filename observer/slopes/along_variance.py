"""How large slopes along the trough are, from the reflection itself.

One pass does not determine the slope along the trough at a point, but how large such slopes are on the whole: both
edges of the tube are seen through one mirror point by cameras some 0.6 m apart, and where the line of sight is oblique
along the trough a slope along it moves them differently, by ``2 tan(incidence) w`` of it, w the half width of the tube
as the mirror point sees it. At 15 degrees this is a fortieth: 0.05 mrad for 2 mrad, below the noise of an edge, but all
edges of the mirror together determine the standard deviation.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from observer.slopes.joint_solution import SlopeErrors
from observer.slopes.row_spline import Roughness, RowGrid, TouchingLines, assemble

#: Standard deviations that are compared: this factor apart, from what does not matter any more to what no mirror has.
_FACTOR = float(np.sqrt(2.0))
_RANGE_RAD = (0.05e-3, 6e-3)
#: Lengths over which such slopes stay alike, from single waves to whole panels, equally probable beforehand [m].
_LENGTHS_M = (0.3, 1.0, 3.0)
#: The largest value that is still believed has a likelihood of exp(-2) of the best one's: two standard deviations.
_EVIDENCE_LOSS = 2.0
#: There clearly are such slopes from this gain of evidence on: 1.8 mrad gain 600 in a pass over an LS-2, systematic
#: errors of edges under clouds up to 40 where there are none.
_CLEAR_EVIDENCE = 100.0
#: Lengths that are less probable than the most probable one by this factor are left out: what they add to a variance is
#: below the square of a tenth of what they are apart.
_NO_WEIGHT = 1e-2


class PossibleRoughness(NamedTuple):
    """How slopes may vary along a row, and how probable it is that they do so."""

    probability: float
    roughness: Roughness


def find_along(lines: TouchingLines, grid: RowGrid, prior: Roughness) -> tuple[PossibleRoughness, ...]:
    """Return the largest standard deviations of slopes along the trough that the edges allow, the likeliest first.

    lines: Observations of slope errors from zero, with what rows have in common already taken off their misfits.
    prior: How slopes may vary, each row by itself, with the standard deviation that was assumed.
    Returns: For each length over which they may be alike, with how probable it is. Each with the upper bound of two
        standard deviations, but what was assumed where the photos say nothing, as from straight above; and where there
        clearly are such slopes 1.4 times the most probable value, because panels differ, or what was assumed if that
        is more and better than none.

    The edges of a dense pass over a trough of 8 m tell 0.3 m from 3 m by odds of 2 to 100 : 1 only, and the errors that
    slopes along make are three times as large where they are alike over a panel: so no length is chosen.
    """
    rows = assemble(lines, grid)
    pulls = rows.right_sides(lines.misfit_rad / lines.sigma_rad)

    def evidence_of(trial: Roughness) -> float:
        return rows.evidence(trial, pulls)

    found = [_largest(evidence_of, replace(prior, along_length_m=length)) for length in _LENGTHS_M]
    evidences = np.array([evidence for _, evidence in found])
    weights = np.exp(evidences - evidences.max())
    weights[weights < _NO_WEIGHT] = 0.0
    weights /= weights.sum()
    order = np.argsort(-weights, kind="stable")
    return tuple(PossibleRoughness(float(weights[k]), found[k][0]) for k in order if weights[k] > 0)


def _largest(evidence_of: Callable[[Roughness], float], prior: Roughness) -> tuple[Roughness, float]:
    """Return the largest standard deviation that is believed of a length, and the evidence of its most probable one."""
    lowest, highest = (round(float(np.log(end / prior.along_rad) / np.log(_FACTOR))) for end in _RANGE_RAD)

    def trial(power: int) -> Roughness:
        return replace(prior, along_rad=prior.along_rad * _FACTOR**power)

    @cache
    def evidence(power: int) -> float:
        return evidence_of(trial(power))

    # There is one maximum: uphill from what was assumed in factors of two, then in single ones.
    best = 0
    for stride in (2, 1):
        for way in (-stride, stride):
            while lowest <= best + way <= highest and evidence(best + way) > evidence(best):
                best += way
    largest = best
    while largest < max(best, 0) and evidence(largest + 1) > evidence(best) - _EVIDENCE_LOSS:
        largest += 1
    if evidence(best) - evidence(lowest) > _CLEAR_EVIDENCE:
        # There are such slopes: single panels may have more of them than the mean, and not less than was assumed where
        # that explains the edges better than none; what is left of edges' own errors looks like 0.2 mrad.
        largest = max(largest, best + 1, 0 if evidence(0) > evidence(lowest) else lowest)
    return trial(largest), evidence(best)


def averaged(models: Sequence[PossibleRoughness], found: Sequence[SlopeErrors]) -> SlopeErrors:
    """Return the mean of solutions under several models, with the scatter between them in the nodes' covariance.

    found: Of each model; the first one's common share stands for all.
    """
    slopes = np.sum([one.probability * each.slopes for one, each in zip(models, found, strict=True)], axis=0)
    random = np.zeros(found[0].random.shape)
    for one, each in zip(models, found, strict=True):
        apart = each.slopes - slopes
        random += one.probability * (each.random + apart[..., :, None] * apart[..., None, :])
    return replace(found[0], slopes=slopes, random=random)
