"""How probable the observations are under an explanation of what is wrong: numbers that are another's, or terms.

Under each the drives' zeros wander, the kinematics lack something, and numbers are within their usual sigmas; what an
explanation adds may be of any size. Numbers, terms and the noise's size are integrated out (Laplace's approximation):
an explanation with more of them is not the likelier one for having them.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calibration.heliostat.diagnosis.bounds import BOUNDS
from calibration.heliostat.fitting.drift_noise import (
    USUAL_NOISE,
    LinearRows,
    drive_zeros,
    occasions_of,
)
from calibration.heliostat.fitting.field_fit import field_names
from calibration.heliostat.fitting.fit_result import HeliostatFit
from calibration.heliostat.fitting.observability import plausible_scales
from calibration.heliostat.fitting.priors import prior_sigma, with_all_terms
from calibration.heliostat.fitting.unit_noise import unit_noise
from calibration.heliostat.kinematic_model.design import HeliostatDesign
from calibration.heliostat.observations.residuals import evaluate
from heliogauge.validate import BoolArray, FloatArray, IntArray

# What is wrong may be wrong by anything: Student's t of one degree, of which a tenfold size is a tenth as likely.
_FREEDOM = 1.0
# Usual size of a term: a tenth of what can be (a frame that bends by 4 mrad, a worm of 2 mrad, a play of 5 mrad).
_USUAL_SHARE = 0.1
# From here on the density of a row falls with the fourth power of its length, not as a normal one [scatter].
_TAIL = 2.0
# Median length of two normal components.
_MEDIAN_LENGTH = 1.17741
_ROUNDS, _NEAR = 30, 0.02


class BlamedTerm(NamedTuple):
    """A term that the residuals of a fit contain.

    kind: A key of `REMEDIES`.
    columns (m, q): Derivatives of all components of the fit by its coefficients [stated sigma]; 0 where not looked at.
    """

    kind: str
    columns: FloatArray

    @property
    def sigmas(self) -> FloatArray:
        """Usual size of each coefficient, shape (q,); numbers are in their own prior sigmas."""
        size = _USUAL_SHARE * BOUNDS[self.kind][0] if self.kind in BOUNDS else 1.0
        return np.full(self.columns.shape[1], size)


@dataclass(frozen=True, slots=True)
class Explanation:
    """What could be wrong.

    fit: Near the most probable numbers under it, where everything is made linear.
    doubted: Parameters that may be wrong by anything.
    terms: In the residuals of `fit`, of any size.
    """

    fit: HeliostatFit
    doubted: Collection[str] = ()
    terms: Sequence[BlamedTerm] = ()


def log_evidences(explanations: Sequence[Explanation], usual: HeliostatDesign) -> FloatArray:
    """Return the logarithm of the probability of the same observations under each explanation, shape (k,).

    explanations: k of them; rows that all can compute count.
    usual: The heliostat as given, with the prior sigmas of its parameters.
    """
    rows = np.logical_and.reduce([one.fit.residuals.computable for one in explanations])
    return np.array([log_evidence(one, usual, rows) for one in explanations])


def log_evidence(explanation: Explanation, usual: HeliostatDesign, rows: BoolArray) -> float:
    """Return the logarithm of the probability of some rows (n,) under an explanation.

    Each doubted number and each coefficient is normal with its usual variance over a weight of its own, whose
    distribution makes it Student's; EM finds the weight (as `settle` does). The noise has its usual shape, and its size
    is integrated out.
    """
    known = _known(explanation, usual)
    sigmas = np.concatenate([known.sigmas, *(term.sigmas for term in explanation.terms)])
    wide = np.ones(sigmas.size, dtype=np.bool_)
    wide[: len(known.names)] = [name in explanation.doubted for name in known.names]
    weighed = _Weighed(_linear_rows(explanation, known.names, rows), np.ones(sigmas.size))
    weighed = _settled(weighed, sigmas, wide)
    equations = weighed.seen.rows.equations(USUAL_NOISE)
    own = weighed.weights[wide]
    penalty = _FREEDOM * float(np.sum(own - 1 - np.log(own)))
    return unit_noise(equations, np.zeros(sigmas.size), weighed.covariance(sigmas)).log_evidence - 0.5 * penalty


class _Known(NamedTuple):
    """Parameters of a heliostat, and by how much each is usually wrong."""

    names: tuple[str, ...]
    sigmas: FloatArray


def _known(explanation: Explanation, usual: HeliostatDesign) -> _Known:
    usual = with_all_terms(usual)
    parameters = usual.parameters
    names = tuple(dict.fromkeys((*field_names(usual), *explanation.fit.solution.names)))
    place = parameters.indices(names)
    scales = plausible_scales(parameters.values[place], names, [parameters.units[i] for i in place])
    own = np.array([prior_sigma(usual, name) for name in names])
    return _Known(names, np.where(np.isfinite(own) & (own > 0), own, scales))


class _Seen(NamedTuple):
    """Rows made linear, and the row that each component (m,) belongs to."""

    rows: LinearRows
    owner: IntArray


def _linear_rows(explanation: Explanation, names: tuple[str, ...], rows: BoolArray) -> _Seen:
    fit = explanation.fit
    nominal, estimated = with_all_terms(fit.nominal), with_all_terms(fit.design)
    values = estimated.parameters.values
    found = evaluate(nominal, values, fit.observations)
    chosen = rows[found.owner]
    owner, place = found.owner[chosen], nominal.parameters.indices(names)
    jacobian = found.jacobian[chosen]
    own = jacobian[:, place]
    residuals = found.whitened[chosen] - own @ (values - nominal.parameters.values)[place]
    linear = LinearRows(
        (*names, *(f"{term.kind} {k + 1}" for term in explanation.terms for k in range(term.columns.shape[1]))),
        residuals,
        np.concatenate([own, *(term.columns[chosen] for term in explanation.terms)], axis=1),
        jacobian[:, nominal.parameters.indices(drive_zeros(nominal))],
        occasions_of(nominal, values, fit.observations).select(owner),
        np.ones(owner.size),
    )
    return _Seen(linear, owner)


class _Weighed(NamedTuple):
    """Rows with the weights that their distances leave them, and weights (p,) of the inverse variances of numbers."""

    seen: _Seen
    weights: FloatArray

    def covariance(self, sigmas: FloatArray) -> FloatArray:
        """Return the covariance (p, p) of the numbers' offsets before anything is observed."""
        return np.diag(sigmas**2 / self.weights)


