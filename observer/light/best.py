"""Where a measured trough collects most: the tracking offset, and the place of its absorber."""

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
    from scipy.optimize import minimize_scalar

    coarse = np.linspace(-largest_rad, largest_rad, 21)
    ratios = np.array([optics.ratio(offset) for offset in coarse])
    # Of a flat top the middle.
    top = np.flatnonzero(ratios >= ratios.max() - _LEAST_LOSS)
    if top[0] == 0 or top[-1] == coarse.size - 1:
        raise EstimationError(
            f"tracking offset: the best one lies beyond {1e3 * largest_rad:g} mrad; are mirror and absorber in the "
            "same frame?"
        )
    found = minimize_scalar(
        lambda offset: -optics.ratio(offset),
        bounds=(float(coarse[top[0] - 1]), float(coarse[top[-1] + 1])),
        method="bounded",
        options={"xatol": _OFFSET_TOLERANCE_RAD},
    )
    best = float(found.x)
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
    from scipy.optimize import minimize

    def at(way_m: FloatArray) -> TroughOptics:
        # Linear in the way: 10 mm at 1.5 m leave out 0.04 mrad of a window of 45 mrad.
        windows = optics.windows
        return replace(
            optics, windows=windows.moved(windows.d_lower_d_absorber @ way_m, windows.d_upper_d_absorber @ way_m)
        )

    def slope(way_m: FloatArray) -> FloatArray:
        return np.asarray(at(way_m).gradients()[1].sum(axis=0))

    def lost(way: FloatArray) -> tuple[float, FloatArray]:
        return -at(_FIRST_STEP_M * way).ratio(), -_FIRST_STEP_M * slope(_FIRST_STEP_M * way)

    # In units of the first step: BFGS begins with a step of length one.
    way = _FIRST_STEP_M * minimize(lost, np.zeros(2), jac=True, method="BFGS", options={"gtol": _LEAST_SLOPE}).x
    if np.abs(way).max() > _LARGEST_SHIFT_M:
        raise EstimationError(
            f"absorber: its best place is more than {1e3 * _LARGEST_SHIFT_M:g} mm from where it was measured; are "
            "mirror and absorber in the same frame?"
        )
    steps = _SHIFT_STEP_M * np.eye(2)
    bend = np.stack([(slope(way + one) - slope(way - one)) / (2 * _SHIFT_STEP_M) for one in steps])
    mixed = []
    for one in steps:
        sides = [sensitivity(trough, Case.AS_MEASURED, at(way + turn * one)) for turn in (1.0, -1.0)]
        mixed.append(joined(sides).mixed(np.array([[1.0, -1.0]]) / (2 * _SHIFT_STEP_M)))
    covariance = _covariance_of_maximum(0.5 * (bend + bend.T), trough.covariance(joined(mixed)), _SHIFT_STEP_M)
    path = trough.absorber
    moved = replace(path, x_m=path.x_m + way[0], z_m=path.z_m + way[1])
    return Best(way, covariance, optics_of(replace(trough, absorber=moved), Case.AS_MEASURED, profile).ratio())


def _covariance_of_maximum(bend: FloatArray, covariance_of_slope: FloatArray, step: float) -> FloatArray:
    """Return the covariance of where a function is largest, from its second derivatives and its slope's covariance."""
    if np.linalg.eigvalsh(-bend)[0] * step**2 < 2 * _LEAST_LOSS:
        return np.full(bend.shape, np.nan)
    inverse = np.linalg.inv(bend)
    return np.asarray(inverse @ covariance_of_slope @ inverse.T)
