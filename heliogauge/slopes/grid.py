"""Slope maps as fields on a grid: curl and curvature, resampling, differences."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.slopes.interpolation import weighted_sigma
from heliogauge.slopes.map import CommonModes, SlopeMap
from heliogauge.slopes.removal import fit_modes
from heliogauge.validate import BoolArray, FlagArray, FloatArray, IntArray, float_array

#: Nodes that are worked on at once: what belongs to them stays in the second-level cache.
_BLOCK = 8192


@dataclass(frozen=True, slots=True, eq=False)
class Derivative:
    """A derivative of the slopes on the map's grid.

    value_per_m (ny, nx): Central differences between nodes that share no pixel; NaN where one of them is missing
        [1/m].
    sigma_per_m (ny, nx): Standard deviation, random and common [1/m].
    """

    value_per_m: FloatArray
    sigma_per_m: FloatArray


def curl(slope_map: SlopeMap) -> Derivative:
    """Return ``d slope_x / dy - d slope_y / dx``: zero for the slopes of any real surface, so a check of the map.

    Returns: Curl and its sigma [1/m]; NaN at nodes with a missing neighbour.

    It is the circulation around the square of neighbours that share no pixel, over its area, its sides by Simpson's
    rule: zero for the slopes of every surface of fifth degree. (Differences through the middle alone make a curl of
    waves that run aslant, ``kx ky (kx^2 - ky^2) h^2 / 6`` times their height.)
    """
    valid, reach = slope_map.valid, _reach(slope_map)
    weights_x, weights_y = (_side_weights(grid, reach) for grid in (slope_map.x_m, slope_map.y_m))
    x_by_y = _central(np.where(valid, slope_map.slope_x, np.nan), slope_map.y_m, 0, reach)
    y_by_x = _central(np.where(valid, slope_map.slope_y, np.nan), slope_map.x_m, 1, reach)
    turned = _along_side(x_by_y, weights_x, 1, reach) - _along_side(y_by_x, weights_y, 0, reach)
    variance = _along_side(_central_variance(slope_map.sigma_random_x, slope_map.y_m, 0, reach), weights_x**2, 1, reach)
    variance += _along_side(
        _central_variance(slope_map.sigma_random_y, slope_map.x_m, 1, reach), weights_y**2, 0, reach
    )
    for mode_x, mode_y in slope_map.common.on_grid(slope_map.x_m, slope_map.y_m):
        turn = _along_side(_central(mode_x, slope_map.y_m, 0, reach), weights_x, 1, reach)
        turn -= _along_side(_central(mode_y, slope_map.x_m, 1, reach), weights_y, 0, reach)
        variance += turn**2
    return _derivative(turned, variance)


def _side_weights(positions_m: FloatArray, reach: int) -> FloatArray:
    """Return the weights of Simpson's rule for the mean between neighbours of each node that has both, shape (3, n).

    Of the neighbour before, the node and the neighbour behind, also where they are unevenly apart.
    """
    if positions_m.size <= 2 * reach:
        return np.zeros((3, 0))
    middle = positions_m[reach:-reach]
    before, after = middle - positions_m[: -2 * reach], positions_m[2 * reach :] - middle
    return np.stack([2 - after / before, (before + after) ** 2 / (before * after), 2 - before / after]) / 6


def _along_side(values: FloatArray, weights: FloatArray, axis: int, reach: int) -> FloatArray:
    """Return weighted sums over the neighbours along an axis, NaN where one is missing, shape as values."""
    along = np.moveaxis(values, axis, -1)
    result = np.full(along.shape, np.nan)
    if weights.size:
        ends = (slice(None, -2 * reach), slice(reach, -reach), slice(2 * reach, None))
        result[..., reach:-reach] = sum(weight * along[..., end] for weight, end in zip(weights, ends, strict=True))
    return np.moveaxis(result, -1, axis)


class CurlRms(NamedTuple):
    """RMS over a map of its `curl`, and of the curl's sigma; NaN where no node has one [1/m]."""

    measured_per_m: float
    expected_per_m: float


