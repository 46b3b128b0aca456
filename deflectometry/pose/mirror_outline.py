"""Where the edges of known facets appear in the image: points along the outlines, their normals, and pixel masks."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from deflectometry.pose.mirrors_in_image import polygon_mask
from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.flags import SampleFlag
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import BoolArray, FlagArray, FloatArray, IntArray, freeze

#: Points along one side: beyond that, neighbours share the same pixels and add time, not knowledge.
MAX_POINTS_PER_SIDE = 256
#: Points of all sides together; keeps an ensemble of many facets as fast as one.
MAX_POINTS = 4096


@dataclass(frozen=True, slots=True, eq=False)
class OutlinePoints:
    """Points along all sides of all facets, on the design surface.

    points_m (sides, n, 3): In the mirror's frame, along each side [m].
    corner_distance_m (sides, n, 2): Distance to both ends of the side [m].
    corner_sharpness (sides, 2): How much the outline turns at both ends: 0 straight on, 1 for a right angle or
        more.
    facet_index (sides,): The facet that each side belongs to.
    """

    points_m: FloatArray
    corner_distance_m: FloatArray
    corner_sharpness: FloatArray
    facet_index: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class ProjectedOutline:
    """The same points in the image.

    pixels_px (sides, n, 2): Projected points [px].
    normals (sides, n, 2): Unit vectors out of the facet, in the image.
    usable (sides, n): Not so near a corner that its profile is rounded.
    """

    pixels_px: FloatArray
    normals: FloatArray
    usable: BoolArray


def sample_outlines(facets: Sequence[Facet], points_per_side: int) -> OutlinePoints:
    """Spread points along the sides of facets.

    facets: The facets with their place in the mirror's frame.
    points_per_side: Wanted points on every side.
    Returns: The points; a side of a curved design follows the surface.
    InputError: No facet, or a design that does not reach its outline.
    """
    if not facets:
        raise InputError("facets: at least one facet with an outline is needed")
    n_sides = sum(len(facet.outline_m) for facet in facets)
    count = int(np.clip(points_per_side, 4, max(4, min(MAX_POINTS_PER_SIDE, MAX_POINTS // n_sides))))
    share = ((np.arange(count) + 0.5) / count)[:, None]
    points, distances, sharpness = [], [], []
    for facet in facets:
        start, end = facet.outline_m, np.roll(facet.outline_m, -1, axis=0)
        side = end - start
        length = np.linalg.norm(side, axis=1)
        plane = start[:, None] + share * side[:, None]
        height = facet.design.height(plane[..., 0], plane[..., 1])
        if not np.isfinite(height).all():
            raise InputError(f"facet {facet.name}: the design ({facet.design.name}) does not reach its outline")
        points.append(facet.ensemble_from_facet.apply(np.concatenate([plane, height[..., None]], axis=-1)))
        distances.append(length[:, None, None] * np.concatenate([share, 1 - share], axis=1))
        turn = _sharpness(np.roll(side, 1, axis=0), side)
        sharpness.append(np.column_stack([turn, np.roll(turn, -1)]))
    index = np.repeat(np.arange(len(facets)), [len(facet.outline_m) for facet in facets])
    return OutlinePoints(
        freeze(np.concatenate(points)), freeze(np.concatenate(distances)), freeze(np.concatenate(sharpness)), index
    )


def _sharpness(before: FloatArray, after: FloatArray) -> FloatArray:
    lengths = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    sine = np.abs(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]) / lengths
    return np.where((before * after).sum(axis=1) < 0, 1.0, sine)


def beside_another(facets: Sequence[Facet], outline: OutlinePoints, reach_m: float) -> BoolArray:
    """Return which outline points have another facet right beside them, so that no dark level can be measured there.

    facets: The facets that the outline was sampled from.
    outline: Points of `sample_outlines`.
    reach_m: How far outside the outline to look [m].
    Returns (sides, n): True where another facet lies at that distance.
    """
    along = outline.points_m[:, -1] - outline.points_m[:, 0]
    front = np.array([facet.ensemble_from_facet.rotation[:, 2] for facet in facets])[outline.facet_index]
    # Counter-clockwise from the front: outwards is to the right of the direction of travel.
    outwards = np.cross(along, front)
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    looked_at = outline.points_m + reach_m * outwards[:, None]
    beside = np.zeros(looked_at.shape[:2], dtype=np.bool_)
    for number, facet in enumerate(facets):
        others = outline.facet_index != number
        place = facet.ensemble_from_facet.inverse().apply(looked_at[others])
        beside[others] |= facet.contains(place[..., 0], place[..., 1])
    return beside


def lit_share(camera: Camera, cam_from_mirror: RigidTransform, facets: Sequence[Facet], lit: BoolArray) -> FloatArray:
    """Return how much of each facet lies on lit pixels.

    Shapes: lit (h, w).
    Returns (n_facets,): Shares from 0 to 1, each from a lattice of about 150 points.
    """
    share = np.zeros(len(facets))
    steps = (np.arange(12) + 0.5) / 12
    for number, facet in enumerate(facets):
        low, high = facet.outline_m.min(axis=0), facet.outline_m.max(axis=0)
        x, y = (grid.ravel() for grid in np.meshgrid(*(low[:, None] + steps * (high - low)[:, None])))
        inside = facet.contains(x, y)
        points = np.column_stack([x, y, facet.design.height(x, y)])[inside]
        pixels = camera.project((cam_from_mirror @ facet.ensemble_from_facet).apply(points))
        place = np.rint(np.nan_to_num(pixels, nan=-1.0)).astype(np.intp)
        seen = (place >= 0).all(axis=1) & (place[:, 0] < lit.shape[1]) & (place[:, 1] < lit.shape[0])
        share[number] = lit[place[seen, 1], place[seen, 0]].sum() / max(len(points), 1)
    return share


def project_outline(
    camera: Camera, cam_from_mirror: RigidTransform, outline: OutlinePoints, corner_reach_px: float
) -> ProjectedOutline:
    """Project outline points and the directions out of the facets.

    outline: Points of `sample_outlines`.
    corner_reach_px: How far a right-angled corner disturbs an edge profile [px].
    """
    pixels = camera.project(cam_from_mirror.apply(outline.points_m))
    tangent = np.gradient(pixels, axis=1)
    length = np.linalg.norm(tangent, axis=-1)
    # Counter-clockwise from the front with y up; in the image y points down: outwards is (-ty, tx).
    with np.errstate(divide="ignore", invalid="ignore"):
        normals = np.stack([-tangent[..., 1], tangent[..., 0]], axis=-1) / length[..., None]
    spacing_m = 2 * outline.corner_distance_m[:, :1, :1]
    from_corner_px = outline.corner_distance_m * (length[..., None] / spacing_m)
    usable = np.isfinite(normals).all(axis=-1)
    usable &= (from_corner_px >= corner_reach_px * outline.corner_sharpness[:, None, :]).all(axis=-1)
    return ProjectedOutline(pixels, np.nan_to_num(normals), usable)


@dataclass(frozen=True, slots=True, eq=False)
class MirrorMasks:
    """Which pixel sees which facet.

    facet_index (h, w): Index of the facet whose surface fills the whole pixel; -1 elsewhere.
    flags (h, w): OUTSIDE_MIRROR, MIRROR_EDGE or 0.
    """

    facet_index: npt.NDArray[np.int16]
    flags: FlagArray


def mirror_masks(
    camera: Camera, cam_from_mirror: RigidTransform, facets: Sequence[Facet], *, margin_px: float
) -> MirrorMasks:
    """Return for every pixel of the camera's image whether it sees a facet, only a facet, or none.

    camera: The camera; its size is the size of the masks.
    margin_px: Distance to the outline below which a pixel mixes the facet with what is beside it: half a pixel's
        diagonal at least, half the width of the edges where the image is blurred [px].
    InputError: A negative margin, or an outline that is not in front of the camera.
    """
    if not margin_px >= 0:
        raise InputError(f"margin_px: zero or more pixels are needed, not {margin_px}")
    shape = (camera.height_px, camera.width_px)
    index = np.full(shape, -1, dtype=np.int16)
    flags = np.full(shape, np.uint32(SampleFlag.OUTSIDE_MIRROR))
    for number, facet in enumerate(facets):
        outline = sample_outlines([facet], 32)
        projected = project_outline(camera, cam_from_mirror, outline, 0.0)
        if not np.isfinite(projected.pixels_px).all():
            raise InputError(f"facet {facet.name}: its outline is not in front of the camera; check the mirror's pose")
        corners = camera.project((cam_from_mirror @ facet.ensemble_from_facet).apply(facet.corners_m))
        ring = np.concatenate([corners[:, None], projected.pixels_px], axis=1)
        touched = polygon_mask(shape, _moved(ring, projected.normals, margin_px))
        whole = polygon_mask(shape, _moved(ring, projected.normals, -margin_px))
        flags[touched & (flags == SampleFlag.OUTSIDE_MIRROR)] = SampleFlag.MIRROR_EDGE
        flags[whole], index[whole] = 0, number
    return MirrorMasks(freeze(index), freeze(flags))


def outline_distance_px(
    camera: Camera, cam_from_mirror: RigidTransform, facets: Sequence[Facet], reach_px: float
) -> FloatArray:
    """Return how far each pixel lies within the outline of its facet, negative beside all, shape (h, w) [px].

    reach_px: Distance beyond which pixels are just far from the outline: the largest value, and the smallest [px].
    """
    shape = (camera.height_px, camera.width_px)
    inside = np.full(shape, -reach_px)
    for facet in facets:
        outline = sample_outlines([facet], 32)
        projected = project_outline(camera, cam_from_mirror, outline, 0.0)
        corners = camera.project((cam_from_mirror @ facet.ensemble_from_facet).apply(facet.corners_m))
        ring = np.concatenate([corners[:, None], projected.pixels_px], axis=1).reshape(-1, 2)
        own = np.where(polygon_mask(shape, ring), reach_px, -reach_px)
        for start, end in zip(ring, np.roll(ring, -1, axis=0), strict=True):
            _near_side(own, start, end, reach_px)
        np.maximum(inside, own, out=inside)
    return inside


def _near_side(inside_px: FloatArray, start_px: FloatArray, end_px: FloatArray, reach_px: float) -> None:
    """Put the distance from one side into the pixels near it, where it is less than that from the sides before."""
    low = np.floor(np.minimum(start_px, end_px) - reach_px).astype(int)
    high = np.ceil(np.maximum(start_px, end_px) + reach_px).astype(int) + 1
    (left, top), (right, bottom) = np.maximum(low, 0), np.minimum(high, inside_px.shape[::-1])
    if left >= right or top >= bottom:
        return
    part = inside_px[top:bottom, left:right]
    x, y = np.meshgrid(np.arange(left, right) - start_px[0], np.arange(top, bottom) - start_px[1])
    along = end_px - start_px
    length = float(np.linalg.norm(along))
    unit = along / max(length, 1e-12)
    before = np.clip(unit[0] * x + unit[1] * y, 0.0, length)
    far = np.hypot(x - before * unit[0], y - before * unit[1])
    nearer = far < np.abs(part)
    part[nearer] = (np.sign(part) * far)[nearer]


def _moved(ring: FloatArray, normals: FloatArray, outwards_px: float) -> FloatArray:
    """Move the outline along its normals; a corner moves to where its two moved sides meet."""
    before, after = np.roll(normals[:, -1], 1, axis=0), normals[:, 0]
    # Both sides' distances are kept at (n1 + n2) / (1 + n1 n2); limited for spikes, where sides nearly turn back.
    corner = (before + after) / np.maximum(1 + (before * after).sum(axis=1), 0.2)[:, None]
    directions = np.concatenate([corner[:, None], normals], axis=1)
    return np.asarray((ring + outwards_px * directions).reshape(-1, 2))
