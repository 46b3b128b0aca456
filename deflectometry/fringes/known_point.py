"""Fringes of one period only: orders counted from pixel to pixel, from a point whose place on the display is known."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from deflectometry.fringes.phase import TURN_RAD, LightResponse, linear_light, solve_steps
from deflectometry.setup.patterns import Axis, FringePattern, FringeSet
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import BoolArray, FloatArray, float_array, positive

#: Below this share of the usual modulation a pixel's phase is no step on the way to its neighbours.
_LEAST_MODULATION = 0.3
#: Neighbours whose unwrapped phases differ by another number of turns than the wrapped ones: where more than this share
#: of them do, no way from pixel to pixel is sure.
_MOST_CUTS = 0.01
#: Standard deviations that the known point may be off, at the least, before another order would be nearer.
_SURE_SIGMAS = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class KnownDisplayPoint:
    """A point of the image whose place on the display is known.

    image_px (2,): Where it is in the image, x and y [px].
    display (2,): Which fractions u and v of the displayed image are seen there.
    sigma_display (2,): Standard deviations of these fractions; one number stands for both.
    is_stated: Whether somebody states it; otherwise it follows from the mirror's pose.
    InputError: A sigma that is not positive.
    """

    image_px: FloatArray
    display: FloatArray
    sigma_display: FloatArray
    is_stated: bool = True

    def __post_init__(self) -> None:
        both = np.broadcast_to(np.asarray(self.sigma_display, dtype=np.float64), 2)
        object.__setattr__(self, "sigma_display", both)
        for name in ("image_px", "display", "sigma_display"):
            object.__setattr__(self, name, float_array(f"known point {name}", getattr(self, name), (2,)))
        for one in self.sigma_display.tolist():
            positive("known point sigma_display", one, "fractions of the displayed image")

    def sigma_shift(self, pattern: FringePattern) -> FloatArray:
        """Return the standard deviations of u and v that all pixels share, shape (2,).

        0 where three sigma are less than half a period: then the order is sure, and the phase gives the rest.
        """
        sigma = np.zeros(2)
        for number, axis in enumerate(Axis):
            periods = coarsest_set(pattern, axis)[0].periods
            if periods >= 1.0 and _SURE_SIGMAS * self.sigma_display[number] > 0.5 / periods:
                sigma[number] = self.sigma_display[number]
        return sigma

    def doubt(self, pattern: FringePattern) -> Doubt:
        """Say what rests on the point."""
        sigma = self.sigma_shift(pattern)
        periods = [coarsest_set(pattern, axis)[0].periods for axis in Axis]
        counted = " and ".join(
            f"{axis} ({number:g} periods)" for axis, number in zip(Axis, periods, strict=True) if number >= 1
        )
        share = float(self.sigma_display.max())
        numbers = {"sigma_display_share": share}
        known = "[pattern.known_point], which is known" if self.is_stated else "the mirror's pose, which gives it"
        if not sigma.any():
            return Doubt(
                "orders_from_known_point",
                f"fringes of {counted} have no coarser ones: their orders are counted from pixel to pixel, from "
                f"{known} to less than a sixth of a period. Parts of the mirror that hang together by no pixels are "
                "left out, and a step of the surface by which the fringes jump half a period would pass unseen",
                numbers,
                Severity.NOTE,
            )
        remedy = "give the point more precisely"
        if not self.is_stated:
            remedy = "say which point of the display one pixel sees ([pattern.known_point])"
        return Doubt(
            "known_point_uncertain",
            f"fringes of {counted} have no coarser ones: their orders are counted from {known} to {share:.2g} of the "
            "display only, more than a sixth of a period: slopes are relative. All of them share an error, which is in "
            "their sigmas: it tilts the mirror as a whole and stretches its curvature. Show a set below one period, or "
            f"{remedy}",
            numbers,
        )


def coarsest_set(pattern: FringePattern, axis: Axis) -> tuple[FringeSet, slice]:
    """Return the set of fewest periods of an axis, and its frames."""
    return min(pattern.sets_of(axis), key=lambda pair: pair[0].periods)


def has_open_orders(pattern: FringePattern) -> bool:
    """Return whether all sets of an axis look the same after a shift by whole periods that stays on the display.

    >>> from deflectometry.setup.patterns import make_pattern
    >>> [has_open_orders(make_pattern(one, (0.9,))) for one in ((16,), (8, 16), (0.9, 16), (15, 16), (1.0, 7))]
    [True, True, False, False, False]
    """
    for axis in Axis:
        periods = sorted(fringes.periods for fringes, _ in pattern.sets_of(axis))
        shifts = np.arange(1, np.ceil(periods[0])) / periods[0]
        turns = np.multiply.outer(shifts, periods)
        # Harmless: periods are typed with a few digits.
        if (np.abs(turns - np.rint(turns)) < 1e-6).all(axis=1).any():
            return True
    return False


def counted_positions(
    frames: npt.NDArray[Any],
    pattern: FringePattern,
    region: BoolArray,
    point: KnownDisplayPoint,
    response: LightResponse | None,
) -> dict[Axis, FloatArray]:
    """Return the position on the display that each pixel sees, for axes whose fringes have no order of their own.

    frames (n, h, w): Frames in the order of the pattern [DN].
    region (h, w): Pixels of the mirror.
    Returns (h, w): Fraction by axis, from its coarsest set; NaN where no pixels lead from the known point.
    InputError: Every axis has a set below one period, so that nothing is to be counted.
    EstimationError: The point is not on the mirror, or the phase steps by half a period between neighbours.
    """
    found = {}
    for number, axis in enumerate(Axis):
        fringes, where = coarsest_set(pattern, axis)
        if fringes.periods < 1.0:
            continue
        light, _ = linear_light(frames[where][:, region].astype(np.float64), response)
        _, cosine, sine = solve_steps(fringes.steps_rad).estimate @ light
        modulation = np.hypot(cosine, sine)
        good = np.zeros(region.shape, dtype=np.bool_)
        good[region] = modulation > _LEAST_MODULATION * np.median(modulation)
        turns = np.zeros(region.shape)
        turns[region] = np.arctan2(sine, cosine) / TURN_RAD
        counted = _count_turns(turns, good, _nearest(good, point), fringes, axis)
        at_point = _read(counted, point.image_px)
        # Of all whole numbers of turns, the one that brings the point nearest to where it is known to be.
        order = round(float(point.display[number]) * fringes.periods - at_point)
        found[axis] = (counted + order) / fringes.periods
    if not found:
        raise InputError(
            "[pattern.known_point]: both axes have a set below one period, whose orders need no point; leave it out"
        )
    return found


def _nearest(good: BoolArray, point: KnownDisplayPoint) -> int:
    """Return the flat index of the pixel of the mirror that the point lies on."""
    column, row = point.image_px
    rows, columns = np.nonzero(good)
    away = np.hypot(rows - row, columns - column)
    if not away.size or away.min() > 1.0:
        raise EstimationError(
            f"[pattern.known_point]: image_px = [{column:g}, {row:g}] is not on the mirror, where fringes are seen"
            + (f"; the nearest such pixel is {away.min():.0f} px away" if away.size else "")
        )
    return int(np.ravel_multi_index((rows[away.argmin()], columns[away.argmin()]), good.shape))


def _read(counted: FloatArray, image_px: FloatArray) -> float:
    """Return the value at a point of the image: that of a plane through the pixels around it."""
    column, row = np.rint(image_px).astype(int)
    rows, columns = slice(max(row - 1, 0), row + 2), slice(max(column - 1, 0), column + 2)
    around = counted[rows, columns]
    y, x = np.mgrid[rows.start : rows.start + around.shape[0], columns.start : columns.start + around.shape[1]]
    seen = np.isfinite(around)
    plane = np.stack([np.ones(seen.sum()), x[seen] - image_px[0], y[seen] - image_px[1]], axis=1)
    return float(np.linalg.lstsq(plane, around[seen], rcond=None)[0][0])


def _count_turns(turns: FloatArray, good: BoolArray, start: int, fringes: FringeSet, axis: Axis) -> FloatArray:
    """Add whole turns so that neighbours differ by less than half of one, from a pixel to all that pixels lead to.

    Pairs of neighbours are joined in the order of their reliability (Herraez et al. 2002, in scikit-image), which says
    nothing of what it cannot join: that is counted here, and refused.
    """
    from skimage.measure import label
    from skimage.restoration import unwrap_phase

    parts = label(good, connectivity=1)
    part = parts == parts.flat[start]
    # The library wants radians and starts at a pixel of its own choice; whole turns are taken from it alone.
    unwrapped = np.ma.getdata(unwrap_phase(np.ma.array(TURN_RAD * turns, mask=~part), rng=0)) / TURN_RAD
    order = np.rint(unwrapped - turns)
    result = np.where(part, turns + order - order.flat[start], np.nan).ravel()
    index = np.arange(turns.size).reshape(turns.shape)
    pairs = []
    for first, second in ((index[:, :-1], index[:, 1:]), (index[:-1], index[1:])):
        both = part.flat[first] & part.flat[second]
        pairs.append(np.stack([first[both], second[both]]))
    one, other = np.concatenate(pairs, axis=1)
    step = turns.flat[other] - turns.flat[one]
    step -= np.rint(step)
    cut = np.abs(result[other] - result[one] - step) > 0.5
    if np.count_nonzero(cut) > _MOST_CUTS * max(step.size, 1):
        raise EstimationError(
            f"{axis} fringes, {fringes.periods:g} periods: they step by half a period and more between neighbouring "
            f"pixels ({np.count_nonzero(cut) / step.size:.1%} of them contradict each other), so that their orders "
            "cannot be counted; show fewer periods, or come nearer with the camera"
        )
    # Where two ways to a pixel disagree neither is believed.
    result[one[cut]] = np.nan
    result[other[cut]] = np.nan
    return result.reshape(turns.shape)
