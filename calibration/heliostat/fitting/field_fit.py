"""The fit of a heliostat within what its field knows: correlated noise, all parameters, one posterior."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calibration.heliostat.fitting.drift_noise import (
    USUAL_NOISE,
    Drift,
    LinearRows,
    NoiseShape,
    Occasions,
    SolvedRows,
    drive_zeros,
    occasions_of,
)
from calibration.heliostat.fitting.field_model import likely_noise
from calibration.heliostat.fitting.field_prior import FieldPrior, Settled, settle
from calibration.heliostat.fitting.fit_result import HeliostatFit
from calibration.heliostat.fitting.observability import plausible_scales, unobserved
from calibration.heliostat.fitting.priors import PRIORS, prior_sigma, with_all_terms
from calibration.heliostat.kinematic_model.design import HeliostatDesign
from calibration.heliostat.observations.residuals import ObservationModel, evaluate
from heliogauge.validate import BoolArray, FloatArray, IntArray, freeze

# Steps of Gauss and Newton; from a robust fit two bring the rest below a hundredth of a sigma.
_MOST_STEPS, _NEAR = 6, 0.01
#: Doubts of a robust fit that hold whatever the other parameters are.
_STILL_TRUE = ("many_observations_rejected", "sigma_estimated_from_residuals", "observations_far_from_fit")


def field_names(design: HeliostatDesign) -> tuple[str, ...]:
    """Return the parameters of which a field can know something: those with a prior, in the design's order.

    design: The heliostat, with all its terms (`with_all_terms`).
    """
    used = set(design.used_names)
    return tuple(name for name in design.parameters.names if name in PRIORS and name in used)


def linear_rows(found: HeliostatFit, names: Sequence[str]) -> LinearRows:
    """Return the observations that a robust fit used, linear about its estimate in some parameters.

    found: A robust fit; its weights count.
    names: Parameters of its design, free or held.
    """
    return _Linearising.of(found, tuple(names)).at(found.values).rows


class _Linearised(NamedTuple):
    """Observations in use about some values, and whether all can be computed there."""

    rows: LinearRows
    complete: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Linearising:
    """The observations that a robust fit used, ready to be made linear about any values.

    names: Parameters.
    model: Its observations, differentiated by these and by the zeros of both drives.
    place (k + 2,): Where these are in the model's derivatives.
    chosen: Components in use.
    occasions, weight: Of these; where the mirror looked is that of the robust fit.
    """

    found: HeliostatFit
    names: tuple[str, ...]
    model: ObservationModel
    columns: IntArray
    place: IntArray
    chosen: BoolArray
    occasions: Occasions
    weight: FloatArray

    @classmethod
    def of(cls, found: HeliostatFit, names: tuple[str, ...]) -> "_Linearising":
        """Choose the rows and derivatives."""
        columns = found.nominal.parameters.indices((*names, *drive_zeros(found.nominal)))
        order = np.unique(columns)
        model = ObservationModel(found.nominal, found.observations, order)
        chosen = found.used[model.owners]
        owner = model.owners[chosen]
        weight = np.clip(found.weight[owner], _LEAST_WEIGHT, 1.0)
        occasions = occasions_of(found.nominal, found.values, found.observations).select(owner)
        return cls(found, names, model, columns, np.searchsorted(order, columns), chosen, occasions, weight)

    def at(self, values: FloatArray) -> _Linearised:
        """Linearise about values of all parameters, shape (p,)."""
        k = len(self.names)
        found = self.found.residuals
        if found.jacobian.shape[1] == values.size and (values == self.found.values).all():
            # The fit itself has been differentiated.
            whitened, computable, jacobian, place = found.whitened, found.computable, found.jacobian, self.columns
        else:
            whitened, jacobian, computable = self.model.whitened(values)
            place = self.place
        own = jacobian[np.ix_(self.chosen, place)]
        offsets = (values - self.found.nominal.parameters.values)[self.columns[:k]]
        residuals = whitened[self.chosen] - own[:, :k] @ offsets
        rows = LinearRows(self.names, residuals, own[:, :k], own[:, k:], self.occasions, self.weight)
        return _Linearised(rows, bool(computable[self.found.used].all()))


#: A row that a robust loss all but ignores still has a variance.
_LEAST_WEIGHT = 0.01


class WithinField(NamedTuple):
    """A fit, and whether what the field knows was used for it."""

    fit: HeliostatFit
    by_field: bool


def fit_within(found: HeliostatFit, field: FieldPrior | None) -> WithinField:
    """Fit a heliostat again within what is known of it: by its field, or by the general priors.

    found: Its robust fit within the general priors.
    field: What the others say; None where there are none, or where they do not help.
    Returns: Within the field's priors, or within the general ones with the noise that its own rows show.
    """
    if field is None:
        prior = general_prior(found, USUAL_NOISE)
        if prior.names and found.used.any():
            rows = linear_rows(found, prior.names)
            prior = replace(prior, noise=likely_noise([rows], prior.mean, prior.covariance))
        return WithinField(fit_with_field(found, prior), False)
    return WithinField(fit_with_field(found, field), True)


def fit_beside(found: HeliostatFit, field: FieldPrior | None) -> HeliostatFit:
    """Fit everything that may be wrong of a heliostat, beside a fit of some parameters alone.

    found: A robust fit; the rows that it used count, as much as it left to them.
    field: What the other heliostats say; None for the general priors.
    Returns: What is known of the heliostat, whatever was held: by it the errors of the fit are judged.
    """
    every = replace(found, nominal=with_all_terms(found.nominal), design=with_all_terms(found.design))
    if field is not None:
        return fit_with_field(every, field)
    names, parameters = field_names(every.nominal), every.nominal.parameters
    known = {name: prior_sigma(every.nominal, name) for name in names}
    usual = {name: PRIORS[name].of(parameters.value(name)) for name in names}
    sigmas = {name: sigma if np.isfinite(sigma) else usual[name] for name, sigma in known.items()}
    nominal = every.nominal.with_parameters(parameters.with_sigmas(sigmas))
    solution = replace(found.solution, names=tuple(dict.fromkeys((*found.solution.names, *names))))
    return fit_within(replace(every, nominal=nominal, solution=solution), None).fit


def general_prior(found: HeliostatFit, noise: NoiseShape) -> FieldPrior:
    """Return the prior of a robust fit: its parameters about their nominal values within their own sigmas.

    noise: How observations scatter.
    """
    parameters = found.nominal.parameters
    names = tuple(name for name in found.solution.names if name in PRIORS and np.isfinite(parameters.sigma(name)))
    sigmas = parameters.sigmas[parameters.indices(names)]
    return FieldPrior(names, np.zeros(len(names)), sigmas, sigmas**2, np.zeros((len(names), len(names))), noise, 0)


def fit_with_field(found: HeliostatFit, prior: FieldPrior) -> HeliostatFit:
    """Fit a heliostat again, within what its field knows.

    found: Its robust fit; which rows count, and how much, is taken from it. Its design holds all parameters of the
        field; what the observations brought besides (cameras) stays free.
    prior: What the others say.
    Returns: The most probable offsets under the prior and noise that moves the drives' zeros from day to day, with
        the covariance of their errors, the misfit's part included.

    The noise's size follows from the evidence of its own observations (`settle`); the misfit is a part of it, by which
    they are not weighed (`NoiseShape.followed`). Parameters of which a survey said more than the field does keep the
    survey's sigma.
    """
    design = found.nominal
    known = _joined(found, prior)
    place = design.parameters.indices(known.names)
    values = found.values.copy()
    linearising = _Linearising.of(found, known.names)
    rows = linearising.at(values).rows
    settled = settle(rows.solved(prior.noise).equations, known)
    # How noise is weighed hardly depends on where the rows are made linear: once, at the robust fit.
    weighing = rows.weighing(prior.noise.followed)
    solved = weighing.solved(rows.jacobian, rows.residuals)
    converged = False
    for _ in range(_MOST_STEPS):
        step = _step(solved, known, settled)
        moved = values.copy()
        moved[place] = design.parameters.values[place] + step.offsets
        change = np.abs(moved - values)[place] / step.sigmas
        if change.max() < _NEAR:
            values, converged = moved, True
            break
        again = linearising.at(moved)
        if not again.complete:
            # Beyond the geometry of an actuator nothing can be predicted: half of the way.
            moved[place] = 0.5 * (moved[place] + values[place])
            again = linearising.at(moved)
            if not again.complete:
                break
        values, rows = moved, again.rows
        solved = weighing.solved(rows.jacobian, rows.residuals)
    final = _posterior(solved, known, settled)
    return _result(found, known.names, values, rows, final, np.sqrt(np.diag(settled.spread)), converged)


def _joined(found: HeliostatFit, prior: FieldPrior) -> FieldPrior:
    """Join what a survey says of single parameters to the prior, and what the observations brought besides."""
    parameters, k = found.nominal.parameters, len(prior.names)
    mean, scatter, wide = prior.mean.copy(), prior.scatter.copy(), prior.variance.copy()
    shared = prior.mean_covariance.copy()
    for index, name in enumerate(prior.names):
        surveyed = _surveyed_sigma(found.nominal, name) if prior.heliostats else None
        if surveyed is not None:
            # One more observation: no offset within the survey's sigma.
            variance = scatter[index] ** 2 + shared[index, index]
            mean[index] *= surveyed**2 / (variance + surveyed**2)
            scatter[index] = surveyed * np.sqrt(variance / (variance + surveyed**2))
            wide[index] = 1 / (1 / (wide[index] + shared[index, index]) + surveyed**-2)
            shared[index], shared[:, index] = 0.0, 0.0
    others = tuple(name for name in found.solution.names if name not in prior.names)
    if not others:
        return replace(prior, mean=mean, scatter=scatter, variance=wide, mean_covariance=shared)
    place = parameters.indices(others)
    scales = plausible_scales(parameters.values[place], others, [parameters.units[i] for i in place])
    own = parameters.sigmas[place]
    sigmas = np.where(np.isfinite(own), own, scales)
    whole = np.zeros((k + len(others), k + len(others)))
    whole[:k, :k] = shared
    return replace(
        prior,
        names=(*prior.names, *others),
        mean=np.concatenate([mean, np.zeros(len(others))]),
        scatter=np.concatenate([scatter, sigmas]),
        variance=np.concatenate([wide, sigmas**2]),
        mean_covariance=whole,
    )


def _surveyed_sigma(design: HeliostatDesign, name: str) -> float | None:
    """Return the design's own sigma of a parameter where it is not the general one."""
    own, value = design.parameters.sigma(name), design.parameters.value(name)
    return own if 0 < own < float("inf") and own != PRIORS[name].of(value) else None


