"""Do two results of one mirror agree, and if not, which of them contradicts its own data."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from deflectometry.comparison.linear_terms import ExpectedRest, LinearTerms, linear_terms
from heliogauge.adjust.chi_square import chi_square_cdf
from heliogauge.doubts import Doubt, Severity
from heliogauge.slopes.curl_moments import curl_moments
from heliogauge.slopes.map import CommonModes, SlopeMap
from heliogauge.validate import BoolArray, FloatArray

#: Two results of one mirror with true sigmas are said to contradict each other once in a hundred comparisons.
SIGNIFICANCE = 0.01
#: A map whose own contradiction is this share of that of both is the one to look at: three times the other's.
_MOSTLY = 0.9
#: Common shares by which a sigma was enlarged because the data contradict themselves; without them it is as stated.
_ENLARGED = "in contradiction"
#: Root of the 99 % point of chi-square over its degrees of freedom, the six means of the curl.
_LARGEST_CURL = 1.67


class Agreement(StrEnum):
    """How two results stand to each other.

    WITHIN: Within the sigmas of both.
    WITHIN_ENLARGED: Only within sigmas that were enlarged because one contradicts its own data.
    CONTRADICT: Not within the sigmas.
    UNKNOWN: Neither has a sigma.
    """

    WITHIN = "agree"
    WITHIN_ENLARGED = "agree within enlarged sigmas only"
    CONTRADICT = "contradict"
    UNKNOWN = "no sigma"


def as_stated(common: CommonModes) -> CommonModes:
    """Return common errors without those that were added because the data contradict themselves."""
    kept = [k for k, source in enumerate(common.sources) if not source.endswith(_ENLARGED)]
    return replace(
        common, sources=tuple(common.sources[k] for k in kept), coefficients=np.asarray(common.coefficients[kept])
    )


@dataclass(frozen=True, slots=True, eq=False)
class SelfCheck:
    """What one result's own data say of it.

    name: Of the result.
    curl_per_m, sigma_curl_per_m: Mean curl of the slopes, which no surface has, and its sigma as stated; NaN where the
        map has one slope only [1/m].
    smooth_curl_per_m: RMS of the smooth part of the curl [1/m].
    smooth_curl_ratio: Its size over what the stated sigmas make.
    turn_rad: Turn between the mean normal of the slopes and that of the mirror's outline; NaN where not known [rad].
    serious: Texts of its serious doubts.
    """

    name: str
    curl_per_m: float
    sigma_curl_per_m: float
    smooth_curl_per_m: float
    smooth_curl_ratio: float
    turn_rad: float
    serious: tuple[str, ...]

    @property
    def contradicts_itself(self) -> bool:
        """Whether its slopes have more smooth curl than noise makes once in a hundred maps, or a serious doubt."""
        return bool(self.smooth_curl_ratio > _LARGEST_CURL or self.serious)

    def words(self) -> str:
        """Say what speaks against it."""
        found = []
        if np.isfinite(self.smooth_curl_ratio):
            found.append(
                f"smooth curl {1e3 * self.smooth_curl_per_m:.2f} mrad/m, {self.smooth_curl_ratio:.3g} times what its "
                "stated sigmas make"
            )
        if np.isfinite(self.turn_rad):
            found.append(f"reflection and outline {1e3 * self.turn_rad:.1f} mrad apart")
        found += [f"its own report says: {one}" for one in self.serious]
        return "; ".join(found) or "nothing to check it with: neither two slopes nor an outline"


def self_check(
    name: str, slope_map: SlopeMap, numbers: Mapping[str, float | int | None], doubts: Iterable[Doubt], known: BoolArray
) -> SelfCheck:
    """Collect what a result's own data say of it.

    slope_map: On its own grid.
    known (ny, nx): Nodes with both slopes.
    """
    bare = replace(slope_map, common=as_stated(slope_map.common), aperture=known)
    turn = numbers.get("alignment_turn_rad")
    serious = tuple(one.text.partition(";")[0] for one in doubts if one.severity is Severity.SERIOUS)
    missing = float("nan")
    curl, sigma, smooth, ratio = (missing,) * 4
    has_curl = bool(np.isfinite(slope_map.slope_y[known]).any())
    moments = curl_moments(bare) if has_curl else None
    if moments is not None:
        errors = np.stack([slope_map.slope_error_x, slope_map.slope_error_y])
        terms = linear_terms(bare, errors, known, bare.common)
        curl, sigma = 2 * float(terms.values[-1]), 2 * float(terms.sigmas[-1])
        smooth = moments.smooth_rms_per_m
        if np.diag(moments.covariance).min() > 0:
            ratio = float(np.sqrt(moments.chi_square / moments.values_per_m.size))
    return SelfCheck(name, curl, sigma, smooth, ratio, missing if turn is None else float(turn), serious)


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """What the difference of two results says.

    agreement: In a word.
    terms_probability, rest_probability: How often errors within the sigmas make so large a difference, of the linear
        terms and of what they leave; NaN without sigmas.
    stated_probability: That of the linear terms with the sigmas as stated.
    contradicting: Linear terms that differ by more than chance, with the factor over their sigma as stated.
    blamed: The result that contradicts its own data more; empty where neither or both do.
    share: Share of the squared contradictions that is its own; NaN where not known.
    """

    agreement: Agreement
    terms_probability: float
    rest_probability: float
    stated_probability: float
    contradicting: Mapping[str, float]
    blamed: str
    share: float


def judge(
    terms: LinearTerms, stated: LinearTerms, rest: ExpectedRest, checks: tuple[SelfCheck, SelfCheck]
) -> Judgement:
    """Judge a difference.

    terms, stated: Its linear terms, with all sigmas and with those as stated.
    rest: What the sigmas leave beside them.
    """
    # Tilts are those of each instrument's own frame: maps that were levelled have none.
    judged = np.array([not name.startswith("tilt") for name in terms.names])
    of_terms, of_stated = (_probability(one, judged) for one in (terms, stated))
    of_rest = rest.probability(float(np.mean(terms.rest**2)))
    known = [one for one in (of_terms, of_rest) if np.isfinite(one)]
    # Two tests share the significance.
    if not known:
        agreement = Agreement.UNKNOWN
    elif min(known) < 0.5 * SIGNIFICANCE:
        agreement = Agreement.CONTRADICT
    elif of_stated < 0.5 * SIGNIFICANCE:
        agreement = Agreement.WITHIN_ENLARGED
    else:
        agreement = Agreement.WITHIN
    factors = np.abs(stated.values) / np.where(stated.sigmas > 0, stated.sigmas, np.nan)
    limit = float(np.sqrt(_quantile(SIGNIFICANCE / np.count_nonzero(judged))))
    contradicting = {
        name: float(factor)
        for name, factor, counts in zip(stated.names, factors, judged, strict=True)
        if counts and factor > limit
    }
    # What is wrong with a set-up by so many mrad changes curl and curvature alike by so many mrad over the distance: a
    # map's curl is the scale of the error of its curvatures.
    sizes = np.array([one.smooth_curl_per_m for one in checks])
    share, blamed = float("nan"), ""
    if agreement in (Agreement.CONTRADICT, Agreement.WITHIN_ENLARGED) and np.isfinite(sizes).all() and sizes.any():
        shares = sizes**2 / np.sum(sizes**2)
        worst = int(np.argmax(shares))
        share = float(shares[worst])
        if share > _MOSTLY and checks[worst].contradicts_itself:
            blamed = checks[worst].name
    elif agreement in (Agreement.CONTRADICT, Agreement.WITHIN_ENLARGED):
        guilty = [one.name for one in checks if one.contradicts_itself]
        blamed = guilty[0] if len(guilty) == 1 else ""
    return Judgement(agreement, of_terms, of_rest, of_stated, contradicting, blamed, share)


def _probability(terms: LinearTerms, judged: BoolArray) -> float:
    sigmas = terms.sigmas[judged]
    if not (sigmas > 0).all():
        return float("nan")
    unit = terms.covariance[np.ix_(judged, judged)] / np.outer(sigmas, sigmas)
    values, vectors = np.linalg.eigh(unit)
    # Terms that the errors move in step are one term.
    kept = values > 1e-10 * values[-1]
    whitened = vectors[:, kept].T @ (terms.values[judged] / sigmas) / np.sqrt(values[kept])
    return 1.0 - chi_square_cdf(float(whitened @ whitened), int(kept.sum()))


def _quantile(probability: float) -> float:
    from heliogauge.adjust.chi_square import chi_square_quantile

    return chi_square_quantile(1 - probability, 1)


def focal_words(values: FloatArray, names: tuple[str, ...]) -> str:
    """Say the focal lengths that the curvatures of a map's slopes have."""
    found = [
        f"{name[-1]} {0.5 / value:.4g} m" if value else f"{name[-1]} flat"
        for name, value in zip(names, values, strict=True)
        if name.startswith("curvature")
    ]
    return ", ".join(found)
