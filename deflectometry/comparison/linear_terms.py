"""The linear part of a slope map, and what is left of it, each with the covariance that the map's sigmas make."""

from dataclasses import dataclass

import numpy as np

from deflectometry.shape.facet_pixels import spread_indices
from heliogauge.slopes.map import CommonModes, SlopeMap
from heliogauge.validate import BoolArray, FloatArray

#: What the linear part is made of. Tilt [rad] at the middle of what was measured; the others [1/m]. The twist is the
#: symmetric half of the mixed derivatives, the shear the other one: half of the curl, which no surface has.
TERMS = ("tilt_x", "tilt_y", "curvature_x", "curvature_y", "twist", "shear")
#: The same of a map that has slopes in x only: its change along y is turn and twist in one.
TERMS_OF_X = ("tilt_x", "curvature_x", "change_along_y")
#: The common modes are smooth: so many nodes show what they leave.
_NODES = 3000


@dataclass(frozen=True, slots=True, eq=False)
class LinearTerms:
    """Linear terms of the slopes of a map.

    names: `TERMS`, or `TERMS_OF_X` where slopes in y are missing.
    values (k,): [rad] and [1/m].
    covariance (k, k): From random and common errors.
    middle_m (2,): Where the tilt is that of the map [m].
    rest (c, n): What they leave at the measured nodes, c components [rad].
    """

    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    middle_m: FloatArray
    rest: FloatArray

    @property
    def sigmas(self) -> FloatArray:
        """Standard deviations of the values."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    @property
    def rest_rms_rad(self) -> FloatArray:
        """RMS of what is left of each component [rad]."""
        return np.asarray(np.sqrt(np.mean(self.rest**2, axis=1)))


def has_both(slope_map: SlopeMap) -> bool:
    """Return whether a map has slopes in y, too."""
    return bool(np.isfinite(slope_map.slope_y[slope_map.valid]).any())


def measured(slope_map: SlopeMap, *, both: bool) -> BoolArray:
    """Return the nodes with all slopes that are compared, shape (ny, nx)."""
    return np.asarray(slope_map.valid & np.isfinite(slope_map.slope_y)) if both else slope_map.valid


def linear_terms(slope_map: SlopeMap, values: FloatArray, known: BoolArray, common: CommonModes) -> LinearTerms:
    """Fit linear slopes to a map, all nodes with equal weight.

    slope_map: Gives places and random sigmas.
    values (c, ny, nx): What is fitted: one component or two [rad].
    known (ny, nx): Nodes that count.
    common: Common share.
    """
    places, middle = _places(slope_map, known)
    products = np.linalg.inv(places @ places.T)
    of_slopes = products @ places
    chosen = values[:, known]
    found = chosen @ of_slopes.T
    count = len(values)
    covariance = np.zeros((3 * count, 3 * count))
    for axis, sigma in enumerate((slope_map.sigma_random_x, slope_map.sigma_random_y)[:count]):
        part = slice(3 * axis, 3 * axis + 3)
        covariance[part, part] = slope_map.noise_correlation * (of_slopes * sigma[known] ** 2) @ of_slopes.T
    modes = np.einsum("kcn,mn->kcm", _modes_at(slope_map, known, common), of_slopes)[:, :count]
    modes = modes.reshape(-1, 3 * count)
    covariance += modes.T @ modes
    turn = _NAMED if count == 2 else _NAMED_X
    return LinearTerms(
        TERMS if count == 2 else TERMS_OF_X,
        turn @ found.ravel(),
        turn @ covariance @ turn.T,
        middle,
        chosen - found @ places,
    )


#: From the constant and the changes along x and y of both slopes to the named terms.
_NAMED = np.array(
    [
        [1, 0, 0, 0, 0, 0],
        [0, 0, 0, 1, 0, 0],
        [0, 1, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 1],
        [0, 0, 0.5, 0, 0.5, 0],
        [0, 0, 0.5, 0, -0.5, 0],
    ]
)
_NAMED_X = np.eye(3)


def _places(slope_map: SlopeMap, known: BoolArray) -> tuple[FloatArray, FloatArray]:
    rows, columns = np.nonzero(known)
    x, y = slope_map.x_m[columns], slope_map.y_m[rows]
    middle = np.array([x.mean(), y.mean()])
    return np.stack([np.ones(x.size), x - middle[0], y - middle[1]]), middle


def _modes_at(slope_map: SlopeMap, known: BoolArray, common: CommonModes) -> FloatArray:
    if not common.sources:
        return np.zeros((0, 2, int(np.count_nonzero(known))))
    return np.stack([one[:, known] for one in common.on_grid(slope_map.x_m, slope_map.y_m)])


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedRest:
    """What errors of measurement leave of a map without its linear terms.

    mean_square (c,): Of each component [rad^2].
    variance: Variance of the mean square over all components [rad^4].
    """

    mean_square: FloatArray
    variance: float

    def probability(self, mean_square: float) -> float:
        """Return how often the errors leave so large a mean square over all components; NaN without any sigma.

        The sum of squares of correlated errors is taken for a scaled chi-square variable of the same mean and variance
        (Satterthwaite, Biometrics 2 (1946) 110).
        """
        from heliogauge.adjust.chi_square import chi_square_cdf

        mean = float(self.mean_square.mean())
        if not (mean > 0 and self.variance > 0):
            return float("nan")
        freedom = 2 * mean**2 / self.variance
        return 1.0 - chi_square_cdf(freedom * mean_square / mean, freedom)


def expected_rest(
    slope_map: SlopeMap, known: BoolArray, common: CommonModes, fine_square: FloatArray, count: int
) -> ExpectedRest:
    """Return the mean square that errors of measurement leave without the linear terms.

    fine_square (c,): Mean square of what a relative error of the fine structure adds [rad^2].
    count: Number of components c.
    """
    places, _ = _places(slope_map, known)
    few = spread_indices(places.shape[1], _NODES)
    places = places[:, few]
    modes = _modes_at(slope_map, known, common)[:, :count, few]
    modes = modes - np.einsum("kcm,mn->kcn", modes @ places.T @ np.linalg.inv(places @ places.T), places)
    squares = np.stack([sigma[known] ** 2 for sigma in (slope_map.sigma_random_x, slope_map.sigma_random_y)[:count]])
    total = squares.shape[1]
    mean = squares.mean(axis=1) + np.sum(modes**2, axis=0).mean(axis=1) + fine_square
    # Traces of the squared covariance: of noise between neighbours, of the modes, and of one factor for each axis.
    flat = modes.reshape(len(modes), count * few.size)
    trace = slope_map.noise_correlation * float(np.sum(squares**2)) / (total * count) ** 2
    trace += float(np.sum((flat @ flat.T) ** 2)) / (few.size * count) ** 2
    trace += float(np.sum(fine_square**2)) / count**2
    return ExpectedRest(np.asarray(mean), 2 * trace)
