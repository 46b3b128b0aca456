"""Robust adjustment of a heliostat's numbers to observations of any kinds, with covariance and named doubts."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calibration.heliostat.fitting.fit_model import Descended, FitModel, descend
from calibration.heliostat.fitting.fit_result import FitOptions, HeliostatFit
from calibration.heliostat.fitting.observability import Combination, unobserved
from calibration.heliostat.kinematic_model.design import HeliostatDesign
from calibration.heliostat.observations.observations import Observations
from calibration.heliostat.observations.residuals import Residuals, evaluate
from heliogauge.adjust.chi_square import chi_square_quantile, two_sided_probability
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import EstimationError
from heliogauge.validate import BoolArray, FloatArray, freeze

# Rounds of scale and rejection: 12 % of gross errors settle in 4 to 6.
_MOST_ROUNDS = 15
#: Scatter about the fit beyond which further starts are worth their time [rad of the beam or line of sight].
_FAR_RAD = 0.01
# What could be wrong of an actuator grows to 30 % when nothing less explains the observations.
_WIDE_REACH = 10.0
# A robust scale is as uncertain as that of fewer normal residuals: 0.53 to 0.70 of them (1500 draws of 200 rows).
_SCALE_EFFICIENCY = 0.55
# While rows and scale still move a tenth of a sigma is near enough; a thousandth at the end.
_ON_THE_WAY, _AT_THE_END = 0.1, 1e-3
# Where observations are linear a hundredth costs nothing: rows and scale settle in one go.
_WHERE_LINEAR = 0.01
# Observations are linear enough where the answer with them differs by less than so many sigmas; else they are made
# linear anew, so often at most.
_BENT, _MOST_LINEAR = 0.5, 3


def fit(
    design: HeliostatDesign,
    observations: Observations,
    options: FitOptions | None = None,
    *,
    near: HeliostatFit | None = None,
) -> HeliostatFit:
    """Fit a heliostat's free parameters to observations.

    design: The heliostat; the sigmas of its parameters: held (0), known before (prior) and free (inf).
    observations: Any mixture of kinds.
    near: A fit of the same heliostat to more rows, about which these are made linear at first. The answer is that of
        these rows alone, to a thousandth of a sigma; it saves the way from the design's numbers.
    Returns: Estimates with covariance, residuals of all rows, what was rejected and why, what was not observable.
    InputError: Observations and design do not fit each other.
    EstimationError: No reading can be computed, or a free parameter is determined by nothing.

    One descent from the design's own numbers: the cost has one basin, and other starts are tried only where the first
    ends in no minimum or more than 10 mrad from the observations. Rows are weighted by Huber's loss on the length of
    their residual, whose scale starts at the median and settles with the fit; rows beyond the chi-square limit of the
    stated chance are left out and tested again in every round. With estimated sigmas each kind has its own factor,
    ``sum psi^2 / E psi^2`` over its redundancy; the priors keep theirs.
    """
    options = options or FitOptions()
    extended = design.with_parameters(design.parameters.extended(observations.extra_parameters(design)))
    # Weak priors on all that is free keep the first steps in range; they stay only where nothing else holds.
    model = FitModel(extended, observations, options, frozenset(extended.parameters.names))
    end, tried = _from(model, model.start, near), 1
    if _far_rad(end) > _FAR_RAD:
        end, tried = _restarted(end)
    end.solution.require(design.name) if end.solution.null_space.size else None
    return _result(end.with_own_covariance(), tried)


def _from(model: FitModel, start: FloatArray, near: HeliostatFit | None = None) -> Descended:
    """Fit from one start."""
    if np.isfinite(model.design.parameters.sigmas[model.columns]).all():
        # Nothing but priors holds what is not observed.
        return _settled(_first(model, start) if near is None else _first_near(model, near))
    first = _first(model, start)
    weak = _held_by_nothing(first)
    end = _settled(_again(first, replace(model, fallback=weak)))
    # At the scale of a start that may be degrees off nothing looks observed: decide anew at the settled one.
    now = _held_by_nothing(end)
    if now == weak:
        return end
    end = _settled(_again(end, replace(model, fallback=now)))
    late = _held_by_nothing(end) - now
    return _settled(_again(end, replace(model, fallback=now | late))) if late else end


def _first(model: FitModel, start: FloatArray) -> Descended:
    usable = model.whitened(start).computable
    if usable.size and not usable.any():
        raise EstimationError(
            f"{model.design.name}: no reading lies within the geometry of the actuators as they are described; "
            "check their numbers and the unit of the readings"
        )
    return descend(model, start, _medians(model, start, usable), usable, _ON_THE_WAY)


def _first_near(model: FitModel, near: HeliostatFit) -> Descended:
    """Descend from the design's numbers as the observations are about another fit, all of them in use."""
    known = dict(zip(near.names, near.values.tolist(), strict=True))
    about = np.array([known.get(name, value) for name, value in zip(model.names, model.start.tolist(), strict=True)])
    usable = model.whitened(about).computable
    if not usable.any() or _median_angle(model, about) > _FAR_RAD:
        return _first(model, model.start)
    return descend(model.linear_about(about), model.start, _medians(model, about, usable), usable, _ON_THE_WAY)


