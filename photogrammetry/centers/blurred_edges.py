"""The shape of blurred edges in a photo, from outlines of round targets: steps of known shape with nothing beside."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from heliogauge.validate import BoolArray, FloatArray
from photogrammetry.centers.disc_model import normal_distribution
from photogrammetry.centers.target_center import REACH

#: Outlines are used where their normal is within this of the direction asked for [rad]; what pixels mix across it then
#: adds up to an eighth of what they mix along it to the variance.
_WEDGE_RAD = 0.35
#: Pixels up to this distance from the outline are used, and not the middle of a disc, where the distance is none [px].
_BESIDE_PX, _LEAST_RADII = 3.0, 0.2
#: Discs of a smaller radius have no pixels that their outline does not reach [px].
_LEAST_RADIUS_PX = 2.5
#: Start and prior: Gaussian blur, and the share that a camera mixes (0.25 where half of the pixels are means of their
#: neighbours in a mosaic of colours). In units of a contrast of 1 and a noise of 0.02 per pixel.
_BLUR_PX, _BLUR_SIGMA_PX, _MIXED_SIGMA, _NOISE = 0.5, 0.3, 0.3, 0.02
_LEAST_PX, _MOST_PX, _MOST_MIXED = 0.1, 3.0, 0.8
#: Pixels that say how bright a disc is inside and outside, and the least difference, as a share of the brighter.
_LEAST_PIXELS, _LEAST_CONTRAST = 3, 0.05
#: A disc that leaves more than so many times the median of all is partly covered, or lies in a shadow's edge.
_REFUSE_TIMES = 3.0
#: Rounds, until no number moves by more: a fifth of what a photo's noise does to it.
_ROUNDS, _SETTLED = 10, 3e-3


class EdgeShape(NamedTuple):
    """How a step is blurred across its edge, besides by the pixel's own width.

    blur_px: Standard deviation of a Gaussian [px].
    mixed: Share of each pixel that its neighbours before and after it replace, one half each: mosaics of colours filled
        in, noise smoothed; below 0 where a camera sharpens.
    scatter_px2: Standard deviation of the blur's variance at single targets, their noise included: as much as it may
        differ at another place in the photo [px^2].
    """

    blur_px: float
    mixed: float
    scatter_px2: float

    @property
    def width_px(self) -> float:
        """Standard deviation of both together; 0 where a camera sharpens more than the lens blurs [px]."""
        return float(np.sqrt(max(self.blur_px**2 + self.mixed, 0.0)))


def edge_shape(
    image: npt.NDArray[np.number],
    centers_px: FloatArray,
    ellipses_px2: FloatArray,
    along: FloatArray,
    full_dn: float = np.inf,
) -> EdgeShape | None:
    """Fit the shape that edges of round targets have in one direction.

    Parameters
    ----------
    image : (height, width) array
        The photo, proportional to light.
    centers_px : (n, 2) array
        Centres of round targets [px].
    ellipses_px2 : (n, 2, 2) array
        Shapes of their ellipses: ``x^T E^-1 x = 1`` is the outline [px^2].
    along : (2,) array
        The direction, of any length.
    full_dn : float, optional
        Pixels from this number on are saturated and say nothing [DN].

    Returns
    -------
    EdgeShape or None
        None where fewer than two targets are large enough and inside the photo.

    Notes
    -----
    A disc is ``inside + step E(d - shift)`` over the distance d from its outline, inside, step and shift of its own
    (blur moves the middle level of a bent edge) and ``E(d) = (1 - m) G(d) + m (G(d - 1) + G(d + 1)) / 2``; G is the
    normal distribution averaged over a pixel's width. Gauss-Newton; discs are eliminated one by one.
    """
    values, distance, used = _pixels(image, centers_px, ellipses_px2, along, full_dn)
    level = []
    for side in (distance < -1, distance > 1):
        count = (used & side).sum(axis=1)
        level.append(np.where(used & side, values, 0.0).sum(axis=1) / np.where(count >= _LEAST_PIXELS, count, np.nan))
    clear = np.abs(level[1] - level[0]) > _LEAST_CONTRAST * np.maximum(np.abs(level[1]), np.abs(level[0]))
    if np.count_nonzero(clear) < 2:
        return None
    values, distance, used = values[clear], distance[clear], used[clear]
    inside, step, shift = level[0][clear], (level[1] - level[0])[clear], np.zeros(int(clear.sum()))
    start = np.array([_BLUR_PX, 0.0])
    shape, precision = start, 1 / np.array([_BLUR_SIGMA_PX, _MIXED_SIGMA]) ** 2
    for _ in range(_ROUNDS):
        edge, by_distance, by_shape = _edge(distance - shift[:, None], *shape)
        # In units of each disc's contrast.
        residual = np.where(used, (values - inside[:, None]) / step[:, None] - edge, 0.0)
        left = np.sqrt(np.square(residual).sum(axis=1) / used.sum(axis=1))
        weight = used * (left <= _REFUSE_TIMES * np.median(left))[:, None] / _NOISE**2
        own = np.stack([np.ones_like(edge), edge, -by_distance], axis=2)
        weighted = np.swapaxes(own * weight[..., None], 1, 2)
        right = weighted @ np.concatenate([by_shape, residual[..., None]], axis=2)
        solved = np.linalg.solve(weighted @ own + np.eye(3), right)
        known = np.einsum("kn,knc,knd->kcd", weight, by_shape, by_shape)
        known -= np.einsum("kpc,kpd->kcd", right[..., :2], solved[..., :2])
        pull = np.einsum("kn,knc,kn->kc", weight, by_shape, residual)
        pull -= np.einsum("kpc,kp->kc", right[..., :2], solved[..., 2])
        move = np.linalg.solve(known.sum(axis=0) + np.diag(precision), pull.sum(axis=0) + precision * (start - shape))
        move = np.clip(shape + np.clip(move, -0.2, 0.2), [_LEAST_PX, -_MOST_MIXED], [_MOST_PX, _MOST_MIXED]) - shape
        each = solved[..., 2] - solved[..., :2] @ move
        inside, step = inside + step * each[:, 0], step * (1 + np.clip(each[:, 1], -0.5, 0.5))
        shape, shift = shape + move, shift + np.clip(each[:, 2], -0.5, 0.5)
        if np.abs(move).max() < _SETTLED:
            break
    # What each disc would change the blur by, weighted by what it knows of it; at least half of them are not refused.
    telling = known[:, 0, 0] > 0
    of_blur, count = known[telling, 0, 0], np.count_nonzero(telling)
    scatter = np.sqrt(np.sum(pull[telling, 0] ** 2 / of_blur) / of_blur.sum() * count / (count - 1))
    return EdgeShape(float(shape[0]), float(shape[1]), float(2 * shape[0] * scatter))


def _pixels(
    image: npt.NDArray[np.number],
    centers_px: FloatArray,
    ellipses_px2: FloatArray,
    along: FloatArray,
    full_dn: float,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return brightness, distance outside the outline [px] and use of the pixels around each disc, shapes (k, n)."""
    height, width = image.shape
    # Corners have no ellipse: NaN, which a determinant warns of.
    (xx, xy), (_, yy) = np.moveaxis(ellipses_px2, 0, 2)
    radii = np.sqrt(np.sqrt(np.abs(xx * yy - xy * xy)))
    large = np.isfinite(centers_px).all(axis=1) & (radii >= _LEAST_RADIUS_PX)
    reach = int(np.ceil(np.max(radii[large], initial=0.0) * REACH * 1.3)) + 1
    middle = np.rint(np.where(large[:, None], centers_px, -1)).astype(np.intp)
    large &= (middle >= reach).all(axis=1) & (middle < np.array([width, height]) - reach).all(axis=1)
    offset = np.arange(-reach, reach + 1)
    column, row = (one.ravel() for one in np.meshgrid(offset, offset))
    x, y = middle[large, :1] + column, middle[large, 1:] + row
    values = np.asarray(image[y, x], dtype=np.float64)
    beside = np.stack([x, y], axis=2) - centers_px[large, None]
    inverse = np.linalg.inv(ellipses_px2[large])
    towards = beside @ inverse
    q = np.maximum(np.sqrt(np.einsum("knc,knc->kn", towards, beside)), 1e-9)
    steep = np.maximum(np.hypot(*np.moveaxis(towards, 2, 0)), 1e-9)
    distance = (q - 1) * q / steep
    near = np.abs(towards @ (along / np.hypot(*along))) > np.cos(_WEDGE_RAD) * steep
    used = near & (q > _LEAST_RADII) & (q < REACH) & (np.abs(distance) < _BESIDE_PX)
    used &= values < full_dn
    # Those of each disc that are used come first, the rest of no disc is kept.
    order = np.argsort(~used, axis=1, kind="stable")[:, : int(used.sum(axis=1).max(initial=0))]
    values, distance, used = (np.take_along_axis(one, order, axis=1) for one in (values, distance, used))
    return values, distance, used


def _edge(distance: FloatArray, blur_px: float, mixed: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return E of `edge_shape`, its derivative by the distance, and those by blur and mixing, shape (..., 2)."""
    ends = [distance + way for way in (-1.5, -0.5, 0.5, 1.5)]
    normal = [normal_distribution(one / blur_px) for one in ends]
    # Integrals of the normal distribution from far inside, that distribution, and its density.
    found = [(end * above + blur_px * bell, above, bell) for end, (above, bell) in zip(ends, normal, strict=True)]
    averaged = [[b - a for a, b in zip(*two, strict=True)] for two in pairwise(found)]
    one, beside = averaged[1], [0.5 * (a + b) for a, b in zip(averaged[0], averaged[2], strict=True)]
    edge, by_distance, by_blur = ((1 - mixed) * a + mixed * b for a, b in zip(one, beside, strict=True))
    return edge, by_distance, np.stack([by_blur, beside[0] - one[0]], axis=-1)
