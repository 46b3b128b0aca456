"""What the sizes of dots say about their place in the pattern: which are large, and how well that fits each place."""

from dataclasses import dataclass

import numpy as np

from deflectometry.dots.found_dots import FEWEST_DOTS, FoundDots
from deflectometry.setup.dot_marks import DotMarks
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, IntArray

#: Chance that a dot is not as large as it looks, whatever the light says: dust on it, a bad print.
_WRONG = 0.02
#: Rounds in which sizes and their ground follow each other: with a ground that is even, sloped, bent (terms of each). A
#: bent one from the start takes the sizes of 25 dots for its own bends.
_ROUNDS = (1,) * 4 + (3,) * 4 + (6,) * 12
#: Least scatter of the logarithm of a dot's light: a per cent, as centres and cells are known.
_LEAST_SCATTER = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class MarkEvidence(ShortRepr):
    """Which dots of a lattice are large, with odds, before a pattern whose sizes are known.

    number (n, 2): Columns and rows of the dots whose size is seen.
    of_large, of_small (n,): Log odds against chance that such a dot of the pattern looks so.
    marks: The pattern.
    """

    number: IntArray
    of_large: FloatArray
    of_small: FloatArray
    marks: DotMarks

    @classmethod
    def of(cls, dots: FoundDots, marks: DotMarks) -> "MarkEvidence":
        """Tell large and small dots apart by their light per cell of the lattice.

        A mirror that magnifies makes dot and cell larger alike, and blur leaves the light as it is: what is left
        changes slowly over the mirror. That, its scatter and the sizes are found together.
        """
        light = dots.contrast_dn * np.sqrt(np.linalg.det(dots.outlines_px2)) / _cells_px2(dots)
        seen = np.isfinite(light) & (light > 0) & ~dots.is_cut
        number = dots.number[seen]
        if len(number) < FEWEST_DOTS:
            nothing = np.zeros(len(number))
            return cls(number, nothing, nothing, marks)
        large = _share_of_large(np.log(light[seen]), number, marks.area_step)
        large = _WRONG + (1.0 - 2.0 * _WRONG) * large
        return cls(number, np.log(2.0 * large), np.log(2.0 * (1.0 - large)), marks)

    def of_shifts(self, turn: IntArray, low: IntArray, high: IntArray) -> FloatArray:
        """Return the log odds against chance of all shifts from low to high (2,), shape (columns, rows) of them.

        turn (2, 2): Numbers in the table are turn @ numbers of the lattice + shift. A dot that is not in the table is
        as likely as chance.
        """
        from scipy.signal import fftconvolve

        number = self.number @ turn.T
        start = number.min(axis=0)
        size = number.max(axis=0) - start + 1
        seen = np.zeros((2, *size))
        at = tuple((number - start).T)
        seen[0][at], seen[1][at] = self.of_large, self.of_small
        # The table from low + start to high + the last number, columns first and rows upwards.
        column, row = (np.arange(low[k] + start[k], high[k] + start[k] + size[k]) for k in (0, 1))
        table = self._large(column[:, None], row[None, :])
        odds = sum(
            fftconvolve(table == which, one[::-1, ::-1], mode="valid") for which, one in ((1, seen[0]), (0, seen[1]))
        )
        return np.asarray(odds, dtype=np.float64)

    def _large(self, column: IntArray, row: IntArray) -> IntArray:
        """Return which dots of the table are large, by their numbers; -1 where it has none."""
        across, down = np.broadcast_arrays(column - self.marks.first[0], self.marks.first[1] - row)
        rows, columns = self.marks.large.shape
        there = (across >= 0) & (across < columns) & (down >= 0) & (down < rows)
        return np.where(there, self.marks.large[np.where(there, down, 0), np.where(there, across, 0)], -1)


def _cells_px2(dots: FoundDots) -> FloatArray:
    """Return the area of the photo that belongs to each dot, (n,) [px^2]; NaN without neighbours along both axes."""
    at = dots.number - dots.number.min(axis=0) + 1
    grid = np.full((*(at.max(axis=0) + 2), 2), np.nan)
    grid[at[:, 0], at[:, 1]] = dots.centers_px
    steps = []
    for off in np.eye(2, dtype=np.intp):
        after, before = grid[tuple((at + off).T)], grid[tuple((at - off).T)]
        both = np.stack([after - dots.centers_px, dots.centers_px - before])
        count = np.isfinite(both).sum(axis=0)
        steps.append(np.where(count > 0, np.nansum(both, axis=0) / np.maximum(count, 1), np.nan))
    (x, y), (x1, y1) = steps[0].T, steps[1].T
    return np.asarray(np.abs(x * y1 - y * x1))


def _share_of_large(log_light: FloatArray, number: IntArray, area_step: float) -> FloatArray:
    """Return the probability of each dot to be large, (n,).

    A mixture of two normal distributions ``area_step`` apart about a quadratic of column and row: expectation and
    maximisation in turn.
    """
    place = (number - number.mean(axis=0)) / np.maximum(np.ptp(number, axis=0), 1)
    x, y = place.T
    terms = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    large, scatter = np.full(len(x), 0.5), 0.5 * area_step
    for count in _ROUNDS:
        ground = terms[:, :count]
        off = log_light - ground @ np.linalg.lstsq(ground, log_light - large * area_step, rcond=None)[0]
        large = 1.0 / (1.0 + np.exp(np.clip((0.5 * area_step - off) * area_step / scatter**2, -50.0, 50.0)))
        square = (1.0 - large) * off**2 + large * (off - area_step) ** 2
        scatter = max(float(np.sqrt(square.mean())), _LEAST_SCATTER)
    return large
