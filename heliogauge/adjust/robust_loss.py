"""Robust losses of an adjustment: what one observation, or one block of them, costs when it is far off."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np

from heliogauge.validate import FloatArray, positive


class Loss(Protocol):
    """What a loss must offer; ``s >= 0`` is the length of a whitened residual block, 1 for one sigma.

    The adjustment minimises ``1/2 sum rho(s)``, with ``rho(s) = s**2`` near zero for every loss here. ``psi(s) =
    rho'(s) / 2`` is the influence, ``weight(s) = psi(s) / s`` the weight of iterated least squares and ``slope(s) =
    psi'(s)`` what the covariance needs: an observation that no longer pulls (slope 0) adds nothing to the precision,
    although its weight is not 0.
    """

    def __hash__(self) -> int:
        """Losses are values: averages over normal errors are kept."""
        ...

    def rho(self, s: FloatArray) -> FloatArray:
        """Cost of a block, equal to ``s**2`` near zero."""
        ...

    def weight(self, s: FloatArray) -> FloatArray:
        """Weight of a block, ``psi(s) / s``."""
        ...

    def slope(self, s: FloatArray) -> FloatArray:
        """Slope of the influence, ``psi'(s)``."""
        ...


@dataclass(frozen=True, slots=True)
class Squares:
    """Plain least squares: best for normal errors, ruined by one gross error."""

    def rho(self, s: FloatArray) -> FloatArray:
        """Cost ``s**2``."""
        return s**2

    def weight(self, s: FloatArray) -> FloatArray:
        """Weight 1."""
        return np.ones_like(s)

    def slope(self, s: FloatArray) -> FloatArray:
        """Slope 1."""
        return np.ones_like(s)


@dataclass(frozen=True, slots=True)
class Huber:
    """Squares up to a threshold, linear beyond: convex, one minimum; a far outlier keeps a bounded pull.

    threshold: Where the linear part begins [sigma]; 1.345 keeps 95 % efficiency for normal errors (Huber 1981,
        section 4.3).
    InputError: The threshold is not positive.
    """

    threshold: float = 1.345

    def __post_init__(self) -> None:
        positive("threshold", self.threshold, "sigma")

    def rho(self, s: FloatArray) -> FloatArray:
        """Cost ``s**2`` inside, ``k (2 s - k)`` outside."""
        k = self.threshold
        return np.where(s <= k, s**2, k * (2 * s - k))

    def weight(self, s: FloatArray) -> FloatArray:
        """Weight ``min(1, k / s)``."""
        return np.asarray(self.threshold / np.maximum(s, self.threshold))

    def slope(self, s: FloatArray) -> FloatArray:
        """Slope 1 inside, 0 outside."""
        return np.where(s <= self.threshold, 1.0, 0.0)


@dataclass(frozen=True, slots=True)
class Cauchy:
    """Logarithmic loss: a far outlier loses its pull slowly; not convex, start near the answer.

    threshold: Scale of the loss [sigma]; 2.385 keeps 95 % efficiency for normal errors.
    InputError: The threshold is not positive.
    """

    threshold: float = 2.385

    def __post_init__(self) -> None:
        positive("threshold", self.threshold, "sigma")

    def rho(self, s: FloatArray) -> FloatArray:
        """Cost ``k**2 log(1 + (s / k)**2)``."""
        return np.asarray(self.threshold**2 * np.log1p((s / self.threshold) ** 2))

    def weight(self, s: FloatArray) -> FloatArray:
        """Weight ``1 / (1 + (s / k)**2)``."""
        return np.asarray(1.0 / (1.0 + (s / self.threshold) ** 2))

    def slope(self, s: FloatArray) -> FloatArray:
        """Slope, negative beyond ``s = k``."""
        square = (s / self.threshold) ** 2
        return np.asarray((1.0 - square) / (1.0 + square) ** 2)


@dataclass(frozen=True, slots=True)
class Tukey:
    """Biweight: beyond the threshold an observation has no pull at all; needs a start near the answer.

    threshold: Where the pull ends [sigma]; 4.685 keeps 95 % efficiency for normal errors.
    InputError: The threshold is not positive.
    """

    threshold: float = 4.685

    def __post_init__(self) -> None:
        positive("threshold", self.threshold, "sigma")

    def rho(self, s: FloatArray) -> FloatArray:
        """Cost ``k**2 / 3 (1 - (1 - (s / k)**2)**3)``, constant beyond the threshold."""
        inside = np.maximum(1.0 - (s / self.threshold) ** 2, 0.0)
        return np.asarray(self.threshold**2 / 3 * (1.0 - inside**3))

    def weight(self, s: FloatArray) -> FloatArray:
        """Weight ``(1 - (s / k)**2)**2``, 0 beyond the threshold."""
        return np.asarray(np.maximum(1.0 - (s / self.threshold) ** 2, 0.0) ** 2)

    def slope(self, s: FloatArray) -> FloatArray:
        """Slope, negative between ``k / sqrt(5)`` and ``k``."""
        square = (s / self.threshold) ** 2
        return np.asarray(np.maximum(1.0 - square, 0.0) * (1.0 - 5.0 * square) * (square < 1.0))


def block_lengths(residuals: FloatArray, block_size: int) -> FloatArray:
    """Return the lengths of consecutive blocks of whitened residuals.

    Shapes: residuals (k * block_size,), result (k,).
    """
    if block_size == 1:
        return np.abs(residuals)
    return np.asarray(np.linalg.norm(residuals.reshape(-1, block_size), axis=1))


@dataclass(frozen=True, slots=True)
class LossMoments:
    """Averages of a loss over residual blocks, per residual component.

    slope: Mean derivative of the influence: 1 for `Squares`.
    influence: Mean squared influence: the mean squared residual for `Squares`.
    slope_variance: Variance of the derivative over the blocks, for the small-sample correction.
    """

    slope: float
    influence: float
    slope_variance: float


def loss_moments(loss: Loss, s: FloatArray, block_size: int) -> LossMoments:
    """Average a loss over measured residual blocks.

    s (k,): Lengths of the whitened residual blocks.
    Returns: For blocks of d components the influence is the vector ``weight(s) r``; its derivative has the mean
        eigenvalue ``((d - 1) weight + slope) / d`` and its square is ``(weight s)**2 / d`` per component.
    """
    weight = loss.weight(s)
    slope = ((block_size - 1) * weight + loss.slope(s)) / block_size
    return LossMoments(float(slope.mean()), float(np.mean((weight * s) ** 2)) / block_size, float(slope.var()))


@lru_cache(maxsize=64)
def normal_moments(loss: Loss, block_size: int) -> LossMoments:
    """Average a loss over normal errors of the stated sigma (by quadrature, good to 1e-3).

    Returns: ``slope**2 / influence`` is the efficiency of the loss against least squares.

    >>> moments = normal_moments(Huber(), 1)
    >>> round(moments.slope**2 / moments.influence, 2)
    0.95
    """
    s: FloatArray = (np.arange(4000, dtype=np.float64) + 0.5) * (12.0 / 4000)
    density = s ** (block_size - 1) * np.exp(-0.5 * s**2)
    density /= density.sum()
    weight = loss.weight(s)
    slope = ((block_size - 1) * weight + loss.slope(s)) / block_size
    mean = float(density @ slope)
    return LossMoments(mean, float(density @ (weight * s) ** 2) / block_size, float(density @ (slope - mean) ** 2))