def curl_rms(slope_map: SlopeMap) -> CurlRms:
    """Return the RMS of a map's `curl` and of its sigma over the measured nodes, without either as a map."""
    reach, valid = _reach(slope_map), slope_map.valid
    if min(slope_map.shape) <= 2 * reach:
        return CurlRms(np.nan, np.nan)
    ends = slice(None, -2 * reach), slice(reach, -reach), slice(2 * reach, None)
    behind, _, ahead = ends
    steps_x, steps_y = (grid[ahead] - grid[behind] for grid in (slope_map.x_m, slope_map.y_m))
    along_x, along_y = (_side_weights(grid, reach) for grid in (slope_map.x_m, slope_map.y_m))
    seen = np.ones(tuple(size - 2 * reach for size in valid.shape), dtype=np.bool_)
    for row_end in ends:
        for column_end in ends:
            seen &= valid[row_end, column_end]
    squares = variances = 0.0
    rows_at_once = max(1, _BLOCK // seen.shape[1])
    for start in range(0, len(seen), rows_at_once):
        rows = slice(start, min(start + rows_at_once, len(seen)))
        first, middle, last = (slice(rows.start + k * reach, rows.stop + k * reach) for k in range(3))
        known, steps = seen[rows], steps_y[rows, None]
        slope_x, slope_y = slope_map.slope_x, slope_map.slope_y
        sigma_x, sigma_y = slope_map.sigma_random_x, slope_map.sigma_random_y
        turn, variance = np.zeros(known.shape), np.zeros(known.shape)
        for weight, end in zip(along_x, ends, strict=True):
            turn += weight * (slope_x[last, end] - slope_x[first, end]) / steps
            variance += weight**2 * (sigma_x[last, end] ** 2 + sigma_x[first, end] ** 2) / steps**2
        for weight, side in zip(along_y[:, rows, None], (first, middle, last), strict=True):
            turn -= weight * (slope_y[side, ahead] - slope_y[side, behind]) / steps_x
            variance += weight**2 * (sigma_y[side, ahead] ** 2 + sigma_y[side, behind] ** 2) / steps_x**2
        squares += float(np.sum(np.square(turn, out=turn), where=known))
        variances += float(np.sum(variance, where=known))
    count = int(np.count_nonzero(seen))
    if not count:
        return CurlRms(np.nan, np.nan)
    variances += _curl_squares(slope_map.common, slope_map, reach, seen)
    return CurlRms(float(np.sqrt(squares / count)), float(np.sqrt(variances / count)))


def _curl_squares(modes: CommonModes, slope_map: SlopeMap, reach: int, seen: BoolArray) -> float:
    """Return the sum over nodes and modes of the squared curl of each mode [1/m^2].

    A mode's curl is a sum of products of a function of y and one of x: its square is summed by products of matrices.
    """
    ahead, behind = slice(2 * reach, None), slice(None, -2 * reach)
    of_x, of_y = modes.powers_on(slope_map.x_m, slope_map.y_m)
    mean_x, mean_y = (
        _along_side(powers, _side_weights(grid, reach), 1, reach)[:, reach:-reach]
        for powers, grid in ((of_x, slope_map.x_m), (of_y, slope_map.y_m))
    )
    d_x, d_y = (
        (powers[:, ahead] - powers[:, behind]) / (grid[ahead] - grid[behind])
        for powers, grid in ((of_x, slope_map.x_m), (of_y, slope_map.y_m))
    )
    along_y = np.concatenate([d_y, mean_y])
    products = (along_y[:, None] * along_y[None]).reshape(-1, along_y.shape[1])
    sums = (products @ seen.astype(np.float64)).reshape(len(along_y), len(along_y), -1)
    total = 0.0
    for by_x, by_y in modes.tables():
        along_x = np.concatenate([by_x @ mean_x, -by_y @ d_x])
        total += float(np.einsum("abn,an,bn->", sums, along_x, along_x, optimize=True))
    return total


def curvature(slope_map: SlopeMap) -> tuple[Derivative, Derivative]:
    """Return ``d slope_x / dx`` and ``d slope_y / dy``, the curvatures in x and y (1 / (2 f) on a paraboloid).

    Returns: Curvature in x and in y with sigma [1/m]; NaN at nodes with a missing neighbour.
    """
    valid, reach = slope_map.valid, _reach(slope_map)
    variance_x = _central_variance(slope_map.sigma_random_x, slope_map.x_m, 1, reach)
    variance_y = _central_variance(slope_map.sigma_random_y, slope_map.y_m, 0, reach)
    for mode_x, mode_y in slope_map.common.on_grid(slope_map.x_m, slope_map.y_m):
        variance_x += _central(mode_x, slope_map.x_m, 1, reach) ** 2
        variance_y += _central(mode_y, slope_map.y_m, 0, reach) ** 2
    along_x = _central(np.where(valid, slope_map.slope_x, np.nan), slope_map.x_m, 1, reach)
    along_y = _central(np.where(valid, slope_map.slope_y, np.nan), slope_map.y_m, 0, reach)
    return _derivative(along_x, variance_x), _derivative(along_y, variance_y)


def _reach(slope_map: SlopeMap) -> int:
    """Return how many nodes away the neighbours of a difference lie: so far that they share no pixel."""
    return max(1, int(np.ceil(np.sqrt(slope_map.noise_correlation) - 1e-9)))


def _derivative(value: FloatArray, variance: FloatArray) -> Derivative:
    return Derivative(value, np.where(np.isfinite(value), np.sqrt(variance), np.nan))


def _central(values: FloatArray, positions_m: FloatArray, axis: int, reach: int) -> FloatArray:
    along = np.moveaxis(values, axis, -1)
    result = np.full(along.shape, np.nan)
    # Over the positions themselves also on an uneven grid: exact for linear slopes everywhere.
    ahead, behind = slice(2 * reach, None), slice(None, -2 * reach)
    if positions_m.size > 2 * reach:
        steps = positions_m[ahead] - positions_m[behind]
        result[..., reach:-reach] = (along[..., ahead] - along[..., behind]) / steps
    return np.moveaxis(result, -1, axis)


def _central_variance(sigma: FloatArray, positions_m: FloatArray, axis: int, reach: int) -> FloatArray:
    along = np.moveaxis(sigma, axis, -1) ** 2
    result = np.full(along.shape, np.nan)
    ahead, behind = slice(2 * reach, None), slice(None, -2 * reach)
    if positions_m.size > 2 * reach:
        steps = positions_m[ahead] - positions_m[behind]
        result[..., reach:-reach] = (along[..., ahead] + along[..., behind]) / steps**2
    return np.moveaxis(result, -1, axis)


def resample(slope_map: SlopeMap, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> SlopeMap:
    """Interpolate a map to another grid (bilinear).

    x_m (nx,): New columns, ascending, in the same frame [m].
    y_m (ny,): New rows, ascending [m].
    Returns: The map on the new grid. A node has a value only where all nodes it draws on have one; otherwise it
        has their flags. Nodes beyond the old grid are outside the aperture.
    InputError: The new grid is not finite or not ascending.

    The random sigma is that of the weighted mean of up to four nodes, which share noise as the map's noise correlation
    says. Neighbours on a finer grid share more of it; the noise correlation is raised so that the mean over an area
    keeps its sigma.
    """
    new_x, new_y = float_array("x_m", x_m, (None,)), float_array("y_m", y_m, (None,))
    for name, grid in (("x_m", new_x), ("y_m", new_y)):
        if grid.size == 0 or (np.diff(grid) <= 0).any():
            raise InputError(f"{name}: a grid that ascends is needed")
    column, right = _locate(slope_map.x_m, new_x)
    row, upper = _locate(slope_map.y_m, new_y)
    last_row, last_column = slope_map.y_m.size - 1, slope_map.x_m.size - 1
    corners = [
        (
            np.ix_(np.minimum(row + i, last_row), np.minimum(column + j, last_column)),
            np.outer(upper if i else 1 - upper, right if j else 1 - right),
        )
        for i in (0, 1)
        for j in (0, 1)
    ]

    def blend(values: FloatArray) -> FloatArray:
        # A corner of weight zero must not spread its NaN.
        parts = [np.where(weight > 0, weight * values[corner], 0.0) for corner, weight in corners]
        return np.asarray(np.sum(parts, axis=0))

    def spread(sigma: FloatArray) -> FloatArray:
        weights = np.stack([weight for _, weight in corners])
        return weighted_sigma(weights, np.stack([sigma[corner] for corner, _ in corners]), slope_map.noise_correlation)

    flags: FlagArray = np.zeros((new_y.size, new_x.size), dtype=np.uint32)
    for corner, weight in corners:
        flags |= np.where(weight > 0, slope_map.flags[corner], np.uint32(0))
    valid = slope_map.valid.astype(np.float64)
    complete = blend(valid) > 1 - 1e-9
    reached = np.outer(_within(slope_map.y_m, new_y), _within(slope_map.x_m, new_x))

    def measured(values: FloatArray) -> FloatArray:
        return np.where(complete & reached, values, np.nan)

    sigma_x, sigma_y = (measured(spread(s)) for s in (slope_map.sigma_random_x, slope_map.sigma_random_y))
    return replace(
        slope_map,
        x_m=new_x,
        y_m=new_y,
        slope_x=measured(blend(slope_map.slope_x)),
        slope_y=measured(blend(slope_map.slope_y)),
        design_slope_x=np.where(reached, blend(slope_map.design_slope_x), np.nan),
        design_slope_y=np.where(reached, blend(slope_map.design_slope_y), np.nan),
        sigma_random_x=sigma_x,
        sigma_random_y=sigma_y,
        noise_correlation=_resampled_correlation(slope_map, new_x, new_y, np.stack([sigma_x, sigma_y])),
        height_m=np.where(reached, blend(slope_map.height_m), np.nan),
        flags=flags,
        aperture=reached & (blend(slope_map.aperture.astype(np.float64)) >= 0.5),
    )


def _resampled_correlation(slope_map: SlopeMap, x_m: FloatArray, y_m: FloatArray, sigma: FloatArray) -> float:
    """Return the noise correlation with which a mean over an area keeps its variance on the new grid."""
    old = np.stack([slope_map.sigma_random_x, slope_map.sigma_random_y])[:, slope_map.valid]
    new = sigma[:, np.isfinite(sigma).all(axis=0)]
    if old.size == 0 or new.size == 0 or not new.any():
        return slope_map.noise_correlation
    cells = _cell_area(slope_map.x_m, slope_map.y_m) / _cell_area(x_m, y_m)
    # On a coarser grid nodes share nothing any more: never below 1.
    return max(1.0, slope_map.noise_correlation * cells * float(np.mean(old**2) / np.mean(new**2)))


def _cell_area(x_m: FloatArray, y_m: FloatArray) -> float:
    # A single row or column has no spacing; 1 m keeps the ratio of two such grids at that of the other axis.
    return float(np.prod([np.ptp(grid) / (grid.size - 1) if grid.size > 1 else 1.0 for grid in (x_m, y_m)]))


def _locate(grid_m: FloatArray, positions_m: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the cell of each position and the fraction within it."""
    if grid_m.size == 1:
        return np.zeros(positions_m.size, dtype=np.intp), np.zeros(positions_m.size)
    cell = np.clip(np.searchsorted(grid_m, positions_m, side="right") - 1, 0, grid_m.size - 2)
    fraction = (positions_m - grid_m[cell]) / (grid_m[cell + 1] - grid_m[cell])
    # Round-off in a grid written in decimals must not draw on a neighbour that is missing.
    fraction = np.where(np.abs(fraction - np.round(fraction)) < 1e-9, np.round(fraction), fraction)
    return cell, np.clip(fraction, 0.0, 1.0)


def _within(grid_m: FloatArray, positions_m: FloatArray) -> BoolArray:
    slack = 1e-9 * max(float(np.ptp(grid_m)), 1e-3)
    return np.asarray((positions_m >= grid_m[0] - slack) & (positions_m <= grid_m[-1] + slack))


def difference(map_a: SlopeMap, map_b: SlopeMap) -> SlopeMap:
    """Subtract one map from another on the same grid.

    map_a, map_b: Maps in the same frame, on the same grid (see `resample`).
    Returns: Slopes and heights a - b with a design of zero, so that its slope errors are the difference; the
        aperture is what both share; sigmas add in squares, as for independent measurements (an upper bound where
        the two share an instrument).
    InputError: The grids differ.
    """
    same = map_a.shape == map_b.shape and all(
        np.allclose(a, b, rtol=0, atol=1e-9) for a, b in ((map_a.x_m, map_b.x_m), (map_a.y_m, map_b.y_m))
    )
    if not same:
        raise InputError(
            f"map_a, map_b: the grids differ ({map_a.shape} nodes from x = {map_a.x_m[0]:.6g} m and {map_b.shape} "
            f"nodes from x = {map_b.x_m[0]:.6g} m); bring one onto the other's grid with resample first"
        )
    both = map_a.valid & map_b.valid
    return replace(
        map_a,
        slope_x=np.where(both, map_a.slope_x - map_b.slope_x, np.nan),
        slope_y=np.where(both, map_a.slope_y - map_b.slope_y, np.nan),
        design_slope_x=np.zeros(map_a.shape),
        design_slope_y=np.zeros(map_a.shape),
        sigma_random_x=np.hypot(map_a.sigma_random_x, map_b.sigma_random_x),
        sigma_random_y=np.hypot(map_a.sigma_random_y, map_b.sigma_random_y),
        noise_correlation=_joint_correlation(map_a, map_b, both),
        height_m=map_a.height_m - map_b.height_m,
        common=joint_modes(map_a.common, map_b.common),
        flags=map_a.flags | map_b.flags,
        aperture=map_a.aperture & map_b.aperture,
        design=f"zero (difference of two maps; first: {map_a.design}; second: {map_b.design})",
        removed=f"first map: {map_a.removed}; second map: {map_b.removed}",
    )


def _joint_correlation(map_a: SlopeMap, map_b: SlopeMap, both: BoolArray) -> float:
    a, b = (float(np.sum(m.sigma_random_x[both] ** 2 + m.sigma_random_y[both] ** 2)) for m in (map_a, map_b))
    total = a + b
    return (map_a.noise_correlation * a + map_b.noise_correlation * b) / total if total > 0 else 1.0


def joint_modes(first: CommonModes, second: CommonModes) -> CommonModes:
    """Return the modes of both, those of the first first."""
    if not second.sources:
        return first
    if not first.sources:
        return second
    degree = max(first.degree, second.degree)
    # A polynomial is known from its values on a (degree + 1)^2 lattice: the change of variables is then exact.
    steps = np.linspace(-1, 1, degree + 1)
    x, y = (grid.reshape(-1) for grid in np.meshgrid(steps, steps))
    x, y = first.center_m[0] + first.scale_m * x, first.center_m[1] + first.scale_m * y
    values = np.concatenate([first.evaluate(x, y), second.evaluate(x, y)])
    return replace(fit_modes(first, values, x, y, degree), sources=first.sources + second.sources)
