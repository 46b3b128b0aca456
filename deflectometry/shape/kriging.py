"""Slopes between samples that are far apart: the best linear estimate, and how far off it may be."""

from dataclasses import dataclass, field, replace

import numpy as np

from deflectometry.shape.facet_pixels import spread_indices
from heliogauge.validate import BoolArray, FloatArray, IntArray

#: Samples that each estimate uses: those of five columns and rows; farther ones get weights below a thousandth.
_NEIGHBOURS = 24
#: Powers of the distance: a broken, a smooth and a very smooth surface of slopes.
_POWERS = (1, 3, 5)
#: With fewer points that are tested the roughness is known to less than a third, with these to 6 %.
_FEWEST_TESTED, _MOST_TESTED = 20, 500
#: Roughness that is tried first, as a share of the values' variance: of waves some samples long; decades that are tried
#: above and below it; a smaller gain of the log likelihood is none.
_START, _MOST_DECADES, _LEAST_GAIN = 1e-3, 12, 0.01
#: Places that are worked on at once: their matrices then take 30 MB.
_BLOCK = 4096


@dataclass(frozen=True, slots=True, eq=False)
class Kriged:
    """Estimates at places, each (n,), and their standard deviations: noise and what waves between samples make."""

    values: FloatArray
    sigma: FloatArray


def krige(points_m: FloatArray, values: FloatArray, sigma: FloatArray, places_m: FloatArray) -> Kriged:
    """Estimate values at places from those at points, with the uncertainty of both noise and gaps.

    Shapes: points_m (m, 2), values, sigma (m,), places_m (n, 2).

    Intrinsic kriging (Matheron, The intrinsic random functions and their applications, 1973) with a generalised
    covariance c r^p and a quadratic drift: the interpolation is a spline, exact for what is quadratic. How rough the
    values are (c) and how smooth their waves (p = 1, 3 or 5) follows from what each point misses by when it is
    estimated from its neighbours: the power is the one that makes these errors most likely. Beyond the outermost points
    waves of one length depart from a spline by more than between points: there the roughness is what these points miss
    by when they are extrapolated from the others.
    """
    from scipy.spatial import cKDTree

    tree = cKDTree(points_m)
    count = min(_NEIGHBOURS, len(points_m) - 1)
    scale = float(np.median(tree.query(points_m, 2)[0][:, 1]))
    near = tree.query(points_m, count + 1)[1][:, 1:]
    # Beyond all of its neighbours a point is extrapolated, which says nothing about gaps.
    is_inner = _is_surrounded(points_m, points_m, near)
    inner, outer = np.flatnonzero(is_inner), np.flatnonzero(~is_inner)
    inner = inner if len(inner) >= _FEWEST_TESTED else np.arange(len(points_m))
    inner = inner[spread_indices(len(inner), _MOST_TESTED)]
    known = _Known(points_m, values, sigma, inner, near[inner], scale)
    model = known.refined(max((known.most_likely(power) for power in _POWERS), key=known.likelihood))
    outer_rough = model.rough
    if len(outer) >= _FEWEST_TESTED:
        missed, spread, noise = _estimates(points_m, values, sigma, points_m[outer], near[outer], scale, model)
        own = _roughness(np.square(missed - values[outer]), spread, noise + sigma[outer] ** 2)
        outer_rough = max(outer_rough, own)
    near = tree.query(places_m, count)[1]
    found, spread, noise = _estimates(points_m, values, sigma, places_m, near, scale, model)
    rough = np.where(_is_surrounded(places_m, points_m, near), model.rough, outer_rough)
    return Kriged(found, np.sqrt(rough * spread + noise))


@dataclass(frozen=True, slots=True)
class _Model:
    """Generalised covariance ``rough * r^power``, its sign that of the power; r in distances of the points."""

    power: int
    rough: float

    def of_squares(self, squares: FloatArray) -> FloatArray:
        """Return the generalised covariance at squared distances, for a roughness of 1."""
        root = np.sqrt(squares)
        # Its sign makes it a covariance.
        return -root if self.power == 1 else squares * root if self.power == 3 else -squares * squares * root


def _is_surrounded(places_m: FloatArray, points_m: FloatArray, near: IntArray) -> BoolArray:
    """Return which places (n,) lie within their eight nearest points: these leave no half plane free."""
    off = points_m[near[:, :8]] - places_m[:, None]
    angle = np.sort(np.arctan2(off[..., 1], off[..., 0]), axis=1)
    gaps = np.diff(np.concatenate([angle, angle[:, :1] + 2 * np.pi], axis=1), axis=1)
    return np.asarray(gaps.max(axis=1) < np.pi)


