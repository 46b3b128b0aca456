"""Along the trough: values of a row that its neighbours on the panel do not bear out, and values that are missing.

Each row of the map was solved alone (`observer.slope_field`). Along a column of one panel the slope error is again an
integrated random walk, whose roughness is taken from the rows' own values. It bridges what no edge of the reflection
came near to: the last centimetres beside panel edges, and islands around which the level curves of theta_ra run.
"""

from dataclasses import dataclass

import numpy as np

from heliogauge.validate import BoolArray, FloatArray
from observer.banded import factorise
from observer.slope_field import IntArray

#: A value further than this from what its neighbours along the trough say is wrong, in standard deviations.
_REJECT_TIMES = 5.0
#: Distance at which the roughness along the trough is read: several rows, so that noise is the smaller part [m].
_ROUGHNESS_REACH_M = 0.2
#: The least roughness [rad^2 / m^3], as in `observer.joint_solution`.
_LEAST_ROUGHNESS = 1e-8
#: Keeps columns without any value solvable [rad].
_LARGEST_SLOPE_RAD = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Bridged:
    """Values of all nodes from those along the trough.

    Parameters
    ----------
    value : ndarray, shape (r, nx)
        Slope error [rad].
    variance : ndarray, shape (r, nx)
        Its variance, with that of the values it rests on [rad^2].
    contradicted : ndarray of bool, shape (r, nx)
        Values that their neighbours do not bear out.
    """

    value: FloatArray
    variance: FloatArray
    contradicted: BoolArray


def bridge_rows(value: FloatArray, variance: FloatArray, good: BoolArray, panel: IntArray, step_m: float) -> Bridged:
    """Interpolate values along the columns of each panel.

    Parameters
    ----------
    value, variance : ndarray, shape (r, nx)
        Slope error of each node and its variance [rad, rad^2].
    good : ndarray of bool, shape (r, nx)
        Which to rest on.
    panel : ndarray of int, shape (r, nx)
        Panel of each node, -1 for none.
    step_m : float
        Distance of the rows [m].

    Returns
    -------
    Bridged
        Interpolated and extrapolated values.

    Notes
    -----
    Neighbouring values share errors (the slope along the trough, say), so their variance is not reduced by averaging:
    that of the nearest values is added to the variance of the interpolation.
    """
    rows = value.shape[0]
    joined = ((panel[1:] == panel[:-1]) & (panel[1:] >= 0)).any(axis=1)
    roughness = _roughness(value, variance, good, joined, step_m)
    kept = good
    for _ in range(2):
        smooth, spread = _smooth(
            np.where(kept, value, 0.0), np.where(kept, 1 / variance, 0.0), joined, roughness, step_m
        )
        kept = good & (np.abs(value - smooth) < _REJECT_TIMES * np.sqrt(variance + spread))
    smooth, spread = _smooth(np.where(kept, value, 0.0), np.where(kept, 1 / variance, 0.0), joined, roughness, step_m)
    own, _ = _smooth(np.where(kept, variance, 0.0), np.where(kept, 1e12, 0.0), joined, 1e-6, step_m)
    base = np.maximum(own, float(np.median(variance[kept])) if kept.any() else 0.0)
    return Bridged(smooth[:rows], (spread + base)[:rows], good & ~kept)


def _roughness(value: FloatArray, variance: FloatArray, good: BoolArray, joined: BoolArray, step_m: float) -> float:
    """Return the spectral density of the second derivative along the trough [rad^2 / m^3]."""
    lag = max(1, round(_ROUGHNESS_REACH_M / step_m))
    if value.shape[0] <= 2 * lag:
        return 1.0
    run = np.concatenate([[0], np.cumsum(joined)])
    whole = (run[2 * lag :] - run[: -2 * lag] == 2 * lag)[:, None]
    triple = good[2 * lag :] & good[lag:-lag] & good[: -2 * lag] & whole
    if np.count_nonzero(triple) < 50:
        return 1.0
    second = (value[2 * lag :] - 2 * value[lag:-lag] + value[: -2 * lag])[triple]
    noise = (variance[2 * lag :] + 4 * variance[lag:-lag] + variance[: -2 * lag])[triple]
    # An integrated random walk has second differences of the variance 2/3 q h^3 at the distance h.
    # Four fifths of a normal distribution lie within 1.28 sigma; wrong values are in the rest.
    excess = (float(np.quantile(np.abs(second), 0.8)) / 1.2816) ** 2 - float(np.median(noise))
    return max(1.5 * excess / (lag * step_m) ** 3, _LEAST_ROUGHNESS)


def _smooth(
    value: FloatArray, weight: FloatArray, joined: BoolArray, roughness: float, step_m: float
) -> tuple[FloatArray, FloatArray]:
    """Return the smoothing spline of each column and its variance."""
    rows, columns = value.shape
    count = rows + rows % 2
    bands = np.zeros((3, count))
    bands[0] = _LARGEST_SLOPE_RAD**-2
    stiffness = (joined[:-1] & joined[1:]) / (roughness * step_m**3)
    parts = (1.0, -2.0, 1.0)
    for first in range(3):
        for other in range(first, 3):
            bands[other - first, first : first + rows - 2] += parts[first] * parts[other] * stiffness
    whole = np.repeat(bands.T[None], columns, axis=0)
    whole[:, :rows, 0] += weight.T
    factor = factorise(whole)
    right = np.zeros((columns, count))
    right[:, :rows] = (weight * value).T
    spread = np.diagonal(factor.inverse_blocks(), axis1=2, axis2=3).reshape(columns, count)
    return factor.solve(right).T[:rows], spread.T[:rows]
