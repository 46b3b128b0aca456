"""Sub-pixel corners of chessboard squares: a least-squares fit of two blurred edges that cross, all corners at once."""

from dataclasses import dataclass

import numpy as np

from heliogauge.adjust.small_fits import Descent, SmallFits, descend
from heliogauge.validate import BoolArray, FloatArray, IntArray, freeze

#: Parameters of the model: corner, directions of both edges, blur, level, contrast, shading.
_N_PARAMETERS = 9
_DESCENT = Descent(most_steps=25, first=1e-6, down=0.1, up=100.0, rise=1e-9, ridge=1e-9)
#: A ten-thousandth of a pixel is a hundredth of the noise of the best corner here.
_ENOUGH_PX = 1e-4
#: First the corner itself, so that few steps are made with all of its edges: 0.6 of the time.
_FIRST_PX, _FIRST_ENOUGH_PX = 9.0, 1e-2
#: Variance of a pixel's own square, which the blur of the model contains.
_PIXEL_VARIANCE = 1 / 12
#: Edges are used over this many pixels to each side at most: print and lens are straight so far, and time counts.
_LONGEST_PX = 20.0
#: Shorter edges than this are blur from end to end.
_SHORTEST_PX = 2.0
#: At a time; 64 windows of 31 x 31 px with their derivatives are 4 MB.
_BLOCK = 6


@dataclass(frozen=True, slots=True, eq=False)
class FittedCorners:
    """Corners of squares.

    pixels_px (n, 2): Corners (x, y); NaN where the fit failed [px].
    covariance_px2 (n, 2, 2): Their covariances from the residuals of the pixels [px^2].
    blur_px (n,): Width of the edges as a standard deviation, without the pixel's own [px].
    contrast_dn (n,): Light minus dark; negative where the square left above is light [DN].
    residual_dn (n,): Rms of what the model leaves [DN].
    """

    pixels_px: FloatArray
    covariance_px2: FloatArray
    blur_px: FloatArray
    contrast_dn: FloatArray
    residual_dn: FloatArray

    @property
    def found(self) -> BoolArray:
        """True where the fit succeeded, shape (n,)."""
        return np.asarray(np.isfinite(self.pixels_px[:, 0]))


@dataclass(frozen=True, slots=True, eq=False)
class CornerStart:
    """Where corners are roughly, and how the edges run there.

    pixels_px (n, 2): Corners to about a pixel [px].
    along_x, along_y (n, 2): Side of a square along both edges, in the image [px].
    curvature_per_px (n, 2): Curvature of both edges, towards the normal that is a right angle from the side [1/px].
    """

    pixels_px: FloatArray
    along_x: FloatArray
    along_y: FloatArray
    curvature_per_px: FloatArray

    def chosen(self, which: IntArray | BoolArray) -> "CornerStart":
        """Return some of the corners."""
        return CornerStart(
            self.pixels_px[which], self.along_x[which], self.along_y[which], self.curvature_per_px[which]
        )


def fit_corners(
    image_dn: FloatArray, start: CornerStart, *, reach: float = 0.42, clear: float = np.inf, rough: bool = False
) -> FittedCorners:
    """Fit corners where four squares meet.

    image_dn (height, width): Grey values [DN].
    start: Rough corners and sides.
    reach: Half size of the piece of the image used, as a share of the squares' sides, but 20 px at most.
    clear: Pixels farther than this share of a side from both edges are left out: a ChArUco board has markers there.
    rough: Use 9 px of the edges and stop at a hundredth of a pixel: a quarter of the time, to start a second fit
        from.
    Returns: The corners; a fit that runs away, sees no contrast or touches the image's border gives NaN.

    Model ``g = level + gx u + gy v + contrast / 2 * E(d1 / s) E(d2 / s)`` with (u, v) measured from the corner, d1
    and d2 the signed distances from both edges and ``E(z) = erf(z / sqrt 2)``: what two edges, blurred by a Gaussian
    that contains the pixel's square (s^2 = blur^2 + 1/12 px^2), leave in each pixel. It differs from the exact
    integral within a blur of the corner itself only, where by symmetry it cannot shift the corner. Edges are
    parabolas of given curvature: the lens bends them by 6e-5 1/px at the border of a usual image, which would shift a
    corner fitted with straight edges over 25 px to both sides by 0.006 px.
    """
    count = len(start.pixels_px)
    found = FittedCorners(
        np.full((count, 2), np.nan), np.full((count, 2, 2), np.nan), *(np.full(count, np.nan) for _ in range(3))
    )
    height, width = image_dn.shape
    sides = np.stack([start.along_x, start.along_y], axis=1)
    longest_px, enough_px = (_FIRST_PX, _FIRST_ENOUGH_PX) if rough else (_LONGEST_PX, _ENOUGH_PX)
    share = np.minimum(reach, longest_px / np.maximum(np.linalg.norm(sides, axis=2), 1e-9))
    half = np.ceil((share[:, :, None] * np.abs(sides)).sum(axis=1)).astype(int)
    middle = np.rint(start.pixels_px).astype(int)
    inside = (middle - half >= 0).all(axis=1) & (middle + half < [width, height]).all(axis=1)
    shorter = (share * np.linalg.norm(sides, axis=2)).min(axis=1)
    usable = np.nonzero(inside & (shorter >= _SHORTEST_PX))[0]
    # Windows of nearly one size share a block.
    order = usable[np.argsort(half[usable].max(axis=1), kind="stable")]
    for first in range(0, order.size, _BLOCK):
        chosen = order[first : first + _BLOCK]
        reach_of_block = int(half[chosen].max())
        _fit_block(image_dn, start.chosen(chosen), share[chosen], reach_of_block, clear, enough_px, chosen, found)
    for array in (found.pixels_px, found.covariance_px2, found.blur_px, found.contrast_dn, found.residual_dn):
        freeze(array)
    return found


