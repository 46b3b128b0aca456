"""One descent of a heliostat's free numbers at given sigmas and rows, and what follows for both."""

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from calibration.heliostat.fitting.fit_result import FitOptions
from calibration.heliostat.fitting.linear_descent import LinearBasis, LinearProblem, descend_linear
from calibration.heliostat.fitting.observability import plausible_scales
from calibration.heliostat.kinematic_model.design import HeliostatDesign
from calibration.heliostat.observations.observations import Observations
from calibration.heliostat.observations.residuals import ObservationModel, Residuals, Whitened
from heliogauge.adjust.chi_square import chi_square_limit, chi_square_quantile
from heliogauge.adjust.least_squares import VECTOR, Huber, Options, Prior, Problem, Solution, Squares, Tukey, solve
from heliogauge.adjust.robust_loss import Loss, LossMoments, block_lengths, normal_moments
from heliogauge.validate import BoolArray, FloatArray, IntArray

#: 95 % efficiency for normal errors in blocks of one, two and three components (quadrature of `normal_moments`).
_HUBER = {1: 1.345, 2: 1.5, 3: 1.65}
# The largest share of a residual that the fit may have taken: below 0.05 left, no row is tested any more sharply.
_LEAST_LEFT = 0.05
#: Factor on the stated sigma from which residuals are the model's, and how much farther rows may then lie.
REFUTED_FROM, _SLACK = 1.2, 1.5
# Chance with which a row lies within its stated sigma, and is no outlier.
_AS_STATED = 0.95
_ON_THE_WAY, _FEW_STEPS = 0.05, 12
# Residuals of data without noise [stated sigma].
_ZERO = 1e-6
# There a sigma below a millionth of the stated one is rounding.
_LEAST_FACTOR = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class LinearObservations:
    """Observations that are linear in the free parameters, about some values: as good as the others, and much faster.

    columns (k,): Positions of the free parameters.
    values (p,): About which numbers.
    found: Residuals and derivatives there.
    owners (m,): Row of each component.
    basis: Of observations and priors; None where these do not hold all parameters.
    exact: The model with the observations themselves.
    """

    columns: IntArray
    values: FloatArray
    found: Whitened
    owners: IntArray
    basis: LinearBasis | None
    exact: "FitModel"

    def whitened(self, values: FloatArray) -> Whitened:
        """Return the residuals at some numbers."""
        residuals, jacobian, computable = self.found
        return Whitened(residuals + jacobian @ (values - self.values)[self.columns], jacobian, computable)