def _settled(weighed: _Weighed, sigmas: FloatArray, wide: BoolArray) -> _Weighed:
    """Weigh rows and numbers by how far they are off, until nothing changes."""
    (rows, owner), weights = weighed
    for _ in range(_ROUNDS):
        equations = rows.equations(USUAL_NOISE)
        size = sigmas / np.sqrt(weights)
        over = unit_noise(equations, np.zeros(size.size), np.diag(size**2)).factor ** -2
        gain = np.linalg.inv(over * equations.matrix * size[:, None] * size + np.eye(size.size))
        offsets = size * (gain @ (over * equations.rhs * size))
        # Rounding takes a variance that is all but zero below it.
        squares = offsets**2 + size**2 * np.maximum(np.diag(gain), 0.0)
        before, weights = weights, np.where(wide, (_FREEDOM + 1) / (_FREEDOM + squares / sigmas**2), 1.0)
        left = rows.residuals + rows.jacobian @ offsets
        lengths = np.sqrt(np.bincount(owner, left**2))[owner]
        scale = float(np.median(lengths)) / _MEDIAN_LENGTH
        rows = replace(rows, weight=np.minimum(1.0, (_TAIL * scale / np.maximum(lengths, 1e-300)) ** 2))
        if np.abs(weights / before - 1).max(initial=0.0) < _NEAR:
            break
    return _Weighed(_Seen(rows, owner), weights)
