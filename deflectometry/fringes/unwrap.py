"""Absolute fringe phase: the order of each fringe with the probability that it is wrong."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from deflectometry.fringes.phase import TURN_RAD
from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import AnyFloatArray, BoolArray, FloatArray, float_array, freeze

#: More candidates than this for the order of the coarsest set cost more than a better choice of periods.
MOST_CANDIDATES = 200


@dataclass(frozen=True, slots=True, eq=False)
class UnwrappedFraction:
    """Position on the display along one axis.

    fraction (...): Fraction of the displayed image, 0 to 1; noise may carry it a little beyond. NaN where no set is
        usable.
    sigma (...): Standard deviation of the fraction, given that the order is right.
    wrong_order_probability (...): Probability that the order of any of the sets is wrong, from the sigmas; 1 where
        no set is usable.
    """

    fraction: FloatArray
    sigma: FloatArray
    wrong_order_probability: FloatArray


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
            "(0.9 leaves a dead band at the edges), or unwrap in space"
        )
    return search


def unwrap_temporal(
    phases_rad: npt.ArrayLike, sigmas_rad: npt.ArrayLike, periods: Sequence[float]
) -> UnwrappedFraction:
    """Find absolute positions from the phases of several periods, pixel by pixel.

    phases_rad (m, ...): Wrapped phase of each set, ``2 pi periods w`` [rad].
    sigmas_rad (m, ...): Their standard deviations; infinite leaves a set out at that pixel [rad].
    periods length m: Periods of each set over the display, in any order, any ratios.
    Returns: Mean of all sets weighted by inverse variance, its sigma, and the probability of a wrong order.
    InputError: Shapes or periods that do not fit.
    EstimationError: Too many periods in the coarsest set.

    The coarsest set gives one candidate for each of its periods that may lie on the display (exactly one below 1
    period: its window is centred on the display, so that noise at an edge stays there instead of jumping by 1 /
    periods). Each candidate is refined by the next sets in turn: order = nearest whole number, then the mean by
    inverse variance. A candidate costs the chi-square of its misfits plus that of lying outside [0, 1]; the best
    wins, and the odds against the next (and against the neighbouring order at each step) are ``exp(difference of
    chi-square / 2)``. With whole periods everywhere w and w + 1 cannot be told apart at the edges; such samples carry
    a probability near 0.5. Sets like (15, 16) without a coarse one work the same way.

    >>> phases = 2 * np.pi * np.array([0.9, 7.0])[:, None] * np.array([0.0, 0.25, 1.0])
    >>> found = unwrap_temporal(phases, np.full((2, 3), 0.01), [0.9, 7.0])
    >>> found.fraction.round(9) + 0.0
    array([0.  , 0.25, 1.  ])
    """
    search = search_orders(periods)
    phases = np.asarray(phases_rad, dtype=np.float64)
    sigmas = np.asarray(sigmas_rad, dtype=np.float64)
    if phases.shape != sigmas.shape or phases.ndim < 1 or len(phases) != len(search.periods):
        raise InputError(
            f"unwrapping: phases {phases.shape} and sigmas {sigmas.shape} of {len(search.periods)} sets are needed"
        )
    cycles = [phases[i] / TURN_RAD for i in search.positions]
    with np.errstate(divide="ignore", invalid="ignore"):
        information = [
            np.nan_to_num((TURN_RAD * p / sigmas[i]) ** 2, nan=0.0, posinf=1e30)
            for p, i in zip(search.periods, search.positions, strict=True)
        ]
    fraction, total, log_odds = combine_orders(search, cycles, information)
    with np.errstate(divide="ignore", over="ignore"):
        sigma = 1.0 / np.sqrt(total)
        probability = np.where(total > 0, 1.0 / (1.0 + np.exp(log_odds)), 1.0)
    return UnwrappedFraction(
        freeze(np.where(total > 0, fraction, np.nan)), freeze(sigma), freeze(np.asarray(probability, dtype=np.float64))
    )


def combine_orders(
    search: OrderSearch, cycles: Sequence[npt.NDArray[Any]], information: Sequence[npt.NDArray[Any]]
) -> tuple[npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any]]:
    """Search the orders for a block of pixels; see `unwrap_temporal` for the model.

    cycles (...): Phase of each set in turns, coarsest first; float32 or float64.
    information (...): Inverse variance of the position from each set alone, coarsest first; zero leaves it out.
    fraction, information, log_odds (...): Position, its inverse variance, and the logarithm of the odds that every
        order is right.
    """
    coarsest = search.periods[0]
    base = cycles[0] - coarsest * 0.5
    base = base - np.rint(base)
    if search.candidates == 1:
        start = 0.5 + base * (1.0 / coarsest)
        fraction, total, odds, _ = _refine(search.periods, start, cycles, information)
        # The neighbouring window lies off the display by at least 1 / coarsest - 1, except at the window's own ends.
        off_center = np.abs(fraction - 0.5)
        off_here = np.maximum(off_center - 0.5, 0.0)
        off_there = np.maximum((1.0 / coarsest - 0.5) - off_center, 0.0)
        return fraction, total, np.minimum(odds, 0.5 * total * (off_there * off_there - off_here * off_here))
    shape, dtype = base.shape, base.dtype
    fraction, total, odds = np.zeros(shape, dtype), np.zeros(shape, dtype), np.zeros(shape, dtype)
    best, second = np.full(shape, np.inf, dtype), np.full(shape, np.inf, dtype)
    reach = search.candidates // 2
    for order in range(-reach, reach + 1):
        start = 0.5 + (base + dtype.type(order)) * (1.0 / coarsest)
        found, found_total, found_odds, cost = _refine(search.periods, start, cycles, information)
        off = np.maximum(np.abs(found - 0.5) - 0.5, 0.0)
        cost = cost + off * off * found_total
        better = cost < best
        second = np.where(better, best, np.minimum(second, cost))
        best = np.where(better, cost, best)
        fraction, odds = np.where(better, found, fraction), np.where(better, found_odds, odds)
        total = np.where(better, found_total, total)
    return fraction, total, np.minimum(odds, 0.5 * (second - best))


def _refine(
    periods: Sequence[float],
    start: npt.NDArray[Any],
    cycles: Sequence[npt.NDArray[Any]],
    information: Sequence[npt.NDArray[Any]],
) -> tuple[npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any]]:
    """Refine a position by each further set; return it with its information, the step's log odds and the chi-square."""
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
    return fraction, total, odds, cost


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