class _Step(NamedTuple):
    """Most probable offsets (p,) and their sigmas (p,), as rows made linear give them.

    gain (p, p): Of the pull of observations and prior: covariance of normal errors.
    inverse (p, p): Of the prior's covariance.
    """

    offsets: FloatArray
    sigmas: FloatArray
    gain: FloatArray
    inverse: FloatArray


def _step(solved: SolvedRows, known: FieldPrior, settled: Settled) -> _Step:
    covariance, over = settled.covariance, settled.noise**-2
    # About the prior's own size of each parameter: metres and radians in one matrix.
    size = np.sqrt(np.diag(covariance))
    units = size[:, None] * size
    inverse = np.linalg.inv(covariance / units)
    gain = np.linalg.inv(over * solved.equations.matrix * units + inverse)
    pull = over * solved.equations.rhs * size + inverse @ (known.mean / size)
    return _Step(size * (gain @ pull), size * np.sqrt(np.diag(gain)), gain * units, inverse / units)


class _Posterior(NamedTuple):
    """Covariance (p, p) of the offsets' errors, and what they have to do with the drives' zeros."""

    covariance: FloatArray
    drift: Drift


def _posterior(solved: SolvedRows, known: FieldPrior, settled: Settled) -> _Posterior:
    noise, over, step = known.noise.times(settled.noise), settled.noise**-2, _step(solved, known, settled)
    link = over * solved.link
    # The estimate takes the prior for normal and the misfit for kinematics; what it may be wrong by has the tails of
    # Student's t, and the misfit's pull.
    spread = step.inverse @ settled.spread @ step.inverse
    kernel = noise.misfit.covariance(solved.occasions, solved.occasions)
    misfit = sum(own.T @ (kernel @ own) for own in link)
    wrong = step.gain @ (over * solved.equations.matrix + spread + misfit) @ step.gain
    return _Posterior(0.5 * (wrong + wrong.T), Drift(noise, solved.occasions, link @ step.gain))


