"""The result of an adjustment and what can be asked of it: sigmas, tests, correlations, what is not determined."""

from dataclasses import dataclass
from enum import StrEnum
from statistics import NormalDist
from typing import Generic, Self

import numpy as np

from heliogauge.adjust.chi_square import VarianceFactorTests
from heliogauge.adjust.gauss_newton import StateT
from heliogauge.errors import EstimationError, NotConvergedError
from heliogauge.validate import BoolArray, FloatArray, freeze


class CovarianceScale(StrEnum):
    """Whether the sigmas of the observations are believed or only their ratios."""

    PRIOR = "a priori: the stated sigmas are believed"
    POSTERIOR = "a posteriori: scaled by the variance factor"


@dataclass(frozen=True, slots=True, eq=False)
class Solution(VarianceFactorTests, Generic[StateT]):
    """Estimate with its covariance and the evidence for or against it.

    state: The estimate as the caller's own type.
    parameters (n,): The estimate as numbers, in the order of ``names``.
    names length n: Names of the parameters, with units.
    covariance (n, n): Covariance of the step from the truth to the estimate; 0 for held parameters, NaN for those
        not determined.
    covariance_scale: How the covariance was scaled.
    converged: Whether the estimate is a minimum to the stated tolerance.
    reason: Why the iteration ended.
    iterations: Steps tried.
    rank: Number of parameter combinations determined by observations, priors and constraints, on top of the datum.
    null_space (n, defect): Directions in which nothing holds the parameters, largest entry 1; no columns when all
        are determined.
    residuals (m,): Whitened residuals [sigma]: observations, then priors and constraints in their order.
    weights (m,): Weight that the robust loss left to each residual, 1 for plain least squares.
    redundancy_numbers (m,): Share of an error of each residual that shows in it; they add up to the redundancy. 0:
        not controlled.
    redundancy: Residuals less rank.
    variance_factor: Squared residuals over redundancy, 1 if the sigmas are right; NaN without redundancy. With a
        robust loss the squared influences count, divided by their expectation for normal errors.
    """

    state: StateT
    parameters: FloatArray
    names: tuple[str, ...]
    covariance: FloatArray
    covariance_scale: CovarianceScale
    converged: bool
    reason: str
    iterations: int
    rank: int
    null_space: FloatArray
    residuals: FloatArray
    weights: FloatArray
    redundancy_numbers: FloatArray
    redundancy: int
    variance_factor: float

    def __post_init__(self) -> None:
        for array in (
            self.parameters,
            self.covariance,
            self.null_space,
            self.residuals,
            self.weights,
            self.redundancy_numbers,
        ):
            freeze(array)

    @property
    def sigmas(self) -> FloatArray:
        """Standard deviations of the parameters, shape (n,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> FloatArray:
        """Correlations of the parameters, shape (n, n); NaN with held or undetermined ones."""
        sigmas = np.where(self.sigmas > 0, self.sigmas, np.nan)
        return np.asarray(self.covariance / sigmas[:, None] / sigmas)

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of the parameters that nothing holds, those with the largest share in the null space first."""
        share = np.abs(self.null_space).max(axis=1, initial=0.0)
        order = np.argsort(-share, kind="stable")
        lost = np.isnan(np.diag(self.covariance))
        return tuple(self.names[i] for i in order if lost[i])

    def sigma(self, name: str) -> float:
        """Return the standard deviation of one parameter."""
        return float(self.sigmas[self.names.index(name)])

    def value(self, name: str) -> float:
        """Return the estimate of one parameter."""
        return float(self.parameters[self.names.index(name)])

    def largest_correlations(self, at_least: float = 0.9) -> tuple[tuple[str, str, float], ...]:
        """List pairs of parameters that the observations hardly separate.

        at_least: Smallest absolute correlation listed.
        Returns: Names and correlation, strongest first.
        """
        correlation = self.correlation
        rows, columns = np.nonzero(np.triu(np.abs(np.nan_to_num(correlation)) >= at_least, 1))
        pairs = [(self.names[i], self.names[j], float(correlation[i, j])) for i, j in zip(rows, columns, strict=True)]
        return tuple(sorted(pairs, key=lambda pair: -abs(pair[2])))

    def baarda(self) -> FloatArray:
        """Return the residuals over their own sigma (Baarda's w), shape (m,); NaN where nothing controls them.

        Returns (m,): Standard normal if the stated sigmas are right; 3.29 is exceeded by chance once in 1000.
        """
        controlled = np.where(self.redundancy_numbers > 1e-8, self.redundancy_numbers, np.nan)
        return np.asarray(self.residuals / np.sqrt(controlled))

    def pope(self) -> FloatArray:
        """Return the residuals over their own estimated sigma (Pope's tau), shape (m,).

        Returns (m,): For sigmas known only up to a common factor.
        """
        return np.asarray(self.baarda() / np.sqrt(self.variance_factor))

    def outliers(self, significance: float = 0.001) -> BoolArray:
        """Mark residuals that are too large for their own sigma.

        significance: Probability of marking one good residual.
        Returns (m,): Baarda's test with a priori scale, Pope's with a posteriori scale.
        """
        if self.covariance_scale is CovarianceScale.PRIOR:
            return np.asarray(np.abs(np.nan_to_num(self.baarda())) > NormalDist().inv_cdf(1 - significance / 2))
        from scipy.special import stdtrit

        freedom = self.redundancy - 1
        if freedom < 1:
            return np.zeros(self.residuals.shape, dtype=np.bool_)
        student = float(stdtrit(freedom, 1 - significance / 2))
        critical = student * np.sqrt(self.redundancy / (freedom + student**2))
        return np.asarray(np.abs(np.nan_to_num(self.pope())) > critical)

    def require(self, what: str) -> Self:
        """Return the solution if it is usable, refuse it otherwise.

        what: What was estimated, for the message ("mirror pose").
        EstimationError: Not converged, or parameters not determined; the message names them.
        """
        if self.null_space.shape[1]:
            names = self.undetermined
            listed = ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
            defect = self.null_space.shape[1]
            raise EstimationError(
                f"{what}: {defect} of {defect + self.rank} degrees of freedom are not determined by the observations; "
                f"they involve {listed}. Add observations or a prior, or hold one of them"
            )
        if not self.converged:
            raise NotConvergedError(f"{what}: {self.reason}")
        return self
