"""Damped Gauss-Newton descent over any state, with an honest stop; the linear algebra is the caller's."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import FloatArray, positive

StateT = TypeVar("StateT")
EvaluationT = TypeVar("EvaluationT", bound="Evaluation")
EvaluationT_co = TypeVar("EvaluationT_co", bound="Evaluation", covariant=True)
# Quick down, slow up (Transtrum and Sethna 2012). Of the 27 NIST problems from start 2 all converge with these numbers
# (Bennett5 in 274 steps, the others in at most 283); Nielsen's rule stops short of Bennett5's minimum after 400.
_DAMPING_DOWN, _DAMPING_UP = 0.1, 2.0
EPSILON = float(np.finfo(np.float64).eps)


class LinearSystem(Protocol):
    """One linearised problem ``min |r + J step|``, scaled by column; dense, sparse or by Schur complement."""

    @property
    def scale(self) -> FloatArray:
        """Column scale used by the damping, shape (n,)."""
        ...

    @property
    def decrement(self) -> float:
        """Length of the part of the residuals that the undamped step would remove, ``|J step|``."""
        ...

    @property
    def rounding(self) -> float:
        """Rounding error of the residual vector's length; 0 if unknown."""
        ...

    @property
    def rank(self) -> int:
        """Number of parameter combinations that the observations determine."""
        ...

    def step(self, damping: float) -> tuple[FloatArray, float]:
        """Return the step of ``(J^T J + damping scale**2) step = -J^T r`` and the decrease of cost it promises."""
        ...


class Evaluation(Protocol):
    """Residuals at one state; the linear system is built only where the descent goes on from."""

    @property
    def cost(self) -> float:
        """Half the sum of the loss; not finite where the model cannot be evaluated."""
        ...

    @property
    def n_residuals(self) -> int:
        """Number of residuals, priors and constraints included."""
        ...

    def system(self, scale_floor: FloatArray | None) -> LinearSystem:
        """Linearise here; columns are scaled by their norm, or by ``scale_floor`` where that is larger."""
        ...