def _fit_block(
    image_dn: FloatArray,
    start: CornerStart,
    share: FloatArray,
    half: int,
    clear: float,
    enough_px: float,
    chosen: IntArray,
    found: FittedCorners,
) -> None:
    middle = np.rint(start.pixels_px).astype(int)
    v, u = (grid.ravel().astype(np.float64) for grid in np.mgrid[-half : half + 1, -half : half + 1])
    rows = np.clip(middle[:, 1:] + v.astype(int), 0, image_dn.shape[0] - 1)
    columns = np.clip(middle[:, :1] + u.astype(int), 0, image_dn.shape[1] - 1)
    values = np.asarray(image_dn[rows, columns], dtype=np.float64)
    # Pixels within the parallelogram that both sides span, with a soft margin of one pixel so that none jumps in.
    frame = np.linalg.inv(np.stack([start.along_x, start.along_y], axis=2))
    off = start.pixels_px - middle
    place = np.abs(frame @ np.stack([u - off[:, :1], v - off[:, 1:]], axis=1))
    per_px = 1 / np.linalg.norm(frame, axis=2)[:, :, None]
    margin = ((share[:, :, None] - place) * per_px).min(axis=1)
    if np.isfinite(clear):
        margin = np.minimum(margin, ((clear - place) * per_px).max(axis=1))
    weights = np.clip(margin, 0.0, 1.0)
    pixels = (u, v, start.curvature_per_px)
    parameters = _start(values, weights, (off, start.along_x, start.along_y), pixels)
    fits = _adjust(values, weights, parameters, pixels, enough_px)
    parameters, good = fits.parameters, fits.settled.copy()
    used = weights.sum(axis=1)
    variance = (weights * fits.residuals**2).sum(axis=1) / np.maximum(used - _N_PARAMETERS, 1.0)
    covariance = _corner_covariance(fits.jacobian, weights, variance)
    contrast = parameters[:, 6]
    moved = np.abs(parameters[:, :2] - off).max(axis=1)
    good &= (moved < 0.2 * np.linalg.norm(start.along_x, axis=1) + 1) & (np.sqrt(variance) < 0.25 * np.abs(contrast))
    good &= np.isfinite(covariance).all(axis=(1, 2)) & (parameters[:, 4] > 0.1)
    place_of = chosen[good]
    found.pixels_px[place_of] = (middle + parameters[:, :2])[good]
    found.covariance_px2[place_of] = covariance[good]
    found.blur_px[place_of] = np.sqrt(np.maximum(parameters[good, 4] ** 2 - _PIXEL_VARIANCE, 0.0))
    found.contrast_dn[place_of] = contrast[good]
    found.residual_dn[place_of] = np.sqrt(variance[good])


