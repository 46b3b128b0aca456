"""Centres of small dots as centres of their light: no template, hence nothing to say about blur or size."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, Float32Array, FloatArray

#: How far beyond the outline light counts, with half a pixel on either side in which it fades out. Of 0.75, 1, 1.25
#: and 1.5 this has the smallest errors on drawn dots of 3 to 8 px with a blur of 0.5 to 1 px, and sigmas that hold
#: (tests/photogrammetry/centers/test_light_moments.py) [px].
_MARGIN_PX = 1.25
#: Width of the ring beyond in which the ground is measured, and the least of it [px].
_RING_PX, _LEAST_RING_PX = 2.0, 1.0
#: Pixels of the ring that a plane needs.
_LEAST_PIXELS = 12
#: Noise of the ground over the usual one of the photo above which something else lies in the ring: thirty pixels of
#: noise alone never reach it.
_MOST_NOISES = 2.5
#: Rounding to whole grey values [DN].
_LEAST_NOISE_DN = 12**-0.5
#: Light in units of its sigma below which there is nothing, as for templates.
_LEAST_SIGMAS = 8.0
#: Passes: the window follows the centre, a twentieth of the first shift is left after the first.
_PASSES = 2
#: Which sum of powers (1, x, y, x^2, x y, y^2) stands where in a product of (1, x, y) with itself.
_PRODUCTS = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
#: Dots that are worked on together: their windows stay in the caches.
_AT_ONCE = 1024


@dataclass(frozen=True, slots=True, eq=False)
class LightCenters(ShortRepr):
    """Centres of n dots.

    centers_px (n, 2): Centres (x, y) [px].
    covariance_px2 (n, 2, 2): Their covariances, from the noise of the ground [px^2].
    contrast_dn (n,): Level inside minus outside; negative for dark dots [DN].
    residual_dn: Usual noise of a pixel of the ground [DN].
    settled (n,): Whether there is a centre: the dot stands out, its ground is free, the centre is where the outline is.
    start_contrast_dn (n,): The contrast in the outline as it was given; NaN where the ground around that is not free.
    """

    centers_px: FloatArray
    covariance_px2: FloatArray
    contrast_dn: FloatArray
    residual_dn: float
    settled: BoolArray
    start_contrast_dn: FloatArray


def light_centers(
    image_dn: npt.NDArray[np.generic],
    centers_px: FloatArray,
    shapes_px2: FloatArray,
    free_px: FloatArray,
    noise_dn: float | None = None,
) -> LightCenters:
    """Find the centre of the light of small dots, above or below the plane of the ground around each.

    Shapes: image_dn (h, w).
    centers_px (n, 2): Outlines to some tenths of a pixel: centres [px].
    shapes_px2 (n, 2, 2): Their ellipses [px^2].
    free_px (n,): How far from the centre there is nothing else [px].
    noise_dn: Usual noise of a pixel; by default that of the ground of these dots [DN].

    The first moment of a dot's light is that of the dot whatever the blur and however pixels divide it, if the window
    holds all of it. Its noise is ``sigma |sum w^2 d d^T|^1/2 / light``, about that of a template up to some 4 px of
    radius; there a template has to tell size and blur apart, which a dozen pixels do not (Trinder 1989 found the same
    of targets on film).
    """
    count = len(centers_px)
    centers, covariance = centers_px.copy(), np.full((count, 2, 2), np.nan)
    light, noise, settled = np.zeros(count), np.full(count, np.nan), np.zeros(count, dtype=np.bool_)
    half_all = np.ceil(np.sqrt(np.einsum("nii->ni", shapes_px2).max(axis=1)) + _MARGIN_PX + _RING_PX + 1).astype(
        np.intp
    )
    at_start, noise_there = np.full(count, np.nan), np.full(count, np.nan)
    order = np.argsort(half_all, kind="stable")
    for first in range(0, count, _AT_ONCE):
        rows = order[first : first + _AT_ONCE]
        half = int(half_all[rows].max())
        for turn in range(_PASSES):
            found = _moments(image_dn, centers[rows], shapes_px2[rows], free_px[rows], half)
            if turn == 0:
                at_start[rows], noise_there[rows] = np.where(found.has_ground, found.light, np.nan), found.noise_dn
            centers[rows] += np.where(found.fine[:, None], found.shift_px, 0.0)
        light[rows], noise[rows], settled[rows], covariance[rows] = (
            found.light,
            found.noise_dn,
            found.fine,
            found.spread,
        )
    area = np.pi * np.sqrt(np.maximum(np.linalg.det(shapes_px2), 0.0))
    radius = np.sqrt(np.einsum("nii->n", shapes_px2) / 2)
    usual = (float(np.median(noise[settled])) if settled.any() else 0.0) if noise_dn is None else noise_dn
    settled &= np.hypot(*(centers - centers_px).T) < np.maximum(0.5 * radius, 0.5)
    settled &= np.abs(light) > _LEAST_SIGMAS * usual * np.sqrt(area)
    most = _MOST_NOISES * max(usual, _LEAST_NOISE_DN)
    settled &= noise < most
    covariance *= np.maximum(noise, usual)[:, None, None] ** 2
    at_start = np.where(noise_there < most, at_start, np.nan) / area
    return LightCenters(centers, covariance, light / area, usual, settled, at_start)


def counted_share(radius_px: float, blur_px: float, outline_px: float) -> float:
    """Return the share of a disc's light that `light_centers` counts: not its tail, nor what that adds to the ground.

    radius_px: Of the disc [px].
    blur_px: Standard deviation of its blur, pixel included [px].
    outline_px: Radius of the outline that the window is laid around [px].
    """
    from scipy.special import chndtr

    r = np.linspace(0.0, outline_px + _MARGIN_PX + 0.5 + _RING_PX, 400)
    # Exact for a circle: the chance that a place, blurred, is on the disc.
    light = chndtr((radius_px / blur_px) ** 2, 2.0, (r / blur_px) ** 2)
    weight = np.clip(_MARGIN_PX + 0.5 - (r - outline_px), 0.0, 1.0)
    ring = r > outline_px + _MARGIN_PX + 0.5
    ground = float((light * r)[ring].sum() / r[ring].sum())
    return float((weight * (light - ground) * r).sum() * (r[1] - r[0]) * 2 / radius_px**2)


@dataclass(frozen=True, slots=True, eq=False)
class _Moments:
    """Shift of the centres, light over ground, noise of the ground, covariance per noise, whether ground and all is."""

    shift_px: FloatArray
    light: FloatArray
    noise_dn: FloatArray
    spread: FloatArray
    has_ground: BoolArray
    fine: BoolArray


def _moments(
    image_dn: npt.NDArray[np.generic], centers: FloatArray, shapes: FloatArray, free_px: FloatArray, half: int
) -> _Moments:
    """Measure dots in windows of 2 half + 1 pixels.

    All sums are over the powers of the same whole pixels, x and y from the middle of the window, so that they are
    products of matrices; what refers to the dot's own place follows from them.
    """
    middle = np.rint(centers).astype(np.intp)
    offset = np.arange(-half, half + 1)
    height, width = image_dn.shape
    inside = ((middle >= half) & (middle < np.array([width, height]) - half)).all(axis=1)
    column = np.clip(middle[:, 0], half, width - 1 - half)[:, None] + offset
    row = np.clip(middle[:, 1], half, height - 1 - half)[:, None] + offset
    values = image_dn[row[:, :, None], column[:, None, :]].astype(np.float32).reshape(len(centers), -1)
    y, x = (one.ravel().astype(np.float32) for one in np.meshgrid(offset, offset, indexing="ij"))
    powers = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    beyond, length_squared = _around(centers - middle, shapes, powers)
    weight = np.clip(_MARGIN_PX + 0.5 - beyond, 0.0, 1.0)
    ring = beyond > _MARGIN_PX + 0.5
    ring &= beyond <= _MARGIN_PX + 0.5 + _RING_PX
    ring &= length_squared < (free_px * np.maximum(free_px, 0.0))[:, None].astype(np.float32)
    on_ring = ring.astype(np.float32)

    def sums(of: Float32Array, count: int = 6) -> FloatArray:
        return (of @ powers[:count].T).astype(np.float64)

    by_ring = sums(on_ring)
    count = by_ring[:, 0]
    # Above the mean of the ring: little is lost when squares are summed in single precision.
    values -= (np.einsum("nk,nk->n", on_ring, values) / np.maximum(count, 1.0).astype(np.float32))[:, None]
    on_ring *= values
    right = sums(on_ring, 3)
    # A plane through a ring that neighbours leave open on one side is as good as its normal matrix says.
    solver = np.linalg.inv(by_ring[:, _PRODUCTS] + 1e-6 * np.eye(3))
    plane = (solver @ right[..., None])[..., 0]
    squares = np.einsum("nk,nk->n", on_ring, values) - np.einsum("ni,ni->n", plane, right)
    noise = np.sqrt(np.maximum(squares, 0.0) / np.maximum(count - 3, 1))
    # Light, and light times x and y, from the middle of the window; then from the dot.
    values *= weight
    by_weight = sums(weight)[:, _PRODUCTS]
    left = sums(values, 3) - (by_weight @ plane[..., None])[..., 0]
    light, own = left[:, 0], (centers - middle)[..., None]
    weight *= weight
    by_square = sums(weight)[:, _PRODUCTS]
    outer = own * by_square[:, None, 0, 1:]
    squared = by_square[:, 1:, 1:] - outer - np.swapaxes(outer, 1, 2)
    squared += by_square[:, :1, :1] * own * np.swapaxes(own, 1, 2)
    by_plane = by_weight[:, 1:] - own * by_weight[:, :1]
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = left[:, 1:] / light[:, None] - own[..., 0]
        spread = (squared + by_plane @ solver @ np.swapaxes(by_plane, 1, 2)) / light[:, None, None] ** 2
    has_ground = inside & (count >= _LEAST_PIXELS)
    fine = has_ground & np.isfinite(shift).all(axis=1) & (np.hypot(*shift.T) < half)
    return _Moments(np.asarray(shift), light, np.asarray(noise), np.asarray(spread), has_ground, fine)


def _around(own_px: FloatArray, shapes_px2: FloatArray, powers: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Return how far pixels lie beyond the outlines [px], and their squared distances from the centres [px^2], (n, k).

    own_px (n, 2): Centres, from the middle of the window [px].
    shapes_px2 (n, 2, 2): Ellipses [px^2].
    powers (6, k): Powers of the pixels' places from there.
    """

    def form(matrices: FloatArray) -> Float32Array:
        by_own = (matrices @ own_px[..., None])[..., 0]
        parts = [np.einsum("ni,ni->n", by_own, own_px), *(-2 * by_own.T)]
        parts += [matrices[:, 0, 0], 2 * matrices[:, 0, 1], matrices[:, 1, 1]]
        return np.asarray(np.stack(parts, axis=1).astype(np.float32) @ powers)

    square = form(np.asarray(np.linalg.inv(shapes_px2)))
    length_squared = form(np.broadcast_to(np.eye(2), shapes_px2.shape))
    np.maximum(length_squared, 0.0, out=length_squared)
    np.sqrt(np.maximum(square, 1e-6, out=square), out=square)
    beyond = np.sqrt(length_squared)
    beyond -= beyond / square
    return beyond, length_squared


def has_free_ground(shapes_px2: FloatArray, free_px: FloatArray) -> BoolArray:
    """Return which dots have room for a window and a ring of ground, shape (n,)."""
    largest = np.sqrt(0.5 * np.einsum("nii->n", shapes_px2) + _half_difference(shapes_px2))
    return np.asarray(free_px > largest + _MARGIN_PX + 0.5 + _LEAST_RING_PX)


def _half_difference(shapes: FloatArray) -> FloatArray:
    return np.asarray(np.hypot(0.5 * (shapes[:, 0, 0] - shapes[:, 1, 1]), shapes[:, 0, 1]))
