"""Smooth curl of a slope map: means over the mirror that are zero for every surface, with their covariance."""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from heliogauge.slopes.map import CommonModes, SlopeMap
from heliogauge.validate import BoolArray, FloatArray

#: Degree of the polynomials: shear of the slopes that is the same everywhere, and its change to second order.
_DEGREE = 2
#: Over this share of the mirror's side the weights rise from its edge and from each hole: a step would add noise.
_RISE_SHARE = 0.1


#: Nodes that are worked on at once: what belongs to them stays in the second-level cache.
_BLOCK = 8192


@dataclass(frozen=True, slots=True, eq=False)
class CurlMoments:
    """Weighted means of ``d slope_x / dy - d slope_y / dx`` over a map.

    values_per_m (k,): The means [1/m].
    covariance (k, k): From random and common errors of measurement [1/m^2].
    slope_map: The map.
    """

    values_per_m: FloatArray
    covariance: FloatArray
    slope_map: SlopeMap
    _weights: "_Weights"

    @property
    def chi_square(self) -> float:
        """Sum of the squared means over their covariance: k on average for the slopes of a surface."""
        return float(self.values_per_m @ np.linalg.solve(self.covariance, self.values_per_m))

    def of_modes(self, modes: CommonModes) -> FloatArray:
        """Return the same means of smooth slope errors, shape (k, number of modes) [1/m]."""
        return self._weights.of_modes(modes)


def curl_moments(slope_map: SlopeMap) -> CurlMoments | None:
    """Return weighted means of a map's curl: polynomials that fall to zero at the edge of what is measured.

    Returns: None where the map has fewer than 100 nodes with four neighbours.

    Single nodes have a curl of noise; the mean over thousands shows slopes that no surface has a hundred times more
    clearly. With weights w that vanish at every edge, ``sum w curl`` is zero for the slopes of any surface, smooth or
    not (Green's theorem), so that waviness is no part of it. Each mean is linear in the slopes; the covariance is
    theirs.
    """
    valid = slope_map.valid
    complete = np.zeros_like(valid)
    inner = (slice(1, -1), slice(1, -1))
    complete[inner] = valid[2:, 1:-1] & valid[:-2, 1:-1] & valid[1:-1, 2:] & valid[1:-1, :-2] & valid[inner]
    if np.count_nonzero(complete) < 100:
        return None
    weights = _Weights.of(slope_map, valid, complete)
    values, random = np.zeros(len(_POWERS)), np.zeros((len(_POWERS),) * 2)
    for rows, weights_x, weights_y in weights.blocks():
        # Nodes without a value have no weight.
        known = valid[rows].ravel()
        for one, slopes, design, sigma in (
            (weights_x, slope_map.slope_x, slope_map.design_slope_x, slope_map.sigma_random_x),
            (weights_y, slope_map.slope_y, slope_map.design_slope_y, slope_map.sigma_random_y),
        ):
            errors = np.where(known, (slopes[rows] - design[rows]).ravel(), 0.0)
            values += one @ errors
            random += (one * np.where(known, sigma[rows].ravel(), 0.0) ** 2) @ one.T
    modes = weights.of_modes(slope_map.common)
    return CurlMoments(values, slope_map.noise_correlation * random + modes @ modes.T, slope_map, weights)


#: Powers of x and of y of each polynomial.
_POWERS = [(order - j, j) for order in range(_DEGREE + 1) for j in range(order + 1)]


@dataclass(frozen=True, slots=True, eq=False)
class _Weights:
    """What slopes in x and y of each node add to each mean.

    x_m, y_m: The map's grid [m].
    columns (d + 1, nx), rows (d + 1, ny): Powers of the places.
    window (ny, nx): Weight of each node's curl, with a sum of 1.
    """

    x_m: FloatArray
    y_m: FloatArray
    columns: FloatArray
    rows: FloatArray
    window: FloatArray

    @classmethod
    def of(cls, slope_map: SlopeMap, valid: BoolArray, complete: BoolArray) -> "_Weights":
        powers, places = np.arange(_DEGREE + 1)[:, None], []
        for grid, count in ((slope_map.x_m, valid.sum(axis=0)), (slope_map.y_m, valid.sum(axis=1))):
            places.append((grid - grid @ count / count.sum(), np.ptp(grid[count > 0])))
        scale = 0.5 * max(float(side) for _, side in places)
        window = _window(complete)
        columns, rows = ((place / scale) ** powers for place, _ in places)
        return cls(slope_map.x_m, slope_map.y_m, columns, rows, window / window.sum())

    def blocks(self) -> Iterator[tuple[slice, FloatArray, FloatArray]]:
        """Yield some rows, and the weights (k, b) of their slopes in x and in y [1/m]."""
        height, width = self.window.shape
        # Sums of differences over two steps, moved from the slopes to the weights; none at the edge.
        along_x, along_y = (np.zeros(grid.size) for grid in (self.x_m, self.y_m))
        for one, grid in ((along_x, self.x_m), (along_y, self.y_m)):
            one[1:-1] = 1 / (grid[2:] - grid[:-2])
        step = max(1, _BLOCK // width)
        for start in range(0, height, step):
            rows = slice(start, min(start + step, height))
            above = slice(max(start - 1, 0), min(rows.stop + 1, height))
            by_y = np.zeros((rows.stop - rows.start + 2, width))
            by_y[above.start - start + 1 : above.stop - start + 1] = self.window[above] * along_y[above, None]
            by_x = self.window[rows] * along_x
            powers_y = np.zeros((_DEGREE + 1, len(by_y)))
            powers_y[:, above.start - start + 1 : above.stop - start + 1] = self.rows[:, above]
            weights_x, weights_y = np.zeros((2, len(_POWERS), *by_x.shape))
            for number, (power_x, power_y) in enumerate(_POWERS):
                part = by_y * powers_y[power_y][:, None]
                np.multiply(part[:-2] - part[2:], self.columns[power_x], out=weights_x[number])
                part = by_x * np.multiply.outer(self.rows[power_y, rows], self.columns[power_x])
                weights_y[number, :, :-1] = part[:, 1:]
                weights_y[number, :, 1:] -= part[:, :-1]
            yield rows, weights_x.reshape(len(_POWERS), -1), weights_y.reshape(len(_POWERS), -1)

    def of_modes(self, modes: CommonModes) -> FloatArray:
        """Return the means of smooth slope errors, shape (k, number of modes) [1/m]."""
        total = np.zeros((len(_POWERS), len(modes.sources)))
        if not modes.sources:
            return total
        for rows, weights_x, weights_y in self.blocks():
            values = np.stack(list(modes.on_grid(self.x_m, self.y_m[rows]))).reshape(len(modes.sources), 2, -1)
            total += weights_x @ values[:, 0].T + weights_y @ values[:, 1].T
        return total


def _window(complete: BoolArray) -> FloatArray:
    """Return weights that rise smoothly from 0 at the edge of what is measured to 1."""
    inside = np.pad(complete.astype(np.uint8), 1)
    away = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1].astype(np.float64)
    share = np.minimum(away / (_RISE_SHARE * np.sqrt(np.count_nonzero(complete))), 1.0)
    return np.asarray(share**2 * (3 - 2 * share))