def _medians(model: FitModel, free: FloatArray, used: BoolArray) -> dict[str, float]:
    """Scale of each kind by the median length of its residuals, not below the stated sigma."""
    lengths, scale = np.sqrt(np.bincount(model.owners, model.whitened(free).residuals ** 2, minlength=used.size)), {}
    for kind, own in model.rows_of.items():
        chosen = own & used
        middle = chi_square_quantile(0.5, int(model.components[own][0]))
        scale[kind] = max(float(np.median(lengths[chosen])) / np.sqrt(middle), 1.0) if chosen.any() else 1.0
    return scale


def _again(before: Descended, model: FitModel) -> Descended:
    """Descend from where another descent ended, with its rows."""
    return descend(model, before.values, before.factors, before.used, _ON_THE_WAY)


def _settled(end: Descended) -> Descended:
    """Iterate descent, scale and rejection until rows and scale stay.

    Near the answer all of that is done with the observations made linear, and tested with the observations themselves.
    """
    if end.solution.converged and (end.model.is_linear or _far_rad(end) < _FAR_RAD):
        for _ in range(_MOST_LINEAR):
            about = end.model if end.model.is_linear else end.model.linear_about(end.values)
            near = _decided(replace(end, model=about), _WHERE_LINEAR)
            end = replace(end, model=end.model.exact)
            if not end.model.whitened(near.end.values).computable[near.end.used].all():
                break
            end = descend(end.model, near.end.values, near.end.factors, near.end.used, _AT_THE_END)
            sigmas = np.sqrt(np.diag(near.end.solution.covariance))
            if not (np.abs(end.values - near.end.values) > _BENT * sigmas).any():
                return _rounds(end, near.estimated, _AT_THE_END)
    end = _decided(replace(end, model=end.model.exact), _ON_THE_WAY).end
    return descend(end.model, end.values, end.factors, end.used, _AT_THE_END)


class _Decided(NamedTuple):
    """Where rows and scale stay, and of which kinds the sigma is estimated rather than believed."""

    end: Descended
    estimated: Mapping[str, bool]


def _decided(end: Descended, tolerance: float) -> _Decided:
    """Iterate with the sigma of all kinds estimated, then again with those believed that are not refuted."""
    options = end.model.options
    estimated = dict.fromkeys(end.factors, True)
    end = _rounds(end, estimated, tolerance)
    if options.sigma != "estimated":
        believed = {kind for kind in end.factors if options.sigma == "stated" or not _refuted(end, kind)}
        if believed:
            factors = {kind: 1.0 if kind in believed else factor for kind, factor in end.factors.items()}
            end = descend(end.model, end.values, factors, _acceptable(end, factors), tolerance)
            estimated = {kind: kind not in believed for kind in end.factors}
            end = _rounds(end, estimated, tolerance)
    return _Decided(end, estimated)