@dataclass(frozen=True, slots=True, eq=False)
class FitModel:
    """The heliostat, its observations, and how to fit.

    design: With the parameters that the observations bring.
    observations: All rows.
    fallback: Free parameters that are held within what could be wrong at all.
    reach: Factor on what could be wrong at all.
    columns (k,): Positions of the free parameters.
    components (n,): Number of components of each row.
    rows_of: Rows of each kind, masks (n,).
    scales (k,): How far each free parameter could be wrong at all.
    priors (k,): Prior sigmas of the free parameters in force, inf where there is none.
    seen: The observations, ready to be evaluated.
    """

    design: HeliostatDesign
    observations: Observations
    options: FitOptions
    fallback: frozenset[str] = frozenset()
    reach: float = 1.0
    columns: IntArray = field(init=False)
    components: IntArray = field(init=False)
    rows_of: Mapping[str, BoolArray] = field(init=False)
    scales: FloatArray = field(init=False)
    priors: FloatArray = field(init=False)
    seen: ObservationModel | LinearObservations = field(init=False)

    def __post_init__(self) -> None:
        columns = np.flatnonzero(self.design.parameters.free)
        object.__setattr__(self, "columns", columns)
        object.__setattr__(self, "seen", ObservationModel(self.design, self.observations, columns))
        kinds = np.array(self.observations.kind, dtype=np.str_)
        object.__setattr__(self, "rows_of", {str(kind): kinds == kind for kind in dict.fromkeys(kinds.tolist())})
        object.__setattr__(self, "components", self.observations.n_components)
        units = [self.design.parameters.units[i] for i in columns]
        scales = self.reach * plausible_scales(self.start, self.names, units)
        own = self.design.parameters.sigmas[columns]
        weak = np.array([name in self.fallback for name in self.names], dtype=np.bool_)
        object.__setattr__(self, "scales", scales)
        object.__setattr__(self, "priors", np.where(np.isinf(own) & weak, scales, own))

    @property
    def owners(self) -> IntArray:
        """Row of each component."""
        return self.seen.owners

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return self.design.parameters.free_names

    @property
    def start(self) -> FloatArray:
        """Values of the free parameters in the design."""
        return np.asarray(self.design.parameters.values[self.columns])

    def full(self, free: FloatArray) -> FloatArray:
        """Return all numbers with the free ones replaced."""
        values = self.design.parameters.values.copy()
        values[self.columns] = free
        return values

    def whitened(self, free: FloatArray) -> Whitened:
        """Return the residuals of all rows with derivatives by the free parameters."""
        return self.seen.whitened(self.full(free))

    def evaluate(self, free: FloatArray) -> Residuals:
        """Return the residuals of all rows, also in radians."""
        if isinstance(self.seen, LinearObservations):
            raise TypeError("linear observations have no angles")
        return self.seen.evaluate(self.full(free))

    def miss_rad(self, free: FloatArray) -> FloatArray:
        """Return the angle between what each row saw and what is predicted, shape (n,) [rad]."""
        if isinstance(self.seen, LinearObservations):
            raise TypeError("linear observations have no angles")
        return self.seen.miss_rad(self.full(free))

    def linear_about(self, free: FloatArray) -> "FitModel":
        """Return the same model with its observations linear about some values of the free parameters."""
        values, found = self.full(free), copy(self)
        seen = self.seen.whitened(values)
        basis = LinearBasis.of(seen.jacobian, self.priors, free - self.start)
        linear = LinearObservations(self.columns, values, seen, self.owners, basis, self)
        object.__setattr__(found, "seen", linear)
        return found

    @property
    def is_linear(self) -> bool:
        """Whether the observations were made linear."""
        return isinstance(self.seen, LinearObservations)

    @property
    def exact(self) -> "FitModel":
        """The same model with the observations themselves."""
        return self.seen.exact if isinstance(self.seen, LinearObservations) else self

    def row_factors(self, factors: Mapping[str, float]) -> FloatArray:
        """Return the factor on the stated sigma of each row."""
        result = np.ones(self.components.size)
        for kind, factor in factors.items():
            result[self.rows_of[kind]] = factor
        return result

    def block(self, used: BoolArray) -> int:
        """Components that are weakened together; one by one where kinds differ in their number."""
        sizes = set(self.components[used].tolist())
        return sizes.pop() if len(sizes) == 1 else 1

    def loss(self, block: int) -> Loss:
        """Return the loss for blocks of so many components."""
        if self.options.loss == "squares":
            return Squares()
        return Huber(_HUBER[block]) if self.options.loss == "huber" else Tukey(4.685 * _HUBER[block] / _HUBER[1])