@dataclass(slots=True, eq=False)
class _Known:
    """Points with their values, and those of them that are tested: each is estimated from its neighbours.

    tested (t,), near (t, k): Those, and the points that each is estimated from.
    """

    points_m: FloatArray
    values: FloatArray
    sigma: FloatArray
    tested: IntArray
    near: IntArray
    scale_m: float
    found: dict[tuple[int, float], float] = field(default_factory=dict)

    def likelihood(self, model: _Model) -> float:
        """Return the log likelihood of what the tested points miss by, estimates and their sigmas by the same model."""
        key = model.power, round(float(np.log(model.rough)), 6)
        if key not in self.found:
            missed, spread, noise = _estimates(
                self.points_m, self.values, self.sigma, self.points_m[self.tested], self.near, self.scale_m, model
            )
            variance = model.rough * spread + noise + self.sigma[self.tested] ** 2
            off = np.square(missed - self.values[self.tested])
            self.found[key] = -0.5 * float(np.sum(off / variance + np.log(variance)))
        return self.found[key]

    def most_likely(self, power: int) -> _Model:
        """Return the most likely model of a power, its roughness to a third: the likelihood has one maximum."""
        usual = float(np.var(self.values)) + float(np.mean(self.sigma**2))
        best = start = _Model(power, max(_START * usual, 1e-300))
        for factor in (10.0, 0.1):
            for _ in range(_MOST_DECADES if best is start else 0):
                other = replace(best, rough=factor * best.rough)
                if not self.likelihood(other) > self.likelihood(best) + _LEAST_GAIN:
                    break
                best = other
        return self._vertex(best, 10.0)

    def refined(self, model: _Model) -> _Model:
        """Return the most likely roughness beside that of a model."""
        return self._vertex(model, 2.0)

    def _vertex(self, model: _Model, factor: float) -> _Model:
        """Return the best of a model and the vertex of the parabola through it and those beside it."""
        low, middle, high = (self.likelihood(replace(model, rough=model.rough * factor**k)) for k in (-1, 0, 1))
        bend = 2 * middle - low - high
        if not bend > 0:
            return model
        other = replace(model, rough=model.rough * factor ** float(np.clip(0.5 * (high - low) / bend, -1.0, 1.0)))
        return max(model, other, key=self.likelihood)


def _roughness(off: FloatArray, spread: FloatArray, noise: FloatArray) -> float:
    """Return the factor of the spreads with which the squares, divided by their variances, have the mean 1."""
    high = float(np.sum(off / np.maximum(spread, 1e-12))) + 1e-300
    low = 1e-15 * high
    for _ in range(60):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if np.mean(off / (middle * spread + noise)) > 1.0 else (low, middle)
    return high


def _estimates(
    points_m: FloatArray,
    values: FloatArray,
    sigma: FloatArray,
    places_m: FloatArray,
    near: IntArray,
    scale_m: float,
    model: _Model,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return estimates, the variance of gaps for a roughness of 1, and the variance of noise, each (n,).

    near (n, k): Points that each estimate uses.
    """
    found, spread, noise = (np.empty(len(places_m)) for _ in range(3))
    count = near.shape[1]
    for start in range(0, len(places_m), _BLOCK):
        part = slice(start, start + _BLOCK)
        index = near[part]
        x, y = np.moveaxis((points_m[index] - places_m[part, None]) / scale_m, -1, 0)
        between = model.of_squares(np.square(x[:, :, None] - x[:, None]) + np.square(y[:, :, None] - y[:, None]))
        away = model.of_squares(x * x + y * y)
        drift = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=2)
        terms = drift.shape[2]
        matrix = np.zeros((len(index), count + terms, count + terms))
        matrix[:, :count, :count] = between
        matrix[:, np.arange(count), np.arange(count)] += sigma[index] ** 2 / model.rough
        matrix[:, :count, count:], matrix[:, count:, :count] = drift, np.swapaxes(drift, 1, 2)
        right = np.zeros((len(index), count + terms))
        right[:, :count], right[:, count] = away, 1.0
        weights = np.linalg.solve(matrix, right[..., None])[:, :count, 0]
        found[part] = np.einsum("nk,nk->n", weights, values[index])
        inner = np.einsum("ni,nij,nj->n", weights, between, weights)
        spread[part] = np.maximum(inner - 2 * np.einsum("nk,nk->n", weights, away), 0.0)
        noise[part] = np.einsum("nk,nk->n", weights**2, sigma[index] ** 2)
    return found, spread, noise
