"""A mirror whose outline nobody gave: its outline from the image, its pose from the reflection and a distance."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from deflectometry.pose.mirrors_in_image import find_mirrors, measure_edges
from deflectometry.pose.outline_edges import edge_margin_px
from deflectometry.pose.pose_observations import DistanceObservation, Knowledge
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.sources.screen_map import ScreenMap
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform, rotation_between, rotation_from_vector
from heliogauge.geometry.surfaces import Facet, Quadric, plane
from heliogauge.validate import BoolArray, Float32Array, FloatArray

#: Corners of the outline polygon: a circle of 1.2 m drawn with 72 corners is right to 0.6 mm.
OUTLINE_CORNERS = 72


@dataclass(frozen=True, slots=True, eq=False)
class ImageOutline:
    """What the image alone shows of a mirror.

    region (h, w): Its pixels.
    contour_px (n, 2): Corners of its outline (x, y) [px].
    centroid_px (2,): Its middle (x, y) [px].
    margin_px: Distance to the outline below which a pixel mixes the mirror with its surroundings [px].
    edge_width_px: Width of its edges; NaN without any [px].
    """

    region: BoolArray
    contour_px: FloatArray
    centroid_px: FloatArray
    margin_px: float
    edge_width_px: float

    def pose(
        self, screen_map: ScreenMap, knowledge: Knowledge, design: Quadric, setup: Setup
    ) -> tuple[RigidTransform, FloatArray]:
        """Find the pose whose middle is at the measured distance and whose design reflects there as measured.

        screen_map: Display point of each pixel.
        knowledge: Exactly one distance, from the middle of the mirror to the origin of the screen; and the expected
            roll.
        design: Its design, origin in the middle of what is seen.
        setup: Camera and screen.
        cam_from_mirror: The design's normal in the middle is the one that reflects as measured; x is level in the
            image but for the roll.
        covariance (6, 6): Of the distance; the orientation is that of the reflection itself.
        InputError: No distance was given, or one to another point than the middle.
        EstimationError: The middle shows no fringes, or no point of its line of sight has this distance.
        """
        distances = knowledge.distances
        if len(distances) != 1:
            raise InputError(
                "[mirror]: without outline_m the pose needs [mirror.distance] (from the middle of the mirror to the "
                "origin of the screen) or [mirror.pose]"
            )
        if distances[0].mirror_point_m.any():
            raise InputError(
                f"[mirror.distance]: point_m = {distances[0].mirror_point_m.tolist()}, but without outline_m the"
                " distance must be to the middle of what is seen of the mirror; leave point_m out, or give outline_m"
            )
        usable = np.argwhere(self.region & (screen_map.flags == 0))
        if not len(usable):
            raise EstimationError("no pixel of the mirror shows fringes; check screen, exposure and pattern")
        row, column = usable[np.argmin(((usable[:, ::-1] - self.centroid_px) ** 2).sum(axis=1))]
        ray = setup.camera.cast_rays(np.array([float(column), float(row)]))
        screen = setup.cam_from_screen.apply(
            setup.screen.points_m(screen_map.u[row, column], screen_map.v[row, column])
        )
        # To the screen of this setup, wherever it stands.
        distance = replace(distances[0], cam_point_m=setup.cam_from_screen.translation_m)
        point, stretch = _at_distance(ray, distance)
        to_screen, to_camera = screen - point, -point
        z_axis = to_screen / np.linalg.norm(to_screen) + to_camera / np.linalg.norm(to_camera)
        z_axis /= np.linalg.norm(z_axis)
        x_axis = np.array([1.0, 0.0, 0.0]) - z_axis[0] * z_axis
        x_axis /= np.linalg.norm(x_axis)
        upright = np.column_stack([x_axis, np.cross(z_axis, x_axis), z_axis])
        # The design of a facet off its optic's vertex may lean in the facet's frame.
        straight = rotation_between(design.normal(0.0, 0.0), [0.0, 0.0, 1.0])
        rotation = upright @ rotation_from_vector([0.0, 0.0, knowledge.roll_rad]) @ straight
        origin = point - rotation[:, 2] * float(design.height(0.0, 0.0))
        along = np.concatenate([np.zeros(3), ray * stretch * distance.sigma_m])
        return RigidTransform(rotation, origin), np.outer(along, along)

    def facet(self, name: str, design: Quadric, camera: Camera, cam_from_mirror: RigidTransform) -> Facet:
        """Carry the outline in the image onto the mirror.

        design: Its design, origin in the middle of what is seen.
        Returns: The mirror with the outline that was seen, its reference point at the origin.
        """
        mirror_from_cam = cam_from_mirror.inverse()
        rays = mirror_from_cam.rotate(camera.cast_rays(self.contour_px))
        start = mirror_from_cam.translation_m
        points = start + design.intersect(start, rays)[:, None] * rays
        if np.isnan(points).any():
            points = start + plane().intersect(start, rays)[:, None] * rays
        corners = points[:, :2]
        following = np.roll(corners, -1, axis=0)
        turns_left = float((corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0]).sum()) > 0
        return Facet(name, corners if turns_left else corners[::-1], design, reference_point_m=np.zeros(2))


def outline_from_image(image_dn: Float32Array) -> ImageOutline:
    """Take the largest bright region as the mirror.

    image_dn (h, w): Bright minus dark, or modulation [DN].
    EstimationError: No mirror in view, or it is cut by the border.
    """
    found = find_mirrors(image_dn)
    largest = found.regions[0]
    if largest.borders:
        raise EstimationError(
            f"the mirror touches the {' and '.join(largest.borders)} border of the image; show it whole"
        )
    contour = largest.contour_px.astype(np.int32).reshape(-1, 1, 2)
    region = np.zeros(image_dn.shape, dtype=np.uint8)
    cv2.drawContours(region, [contour], -1, 1, cv2.FILLED)
    corners = _evenly(largest.contour_px, OUTLINE_CORNERS)
    tangents = np.roll(corners, -1, axis=0) - np.roll(corners, 1, axis=0)
    normals = np.stack([tangents[:, 1], -tangents[:, 0]], axis=1) / np.linalg.norm(tangents, axis=1)[:, None]
    away = ((corners - largest.centroid_px) * normals).sum(axis=1, keepdims=True)
    normals = np.where(away < 0, -normals, normals)
    reach = max(0.02 * np.sqrt(largest.area_px), 3.0)
    edges = measure_edges(image_dn, corners, normals, reach_px=reach, noise_dn=found.noise_dn, width_px=None)
    corners = corners + np.nan_to_num(edges.offset_px)[:, None] * normals
    width = float(np.nan_to_num(edges.width_px))
    # No outline to say where the edge is: a quarter of a pixel more.
    margin_px = edge_margin_px(width, 0.25)
    return ImageOutline(region.astype(bool), corners, largest.centroid_px, margin_px, edges.width_px)


def _evenly(contour_px: FloatArray, count: int) -> FloatArray:
    """Pick points at equal arc lengths along a closed contour, shape (count, 2) [px]."""
    closed = np.vstack([contour_px, contour_px[:1]])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    at = np.linspace(0.0, length[-1], count, endpoint=False)
    return np.stack([np.interp(at, length, closed[:, axis]) for axis in (0, 1)], axis=1)


def _at_distance(ray: FloatArray, distance: DistanceObservation) -> tuple[FloatArray, float]:
    """Return the point of a line of sight at a distance from a known point, and how far it moves per metre of that."""
    along = float(ray @ distance.cam_point_m)
    rest = distance.distance_m**2 - float(distance.cam_point_m @ distance.cam_point_m) + along**2
    if rest <= 0:
        raise EstimationError(
            f"[mirror.distance]: no point on the line of sight is {distance.distance_m:g} m from the screen's origin; "
            "check distance_m and the pose of the screen"
        )
    return (along + np.sqrt(rest)) * ray, distance.distance_m / float(np.sqrt(rest))
