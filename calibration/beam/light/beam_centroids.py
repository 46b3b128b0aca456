"""Centroids of a beam by four methods, each with its influence function, so that one noise model gives all sigmas."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from calibration.beam.light.background import area_resized
from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.adjust.small_fits import Descent, SmallFits, descend
from heliogauge.errors import EstimationError
from heliogauge.validate import BoolArray, Float32Array, FloatArray, IntArray, freeze

__all__ = [
    "CENTROID_METHODS",
    "Bell",
    "Centroid",
    "PixelNoise",
    "Spot",
    "bell_again",
    "bell_curvature",
    "bell_model",
    "block_sums",
    "coarse_shape",
    "gaussian_centroid",
    "intensity_centroid",
    "pixel_noise",
    "propagated",
    "super_gaussian_centroid",
    "threshold_centroid",
]

#: Names of the methods; the first is the recommended one.
CENTROID_METHODS = ("intensity", "threshold", "gaussian", "super_gaussian")
_THRESHOLD = 0.5
#: Fits run on a picture of at most this many pixels on the longer side: a beam is many of them wide.
_FIT_PX = 64
_DESCENT = Descent(most_steps=60, first=1e-3, down=1 / 8, up=8.0, most=1e12, ridge=1e-300)
#: A centre that moves less has its place [px of that picture]: what is left to go is a tenth of it, 2e-7 of the target.
_LAST_STEP_PX = 1e-4
#: The same for height, quadratic form and exponent, as a share of them.
_LAST_SHARE = 1e-3
_LEAST_EXPONENT, _MOST_EXPONENT = 0.4, 6.0
#: Blocks of the target across its longer side, in each of which an error of the background is taken as constant: from
#: panels to shadows. The scale with the largest effect counts. Without the widest, beams on drawn panels of 2 m were 3
#: sigma off (RMS).
_BLOCKS = (16, 8, 5, 4)
#: Scatter of even daylight about its functions, as a share: 0.1 to 0.2 % on drawn even targets. What is more is panels.
_DAYLIGHT_SHARE = 0.003
#: Second differences whose median tells which of them are noise and which are seams: to 1 % in its sigma.
_ENOUGH_DIFFERENCES = 8000
# Second difference in both directions; its variance is 36 times that of a pixel, and planes and parabolas vanish.
_NOISE_KERNEL = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]]) / 6.0


class _Pixels(NamedTuple):
    """Columns, rows and values of all pixels of the coarse grid, flat; which of them count."""

    x: FloatArray
    y: FloatArray
    values_dn: FloatArray
    counted: BoolArray

    @property
    def counted_pixels(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Columns, rows and values of those that count."""
        return self.x[self.counted], self.y[self.counted], self.values_dn[self.counted]


class _Descended(NamedTuple):
    """Parameters with the least squares, and the derivatives of the residuals by the free ones there."""

    parameters: FloatArray
    jacobian: FloatArray


@dataclass(frozen=True, eq=False)
class Spot:
    """A beam whose background was subtracted.

    values_dn (h, w): Brightness [DN].
    smoothed_dn (h, w): The same, smoothed: it chooses pixels, so that noise does not choose [DN].
    inside (h, w): The beam.
    usable (h, w): Pixels that show the target and no other beam.
    peak_dn: Largest smoothed value [DN].
    outline_dn: Smoothed value on the beam's outline [DN].
    smoothing_px: Standard deviation of the Gaussian that smoothed [px].
    """

    values_dn: FloatArray
    smoothed_dn: FloatArray
    inside: BoolArray
    usable: BoolArray
    peak_dn: float
    outline_dn: float
    smoothing_px: float

    @cached_property
    def _pixels(self) -> _Pixels:
        """The pixels that bells are fitted to."""
        shape = coarse_shape(self.values_dn.shape)
        counted = (area_resized(self.usable.astype(np.float32), shape) > 0.99).ravel()
        x, y = np.meshgrid(np.arange(shape[1], dtype=np.float64), np.arange(shape[0], dtype=np.float64))
        return _Pixels(x.ravel(), y.ravel(), area_resized(self.values_dn, shape).ravel(), counted)

    @cached_property
    def _gaussian(self) -> _Descended:
        """The Gaussian that fits best; the super-Gaussian starts from it.

        EstimationError: The fit does not converge.
        """
        start = _start(self, coarse_shape(self.values_dn.shape))
        return _descend(start, np.array([True] * 6 + [False]), self._pixels.counted_pixels)


