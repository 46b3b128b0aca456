"""Centres of small dots as centres of their light: no template, hence nothing to say about blur or size."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FloatArray

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
    """

    centers_px: FloatArray
    covariance_px2: FloatArray
    contrast_dn: FloatArray
    residual_dn: float
    settled: BoolArray


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
    order = np.argsort(half_all, kind="stable")
    for first in range(0, count, _AT_ONCE):
        rows = order[first : first + _AT_ONCE]
        half = int(half_all[rows].max())
        for _ in range(_PASSES):
            found = _moments(image_dn, centers[rows], shapes_px2[rows], free_px[rows], half)
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
    settled &= noise < _MOST_NOISES * max(usual, _LEAST_NOISE_DN)
    covariance *= np.maximum(noise, usual)[:, None, None] ** 2
    return LightCenters(centers, covariance, light / area, usual, settled)


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
    """Shift of the centres, light over ground, noise of the ground, covariance per noise, whether all is there."""

    shift_px: FloatArray
    light: FloatArray
    noise_dn: FloatArray
    spread: FloatArray
    fine: BoolArray


def _moments(
    image_dn: npt.NDArray[np.generic], centers: FloatArray, shapes: FloatArray, free_px: FloatArray, half: int
) -> _Moments:
    middle = np.rint(centers).astype(np.intp)
    offset = np.arange(-half, half + 1)
    height, width = image_dn.shape
    inside = ((middle >= half) & (middle < np.array([width, height]) - half)).all(axis=1)
    column = np.clip(middle[:, 0], half, width - 1 - half)[:, None] + offset
    row = np.clip(middle[:, 1], half, height - 1 - half)[:, None] + offset
    values = image_dn[row[:, :, None], column[:, None, :]].astype(np.float32).reshape(len(centers), -1)
    size = (len(centers), offset.size, offset.size)
    x = np.broadcast_to((offset - (centers[:, 0] - middle[:, 0])[:, None])[:, None, :], size).reshape(values.shape)
    y = np.broadcast_to((offset - (centers[:, 1] - middle[:, 1])[:, None])[:, :, None], size).reshape(values.shape)
    x, y = x.astype(np.float32), y.astype(np.float32)
    inverse = np.linalg.inv(shapes).astype(np.float32)
    square = inverse[:, 0, 0, None] * x * x + 2 * inverse[:, 0, 1, None] * x * y + inverse[:, 1, 1, None] * y * y
    length = np.sqrt(x * x + y * y)
    beyond = length * (1 - 1 / np.sqrt(np.maximum(square, 1e-6)))
    weight = np.clip(_MARGIN_PX + 0.5 - beyond, 0.0, 1.0)
    ring = ((beyond > _MARGIN_PX + 0.5) & (beyond <= _MARGIN_PX + 0.5 + _RING_PX) & (length < free_px[:, None])).astype(
        np.float32
    )
    terms = np.stack([np.ones_like(x), x, y], axis=1)
    on_ring = terms * ring[:, None]
    count = ring.sum(axis=1)
    # A plane through a ring that neighbours leave open on one side is as good as its normal matrix says.
    normal = (on_ring @ np.swapaxes(terms, 1, 2)).astype(np.float64) + 1e-6 * np.eye(3)
    solver = np.linalg.inv(normal)
    plane = (solver @ (on_ring @ values[:, :, None]).astype(np.float64))[..., 0]
    left = values - (plane[:, None].astype(np.float32) @ terms)[:, 0]
    noise = np.sqrt((ring * left * left).sum(axis=1) / np.maximum(count - 3, 1))
    weighed = weight * terms.transpose(1, 0, 2)
    light = (weight * left).sum(axis=1).astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.stack([(one * left).sum(axis=1) / light for one in weighed[1:]], axis=1)
        own = weighed[1:].transpose(1, 0, 2).astype(np.float64)
        by_plane = own @ np.swapaxes(terms, 1, 2)
        spread = (own @ np.swapaxes(own, 1, 2) + by_plane @ solver @ np.swapaxes(by_plane, 1, 2)) / light[
            :, None, None
        ] ** 2
    fine = inside & (count >= _LEAST_PIXELS) & np.isfinite(shift).all(axis=1) & (np.hypot(*shift.T) < half)
    return _Moments(np.asarray(shift), light, np.asarray(noise), np.asarray(spread), fine)


def has_free_ground(shapes_px2: FloatArray, free_px: FloatArray) -> BoolArray:
    """Return which dots have room for a window and a ring of ground, shape (n,)."""
    largest = np.sqrt(0.5 * np.einsum("nii->n", shapes_px2) + _half_difference(shapes_px2))
    return np.asarray(free_px > largest + _MARGIN_PX + 0.5 + _LEAST_RING_PX)


def _half_difference(shapes: FloatArray) -> FloatArray:
    return np.asarray(np.hypot(0.5 * (shapes[:, 0, 0] - shapes[:, 1, 1]), shapes[:, 0, 1]))