@dataclass(frozen=True, slots=True, eq=False)
class Descended:
    """Where a descent ended.

    model: What was fitted.
    factors: Factors on the stated sigmas by kind that were in force.
    used (n,): Rows that were in use.
    """

    model: FitModel
    factors: Mapping[str, float]
    used: BoolArray
    solution: Solution[FloatArray]

    @property
    def values(self) -> FloatArray:
        """Free parameters."""
        return self.solution.parameters

    def redundancy(self) -> dict[str, float]:
        """Return the spare components by kind."""
        owners = self.model.owners[self.used[self.model.owners]]
        numbers = self.solution.redundancy_numbers[: owners.size]
        return {kind: float(numbers[self.model.rows_of[kind][owners]].sum()) for kind in self.factors}

    def scatter(self) -> dict[str, float]:
        """Return the factor on the stated sigmas that the residuals of each kind ask for; NaN with nothing to spare.

        The factor s solves ``sum psi(r / s)^2 / E psi^2 = redundancy`` at the residuals r as they stand (Huber 1981,
        section 7.7), so that the descents only have to follow the rows.
        """
        block, redundancy = self.model.block(self.used), self.redundancy()
        owners = self.model.owners[self.used[self.model.owners]]
        lengths, owners = block_lengths(self.solution.residuals[: owners.size], block), owners[::block]
        loss = self.model.loss(block)
        expected = 1.0 if isinstance(loss, Squares) else normal_moments(loss, block).influence
        result = {}
        for kind, factor in self.factors.items():
            # Two spare components or fewer do not give a scatter.
            enough = redundancy[kind] > 2
            own = lengths[self.model.rows_of[kind][owners]]
            found = _scale(own, loss, expected, redundancy[kind]) if enough else np.nan
            result[kind] = max(factor * found, _LEAST_FACTOR) if enough else float("nan")
        return result

    def accepted(self, factors: Mapping[str, float]) -> BoolArray:
        """Return the rows whose residual is no larger than chance allows, in use or not, at given factors."""
        residuals, jacobian, computable = self.model.whitened(self.values)
        if self.model.options.loss == "squares":
            return computable
        scale = self.model.row_factors(factors)
        limit = self.limits() * np.sqrt(self._own_variance(jacobian, scale))
        lengths = np.sqrt(np.bincount(self.model.owners, residuals**2, minlength=scale.size))
        # A row that is where its stated sigma has it contradicts nothing, however well others of the kind fit.
        stated = {n: np.sqrt(chi_square_quantile(_AS_STATED, n)) for n in set(self.model.components.tolist())}
        near = np.array([stated[n] for n in self.model.components.tolist()])
        return np.asarray(computable & (lengths <= np.maximum(limit * scale, near)))

    def with_own_covariance(self) -> "Descended":
        """Return the same end with the covariance for normal errors of the sigmas in force.

        ``A^-1 B A^-1``, ``A = E psi' N + P``, ``B = E psi^2 N + P`` with the normal matrices N of the observations
        and P of the priors. The adjustment takes the larger of this and of what the residuals themselves show; here
        the sigmas were tested or estimated before, and the larger of two is 10 % too large with 15 rows and 5
        parameters.
        """
        model, block = self.model, self.model.block(self.used)
        chosen = self.used[model.owners]
        scale = model.row_factors(self.factors)[model.owners[chosen]]
        jacobian = model.whitened(self.values).jacobian
        jacobian = jacobian[chosen] / scale[:, None]
        loss = model.loss(block)
        plain = isinstance(loss, Squares) or not chosen.any()
        expected = LossMoments(1.0, 1.0, 0.0) if plain else normal_moments(loss, block)
        known = np.where(np.isfinite(model.priors), 1.0 / model.priors**2, 0.0)
        observed = jacobian.T @ jacobian
        # Angles and metres in one matrix: scaled to a diagonal of ones before it is inverted.
        bread = expected.slope * observed + np.diag(known)
        root = np.sqrt(np.diag(bread))
        if not (root > 0).all():
            return self
        inverse = np.linalg.inv(bread / root[:, None] / root) / root[:, None] / root
        covariance = inverse @ (expected.influence * observed + np.diag(known)) @ inverse
        return replace(self, solution=replace(self.solution, covariance=0.5 * (covariance + covariance.T)))

    def limits(self) -> FloatArray:
        """Return the longest residual that chance allows each row, shape (n,) [sigma]."""
        probability = self.model.options.significance / max(self.used.size, 1)
        limit = np.ones(self.used.size)
        for kind, freedom in self.redundancy().items():
            own = self.model.rows_of[kind]
            square = chi_square_limit(probability, int(self.model.components[own][0]))
            if freedom > 2:
                # The scatter rests on few rows: F(2, v), whose tail is (1 + 2 F / v)^(-v / 2), instead of chi-square.
                square *= freedom * (probability ** (-2 / freedom) - 1) / (-2 * np.log(probability))
            # What a model lacks is no normal error: rows that follow it are not outliers for that.
            refuted = self.factors[kind] > REFUTED_FROM
            limit[own] = np.sqrt(square) * (_SLACK if refuted else 1.0)
        return limit

    def _own_variance(self, jacobian: FloatArray, scale: FloatArray) -> FloatArray:
        """Mean variance of a row's residual over sigma^2: below 1 for rows in use, above for the others."""
        jacobian = jacobian / scale[self.model.owners, None]
        covariance = self.solution.covariance
        covariance = covariance if np.isfinite(covariance).all() else np.nan_to_num(covariance)
        spread = np.einsum("ij,ij->i", jacobian @ covariance, jacobian)
        mean = np.bincount(self.model.owners, spread, minlength=self.used.size) / self.model.components
        return np.where(self.used, np.maximum(1 - mean, _LEAST_LEFT), 1 + mean)


