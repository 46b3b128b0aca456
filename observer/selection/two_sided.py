"""Edges that both sides of the tube agree on, where brightness does not say which edge of what is seen.

From far away a mirror's waves magnify the tube's reflection without limit and turn it round: each edge may be either of
the tube's two, or the rim of its glass. Taken for the wrong one it shifts the beam by the tube's width, or by what the
glass is wider; the rim of the glass to opposite sides on both sides. So where edges taken for the one side and for the
other say the same slope at a place, that is the mirror's.
"""

from itertools import pairwise

import numpy as np

from heliogauge.validate import BoolArray, FloatArray, IntArray

#: Edges within this distance across and along the trough are compared: slopes change by a milliradian across it [m].
_ACROSS_M, _ALONG_M = 0.1, 0.25
#: Edges agree within this share of half the tube's width: the rim of a usual glass is 0.6 of it off.
_AGREE_SHARE = 0.5


def cells_of(points_m: FloatArray) -> IntArray:
    """Return the number of the piece of the mirror in which each edge is compared.

    Shapes: points_m (m, 3), result (m,).
    """
    cell = np.floor(points_m[:, :2] / [_ACROSS_M, _ALONG_M]).astype(np.intp)
    return np.asarray(np.unique(cell, axis=0, return_inverse=True)[1].ravel(), dtype=np.intp)


def agreed_by_both(group: IntArray, side: FloatArray, shift_rad: FloatArray, half_rad: FloatArray) -> BoolArray:
    """Return which edges say what edges of both sides in the same piece of the mirror say.

    group (m,): Piece of the mirror that each is in.
    side (m,): Edge of the tube that each is taken for; one that may be either stands there as both.
    shift_rad (m,): By what angle the beam must be turned for the line of sight to touch the tube there [rad].
    half_rad (m,): Half the tube's width from there [rad].

    In each piece the stretch of angles with most edges of both sides, counted by the rarer side; edges near its middle
    agree.
    """
    agree = np.zeros(side.shape, dtype=bool)
    group = np.unique(group, return_inverse=True)[1].ravel()
    order = np.lexsort((shift_rad, group))
    ends = np.searchsorted(group[order], np.arange(group.max(initial=-1) + 2))
    for first, last in pairwise(ends.tolist()):
        own = order[first:last]
        agree[own] = _within(shift_rad[own], side[own], _AGREE_SHARE * float(np.median(half_rad[own])))
    return agree


def _within(shift_rad: FloatArray, side: FloatArray, width_rad: float) -> BoolArray:
    """Return which of sorted angles are near the middle of the stretch in which both sides have most; none without.

    Shapes: shift_rad, side, result (k,).
    """
    end = np.searchsorted(shift_rad, shift_rad + width_rad, side="right")
    counts = [_counts(side == sign, end) for sign in (-1.0, 1.0)]
    rarer = np.minimum(*counts)
    # Of stretches with as many of the rarer side the one with most edges.
    best = int(np.lexsort((counts[0] + counts[1], rarer))[-1])
    if rarer[best] == 0:
        return np.zeros(shift_rad.shape, dtype=bool)
    middle = float(np.median(shift_rad[best : end[best]]))
    return np.asarray(np.abs(shift_rad - middle) <= width_rad)


def _counts(which: BoolArray, end: IntArray) -> IntArray:
    """Return how many lie in the stretch that begins at each and ends before ``end``."""
    before = np.concatenate([[0], np.cumsum(which)])
    return np.asarray(before[end] - before[:-1])