def _result(
    found: HeliostatFit,
    names: tuple[str, ...],
    values: FloatArray,
    rows: LinearRows,
    final: _Posterior,
    sigmas: FloatArray,
    converged: bool,
) -> HeliostatFit:
    place = found.nominal.parameters.indices(names)
    held = found.nominal.parameters.with_only_free(())
    nominal = found.nominal.with_parameters(held.with_sigmas(dict(zip(names, sigmas.tolist(), strict=True))))
    # The solution keeps the order of the design, as every other fit does.
    order = np.argsort(place, kind="stable")
    covariance = np.zeros((values.size, values.size))
    covariance[np.ix_(place, place)] = final.covariance
    residuals = evaluate(nominal, values, found.observations)
    noise, size = final.drift.noise, len(found.observations)
    own = residuals.owner
    owner = own[found.used[own]]
    variance = noise.white**2 / rows.weight + noise.drive_variance_rad2 * np.sum(rows.drives**2, axis=1)
    share = np.einsum("ij,jk,ik->i", rows.jacobian, final.covariance, rows.jacobian) / variance
    components = np.maximum(np.bincount(owner, minlength=size), 1)
    leverage = np.bincount(owner, np.minimum(share, 1.0), minlength=size) / components
    offsets = (values - nominal.parameters.values)[place]
    whitened = (rows.residuals + rows.jacobian @ offsets) / noise.white
    scales = plausible_scales(nominal.parameters.values[place], names, [nominal.parameters.units[i] for i in place])
    weak = unobserved(
        (rows.jacobian / np.sqrt(variance)[:, None])[:, order],
        [names[i] for i in order],
        sigmas[order],
        scales[order],
    )
    solution = replace(
        found.solution,
        state=values[place][order],
        parameters=values[place][order],
        names=tuple(names[i] for i in order),
        covariance=final.covariance[np.ix_(order, order)],
        converged=found.solution.converged and converged,
        reason="within the field's priors" if converged else "the steps within the field's priors did not settle",
        rank=len(names),
        null_space=np.zeros((len(names), 0)),
        residuals=whitened,
        weights=rows.weight.copy(),
        redundancy_numbers=1 - np.minimum(share, 1.0),
        redundancy=int(whitened.size),
    )
    return replace(
        found,
        design=nominal.with_parameters(nominal.parameters.with_values(values)),
        nominal=nominal,
        solution=solution,
        covariance=np.asarray(freeze(covariance)),
        residuals=residuals,
        leverage=np.asarray(freeze(np.where(found.used, leverage, 0.0))),
        unobservable=weak,
        doubts=tuple(one for one in found.doubts if one.code in _STILL_TRUE),
        drift=replace(final.drift, link=final.drift.link[:, :, order]),
    )
