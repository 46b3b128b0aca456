"""Fits of observations that are linear in the parameters: one factorisation for all scales, weights and rows."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from heliogauge.adjust.covariance import covariance_factors
from heliogauge.adjust.gauss_newton import EPSILON, Options
from heliogauge.adjust.robust_loss import Loss, LossMoments, Squares, block_lengths, loss_moments, normal_moments
from heliogauge.adjust.solution import CovarianceScale, Solution
from heliogauge.validate import FloatArray

# Below this share of the largest column of the triangle a direction is held by nothing.
_HELD = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class LinearBasis:
    """Derivatives of observations and priors with orthonormal columns, so that normal equations lose no digits.

    observed (m, k), known (q, k): Derivatives by t of the residuals in stated sigma, and of the priors' pulls.
    pulls (q,): Of the priors, where t is zero.
    inverse (k, k): Free parameters less those about which all is linear, over t.
    triangle (k, k): Its inverse.
    """

    observed: FloatArray
    known: FloatArray
    pulls: FloatArray
    inverse: FloatArray
    triangle: FloatArray

    @classmethod
    def of(cls, jacobian: FloatArray, sigmas: FloatArray, offsets: FloatArray) -> "LinearBasis | None":
        """Factorise.

        jacobian (m, k): Derivatives of the residuals, in stated sigma.
        sigmas (k,): Prior sigmas of the parameters, inf where there is none.
        offsets (k,): How far the parameters are from what the priors expect.
        Returns: None where something is held by neither.
        """
        held = np.flatnonzero(np.isfinite(sigmas))
        priors = np.zeros((held.size, sigmas.size))
        priors[np.arange(held.size), held] = 1.0 / sigmas[held]
        both = np.concatenate([jacobian, priors])
        scale = np.sqrt(np.einsum("ij,ij->j", both, both))
        if not sigmas.size or not (scale > 0).all() or not np.isfinite(scale).all():
            return None
        orthonormal, triangle = np.linalg.qr(both / scale)
        diagonal = np.abs(np.diag(triangle))
        if diagonal.size < sigmas.size or diagonal.min() < _HELD * diagonal.max():
            return None
        count = len(jacobian)
        return cls(
            orthonormal[:count],
            orthonormal[count:],
            offsets[held] / sigmas[held],
            np.linalg.inv(triangle) / scale[:, None],
            triangle * scale,
        )


class LinearProblem(NamedTuple):
    """What is observed of parameters that observations are linear in.

    basis: Of all rows, and of the priors.
    residuals (m,), observed (m, k): Of the rows in use where t is zero, and their derivatives by t, in the sigmas in
        force.
    about (k,): Parameters where t is zero.
    names length k: Of the parameters.
    """

    basis: LinearBasis
    residuals: FloatArray
    observed: FloatArray
    about: FloatArray
    names: tuple[str, ...]

    @property
    def freedom(self) -> int:
        """Residuals and priors less parameters."""
        return self.residuals.size + self.basis.pulls.size - len(self.names)


def descend_linear(
    problem: LinearProblem, start: FloatArray, loss: Loss, block: int, options: Options
) -> Solution[FloatArray] | None:
    """Adjust parameters to observations that are linear in them by iterated weights.

    start (k,): Parameters to start from.
    block: Components that the loss weakens together.
    Returns: As `heliogauge.adjust.least_squares.solve` does, but without a variance factor and the count of
        iterations; None where the rows in use do not hold all parameters.
    """
    basis, residuals, observed, about, _ = problem
    size, freedom = basis.triangle.shape[0], problem.freedom
    known = basis.known.T @ basis.known
    t = basis.triangle @ (start - about)
    # Squares below this are rounding.
    nothing = (16 * EPSILON) ** 2 * float(residuals @ residuals + basis.pulls @ basis.pulls)
    converged, offset = False, float("inf")
    for _ in range(options.max_iterations):
        rest, pulls = residuals + observed @ t, basis.pulls + basis.known @ t
        weights = np.repeat(loss.weight(block_lengths(rest, block)), block)
        weighted = observed * weights[:, None]
        gradient = rest @ weighted + pulls @ basis.known
        try:
            step = -np.linalg.solve(weighted.T @ observed + known, gradient)
        except np.linalg.LinAlgError:
            return None
        # As `relative_offset`: the remaining step in units of the parameters' own standard deviations.
        removed = -float(gradient @ step)
        left = max(float(weights @ rest**2 + pulls @ pulls) - removed, 0.0)
        offset = float(np.sqrt(max(removed, 0.0) / size / (left / freedom))) if freedom > 0 and left > 0 else offset
        converged = removed <= nothing or offset <= options.tolerance
        if converged:
            break
        t = t + step
    reason = f"the remaining step is {offset:.1e} sigma"
    return _solution(problem, t, loss, block, converged=converged, reason=reason)


def _solution(
    problem: LinearProblem, t: FloatArray, loss: Loss, block: int, *, converged: bool, reason: str
) -> Solution[FloatArray]:
    """Return covariance and redundancy at t (k,)."""
    basis, residuals, observed, about, names = problem
    rest, pulls, known = residuals + observed @ t, basis.pulls + basis.known @ t, basis.known.T @ basis.known
    lengths, plain = block_lengths(rest, block), isinstance(loss, Squares)
    expected = LossMoments(1.0, 1.0, 0.0) if plain else normal_moments(loss, block)
    normal = observed.T @ observed
    cofactor = np.linalg.inv(expected.slope * normal + known)
    followed = np.concatenate(
        [
            expected.slope * np.einsum("ij,ij->i", observed @ cofactor, observed),
            np.einsum("ij,ij->i", basis.known @ cofactor, basis.known),
        ]
    )
    measured = loss_moments(loss, lengths, block) if rest.size else expected
    share = float(np.mean(1.0 - followed[: rest.size])) if rest.size else 1.0
    factors = covariance_factors((expected, measured), share, 1.0, plain=plain, scale=CovarianceScale.PRIOR)
    bread = cofactor if factors.slope == expected.slope else np.linalg.inv(factors.slope * normal + known)
    spread = bread @ (factors.influence * normal + known) @ bread
    parameters = about + basis.inverse @ t
    return Solution(
        state=parameters,
        parameters=parameters.copy(),
        names=names,
        covariance=basis.inverse @ spread @ basis.inverse.T,
        covariance_scale=CovarianceScale.PRIOR,
        converged=converged,
        reason=reason,
        iterations=0,
        rank=t.size,
        null_space=np.zeros((t.size, 0)),
        residuals=np.concatenate([rest, pulls]),
        weights=np.concatenate([np.repeat(loss.weight(lengths), block), np.ones(pulls.size)]),
        redundancy_numbers=np.clip(1.0 - followed, 0.0, 1.0),
        redundancy=problem.freedom,
        variance_factor=float("nan"),
    )
