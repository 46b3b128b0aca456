"""What uncertain camera poses do to the touching lines of sight, in the few combinations that matter."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import FloatArray, IntArray
from observer.photo_edges.views import View
from observer.slopes.panel_places import PanelPlaces
from observer.trough.observation_equation import Misfit, Sights, gradient_on_mirror

#: Combinations of a pose's six movements that are kept. The first is the camera's place across the trough with the
#: mirror held in the image, the second its place in the image; the third keeps what all photos and the tube do together
#: where the targets lean or stand aside: with two, 1 % of that is left over and looks as if the reflection told where
#: the tube is, to 0.2 mm.
MODES_PER_PHOTO = 3


@dataclass(frozen=True, slots=True, eq=False)
class Photos:
    """Poses of all photos.

    poses: ``cam_from_frame`` of each.
    covariance (6 n, 6 n): Joint covariance of their steps (`RigidTransform.moved`) [rad, m].
    with_tube (2 k, 6 n): Covariance of the absorber's k stations (all x, then all z) with those steps; none without
        [m rad, m^2].
    moving: Views of cameras that move while they read a frame; none where all rows are read at once.
    panels: How high the panels are, where their edges in the photos say so; only their mounting is known otherwise.
    """

    poses: tuple[RigidTransform, ...]
    covariance: FloatArray
    with_tube: FloatArray | None = None
    moving: tuple[View, ...] = ()
    panels: PanelPlaces | None = None

    @property
    def eyes_m(self) -> FloatArray:
        """Centres of the cameras, shape (n, 3) [m]."""
        return -np.array([pose.rotation.T @ pose.translation_m for pose in self.poses])

    def eyes_of(self, points_m: FloatArray, photo: IntArray) -> FloatArray:
        """Return where the camera was when it took points.

        Shapes: points_m (m, 3), photo (m,), result (m, 3) [m].
        """
        eyes = self.eyes_m[photo]
        if not self.moving:
            return eyes
        for view, some in zip(self.moving, _rows_of(photo, len(self.moving)), strict=True):
            eyes[some] = view.eyes_at(view.project(points_m[some]))
        return eyes


@dataclass(frozen=True, slots=True, eq=False)
class CameraModes:
    """Unknowns of all photos that stand for their poses.

    index (m, MODES_PER_PHOTO): Unknowns that move each line.
    derivative (m, MODES_PER_PHOTO): By how much [rad].
    covariance (c, c): Prior covariance of the unknowns; 1 on its diagonal.
    steps (n, 6, MODES_PER_PHOTO): Step of each photo's pose (`RigidTransform.moved`) for one unit of its unknowns
        [rad, m].
    reading (n, MODES_PER_PHOTO, 6): The unknowns of each photo from a step of its pose.
    """

    index: IntArray
    derivative: FloatArray
    covariance: FloatArray
    steps: FloatArray
    reading: FloatArray

    def with_steps(self, covariance: FloatArray) -> FloatArray:
        """Return the covariance of the unknowns with the steps of all poses.

        Shapes: result (c, 6 n).
        covariance (6 n, 6 n): Joint covariance of the steps, as these modes were made of.
        """
        blocks = covariance.reshape(len(self.reading), 6, -1)
        return np.asarray((self.reading @ blocks).reshape(len(self.covariance), -1))

    def read(self, with_steps: FloatArray) -> FloatArray:
        """Return the covariance of something with the unknowns.

        Shapes: with_steps (k, 6 n), result (k, c).
        """
        blocks = np.swapaxes(with_steps.reshape(len(with_steps), len(self.reading), 6), 0, 1)
        parts = blocks @ np.swapaxes(self.reading, 1, 2)
        return np.asarray(np.swapaxes(parts, 0, 1).reshape(len(with_steps), -1))


def pose_derivatives(
    sights: Sights,
    found: Misfit,
    poses: Sequence[RigidTransform],
    photo: IntArray,
    focal_length_m: float,
    bend_per_m: FloatArray | float = 0.0,
) -> FloatArray:
    """Differentiate the misfit of lines of sight with respect to their photo's pose, the pixel held.

    Shapes: photo (m,).
    poses: ``cam_from_frame`` of each photo.
    focal_length_m: Focal length of the mirror, whose curvature turns the normal where the line moves along it [m].
    bend_per_m (m,): Curvature across that the mirror has beside that: change of the slope's error [1/m].
    Returns (m, 6): Derivatives with respect to the steps of `RigidTransform.moved` [rad/rad, rad/m].
    """
    points, sight = sights.points_m, sights.eyes_m - sights.points_m
    gradient = gradient_on_mirror(sights, found, focal_length_m, bend_per_m)
    # A ray that moves by r moves the point where it meets the mirror by r - s (n.r) / (n.s), s the line of sight.
    across = (np.einsum("mi,mi->m", gradient, sight)) / (
        sight[:, 2] - points[:, 0] / (2 * focal_length_m) * sight[:, 0]
    )
    by_ray = gradient
    by_ray[:, 0] += across * points[:, 0] / (2 * focal_length_m)
    by_ray[:, 2] -= across
    # A step (w, d) moves the eye by -R^T ([t]x w + d) and the ray by R^T ([R p]x w - d) = (R^T w) x p - R^T d.
    (r_x, r_y, r_z), (p_x, p_y, p_z) = by_ray.T, points.T
    local = np.empty((len(points), 9))
    local[:, 0], local[:, 1], local[:, 2] = r_z * p_y - r_y * p_z, r_x * p_z - r_z * p_x, r_y * p_x - r_x * p_y
    local[:, 3:6], local[:, 6:] = found.d_angle_d_eye, by_ray
    return _by_photo(local, photo, np.array([_turned_into_steps(pose) for pose in poses]))


def pose_scatter(derivatives: FloatArray, photo: IntArray, covariance: FloatArray) -> FloatArray:
    """Return the variance that uncertain poses make in each line's angle.

    Shapes: derivatives (m, 6), photo (m,), result (m,).
    covariance (6 n, 6 n): Joint covariance of the steps of all n poses.
    """
    return np.asarray((_by_photo(derivatives, photo, _own_blocks(covariance)) * derivatives).sum(axis=1))


def _own_blocks(covariance: FloatArray) -> FloatArray:
    """Return the covariance of the steps of each pose alone, shape (n, 6, 6)."""
    count = len(covariance) // 6
    return covariance.reshape(count, 6, count, 6)[np.arange(count), :, np.arange(count)]


def _turned_into_steps(pose: RigidTransform) -> FloatArray:
    """Return what turns derivatives by turn, eye and ray in the frame, one row, into those by a step of the pose."""
    back, (t_x, t_y, t_z) = pose.rotation.T, pose.translation_m
    table = np.zeros((9, 6))
    table[:3, :3] = -back
    table[3:6, :3] = back @ np.array([[0.0, t_z, -t_y], [-t_z, 0.0, t_x], [t_y, -t_x, 0.0]])
    table[3:6, 3:] = table[6:, 3:] = -back
    return table


def _by_photo(values: FloatArray, photo: IntArray, tables: FloatArray) -> FloatArray:
    """Multiply each row of values, shape (m, k), with the table, (n, k, l), of its photo."""
    result = np.empty((len(values), tables.shape[2]))
    for table, some in zip(tables, _rows_of(photo, len(tables)), strict=True):
        result[some] = values[some] @ table
    return result


def _rows_of(photo: IntArray, count: int) -> list[IntArray | slice]:
    """Return where the lines of each of n photos stand: slices where photos follow each other."""
    if (np.diff(photo) >= 0).all():
        bounds = np.searchsorted(photo, np.arange(count + 1))
        return [slice(first, last) for first, last in pairwise(bounds)]
    order = np.argsort(photo, kind="stable")
    bounds = np.searchsorted(photo[order], np.arange(count + 1))
    return [order[first:last] for first, last in pairwise(bounds)]


def reduce_to_modes(derivatives: FloatArray, photo: IntArray, covariance: FloatArray) -> CameraModes:
    """Keep the combinations of pose movements that move the lines most, in units of their standard deviation.

    Shapes: derivatives (m, 6), photo (m,).
    covariance (6 n, 6 n): Joint covariance of the steps of all n poses.
    """
    count = len(covariance) // 6
    index = MODES_PER_PHOTO * photo[:, None] + np.arange(MODES_PER_PHOTO)
    blocks = _own_blocks(covariance)
    scale = np.sqrt(np.maximum(np.diagonal(blocks, axis1=1, axis2=2), 1e-30))
    values, vectors = np.linalg.eigh(blocks / (scale[:, :, None] * scale[:, None, :]))
    values = np.maximum(values, 1e-12 * values.max(axis=1, keepdims=True))
    root = scale[:, :, None] * vectors * np.sqrt(values)[:, None, :]
    back = np.swapaxes(vectors / np.sqrt(values)[:, None, :], 1, 2) / scale[:, None, :]
    effect = _by_photo(derivatives, photo, root)
    products = np.stack([effect[some].T @ effect[some] for some in _rows_of(photo, count)])
    strongest = np.linalg.eigh(products)[1][:, :, ::-1][:, :, :MODES_PER_PHOTO]
    steps, reading = root @ strongest, np.swapaxes(strongest, 1, 2) @ back
    # Each photo's unknowns read its own six movements only: blocks, not a product of whole matrices.
    half = reading @ covariance.reshape(count, 6, 6 * count)
    joint = reading @ np.swapaxes(half.reshape(-1, 6 * count), 0, 1).reshape(count, 6, -1)
    joint = joint.reshape(MODES_PER_PHOTO * count, -1)
    return CameraModes(index, _by_photo(derivatives, photo, steps), 0.5 * (joint + joint.T), steps, reading)
