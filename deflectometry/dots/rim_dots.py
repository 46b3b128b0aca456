"""Dots at the edges of a mirror: those that are whole are measured without the edges, those that are cut are named."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from deflectometry.dots.cut_dots import fit_cut_dot
from deflectometry.dots.found_dots import LIKE_SO_MANY, FoundDots, expected_dots, like_neighbours
from deflectometry.dots.rim import BLURS, Rim
from deflectometry.pose.mirror_outline import outline_distance_px
from deflectometry.pose.outline_edges import edge_blur_px
from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import BoolArray, Float32Array, FloatArray
from photogrammetry.centers import Ellipse, TargetCenter, measure_centers

#: Standard deviations of a blur from where what is left of a dot's step (2 %) is less than the noise of an edge.
_MOST_OF_BLUR = 2.0
#: Share of the dots' distance beyond which there is ground whatever their blur: the middle of four dots is 0.7 away.
_FREE_SHARE = 0.6


def _radius_px(dots: FoundDots) -> float:
    """Return the usual larger semi-axis of dots [px]."""
    return float(np.sqrt(np.median(np.linalg.eigvalsh(dots.outlines_px2)[:, 1])))


def find_rim(
    photo_dn: npt.NDArray[Any],
    found: Sequence[FoundDots],
    camera: Camera,
    cam_from_mirror: RigidTransform,
    facets: Sequence[Facet],
    edge_width_px: float,
    sigma_edge_px: float,
) -> Rim:
    """Take the edges of a mirror out of its photo.

    photo_dn (h, w): Grey values [DN].
    found: Its dots.
    cam_from_mirror: Pose whose outline lies on the edges.
    edge_width_px: Width of the edges; NaN where none was measured [px].
    sigma_edge_px: How far the outline may be off an edge [px].

    A mirror with dots that ends at an edge, blurred as a whole, is ``ground * cover - blurred dots`` where no dot is
    cut; cover is the blurred step of the edge. So the ground that is missing is added: exact for whole dots, however
    near to the edge they are.
    """
    blur = max(edge_blur_px(float(np.nan_to_num(edge_width_px, nan=2.0))), 0.3)
    spacing = max(one.spacing_px for one in found)
    # As far as the edges' blur, and the light of dots near them, go.
    reach = max(BLURS * blur + 2.0 * spacing, *(_farthest_px(one) + 1.0 for one in found))
    inside = outline_distance_px(camera, cam_from_mirror, facets, reach)
    clear = np.ones(photo_dn.shape, dtype=np.uint8)
    for dots in found:
        expected, _ = expected_dots(dots.centers_px, dots.number)
        far = min(_reach_px(dots), _FREE_SHARE * dots.spacing_px)
        _put_discs(clear, np.concatenate([dots.centers_px, expected]), far, 0)
    photo, within = photo_dn.astype(np.float32), inside > BLURS * blur
    free = within & (clear > 0)
    ground = _mean_around(photo, free if free.any() else within, spacing)
    beside = _mean_around(photo, inside < -BLURS * blur, spacing)
    from scipy.special import ndtr

    step = ground - beside
    missing = step * ndtr(-inside / blur)
    whole = np.where(inside <= -reach, ground, photo + missing)
    return Rim(np.asarray(whole, dtype=np.float32), inside, step, blur, sigma_edge_px, ground)


def _reach_px(dots: FoundDots) -> float:
    """Return how far from its middle a dot darkens or lights the photo, where it is only expected, too [px]."""
    return _radius_px(dots) + BLURS * dots.blur_px + 1.0


def _farthest_px(dots: FoundDots) -> float:
    """Return how far from an edge a dot is at most whose light reaches a pixel near it [px]."""
    return 2.0 * _reach_px(dots) + dots.spacing_px


def _put_discs(image: npt.NDArray[np.uint8], places_px: FloatArray, radius_px: float, value: int) -> None:
    for x, y in np.rint(places_px).astype(int).tolist():
        cv2.circle(image, (x, y), int(np.ceil(radius_px)), value, cv2.FILLED)


def _mean_around(photo_dn: Float32Array, where: BoolArray, width_px: float) -> FloatArray:
    """Return the mean of the photo around each pixel over those that count; of all of them where none is near."""
    weight = cv2.GaussianBlur(where.astype(np.float32), (0, 0), width_px)
    total = cv2.GaussianBlur(np.where(where, photo_dn, np.float32(0.0)), (0, 0), width_px)
    usual = float(np.median(photo_dn[where])) if where.any() else 0.0
    # Below a thousandth the sum is that of a few far pixels.
    return np.where(weight > 1e-3, total / np.maximum(weight, 1e-3), usual)


def with_rim_dots(dots: FoundDots, rim: Rim) -> FoundDots:
    """Measure dots that are near the edges once more, without the edges, and those that the lattice expects there.

    Returns: The dots, with those added that are seen. Dots of which an edge cuts less than half off have a centre from
        the rest, with a larger sigma; those that it cuts more off are marked.
    """
    ellipses = [Ellipse(*one) for one in zip(dots.centers_px, dots.outlines_px2, strict=True)]
    near = rim.are_near(ellipses, dots.blur_px)
    if not near.any():
        return dots
    expected, their_number = expected_dots(dots.centers_px, dots.number)
    # Where hardly any dot is away from the edges, two columns of them say, those at the edges are all that there is.
    clear = ~near if np.count_nonzero(~near) >= LIKE_SO_MANY else np.ones_like(near)
    usual = like_neighbours(dots.centers_px[near], dots.centers_px[clear], dots.outlines_px2[clear])
    new = like_neighbours(expected, dots.centers_px[clear], dots.outlines_px2[clear])
    may_be = rim.are_near(new, dots.blur_px)
    may_be[may_be] = [rim.holds(one.center_px) for one, there in zip(new, may_be, strict=True) if there]
    starts = [one for one, there in zip(ellipses, near, strict=True) if there]
    starts += [one for one, there in zip(new, may_be, strict=True) if there]
    alike = [*usual, *(one for one, there in zip(new, may_be, strict=True) if there)]
    number = np.concatenate([dots.number[near], their_number[may_be]])
    contrast = float(np.nanmedian(dots.contrast_dn))
    found = [
        # A disc that is cut may pass for a whole one that is smaller.
        one
        if isinstance(one, TargetCenter) and not rim.cuts(replace(other, center_px=one.center_px))
        else fit_cut_dot(rim, other, contrast, dots)
        for one, other in zip(measure_centers(rim.photo_dn, starts), alike, strict=True)
    ]
    # One that is only expected, and not there, is none; one that was found keeps its number.
    was_found = np.arange(len(starts)) < np.count_nonzero(near)
    good = np.array([one is not None for one in found], dtype=np.bool_)
    kept = np.flatnonzero(good | was_found)
    nothing = np.full((2, 2), np.nan)
    rows = [(found[k], starts[k]) for k in kept.tolist()]
    added = replace(
        dots,
        centers_px=np.array([start.center_px if one is None else one.center_px for one, start in rows]),
        covariance_px2=np.array([nothing if one is None else one.covariance_px2 for one, _ in rows]),
        number=number[kept],
        contrast_dn=np.array([np.nan if one is None else abs(one.contrast_dn) for one, _ in rows]),
        n_coarse=0,
        shapes_px2=np.array([start.shape_px2 if one is None else one.ellipse.shape_px2 for one, start in rows]),
        cut=~good[kept],
    )
    rest = dots.chosen(~near)
    return replace(
        rest,
        centers_px=np.concatenate([added.centers_px, rest.centers_px]),
        covariance_px2=np.concatenate([added.covariance_px2, rest.covariance_px2]),
        number=np.concatenate([added.number, rest.number]),
        contrast_dn=np.concatenate([added.contrast_dn, rest.contrast_dn]),
        shapes_px2=np.concatenate([added.outlines_px2, rest.outlines_px2]),
        cut=np.concatenate([added.is_cut, rest.is_cut]),
    )


def edges_without_dots(
    photo_dn: npt.NDArray[Any], without_dn: Float32Array, found: Sequence[FoundDots], rim: Rim, sign: float
) -> tuple[Float32Array, BoolArray]:
    """Return the photo without dots, its edges untouched by them, and where a dot hides the edge, both (h, w).

    without_dn (h, w): The photo with the ground in the place of each dot [DN].
    found: The dots of `with_rim_dots`.
    sign: 1 for light dots, -1 for dark ones.

    Near an edge the ground in the place of a dot would hide the edge as well: the light of the dot itself is taken off.
    """
    image = photo_dn.astype(np.float32)
    near_edge = np.abs(rim.inside_px) < max(_reach_px(one) + one.spacing_px for one in found)
    clutter = np.zeros(photo_dn.shape, dtype=np.uint8)
    for dots in found:
        expected, _ = expected_dots(dots.centers_px, dots.number)
        reach = _reach_px(dots)
        near = np.abs(rim.inside_at(dots.centers_px)) < _farthest_px(dots)
        unknown = dots.is_cut | ~np.isfinite(dots.contrast_dn)
        # Of a dot that is cut the disc would be taken off beyond the edge as well.
        for k in np.flatnonzero(near & ~unknown).tolist():
            unknown[k] = rim.cuts(Ellipse(dots.centers_px[k], dots.outlines_px2[k]))
        places = np.concatenate([dots.centers_px[unknown], expected])
        # What is wholly beside the mirror nobody sees; of a dot that was not found the place is not sure.
        seen = rim.inside_at(places) > -_radius_px(dots) - 1.0
        _put_discs(clutter, places[seen], _radius_px(dots) + _MOST_OF_BLUR * dots.blur_px, 1)
        for k in np.flatnonzero(~unknown & near).tolist():
            _take_off(image, dots, k, sign, reach)
    return np.where(near_edge, image, without_dn).astype(np.float32), clutter > 0


def _take_off(image_dn: Float32Array, dots: FoundDots, which: int, sign: float, reach_px: float) -> None:
    """Take the light of one dot off an image where that still shows it: a disc with a Gaussian blur."""
    from scipy.special import chndtr

    center, shape = dots.centers_px[which], dots.outlines_px2[which]
    height, width = image_dn.shape
    left, top = np.maximum(np.floor(center - reach_px), 0).astype(int).tolist()
    right, bottom = np.minimum(np.ceil(center + reach_px) + 1, (width, height)).astype(int).tolist()
    x, y = np.meshgrid(np.arange(left, right) - center[0], np.arange(top, bottom) - center[1])
    away = np.stack([x, y], axis=-1)
    square = np.einsum("...i,ij,...j->...", away, np.linalg.inv(shape), away)
    # Exact for a circle: the chance that a place, blurred, is on the disc. Of an ellipse a circle of its area.
    size = float(np.sqrt(np.linalg.det(shape))) / dots.blur_px**2
    share = chndtr(size, 2.0, size * square)
    image_dn[top:bottom, left:right] -= sign * dots.contrast_dn[which] * share
