"""What a mirror of design shape will show: the point of the screen at each pixel, and how its edges will look."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from deflectometry.setup.camera_and_screen import Screen, Setup
from heliogauge.errors import InputError
from heliogauge.geometry.rays import reflect
from heliogauge.geometry.rigid import RigidTransform, rotation_between, rotation_from_vector
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import BoolArray, Float32Array, FloatArray

#: Points along each side of an outline: sides of a curved mirror bend in the image.
_SIDE_POINTS = 48
#: Light of an edge reaches so many of its standard deviations.
_REACH_SIGMAS = 5.0
#: Parts of a pixel along each side over which the light of an edge is integrated.
_PARTS = 6
#: Places whose distances to an outline are found at once.
_BLOCK = 4096
#: Rounds of Newton from the screen's best plane; a wall bent by a tenth of its width settles to 1e-9 of it in four.
_ROUNDS = 6


@dataclass(frozen=True, slots=True, eq=False)
class FacetSight:
    """What one facet shows on the pixels of a box around it.

    rows, columns: The box.
    inside (h, w): Pixels whose middle sees the facet.
    u, v (h, w): Point of the screen seen there; beyond 0 to 1 where the mirror looks past it, NaN where it looks away.
    cover (h, w): Share of the facet's light that each pixel gets, after blur.
    """

    facet: Facet
    rows: slice
    columns: slice
    inside: BoolArray
    u: FloatArray
    v: FloatArray
    cover: Float32Array

    @property
    def on_screen(self) -> BoolArray:
        """Pixels of the box that see the screen, shape (h, w)."""
        return np.asarray((self.u >= 0) & (self.u <= 1) & (self.v >= 0) & (self.v <= 1))

    @property
    def seen_share(self) -> float:
        """Share of the facet's pixels that see the screen."""
        return float(np.count_nonzero(self.inside & self.on_screen) / np.count_nonzero(self.inside))


def facing_pose(
    setup: Setup, facets: Sequence[Facet], point_m: FloatArray, place_m: FloatArray, roll_rad: float
) -> RigidTransform:
    """Return the pose of a mirror that shows the screen's middle in its own.

    point_m (3,): A point of the mirror, in its frame [m].
    place_m (3,): Where that point is, in the camera's frame [m].
    roll_rad: From the image's x axis to the mirror's, counter-clockwise as displayed.
    """
    areas = np.array([one.area_m2 for one in facets])
    middle_m, normal = np.zeros(3), np.zeros(3)
    for one, area in zip(facets, areas / areas.sum(), strict=True):
        x, y = one.reference_point_m
        middle_m += area * one.ensemble_from_facet.apply([x, y, float(one.design.height(x, y))])
        normal += area * one.ensemble_from_facet.rotate(one.design.normal(x, y))
    target = setup.cam_from_screen.apply(setup.screen.points_m(np.array(0.5), np.array(0.5)))
    rotation = np.eye(3)
    # The middle moves with the turn: a mirror that is not small stands beside the point.
    for _ in range(_ROUNDS):
        middle = place_m + rotation @ (middle_m - point_m)
        z_axis = target - middle
        z_axis = z_axis / np.linalg.norm(z_axis) - middle / np.linalg.norm(middle)
        z_axis /= np.linalg.norm(z_axis)
        x_axis = np.cross([0.0, -1.0, 0.0], z_axis)
        if np.linalg.norm(x_axis) < 1e-9:
            raise InputError("the mirror would have to look straight up or down in the image; give [mirror.pose]")
        x_axis /= np.linalg.norm(x_axis)
        upright = np.column_stack([x_axis, np.cross(z_axis, x_axis), z_axis])
        rotation = upright @ rotation_from_vector([0.0, 0.0, roll_rad]) @ rotation_between(normal, [0.0, 0.0, 1.0])
    return RigidTransform(rotation, place_m - rotation @ point_m)