@dataclass(frozen=True, slots=True)
class Options:
    """How to iterate.

    max_iterations: Accepted or tried steps before the descent gives up.
    tolerance: Relative offset at which the descent has converged: the remaining step, in units of the parameters'
        own standard deviations (Bates and Watts 1981).
    initial_damping: Damping of the first step, relative to the squared column norms; 0 starts with a pure
        Gauss-Newton step.
    rank_tolerance: Singular values of the column-scaled Jacobian below this share of the largest count as zero.
    InputError: A number is out of its range.
    """

    max_iterations: int = 200
    tolerance: float = 1e-8
    initial_damping: float = 1e-6
    rank_tolerance: float = 1e-11

    def __post_init__(self) -> None:
        positive("tolerance", self.tolerance, "sigma")
        positive("rank_tolerance", self.rank_tolerance, "the largest singular value")
        if self.max_iterations < 1 or self.initial_damping < 0:
            raise InputError(
                f"max_iterations: at least 1 is needed, not {self.max_iterations}; "
                f"initial_damping: at least 0 is needed, not {self.initial_damping}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Descent(Generic[StateT, EvaluationT_co]):
    """Where a descent ended and why.

    state: The last accepted state.
    evaluation: The residuals there.
    converged: Whether the stop is a minimum to the stated tolerance.
    reason: Why the descent stopped, with numbers.
    iterations: Steps tried.
    """

    state: StateT
    evaluation: EvaluationT_co
    converged: bool
    reason: str
    iterations: int


def relative_offset(system: LinearSystem, cost: float, n_residuals: int) -> float:
    """Return the remaining step in units of the parameters' standard deviations.

    system: The linearised problem.
    cost: Half the sum of squares at the same place.
    Returns: ``|J step| / sqrt(rank)`` over ``|r + J step| / sqrt(n_residuals - rank)``; infinite without
        redundancy.

    Bates and Watts, Technometrics 23 (1981) 179: unlike a small step or a small change of the cost this cannot be
    met by a heavily damped crawl, because the undamped step enters.
    """
    rest = max(2 * cost - system.decrement**2, 0.0)
    freedom = n_residuals - system.rank
    if system.decrement == 0:
        return 0.0
    if freedom <= 0 or rest == 0:
        return float("inf")
    return float(system.decrement / np.sqrt(max(system.rank, 1)) / np.sqrt(rest / freedom))


def minimise(
    start: StateT,
    evaluate: Callable[[StateT], EvaluationT],
    retract: Callable[[StateT, FloatArray], StateT],
    *,
    options: Options | None = None,
) -> Descent[StateT, EvaluationT]:
    """Descend to a minimum of the cost with Levenberg-Marquardt steps.

    evaluate: State to `Evaluation`.
    retract: State and step, shape (n,), to the moved state.
    Returns: The last state; ``converged`` is False with the reason when it is not a minimum.
    EstimationError: The model cannot be evaluated at the start.

    Damping after Marquardt (scaled by column, scales never shrink), lowered or raised by the ratio of the real to the
    promised decrease. Where the promised decrease is below the rounding error of the cost the step is accepted
    unless the cost rises beyond rounding, so the gradient and not the noise of the cost decides about the end.
    """
    options = options or Options()
    state, here = start, evaluate(start)
    if not np.isfinite(here.cost):
        raise EstimationError(
            "least squares: the model gives values that are not finite at the start; give other start values"
        )
    first_cost, damping, blind = here.cost, options.initial_damping, 0
    system = here.system(None)
    reason = _stop(system, here, first_cost, options)
    for iteration in range(options.max_iterations):
        if reason:
            return Descent(state, here, True, reason, iteration)
        step, promised = system.step(damping)
        trial_state = retract(state, step)
        there = evaluate(trial_state)
        noise = 1e-13 * here.cost + 4 * np.sqrt(2 * here.cost) * system.rounding
        blind = blind + 1 if promised <= noise else 0
        gain = _gain(here.cost - there.cost, promised, noise)
        # Ten steps below the noise of the cost improve the gradient as far as its own rounding lets them.
        if damping > 1e12 or blind > 10:
            return _stalled(state, here, system, iteration + 1)
        if gain > 1e-4:
            state, here = trial_state, there
            # A step that keeps little of its promise went too far: undamped ones may hop across a minimum for ever.
            damping = damping * _DAMPING_DOWN if gain > 0.25 else max(damping, 1e-9) * _DAMPING_UP
            system = here.system(system.scale)
            reason = _stop(system, here, first_cost, options)
        else:
            damping = max(damping, 1e-9) * _DAMPING_UP
    offset = relative_offset(system, here.cost, here.n_residuals)
    text = f"not converged after {options.max_iterations} iterations: {offset:.1e} sigma still to go"
    return Descent(state, here, bool(reason), reason or text, options.max_iterations)


def _gain(decrease: float, promised: float, noise: float) -> float:
    """Real over promised decrease; 1 where the promise is below the noise of the cost and nothing got worse."""
    if not np.isfinite(decrease):
        return -1.0
    if promised <= noise:
        return 1.0 if decrease >= -noise else -1.0
    return decrease / promised


def _stop(system: LinearSystem, here: Evaluation, first_cost: float, options: Options) -> str:
    """Reason to stop at a minimum, or an empty string."""
    if here.cost <= (16 * EPSILON) ** 2 * first_cost:
        return "the residuals are zero to rounding"
    if system.decrement <= 4 * system.rounding:
        return "the remaining step is below the rounding error of the observations"
    offset = relative_offset(system, here.cost, here.n_residuals)
    if offset <= options.tolerance:
        return f"the remaining step is {offset:.1e} sigma"
    return ""


def _stalled(state: StateT, here: EvaluationT, system: LinearSystem, iteration: int) -> Descent[StateT, EvaluationT]:
    offset = relative_offset(system, here.cost, here.n_residuals)
    # 1e-4 sigma is far below what any user of the estimate can notice, and above the noise of single-precision models.
    fine = offset <= 1e-4
    text = f"the cost changes by rounding only, with {offset:.1e} sigma to go"
    stalled = f"stalled: no step lowers the cost, the linear model promises {offset:.1e} sigma; check the derivatives"
    return Descent(state, here, fine, text if fine else stalled, iteration)