def _scale(lengths: FloatArray, loss: Loss, expected: float, redundancy: float) -> float:
    """Scale at which the influences of block lengths are as large as normal errors make them."""
    scale = 1.0
    for _ in range(60):
        before = scale
        influence = loss.weight(lengths / scale) * lengths
        scale = float(np.sqrt(influence @ influence / (expected * redundancy)))
        if scale == 0 or abs(scale / before - 1) < 1e-4:
            break
    return scale


def descend(
    model: FitModel, start: FloatArray, factors: Mapping[str, float], used: BoolArray, tolerance: float
) -> Descended:
    """Adjust the free parameters to some rows at given sigmas.

    Shapes: start (k,).
    factors: Factors on the stated sigmas by kind.
    used (n,): Rows in use; all of them must be computable at the start.
    tolerance: Remaining step at which to stop [sigma].
    Returns: The end, converged or not.
    """
    chosen = used[model.owners]
    per_component = 1.0 / model.row_factors(factors)[model.owners[chosen]]

    def residuals_at(free: FloatArray) -> tuple[FloatArray, FloatArray]:
        residuals, jacobian, computable = model.whitened(free)
        residuals, jacobian = residuals[chosen] * per_component, jacobian[chosen] * per_component[:, None]
        # Leaving the geometry of an actuator must not pay: such a step is refused.
        return residuals if computable[used].all() else np.full_like(residuals, np.nan), jacobian

    block = model.block(used)
    # On the way, while scale and rows still move, a long valley is not worth following to its end.
    most = model.options.max_iterations if tolerance < _ON_THE_WAY else min(model.options.max_iterations, _FEW_STEPS)
    options = Options(max_iterations=most, tolerance=tolerance, rank_tolerance=1e-10)
    solution, seen = None, model.seen
    if isinstance(seen, LinearObservations) and seen.basis is not None:
        residuals = seen.found.residuals[chosen] * per_component
        observed = seen.basis.observed[chosen] * per_component[:, None]
        linear = LinearProblem(seen.basis, residuals, observed, seen.values[model.columns], model.names)
        solution = descend_linear(linear, start, model.loss(block), block, options)
    if solution is None:
        known = zip(model.names, model.start, model.priors, strict=True)
        extra = tuple(Prior(name, float(value), float(sigma)) for name, value, sigma in known if np.isfinite(sigma))
        problem = Problem(model.names, residuals_at, VECTOR, extra=extra)
        solution = solve(problem, start, loss=model.loss(block), block_size=block, options=options)
    stated = np.abs(solution.residuals[: per_component.size] / per_component)
    if not solution.converged and stated.max(initial=0.0) < _ZERO:
        solution = replace(solution, converged=True, reason="the residuals are zero to rounding")
    return Descended(model, dict(factors), used, solution)
