"""A slope map read between its nodes."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from heliogauge.slopes.map import SlopeMap, monomials
from heliogauge.validate import BoolArray, FlagArray, FloatArray, IntArray

#: Slopes of strong mirrors change by 0.3 mrad from node to node; a polynomial of this degree holds all but what the
#: nodes themselves show, so that a neighbour on one side alone shifts nothing.
_TREND_DEGREE = 4
#: So many nodes fix the trend.
_TREND_NODES = 2000


class MapReading(NamedTuple):
    """What a map says at points, each of shape (n,).

    slope_x, slope_y, design_slope_x, design_slope_y: Slopes; NaN where the nearest node has none.
    sigma_random_x, sigma_random_y: Random share of their uncertainty [rad].
    height_m: Height [m].
    flags: Those of the nearest node.
    """

    slope_x: FloatArray
    slope_y: FloatArray
    design_slope_x: FloatArray
    design_slope_y: FloatArray
    sigma_random_x: FloatArray
    sigma_random_y: FloatArray
    height_m: FloatArray
    flags: FlagArray


def read_map(slope_map: SlopeMap, x_m: FloatArray, y_m: FloatArray) -> MapReading:
    """Interpolate a map at points.

    x_m, y_m (n,): Points in the map's frame; beyond its grid the nearest nodes are read [m].
    Returns: Slopes, sigmas, height and flags there.

    Linear between the up to four nodes around a point that have a value, after a polynomial through all nodes was taken
    out; it is added again at the point itself. A point whose nearest node has no slope has none.
    """
    cells = _Cells.around(slope_map, x_m, y_m)
    fields = [slope_map.slope_x, slope_map.slope_y, slope_map.design_slope_x, slope_map.design_slope_y]
    measured = slope_map.valid.ravel()
    usable = measured[cells.nearest]
    values = [
        cells.mean(slope_map, field, measured if number < 2 else np.isfinite(field.ravel()), (x_m, y_m))
        for number, field in enumerate([*fields, slope_map.height_m])
    ]
    values[:2] = [np.where(usable, one, np.nan) for one in values[:2]]
    weights = cells.weights_of(measured)
    sigmas = [
        np.where(usable, weighted_sigma(weights, sigma.ravel()[cells.corners], slope_map.noise_correlation), np.nan)
        for sigma in (slope_map.sigma_random_x, slope_map.sigma_random_y)
    ]
    flags: FlagArray = slope_map.flags.ravel()[cells.nearest]
    slope_x, slope_y, design_x, design_y, height = values
    return MapReading(slope_x, slope_y, design_x, design_y, sigmas[0], sigmas[1], height, flags)


def weighted_sigma(weights: FloatArray, sigmas: FloatArray, noise_correlation: float) -> FloatArray:
    """Return the sigma of weighted means of the four nodes of a cell, which share noise where the grid is fine.

    weights, sigmas (4, ...): Of the lower left, lower right, upper left and upper right node; a weight of zero leaves
        its sigma out.
    noise_correlation: That of the map, the sum over one node's correlations with all others.

    Smooth interpolation of pixels makes correlations that fall off like ``exp(-pi d**2 / c)`` over d nodes, where c is
    that sum: 0.81 between neighbours for linear interpolation at 0.4 px (exact 0.808), 0.25 at 1 px (exact 0.25).
    """
    beside = float(np.exp(-np.pi / noise_correlation)) if noise_correlation > 1 else 0.0
    shares = np.where(weights > 0, weights * sigmas, 0.0)
    along = np.array([[1.0, beside], [beside, 1.0]])
    shared = np.kron(along, along)
    return np.asarray(np.sqrt(np.einsum("i...,ij,j...->...", shares, shared, shares)))


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """The nodes around points, as flat indices.

    corners (4, n): Lower left, lower right, upper left, upper right.
    weights (4, n): Bilinear weights, with a sum of 1.
    nearest (n,): The nearest node.
    """

    corners: IntArray
    weights: FloatArray
    nearest: IntArray

    @classmethod
    def around(cls, slope_map: SlopeMap, x_m: FloatArray, y_m: FloatArray) -> "_Cells":
        column, right = _cell(slope_map.x_m, x_m)
        row, up = _cell(slope_map.y_m, y_m)
        width = slope_map.x_m.size
        next_column = np.minimum(column + 1, width - 1)
        next_row = np.minimum(row + 1, slope_map.y_m.size - 1)
        corners = np.stack([r * width + c for r in (row, next_row) for c in (column, next_column)])
        weights = np.stack([v * u for v in (1 - up, up) for u in (1 - right, right)])
        near = np.where(up > 0.5, next_row, row) * width + np.where(right > 0.5, next_column, column)
        return cls(corners, weights, near)

    def weights_of(self, usable: BoolArray) -> FloatArray:
        """Return the weights with the nodes left out that are not usable (flat); zero where none is."""
        kept = np.where(usable[self.corners], self.weights, 0.0)
        total = kept.sum(axis=0)
        return np.asarray(np.divide(kept, total, out=np.zeros_like(kept), where=total > 0))

    def mean(
        self, slope_map: SlopeMap, field: FloatArray, usable: BoolArray, at_m: tuple[FloatArray, FloatArray]
    ) -> FloatArray:
        """Interpolate a field at the points; NaN where no node around has a value."""
        usable = usable & np.isfinite(field.ravel())
        if not usable.any():
            return np.full(at_m[0].shape, np.nan)
        trend = _Trend.through(slope_map, field, usable)
        nodes = np.stack(
            [slope_map.x_m[self.corners % slope_map.x_m.size], slope_map.y_m[self.corners // slope_map.x_m.size]]
        )
        rest = np.where(usable[self.corners], field.ravel()[self.corners] - trend(*nodes), 0.0)
        weights = self.weights_of(usable)
        return np.where(weights.any(axis=0), (weights * rest).sum(axis=0) + trend(*at_m), np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class _Trend:
    """A polynomial through the nodes of a field."""

    coefficients: FloatArray
    center_m: FloatArray
    scale_m: float

    @classmethod
    def through(cls, slope_map: SlopeMap, field: FloatArray, usable: BoolArray) -> "_Trend":
        index = np.flatnonzero(usable)
        index = index[:: max(1, index.size // _TREND_NODES)]
        width = slope_map.x_m.size
        places = np.stack([slope_map.x_m[index % width], slope_map.y_m[index // width]])
        center = 0.5 * (places.min(axis=1) + places.max(axis=1))
        scale = 0.5 * float(np.ptp(places, axis=1).max()) or 1.0
        # Few nodes, or nodes in a row, leave most terms out: the least solution is taken.
        u, v = (places - center[:, None]) / scale
        terms = monomials(u, v, _TREND_DEGREE)
        found = np.linalg.lstsq(terms.T, field.ravel()[index], rcond=None)[0]
        return cls(np.asarray(found, dtype=np.float64), center, scale)

    def __call__(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        terms = monomials(
            (x_m - self.center_m[0]) / self.scale_m, (y_m - self.center_m[1]) / self.scale_m, _TREND_DEGREE
        )
        return np.asarray(np.tensordot(self.coefficients, terms, axes=1))


def _cell(grid_m: FloatArray, positions_m: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the cell of each position and the fraction within it; positions beyond the grid are at its ends."""
    if grid_m.size == 1:
        return np.zeros(positions_m.shape, dtype=np.intp), np.zeros(positions_m.shape)
    cell = np.clip(np.searchsorted(grid_m, positions_m, side="right") - 1, 0, grid_m.size - 2)
    return cell, np.clip((positions_m - grid_m[cell]) / (grid_m[cell + 1] - grid_m[cell]), 0.0, 1.0)
