"""Levenberg-Marquardt for many small independent fits at once, each with a damping of its own."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from heliogauge.validate import BoolArray, FloatArray, IntArray

#: From rows and parameters (m, p) to residuals (m, k), observed minus model, and derivatives of the model (m, p, k).
Evaluate = Callable[[IntArray, FloatArray], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True, slots=True)
class Descent:
    """How fits descend; dampings are relative to the diagonal of the normal equations.

    first, down, up: Damping of the first step; its factors after a step that gained and one that did not.
    least, gone: A step that did not gain raises it to at least `least`; below `gone` one that did sets it to 0 (which
        needs a `least`).
    most: A fit damped more than this has its minimum, to round-off.
    rise: A cost larger by this share is no loss: round-off, or a step along a direction that hardly matters.
    ridge: Added to the diagonal.
    linear_below: The last step is taken without another evaluation where the damping is below this; 0: never.
    persistent: A step that does not gain is tried again, damped; else the fit does not settle.
    """

    most_steps: int
    first: float
    down: float
    up: float
    least: float = 0.0
    gone: float = 0.0
    most: float = np.inf
    rise: float = 0.0
    ridge: float = 0.0
    linear_below: float = 0.0
    persistent: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class SmallFits:
    """State of n fits of p parameters to k residuals each, changed in place.

    parameters (n, p), residuals (n, k), jacobian (n, p, k): Where each fit is.
    roots (n, k): Square roots of the weights.
    prior_mean, prior_weights (n, p): What is known of the parameters before; weights in units of the residuals'.
    settled (n,): Whether a fit has ended.
    """

    parameters: FloatArray
    residuals: npt.NDArray[Any]
    jacobian: npt.NDArray[Any]
    roots: npt.NDArray[Any]
    prior_mean: FloatArray
    prior_weights: FloatArray
    settled: BoolArray

    def costs(self, rows: IntArray, residuals: npt.NDArray[Any], parameters: FloatArray) -> FloatArray:
        """Return the weighted squares of some fits at other parameters, the prior's among them."""
        left = residuals * self.roots[rows]
        prior = (self.prior_weights[rows] * (self.prior_mean[rows] - parameters) ** 2).sum(axis=1)
        return np.asarray((left * left).sum(axis=1) + prior)


def descend(
    fits: SmallFits,
    active: IntArray,
    evaluate: Evaluate,
    is_last: Callable[[FloatArray], BoolArray],
    how: Descent,
    allow: Callable[[IntArray, FloatArray], BoolArray] | None = None,
) -> None:
    """Bring some fits to their minima.

    active: The rows that descend; residuals and derivatives of the others stay as they are.
    is_last: From steps (m, p) to whether they are so small that they are the last.
    allow: From rows and trial parameters, which it may limit in place, to whether those are possible.
    """
    count, precision = len(fits.parameters), fits.residuals.dtype
    damping, cost = np.full(count, how.first), np.full(count, np.inf)
    cost[active] = fits.costs(active, fits.residuals[active], fits.parameters[active])
    fits.settled[active] = False
    for _ in range(how.most_steps):
        if not active.size:
            return
        own = slice(None) if active.size == count else active
        here, jacobian = fits.parameters[own], fits.jacobian[own]
        step = _steps(fits, own, damping[own], how.ridge)
        trial = here + step
        allowed = np.ones(active.size, dtype=np.bool_) if allow is None else allow(active, trial)
        near = is_last(step)
        # So small a step that the model is linear in it.
        linear = allowed & near & (damping[own] < how.linear_below)
        ended = active[linear]
        fits.residuals[ended] -= (step[linear, None].astype(precision) @ jacobian[linear])[:, 0]
        fits.parameters[ended] = trial[linear]
        gained = allowed & ~linear
        rows = active[gained]
        residuals, derivatives = evaluate(rows, trial[gained])
        now = fits.costs(rows, residuals, trial[gained])
        better = now <= cost[rows] * (1 + how.rise)
        gained[gained] = better
        good, worse = active[gained], active[~(gained | linear)]
        fits.parameters[good], fits.residuals[good] = trial[gained], residuals[better]
        fits.jacobian[good], cost[good] = derivatives[better], now[better]
        damping[good] = np.where(damping[good] > how.gone, how.down * damping[good], 0.0)
        damping[worse] = np.maximum(how.up * damping[worse], how.least)
        done = linear | (damping[active] > how.most)
        if how.linear_below == 0:
            done |= gained & near
        fits.settled[active[done]] = True
        active = active[~done & (gained | how.persistent)]


def _steps(fits: SmallFits, own: Any, damping: FloatArray, ridge: float) -> FloatArray:
    """Solve the damped normal equations of some fits, shape (m, p)."""
    roots, prior = fits.roots[own], fits.prior_weights[own]
    weighted, left = fits.jacobian[own] * roots[:, None], fits.residuals[own] * roots
    normal = (weighted @ np.swapaxes(weighted, 1, 2)).astype(np.float64)
    diagonal = np.einsum("nii->ni", normal)
    diagonal += prior + ridge
    diagonal *= 1 + damping[:, None]
    right = (weighted @ left[:, :, None])[..., 0] + prior * (fits.prior_mean[own] - fits.parameters[own])
    try:
        return np.asarray(np.linalg.solve(normal, right[..., None])[..., 0])
    except np.linalg.LinAlgError:
        return np.asarray((np.linalg.pinv(normal, hermitian=True) @ right[..., None])[..., 0])