def _start(
    values: FloatArray, weights: FloatArray, geometry: tuple[FloatArray, ...], pixels: tuple[FloatArray, ...]
) -> FloatArray:
    off, along_x, along_y = geometry
    parameters = np.zeros((len(values), _N_PARAMETERS))
    parameters[:, :2] = off
    # Normals of the edges: turned by a right angle from their directions.
    parameters[:, 2] = np.arctan2(along_x[:, 0], -along_x[:, 1])
    parameters[:, 3] = np.arctan2(along_y[:, 0], -along_y[:, 1])
    parameters[:, 4] = 0.8
    parameters[:, 6] = 1.0
    shape = _model(parameters, *pixels)[0]
    total = weights.sum(axis=1)
    level, mean = (weights * values).sum(axis=1) / total, (weights * shape).sum(axis=1) / total
    spread = (weights * (shape - mean[:, None]) ** 2).sum(axis=1)
    both = (weights * (shape - mean[:, None]) * (values - level[:, None])).sum(axis=1)
    parameters[:, 6] = both / np.maximum(spread, 1e-12)
    parameters[:, 5] = level - parameters[:, 6] * mean
    return parameters


def _model(
    parameters: FloatArray, u: FloatArray, v: FloatArray, curvature: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return grey values, shape (n, m), and derivatives, shape (n, 9, m); the bending's are left out (1 % of them)."""
    from scipy.special import erf

    x, y, first, second, s, level, contrast, slope_x, slope_y = (parameters[:, k, None] for k in range(_N_PARAMETERS))
    du, dv = u - x, v - y
    jacobian = np.empty((len(parameters), _N_PARAMETERS, u.size))
    edges, bells, distances, turns = [], [], [], []
    for angle, bent in ((first, curvature[:, :1]), (second, curvature[:, 1:])):
        cosine, sine = np.cos(angle), np.sin(angle)
        distance = (cosine * du + sine * dv - 0.5 * bent * (cosine * dv - sine * du) ** 2) / s
        edges.append(erf(distance * np.sqrt(0.5)))
        bells.append(np.sqrt(2 / np.pi) * np.exp(-0.5 * distance**2) / s)
        distances.append(distance)
        turns.append((cosine, sine, cosine * dv - sine * du))
    half = 0.5 * contrast
    one, two = half * bells[0] * edges[1], half * bells[1] * edges[0]
    jacobian[:, 0] = -one * turns[0][0] - two * turns[1][0]
    jacobian[:, 1] = -one * turns[0][1] - two * turns[1][1]
    jacobian[:, 2], jacobian[:, 3] = one * turns[0][2], two * turns[1][2]
    jacobian[:, 4] = -one * distances[0] - two * distances[1]
    jacobian[:, 5] = 1.0
    jacobian[:, 6] = 0.5 * edges[0] * edges[1]
    jacobian[:, 7], jacobian[:, 8] = du, dv
    # The corner moves with its shading's origin; that is a change of the level only.
    jacobian[:, 0] -= slope_x
    jacobian[:, 1] -= slope_y
    values = level + slope_x * du + slope_y * dv + contrast * jacobian[:, 6]
    return values, jacobian


def _adjust(
    values: FloatArray, weights: FloatArray, parameters: FloatArray, pixels: tuple[FloatArray, ...], enough_px: float
) -> SmallFits:
    """Fit all windows together."""
    u, v, curvature = pixels

    def evaluate(rows: IntArray, trial: FloatArray) -> tuple[FloatArray, FloatArray]:
        model, jacobian = _model(trial, u, v, curvature[rows])
        return values[rows] - model, jacobian

    def allow(rows: IntArray, trial: FloatArray) -> BoolArray:
        trial[:, 4] = np.clip(trial[:, 4], 0.05, 8.0)
        return np.ones(len(trial), dtype=np.bool_)

    every = np.arange(len(values))
    residuals, jacobian = evaluate(every, parameters)
    nothing = np.zeros_like(parameters)
    done = np.zeros(len(values), dtype=np.bool_)
    fits = SmallFits(parameters.copy(), residuals, jacobian, np.sqrt(weights), nothing, nothing, done)
    descend(fits, every, evaluate, lambda step: np.abs(step[:, :2]).max(axis=1) < enough_px, _DESCENT, allow)
    return fits


def _corner_covariance(jacobian: FloatArray, weights: FloatArray, variance: FloatArray) -> FloatArray:
    weighted = jacobian * weights[:, None]
    normal = weighted @ np.swapaxes(jacobian, 1, 2)
    normal += 1e-12 * np.einsum("nii->n", normal)[:, None, None] * np.eye(_N_PARAMETERS)
    inverse = np.linalg.inv(normal)
    spread = weighted @ np.swapaxes(weighted, 1, 2)
    block = (inverse @ spread @ inverse)[:, :2, :2] * variance[:, None, None]
    return np.asarray(0.5 * (block + np.swapaxes(block, 1, 2)))
