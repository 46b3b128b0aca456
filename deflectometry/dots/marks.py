"""Marks in a field of dots: large and small ones, by which every part of the field says which part it is."""

from dataclasses import dataclass

import numpy as np

from deflectometry.dots.found_dots import FoundDots
from deflectometry.dots.turns import TURNS
from heliogauge.errors import EstimationError
from heliogauge.validate import BoolArray, FloatArray, IntArray

#: Chance that the size of a dot is read wrong, where the photo does not say it better.
_LEAST_WRONG, _MOST_WRONG = 1e-3, 0.45
#: A place of the field with less probability than this is not said.
_SURE = 0.999
#: Dots around a dot whose sizes say what is large there.
_AROUND = 48


@dataclass(frozen=True, slots=True, eq=False)
class DotTable:
    """The dots of a pattern with their sizes.

    number (n, 2): Columns to the right and rows upwards.
    large (n,): Which are the large ones.
    u, v (n,): Their fractions of the displayed image; NaN for a print.
    """

    number: IntArray
    large: BoolArray
    u: FloatArray
    v: FloatArray

    @property
    def on_display(self) -> bool:
        """Whether the dots have places on a display."""
        return bool(np.isfinite(self.u).all())

    def fractions(self, number: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return u and v of dots by their numbers."""
        place = {tuple(one): k for k, one in enumerate(self.number.tolist())}
        index = [place[tuple(one)] for one in number.tolist()]
        return self.u[index], self.v[index]

    def grid(self) -> tuple[FloatArray, IntArray]:
        """Return 1 for large, -1 for small and 0 for no dot, by column and row, and the number of the first."""
        low = self.number.min(axis=0)
        signs = np.zeros(tuple((self.number.max(axis=0) - low + 1).tolist()))
        signs[tuple((self.number - low).T)] = np.where(self.large, 1.0, -1.0)
        return signs, low


def number_by_marks(dots: FoundDots, table: DotTable, photo: str, *, mirrored: bool = False) -> IntArray:
    """Return the numbers in the table of the dots that a photo shows.

    dots: Numbered by the photo's own lattice, rows downwards.
    photo: Its name, for messages.
    mirrored: Whether the pattern is seen in a mirror; it is then found mirrored only.
    EstimationError: The sizes fit no place, or several.

    Every turn and place of the lattice is a hypothesis; its odds are those of the sizes that are read right and wrong.
    A dot with sizes a in the table and b in the photo counts log((1 - p) / p), with p the chance of a wrong reading by
    how far the sizes of the two kinds are apart in the photo.
    """
    from scipy.signal import fftconvolve

    score, wrong = read_sizes(dots)
    signs, low = table.grid()
    evidence = float(np.log((1.0 - wrong) / wrong))
    found: list[tuple[float, IntArray, IntArray]] = []
    for turn in TURNS:
        # Rows of the photo run downwards and those of the table upwards: the same sense has determinant -1.
        if (np.linalg.det(turn) > 0) != mirrored:
            continue
        number = dots.number @ turn.T
        first = number.min(axis=0)
        seen = np.zeros(tuple((number.max(axis=0) - first + 1).tolist()))
        seen[tuple((number - first).T)] = score
        agreement = fftconvolve(signs, seen[::-1, ::-1])
        best = np.argsort(agreement, axis=None)[-4:]
        for flat in best.tolist():
            at = np.array(np.unravel_index(flat, agreement.shape)) - np.array(seen.shape) + 1
            found.append((float(agreement.flat[flat]), turn, low - first + at))
    odds = evidence * 0.5 * np.array([one[0] for one in found])
    weight = np.exp(odds - odds.max())
    weight /= weight.sum()
    chosen = int(np.argmax(weight))
    agreeing, turn, shift = found[chosen]
    share = 0.5 + 0.5 * agreeing / len(score)
    # Of two sizes at random half agree, with a spread of the root of the number over two; so do the best of all places.
    places = signs.size * len(TURNS)
    by_chance = 0.5 + np.sqrt(np.log(places) / (2.0 * len(score)))
    if weight[chosen] < _SURE or share < by_chance:
        raise EstimationError(
            f"{photo}: the sizes of {len(score)} dots do not say which part of the pattern is seen (best place: "
            f"{share:.0%} agree, by chance up to {by_chance:.0%}); is it the pattern of this table, and "
            + ("seen in a mirror?" if mirrored else "not mirrored?")
        )
    return np.asarray(dots.number @ turn.T + shift)


def read_sizes(dots: FoundDots) -> tuple[FloatArray, float]:
    """Return 1 for large dots and -1 for small ones, and the chance of a wrong one.

    EstimationError: All dots are equally large.

    Sizes are compared with those around: illumination and perspective change them over the field. Two kinds leave a gap
    between their sizes; the chance is that of a normal spread of each kind beyond the middle between both.
    """
    from scipy.spatial import cKDTree
    from scipy.stats import norm

    size = np.asarray(dots.size, dtype=np.float64)
    near = cKDTree(dots.centers_px).query(dots.centers_px, min(_AROUND, len(size)))[1]
    around = size[near]
    low, high = np.nanpercentile(around, 15, axis=1), np.nanpercentile(around, 85, axis=1)
    relative = (size - 0.5 * (low + high)) / np.maximum(high - low, 1e-12)
    relative[~np.isfinite(relative)] = 0.0
    score = np.where(relative > 0, 1.0, -1.0)
    kinds = [relative[score > 0], relative[score < 0]]
    if min(len(one) for one in kinds) < 3:
        raise EstimationError("all dots are equally large: this is no pattern with marks")
    middles = [float(np.median(one)) for one in kinds]
    spread = float(
        np.sqrt(np.mean([np.median(np.abs(one - middle)) ** 2 for one, middle in zip(kinds, middles, strict=True)]))
    )
    wrong = float(norm.sf((middles[0] - middles[1]) / 2.0 / max(1.4826 * spread, 1e-12)))
    return score, float(np.clip(wrong, _LEAST_WRONG, _MOST_WRONG))
