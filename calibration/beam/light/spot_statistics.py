"""Statistics of a series of beam places: accuracy, repeatability, drift and oscillation.

Every angle here is of the reflected beam: offset on the target over the slant range. The normal's is half of it where
the heliostat turns in the plane of incidence.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import FloatArray, float_array, freeze, positive

__all__ = [
    "DailyTracking",
    "Drift",
    "Repeatability",
    "daily_tracking",
    "drift_and_oscillation",
    "repeatability",
    "search_spiral",
]

_DEGREE = 3
#: Sun's hour angle within which a spot counts for the accuracy at noon: half an hour [h].
_NOON_H = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """Drift and oscillation of a beam (Stage-STE 12.6, 1.3.6.2 and 2.4).

    amplitude_m (2,): Largest minus smallest value of the trend in x and y [m].
    oscillation_m (2,): Standard deviation of the places about the trend [m].
    oscillation_beam_rad (2,): The same over the slant range: angle of the beam [rad].
    trend_m (n, 2): The trend at each time [m].
    """

    amplitude_m: FloatArray
    oscillation_m: FloatArray
    oscillation_beam_rad: FloatArray
    trend_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class DailyTracking:
    """Accuracy of tracking over a day (Stage-STE 12.6, 1.2.4.1 and 1.3.1.4), angles of the beam.

    mean_rad (2,): Systematic offset right and up [rad].
    standard_deviation_rad (2,): Scatter about it [rad].
    rms_rad: Root mean square of the offset in both directions: the daily error [rad].
    largest_rad: Largest offset [rad].
    noon_rad (2,): Mean offset within half an hour of solar noon; NaN without any [rad].
    n: Spots.
    """

    mean_rad: FloatArray
    standard_deviation_rad: FloatArray
    rms_rad: float
    largest_rad: float
    noon_rad: FloatArray
    n: int


@dataclass(frozen=True, slots=True, eq=False)
class Repeatability:
    """Repeated approaches of the same aim point (Stage-STE 12.6, 1.3.1.4), angles of the beam.

    systematic_rad (k, 2): Mean offset of each group: what a model can correct [rad].
    repeatability_rad (2,): Standard deviation within the groups, pooled: what no model can correct [rad].
    degrees_of_freedom: Spots minus groups.
    """

    systematic_rad: FloatArray
    repeatability_rad: FloatArray
    degrees_of_freedom: int


def drift_and_oscillation(
    times_s: npt.ArrayLike, places_m: npt.ArrayLike, slant_range_m: float, *, degree: int = _DEGREE
) -> Drift:
    """Separate the slow drift of a beam from its oscillation.

    times_s (n,): Times from any origin [s].
    places_m (n, 2): Places of the beam on the target; rows with NaN do not count [m].
    slant_range_m: Distance from heliostat to target [m].
    degree: Degree of the trend; 3 as in the report.
    Returns: Amplitude of the trend, scatter about it.
    InputError: Shapes do not fit or the range is not positive.
    EstimationError: Fewer places than the trend and a scatter need, or all at one time.

    Least squares on time scaled to -1 to 1: with the report's own coefficients, which refer to hours from midnight,
    five printed digits leave 12.8 m of rounding. The scatter has the degrees of freedom n - degree - 1.
    """
    times = float_array("times_s", times_s, (None,))
    places = float_array("places_m", places_m, (times.size, 2), finite=False)
    distance = positive("slant_range_m", slant_range_m, "metres")
    good = np.isfinite(places).all(axis=1)
    spare = int(good.sum()) - degree - 1
    if spare < 1:
        raise EstimationError(f"drift: {int(good.sum())} places are given, {degree + 2} are needed for degree {degree}")
    span = float(np.ptp(times[good]))
    if not span > 0:
        raise EstimationError("drift: all places are of one time")
    scaled = 2 * (times - times[good].min()) / span - 1
    rows = np.polynomial.legendre.legvander(scaled, degree)
    solution, _, rank, _ = np.linalg.lstsq(rows[good], places[good], rcond=None)
    if rank < degree + 1:
        raise EstimationError(f"drift: {len(np.unique(times[good]))} different times do not determine degree {degree}")
    trend = rows @ solution
    # The largest value of the trend may lie between two places.
    fine = np.polynomial.legendre.legvander(np.linspace(-1, 1, 1001), degree) @ solution
    scatter = np.sqrt(np.sum((places[good] - trend[good]) ** 2, axis=0) / spare)
    return Drift(freeze(np.ptp(fine, axis=0)), freeze(scatter), freeze(scatter / distance), freeze(trend))


def daily_tracking(
    offsets_m: npt.ArrayLike, slant_range_m: float, *, hours_from_noon: npt.ArrayLike | None = None
) -> DailyTracking:
    """Summarise how far beams were from the aim point over a day.

    offsets_m (n, 2): Place of the beam minus the aim point, right and up; rows with NaN do not count [m].
    slant_range_m: Distance from heliostat to target [m].
    hours_from_noon (n,): Solar time minus 12 h of each spot [h].
    Returns: Offset, scatter, daily error, error at noon.
    InputError: Shapes do not fit or the range is not positive.
    EstimationError: Fewer than two spots.
    """
    offsets = float_array("offsets_m", offsets_m, (None, 2), finite=False)
    angles = offsets / positive("slant_range_m", slant_range_m, "metres")
    good = np.isfinite(angles).all(axis=1)
    if good.sum() < 2:
        raise EstimationError(f"tracking: at least two spots are needed, not {int(good.sum())}")
    noon = np.full(2, np.nan)
    if hours_from_noon is not None:
        near = good & (np.abs(float_array("hours_from_noon", hours_from_noon, (offsets.shape[0],))) <= _NOON_H)
        noon = angles[near].mean(axis=0) if near.any() else noon
    chosen = angles[good]
    lengths = np.hypot(chosen[:, 0], chosen[:, 1])
    return DailyTracking(
        freeze(chosen.mean(axis=0)),
        freeze(chosen.std(axis=0, ddof=1)),
        float(np.sqrt(np.mean(lengths**2))),
        float(lengths.max()),
        freeze(noon),
        int(good.sum()),
    )


def repeatability(offsets_m: npt.ArrayLike, groups: npt.ArrayLike, slant_range_m: float) -> Repeatability:
    """Split offsets of repeated approaches into what is systematic and what is not.

    offsets_m (n, 2): Place of the beam minus the aim point, right and up [m].
    groups (n,): Which approach each spot belongs to: the same aim, sun position and direction of the last move.
    slant_range_m: Distance from heliostat to target [m].
    Returns: Mean of each group in the order of their sorted names, pooled scatter.
    InputError: Shapes do not fit or the range is not positive.
    EstimationError: No group has two spots.
    """
    offsets = float_array("offsets_m", offsets_m, (None, 2))
    names = np.asarray(groups)
    if names.shape != (offsets.shape[0],):
        raise InputError(f"groups: one for each of {offsets.shape[0]} spots is needed, not shape {names.shape}")
    angles = offsets / positive("slant_range_m", slant_range_m, "metres")
    unique, index = np.unique(names, return_inverse=True)
    counts = np.bincount(index)
    spare = int(offsets.shape[0] - unique.size)
    if spare < 1:
        raise EstimationError("repeatability: no approach was repeated; two spots of one group are needed")
    means = np.stack([np.bincount(index, weights=angles[:, k]) / counts for k in (0, 1)], axis=1)
    scatter = np.sqrt(np.sum((angles - means[index]) ** 2, axis=0) / spare)
    return Repeatability(freeze(means), freeze(scatter), spare)


def search_spiral(target_side_m: float, rings: int) -> FloatArray:
    """Return offsets of the aim point that look for a beam which is not on the target (Malan 2014, 6.5).

    rings: Rings around the start.
    Returns ((2 rings + 1)^2, 2): Offsets right and up in the order of the visit: a square spiral outwards (right,
        up, left, left, down, ...) in blocks of half the target's side [m].
    InputError: A side that is not positive, or fewer than no rings.

    >>> search_spiral(2.0, 1)[:4].tolist()
    [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
    """
    block = positive("target_side_m", target_side_m, "metres") / 2
    if rings < 0:
        raise InputError(f"rings: 0 or more are needed, not {rings}")
    wanted = (2 * rings + 1) ** 2
    place, direction = np.zeros(2), np.array([1.0, 0.0])
    places, leg = [place], 0
    while len(places) < wanted:
        for _ in range(leg // 2 + 1):
            place = place + direction
            places.append(place)
        direction = np.array([-direction[1], direction[0]])
        leg += 1
    return freeze(block * np.array(places[:wanted]))
