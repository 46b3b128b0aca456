"""Whether what looks like a change in time is decided: other numbers of the heliostat may explain it without time."""

from dataclasses import dataclass

import numpy as np

from calibration.heliostat.diagnosis.linear_model import Extension, LinearFit
from calibration.heliostat.diagnosis.terms import Terms
from calibration.heliostat.fitting.priors import PRIORS
from heliogauge.validate import FloatArray

#: Difference of the Bayesian information criterion from which on the evidence is "very strong" (Kass and Raftery,
#: Bayes factors, J. Am. Stat. Assoc. 90, 1995, section 3.2).
DECIDED = 10.0
#: From here on it is "strong": it decides between a term and other numbers, neither of which is chosen among dates.
STRONG = 6.0
# A rival may move every number three times as far as is usual.
_WIDE = 3.0
# A row's share in what is unexplained is cut here [sigma].
_CUT = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """What numbers without time explain of the same residuals.

    explained: Share of the variance that they explain.
    numbers: How many of them the observations determine.
    evidence: By how much time explains the residuals better: difference of the information criteria; negative where
        the numbers do.
    """

    explained: float
    numbers: float
    evidence: float

    @property
    def is_decided(self) -> bool:
        """Whether the evidence is for time."""
        return self.evidence > DECIDED

    @property
    def is_open(self) -> bool:
        """Whether the evidence is for neither."""
        return abs(self.evidence) <= DECIDED

    @property
    def text(self) -> str:
        """What the evidence says."""
        share = f"{self.numbers:.0f} further numbers without time explain {100 * self.explained:.0f} %"
        if self.is_decided:
            return f"{share}, time explains it better (evidence {self.evidence:.0f})"
        if self.is_open:
            return f"{share} of it as well: open (evidence {self.evidence:.0f}, {DECIDED:.0f} would decide)"
        return f"{share} of it better (evidence {self.evidence:.0f})"


def rival_of(model: LinearFit, terms: Terms, found: Extension, looks: int) -> Rival:
    """Compare a term of time with all numbers of the heliostat without time.

    model: The fit without either.
    terms: Of the same rows.
    found: The term of time.
    looks: Dates among which it was chosen.
    """
    columns, sigmas = further_numbers(terms)
    other = model.extended(columns, sigmas)
    count = 2 * max(model.count, 1)
    freedom = model.freedom(columns, sigmas)
    cost = np.log(count)
    # A date is chosen among so many: as large as they are many.
    of_time = _misfit(model, found, count) + found.coefficients.size * cost + 2 * np.log(looks)
    of_numbers = _misfit(model, other, count) + freedom * cost
    before = np.minimum(model.lengths() / model.scale, _CUT)
    after = np.minimum(other.model.lengths() / model.scale, _CUT)
    share = 1 - float(after @ after) / max(float(before @ before), 1e-300)
    return Rival(share, freedom, float(of_numbers - of_time))


def _misfit(model: LinearFit, extension: Extension, count: int) -> float:
    """Return twice the negative logarithm of the likelihood, each row's share in it bounded."""
    left = np.minimum(extension.model.lengths() / model.scale, _CUT)
    return float(count * np.log(max(float(left @ left), 1e-300) / count))


def further_numbers(terms: Terms) -> tuple[FloatArray, FloatArray]:
    """Return derivatives by all numbers of the heliostat and by the bending of both axes, and how far they may go."""
    design = terms.fit.design
    names = [name for name in design.used_names if name in PRIORS]
    by = [terms.by(name) for name in names]
    sigmas = [_WIDE * PRIORS[name].of(design.parameters.value(name)) for name in names]
    for axis in (0, 1):
        angle, by_axis = terms.angle(axis), terms.by_axis(axis)
        by += [by_axis * np.cos(angle), by_axis * np.sin(angle)]
        sigmas += [_WIDE * PRIORS["sag_1"].of(0.0)] * 2
    columns = np.stack(by, axis=1)
    seen = np.linalg.norm(columns, axis=0) > 0
    return columns[:, seen], np.array(sigmas)[seen]
