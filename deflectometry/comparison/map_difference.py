"""The difference of two maps with the uncertainty that both have together."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deflectometry.comparison.judgement import as_stated
from deflectometry.comparison.linear_terms import linear_terms
from deflectometry.comparison.placing import Placed
from heliogauge.errors import InputError
from heliogauge.slopes.grid import difference
from heliogauge.slopes.map import CommonModes, SlopeMap
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


def motion_square(map_b: SlopeMap, placed: Placed, known: BoolArray, count: int) -> FloatArray:
    """Return what the uncertain place of the second map adds, mean square of each component."""
    if placed.found is None or not placed.is_moved:
        return np.zeros(count)
    found = np.zeros(count)
    for k, values in enumerate((map_b.slope_x, map_b.slope_y)[:count]):
        for axis, grid, sigma in ((1, map_b.x_m, placed.found.sigmas[1]), (0, map_b.y_m, placed.found.sigmas[2])):
            slope = np.gradient(np.where(known, values, np.nan), grid, axis=axis)
            found[k] += float(np.nanmean(slope**2)) * sigma**2
    return found
