"""Weighted, robust adjustment of named parameters: priors, constraints, datum, rank, covariance."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic

import numpy as np

from heliogauge.adjust.covariance import Facts, assemble
from heliogauge.adjust.dense_system import DenseSystem, factorise
from heliogauge.adjust.gauss_newton import Options, StateT, minimise
from heliogauge.adjust.robust_loss import Cauchy, Huber, Loss, Squares, Tukey, block_lengths
from heliogauge.adjust.solution import CovarianceScale, Solution
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import BoolArray, FloatArray, positive

__all__ = [
    "POSE",
    "POSE_NAMES",
    "VECTOR",
    "Cauchy",
    "Chart",
    "Constraint",
    "CovarianceScale",
    "Huber",
    "Options",
    "Prior",
    "Problem",
    "Solution",
    "Squares",
    "Tukey",
    "solve",
    "whitened",
]


@dataclass(frozen=True, slots=True, eq=False)
class Chart(Generic[StateT]):
    """How a state is moved by a step and written as numbers.

    retract: State and step, shape (n,), to the moved state; derivatives are taken with respect to the step at zero.
    coordinates: State to numbers, shape (n,), for tables and priors.
    """

    retract: Callable[[StateT, FloatArray], StateT]
    coordinates: Callable[[StateT], FloatArray]


def _add(state: FloatArray, step: FloatArray) -> FloatArray:
    return np.asarray(state + step)


def _same(state: FloatArray) -> FloatArray:
    return np.array(state, dtype=np.float64)


def _pose_moved(pose: RigidTransform, step: FloatArray) -> RigidTransform:
    return pose.moved(step)


def _pose_coordinates(pose: RigidTransform) -> FloatArray:
    return np.concatenate([pose.rotation_vector_rad, pose.translation_m])


VECTOR: Chart[FloatArray] = Chart(_add, _same)
"""Plain parameters: the step is added."""

POSE: Chart[RigidTransform] = Chart(_pose_moved, _pose_coordinates)
"""A pose moved by `RigidTransform.moved`; its coordinates are rotation vector and translation."""

POSE_NAMES = (
    "rotation_x_rad",
    "rotation_y_rad",
    "rotation_z_rad",
    "translation_x_m",
    "translation_y_m",
    "translation_z_m",
)


@dataclass(frozen=True, slots=True)
class Prior:
    """A value known before, as one more observation of one coordinate.

    name: Name of the parameter; it must be one to which the step is added (not a rotation: use `Constraint` there).
    value: The known value, in the parameter's unit.
    sigma: Its standard deviation, in the parameter's unit.
    InputError: The sigma is not positive.
    """

    name: str
    value: float
    sigma: float

    def __post_init__(self) -> None:
        positive(f"prior of {self.name}: sigma", self.sigma, "the parameter's unit")


@dataclass(frozen=True, slots=True, eq=False)
class Constraint(Generic[StateT]):
    """Something known about the state, with sigma, as more observations that no robust loss weakens.

    name: What is known ("distance screen to mirror").
    evaluate: State to residuals (predicted minus known), shape (k,), and their derivatives by the step, shape (k,
        n).
    sigma: Standard deviation of the residuals.
    InputError: The sigma is not positive.
    """

    name: str
    evaluate: Callable[[StateT], tuple[FloatArray, FloatArray]]
    sigma: float

    def __post_init__(self) -> None:
        positive(f"constraint {self.name}: sigma", self.sigma, "the residual's unit")


@dataclass(frozen=True, slots=True, eq=False)
class Problem(Generic[StateT]):
    """What is observed and what is sought.

    names length n: Names of the parameters, with units.
    evaluate: State to whitened residuals (predicted minus observed over sigma), shape (m,), and their derivatives
        by the step, shape (m, n); `whitened` divides by sigmas or covariance blocks.
    chart: How a state moves: `VECTOR` for plain arrays, `POSE` for a rigid transform, or the caller's.
    held: Parameters that stay at their start value.
    extra: Further knowledge with its sigma.
    datum: State to constraint columns, shape (n, d): steps and covariance obey ``columns.T @ step = 0``. Unit
        columns give minimal constraints, the null space of the observations (of chosen points) gives inner
        constraints.
    InputError: A name is repeated or unknown.
    """

    names: tuple[str, ...]
    evaluate: Callable[[StateT], tuple[FloatArray, FloatArray]]
    chart: Chart[StateT]
    held: tuple[str, ...] = ()
    extra: tuple[Prior | Constraint[StateT], ...] = ()
    datum: Callable[[StateT], FloatArray] | None = None

    def __post_init__(self) -> None:
        if len(set(self.names)) != len(self.names):
            raise InputError("names: every parameter needs a name of its own")
        asked = [*self.held, *(item.name for item in self.extra if isinstance(item, Prior))]
        unknown = [name for name in asked if name not in self.names]
        if unknown:
            raise InputError(f"{', '.join(unknown)}: no such parameter; there are {', '.join(self.names)}")


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Residuals and derivatives at one state, observations first, then priors and constraints."""

    residuals: FloatArray
    jacobian: FloatArray
    n_observations: int
    weights: FloatArray
    cost: float
    values: FloatArray
    constraints: FloatArray | None
    rank_tolerance: float

    @property
    def n_residuals(self) -> int:
        return self.residuals.size

    def system(self, scale_floor: FloatArray | None) -> DenseSystem:
        root = np.sqrt(self.weights)
        return self.factorised(root, scale_floor)

    def leverages(self, root: FloatArray, system: DenseSystem) -> FloatArray:
        spread = (self.jacobian * root[:, None]) @ system.cofactor_root()
        return np.asarray(np.einsum("ij,ij->i", spread, spread))

    @property
    def extra_jacobian(self) -> FloatArray:
        return self.jacobian[self.n_observations :]

    def factorised(self, root: FloatArray, scale_floor: FloatArray | None = None) -> DenseSystem:
        return factorise(
            self.jacobian * root[:, None],
            self.residuals * root,
            self.rank_tolerance,
            values=self.values,
            constraints=self.constraints,
            scale_floor=scale_floor,
        )


