"""What changes with time: references that jumped on a date, or that wander."""

from collections.abc import Sequence

import numpy as np

from calibration.heliostat.diagnosis.linear_model import FEWEST_ROWS, Windows
from calibration.heliostat.diagnosis.terms import Term, Terms
from calibration.heliostat.kinematic_model.design import HeliostatDesign
from heliogauge.validate import FloatArray, TimeArray

# A step is looked for on so many dates at most.
_MOST_DATES = 120
# An episode is over within a month; so many are looked at.
_LONGEST, _MOST_SPANS = np.timedelta64(30, "D"), 400
_YEAR = np.timedelta64(31_557_600, "s")
_SAME = 1 - 1e-6
_DAY = np.timedelta64(1, "D")


def angles_of(design: HeliostatDesign) -> tuple[str, ...]:
    """Return the angles that can slip or settle: tilts, offsets, zeros, without the drives' own terms.

    Returns: Names in the order of the chain.
    """
    terms = {name for drive in design.drives for name in drive.terms.names}
    units = dict(zip(design.parameters.names, design.parameters.units, strict=True))
    return tuple(name for name in design.used_names if units[name] == "rad" and name not in terms)


def in_time(terms: Terms) -> list[Term]:
    """Return a jump of the angles on each date, a drift of them, and other levels of the axes for some days.

    terms: The fit, and rows whose time is known.
    Returns: All, or nothing where all rows are of one day or too few.
    """
    times = terms.fit.observations.time
    dates = change_dates(times[terms.rows])
    names = angles_of(terms.fit.design)
    if not dates.size or not names:
        return []
    by = np.stack([terms.by(name) for name in names], axis=1)
    # Two names for one turn (initial angle and tilt of the same axis) would share its change between them.
    size = np.linalg.norm(by, axis=0)
    alike = np.abs(by.T @ by) > _SAME * np.maximum(np.outer(size, size), 1e-300)
    alone = [k for k in range(len(names)) if size[k] > 0 and not alike[k, :k].any()]
    by, names = by[:, alone], tuple(names[k] for k in alone)
    own = times[terms.owner]
    order = np.argsort(own, kind="stable")
    sorted_days = own[order]
    later = np.searchsorted(sorted_days, dates)
    units = tuple(f"{name}_rad" for name in names)
    jump = Term(
        "change_point",
        "a jump on one date",
        Windows(by, order, later, np.full_like(later, own.size)),
        units,
        _days(dates),
    )
    first = times[terms.rows].min()
    years = (own - first) / _YEAR
    wander = (by * (years - years.mean())[:, None])[None]
    per_year = tuple(f"{name}_rad_per_year" for name in names)
    found = [jump, Term("drift", "a drift in time", wander, per_year, np.zeros(1))]
    spans = episode_spans(times[terms.rows])
    if len(spans):
        first_in, after = np.searchsorted(sorted_days, spans.T)
        axes = np.stack([terms.by_axis(0), terms.by_axis(1)], axis=1)
        at = np.arange(len(spans), dtype=np.float64)
        units = ("level_1_rad", "level_2_rad")
        during = Windows(axes, order, first_in, after)
        found.append(Term("episode", "another level for some days", during, units, at, spans=spans))
    return found


def episode_spans(times: TimeArray) -> TimeArray:
    """Return spans of at most a month during which the level could have been another.

    Shapes: times (n,).
    Returns (s, 2): First day, and first day after it; with enough rows during, before and after, at most 400.
    """
    days = np.sort(times.astype("datetime64[D]"))
    dates, first = np.unique(days, return_index=True)
    edges = np.append(first, days.size)
    starts = np.flatnonzero(first >= FEWEST_ROWS)
    # The first day after a span: from the next one on, as long as the last day of the span is within a month.
    latest = np.minimum(np.searchsorted(dates, dates[starts] + _LONGEST, side="right"), len(dates) - 1)
    lengths = np.maximum(latest - starts, 0)
    a = np.repeat(starts, lengths)
    b = a + 1 + np.arange(a.size) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    inside = edges[b] - edges[a]
    enough = (inside >= FEWEST_ROWS) & (days.size - edges[b] >= FEWEST_ROWS) & (inside <= days.size / 3)
    found = np.stack([dates[a[enough]], dates[b[enough]]], axis=1)
    if len(found) > _MOST_SPANS:
        found = found[np.linspace(0, len(found) - 1, _MOST_SPANS).round().astype(np.intp)]
    return np.asarray(found)


def change_dates(times: TimeArray) -> TimeArray:
    """Return the dates on which rows begin to be new: each could be the first after a change.

    Shapes: times (n,).
    Returns (d,): Dates with enough rows before and from them on, at most 120.
    """
    days = np.sort(times.astype("datetime64[D]"))
    dates, first = np.unique(days, return_index=True)
    enough = (first >= FEWEST_ROWS) & (days.size - first >= FEWEST_ROWS)
    dates = dates[enough]
    if dates.size > _MOST_DATES:
        dates = dates[np.linspace(0, dates.size - 1, _MOST_DATES).round().astype(np.intp)]
    return np.asarray(dates)


def date_range(at: FloatArray, statistics: FloatArray, times: TimeArray) -> tuple[np.datetime64, np.datetime64]:
    """Return between which days a change lies, with 95 % confidence.

    Shapes: statistics (d,), times (n,).
    at (d,): First days after the change, one for each look [days since 1970].
    Returns: The last day that is surely before it, and the first that is surely after it.

    Dates whose statistic is within 6.0 of the best: the 95 % point of chi-square with two degrees, a date being one
    and the discreteness of days being paid with the other.
    """
    likely = at[statistics >= statistics.max() - 6.0]
    days = np.unique(times[~np.isnat(times)].astype("datetime64[D]"))
    earliest, latest = _dates(likely.min()), _dates(likely.max())
    before = days[days < earliest]
    return (before[-1] if before.size else earliest), latest


def jumped(names: Sequence[str], values: FloatArray, sigmas: FloatArray) -> str:
    """Return in words which angles changed and by how much: those beyond 3 sigma, or the clearest."""
    clear = np.abs(values) / np.maximum(sigmas, 1e-300)
    chosen = np.flatnonzero(clear > 3) if (clear > 3).any() else np.array([int(np.argmax(clear))])
    chosen = chosen[np.argsort(-clear[chosen])][:3]
    parts = [f"{_plain(names[i])} {1e3 * values[i]:+.2g} +- {1e3 * sigmas[i]:.1g} mrad" for i in chosen]
    return ", ".join(parts)


def _plain(name: str) -> str:
    return name.removesuffix("_per_year").removesuffix("_rad")


def _days(dates: TimeArray) -> FloatArray:
    return np.asarray((dates - np.datetime64("1970-01-01")) / _DAY, dtype=np.float64)


def _dates(day: float) -> np.datetime64:
    return np.datetime64("1970-01-01") + round(day) * _DAY
