"""Several poses of one mirror in one adjustment: what camera and screen do to the slopes turns with the pose."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from heliogauge.adjust.chi_square import chi_square_cdf
from heliogauge.validate import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PoseSlopes:
    """What one pose says of the mirror's smooth slopes, in the mirror's own frame.

    slopes (n,): Coefficients of polynomials that hold its slope errors.
    covariance (n, n): Of their noise.
    common (n, k): Change of the coefficients for +1 sigma of each error that all poses have in common: those of camera
        and screen first, then those of the places of facets.
    own (n, m): The same for errors of this pose alone.
    measured_at (k,): Amounts of the common errors, in sigmas, with which the slopes were measured.
    free_turns: The last so many own errors are turns of the mirror that no measurement knows: they add up to zero
        over all poses.
    """

    slopes: FloatArray
    covariance: FloatArray
    common: FloatArray
    own: FloatArray
    measured_at: FloatArray
    free_turns: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class JointSolution:
    """The surface and the errors of the setup that fit all poses best.

    common (k,): Amounts of the common errors, in their stated sigmas.
    own length n_poses: Amounts of each pose's own errors.
    covariance: Of all amounts, the common ones first, then those of each pose.
    noise_factor: By how much more than their noise the poses differ; 1 where they do not. It is in the covariance.
    chi_square, freedom: Sum of squared differences between the poses, in noise, and what is expected of it.
    """

    common: FloatArray
    own: tuple[FloatArray, ...]
    covariance: FloatArray
    noise_factor: float
    chi_square: float
    freedom: float

    @property
    def covariance_common(self) -> FloatArray:
        """Covariance of the common errors' amounts, shape (k, k); the unit matrix where the poses say nothing."""
        count = self.common.size
        return self.covariance[:count, :count]

    @property
    def probability(self) -> float:
        """Probability of so large differences between the poses, if noise and the stated sigmas explain them."""
        return 1.0 - chi_square_cdf(self.chi_square, self.freedom) if self.freedom > 0.5 else 1.0


def adjust_poses(poses: Sequence[PoseSlopes]) -> JointSolution:
    """Find surface, common errors and each pose's own ones together, by weighted least squares.

    poses: Two or more.
    Returns: Amounts of all errors with their covariance.

    The slopes of pose p measured with amounts ``measured_at`` obey ``S = s_p + C_p (c - measured_at) + O_p o_p`` with
    the surface S, unknown without a prior, and amounts c and o_p with prior 0 +- 1. What the poses cannot tell from
    the surface keeps its prior. Where the poses differ by more than their noise, all of it counts as larger noise.
    """
    first = _solve(poses)
    factor = float(np.sqrt(max(first.chi_square / first.freedom, 1.0))) if first.freedom > 0.5 else 1.0
    if factor == 1.0:
        return first
    noisier = [replace(one, covariance=factor**2 * one.covariance) for one in poses]
    return replace(_solve(noisier), noise_factor=factor, chi_square=first.chi_square, freedom=first.freedom)


def _solve(poses: Sequence[PoseSlopes]) -> JointSolution:
    n_slopes, n_common = poses[0].common.shape
    own = np.cumsum([n_slopes + n_common, *(one.own.shape[1] for one in poses)])
    # The surface in units of its noise: all unknowns of the order of one.
    scale = np.sqrt(np.mean([np.diag(one.covariance) for one in poses], axis=0))
    data, target = [], []
    for number, one in enumerate(poses):
        rows = np.zeros((n_slopes, own[-1]))
        rows[:, :n_slopes] = np.diag(scale)
        rows[:, n_slopes : own[0]] = -one.common
        rows[:, own[number] : own[number + 1]] = -one.own
        root = np.linalg.cholesky(one.covariance / np.outer(scale, scale))
        data.append(np.linalg.solve(root, rows / scale[:, None]))
        target.append(np.linalg.solve(root, (one.slopes - one.common @ one.measured_at) / scale))
    prior = np.eye(own[-1])[n_slopes:]
    turns = np.zeros((poses[0].free_turns, own[-1]))
    for turn in range(poses[0].free_turns):
        # Nothing tells a turn of all poses from a turn of the surface: their sum is held at zero.
        turns[turn, own[1:] - 1 - turn] = 1e6
    matrix = np.concatenate([*data, prior, turns])
    right = np.concatenate([*target, np.zeros(len(prior) + len(turns))])
    orthogonal, triangle = np.linalg.qr(matrix)
    solution = np.linalg.solve(triangle, orthogonal.T @ right)
    inverse = np.linalg.inv(triangle)
    n_data = n_slopes * len(poses)
    residual = (right - matrix @ solution)[:n_data]
    return JointSolution(
        common=solution[n_slopes : own[0]],
        own=tuple(solution[low:high] for low, high in pairwise(own)),
        covariance=(inverse @ inverse.T)[n_slopes:, n_slopes:],
        noise_factor=1.0,
        chi_square=float(residual @ residual),
        freedom=n_data - float(np.sum(orthogonal[:n_data] ** 2)),
    )
