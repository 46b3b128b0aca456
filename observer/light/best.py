"""Where a measured trough collects most: the tracking offset, and the place of its absorber."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from heliogauge.errors import EstimationError
from heliogauge.validate import FloatArray
from observer.light.beam import BeamProfile
from observer.light.cases import Case, MeasuredTrough, joined, optics_of, sensitivity
from observer.light.intercept import TroughOptics

#: Steps for second differences of the intercept factor: large beside the table's rounding, small beside its widths.
_OFFSET_STEP_RAD = 1e-3
_SHIFT_STEP_M = 1e-3
#: How near the best offset is found, and the first step of the absorber towards its best place.
_OFFSET_TOLERANCE_RAD, _FIRST_STEP_M = 1e-7, 5e-3
#: The best place is found where a first step more would gain less than this. Factors from the table and their slopes
#: agree to 1e-10 of the light: beyond 0.1 um, a ten-thousandth of its sigma, the place has no meaning.
_LEAST_SLOPE = 1e-8
#: Steps until a maximum is found, at most; a golden section comes from 2 mrad to the tolerance in 21.
_MOST_STEPS = 60
#: Share of the longer side at which a golden section cuts; sides more unequal than this are cut so.
_GOLDEN, _LONG_SIDE = 0.381966, 0.01
#: Bends are computed again where a step leaves more than this share of the slope.
_SLOWLY = 0.3
#: Two intercept factors from the table differ by this and are equal.
_ROUND_OFF = 1e-12
#: An absorber farther away from its best place than this was not measured by the reflection [m].
_LARGEST_SHIFT_M = 0.05
#: Curvature below which the place of a maximum means nothing: 1e-5 of the light is lost at one step beside it.
_LEAST_LOSS = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class Best:
    """Where an intercept factor is largest.

    place (p,): The offset of the sun [rad], or the absorber's way (x, z) from where it is [m].
    covariance (p, p): Its covariance; NaN where the maximum is too flat to have a place.
    ratio: The intercept factor there.
    """

    place: FloatArray
    covariance: FloatArray
    ratio: float


def best_offset(trough: MeasuredTrough, case: Case, optics: TroughOptics, largest_rad: float = 0.02) -> Best:
    """Find the tracking offset that collects most.

    Returns: The offset of the sun towards +x.
    EstimationError: It lies beyond the largest.
    """
    coarse = np.linspace(-largest_rad, largest_rad, 21)
    ratios = np.array([optics.ratio(offset) for offset in coarse])
    # Of a flat top the middle.
    top = np.flatnonzero(ratios >= ratios.max() - _LEAST_LOSS)
    if top[0] == 0 or top[-1] == coarse.size - 1:
        raise EstimationError(
            f"tracking offset: the best one lies beyond {1e3 * largest_rad:g} mrad; are mirror and absorber in the "
            "same frame?"
        )
    middle = float(coarse[(top[0] + top[-1]) // 2])
    best = _top_between(optics.ratio, float(coarse[top[0] - 1]), middle, float(coarse[top[-1] + 1]))
    step = _OFFSET_STEP_RAD
    sides = (best - step, best, best + step)
    bend = np.array([[np.array([1.0, -2.0, 1.0]) @ [optics.ratio(one) for one in sides] / step**2]])
    slope = joined([sensitivity(trough, case, optics, one) for one in (sides[0], sides[2])]).mixed(
        np.array([[-1.0, 1.0]]) / (2 * step)
    )
    covariance = _covariance_of_maximum(bend, trough.covariance(slope), step)
    return Best(np.array([best]), covariance, optics.ratio(best))


def best_absorber(trough: MeasuredTrough, optics: TroughOptics, profile: BeamProfile) -> Best:
    """Find the way by which the whole absorber should be moved to collect most, the sun on the optical axis.

    EstimationError: It is longer than 50 mm.
    """

    def at(way_m: FloatArray) -> TroughOptics:
        # Linear in the way: 10 mm at 1.5 m leave out 0.04 mrad of a window of 45 mrad.
        windows = optics.windows
        return replace(
            optics, windows=windows.moved(windows.d_lower_d_absorber @ way_m, windows.d_upper_d_absorber @ way_m)
        )

    def slope(way_m: FloatArray) -> FloatArray:
        return np.asarray(at(way_m).gradients()[1].sum(axis=0))

    way = _climbed(lambda place: at(place).ratio(), slope)
    if np.abs(way).max() > _LARGEST_SHIFT_M:
        raise EstimationError(
            f"absorber: its best place is more than {1e3 * _LARGEST_SHIFT_M:g} mm from where it was measured; are "
            "mirror and absorber in the same frame?"
        )
    mixed = []
    for one in _SHIFT_STEP_M * np.eye(2):
        sides = [sensitivity(trough, Case.AS_MEASURED, at(way + turn * one)) for turn in (1.0, -1.0)]
        mixed.append(joined(sides).mixed(np.array([[1.0, -1.0]]) / (2 * _SHIFT_STEP_M)))
    covariance = _covariance_of_maximum(_bend(slope, way), trough.covariance(joined(mixed)), _SHIFT_STEP_M)
    path = trough.absorber
    moved = replace(path, x_m=path.x_m + way[0], z_m=path.z_m + way[1])
    return Best(way, covariance, optics_of(replace(trough, absorber=moved), Case.AS_MEASURED, profile).ratio())


def _top_between(value: Callable[[float], float], low: float, middle: float, high: float) -> float:
    """Return where a function is largest between two places, to `_OFFSET_TOLERANCE_RAD`.

    middle: A place between both where it is at least as large as at them.

    The vertex of the parabola through the three best places, as long as it comes nearer; else a golden section of the
    longer side (Brent 1973, chapter 5).
    """
    places = [low, middle, high]
    values = [value(one) for one in places]
    for _ in range(_MOST_STEPS):
        low, middle, high = places
        if high - low < 2 * _OFFSET_TOLERANCE_RAD:
            break
        to_low, to_high = middle - low, high - middle
        rise_low, rise_high = (values[1] - values[0]) / to_low, (values[1] - values[2]) / to_high
        total = rise_low + rise_high
        vertex = middle + 0.5 * (to_high * rise_low - to_low * rise_high) / total if total > 0 else middle
        near = 0.5 * _OFFSET_TOLERANCE_RAD
        if abs(vertex - middle) < near:
            # Beside the place that is known, on the longer side, so that this one becomes shorter.
            vertex = middle + (near if to_high > to_low else -near)
        elif not low + near < vertex < high - near or min(to_low, to_high) < _LONG_SIDE * max(to_low, to_high):
            vertex = middle + (_GOLDEN * to_high if to_high > to_low else -_GOLDEN * to_low)
        found = value(vertex)
        at = 1 if vertex < middle else 2
        places.insert(at, vertex)
        values.insert(at, found)
        first = 0 if values[1] >= values[2] else 1
        places, values = places[first : first + 3], values[first : first + 3]
    return places[1]


def _bend(slope: Callable[[FloatArray], FloatArray], way_m: FloatArray) -> FloatArray:
    """Return the second derivatives of the intercept factor with respect to the absorber's way, shape (2, 2)."""
    steps = _SHIFT_STEP_M * np.eye(2)
    bend = np.stack([(slope(way_m + one) - slope(way_m - one)) / (2 * _SHIFT_STEP_M) for one in steps])
    return 0.5 * (bend + bend.T)


