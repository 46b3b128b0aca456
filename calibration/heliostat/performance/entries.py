"""Entries of a data sheet: a value with its uncertainty and where it comes from, and what a limit makes of it.

The rule of decision is that of ISO 14253-1:2017 and of ILAC-G8:09/2019, 4.2.3: conformity is stated where its
probability is at least 95 %, failure where that of conformity is at most 5 %; what lies between is conditional.
"""

from dataclasses import dataclass
from enum import StrEnum
from math import inf, isfinite

from heliogauge.errors import InputError

#: ISO 14253-1:2017: the probability at which conformity counts as proven unless agreed otherwise.
CONFIDENCE = 0.95
#: Probability with which a bound on what was not seen holds (`Entry.below`).
BOUND_PROBABILITY = 0.95


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of a data sheet.

    test: Which test it is of, one word.
    key: What it is; ends with its unit (`heliogauge.results.folder.UNITS`).
    label: What it is in words; angles say whether they are of the beam or of the normal.
    value: None: not measured, see `note`; or measured and none seen, see `below`.
    sigma: Standard deviation; None where it is not known, and `note` says why.
    degrees: Degrees of freedom of `sigma`; infinite where it was not estimated from few samples.
    method, date, conditions: How, when, and under which conditions, in words.
    note: Why there is no value or no sigma, or what must be known beside them.
    below: Of what was looked for in vain: it is smaller than this with a probability of 95 %; None where there is a
        value, or nothing was measured.
    """

    test: str
    key: str
    label: str
    value: float | None
    sigma: float | None = None
    degrees: float = inf
    method: str = ""
    date: str = ""
    conditions: str = ""
    note: str = ""
    below: float | None = None

    @property
    def is_measured(self) -> bool:
        """Whether it was measured: there is a value, or a bound on what was not seen."""
        return self.value is not None or self.below is not None

    @property
    def name(self) -> str:
        """Test and key: how limits and tables call it."""
        return f"{self.test}_{self.key}"


class Conformity(StrEnum):
    """What a limit makes of a value.

    PASS, FAIL: Proven with the probability asked.
    CONDITIONAL_PASS, CONDITIONAL_FAIL: The value lies inside or outside, but its uncertainty reaches across the limit.
    UNDECIDED: No uncertainty is known, or none was seen and its bound reaches the limit or holds with less than the
        probability asked: nothing is proven.
    NOT_MEASURED: There is no value.
    NO_LIMIT: Nothing was asked.
    """

    PASS = "pass"
    CONDITIONAL_PASS = "conditional pass"
    CONDITIONAL_FAIL = "conditional fail"
    FAIL = "fail"
    UNDECIDED = "undecided"
    NOT_MEASURED = "not measured"
    NO_LIMIT = ""


@dataclass(frozen=True, slots=True)
class Limit:
    """What an entry must keep.

    least, most: Ends of the tolerance, in the entry's unit; None: open.
    source: Where the limit comes from.
    InputError: No end, or ends that cross.
    """

    least: float | None = None
    most: float | None = None
    source: str = ""

    def __post_init__(self) -> None:
        if self.least is None and self.most is None:
            raise InputError("limit: least or most is needed")
        if self.least is not None and self.most is not None and not self.least < self.most:
            raise InputError(f"limit: least = {self.least:g} is not below most = {self.most:g}")


@dataclass(frozen=True, slots=True)
class Decision:
    """What a limit makes of an entry.

    probability: That the true value keeps the limit; None without value or sigma.
    guard: Distance from the limit within which neither passing nor failing is proven, for one open end, in the
        entry's unit; None without sigma.
    """

    conformity: Conformity
    probability: float | None = None
    guard: float | None = None


def decide(entry: Entry, limit: Limit | None, confidence: float = CONFIDENCE) -> Decision:
    """Compare an entry with a limit, its uncertainty counted.

    confidence: Probability at which passing or failing counts as proven, above 0.5 and below 1.
    InputError: Another confidence.

    The true value has the distribution of Student's t about the measured one, with the sigma's degrees of freedom.
    """
    if not 0.5 < confidence < 1:
        raise InputError(f"confidence = {confidence:g}: more than 0.5 and less than 1 is needed")
    if limit is None:
        return Decision(Conformity.NO_LIMIT)
    if entry.value is None:
        return _of_none_seen(entry.below, limit, confidence)
    if entry.sigma is None or not isfinite(entry.sigma) or entry.sigma <= 0:
        return Decision(Conformity.UNDECIDED)
    from scipy.special import ndtr, ndtri, stdtr, stdtrit

    is_normal = not isfinite(entry.degrees)

    def below(end: float) -> float:
        reach = (end - entry.value) / entry.sigma  # type: ignore[operator]
        return float(ndtr(reach) if is_normal else stdtr(entry.degrees, reach))

    probability = (1.0 if limit.most is None else below(limit.most)) - (
        0.0 if limit.least is None else below(limit.least)
    )
    quantile = float(ndtri(confidence) if is_normal else stdtrit(entry.degrees, confidence))
    inside = (limit.most is None or entry.value <= limit.most) and (limit.least is None or entry.value >= limit.least)
    if probability >= confidence:
        state = Conformity.PASS
    elif probability <= 1 - confidence:
        state = Conformity.FAIL
    else:
        state = Conformity.CONDITIONAL_PASS if inside else Conformity.CONDITIONAL_FAIL
    return Decision(state, probability, quantile * entry.sigma)


def _of_none_seen(below: float | None, limit: Limit, confidence: float) -> Decision:
    """Return what a limit makes of a size that was not seen: only an upper end above all that it can be is kept.

    The bound holds with the probability of `BOUND_PROBABILITY`; of a larger one it proves nothing.
    """
    if below is None:
        return Decision(Conformity.NOT_MEASURED)
    proven = confidence <= BOUND_PROBABILITY
    kept = proven and limit.least is None and limit.most is not None and below <= limit.most
    return Decision(Conformity.PASS if kept else Conformity.UNDECIDED)
