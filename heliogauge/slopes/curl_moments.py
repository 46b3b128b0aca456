"""Smooth curl of a slope map: means over the mirror that are zero for every surface, with their covariance."""

from dataclasses import dataclass

import numpy as np

from heliogauge.slopes.map import CommonModes, SlopeMap, monomials
from heliogauge.validate import BoolArray, FloatArray

#: Degree of the polynomials: shear of the slopes that is the same everywhere, and its change to second order.
_DEGREE = 2
#: Over this share of the mirror's side the weights rise from its edge and from each hole: a step would add noise.
_RISE_SHARE = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class CurlMoments:
    """Weighted means of ``d slope_x / dy - d slope_y / dx`` over a map.

    values_per_m (k,): The means [1/m].
    covariance (k, k): From random and common errors of measurement [1/m^2].
    weights (2, k, n): What a slope in x or y of each valid node adds to each mean [1/m].
    x_m, y_m (n,): Those nodes [m].
    """

    values_per_m: FloatArray
    covariance: FloatArray
    weights: FloatArray
    x_m: FloatArray
    y_m: FloatArray

    @property
    def chi_square(self) -> float:
        """Sum of the squared means over their covariance: k on average for the slopes of a surface."""
        return float(self.values_per_m @ np.linalg.solve(self.covariance, self.values_per_m))

    def of_modes(self, modes: CommonModes) -> FloatArray:
        """Return the same means of smooth slope errors, shape (k, number of modes) [1/m]."""
        along_x, along_y = modes.evaluate(self.x_m, self.y_m).swapaxes(0, 1)
        return np.asarray(self.weights[0] @ along_x.T + self.weights[1] @ along_y.T)


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
    x_m, y_m = np.meshgrid(slope_map.x_m, slope_map.y_m)
    scale = 0.5 * max(float(np.ptp(x_m[valid])), float(np.ptp(y_m[valid])))
    u, v = (x_m - x_m[valid].mean()) / scale, (y_m - y_m[valid].mean()) / scale
    window = _window(complete)
    by_node = monomials(u, v, _DEGREE) * (window / window.sum())
    along_x, along_y = np.zeros_like(by_node), np.zeros_like(by_node)
    # Sums of differences, moved from the slopes to the weights.
    by_y, by_x = (by_node[:, *inner] / (one[2:] - one[:-2])[place] for one, place in _steps(slope_map))
    along_x[:, 2:, 1:-1] += by_y
    along_x[:, :-2, 1:-1] -= by_y
    along_y[:, 1:-1, 2:] -= by_x
    along_y[:, 1:-1, :-2] += by_x
    weights = np.stack([along_x[:, valid], along_y[:, valid]])
    errors = slope_map.slope_error_x[valid], slope_map.slope_error_y[valid]
    sigmas = slope_map.sigma_random_x[valid], slope_map.sigma_random_y[valid]
    values = sum((w @ error for w, error in zip(weights, errors, strict=True)), np.zeros(len(by_node)))
    random = sum(((w * s**2) @ w.T for w, s in zip(weights, sigmas, strict=True)), np.zeros((len(by_node),) * 2))
    found = CurlMoments(values, slope_map.noise_correlation * random, weights, x_m[valid], y_m[valid])
    modes = found.of_modes(slope_map.common)
    return CurlMoments(values, found.covariance + modes @ modes.T, weights, found.x_m, found.y_m)


def _steps(slope_map: SlopeMap) -> tuple[tuple[FloatArray, tuple[slice | None, ...]], ...]:
    """Return rows and columns of the grid, and how their differences stand beside nodes (k, ny, nx)."""
    return (slope_map.y_m, (slice(None), None)), (slope_map.x_m, (None, slice(None)))


def _window(complete: BoolArray) -> FloatArray:
    """Return weights that rise smoothly from 0 at the edge of what is measured to 1."""
    from scipy.ndimage import distance_transform_edt

    away = np.asarray(distance_transform_edt(np.pad(complete, 1)))[1:-1, 1:-1]
    share = np.minimum(away / (_RISE_SHARE * np.sqrt(np.count_nonzero(complete))), 1.0)
    return np.asarray(share**2 * (3 - 2 * share))