def facet_sight(setup: Setup, cam_from_mirror: RigidTransform, facet: Facet, blur_px: float) -> FacetSight:
    """Trace the pixels around a facet of design shape to the screen.

    blur_px: Standard deviation of the lens's blur [px].
    InputError: The facet is behind the camera, turned away from it, or reaches beyond the image.
    """
    cam_from_facet = cam_from_mirror @ facet.ensemble_from_facet
    facet_from_cam = cam_from_facet.inverse()
    camera_m = facet_from_cam.translation_m
    x, y = facet.reference_point_m
    normal = facet.design.normal(x, y)
    middle_m = np.array([x, y, float(facet.design.height(x, y))])
    if not cam_from_facet.apply(middle_m)[2] > 0:
        raise InputError(f"facet {facet.name} is behind the camera; check [mirror.pose] or plan.mirror_m")
    if not (camera_m - middle_m) @ normal > 0:
        raise InputError(f"the camera is behind facet {facet.name}: it sees its back; check [mirror.pose] and [screen]")
    outline_px = _outline_px(setup, cam_from_facet, facet)
    size_px = np.array([setup.camera.width_px, setup.camera.height_px])
    margin = int(np.ceil(_REACH_SIGMAS * blur_px)) + 2
    low, high = np.floor(outline_px.min(axis=0)).astype(int) - margin, np.ceil(outline_px.max(axis=0)).astype(int)
    high += margin + 1
    if not (low >= 0).all() or not (high <= size_px).all():
        wide = np.ptp(outline_px, axis=0)
        raise InputError(
            f"facet {facet.name} reaches beyond the image: it is {wide[0]:.0f} px x {wide[1]:.0f} px from "
            f"({outline_px[:, 0].min():.0f}, {outline_px[:, 1].min():.0f}) px, the image {size_px[0]} x {size_px[1]} "
            "px; move the mirror (plan.mirror_m), or take a shorter focal length"
        )
    pixels = np.stack(np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1])), axis=-1).astype(np.float64)
    u, v, inside = trace_pixels(setup, cam_from_mirror, facet, pixels.reshape(-1, 2))
    shape = pixels.shape[:2]
    return FacetSight(
        facet,
        slice(low[1], high[1]),
        slice(low[0], high[0]),
        inside.reshape(shape),
        u.reshape(shape),
        v.reshape(shape),
        _cover(pixels, inside.reshape(shape), outline_px, blur_px, margin),
    )


