"""A fit made linear about its end, robust and with all rows, to ask what a further term would explain."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from calibration.heliostat.fitting.fit_result import HeliostatFit
from heliogauge.adjust.robust_loss import Huber
from heliogauge.validate import BoolArray, FloatArray, IntArray

#: A row agrees with the others when it lies within this of the fit [sigma of the beam].
EXPLAINED_SIGMAS = 4.0
#: Rows on either side of a change that are needed to speak of one.
FEWEST_ROWS = 4
# Length of a row's residual (two components) from which on its pull no longer grows [sigma].
_HUBER = Huber(2.0)
# Median length of two normal components.
_MEDIAN_LENGTH = 1.17741
# A row's share in what is unexplained is cut here: other outliers neither make nor hide a fault [sigma].
_CUT = 5.0
# Directions of a term that the heliostat's own parameters imitate to better than this do not determine it.
_IMITATED = 0.02
_ROUNDS = 12


@dataclass(frozen=True, slots=True, eq=False)
class LinearFit:
    """Residuals of a fit and their derivatives, in units of the rows' scatter.

    residual (m,): Predicted minus measured, then the pulls of the priors [sigma].
    base (m, k): Derivatives by what is adjusted anyhow.
    owner (m,): Row of each component, counted from 0; -1 for priors.
    scale: Scatter of the rows over their sigma.
    stated: What that is where they scatter as was stated of them.
    """

    residual: FloatArray
    base: FloatArray
    owner: IntArray
    count: int
    scale: float = 1.0
    stated: float = 0.0
    _kept: "list[_Asked]" = field(init=False, default_factory=list)

    @property
    def observed(self) -> BoolArray:
        """Components of observations, shape (m,)."""
        return np.asarray(self.owner >= 0)

    def lengths(self) -> FloatArray:
        """Return the length of each row's residual, shape (count,) [sigma]."""
        own = self.observed
        return np.sqrt(np.bincount(self.owner[own], self.residual[own] ** 2, minlength=self.count))

    def padded(self, columns: FloatArray) -> FloatArray:
        """Return columns for the rows' components (m_rows, q) with zeros for the priors."""
        filled = np.zeros((self.owner.size, columns.shape[1]))
        filled[self.observed] = columns
        return filled

    def scores(self, columns: "FloatArray | Windows") -> tuple[FloatArray, IntArray]:
        """Ask whether the residuals contain one of several terms.

        columns (looks, m_rows, q): Derivatives by the coefficients of each.
        Returns (looks,): Statistic of each: chi-square with its degrees of freedom if the term is not there.
        Returns (looks,): Degrees of freedom: directions of the term that the base does not imitate.

        A score test with Huber's influence: the bounded residuals are projected on what the columns have beyond the
        base. ``-(v + q / 2 - 1) ln(1 - R^2)``, with v spare components, is chi-square with q degrees to second order
        in 1 / v, and exactly for q = 2. Rows that scatter less than was stated of them are judged by what was stated:
        errors that they share do not scatter, and are no fault.
        """
        basis, pull, pull_in_base, whole = self._asked
        looks, _, q = columns.shape
        spare = int(self.observed.sum()) - basis.shape[1]
        if spare - q < 3 or whole == 0:
            return np.zeros(looks), np.zeros(looks, dtype=np.intp)
        own = self.observed
        square, shares = _products(columns, np.column_stack([basis[own], pull[own]]))
        size = np.sqrt(square.diagonal(axis1=1, axis2=2))
        over = 1 / np.where(size > 0, size, 1.0)
        imitated, along = shares[:, :-1] * over[:, None], shares[:, -1] * over
        # What the base takes of each column is a part of unit columns: the difference keeps 1e-15, 4e-4 counts.
        left = square * over[:, :, None] * over[:, None] - imitated.transpose(0, 2, 1) @ imitated
        values, vectors = (left[:, 0], np.ones_like(left)) if q == 1 else np.linalg.eigh(left)
        along = ((along - pull_in_base @ imitated)[:, None] @ vectors)[:, 0]
        seen = values > _IMITATED**2
        freedom = seen.sum(axis=1)
        explained = np.where(seen, along**2 / np.where(seen, values, 1.0), 0.0).sum(axis=1)
        share = np.minimum(explained / whole, 1 - 1e-12)
        statistics = -(spare - freedom / 2 - 1) * np.log1p(-share)
        return np.asarray(statistics * min(1.0, self.scale / max(self.stated, 1e-300)) ** 2), freedom

    def extended(
        self, columns: FloatArray, sigmas: FloatArray | None = None, *, judged: BoolArray | None = None
    ) -> "Extension":
        """Adjust a term together with the base.

        Shapes: columns (m_rows, q).
        sigmas (q,): What is known of its coefficients beforehand; nothing without.
        judged (count,): Rows in which it shall explain something; all without.
        Returns: Coefficients with sigma, and what is left.
        """
        wide, residual, base, owner = self.padded(columns), self.residual, self.base, self.owner
        if sigmas is not None:
            wide = np.concatenate([wide, np.diag(1 / sigmas)])
            residual = np.append(residual, np.zeros(sigmas.size))
            base = np.concatenate([base, np.zeros((sigmas.size, base.shape[1]))])
            owner = np.append(owner, np.full(sigmas.size, -1))
        both = replace(self, residual=residual, base=np.concatenate([base, wide], axis=1), owner=owner)
        settled, step, covariance = _settle(both)
        own = slice(self.base.shape[1], None)
        rows = np.ones(self.count, dtype=np.bool_) if judged is None else judged
        before = np.minimum(self.lengths()[rows] / self.scale, _CUT)
        after = np.minimum(settled.lengths()[rows] / self.scale, _CUT)
        spare = max(int(self.observed.sum()) - self.base.shape[1], 1)
        least = max(spare - columns.shape[1], 1)
        left, whole = max(float(after @ after), 1e-300), float(before @ before)
        ratio = left / least / max(whole / spare, 1e-300)
        sigma = np.sqrt(np.maximum(np.diag(covariance)[own], 0)) * max(settled.scale, self.stated)
        # Rows that scatter less than was stated of them are judged by what was stated.
        gain = (whole - left) / (left * max(1.0, self.stated / settled.scale) ** 2)
        return Extension(settled, step[own], sigma, 1 - ratio, gain, least * float(rows.mean()))

    def shifted(self, by: FloatArray) -> "LinearFit":
        """Return the fit to other observations.

        by (m_rows,): What they add to the residuals of the rows.
        """
        other = self.residual.copy()
        other[self.observed] += by
        return _settle(replace(self, residual=other)).model

    def squares(self, scale: float) -> FloatArray:
        """Return the (cut) square of what is left of each row, shape (count,), in units of a scatter."""
        return np.asarray(np.minimum(self.lengths() / scale, _CUT) ** 2)

    def estimate(self, columns: FloatArray) -> "Estimate":
        """Estimate a term in one step, whether it is there or not.

        Shapes: columns (m_rows, q).
        Returns: Coefficients with sigma; of no use where the base imitates the term: then the sigma is large.
        """
        wide = self.padded(columns)
        basis, pull, _, _ = self._asked
        wide -= basis @ (basis.T @ wide)
        # What the base imitates wholly stays finite: a millionth of the information.
        normal = wide.T @ wide
        normal += np.diag(1e-6 * np.einsum("ij,ij->j", columns, columns) + 1e-300)
        inverse = np.linalg.inv(normal)
        values = -inverse @ (wide.T @ pull) * self.scale
        return Estimate(np.asarray(values), np.sqrt(np.diag(inverse)) * max(self.scale, self.stated))

    def freedom(self, columns: FloatArray, sigmas: FloatArray) -> float:
        """Return how many combinations of columns the observations determine beyond the base.

        columns (m_rows, q): Derivatives by further numbers.
        sigmas (q,): What is known of these beforehand.
        """
        wide = self.padded(columns * sigmas) / self.scale
        basis = self._asked.basis
        wide -= basis @ (basis.T @ wide)
        values = np.linalg.svd(wide, compute_uv=False) ** 2
        return float(np.sum(values / (1 + values)))

    @property
    def _asked(self) -> "_Asked":
        """What every question to the residuals needs; a fit is asked some dozen."""
        if not self._kept:
            weight, own = np.ones(self.owner.size), self.observed
            weight[own] = _HUBER.weight(self.lengths() / self.scale)[self.owner[own]]
            pull = weight * self.residual / np.where(own, self.scale, 1.0)
            # Priors keep their sigma where the rows turned out to scatter by another factor.
            basis = _span(self.base * np.where(own, 1.0, self.scale)[:, None])
            self._kept.append(_Asked(basis, pull, pull @ basis, float(pull @ pull)))
        return self._kept[0]


