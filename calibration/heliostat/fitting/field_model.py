"""What the heliostats of a field have in common: mean and scatter of every parameter, and the noise, by evidence."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calibration.heliostat.fitting.drift_noise import USUAL_NOISE, LinearRows, NoiseShape, NormalEquations
from calibration.heliostat.fitting.field_prior import FieldPrior, settle, student_weights
from calibration.heliostat.fitting.unit_noise import unit_noise
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, IntArray

#: So many heliostats show a field's scatter to 4 %; of a larger field as many are taken, evenly spread over it.
MOST_LEARNED_FROM = 300
#: With so few the scatter is estimated anew without each one; with more it no longer depends on any single one.
_FEW = 30
#: Heliostats with the most rows, from which the shape of the noise is estimated.
_NOISE_UNITS, _NOISE_STEPS = 12, 70
_WEIGHT_ROUNDS = 6
#: Least group that has a model of its own.
_LEAST_GROUP = 3
# Scatter over its scale: below e^-5 it is nothing, above e^3 the priors were wrong by a factor of 20.
_LOG_SCATTER = (-5.0, 3.0)


@dataclass(frozen=True, slots=True, eq=False)
class FieldUnit(ShortRepr):
    """A heliostat from which a field is learned.

    name: Which.
    rows: Its observations.
    groups: By what it may be like some of the others: kind of grouping, and its group there.
    """

    name: str
    rows: LinearRows
    groups: Mapping[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class FieldModel(ShortRepr):
    """Heliostats of one kind: their parameters are normal about a common mean.

    names length p: Parameters.
    mean (p,), scatter (p,): Mean offset from the nominal values, and most probable standard deviation about it.
    variance (p,): Posterior mean of the squared standard deviation.
    mean_covariance (p, p): Of the mean.
    noise: How observations scatter.
    units: From which heliostats.
    weights (k, p): How much each counts for each parameter: about 1, less where it is unlike the others.
    without: What is known of each of them from the others.
    gains (k,): Log of the odds that the field predicts the observations of each, learned without it, better than the
        general priors do.
    """

    names: tuple[str, ...]
    mean: FloatArray
    scatter: FloatArray
    variance: FloatArray
    mean_covariance: FloatArray
    noise: NoiseShape
    units: tuple[str, ...]
    weights: FloatArray
    without: Mapping[str, FieldPrior]
    gains: FloatArray

    @property
    def helps(self) -> bool:
        """Whether most heliostats are better predicted by the others than by the general priors."""
        return bool(self.gains.size) and float(np.median(self.gains)) > 0

    def prior(self, name: str) -> FieldPrior:
        """Return what the other heliostats say of one."""
        if name in self.without:
            return self.without[name]
        return FieldPrior(
            self.names, self.mean, self.scatter, self.variance, self.mean_covariance, self.noise, len(self.units)
        )


@dataclass(frozen=True, slots=True, eq=False)
class Field(ShortRepr):
    """What is known of the heliostats of a field.

    grouping: By what they are told apart; empty where all of a kind are alike.
    models: By parameters and group.
    """

    grouping: str
    models: Mapping[tuple[tuple[str, ...], str], FieldModel]

    def model(self, names: tuple[str, ...], groups: Mapping[str, str]) -> FieldModel | None:
        """Return the model for a heliostat with these parameters; None where there is none, or none that helps."""
        own = self.models.get((names, groups.get(self.grouping, "")))
        found = own if own is not None else self.models.get((names, ""))
        return found if found is not None and found.helps else None


def learn_field(units: Sequence[FieldUnit], scales: Mapping[str, float]) -> Field:
    """Learn what heliostats have in common.

    units: Heliostats, at most some hundred.
    scales: Prior sigma of each parameter, which bounds mean and scatter where the field says nothing.
    Returns: A model for the heliostats with the same parameters; for groups of them where those predict each other
        better than all do together.
    """
    kinds: dict[tuple[str, ...], list[FieldUnit]] = {}
    for unit in units:
        kinds.setdefault(unit.rows.names, []).append(unit)
    together = {(names, ""): learn_model(some, _in_order(names, scales)) for names, some in kinds.items()}
    best, best_score = Field("", together), sum(_score(model) for model in together.values())
    for grouping in dict.fromkeys(name for unit in units for name in unit.groups):
        apart = dict(together)
        score = 0.0
        for names, some in kinds.items():
            rest = dict(zip(together[names, ""].units, np.minimum(together[names, ""].gains, _MOST_GAIN), strict=True))
            members: dict[str, list[FieldUnit]] = {}
            for unit in some:
                members.setdefault(unit.groups.get(grouping, ""), []).append(unit)
            for group, own in members.items():
                if group and _LEAST_GROUP <= len(own) < len(some):
                    noise = together[names, ""].noise
                    apart[names, group] = learn_model(own, _in_order(names, scales), noise)
                    score += _score(apart[names, group])
                else:
                    score += float(sum(rest[unit.name] for unit in own))
        if score > best_score:
            best, best_score = Field(grouping, apart), score
    return best


#: No single heliostat decides on a grouping: odds above e^20 are certainty.
_MOST_GAIN = 20.0


def _score(model: FieldModel) -> float:
    return float(np.clip(model.gains, -_MOST_GAIN, _MOST_GAIN).sum())


def _in_order(names: Sequence[str], scales: Mapping[str, float]) -> FloatArray:
    return np.array([scales[name] for name in names])


def learn_model(units: Sequence[FieldUnit], scales: FloatArray, noise: NoiseShape | None = None) -> FieldModel:
    """Learn mean and scatter of the parameters of heliostats of one kind, and their noise.

    scales (p,): Prior sigmas: of the mean, and of a half-normal prior of each scatter (Gelman 2006).
    noise: The noise, if it is known.
    Returns: The most probable scatter by marginal likelihood, the mean of its square, and the mean, exact given the
        scatter.
    """
    names = units[0].rows.names
    if noise is None:
        noise = _field_noise(units, scales)
    equations = [unit.rows.equations(noise.followed) for unit in units]
    found = _estimate(equations, scales)
    count = len(units) - 1
    without = {
        unit.name: _without(equations, scales, found, index).prior(names, noise, count)
        for index, unit in enumerate(units)
    }
    general = FieldPrior(
        names, np.zeros(scales.size), scales, scales**2, np.zeros((scales.size, scales.size)), noise, 0
    )
    gains = [
        settle(one, without[unit.name]).log_evidence - settle(one, general).log_evidence
        for unit, one in zip(units, equations, strict=True)
    ]
    return FieldModel(
        names,
        found.mean,
        found.scatter,
        found.variance,
        found.mean_covariance,
        noise,
        tuple(unit.name for unit in units),
        found.weights,
        without,
        np.array(gains),
    )


class _Estimate(NamedTuple):
    """What heliostats have in common.

    Mean (p,), scatter (p,), mean of its square (p,), covariance of the mean (p, p); weights (k, p) and size of noise
    (k,) of each one.
    """

    mean: FloatArray
    scatter: FloatArray
    variance: FloatArray
    mean_covariance: FloatArray
    weights: FloatArray
    noises: FloatArray

    def prior(self, names: tuple[str, ...], noise: NoiseShape, heliostats: int) -> FieldPrior:
        """Return what it says of one more heliostat."""
        return FieldPrior(names, self.mean, self.scatter, self.variance, self.mean_covariance, noise, heliostats)


def _without(equations: Sequence[NormalEquations], scales: FloatArray, every: _Estimate, index: int) -> _Estimate:
    """Return the estimate without one heliostat."""
    rest = [one for place, one in enumerate(equations) if place != index]
    if len(equations) <= _FEW:
        return _estimate(rest, scales, every.scatter)
    # Of many, one moves the mean a little and the scatter by nothing that matters: only its share is taken away.
    own = equations[index].scaled(every.noises[index])
    shares = _MeanShares.of(own.matrix[None], own.rhs[None], every.weights[[index]] / every.scatter**2)
    information = np.linalg.inv(every.mean_covariance)
    covariance = np.linalg.inv(information - shares.information)
    return every._replace(
        mean=covariance @ (information @ every.mean - shares.pull), mean_covariance=np.asarray(covariance)
    )


class _MeanShares(NamedTuple):
    """What heliostats say of the mean together: information (p, p), pull (p,); covariances of each given it."""

    information: FloatArray
    pull: FloatArray
    covariances: FloatArray
    shrinkage: FloatArray

    @classmethod
    def of(cls, matrices: FloatArray, rhs: FloatArray, inverse: FloatArray) -> "_MeanShares":
        """Integrate each heliostat out: (k, p, p), (k, p), inverse variances of its scatter (k, p)."""
        identity = np.eye(matrices.shape[1])
        given = np.asarray(np.linalg.inv(matrices + inverse[:, :, None] * identity), dtype=np.float64)
        shrinkage = given * inverse[:, None, :]
        kept = inverse[:, :, None] * (identity - shrinkage)
        return cls(kept.sum(axis=0), np.einsum("ki,kij,kj->i", inverse, given, rhs), given, shrinkage)


def _estimate(equations: Sequence[NormalEquations], scales: FloatArray, start: FloatArray | None = None) -> _Estimate:
    """Maximise the evidence of all heliostats over the scatter of each parameter.

    With offsets ``x_ij ~ N(mean_i, scatter_i^2 / w_ij)``, noise scales by each one's own evidence, and the weights
    ``w_ij = (f + 1) / (f + E d_ij^2)`` of Student's t (Lange, Little and Taylor 1989). The gradient of the log evidence
    is that of the expected complete-data likelihood (Fisher's identity), so that a quasi-Newton method takes some
    thirty steps where EM, which has the same maximum, takes thousands for parameters that trade against each other.
    """
    from scipy.optimize import minimize

    p, k = scales.size, len(equations)
    prior_scatter = scales if not k else (scales * 0.5 if start is None else start)
    logs = np.clip(np.log(prior_scatter / scales), *_LOG_SCATTER)
    mean, mean_covariance, weights, noises = np.zeros(p), np.diag(scales**2), np.ones((k, p)), np.ones(k)
    if not k:
        return _Estimate(mean, scales, scales**2, mean_covariance, weights, noises)
    matrices = np.array([one.matrix for one in equations]) * scales[:, None] * scales
    rhs = np.array([one.rhs for one in equations]) * scales
    state: dict[str, FloatArray] = {}

    def cost(logs: FloatArray) -> tuple[float, FloatArray]:
        inverse = weights * np.exp(-2 * logs)
        over = noises[:, None] ** -2
        own, pulls = matrices * over[:, :, None], rhs * over
        shares = _MeanShares.of(own, pulls, inverse)
        information = np.eye(p) + shares.information
        covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
        middle = covariance @ shares.pull
        offsets = np.einsum("kij,kj->ki", shares.covariances, pulls + inverse * middle)
        apart = offsets - middle
        left = np.eye(p) - shares.shrinkage
        spread = np.einsum("kii->ki", shares.covariances) + apart**2
        spread = spread + np.einsum("kij,jl,kil->ki", left, covariance, left)
        state.update(mean=middle, covariance=covariance, distance=spread * np.exp(-2 * logs))
        twice = -np.linalg.slogdet(shares.covariances)[1].sum() + 2 * k * logs.sum()
        twice += np.linalg.slogdet(information)[1] + middle @ middle
        twice += np.einsum("ki,kij,kj->", offsets, own, offsets) - 2 * np.sum(pulls * offsets)
        twice += np.sum(apart**2 * inverse) + np.exp(2 * logs).sum()
        gradient = 2 * (k - np.sum(weights * spread, axis=0) * np.exp(-2 * logs)) + 2 * np.exp(2 * logs)
        return float(twice), gradient

    for _ in range(_WEIGHT_ROUNDS):
        covariance = (np.diag(np.exp(2 * logs)) + mean_covariance / scales[:, None] / scales) * scales[:, None] * scales
        noises = np.array([unit_noise(one, mean, covariance).factor for one in equations])
        logs = minimize(cost, logs, jac=True, method="L-BFGS-B", bounds=[_LOG_SCATTER] * p).x
        cost(logs)
        weights = student_weights(state["distance"])
        mean, mean_covariance = state["mean"] * scales, state["covariance"] * scales[:, None] * scales
    expected = _expected_variance(cost, logs) * scales**2
    return _Estimate(mean, np.exp(logs) * scales, expected, mean_covariance, weights, noises)


def _expected_variance(cost: Callable[[FloatArray], tuple[float, FloatArray]], logs: FloatArray) -> FloatArray:
    """Return the posterior mean of each squared scatter, the others being what they are, over the scale's.

    cost: -2 log of the posterior density by the logs of the scatters, and its gradient.
    logs (p,): Where it is most probable.
    """
    from scipy.interpolate import CubicHermiteSpline

    found = np.zeros(logs.size)
    fine = np.linspace(_ASKED[0], _ASKED[-1], 20 * _ASKED.size)
    for index in range(logs.size):
        asked = np.tile(logs, (_ASKED.size, 1))
        asked[:, index] = _ASKED
        values, gradients = zip(*(cost(one) for one in asked), strict=True)
        twice = CubicHermiteSpline(_ASKED, values, [gradient[index] for gradient in gradients])(fine)
        # The density is that of the scatter; steps are of its log.
        chance = np.exp(fine - 0.5 * (twice - twice.min()))
        found[index] = float(chance @ np.exp(2 * fine) / chance.sum())
    return found


#: Logs of the scatter over its scale for its posterior mean; beyond, the half-normal prior leaves nothing.
_ASKED = np.linspace(-4.5, 1.25, 9)


def _field_noise(units: Sequence[FieldUnit], scales: FloatArray) -> NoiseShape:
    """Return the most probable noise of the heliostats with the most rows, given what these have in common."""
    longest: IntArray = np.argsort([-unit.rows.residuals.size for unit in units], kind="stable")[:_NOISE_UNITS]
    some = [units[index].rows for index in longest]
    first = _estimate([rows.equations(USUAL_NOISE.followed) for rows in some], scales)
    prior = first.prior(some[0].names, USUAL_NOISE, len(some))
    return likely_noise(some, prior.mean, prior.covariance)


def likely_noise(some: Sequence[LinearRows], mean: FloatArray, covariance: FloatArray) -> NoiseShape:
    """Return the most probable shape of the noise, each number within a factor of e (one sigma) of the usual one.

    some: Observations of one heliostat or of several.
    mean (p,), covariance (p, p): What is known of the parameters of each.
    """
    from scipy.optimize import minimize

    def shape(logs: FloatArray) -> NoiseShape:
        white, day, wander, misfit = np.exp(logs).tolist()
        usual = USUAL_NOISE
        return replace(
            usual,
            white=usual.white * white,
            day_rad=usual.day_rad * day,
            wander_rad=usual.wander_rad * wander,
            misfit_rad=usual.misfit_rad * misfit,
        )

    def cost(logs: FloatArray) -> float:
        noise = shape(logs)
        evidence = sum(unit_noise(rows.equations(noise), mean, covariance).log_evidence for rows in some)
        return float(-2 * evidence + logs @ logs)

    found = minimize(cost, np.zeros(4), method="Nelder-Mead", options={"maxfev": _NOISE_STEPS, "xatol": 0.05})
    return shape(np.asarray(found.x))
