"""Smooth curl of a slope map: means over the mirror that are zero for every surface, with their covariance."""

from dataclasses import dataclass, replace
from itertools import product

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

    @property
    def smooth_rms_per_m(self) -> float:
        """RMS over the map of the polynomial that fits the curl best [1/m]."""
        return float(np.sqrt(self.values_per_m @ np.linalg.solve(self._weights.products(), self.values_per_m)))

    def of_modes(self, modes: CommonModes) -> FloatArray:
        """Return the same means of smooth slope errors, shape (k, number of modes) [1/m]."""
        return self._weights.of_modes(modes)

    def with_waviness(self, responses: FloatArray) -> "CurlMoments":
        """Return the same moments with what errors of measurement do to waviness in their covariance.

        responses (k, 2, 2): What one sigma of each error adds to both slopes, for waviness in either.

        Modes are polynomials: where slopes step, as at a kink, what an error makes of the step is no polynomial, and
        slopes along y that a turned screen makes of a step in slopes along x have a curl.
        """
        one, valid = self.slope_map, self.slope_map.valid
        waves = _beside_modes(one, valid)
        known = np.where(valid, 0.0, np.nan)
        fields = np.zeros((2, 2, len(_POWERS)))
        for seen, wave in enumerate(waves):
            for into in range(2):
                slopes = [known, known]
                slopes[into] = wave
                bare = replace(one, slope_x=slopes[0] + one.design_slope_x, slope_y=slopes[1] + one.design_slope_y)
                fields[into, seen] = self._weights.of_slopes(bare, valid)[0]
        effects = np.einsum("kis,ism->mk", responses, fields)
        return replace(self, covariance=self.covariance + effects @ effects.T)


def _beside_modes(slope_map: SlopeMap, valid: BoolArray) -> FloatArray:
    """Return what polynomials of the degree of the common modes leave of the slope errors, shape (2, ny, nx)."""
    errors = np.stack([slope_map.slope_error_x, slope_map.slope_error_y])
    if not slope_map.common.sources:
        return errors
    columns, rows = slope_map.common.powers_on(slope_map.x_m, slope_map.y_m)
    degree = slope_map.common.degree
    terms = np.stack([np.outer(rows[j], columns[i])[valid] for j in range(degree + 1) for i in range(degree + 1 - j)])
    left = np.full_like(errors, np.nan)
    left[:, valid] = errors[:, valid] - np.linalg.solve(terms @ terms.T, terms @ errors[:, valid].T).T @ terms
    return left


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
    values, random = weights.of_slopes(slope_map, valid)
    modes = weights.of_modes(slope_map.common)
    return CurlMoments(values, slope_map.noise_correlation * random + modes @ modes.T, slope_map, weights)


#: Powers of x and of y of each polynomial.
_POWERS = [(order - j, j) for order in range(_DEGREE + 1) for j in range(order + 1)]