class _Asked(NamedTuple):
    """Orthonormal basis (m, k) of what is adjusted anyhow, bounded residuals (m,), these in it (k,), their square."""

    basis: FloatArray
    pull: FloatArray
    pull_in_base: FloatArray
    whole: float


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """Columns of many looks that differ only in the rows where they are not zero: those between two times.

    base (m_rows, q): The columns, everywhere.
    order (m_rows,): Components in the order of time.
    first, last (looks,): Of that order, from where to before where each look is not zero.
    """

    base: FloatArray
    order: IntArray
    first: IntArray
    last: IntArray

    @property
    def shape(self) -> tuple[int, int, int]:
        """Looks, components of rows, columns of each."""
        return len(self.first), *self.base.shape

    def __getitem__(self, look: int) -> FloatArray:
        """Return the columns of one look, shape (m_rows, q)."""
        found = np.zeros(self.base.shape)
        inside = self.order[self.first[look] : self.last[look]]
        found[inside] = self.base[inside]
        return found

    def sums(self, products: FloatArray) -> FloatArray:
        """Return the sums over each look's components of something that they have, (m_rows, r): (looks, r)."""
        up_to = np.concatenate([np.zeros((1, products.shape[1])), np.cumsum(products[self.order], axis=0)])
        return np.asarray(up_to[self.last] - up_to[self.first])


