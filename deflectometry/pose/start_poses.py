"""Starting values for the pose of a mirror: from the outline of what is bright, without any from the user."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from deflectometry.pose.mirrors_in_image import FoundMirrors, Region, enclosing_polygon
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform, rotation_between, rotation_from_vector
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import FloatArray

#: Outlines with more corners than this are matched by their moments; a polygon fit would pick corners at random.
_MAX_CORNERS = 6
#: A side that bends by less than this share of the mirror's size is one side.
_STRAIGHT = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class PoseStart:
    """A first pose and how well it explains the outline.

    rms_px: RMS distance of the corners [px].
    """

    cam_from_mirror: RigidTransform
    rms_px: float


def mirror_regions(found: FoundMirrors, n_facets: int) -> list[Region]:
    """Choose the regions that are facets: the largest ones; refuse those that the image border cuts.

    found: Bright regions, largest first.
    EstimationError: A region touches the border of the image.
    """
    regions = list(found.regions[:n_facets])
    cut = next((region for region in regions if region.borders), None)
    if cut is not None:
        raise EstimationError(
            f"the mirror touches the {' and '.join(cut.borders)} border of the image, so its outline is not complete;"
            " turn the camera until all edges are in view, or give the pose in [mirror.pose]"
        )
    return regions


def start_poses(camera: Camera, regions: Sequence[Region], facets: Sequence[Facet], roll_rad: float) -> list[PoseStart]:
    """Find the poses that explain the outline of the bright regions, best orientation only.

    roll_rad: Expected angle from the image's x axis to the mirror's x axis, counter-clockwise as displayed [rad].
    Returns: Up to two poses: a flat object in weak perspective looks the same in two tilts.
    InputError: A design that does not reach its outline.
    EstimationError: The outline has fewer corners than the mirror, or no pose explains it.

    Which corner is which cannot be seen on a square: of the assignments that explain the corners, the one with the
    roll nearest to the expected one is taken.
    """
    contour = np.concatenate([region.contour_px for region in regions])
    corners_m, hull_m = _hull_corners(facets)
    if len(corners_m) <= _MAX_CORNERS:
        # Contours run through the centres of the outermost pixels, the edge lies half a pixel further out.
        image = _grown(enclosing_polygon(contour, len(corners_m)), 0.5)
        # Counter-clockwise with y up is the other way round in the image.
        ordered = image[::-1]
        pairs = [(corners_m, np.roll(ordered, shift, axis=0)) for shift in range(len(ordered))]
    else:
        pairs = [(corners_m, _by_moments(camera, hull_m, corners_m, contour, roll_rad))]
    tried = [_planar_poses(camera, model, image) for model, image in pairs]
    tried = [poses for poses in tried if poses]
    if not tried:
        raise EstimationError("no pose of the mirror explains its outline in the image; check outline_m and the camera")
    best = min(poses[0].rms_px for poses in tried)
    size_px = float(np.ptp(contour, axis=0).max())
    # Twice the best, and 1 % of the size: what a polygon around pixels may be off by.
    plausible = [poses for poses in tried if poses[0].rms_px <= 2 * best + 0.01 * size_px]
    return min(plausible, key=lambda poses: abs(_roll_off(poses[0].cam_from_mirror, roll_rad)))


def _roll_off(pose: RigidTransform, roll_rad: float) -> float:
    axis = pose.rotation[:, 0]
    off = np.arctan2(-axis[1], axis[0]) - roll_rad
    return float(np.arctan2(np.sin(off), np.cos(off)))


def _hull_corners(facets: Sequence[Facet]) -> tuple[FloatArray, FloatArray]:
    """Return the mirror's outer corners (n, 3), counter-clockwise from the front, and its whole hull (m, 3)."""
    for facet in facets:
        if not np.isfinite(facet.corners_m).all():
            raise InputError(
                f"facet {facet.name}: the design ({facet.design.describe()}) does not reach its outline; check the "
                "design's radius or focal length, outline_m and design_center_m (all in metres)"
            )
    points = np.concatenate([facet.ensemble_from_facet.apply(facet.corners_m) for facet in facets])
    order = cv2.convexHull(points[:, :2].astype(np.float32), clockwise=False, returnPoints=False).ravel()
    hull = points[order]
    following = np.roll(hull, -1, axis=0)
    if (hull[:, 0] * following[:, 1] - hull[:, 1] * following[:, 0]).sum() < 0:
        hull = hull[::-1]
    size = float(np.ptp(hull[:, :2], axis=0).max())
    kept = cv2.approxPolyDP(hull[:, :2].astype(np.float32).reshape(-1, 1, 2), _STRAIGHT * size, True).reshape(-1, 2)
    distance = np.linalg.norm(hull[None, :, :2] - kept[:, None], axis=-1)
    return hull[np.sort(distance.argmin(axis=1))], hull