def _climbed(value: Callable[[FloatArray], float], slope: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Return the way from zero to the maximum that lies uphill, or one that is longer than `_LARGEST_SHIFT_M`.

    Newton's steps with the sizes of the bends, so that they go uphill everywhere, no longer than what has proved good.
    """
    way, reach = np.zeros(2), _FIRST_STEP_M
    before, up = value(way), slope(way)
    bends: tuple[FloatArray, FloatArray] | None = None
    for _ in range(_MOST_STEPS):
        if np.abs(up).max() * _FIRST_STEP_M < _LEAST_SLOPE or np.abs(way).max() > _LARGEST_SHIFT_M:
            break
        if bends is None:
            bends = np.linalg.eigh(_bend(slope, way))
        sizes, axes = np.maximum(np.abs(bends[0]), _LEAST_SLOPE / _FIRST_STEP_M**2), bends[1]
        step = axes @ ((axes.T @ up) / sizes)
        length = float(np.linalg.norm(step))
        step *= min(1.0, reach / length)
        after = value(way + step)
        if after < before - _ROUND_OFF:
            reach, bends = 0.25 * min(length, reach), None
            continue
        was = float(np.linalg.norm(up))
        way, before, up = way + step, after, slope(way + step)
        if length > reach:
            reach *= 2
        # With bends that have changed steps become small slowly.
        if float(np.linalg.norm(up)) > _SLOWLY * was:
            bends = None
    return way


def _covariance_of_maximum(bend: FloatArray, covariance_of_slope: FloatArray, step: float) -> FloatArray:
    """Return the covariance of where a function is largest, from its second derivatives and its slope's covariance."""
    if np.linalg.eigvalsh(-bend)[0] * step**2 < 2 * _LEAST_LOSS:
        return np.full(bend.shape, np.nan)
    inverse = np.linalg.inv(bend)
    return np.asarray(inverse @ covariance_of_slope @ inverse.T)