def _products(columns: FloatArray | Windows, others: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the products of each look's columns with each other, (looks, q, q), and with others (m_rows, r)."""
    if not isinstance(columns, Windows):
        return columns.transpose(0, 2, 1) @ columns, others.T @ columns
    base, (looks, rows, q), r = columns.base, columns.shape, others.shape[1]
    both = np.concatenate([base, others], axis=1)
    sums = columns.sums((both[:, :, None] * base[:, None]).reshape(rows, (q + r) * q)).reshape(looks, q + r, q)
    return sums[:, :q], sums[:, q:]


class Estimate(NamedTuple):
    """Coefficients of a term with their standard deviations."""

    values: FloatArray
    sigmas: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Extension:
    """A term that was adjusted together with the base.

    model: What is left, the term being part of the base.
    coefficients, sigmas (q,): Of the term.
    explained: Share of the (cut) variance that it explains beyond its degrees of freedom.
    gain: What it explains over what it leaves, as (cut) sums of squares.
    spare: Components that are left to judge it by.
    """

    model: LinearFit
    coefficients: FloatArray
    sigmas: FloatArray
    explained: float
    gain: float
    spare: float

    @property
    def misfit(self) -> float:
        """Largest share of what is left that can be other than scatter as stated: smooth errors, perhaps."""
        # With 95 %: the square of a median of so many components has twice the variance of their mean square.
        most = self.model.scale**2 * (1 + 2 * np.sqrt(4 / max(self.spare, 1.0)))
        return float(max(0.0, 1 - self.model.stated**2 / most))


def linear_fit(fit: HeliostatFit, rows: BoolArray | None = None) -> LinearFit:
    """Make a fit linear.

    rows (n,): Rows to take; all that can be computed without.
    Returns: Rejected rows included, with a bounded pull: a fault that concerns some rows shows in just these.
    """
    residuals, parameters = fit.residuals, fit.nominal.parameters
    taken = residuals.computable if rows is None else residuals.computable & rows
    chosen = taken[residuals.owner]
    factor = fit.factor[residuals.owner[chosen]]
    number = np.cumsum(taken) - 1
    free = np.flatnonzero(parameters.free)
    known = free[np.isfinite(parameters.sigmas[free])]
    prior = np.zeros((known.size, free.size))
    prior[np.arange(known.size), np.searchsorted(free, known)] = 1 / parameters.sigmas[known]
    pulls = (fit.values[known] - parameters.values[known]) / parameters.sigmas[known]
    model = LinearFit(
        np.append(residuals.whitened[chosen] / factor, pulls),
        np.concatenate([residuals.jacobian[chosen][:, free] / factor[:, None], prior]),
        np.append(number[residuals.owner[chosen]], np.full(known.size, -1)),
        int(taken.sum()),
        stated=1 / float(np.median(factor)) if factor.size else 0.0,
    )
    return _settle(model).model


class _Settled(NamedTuple):
    """What is left after the base was adjusted, the step, and its cofactors."""

    model: LinearFit
    step: FloatArray
    cofactors: FloatArray


def _settle(model: LinearFit) -> _Settled:
    """Adjust the base with Huber's loss."""
    own = model.observed
    size = np.linalg.norm(model.base, axis=0)
    size[size == 0] = 1.0
    base = model.base / size
    step, inverse, scale = np.zeros(base.shape[1]), np.zeros((base.shape[1],) * 2), model.scale
    weight, before = np.ones(model.owner.size), np.inf
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)
        left, singular, right = np.linalg.svd(base * root[:, None], full_matrices=False)
        kept = singular > 1e-9 * max(float(singular.max(initial=0.0)), 1e-300)
        inverted = np.where(kept, 1 / np.where(kept, singular, 1.0), 0.0)
        step = -(right.T * inverted) @ (left.T @ (root * model.residual))
        inverse = (right.T * inverted**2) @ right
        rest = model.residual + base @ step
        lengths = np.sqrt(np.bincount(model.owner[own], rest[own] ** 2, minlength=model.count))
        # The median alone would take the parameters' share for scatter that is not there.
        spare = max(1 - int(kept.sum()) / max(int(own.sum()), 1), 0.1)
        scale = max(float(np.median(lengths)) / _MEDIAN_LENGTH / np.sqrt(spare), 1e-9)
        weight[own] = _HUBER.weight(lengths / scale)[model.owner[own]]
        weight[~own] = scale**2
        if abs(scale / before - 1) < 1e-3:
            break
        before = scale
    settled = replace(model, residual=np.asarray(rest), scale=scale)
    return _Settled(settled, np.asarray(step / size), np.asarray(inverse / size / size[:, None]))


def _span(columns: FloatArray) -> FloatArray:
    """Orthonormal basis of the columns."""
    size = np.linalg.norm(columns, axis=0)
    columns = columns[:, size > 0] / size[size > 0]
    if not columns.shape[1]:
        return columns
    left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, singular > 1e-9 * singular[0]])