def _grown(polygon: FloatArray, by_px: float) -> FloatArray:
    center = polygon.mean(axis=0)
    radius = np.linalg.norm(polygon - center, axis=1, keepdims=True)
    return np.asarray(center + (polygon - center) * (1 + by_px * np.sqrt(2) / radius))


def _by_moments(
    camera: Camera, hull_m: FloatArray, corners_m: FloatArray, contour: FloatArray, roll_rad: float
) -> FloatArray:
    """Where the corners would be if the contour were an affine image of the hull, by centroid and second moments."""
    image = cv2.convexHull(contour.astype(np.float32)).reshape(-1, 2).astype(np.float64)
    model_center, model_root = _moments(hull_m[:, :2])
    image_center, image_root = _moments(image)
    turn = np.array([[np.cos(roll_rad), -np.sin(roll_rad)], [-np.sin(roll_rad), -np.cos(roll_rad)]])
    affine = image_root @ turn @ np.linalg.inv(model_root)
    return np.asarray((corners_m[:, :2] - model_center) @ affine.T + image_center)


def _moments(polygon: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centroid and symmetric root of the second moments of a polygon's area."""
    moments = cv2.moments((polygon - polygon.mean(axis=0)).astype(np.float32).reshape(-1, 1, 2))
    area = moments["m00"]
    center = np.array([moments["m10"], moments["m01"]]) / area
    second = np.array([[moments["mu20"], moments["mu11"]], [moments["mu11"], moments["mu02"]]]) / area
    values, vectors = np.linalg.eigh(second)
    return center + polygon.mean(axis=0), np.asarray(vectors * np.sqrt(values) @ vectors.T)


def _planar_poses(camera: Camera, model_m: FloatArray, image_px: FloatArray) -> list[PoseStart]:
    """Both poses of a nearly flat set of points, the better first; only those that show the front."""
    rays = camera.cast_rays(image_px)
    if not np.isfinite(rays).all():
        return []
    center = model_m.mean(axis=0)
    # Flat in its own plane: a panel 1 m off a trough's vertex leans by 0.3 rad in the frame of its optic.
    normal = np.linalg.svd(model_m - center)[2][2]
    plane_from_mirror = rotation_between(normal * np.copysign(1.0, normal[2]), [0.0, 0.0, 1.0])
    flat = (model_m - center) @ plane_from_mirror.T
    flat[:, 2] = 0.0
    directions = rays[:, :2] / rays[:, 2:]
    beside_from_plane = _beside_image(flat, directions)
    flat = flat @ beside_from_plane.T
    if len(flat) == 3:
        # Three points fit up to four poses exactly; IPPE needs a fourth.
        count, vectors, shifts = cv2.solveP3P(flat, directions, np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_P3P)
    else:
        count, vectors, shifts, _ = cv2.solvePnPGeneric(
            flat, directions, np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_IPPE
        )
        if not np.isfinite(vectors).any():
            # IPPE takes the root of a rounding error where nothing is foreshortened: both tilts are one.
            done, vector, shift = cv2.solvePnP(flat, directions, np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_SQPNP)
            count, vectors, shifts = int(done), (vector,), (shift,)
    poses = []
    for number in range(int(count)):
        vector, shift = np.asarray(vectors[number]).ravel(), np.asarray(shifts[number]).ravel()
        if not (np.isfinite(vector).all() and np.isfinite(shift).all()):
            continue
        from_plane = RigidTransform.from_rotation_vector(vector, shift).rotation @ beside_from_plane
        rotation = from_plane @ plane_from_mirror
        pose = RigidTransform(rotation, shift - rotation @ center)
        # The front shows where the normal points against the line of sight.
        if shift[2] > 0 and float(from_plane[:, 2] @ shift) < 0:
            off = camera.project(pose.apply(model_m)) - image_px
            poses.append(PoseStart(pose, float(np.sqrt((off**2).sum(axis=1).mean()))))
    return sorted((pose for pose in poses if np.isfinite(pose.rms_px)), key=lambda pose: pose.rms_px)


def _beside_image(flat_m: FloatArray, directions: FloatArray) -> FloatArray:
    """Return the turn (3, 3) of a flat set of points, seen from the front, to a quarter turn from how its image lies.

    IPPE of OpenCV loses rotation vectors of no turn (NaN) and of half turns (zero), both of which are common: a square
    that faces the camera. From a quarter turn in the image a tilt of less than a right angle leads to neither: the
    whole turn is one of 90 to 120 degrees.
    """
    half_turn = np.diag([1.0, -1.0, -1.0])
    model = (flat_m @ half_turn)[:, :2] @ [1.0, 1.0j]
    image = (directions - directions.mean(axis=0)) @ [1.0, 1.0j]
    roll = np.angle(np.vdot(model, image)) - np.pi / 2
    return np.asarray(rotation_from_vector([0.0, 0.0, roll]) @ half_turn)


def point_poses(camera: Camera, points_m: FloatArray, image_px: FloatArray) -> list[PoseStart]:
    """Find start poses from known points.

    Shapes: image_px (n, 2).
    points_m (n, 3): Points in the mirror's frame [m].
    Returns: The poses found, best first.
    EstimationError: Fewer than four points, all on one line, or no pose.
    """
    if len(points_m) < 4:
        raise EstimationError(
            f"{len(points_m)} known points do not determine the mirror's pose; 4 that are not on one line are needed"
        )
    spread, axes = np.linalg.svd(points_m - points_m.mean(axis=0), full_matrices=False)[1:]
    if spread[1] < 1e-3 * spread[0]:
        raise EstimationError("the known points lie on one line, so they do not determine the mirror's pose; add one")
    rays = camera.cast_rays(image_px)
    poses: list[PoseStart] = []
    if spread[2] < 0.05 * spread[1]:
        # Nearly flat: look at it in its own plane, both ways round for the sign of the third axis.
        plane_from_mirror = RigidTransform(axes * np.sign(np.linalg.det(axes)), np.zeros(3))
        found = _planar_poses_any_side(camera, plane_from_mirror.apply(points_m), image_px)
        poses = [PoseStart(start.cam_from_mirror @ plane_from_mirror, start.rms_px) for start in found]
    else:
        done, vector, shift = cv2.solvePnP(
            points_m, rays[:, :2] / rays[:, 2:], np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_SQPNP
        )
        if done:
            pose = RigidTransform.from_rotation_vector(vector.ravel(), shift.ravel())
            off = camera.project(pose.apply(points_m)) - image_px
            poses.append(PoseStart(pose, float(np.sqrt((off**2).sum(axis=1).mean()))))
    poses = sorted((start for start in poses if np.isfinite(start.rms_px)), key=lambda start: start.rms_px)
    if not poses:
        raise EstimationError("no pose of the mirror explains its known points; check their coordinates and order")
    return poses


def _planar_poses_any_side(camera: Camera, model_m: FloatArray, image_px: FloatArray) -> list[PoseStart]:
    half_turn = RigidTransform(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    front = _planar_poses(camera, model_m, image_px)
    back = _planar_poses(camera, half_turn.apply(model_m), image_px)
    return front + [PoseStart(pose.cam_from_mirror @ half_turn, pose.rms_px) for pose in back]
