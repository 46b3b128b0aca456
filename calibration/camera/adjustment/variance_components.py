"""Variance components of a linear mixed model of photos of a board: which share of misfit comes from where."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from heliogauge.errors import EstimationError
from heliogauge.validate import FloatArray, IntArray

#: Redundancy below this share of a group's members says nothing about the group; steps are limited by it.
_LEAST_REDUNDANCY = 1e-3
#: Largest change of a variance in one iteration; the fixed point is reached from a thousandth in three.
_LARGEST_STEP = 20.0
#: Standard deviations are known to a few per cent at best: changes by one per cent end the iteration.
_SETTLED, _MOST_ITERATIONS = 0.01, 30
#: Standard deviations of an effect are looked at as far as their likelihood is above exp(-4) of the largest: 1 in 200.
_UNLIKELY, _MOST_DOUBLINGS, _NODES = 4.0, 8, 6
#: Where there is no effect the search for its upper limit begins with this share of its usual size.
_UNSEEN_SHARE = 0.05
#: A flat prior keeps this much weight, so that an undetermined direction shows as an immense variance.
_FLAT = 1e-18


@dataclass(frozen=True, slots=True, eq=False)
class PhotoRows:
    """Whitened rows of one photo.

    columns (a,): Which of the common unknowns it touches.
    jacobian (n, 2, a): Derivatives by these.
    targets (n,): Point of the board in each row.
    d_point (n, 2, 3): Derivatives by that point.
    misfit (n, 2): Measured less predicted at the state of the linearisation.
    """

    columns: IntArray
    jacobian: FloatArray
    targets: IntArray
    d_point: FloatArray
    misfit: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Components:
    """Standard deviations of the groups of a mixed model.

    effects (g,): Of each group of random effects among the common unknowns, in the units of its columns.
    point (3,): Of each point's own departure; held where `MixedModel` was told so.
    noise (p,): Of each photo's rows, in units of their stated sigma.
    """

    effects: FloatArray
    point: FloatArray
    noise: FloatArray


class MixedModel:
    """A linear mixed model whose points are eliminated one by one.

    photos: The rows of each photo.
    group (k,): Group of random effects of each common unknown, -1 for one without a prior.
    prior_point (m, 3): Expected value of each point's step.
    points_estimated: Whether the variance of the points' own departures is estimated; otherwise it is held.
    least: Standard deviations that mean nothing: none gets smaller, so that the likelihood keeps its digits.

    The rows of photo i are ``y = A x + B e + v`` with common unknowns x (some of them random effects), steps e of the
    points around their expectation, and noise v. Variances follow from ``s^2 = q / (n - tr(C) / s^2)`` for each group
    with its sum of squares q, number n and posterior covariance C, iterated: the fixed point is a maximum of the
    restricted likelihood (Harville 1977, J. Am. Stat. Assoc. 72, eq. 5.1 to 5.4; in geodesy Foerstner's estimate).
    """

    def __init__(
        self,
        photos: Sequence[PhotoRows],
        group: IntArray,
        prior_point: FloatArray,
        *,
        points_estimated: bool,
        least: Components | None = None,
    ) -> None:
        self._least = least
        self._last: _Reduced | None = None
        self._group, self._prior_point, self._points_estimated = group, prior_point, points_estimated
        self._parts = [_Part.of(one) for one in photos]

    def settle(self, start: Components) -> "Posterior":
        """Estimate the variances, beginning with the ones given, and return the unknowns under them."""
        now = start
        for _ in range(_MOST_ITERATIONS):
            posterior = self.solve(now)
            new = posterior.updated()
            changes = [
                np.abs(np.log(after / before)).max(initial=0.0)
                for after, before in ((new.effects, now.effects), (new.point, now.point), (new.noise, now.noise))
            ]
            now = new
            if max(changes) < _SETTLED:
                break
        return self.solve(now)

    def solve(self, components: Components) -> "Posterior":
        """Return the unknowns and their covariance under given variances."""
        reduced = self._without_points(components)
        effect = self._group >= 0
        normal = reduced.normal.copy()
        normal[np.diag_indices(self._group.size)] += np.where(effect, 1 / components.effects[self._group] ** 2, _FLAT)
        scale = 1 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
        inverse_normal, logs = _inverse_of(normal * scale[:, None] * scale)
        covariance = inverse_normal * scale[:, None] * scale
        values = covariance @ reduced.right
        logs += reduced.logs - 2 * float(np.log(scale).sum())
        logs += 2 * float((np.log(components.effects)[self._group] * effect).sum())
        misfit = logs + reduced.square - float(reduced.right @ values)
        steps = reduced.steps - np.einsum("jak,k->ja", reduced.eliminated, values)
        inverse, eliminated = reduced.inverse, reduced.eliminated
        return Posterior(self, components, values, covariance, steps, -0.5 * misfit, inverse, eliminated)

    def _without_points(self, components: Components) -> "_Reduced":
        """Eliminate the points; the last result is kept: it holds for all sizes of the effects."""
        last = self._last
        if last is not None and last.point is components.point and last.noise is components.noise:
            return last
        size, count = self._group.size, len(self._prior_point)
        weight = 1 / components.point**2
        normal, right = np.zeros((size, size)), np.zeros(size)
        crossed = np.zeros((count, 3, size))
        own, own_right = np.tile(np.diag(weight), (count, 1, 1)), self._prior_point * weight
        logs = 2 * count * float(np.log(components.point).sum())
        square = float((self._prior_point**2 * weight).sum())
        for part, noise in zip(self._parts, components.noise, strict=True):
            share = 1 / noise**2
            columns = part.columns
            normal[np.ix_(columns, columns)] += share * part.normal
            right[columns] += share * part.right
            crossed[part.targets[:, None, None], np.arange(3)[None, :, None], columns] += share * part.crossed
            own[part.targets] += share * part.own
            own_right[part.targets] += share * part.own_right
            logs += 4 * part.targets.size * float(np.log(noise))
            square += share * part.square
        inverse = np.asarray(np.linalg.inv(own), dtype=np.float64)
        eliminated = inverse @ crossed
        normal -= crossed.reshape(-1, size).T @ eliminated.reshape(-1, size)
        right -= np.einsum("jak,ja->k", eliminated, own_right)
        steps = np.einsum("jab,jb->ja", inverse, own_right)
        square -= float((own_right * steps).sum())
        logs += float(np.linalg.slogdet(own)[1].sum())
        self._last = _Reduced(
            components.point, components.noise, normal, right, inverse, eliminated, steps, logs, square
        )
        return self._last


@dataclass(frozen=True, slots=True, eq=False)
class _Reduced:
    """Normal equations without the points, before the effects' sizes enter.

    point, noise: The variances they hold for.
    normal (k, k), right (k,): Of the common unknowns.
    inverse (m, 3, 3), eliminated (m, 3, k), steps (m, 3): Each point's covariance with the common unknowns held, how
        its step follows them, and its step where they do not move.
    logs, square: Parts of the likelihood.
    """

    point: FloatArray
    noise: FloatArray
    normal: FloatArray
    right: FloatArray
    inverse: FloatArray
    eliminated: FloatArray
    steps: FloatArray
    logs: float
    square: float


def _inverse_of(normal: FloatArray) -> tuple[FloatArray, float]:
    """Invert a normal matrix from its Cholesky factor in place; return the logarithm of its determinant too."""
    from scipy.linalg import lapack

    factor, fault = lapack.dpotrf(normal, lower=1)
    if fault:
        raise EstimationError("calibration: the photos do not determine camera and poses")
    half = np.tril(lapack.dpotri(factor, lower=1)[0])
    return np.asarray(half + np.tril(half, -1).T), 2 * float(np.log(np.diag(factor)).sum())


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Products of one photo's rows."""

    columns: IntArray
    targets: IntArray
    normal: FloatArray
    right: FloatArray
    square: float
    crossed: FloatArray
    own: FloatArray
    own_right: FloatArray

    @classmethod
    def of(cls, rows: PhotoRows) -> "_Part":
        flat = rows.jacobian.reshape(-1, rows.columns.size)
        return cls(
            rows.columns,
            rows.targets,
            flat.T @ flat,
            flat.T @ rows.misfit.ravel(),
            float((rows.misfit**2).sum()),
            np.swapaxes(rows.d_point, 1, 2) @ rows.jacobian,
            np.swapaxes(rows.d_point, 1, 2) @ rows.d_point,
            np.einsum("nia,ni->na", rows.d_point, rows.misfit),
        )


@dataclass(frozen=True, eq=False)
class Posterior:
    """Unknowns of a mixed model under given variances.

    components: These variances.
    values (k,): Common unknowns.
    covariance (k, k): Their covariance.
    steps (m, 3): Steps of the points.
    log_likelihood: Restricted log-likelihood of these variances, but for a constant.
    """

    model: MixedModel
    components: Components
    values: FloatArray
    covariance: FloatArray
    steps: FloatArray
    log_likelihood: float
    _inverse: FloatArray
    _eliminated: FloatArray

    @cached_property
    def _with_points(self) -> FloatArray:
        """Covariance of points and common unknowns with the sign reversed, shape (m, 3, k)."""
        return self._eliminated @ self.covariance

    def joint_of_steps(self, through: FloatArray) -> FloatArray:
        """Return the joint covariance of points that also move with common unknowns, shape (3 m, 3 m).

        through (m, 3, k): Derivative of each point's place by the common unknowns.
        """
        size = self.covariance.shape[0]
        moved = (through - self._eliminated).reshape(-1, size)
        joint = np.asarray(moved @ self.covariance @ moved.T)
        for j, block in enumerate(self._inverse):
            joint[3 * j : 3 * j + 3, 3 * j : 3 * j + 3] += block
        return joint

    def crossed_with_steps(self, through: FloatArray) -> FloatArray:
        """Return the covariance of such points with the common unknowns, shape (3 m, k)."""
        return np.asarray((through - self._eliminated).reshape(-1, self.covariance.shape[0]) @ self.covariance)

    def with_unknown_sizes(self, columns: IntArray, usual: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the covariance of some common unknowns with what is not known of the effects' sizes; those sizes.

        columns (c,): Which of the common unknowns.
        usual (g,): Size of each group's effects in other cases: where a group has none here, the search begins with a
            part of it.
        covariance (c, c): ``E[C] + E[(x - x0)(x - x0)^T]`` over the restricted likelihood of each group's standard
            deviation with a flat prior (Gelman 2006, Bayesian Analysis 1, section 5.2), group by group.
        effects (g,): Root of the mean square of each group's standard deviation under the same, at least today's.
        """
        place = np.ix_(columns, columns)
        base = self.covariance[place]
        total, effects = base.copy(), self.components.effects.copy()
        for group, size in enumerate(usual):
            family = _OtherSizes.of(self, group, columns)
            sizes, shares = self._likely(family, group, float(size))
            others = [family.at(sigma) for sigma in sizes]
            moments = [base - other.gained + np.outer(other.apart, other.apart) for other in others]
            likelihoods = np.array([other.log_ratio for other in others])
            weights = shares * np.exp(likelihoods - likelihoods.max())
            effects[group] = max(effects[group], float(np.sqrt(np.average(np.square(sizes), weights=weights))))
            excess = np.average(moments, axis=0, weights=weights) - base
            values, vectors = np.linalg.eigh(excess / np.sqrt(np.outer(np.diag(base), np.diag(base))))
            # A smaller variance here is never taken as more certainty.
            scaled = (vectors * np.maximum(values, 0.0)) @ vectors.T
            total += scaled * np.sqrt(np.outer(np.diag(base), np.diag(base)))
        return np.asarray(total), effects

    def _likely(self, family: "_OtherSizes", group: int, usual: float) -> tuple[list[float], FloatArray]:
        """Return places and weights of an integral over a group's standard deviation, as far as it is likely."""
        least = 0.0 if self.model._least is None else float(self.model._least.effects[group])
        largest = max(2 * float(self.components.effects[group]), _UNSEEN_SHARE * usual)
        for _ in range(_MOST_DOUBLINGS):
            if family.at(largest).log_ratio < -_UNLIKELY:
                break
            largest *= 2
        nodes, weights = np.polynomial.legendre.leggauss(_NODES)
        return (least + (largest - least) * 0.5 * (nodes + 1)).tolist(), weights

    def updated(self) -> Components:
        """Return the variances that these unknowns speak for."""
        group, now = self.model._group, self.components
        diagonal = np.diag(self.covariance)
        effects = now.effects.copy()
        for k in range(effects.size):
            own = group == k
            effects[k] *= _factor(
                float((self.values[own] ** 2).sum()), float(diagonal[own].sum()), effects[k], own.sum()
            )
        block = self._inverse + np.einsum("jak,jbk->jab", self._with_points, self._eliminated)
        point = now.point.copy()
        if self.model._points_estimated:
            departures, spread = self.steps - self.model._prior_point, np.einsum("jaa->ja", block)
            for axes in ([0, 1], [2]):
                square, variance = float((departures[:, axes] ** 2).sum()), float(spread[:, axes].sum())
                point[axes] *= _factor(square, variance, point[axes[0]], len(axes) * len(departures))
        noise = np.array(
            [
                one * _factor(*self._misfit(part, block), one, 2 * part.targets.size)
                for part, one in zip(self.model._parts, now.noise, strict=True)
            ]
        )
        least = self.model._least
        if least is not None:
            effects, noise = np.maximum(effects, least.effects), np.maximum(noise, least.noise)
            point = np.maximum(point, least.point) if self.model._points_estimated else point
        return Components(effects, point, noise)

    def _misfit(self, part: _Part, block: FloatArray) -> tuple[float, float]:
        """Return a photo's sum of squared residuals, and what the unknowns' covariance adds to it."""
        values, steps = self.values[part.columns], self.steps[part.targets]
        square = part.square - 2 * values @ part.right + values @ part.normal @ values
        square += -2 * (steps * part.own_right).sum() + np.einsum("na,nab,nb->", steps, part.own, steps)
        square += 2 * np.einsum("na,nak,k->", steps, part.crossed, values)
        variance = (self.covariance[np.ix_(part.columns, part.columns)] * part.normal).sum()
        variance += (block[part.targets] * part.own).sum()
        variance -= 2 * (self._with_points[part.targets][:, :, part.columns] * part.crossed).sum()
        return max(float(square), 0.0), float(variance)


class _OtherSize(NamedTuple):
    """What another standard deviation of one group makes of some common unknowns.

    gained (c, c): By how much their covariance shrinks.
    apart (c,): Their values less those of today.
    log_ratio: Restricted log-likelihood less that of today.
    """

    gained: FloatArray
    apart: FloatArray
    log_ratio: float


@dataclass(frozen=True, slots=True, eq=False)
class _OtherSizes:
    """How a posterior follows the standard deviation of one group of effects, all others held.

    sigma: That of today.
    variances (g,): Eigenvalues of the group's own posterior covariance.
    values (g,): The group's effects along its eigenvectors.
    along (c, g): Covariance of the unknowns asked for with these.

    Another standard deviation adds one number d to the diagonal of the group's normal equations. The inverse changes by
    ``-B diag(d / (1 + d v)) B^T`` (Woodbury) with the eigenvalues v, and its determinant by ``prod(1 + d v)``: the
    eigenvalues are formed once, and each further size costs as many operations as there are effects.
    """

    sigma: float
    variances: FloatArray
    values: FloatArray
    along: FloatArray

    @classmethod
    def of(cls, posterior: Posterior, group: int, columns: IntArray) -> "_OtherSizes":
        own = np.flatnonzero(posterior.model._group == group)
        variances, vectors = np.linalg.eigh(posterior.covariance[np.ix_(own, own)])
        along = posterior.covariance[np.ix_(columns, own)] @ vectors
        return cls(float(posterior.components.effects[group]), variances, posterior.values[own] @ vectors, along)

    def at(self, sigma: float) -> _OtherSize:
        """Return the change for another standard deviation."""
        more = 1 / sigma**2 - 1 / self.sigma**2
        # No effect is known worse than its prior; round-off could say so.
        grown = np.maximum(1 + more * self.variances, min(1.0, (self.sigma / sigma) ** 2))
        shares = more / grown
        logs = float(np.log(grown).sum()) + 2 * grown.size * float(np.log(sigma / self.sigma))
        logs += float(shares @ self.values**2)
        return _OtherSize((self.along * shares) @ self.along.T, -(self.along * shares) @ self.values, -0.5 * logs)


def _factor(square: float, variance: float, sigma: float, count: int) -> float:
    """Return by what a standard deviation changes."""
    redundancy = max(float(count - variance / sigma**2), _LEAST_REDUNDANCY * max(count, 1))
    wanted = float(square / redundancy / sigma**2)
    return float(np.sqrt(min(max(wanted, 1 / _LARGEST_STEP), _LARGEST_STEP)))