@dataclass(frozen=True, slots=True, eq=False)
class Bell:
    """An elliptic super-Gaussian.

    parameters (7,): Height, centre, quadratic form, exponent.
    values_dn (h, w): It, on the grid of `coarse_shape` [DN].
    """

    parameters: FloatArray
    values_dn: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Centroid:
    """A position and how it depends on every pixel.

    position_px (2,): Column and row [px].
    influence (2, h, w): Derivative of the position by each pixel's value, on the grid of `coarse_shape` [px/DN].
    exponent: Exponent of the super-Gaussian; NaN for other methods.
    bell: The bell that was fitted; None for other methods.
    """

    position_px: FloatArray
    influence: FloatArray
    exponent: float = float("nan")
    bell: Bell | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PixelNoise:
    """Errors of a picture minus its background.

    white_dn2 (h, w): Variance of each pixel, independent of its neighbours [DN^2].
    block_dn2: Variance of the background's error, alike within a block, for each of several sizes of blocks [DN^2].
    basis (hc, wc, k): Functions of the smooth background, on a coarser grid that covers the same target.
    coefficients (k, k): Covariance of their coefficients.
    """

    white_dn2: FloatArray
    block_dn2: tuple[float, ...]
    basis: FloatArray
    coefficients: FloatArray


def intensity_centroid(spot: Spot) -> Centroid:
    """Return the centre of the light inside the beam's outline.

    Returns: ``sum(x B)/sum(B)`` over the pixels inside.
    EstimationError: The light inside does not add up to a positive sum.
    """
    return _weighted(spot, spot.outline_dn, 0.5 * spot.outline_dn)


def threshold_centroid(spot: Spot) -> Centroid:
    """Return the centre of the light of the pixels above half the peak.

    Returns: ``sum(x B)/sum(B)`` over pixels whose smoothed brightness above the background is more than half the
        peak's, B their brightness above it; a ramp of a tenth of the peak takes the place of the sharp level. Malan
        (2014, eq. 5.4) weighs alike, but above a level halfway from the picture's mean to its brightest pixel (5.3),
        which moves with how much of the target the picture shows, and without taking a background off.
    EstimationError: The light does not add up to a positive sum.
    """
    return _weighted(spot, _THRESHOLD * spot.peak_dn, 0.1 * spot.peak_dn)


def gaussian_centroid(spot: Spot) -> Centroid:
    """Return the centre of the elliptic Gaussian that fits best.

    Returns: Centre of ``A exp(-q/2)``, q a quadratic form about it.
    EstimationError: The fit does not converge on the target.
    """
    return _fitted(spot, free_exponent=False)


def super_gaussian_centroid(spot: Spot) -> Centroid:
    """Return the centre of the elliptic super-Gaussian that fits best.

    Returns: Centre of ``A exp(-q^n/2)``; n = 1 is a Gaussian, more is flat-topped, less is peaked with wide skirts.
    EstimationError: The fit does not converge on the target.
    """
    return _fitted(spot, free_exponent=True)


def bell_again(spot: Spot, before: Bell) -> Bell:
    """Fit the super-Gaussian to a picture that hardly differs from one that it was fitted to.

    before: That one's.
    EstimationError: The fit does not converge.
    """
    pixels = spot._pixels
    found = _descend(before.parameters, np.ones(7, dtype=np.bool_), pixels.counted_pixels).parameters
    return Bell(found, _values(found, pixels.x, pixels.y).reshape(before.values_dn.shape))