def _rounds(end: Descended, estimated: Mapping[str, bool], tolerance: float) -> Descended:
    for _ in range(_MOST_ROUNDS):
        scatter = end.scatter()
        known = {kind: estimated[kind] and np.isfinite(scatter[kind]) for kind in end.factors}
        factors = {kind: scatter[kind] if known[kind] else old for kind, old in end.factors.items()}
        # Nothing to spare: what the median gave on the way gives place to the stated sigma.
        factors = {kind: 1.0 if np.isnan(scatter[kind]) else factor for kind, factor in factors.items()}
        used = _acceptable(end, factors)
        still = all(abs(factors[kind] / end.factors[kind] - 1) < 5e-3 for kind in factors)
        if still and (used == end.used).all():
            break
        end = descend(end.model, end.values, factors, used, tolerance)
    return end


def _acceptable(end: Descended, factors: Mapping[str, float]) -> BoolArray:
    used = end.accepted(factors)
    # Never fewer rows than the majority: what then remains is not the heliostat but a coincidence.
    return used if 2 * used.sum() >= used.size else end.used


def _refuted(end: Descended, kind: str) -> bool:
    """Whether the residuals of a kind are too large or too small for the stated sigma."""
    freedom, scatter = end.redundancy()[kind], end.scatter()[kind]
    if freedom <= 2 or np.isnan(scatter):
        return False
    freedom *= 1.0 if end.model.options.loss == "squares" else _SCALE_EFFICIENCY
    return two_sided_probability(scatter**2 * freedom, freedom) < end.model.options.refuted_below


def _far_rad(end: Descended) -> float:
    """Median angle between observation and prediction [rad], of the beam or the normal."""
    return _median_angle(end.model.exact, end.values)


def _median_angle(model: FitModel, free: FloatArray) -> float:
    angles = model.miss_rad(free)
    angles = angles[model.whitened(free).computable & np.isfinite(angles)]
    return float(np.median(angles)) if angles.size else 0.0


def _restarted(end: Descended) -> tuple[Descended, int]:
    """Try other starts, the first with a wider reach only, and keep the one that ends nearest to the observations."""
    everything = frozenset(end.model.design.parameters.names)
    model, rng = replace(end.model, reach=_WIDE_REACH, fallback=everything), np.random.default_rng(0)
    angular = np.array([model.design.parameters.units[i] == "rad" for i in model.columns], dtype=np.bool_)
    spread = np.where(angular, np.minimum(model.priors, 0.3), 0.0)
    best, best_far, tried = end, _far_rad(end), 1
    while tried <= model.options.restarts and best_far > _FAR_RAD:
        start = model.start + spread * (rng.standard_normal(spread.size) if tried > 1 else 0.0)
        tried += 1
        if not model.evaluate(start).computable.any():
            continue
        other = _from(model, start)
        far = _far_rad(other)
        if far < 0.9 * best_far:
            best, best_far = other, far
    return best, tried


def _unobserved(end: Descended) -> tuple[Combination, ...]:
    model = end.model
    chosen = end.used[model.owners]
    factor = model.row_factors(end.factors)[model.owners[chosen]]
    jacobian = model.whitened(end.values).jacobian[chosen] / factor[:, None]
    return unobserved(jacobian, model.names, model.design.parameters.sigmas[model.columns], model.scales)


def _held_by_nothing(end: Descended) -> frozenset[str]:
    """Free parameters without a prior that take part in what is not observed."""
    own = dict(zip(end.model.names, end.model.design.parameters.sigmas[end.model.columns], strict=True))
    lost = {name for one in _unobserved(end) for name in one.names}
    return frozenset(name for name in lost if np.isinf(own[name]))


