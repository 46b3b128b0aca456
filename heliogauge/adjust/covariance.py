"""From the end of a descent to its covariance and quality figures; the same for dense and sparse adjustments."""

from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from heliogauge.adjust.gauss_newton import Descent, Evaluation, StateT
from heliogauge.adjust.robust_loss import Loss, LossMoments, Squares, block_lengths, loss_moments, normal_moments
from heliogauge.adjust.solution import CovarianceScale, Solution
from heliogauge.validate import BoolArray, FloatArray


class Factorised(Protocol):
    """A factorised normal matrix after the last step."""

    @property
    def scale(self) -> FloatArray:
        """Column scale, shape (n,)."""
        ...

    @property
    def rank(self) -> int:
        """Number of determined directions on top of the datum."""
        ...

    def cofactor(self) -> FloatArray:
        """Return the (pseudo-)inverse of the normal matrix, under the datum."""
        ...

    def null_space(self) -> FloatArray:
        """Return the directions nothing holds, unit length in scaled coordinates."""
        ...


FactorisedT = TypeVar("FactorisedT", bound=Factorised)


class WeightedRows(Evaluation, Protocol[FactorisedT]):
    """Residuals at the end: observations first, then priors and constraints."""

    @property
    def residuals(self) -> FloatArray:
        """Whitened residuals, shape (m,)."""
        ...

    @property
    def n_observations(self) -> int:
        """Number of residuals that the loss applies to."""
        ...

    @property
    def weights(self) -> FloatArray:
        """Weights the loss left, shape (m,)."""
        ...

    @property
    def extra_jacobian(self) -> FloatArray:
        """Derivatives of priors and constraints, shape (k, n)."""
        ...

    def factorised(self, root: FloatArray) -> FactorisedT:
        """Factorise with given roots of weights."""
        ...

    def leverages(self, root: FloatArray, system: FactorisedT) -> FloatArray:
        """Return the diagonal of ``J Q J^T`` with rows times ``root``, shape (m,)."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Facts:
    """What the caller knows about the parameters.

    names length n: Names of all parameters.
    free (n,): Which of them were estimated.
    values (n,): Their estimates.
    """

    names: tuple[str, ...]
    free: BoolArray
    values: FloatArray


@dataclass(frozen=True, slots=True)
class CovarianceFactors:
    """Factors of the covariance ``A^-1 B A^-1``: ``A = slope N + P`` and ``B = influence N + prior P``.

    N is the observations' share of the normal matrix, P that of priors and constraints.
    """

    slope: float
    influence: float
    prior: float


def assemble(
    descent: Descent[StateT, WeightedRows[FactorisedT]],
    facts: Facts,
    *,
    loss: Loss,
    block: int,
    covariance_scale: CovarianceScale,
) -> Solution[StateT]:
    """Compute covariance, redundancy and variance factor where a descent ended.

    facts: Names, free parameters and values.
    loss, block: The loss of the observations and its block size.
    covariance_scale: Whether the stated sigmas are believed.
    Returns: The result, see `heliogauge.adjust.least_squares.solve` for the model.
    """
    rows = descent.evaluation
    observed = np.arange(rows.n_residuals) < rows.n_observations
    lengths = block_lengths(rows.residuals[observed], block)
    plain = isinstance(loss, Squares)
    expected = LossMoments(1.0, 1.0, 0.0) if plain else normal_moments(loss, block)
    measured = loss_moments(loss, lengths, block) if lengths.size else expected
    # The loss takes the same share of precision everywhere: one constant in place of each observation's own slope.
    root = np.where(observed, np.sqrt(expected.slope), 1.0)
    system = rows.factorised(root)
    redundancy = rows.n_residuals - system.rank
    controlled = 1.0 - rows.leverages(root, system)
    known = rows.residuals[~observed]
    squares = rows.n_observations * measured.influence / expected.influence + float(known @ known)
    variance_factor = squares / redundancy if redundancy > 0 else float("nan")
    share = float(controlled[observed].mean()) if lengths.size else 1.0
    factors = covariance_factors((expected, measured), share, variance_factor, plain=plain, scale=covariance_scale)
    if factors.slope != expected.slope:
        system = rows.factorised(np.where(observed, np.sqrt(factors.slope), 1.0))
    covariance, null_space = _in_all_parameters(facts.free, _covariance(system, rows.extra_jacobian, factors), system)
    return Solution(
        state=descent.state,
        parameters=facts.values.copy(),
        names=facts.names,
        covariance=covariance,
        covariance_scale=covariance_scale,
        converged=descent.converged,
        reason=descent.reason,
        iterations=descent.iterations,
        rank=system.rank,
        null_space=null_space,
        residuals=rows.residuals.copy(),
        weights=rows.weights.copy(),
        redundancy_numbers=np.clip(controlled, 0.0, 1.0),
        redundancy=redundancy,
        variance_factor=variance_factor,
    )


def covariance_factors(
    moments: tuple[LossMoments, LossMoments], share: float, factor: float, *, plain: bool, scale: CovarianceScale
) -> CovarianceFactors:
    """Choose the factors of the covariance: those of normal errors, or of the residuals where these say less.

    moments: Of the loss for normal errors, and over the residuals.
    share: Mean redundancy number of the observations.
    factor: Variance factor, which scales the covariance a posteriori.
    """
    posterior = scale is CovarianceScale.POSTERIOR
    prior = factor if posterior else 1.0
    if plain:
        return CovarianceFactors(1.0, prior, prior)
    expected, measured = moments
    # A redescending loss far from normal errors can have a mean slope near zero: 0.1 bounds the inflation at 100.
    slope = max(measured.slope, 0.1)
    correction = 1.0 + (1.0 - share) * measured.slope_variance / slope**2
    influence = measured.influence / share * correction**2 if share > 1e-8 else float("nan")
    if posterior or influence / slope**2 > expected.influence / expected.slope**2:
        return CovarianceFactors(slope, influence, prior)
    return CovarianceFactors(expected.slope, expected.influence, prior)


def _covariance(system: Factorised, extra_jacobian: FloatArray, factors: CovarianceFactors) -> FloatArray:
    """``Q B Q`` with ``B = b (Q^-1 - P) + prior P``: only the few rows of priors and constraints are needed again."""
    cofactor, share = system.cofactor(), factors.influence / factors.slope
    covariance = share * cofactor
    if extra_jacobian.size and share != factors.prior:
        propagated = extra_jacobian @ cofactor
        covariance += (factors.prior - share) * (propagated.T @ propagated)
    return covariance


def _in_all_parameters(free: BoolArray, covariance: FloatArray, system: Factorised) -> tuple[FloatArray, FloatArray]:
    """Covariance and null space with the held parameters; NaN where nothing determines a parameter."""
    lost = system.null_space()
    # 1e-6 of a direction of unit length: below that the parameter is held to its sigma by the rest.
    unknown = np.abs(lost).max(axis=1, initial=0.0) > 1e-6
    covariance[unknown, :] = np.nan
    covariance[:, unknown] = np.nan
    directions = lost / system.scale[:, None]
    if lost.shape[1]:
        directions = directions / np.abs(directions).max(axis=0)
    if free.all():
        return covariance, directions
    full, all_directions = np.zeros((free.size, free.size)), np.zeros((free.size, lost.shape[1]))
    full[np.ix_(free, free)] = covariance
    all_directions[free] = directions
    return full, all_directions