def _weighted(spot: Spot, level_dn: float, ramp_dn: float) -> Centroid:
    """Centre of the light above a level of the smoothed picture, which a ramp makes a function of the pixels.

    With a sharp level, noise moves the outline by whole pixels and the influence would lack the outline's own part.
    """
    near = cv2.dilate(spot.inside.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    chosen = (spot.smoothed_dn - level_dn) * (1 / max(ramp_dn, 1e-300))
    chosen += 0.5
    np.clip(chosen, 0.0, 1.0, out=chosen)
    chosen *= near
    light = chosen * spot.values_dn
    rows, columns = light.sum(axis=1), light.sum(axis=0)
    total = float(rows.sum())
    if not total > 0:
        raise EstimationError(f"the light of the beam adds up to {total:.4g} DN: there is no centroid")
    x, y = np.arange(columns.size), np.arange(rows.size)
    center = np.array([columns @ x, rows @ y]) / total
    shape = coarse_shape(spot.values_dn.shape)
    parts = _arms(chosen, center, shape) / total
    # The outline's own part, which the smoothing spreads; over blocks as wide as that, sums come first.
    sigma = [max(spot.smoothing_px * n / size, 1e-3) for n, size in zip(shape, chosen.shape, strict=True)]
    outline = _arms(np.where((chosen > 0) & (chosen < 1), spot.values_dn, 0.0), center, shape) / (ramp_dn * total)
    for part, own in zip(parts, outline, strict=True):
        part += cv2.GaussianBlur(own, (0, 0), sigma[1], sigmaY=sigma[0])
    return Centroid(center, parts)


def _arms(weights: FloatArray, center_px: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Add up weights times their distances from a centre in columns and rows, in blocks of the picture, (2, h, w)."""
    x, y = (np.arange(pixels) - middle for pixels, middle in zip(weights.shape[::-1], center_px, strict=True))
    count = weights.size / (shape[0] * shape[1])
    return count * np.stack([area_resized(weights * arm, shape) for arm in (x[None, :], y[:, None])])


# --- fits -----------------------------------------------------------------------------------------------------------


def coarse_shape(shape: tuple[int, ...]) -> tuple[int, int]:
    """Return rows and columns of the grid on which a beam is fitted, and influences vary little from pixel to pixel."""
    scale = max(1.0, max(shape) / _FIT_PX)
    return max(4, round(shape[0] / scale)), max(4, round(shape[1] / scale))


def _fitted(spot: Spot, *, free_exponent: bool) -> Centroid:
    height, width = spot.values_dn.shape
    shape = coarse_shape(spot.values_dn.shape)
    stretch = np.array([width / shape[1], height / shape[0]])
    pixels = spot._pixels
    found, jacobian = _super_gaussian(spot) if free_exponent else spot._gaussian
    if not (-0.5 <= found[1] <= shape[1] - 0.5 and -0.5 <= found[2] <= shape[0] - 0.5):
        raise EstimationError("the fitted beam's centre is not on the target")
    influence = np.zeros((2, pixels.x.size))
    influence[:, pixels.counted] = _center_derivative(found, pixels.counted_pixels, jacobian)
    # Pixel centres of the coarser picture: outlines of both pictures coincide.
    position = (found[1:3] + 0.5) * stretch - 0.5
    bell = Bell(found, _values(found, pixels.x, pixels.y).reshape(shape))
    exponent = float(found[6]) if free_exponent else float("nan")
    return Centroid(position, influence.reshape(2, *shape) * stretch[:, None, None], exponent, bell)


def _super_gaussian(spot: Spot) -> _Descended:
    try:
        start = spot._gaussian.parameters
    except EstimationError:
        start = _start(spot, coarse_shape(spot.values_dn.shape))
    return _descend(start, np.ones(7, dtype=np.bool_), spot._pixels.counted_pixels)


def _start(spot: Spot, shape: tuple[int, int]) -> FloatArray:
    light = np.maximum(area_resized(np.where(spot.inside, spot.smoothed_dn, 0.0), shape), 0.0)
    total = float(light.sum())
    if not total > 0:
        raise EstimationError("there is no light in the beam's outline")
    x, y = np.arange(shape[1]), np.arange(shape[0])
    columns, rows = light.sum(axis=0) / total, light.sum(axis=1) / total
    center_x, center_y = float(columns @ x), float(rows @ y)
    cross = float((y - center_y) @ light @ (x - center_x)) / total
    spread = np.array([[columns @ (x - center_x) ** 2, cross], [cross, rows @ (y - center_y) ** 2]])
    form = np.linalg.inv(spread + 0.1 * np.eye(2))
    return np.array([spot.peak_dn, center_x, center_y, form[0, 0], form[0, 1], form[1, 1], 1.0])


def _quadratic_form(parameters: FloatArray, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the quadratic form, and half its derivatives by the centre with the sign turned."""
    _, center_x, center_y, xx, xy, yy, _ = parameters
    dx, dy = x - center_x, y - center_y
    along, down = xx * dx + xy * dy, xy * dx + yy * dy
    return np.maximum(along * dx + down * dy, 1e-12), along, down


def _values(parameters: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Super-Gaussian: height, centre, quadratic form (xx, xy, yy), exponent."""
    form, _, _ = _quadratic_form(parameters, x, y)
    return np.asarray(parameters[0] * np.exp(-0.5 * form ** parameters[6]))


def bell_model(
    parameters: FloatArray, x: FloatArray, y: FloatArray, *, free_exponent: bool
) -> tuple[FloatArray, FloatArray]:
    """Values of a super-Gaussian, (m,), and derivatives by its parameters, (7, m); (6, m) without the exponent's."""
    height, center_x, center_y, _, _, _, exponent = parameters
    form, along, down = _quadratic_form(parameters, x, y)
    logarithm = np.log(form) if free_exponent else None
    power = form**exponent if logarithm is None else np.exp(exponent * logarithm)
    derivatives = np.empty((7 if free_exponent else 6, x.size))
    bell = np.exp(-0.5 * power, out=derivatives[0])
    values = height * bell
    power *= values
    d_form = power / form
    d_form *= -0.5 * exponent
    dx, dy = x - center_x, y - center_y
    twice = -2 * d_form
    np.multiply(twice, along, out=derivatives[1])
    np.multiply(twice, down, out=derivatives[2])
    across = np.multiply(d_form, dx, out=twice)
    np.multiply(across, dx, out=derivatives[3])
    np.multiply(across, dy, out=derivatives[4])
    derivatives[4] *= 2
    np.multiply(d_form, dy * dy, out=derivatives[5])
    if logarithm is not None:
        np.multiply(power, logarithm, out=derivatives[6])
        derivatives[6] *= -0.5
    return values, derivatives


def _possible(p: FloatArray) -> bool:
    positive = p[0] > 0 and p[3] > 0 and p[3] * p[5] > p[4] ** 2
    return bool(positive and _LEAST_EXPONENT <= p[6] <= _MOST_EXPONENT)


def _descend(start: FloatArray, free: BoolArray, pixels: tuple[FloatArray, FloatArray, FloatArray]) -> _Descended:
    """Minimise the squares (Levenberg-Marquardt)."""
    x, y, wanted = pixels

    def at(values: FloatArray) -> FloatArray:
        whole = start.copy()
        whole[free] = values
        return whole

    def evaluate(rows: IntArray, trial: FloatArray) -> tuple[FloatArray, FloatArray]:
        if not rows.size:
            return np.empty((0, x.size)), np.empty((0, trial.shape[1], x.size))
        values, jacobian = bell_model(at(trial[0]), x, y, free_exponent=bool(free[6]))
        return (wanted - values)[None], jacobian[None]

    one, first = np.arange(1), start[free][None]
    form = np.sqrt(start[3] * start[5])
    last = np.array([_LAST_SHARE * start[0], *2 * [_LAST_STEP_PX], *3 * [_LAST_SHARE * form], _LAST_SHARE])[free]
    residuals, jacobian = evaluate(one, first)
    fit = SmallFits(
        first.copy(),
        residuals,
        jacobian,
        np.ones_like(residuals),
        np.zeros_like(first),
        np.zeros_like(first),
        np.zeros(1, dtype=np.bool_),
    )
    descend(
        fit,
        one,
        evaluate,
        lambda step: np.asarray((np.abs(step) < last).all(axis=1)),
        _DESCENT,
        lambda rows, trial: np.array([_possible(at(trial[0]))]),
    )
    if not fit.settled[0]:
        raise EstimationError(f"the fit of the beam did not converge in {_DESCENT.most_steps} steps")
    return _Descended(at(fit.parameters[0]), fit.jacobian[0])


def _center_derivative(
    found: FloatArray, pixels: tuple[FloatArray, FloatArray, FloatArray], jacobian: FloatArray
) -> FloatArray:
    """Implicit derivative at the minimum, with the true Hessian: a beam is no Gaussian, so residuals are not noise.

    jacobian (p, m): Derivatives by the free parameters there.
    """
    hessian = jacobian @ jacobian.T - bell_curvature(found, pixels, jacobian)[: len(jacobian), : len(jacobian)]
    scale = np.sqrt(np.abs(np.diag(hessian))) + 1e-300
    inverse = np.linalg.inv(hessian / scale[:, None] / scale) / scale[:, None] / scale
    return np.asarray(inverse[1:3] @ jacobian)


def bell_curvature(
    found: FloatArray, pixels: tuple[FloatArray, FloatArray, FloatArray], jacobian: FloatArray
) -> FloatArray:
    """Return the second derivatives of the model by its parameters, times the residuals, added up, shape (7, 7)."""
    x, y, wanted = pixels
    height, center_x, center_y, xx, xy, yy, exponent = found
    form, along, down = _quadratic_form(found, x, y)
    dx, dy = x - center_x, y - center_y
    logarithm = np.log(form)
    power = np.exp(exponent * logarithm)
    values = height * jacobian[0]
    left = (wanted - values) * values
    # By the form's own parameters, with v the values, q the form, n the exponent, p = q^n:
    # v_ab = v [n^2 p^2 / 4 - n (n - 1) p / 2] / q^2 q_a q_b - v n p / (2 q) q_ab.
    single = left * power / form * (-0.5 * exponent)
    double = single / form * (exponent - 1 - 0.5 * exponent * power)
    by_form = np.stack([-2 * along, -2 * down, dx * dx, 2 * dx * dy, dy * dy])
    sums = np.zeros((7, 7))
    sums[1:6, 1:6] = (by_form * double) @ by_form.T
    total, sum_x, sum_y = float(single.sum()), float(single @ dx), float(single @ dy)
    twice = np.zeros((5, 5))
    twice[0, 0], twice[0, 1], twice[1, 1] = xx * total, 2 * xy * total, yy * total
    twice[0, 2:4], twice[1, 3:5] = (-2 * sum_x, -2 * sum_y), (-2 * sum_x, -2 * sum_y)
    sums[1:6, 1:6] += twice + twice.T
    sums[0, 1:6] = by_form @ single / height
    by_exponent = left * power * logarithm * -0.5
    sums[0, 6] = float(by_exponent.sum()) / height
    sums[1:6, 6] = by_form @ (single * (1 / exponent + logarithm * (1 - 0.5 * power)))
    sums[6, 6] = float(by_exponent @ (logarithm * (1 - 0.5 * power)))
    sums[1:, 0], sums[6, 1:6] = sums[0, 1:], sums[1:6, 6]
    return sums


# --- noise ----------------------------------------------------------------------------------------------------------


def pixel_noise(
    values_dn: FloatArray, inside: BoolArray, free: BoolArray, background: tuple[FloatArray, FloatArray, FloatArray]
) -> PixelNoise:
    """Estimate the errors of a picture minus its background from the picture.

    Shapes: values_dn (h, w), inside (h, w).
    free (h, w): Pixels without a beam.
    background: Basis (hc, wc, k), cofactor (k, k), and residuals (hc, wc) of the smooth background; 0 where not
        free [DN].
    Returns: White noise in the beam and beside it; what the background's residuals have beyond white noise.

    White noise follows from second differences (Immerkaer 1996) through their median, so that seams do not count. The
    background's error is the scatter of the residuals' means in blocks of the target.
    """
    filtered = cv2.filter2D(values_dn.astype(np.float32), cv2.CV_32F, _NOISE_KERNEL, borderType=cv2.BORDER_REFLECT)
    difference = np.asarray(filtered, dtype=np.float32)
    outside = _robust_variance(difference[free])
    beam = max(outside, _robust_variance(difference[inside]))
    white = np.where(inside, beam, outside)
    basis, cofactor, residuals = background
    # Pixels of the coarse grid are averages of finer ones.
    finer = values_dn.size / residuals.size
    excesses, correlated = [], 0.0
    daylight = (_DAYLIGHT_SHARE * float(np.median(values_dn[free]))) ** 2 if free.any() else 0.0
    for blocks in _BLOCKS:
        block, count, n = _block_variance(residuals, blocks)
        random = outside / finer / count
        # Panels: blocks that the smooth functions follow say nothing; with fewer than two to spare nothing is known.
        spare = max(n - basis.shape[2], 2)
        panels = block * n / spare - random * (1 + 2 * np.sqrt(2 / spare)) - daylight
        # White noise alone exceeds its mean in the largest of the scales; only what is beyond counts.
        excess = max(0.0, block - random * (1 + 2 * np.sqrt(2 / max(n, 1))), panels)
        excesses.append(excess)
        correlated = max(correlated, excess * count)
    # No finer than the influences that it is added up with.
    fits = coarse_shape(values_dn.shape)
    basis = _resized_functions(basis, (min(fits[0], basis.shape[0]), min(fits[1], basis.shape[1])))
    return PixelNoise(white, tuple(excesses), basis, cofactor * (outside / finer + correlated))


def _robust_variance(differences: Float32Array) -> float:
    if differences.size < 10:
        return 0.0
    scale = robust_scale(differences[:: (differences.size // _ENOUGH_DIFFERENCES) | 1])
    squares = differences * differences
    near = squares < np.float32(16 * scale * scale)
    count = np.count_nonzero(near)
    # Grey values are whole numbers: a median of few distinct values is coarse, so the mean square of what is near it.
    return float(squares @ near.astype(np.float32)) / count if count else scale**2


def _block_shape(shape: tuple[int, ...], blocks: int) -> tuple[int, int]:
    side = max(shape) / blocks
    return max(1, round(shape[0] / side)), max(1, round(shape[1] / side))


class _Blocks(NamedTuple):
    """Variance of the means of blocks, pixels in each, number of blocks."""

    variance: float
    pixels: float
    blocks: int


def _block_variance(residuals: FloatArray, blocks: int) -> _Blocks:
    shape = _block_shape(residuals.shape, blocks)
    share = area_resized((residuals != 0).astype(np.float32), shape)
    means = area_resized(residuals, shape)[share > 0.7] / share[share > 0.7]
    count = residuals.size / (shape[0] * shape[1])
    return _Blocks(float(np.mean((means if means.size else residuals) ** 2)), count, means.size)


class Propagated(NamedTuple):
    """Covariance of quantities, (k, k): of what is sure, and of the background's error by each size of its blocks."""

    covariance: FloatArray
    by_blocks: list[FloatArray]

    def of(self, chosen: slice) -> FloatArray:
        """Return the covariance of some quantities of one unit, with the blocks that have the largest effect on it."""
        largest = max((one[chosen, chosen] for one in self.by_blocks), key=np.trace)
        return np.asarray(self.covariance[chosen, chosen] + largest)


def propagated(influence: FloatArray, noise: PixelNoise) -> Propagated:
    """Propagate the errors of the pixels into the covariance of quantities.

    influence (k, h, w): Derivative of each quantity by each pixel's value, on a grid that covers the same target.
    """
    shape = (influence.shape[1], influence.shape[2])
    finer = noise.white_dn2.size / (shape[0] * shape[1])
    white = area_resized(noise.white_dn2, shape) / finer
    flat = influence.reshape(len(influence), -1)
    covariance = (flat * white.ravel()) @ flat.T
    coarse = noise.basis.shape[:2]
    least = (min(coarse[0], shape[0]), min(coarse[1], shape[1]))
    basis = _resized_functions(noise.basis, least).reshape(-1, noise.basis.shape[2])
    pull = (flat if least == shape else _sums(influence, least)) @ basis
    return Propagated(np.asarray(covariance + pull @ noise.coefficients @ pull.T), _of_blocks(influence, noise))


def _resized_functions(functions: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Resample functions (h, w, k) to another grid."""
    if functions.shape[:2] == shape:
        return functions
    return np.stack([area_resized(function, shape) for function in np.moveaxis(functions, 2, 0)], axis=2)


def _of_blocks(influence: FloatArray, noise: PixelNoise) -> list[FloatArray]:
    found = []
    for blocks, variance in zip(_BLOCKS, noise.block_dn2, strict=True):
        sums = _sums(influence, _block_shape(influence.shape[1:], blocks))
        found.append(variance * (sums @ sums.T))
    return found


def _sums(influence: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Add up the influence in blocks, shape (k, blocks)."""
    down, across = _overlap(influence.shape[1], shape[0]), _overlap(influence.shape[2], shape[1])
    return np.asarray((down @ influence @ across.T).reshape(len(influence), -1))


@lru_cache(maxsize=64)
def _overlap(pixels: int, blocks: int) -> FloatArray:
    """Return the share of each pixel that lies in each of so many equal parts of a line, shape (blocks, pixels)."""
    edges = np.arange(blocks + 1) * (pixels / blocks)
    first = np.arange(pixels)
    shared = np.minimum(first + 1, edges[1:, None]) - np.maximum(first, edges[:-1, None])
    return np.asarray(freeze(np.maximum(shared, 0.0)))


def block_sums(values: FloatArray) -> list[FloatArray]:
    """Return the sums of a picture in blocks of the target, for each size of blocks within which errors are alike."""
    return [_sums(values[None], _block_shape(values.shape, blocks))[0] for blocks in _BLOCKS]
