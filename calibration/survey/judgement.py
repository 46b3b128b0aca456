"""Trends and changes of a quantity from results with sigmas, for many subjects at once.

Sums over results, weighted by 1 / sigma^2, are all that is needed; a store forms them where the rows are. Results that
scatter more than their sigmas say make the sigma of what is derived larger by the root of chi-square over its degrees
of freedom (Birge's ratio), never smaller.
"""

from dataclasses import dataclass

import numpy as np

from heliogauge.validate import FloatArray, IntArray, freeze


@dataclass(frozen=True, slots=True, eq=False)
class Trend:
    """A straight line through the results of each subject.

    slope_per_year (n,), sigma_slope (n,): Change in a year; NaN with fewer than three results or one date.
    mean (n,), sigma_mean (n,): Weighted mean of all results.
    birge (n,): Root of chi-square over degrees of freedom of the line; NaN where there are none.
    degrees (n,), degrees_mean (n,): Degrees of freedom of the sigmas of slope and mean: of the scatter where that
        enlarged them, infinite else.
    count (n,): Results.
    """

    slope_per_year: FloatArray
    sigma_slope: FloatArray
    mean: FloatArray
    sigma_mean: FloatArray
    birge: FloatArray
    degrees: FloatArray
    degrees_mean: FloatArray
    count: IntArray


def trends(sums: dict[str, FloatArray]) -> Trend:
    """Fit a line to the results of each subject.

    sums: By name, each (n,): ``count``, and with w = 1 / sigma^2, t in years, y the value: ``w``, ``wt``, ``wy``,
        ``wtt``, ``wty``, ``wyy``; t and y from an origin near the data.
    """
    count = sums["count"].astype(np.intp)
    w, wt, wy = sums["w"], sums["wt"], sums["wy"]
    with np.errstate(all="ignore"):
        mean_t, mean_y = wt / w, wy / w
        spread_t = sums["wtt"] - w * mean_t**2
        cross = sums["wty"] - w * mean_t * mean_y
        spread_y = np.maximum(sums["wyy"] - w * mean_y**2, 0.0)
        slope = cross / spread_t
        chi = np.maximum(spread_y - cross * slope, 0.0)
        # A day in the weighted sum of squares of time is the least that two dates differ.
        known = (count >= 3) & (spread_t > w * (1 / 365.25) ** 2 * 1e-3)
        birge = np.where(known & (count > 2), np.sqrt(chi / np.maximum(count - 2, 1)), np.nan)
        sigma_slope = np.where(known, np.maximum(birge, 1.0) / np.sqrt(spread_t), np.nan)
        excess = np.where(count > 1, np.sqrt(spread_y / np.maximum(count - 1, 1)), 0.0)
        sigma_mean = np.maximum(excess, 1.0) / np.sqrt(w)
    return Trend(
        freeze(np.where(known, slope, np.nan)),
        freeze(sigma_slope),
        freeze(mean_y),
        freeze(sigma_mean),
        freeze(birge),
        freeze(np.where(birge > 1, np.maximum(count - 2.0, 1.0), np.inf)),
        freeze(np.where(excess > 1, np.maximum(count - 1.0, 1.0), np.inf)),
        count,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """What an event did: means after minus means before.

    before, after (n,), sigma_before, sigma_after (n,): Weighted means.
    change (n,), sigma (n,), degrees (n,): Their difference; the fewer degrees of freedom of both means.
    """

    before: FloatArray
    sigma_before: FloatArray
    after: FloatArray
    sigma_after: FloatArray
    change: FloatArray
    sigma: FloatArray
    degrees: FloatArray


def changes(before: dict[str, FloatArray], after: dict[str, FloatArray]) -> Changes:
    """Compare results before and after events.

    before, after: Sums as of `trends`, about the same origin of y.
    """
    one, other = trends(before), trends(after)
    return Changes(
        one.mean,
        one.sigma_mean,
        other.mean,
        other.sigma_mean,
        freeze(other.mean - one.mean),
        freeze(np.hypot(one.sigma_mean, other.sigma_mean)),
        freeze(np.minimum(one.degrees_mean, other.degrees_mean)),
    )


def chance(change: FloatArray, sigma: FloatArray, degrees: FloatArray) -> FloatArray:
    """Return the probability of a change at least this large where there is none (two-sided; Student's t).

    Shapes: change (n,), sigma (n,), degrees (n,), result (n,).
    degrees (n,): Degrees of freedom of the sigmas; infinite: normal.
    """
    from scipy.special import erfc, stdtr

    with np.errstate(all="ignore"):
        size = np.abs(change / sigma)
        few = np.isfinite(degrees)
        return np.asarray(np.where(few, 2 * stdtr(np.where(few, degrees, 1.0), -size), erfc(size / np.sqrt(2))))
