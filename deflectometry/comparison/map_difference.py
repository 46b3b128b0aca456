"""The difference of two maps with the uncertainty that both have together."""

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce

import numpy as np

from deflectometry.comparison.in_plane import SMOOTH_DEGREE
from deflectometry.comparison.judgement import as_stated
from deflectometry.comparison.linear_terms import linear_terms
from deflectometry.comparison.moved_map import PlaneMotion, moved_modes
from heliogauge.errors import InputError
from heliogauge.slopes.grid import difference, joint_modes
from heliogauge.slopes.map import CommonModes, SlopeMap, monomials
from heliogauge.validate import BoolArray, FloatArray


def difference_of(map_a: SlopeMap, map_b: SlopeMap, shared: Sequence[str]) -> SlopeMap:
    """Return a minus b with both common shares; those of shared sources are subtracted."""
    change = difference(map_a, map_b)
    sources_a, sources_b = map_a.common.sources, map_b.common.sources
    if not shared:
        return change
    coefficients, kept, names = change.common.coefficients, [], []
    taken: set[int] = set()
    for source in dict.fromkeys(shared):
        of_a = [k for k, name in enumerate(sources_a) if name == source]
        of_b = [k + len(sources_a) for k, name in enumerate(sources_b) if name == source]
        if len(of_a) != len(of_b) or not of_a:
            known = ", ".join(sorted({*sources_a} & {*sources_b})) or "none"
            raise InputError(
                f"--shared {source!r}: the first map has {len(of_a)} common errors of this source, the second "
                f"{len(of_b)}; sources of both: {known}"
            )
        for one, other in zip(of_a, of_b, strict=True):
            kept.append(coefficients[one] - coefficients[other])
            names.append(source)
        taken |= {*of_a, *of_b}
    for k, name in enumerate(change.common.sources):
        if k not in taken:
            kept.append(coefficients[k])
            names.append(name)
    common = CommonModes(tuple(names), np.stack(kept), change.common.center_m, change.common.scale_m)
    return replace(change, common=common)


def fine_square(map_a: SlopeMap, map_b: SlopeMap, known: BoolArray, count: int) -> FloatArray:
    """Return what the relative errors of both fine structures add to the difference, mean square of each component."""
    found = np.zeros(count)
    for one in (map_a, map_b):
        values = np.stack([one.slope_x, one.slope_y])[:count]
        rest = linear_terms(one, values, known, as_stated(one.common)).rest
        found += one.fine_share[:count] ** 2 * np.mean(rest**2, axis=1)
    return found


def with_place_errors(moved: SlopeMap, map_b: SlopeMap, motion: PlaneMotion, covariance: FloatArray) -> SlopeMap:
    """Return the second map, in the frame of the first, with the errors of its place among its common modes.

    moved: The map in the frame of the first. map_b: In its own.
    motion: From its own to that of the first. covariance (3, 3): Of its turn [rad] and shift [m].

    A turn by one sigma changes the twist of a trough by its curvature times that. The smooth part of the slopes follows
    the motion as a polynomial; what the fine part does is `motion_square`.
    """
    size, axes = np.linalg.eigh(covariance)
    smooth, changes = _smooth_slopes(map_b), []
    for step in (axes * np.sqrt(np.maximum(size, 0.0))).T:
        ahead, back = (
            moved_modes(
                smooth,
                PlaneMotion(motion.turn_rad + sign * step[0], motion.shift_m + sign * step[1:]),
                moved.x_m,
                moved.y_m,
            )
            for sign in (1.0, -1.0)
        )
        change = 0.5 * (ahead.coefficients - back.coefficients)
        changes.append(replace(ahead, sources=("place of the second map",), coefficients=change))
    return replace(moved, common=reduce(joint_modes, changes, moved.common))


def _smooth_slopes(slope_map: SlopeMap) -> CommonModes:
    """Return the slopes of a map as a polynomial, written as one mode."""
    known = slope_map.valid & np.isfinite(slope_map.slope_y)
    rows, columns = np.nonzero(known)
    x, y = slope_map.x_m[columns], slope_map.y_m[rows]
    center = np.array([0.5 * (x.min() + x.max()), 0.5 * (y.min() + y.max())])
    scale = 0.5 * max(float(np.ptp(x)), float(np.ptp(y)))
    terms = monomials((x - center[0]) / scale, (y - center[1]) / scale, SMOOTH_DEGREE)
    slopes = np.stack([slope_map.slope_x[known], slope_map.slope_y[known]])
    found = np.linalg.lstsq(terms.T, slopes.T, rcond=None)[0].T
    return CommonModes(("slopes",), np.asarray(found[None], np.float64), center, scale)


def motion_square(moved: SlopeMap, sigmas: FloatArray, known: BoolArray, count: int) -> FloatArray:
    """Return what the uncertain place of the second map adds to its fine part, mean square of each component.

    sigmas (3,): Of turn [rad] and shift [m].
    """
    found = np.zeros(count)
    (smooth,) = _smooth_slopes(moved).on_grid(moved.x_m, moved.y_m)
    for k, values in enumerate((moved.slope_x, moved.slope_y)[:count]):
        for axis, grid, sigma in ((1, moved.x_m, sigmas[1]), (0, moved.y_m, sigmas[2])):
            slope = np.gradient(np.where(known, values - smooth[k], np.nan), grid, axis=axis)
            found[k] += float(np.nanmean(slope**2)) * sigma**2
    return found
