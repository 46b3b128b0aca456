"""Absolute fringe phase: the order of each fringe with the probability that it is wrong."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from deflectometry.fringes.phase import TURN_RAD
from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import FloatArray, float_array

#: More candidates than this for the order of the coarsest set cost more than a better choice of periods.
MOST_CANDIDATES = 200


@dataclass(frozen=True, slots=True, eq=False)
class OrderSearch:
    """Periods of one axis, coarsest first, and what follows from them.

    periods: Periods over the display, ascending.
    positions: Where each stood in the order given.
    """

    periods: tuple[float, ...]
    positions: tuple[int, ...]

    @property
    def candidates(self) -> int:
        """Number of orders of the coarsest set that may lie on the display."""
        # Below one period, a window of one period centred on the display is longer than the display.
        coarsest = self.periods[0]
        return 1 if coarsest < 1.0 else math.floor(coarsest) + 2


def search_orders(periods: Sequence[float]) -> OrderSearch:
    """Sort the periods of one axis and check that their orders can be searched.

    periods: Periods over the display, in any order.
    InputError: No periods, or one that is not positive.
    EstimationError: The coarsest set already has too many periods for the orders to be searched.
    """
    values = float_array("periods", list(periods), (None,))
    if values.size == 0 or not (values > 0).all():
        raise InputError(f"periods: positive numbers are needed, not {values.tolist()}")
    order = np.argsort(values, kind="stable")
    search = OrderSearch(tuple(float(values[i]) for i in order), tuple(int(i) for i in order))
    if search.candidates > MOST_CANDIDATES:
        raise EstimationError(
            f"unwrapping: the coarsest set has {search.periods[0]:g} periods; add a set with fewer than 1 "
            "(0.9 leaves a dead band at the edges)"
        )
    return search


class Position(NamedTuple):
    """Positions on the display along one axis, each of shape (...).

    fraction: Fraction of the displayed image; noise may move it a little beyond 0 and 1.
    information: Its inverse variance, given that the orders are right.
    log_odds: Logarithm of the odds that every order is right.
    """

    fraction: npt.NDArray[Any]
    information: npt.NDArray[Any]
    log_odds: npt.NDArray[Any]


def combine_orders(
    search: OrderSearch, cycles: Sequence[npt.NDArray[Any]], information: Sequence[npt.NDArray[Any]]
) -> Position:
    """Search the orders of all sets of one axis for a block of pixels.

    cycles (...): Phase of each set in turns, coarsest first; float32 or float64.
    information (...): Inverse variance of the position from each set alone, coarsest first; zero leaves it out.

    The coarsest set gives one candidate for each of its periods that may lie on the display (exactly one below 1
    period: its window is centred on the display, so that noise at an edge stays there instead of jumping by 1 /
    periods). Each candidate is refined by the next sets in turn: order = nearest whole number, then the mean by
    inverse variance. A candidate costs the chi-square of its misfits plus that of lying outside [0, 1]; the best
    wins, and the odds against the next (and against the neighbouring order at each step) are ``exp(difference of
    chi-square / 2)``. With whole periods everywhere w and w + 1 cannot be told apart at the edges; such samples have
    a probability near 0.5. Sets like (15, 16) without a coarse one work the same way.
    """
    coarsest = search.periods[0]
    base = cycles[0] - coarsest * 0.5
    base = base - np.rint(base)
    if search.candidates == 1:
        start = 0.5 + base * (1.0 / coarsest)
        found, _ = _refine(search.periods, start, cycles, information)
        # The neighbouring window lies off the display by at least 1 / coarsest - 1, except at the window's own ends.
        off_center = np.abs(found.fraction - 0.5)
        off_here = np.maximum(off_center - 0.5, 0.0)
        off_there = np.maximum((1.0 / coarsest - 0.5) - off_center, 0.0)
        against = 0.5 * found.information * (off_there * off_there - off_here * off_here)
        return found._replace(log_odds=np.minimum(found.log_odds, against))
    shape, dtype = base.shape, base.dtype
    chosen = Position(np.zeros(shape, dtype), np.zeros(shape, dtype), np.zeros(shape, dtype))
    best, second = np.full(shape, np.inf, dtype), np.full(shape, np.inf, dtype)
    reach = search.candidates // 2
    for order in range(-reach, reach + 1):
        start = 0.5 + (base + dtype.type(order)) * (1.0 / coarsest)
        found, cost = _refine(search.periods, start, cycles, information)
        off = np.maximum(np.abs(found.fraction - 0.5) - 0.5, 0.0)
        cost = cost + off * off * found.information
        better = cost < best
        second = np.where(better, best, np.minimum(second, cost))
        best = np.where(better, cost, best)
        chosen = Position(*(np.where(better, new, old) for new, old in zip(found, chosen, strict=True)))
    return chosen._replace(log_odds=np.minimum(chosen.log_odds, 0.5 * (second - best)))


def _refine(
    periods: Sequence[float],
    start: npt.NDArray[Any],
    cycles: Sequence[npt.NDArray[Any]],
    information: Sequence[npt.NDArray[Any]],
) -> tuple[Position, npt.NDArray[Any]]:
    """Refine a position by each further set; return it with the odds of the worst step, and the chi-square."""
    fraction, total = start, information[0]
    odds = np.full_like(start, np.inf)
    cost = np.zeros_like(start)
    for period, turns, weight in zip(periods[1:], cycles[1:], information[1:], strict=True):
        misfit = turns - fraction * period
        misfit -= np.rint(misfit)
        whole = total + weight
        share = weight / np.maximum(whole, 1e-30)
        # Inverse variance of the misfit in turns; the neighbouring order would misfit by 1 - |misfit| instead.
        certainty = total * share * (1.0 / period**2)
        step_odds = (0.5 - np.abs(misfit)) * certainty
        # A set left out at a pixel decides nothing there; most blocks have none.
        odds = np.minimum(odds, step_odds if weight.all() else np.where(weight > 0, step_odds, np.inf))
        cost += misfit * misfit * certainty
        fraction = fraction + misfit * share * (1.0 / period)
        total = whole
    return Position(fraction, total, odds), cost


def estimate_systematic_phase(
    search: OrderSearch, cycles: Sequence[FloatArray], information: Sequence[FloatArray]
) -> float:
    """Estimate the phase error beyond noise from how well neighbouring periods agree, pooled over pixels.

    cycles (n,): Phase of each set in turns, coarsest first.
    information (n,): Inverse variance of the position from each set's noise alone, coarsest first; zero leaves it
        out.
    Returns: Standard deviation of a phase error that is the same, in turns of its own fringe, for all sets [rad]; 0
        where noise explains the misfits within 5 standard errors.

    Harmonics of the display (gamma) shift the phase by an amount that does not depend on the period, so they spoil
    the position from a coarse set far more than that from a fine one. The median of the squared misfits over their
    variance is solved for; a few wrong orders or a spoilt corner of the image do not move it.
    """
    position, _, odds = combine_orders(search, cycles, information)
    squares, variances, factors = [], [], []
    for fine in range(1, len(search.periods)):
        coarse = fine - 1
        ratio = search.periods[coarse] / search.periods[fine]
        good = (information[coarse] > 0) & (information[fine] > 0) & (odds > 10.0)
        turns = cycles[fine][good]
        turns = turns + np.rint(position[good] * search.periods[fine] - turns)
        misfit = cycles[coarse][good] - ratio * turns
        squares.append((misfit - np.rint(misfit)) ** 2)
        noise = 1.0 / information[coarse][good] + 1.0 / information[fine][good]
        variances.append(search.periods[coarse] ** 2 * noise)
        factors.append(np.full(turns.shape, 1.0 + ratio**2))
    if not squares or sum(part.size for part in squares) < 100:
        return 0.0
    square, variance, factor = (np.concatenate(parts) for parts in (squares, variances, factors))
    # Median of a chi-square of one degree of freedom and the standard error of a sample's median.
    median, error = 0.4549, 1.06 / math.sqrt(square.size)
    if float(np.median(square / variance)) < median + 5 * error:
        return 0.0
    low, high = 0.0, 0.25
    for _ in range(20):
        middle = 0.5 * (low + high)
        enough = float(np.median(square / (variance + middle**2 * factor))) < median
        low, high = (low, middle) if enough else (middle, high)
    return TURN_RAD * high
