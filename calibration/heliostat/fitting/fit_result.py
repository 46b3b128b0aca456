"""The fit of a heliostat: its options and its result."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from calibration.heliostat.fitting.drift_noise import Drift
from calibration.heliostat.fitting.observability import Combination
from calibration.heliostat.kinematic_model.design import HeliostatDesign
from calibration.heliostat.observations.observations import Observations
from calibration.heliostat.observations.residuals import Residuals
from heliogauge.adjust.solution import Solution
from heliogauge.doubts import Doubt
from heliogauge.errors import InputError
from heliogauge.validate import BoolArray, FloatArray, positive

LossName: TypeAlias = Literal["huber", "squares", "tukey"]
SigmaPolicy: TypeAlias = Literal["auto", "stated", "estimated"]


@dataclass(frozen=True, slots=True)
class FitOptions:
    """How to fit.

    loss: What a row far off may pull; "squares" rejects nothing.
    sigma: Whether the stated sigmas of the observations are believed, or estimated from the residuals, kind by
        kind; "auto" believes them unless the residuals refute them.
    significance: Chance that any good row is rejected at all.
    refuted_below: Probability of the residuals under the stated sigmas below which "auto" estimates.
    restarts: Further starts, tried only where the first ends in no minimum or far from the observations.
    max_iterations: Steps of one descent.
    InputError: A choice that does not exist or a number out of its range.
    """

    loss: LossName = "huber"
    sigma: SigmaPolicy = "auto"
    significance: float = 0.01
    refuted_below: float = 0.001
    restarts: int = 8
    max_iterations: int = 100

    def __post_init__(self) -> None:
        if self.loss not in ("huber", "squares", "tukey"):
            raise InputError(f"loss: huber, squares or tukey is needed, not {self.loss!r}")
        if self.sigma not in ("auto", "stated", "estimated"):
            raise InputError(f"sigma: auto, stated or estimated is needed, not {self.sigma!r}")
        positive("significance", self.significance, "probability")
        positive("refuted_below", self.refuted_below, "probability")
        if self.restarts < 0 or self.max_iterations < 1:
            raise InputError(
                f"restarts: at least 0, max_iterations: at least 1, not {self.restarts}, {self.max_iterations}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class HeliostatFit:
    """A fitted heliostat with the evidence for and against it.

    design: The heliostat with the estimates as values; the sigmas of its parameters are still the priors.
    nominal: The heliostat as given, with the parameters that the observations bring.
    observations: All rows, rejected ones too.
    solution: The adjustment in the free parameters; whitened with the sigmas that were used in the end.
    covariance (p, p): Covariance of all parameters, 0 for held ones.
    residuals: Of all rows, whitened with the stated sigmas; derivatives by all parameters.
    rejected (n,): Rows that were left out.
    reason length n: Why a row was left out; empty for rows that were used.
    weight (n,): Weight that the loss left to each row, 0 if rejected.
    leverage (n,): Share of each row's own error that the fit follows (mean of its components), 0 if rejected.
    sigma_factors: Factor on the stated sigmas by kind; 1 where they were believed.
    sigma0: Scatter of the residuals over the stated sigmas by kind; NaN without redundancy.
    unobservable: Combinations that the priors decide.
    basins: Starts tried.
    doubts: What a user must know before believing the numbers.
    drift: What it knows of noise that moves the drives' zeros; None where every row was taken for itself.
    beside: What is known of everything that may be wrong of the heliostat, where only some of it was free: by that the
        fit's predictions are judged. None where it judges itself.
    """

    design: HeliostatDesign
    nominal: HeliostatDesign
    observations: Observations
    solution: Solution[FloatArray]
    covariance: FloatArray
    residuals: Residuals
    rejected: BoolArray
    reason: tuple[str, ...]
    weight: FloatArray
    leverage: FloatArray
    sigma_factors: Mapping[str, float]
    sigma0: Mapping[str, float]
    unobservable: tuple[Combination, ...]
    basins: int
    doubts: tuple[Doubt, ...]
    drift: Drift | None = None
    beside: "HeliostatFit | None" = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters."""
        return self.design.parameters.names

    @property
    def values(self) -> FloatArray:
        """Estimates of all parameters, shape (p,)."""
        return self.design.parameters.values

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations of all parameters, shape (p,); 0 for held ones."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def correlation(self) -> FloatArray:
        """Correlations, shape (p, p); NaN with held parameters."""
        sigma = np.where(self.sigma > 0, self.sigma, np.nan)
        return np.asarray(self.covariance / sigma[:, None] / sigma)

    @property
    def n_free(self) -> int:
        """Number of parameters that were free."""
        return len(self.solution.names)

    @property
    def rank(self) -> int:
        """Number of combinations of the free parameters that the observations decide."""
        return self.n_free - len(self.unobservable)

    @property
    def converged(self) -> bool:
        """Whether the estimate is a minimum."""
        return self.solution.converged

    @property
    def message(self) -> str:
        """Why the iteration ended."""
        return self.solution.reason

    @property
    def used(self) -> BoolArray:
        """Rows that were used, shape (n,)."""
        return np.asarray(~self.rejected)

    @property
    def factor(self) -> FloatArray:
        """Factor on the stated sigma of each row, shape (n,)."""
        return np.array([self.sigma_factors.get(kind, 1.0) for kind in self.observations.kind])

    @property
    def sigma_estimated(self) -> tuple[str, ...]:
        """Kinds whose sigma was estimated from the residuals."""
        return tuple(kind for kind, factor in self.sigma_factors.items() if factor != 1.0)