def whitened(residuals: FloatArray, jacobian: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Divide residuals and derivatives by the square root of their covariance.

    Shapes: jacobian (m, n), residuals (m,), jacobian (m, n).
    residuals (m,): Predicted minus observed.
    covariance (m,) or (k, d, d): Variances, or the covariance of each block of d consecutive residuals (k d = m).
    InputError: A covariance is not positive definite, or of another size.
    """
    if covariance.ndim == 1:
        if covariance.shape != residuals.shape or not (covariance > 0).all():
            raise InputError(f"covariance: {residuals.size} positive variances are needed")
        root = 1.0 / np.sqrt(covariance)
        return residuals * root, jacobian * root[:, None]
    blocks, size = covariance.shape[:2]
    if blocks * size != residuals.size:
        raise InputError(f"covariance: blocks for {residuals.size} residuals are needed, not {blocks} of {size}")
    try:
        inverse = np.linalg.inv(np.linalg.cholesky(covariance))
    except np.linalg.LinAlgError as error:
        raise InputError("covariance: a block is not positive definite") from error
    scaled = inverse @ residuals.reshape(blocks, size, 1)
    return scaled.reshape(-1), (inverse @ jacobian.reshape(blocks, size, -1)).reshape(residuals.size, -1)


def solve(
    problem: Problem[StateT],
    start: StateT,
    *,
    loss: Loss | None = None,
    block_size: int = 1,
    covariance_scale: CovarianceScale = CovarianceScale.PRIOR,
    options: Options | None = None,
) -> Solution[StateT]:
    """Adjust the parameters to the observations.

    problem: What is observed and what is sought.
    loss: Robust loss of the observations; plain least squares if not given. Priors and constraints are never
        weakened.
    block_size: Number of consecutive residuals that belong together (2 for image points) and are weakened together.
    covariance_scale: Whether the stated sigmas are believed, or only their ratios.
    Returns: ``converged`` is False with the reason if the iteration did not end in a minimum; parameters that
        nothing holds have covariance NaN and are named by ``undetermined``. `Solution.require` turns both into an
        error.
    InputError: The residuals and derivatives do not fit the parameters.
    EstimationError: The model cannot be evaluated at the start.

    With whitened residuals r, derivatives J and psi the influence of the loss, the covariance is ``A^-1 B A^-1`` with
    ``A = mean(psi') J^T J`` and ``B = m / (m - n) mean(psi^2) K^2 J^T J``, ``K = 1 + n / m var(psi') / mean(psi')^2``
    (Huber 1981, section 7.6), plus the priors' shares; for plain least squares this is ``(J^T J)^-1``, times the
    variance factor if a posteriori. With a robust loss and a priori scale the averages are those for normal errors of
    the stated sigma, or those of the residuals if they say that the answer is less certain.

    >>> lengths = np.array([1.0, 2.0, 4.0])
    >>> mean = Problem(("length_m",), lambda x: ((x - lengths) / 0.1, np.full((3, 1), 10.0)), VECTOR)
    >>> solution = solve(mean, np.zeros(1))
    >>> solution.parameters.round(6), solution.sigmas.round(6)
    (array([2.333333]), array([0.057735]))
    """
    loss, options = loss or Squares(), options or Options()
    model = _Model(problem, loss, block_size, options.rank_tolerance)
    descent = minimise(start, model.rows, model.retract, options=options)
    return assemble(descent, model.facts(descent.state), loss=loss, block=block_size, covariance_scale=covariance_scale)


@dataclass(frozen=True, slots=True, eq=False)
class _Model(Generic[StateT]):
    """The problem in its free parameters, with its loss."""

    problem: Problem[StateT]
    loss: Loss
    block_size: int
    rank_tolerance: float

    @property
    def free(self) -> BoolArray:
        return np.array([name not in self.problem.held for name in self.problem.names], dtype=np.bool_)

    def facts(self, state: StateT) -> Facts:
        return Facts(self.problem.names, self.free, self.problem.chart.coordinates(state))

    def retract(self, state: StateT, step: FloatArray) -> StateT:
        if not self.problem.held:
            return self.problem.chart.retract(state, step)
        full = np.zeros(len(self.problem.names))
        full[self.free] = step
        return self.problem.chart.retract(state, full)

    def rows(self, state: StateT) -> _Rows:
        problem = self.problem
        residuals, jacobian = problem.evaluate(state)
        n_observations = residuals.size
        fits = residuals.ndim == 1 and jacobian.shape == (n_observations, len(problem.names))
        if not fits or n_observations % self.block_size:
            raise InputError(
                f"least squares: residuals {residuals.shape} in blocks of {self.block_size} and derivatives "
                f"{jacobian.shape} do not fit {len(problem.names)} parameters"
            )
        values = problem.chart.coordinates(state)
        weights, cost = np.ones(n_observations), 0.5 * float(residuals @ residuals)
        if not isinstance(self.loss, Squares):
            lengths = block_lengths(residuals, self.block_size)
            weights = np.repeat(self.loss.weight(lengths), self.block_size)
            cost = 0.5 * float(self.loss.rho(lengths).sum())
        if problem.extra:
            known, known_jacobian = _extra_rows(problem, state, values)
            residuals, jacobian = np.concatenate([residuals, known]), np.concatenate([jacobian, known_jacobian])
            weights, cost = np.concatenate([weights, np.ones(known.size)]), cost + 0.5 * float(known @ known)
        if not np.isfinite(jacobian).all():
            cost = float("inf")
        constraints = None if problem.datum is None else problem.datum(state)
        if problem.held:
            free = self.free
            jacobian, values = jacobian[:, free], values[free]
            constraints = None if constraints is None else constraints[free]
        return _Rows(residuals, jacobian, n_observations, weights, cost, values, constraints, self.rank_tolerance)


def _extra_rows(problem: Problem[Any], state: Any, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Residuals and derivatives of priors, then of constraints."""
    priors = [item for item in problem.extra if isinstance(item, Prior)]
    places = [problem.names.index(item.name) for item in priors]
    over = 1.0 / np.array([item.sigma for item in priors])
    jacobian = np.zeros((len(priors), len(problem.names)))
    jacobian[np.arange(len(priors)), places] = over
    residuals = (values[places] - [item.value for item in priors]) * over
    constraints = [item for item in problem.extra if isinstance(item, Constraint)]
    if not constraints:
        return np.asarray(residuals), jacobian
    found = [(one.sigma, *one.evaluate(state)) for one in constraints]
    more = [np.atleast_1d(rest) / sigma for sigma, rest, _ in found]
    derivatives = [np.atleast_2d(derivative) / sigma for sigma, _, derivative in found]
    return np.concatenate([residuals, *more]), np.concatenate([jacobian, *derivatives])