def trace_pixels(
    setup: Setup, cam_from_mirror: RigidTransform, facet: Facet, pixels: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return which point of the screen a facet of design shape shows at pixels (n, 2).

    Returns: u and v as in `screen_hits`, and which pixels see the facet, each (n,).
    """
    cam_from_facet = cam_from_mirror @ facet.ensemble_from_facet
    facet_from_cam = cam_from_facet.inverse()
    camera_m, rays = facet_from_cam.translation_m, facet_from_cam.rotate(setup.camera.cast_rays(pixels))
    points = camera_m + facet.design.intersect(camera_m, rays)[:, None] * rays
    met = np.isfinite(points).all(axis=1)
    normals = np.full(points.shape, np.nan)
    normals[met] = facet.design.normal(points[met, 0], points[met, 1])
    screen_from_facet = setup.cam_from_screen.inverse() @ cam_from_facet
    u, v = screen_hits(setup.screen, screen_from_facet.apply(points), screen_from_facet.rotate(reflect(rays, normals)))
    inside = np.zeros(len(points), dtype=np.bool_)
    inside[met] = facet.contains(points[met, 0], points[met, 1])
    return u, v, inside


def _outline_px(setup: Setup, cam_from_facet: RigidTransform, facet: Facet) -> FloatArray:
    """Return the outline in the image, shape (n, 2) [px]."""
    share = (np.arange(_SIDE_POINTS) / _SIDE_POINTS)[:, None]
    start, end = facet.outline_m[:, None], np.roll(facet.outline_m, -1, axis=0)[:, None]
    plane = (start + share * (end - start)).reshape(-1, 2)
    points = np.column_stack([plane, facet.design.height(plane[:, 0], plane[:, 1])])
    if not np.isfinite(points).all():
        raise InputError(f"facet {facet.name}: the design ({facet.design.name}) does not reach its outline")
    outline = setup.camera.project(cam_from_facet.apply(points))
    if not np.isfinite(outline).all():
        raise InputError(f"facet {facet.name} is partly behind the camera or beyond its lens; check the mirror's place")
    return outline


def _cover(pixels: FloatArray, inside: BoolArray, outline_px: FloatArray, blur_px: float, margin: int) -> Float32Array:
    """Return the share of light (h, w) that pixels get: the blurred edge nearest to each, integrated over its area."""
    from scipy.special import ndtr

    kernel = np.ones((2 * margin + 1, 2 * margin + 1), dtype=np.uint8)
    mask = inside.astype(np.uint8)
    band = (cv2.dilate(mask, kernel) - cv2.erode(mask, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0)) > 0
    cover = inside.astype(np.float32)
    places = pixels[band]
    off = np.concatenate([_off_edge(places[k : k + _BLOCK], outline_px) for k in range(0, len(places), _BLOCK)])
    distance = np.linalg.norm(off, axis=1)
    # From the edge inwards; on an edge itself either side will do.
    inwards = np.where(inside[band], 1.0, -1.0)
    normal = off / np.maximum(distance, 1e-9)[:, None] * inwards[:, None]
    part = (np.arange(_PARTS) + 0.5) / _PARTS - 0.5
    shifts = np.stack(np.meshgrid(part, part), axis=-1).reshape(-1, 2)
    inner = (inwards * distance)[:, None] + normal @ shifts.T
    cover[band] = ndtr(inner / max(blur_px, 0.5 / _PARTS)).mean(axis=1)
    return cover


def _off_edge(places: FloatArray, outline_px: FloatArray) -> FloatArray:
    """Return the way from the nearest point of a closed line of points (m, 2) to places (n, 2), shape (n, 2)."""
    side = np.roll(outline_px, -1, axis=0) - outline_px
    off = places[:, None] - outline_px
    along = np.clip((off * side).sum(axis=2) / (side * side).sum(axis=1), 0.0, 1.0)
    off -= along[..., None] * side
    nearest = (off * off).sum(axis=2).argmin(axis=1)
    return np.asarray(off[np.arange(len(places)), nearest])


def screen_hits(screen: Screen, origins_m: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where rays meet a screen, from its front: u and v (n,), beyond 0 to 1 beside it; NaN where they never do.

    origins_m, directions (n, 3): In the screen's frame.
    """
    u, v = np.full(len(origins_m), 0.5), np.full(len(origins_m), 0.5)
    reach = 0.5
    for number in range(_ROUNDS):
        # First the plane through the quarter points, then planes that touch the screen ever nearer.
        near_u, near_v = (np.clip(one, reach / 2, 1 - reach / 2) for one in (u, v))
        at = screen.points_m(near_u, near_v)
        by_u = (screen.points_m(near_u + reach / 2, near_v) - screen.points_m(near_u - reach / 2, near_v)) / reach
        by_v = (screen.points_m(near_u, near_v + reach / 2) - screen.points_m(near_u, near_v - reach / 2)) / reach
        front = np.cross(by_v, by_u)
        approach = (directions * front).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            length = ((at - origins_m) * front).sum(axis=1) / approach
            off = origins_m + length[:, None] * directions - at
            area = (front * front).sum(axis=1)
            step_u = (np.cross(by_v, off) * front).sum(axis=1) / area
            step_v = (np.cross(off, by_u) * front).sum(axis=1) / area
        u, v = near_u + step_u, near_v + step_v
        if number == 0:
            # A ray that leaves the screen behind, or meets its back, never shows it.
            away = ~((length > 0) & (approach < 0))
        reach = max(reach / 4, 1 / 64)
    u[away] = v[away] = np.nan
    return u, v
