"""What photos of a heliostat of design shape will show of a source: where its edge falls, and the light."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from deflectometry.overlay.camera_place import Station, place_camera
from deflectometry.overlay.facet_sight import LEAST_NOISE_DN, pixels_within
from deflectometry.overlay.planning.keys import OverlayPlanSection
from deflectometry.overlay.source_image import FacetPixels, Source, outline_px, seen_places
from deflectometry.overlay.turn_fit import FacetView
from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform, looking_at
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import BoolArray, FloatArray

#: Points of a source's edge that are looked for in a facet.
_EDGE_POINTS = 96
#: Fewest points of known place for the pose of a camera.
_FEWEST_POINTS = 4


@dataclass(frozen=True, slots=True, eq=False)
class FacetInPhoto:
    """Where one facet as designed looks in one photo.

    edge_share: Share of the source's edge that it shows.
    room_rad: How far it may be turned either way before it cuts off the source's image; negative: it does already.
    off_m (2,): Place in the source's plane, from the source's middle, at which its middle looks [m].
    words: Why it shows none of the edge; empty where it shows some.
    """

    photo: str
    facet: str
    edge_share: float
    room_rad: float
    off_m: FloatArray
    words: str


def planned_pose(facets: Sequence[Facet], place_m: FloatArray) -> RigidTransform:
    """Return the pose of a camera at a place that looks at the middle of the heliostat, its top up."""
    middle = np.mean([one.ensemble_from_facet.apply(_middle(one)) for one in facets], axis=0)
    return looking_at(place_m, middle, np.array([0.0, 1.0, 0.0]))


def predicted_station(
    camera: Camera, pose: RigidTransform, facets: Sequence[Facet], sigma_px: float, photo: str
) -> Station:
    """Place a camera by the corners of the facets that its photo will show.

    InputError: The photo shows too few of them.
    EstimationError: As for `place_camera`.
    """
    corners = np.concatenate([one.ensemble_from_facet.apply(_solid(one, one.outline_m)) for one in facets])
    pixels = camera.project(pose.apply(corners))
    shown = _in_image(camera, pixels)
    if np.count_nonzero(shown) < _FEWEST_POINTS:
        raise InputError(
            f"photo {photo}: it shows {np.count_nonzero(shown)} of {len(corners)} corners of facets, at least "
            f"{_FEWEST_POINTS} are needed; go farther away, or take a shorter focal length"
        )
    return place_camera(camera, corners[shown], pixels[shown], sigma_px, f"photo {photo}")


def sight_of(camera: Camera, pose: RigidTransform, facet: Facet, source: Source, photo: str) -> FacetInPhoto:
    """Return how much of the source's edge a facet as designed shows in a photo."""
    middle = camera.project(pose.apply(facet.ensemble_from_facet.apply(_middle(facet)))[None])
    off = seen_places(FacetPixels.of(camera, pose, facet, middle), facet, np.zeros(2), source)[:, 0]

    def unseen(words: str) -> FacetInPhoto:
        return FacetInPhoto(photo, facet.name, 0.0, np.nan, off, words)

    facet_from_cam = (pose @ facet.ensemble_from_facet).inverse()
    if not (facet_from_cam.translation_m - _middle(facet)) @ facet.design.normal(*facet.reference_point_m) > 0:
        return unseen("its back is seen")
    used = pixels_within(camera, pose, facet)
    if used is None:
        return unseen("too little of it is in the image")
    outline = cv2.convexHull(used[1].pixels_px.astype(np.float32))[:, 0].astype(np.float64)
    seen = seen_places(FacetPixels.of(camera, pose, facet, outline), facet, np.zeros(2), source)
    if not np.isfinite(seen).all():
        return unseen("it looks away from the source")
    ring = np.ascontiguousarray(seen.T, dtype=np.float32)
    inside = np.array([cv2.pointPolygonTest(ring, place, True) for place in _edge(source).tolist()])
    share = float(np.mean(inside > 0))
    reach = np.linalg.norm(source.heliostat_from_source.translation_m - facet.ensemble_from_facet.apply(_middle(facet)))
    # A turn moves the reflected line of sight by twice as much.
    room = float(inside.min() / (2 * reach))
    if share > 0:
        return FacetInPhoto(photo, facet.name, share, room, off, "")
    if _covers(source, seen):
        return FacetInPhoto(photo, facet.name, 0.0, room, off, "the source fills it")
    away = f"it looks {np.hypot(*off):.2g} m past the source's middle, by ({off[0]:+.2g}, {off[1]:+.2g}) m"
    if not _in_image(camera, outline_px(camera, pose, facet)).all():
        away += ", and only a part of it is in the image"
    return FacetInPhoto(photo, facet.name, 0.0, room, off, away)


def predicted_view(
    camera: Camera,
    photo: int,
    pose: RigidTransform,
    station: Station,
    facet: Facet,
    source: Source,
    plan: OverlayPlanSection,
) -> FacetView | None:
    """Return the pixels of a facet of design shape in a photo, without noise in their light but with its sigma.

    photo: Its number. pose: From the heliostat to the camera as it will stand. station: Where its points place it.
    Returns: None where too few pixels see the facet.
    """
    seen = pixels_within(camera, station.cam_from_heliostat, facet)
    if seen is None:
        return None
    pixels = seen[1].pixels_px
    places, beside = (
        seen_places(FacetPixels.of(camera, pose, facet, pixels + by), facet, np.zeros(2), source)
        for by in (0.0, [1.0, 0.0])
    )
    blur = plan.blur_px * float(np.nanmedian(np.hypot(*(beside - places))))
    light = plan.contrast_dn * source.brightness(np.nan_to_num(places, nan=1e6), blur)
    return FacetView(photo, seen[1], light, max(plan.noise_dn, LEAST_NOISE_DN))


def _middle(facet: Facet) -> FloatArray:
    """Return the facet's reference point on its surface, in its frame, shape (3,) [m]."""
    return np.asarray(_solid(facet, np.array([facet.reference_point_m]))[0])


def _solid(facet: Facet, plane_m: FloatArray) -> FloatArray:
    return np.column_stack([plane_m, facet.design.height(plane_m[:, 0], plane_m[:, 1])])


def _in_image(camera: Camera, pixels: FloatArray) -> BoolArray:
    """Return which points (n, 2) are in the image; not those that are NaN."""
    size = np.array([camera.width_px, camera.height_px])
    with np.errstate(invalid="ignore"):
        return np.asarray(((pixels >= -0.5) & (pixels <= size - 0.5)).all(axis=1))


def _edge(source: Source) -> FloatArray:
    """Return points of the source's edge in its plane, shape (n, 2) [m]."""
    if source.is_disc:
        angle = 2 * np.pi * np.arange(_EDGE_POINTS) / _EDGE_POINTS
        return source.half_m[0] * np.column_stack([np.cos(angle), np.sin(angle)])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array(source.half_m)
    share = (np.arange(_EDGE_POINTS // 4) / (_EDGE_POINTS // 4))[:, None]
    sides = [a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    return np.concatenate(sides)


def _covers(source: Source, seen_m: FloatArray) -> bool:
    """Return whether all places (2, n) are on the source."""
    if source.is_disc:
        return bool((np.hypot(*seen_m) < source.half_m[0]).all())
    return bool((np.abs(seen_m) < np.array(source.half_m)[:, None]).all())