@dataclass(frozen=True, slots=True, eq=False)
class RelativePhase:
    """Phase unwrapped in space: known up to a whole number of turns for each connected region.

    phase_rad (h, w): Continuous phase [rad]; NaN outside the region. Not an absolute position on the display.
    region (h, w): Where it was unwrapped.
    """

    phase_rad: FloatArray
    region: BoolArray


def unwrap_spatial(phase_rad: AnyFloatArray, region: BoolArray) -> RelativePhase:
    """Unwrap one phase image in space, where no coarse set of fringes exists.

    Shapes: phase_rad (h, w).
    region (h, w): Pixels to unwrap; pixels that are not finite are left out.
    Returns: Relative by type: a known point or another measurement must fix the turns.
    InputError: Shapes differ.
    EstimationError: No usable pixel in the region.

    Reliability-sorted path of Herraez et al. 2002, from scikit-image. Neighbours must differ by less than half a
    turn.
    """
    from skimage.restoration import unwrap_phase  # 0.3 s to import, and few measurements need it

    wrapped = np.asarray(phase_rad, dtype=np.float64)
    if wrapped.ndim != 2 or region.shape != wrapped.shape:
        raise InputError(f"unwrap_spatial: a phase image and a region of its shape are needed, not {wrapped.shape}")
    usable = region & np.isfinite(wrapped)
    if not usable.any():
        raise EstimationError("unwrap_spatial: the region has no pixel with a phase")
    filled = np.ma.MaskedArray(np.where(usable, wrapped, 0.0), mask=~usable)
    unwrapped = np.ma.filled(unwrap_phase(filled), np.nan)  # type: ignore[no-untyped-call]
    return RelativePhase(freeze(np.asarray(unwrapped, dtype=np.float64)), freeze(usable))