def _result(end: Descended, tried: int) -> HeliostatFit:
    model = end.model
    values = model.full(end.values)
    covariance = np.zeros((values.size, values.size))
    covariance[np.ix_(model.columns, model.columns)] = end.solution.covariance
    # With everything free the last evaluation has all derivatives.
    complete = model.columns.size == values.size
    residuals = model.evaluate(end.values) if complete else evaluate(model.design, values, model.observations)
    combinations = _unobserved(end)
    weight, leverage = _per_row(end)
    return HeliostatFit(
        design=model.design.with_parameters(model.design.parameters.with_values(values)),
        nominal=model.design,
        observations=model.observations,
        solution=end.solution,
        covariance=np.asarray(freeze(covariance)),
        residuals=residuals,
        rejected=np.asarray(freeze(~end.used)),
        reason=_reasons(end, residuals),
        weight=weight,
        leverage=leverage,
        sigma_factors=dict(end.factors),
        sigma0=end.scatter(),
        unobservable=combinations,
        basins=tried,
        doubts=tuple(_doubts(end, combinations)),
    )


def _per_row(end: Descended) -> tuple[FloatArray, FloatArray]:
    """Weight and leverage of each row, 0 where it was left out."""
    owners = end.model.owners[end.used[end.model.owners]]
    size, components = end.used.size, end.model.components
    weight = np.bincount(owners, end.solution.weights[: owners.size], minlength=size) / components
    controlled = np.bincount(owners, end.solution.redundancy_numbers[: owners.size], minlength=size) / components
    return freeze(weight), freeze(np.where(end.used, 1 - controlled, 0.0))


def _reasons(end: Descended, residuals: Residuals) -> tuple[str, ...]:
    lengths, limits = residuals.lengths / end.model.row_factors(end.factors), end.limits()
    reasons = [""] * end.used.size
    for i in np.flatnonzero(~end.used):
        if not residuals.computable[i]:
            reasons[i] = "the readings lie outside the geometry of an actuator"
            continue
        angle = residuals.beam_angle_rad[i]
        what = f"{1e3 * angle:.1f} mrad of the beam, " if np.isfinite(angle) else ""
        reasons[i] = f"outlier: {what}{lengths[i]:.1f} sigma from the fit, {limits[i]:.1f} allowed"
    return tuple(reasons)


def _doubts(end: Descended, combinations: tuple[Combination, ...]) -> Iterator[Doubt]:
    """Yield what a user must know before believing the numbers."""
    used, rejected, rows = int(end.used.sum()), int((~end.used).sum()), end.used.size
    if not end.solution.converged:
        yield Doubt("fit_not_converged", f"the fit has not converged: {end.solution.reason}", severity=Severity.SERIOUS)
    if combinations and len(combinations) == len(end.model.names):
        text = f"{used} usable observations determine less than the priors: this is a prior-only answer"
        yield Doubt("answer_is_of_priors_only", text, {"used_count": used})
    for one in combinations:
        if not one.held_by_prior:
            yield Doubt("parameters_not_observed", f"not observed: {one.text}; held near the given value")
    if rejected > 0.2 * rows:
        text = f"{rejected} of {rows} observations rejected: more than outliers should be"
        yield Doubt("many_observations_rejected", text, {"rejected_count": rejected, "observations_count": rows})
    for kind, factor in end.factors.items():
        if factor != 1.0:
            # That the scale of the sigmas is estimated is no fault of the heliostat.
            text = f"sigma of {kind} observations estimated from the residuals: {factor:.2g} times the stated one"
            yield Doubt("sigma_estimated_from_residuals", text, {"scale_factor": factor}, Severity.NOTE)
    far = _far_rad(end)
    if far > _FAR_RAD:
        yield Doubt(
            "observations_far_from_fit",
            f"the observations lie {1e3 * far:.0f} mrad from the best fit in the median: "
            "the model or the numbers it was given are wrong",
            {"median_distance_rad": far},
            Severity.SERIOUS,
        )