@dataclass(frozen=True, slots=True, eq=False)
class _Weights:
    """What the curl of each node adds to each mean: a window times powers of the place in x and in y.

    x_m, y_m: The map's grid [m].
    columns (d + 1, nx), rows (d + 1, ny): Powers of the places.
    window (ny, nx): Weight of each node's curl, with a sum of 1; none in the first and last rows and columns.

    The curl of a node is that of differences over two steps. Sums over all nodes of a window times powers are made of
    two products of matrices, the powers of y with the window and what comes with the powers of x.
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

    def of_slopes(self, slope_map: SlopeMap, valid: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Return the means (k,) of a map's slope errors [1/m], and their covariance (k, k) from its noise [1/m^2].

        A slope has the difference of the weights of two nodes. The covariance is therefore that of each node's curl
        with itself, less that of two nodes that share the slope between them.
        """
        along_x, along_y = _Differences.of(self.x_m, self.columns), _Differences.of(self.y_m, self.rows)
        size = 2 * _DEGREE + 1
        means = np.zeros((_DEGREE + 1, self.x_m.size))
        own_x, own_y = np.zeros((2, size, self.x_m.size))
        shared_x, shared_y = np.zeros((_SQUARES, self.x_m.size)), np.zeros((size, self.x_m.size))
        step = max(1, _BLOCK // self.x_m.size)
        for start in range(1, self.y_m.size - 1, step):
            rows = slice(start, min(start + step, self.y_m.size - 1))
            halo = slice(rows.start - 1, rows.stop + 1)
            # Nodes without a value have no weight.
            known, window = valid[halo], self.window[halo]
            errors_x = np.where(known, slope_map.slope_x[halo] - slope_map.design_slope_x[halo], 0.0)
            errors_y = np.where(known, slope_map.slope_y[halo] - slope_map.design_slope_y[halo], 0.0)[1:-1]
            curl = (errors_x[2:] - errors_x[:-2]) * along_y.per_m[rows, None]
            curl[:, 1:-1] -= (errors_y[:, 2:] - errors_y[:, :-2]) * along_x.per_m[1:-1]
            means += self.rows[:, rows] @ (window[1:-1] * curl)
            variance_x = np.where(known, slope_map.sigma_random_x[halo], 0.0) ** 2
            variance_y = np.where(known, slope_map.sigma_random_y[halo], 0.0)[1:-1] ** 2
            squares = window[1:-1] ** 2
            own_x += along_y.squares[:, rows] @ (squares * (variance_x[2:] + variance_x[:-2]))
            shared_x += along_y.shared[:, rows] @ (window[2:] * window[:-2] * variance_x[1:-1])
            powers = along_y.powers[:, rows]
            window, squares = window[1:-1], squares[:, 1:-1]
            own_y[:, 1:-1] += powers @ (squares * (variance_y[:, 2:] + variance_y[:, :-2]))
            shared_y[:, 1:-1] += powers @ (window[:, 2:] * window[:, :-2] * variance_y[:, 1:-1])
        # The first and last nodes have no weight: not even in a slope that another node shares.
        shared_x = shared_x @ along_x.powers.T
        own = own_x @ along_x.powers.T + own_y @ along_x.squares.T
        shared_y = shared_y @ along_x.shared.T
        values = np.array([means[j] @ self.columns[i] for i, j in _POWERS])
        random = np.empty((len(_POWERS),) * 2)
        for (row, (i, j)), (column, (m, n)) in product(enumerate(_POWERS), repeat=2):
            shared = shared_x[_square(j, n), i + m] + shared_y[j + n, _square(i, m)]
            random[row, column] = own[j + n, i + m] - shared
        return values, random

    def products(self) -> FloatArray:
        """Return the means of the products of two of the polynomials, shape (k, k)."""
        found = np.empty((len(_POWERS),) * 2)
        for (row, (i, j)), (column, (m, n)) in product(enumerate(_POWERS), repeat=2):
            found[row, column] = (self.rows[j] * self.rows[n]) @ self.window @ (self.columns[i] * self.columns[m])
        return found

    def of_modes(self, modes: CommonModes) -> FloatArray:
        """Return the means of smooth slope errors, shape (k, number of modes) [1/m]."""
        total = np.zeros((len(_POWERS), len(modes.sources)))
        if not modes.sources:
            return total
        along_x, along_y = _Differences.of(self.x_m, self.columns), _Differences.of(self.y_m, self.rows)
        columns, rows = modes.powers_on(self.x_m, self.y_m)
        # Sums of the window times powers of the polynomials and of the modes: [of y: both, of x: both].
        of_y, of_x = _products(self.rows, along_y.of_functions(rows)), _products(self.columns, columns)
        by_y = _split(of_y @ self.window @ of_x.T, modes.degree + 1)
        of_y, of_x = _products(self.rows, rows), _products(self.columns, along_x.of_functions(columns))
        by_x = _split(of_y @ self.window @ of_x.T, modes.degree + 1)
        for number, table in enumerate(modes.tables()):
            for row, (i, j) in enumerate(_POWERS):
                total[row, number] = np.sum(table[0] * by_y[j, :, i]) - np.sum(table[1] * by_x[j, :, i])
        return total


#: Number of pairs of powers of two places.
_SQUARES = (_DEGREE + 1) ** 2


def _square(first: int, second: int) -> int:
    return first * (_DEGREE + 1) + second


def _products(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return all products of two sets of functions of one place, shape (a * b, n)."""
    return np.asarray((first[:, None] * second[None]).reshape(-1, first.shape[1]))


def _split(sums: FloatArray, size: int) -> FloatArray:
    """Take sums of products of y (rows) and of x (columns) apart: [polynomial y, mode y, polynomial x, mode x]."""
    return np.asarray(sums.reshape(_DEGREE + 1, size, _DEGREE + 1, size))


@dataclass(frozen=True, slots=True, eq=False)
class _Differences:
    """Differences over two steps along one axis of the grid, of n places.

    per_m (n,): One over the two steps; 0 at the ends [1/m].
    powers (2 d + 1, n): Powers of the places.
    squares (2 d + 1, n): The same times the square of `per_m`.
    shared ((d + 1)^2, n): For the slope of a node, which its neighbours' curls share: products of the powers of the
        place behind and of the one ahead, in both orders, times both `per_m`.
    """

    per_m: FloatArray
    powers: FloatArray
    squares: FloatArray
    shared: FloatArray

    @classmethod
    def of(cls, grid_m: FloatArray, powers: FloatArray) -> "_Differences":
        per_m = np.zeros(grid_m.size)
        per_m[1:-1] = 1 / (grid_m[2:] - grid_m[:-2])
        more = powers[1] ** np.arange(2 * _DEGREE + 1)[:, None]
        weighted, shared = powers * per_m, np.zeros((_DEGREE + 1, _DEGREE + 1, grid_m.size))
        ahead_behind = weighted[:, None, 2:] * weighted[None, :, :-2]
        shared[..., 1:-1] = ahead_behind + ahead_behind.swapaxes(0, 1)
        return cls(per_m, more, more * per_m**2, shared.reshape(_SQUARES, -1))

    def of_functions(self, values: FloatArray) -> FloatArray:
        """Return the differences of functions of the place, shape (k, n); 0 at the ends."""
        result = np.zeros_like(values)
        result[:, 1:-1] = (values[:, 2:] - values[:, :-2]) * self.per_m[1:-1]
        return result


def _window(complete: BoolArray) -> FloatArray:
    """Return weights that rise smoothly from 0 at the edge of what is measured to 1."""
    inside = np.pad(complete.astype(np.uint8), 1)
    away = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1].astype(np.float64)
    share = np.minimum(away / (_RISE_SHARE * np.sqrt(np.count_nonzero(complete))), 1.0)
    return np.asarray(share**2 * (3 - 2 * share))
