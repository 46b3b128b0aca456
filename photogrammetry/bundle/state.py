"""What a bundle adjustment estimates: intrinsics of every camera, pose of every photo, coordinates of every target."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform, skew
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, float_array

#: Intrinsics as an adjustment varies them; ``focal_px`` is that of the rows, ``focal_x_px = focal_px / (1 + aspect)``.
INTRINSIC_NAMES = ("focal_px", "aspect", "center_x_px", "center_y_px", "skew", "k1", "k2", "p1", "p2", "k3")


def intrinsics_of(camera: Camera) -> FloatArray:
    """Return the values of `INTRINSIC_NAMES`, shape (10,)."""
    values = camera.parameters.copy()
    values[0], values[1] = camera.focal_y_px, camera.focal_y_px / camera.focal_x_px - 1
    return values


def camera_with_intrinsics(camera: Camera, values: FloatArray) -> Camera:
    """Return the camera with other values of `INTRINSIC_NAMES`, shape (10,); the covariance stays."""
    parameters = np.array(values, dtype=np.float64)
    parameters[0], parameters[1] = values[0] / (1 + values[1]), values[0]
    return camera.with_parameters(parameters)


def d_parameters_d_intrinsics(camera: Camera) -> FloatArray:
    """Return the derivative of the camera's own parameters with respect to `INTRINSIC_NAMES`, shape (10, 10)."""
    jacobian = np.eye(10)
    ratio = camera.focal_x_px / camera.focal_y_px
    jacobian[0, 0], jacobian[0, 1] = ratio, -camera.focal_x_px * ratio
    jacobian[1, 0], jacobian[1, 1] = 1.0, 0.0
    return jacobian


@dataclass(frozen=True, slots=True, eq=False)
class BundleState(ShortRepr):
    """Cameras, poses and points.

    cameras: One for each physical camera.
    rotations (p, 3, 3): Rotation of ``cam_from_world`` for each photo.
    translations_m (p, 3): Its translation [m].
    points_m (n, 3): Targets in the world frame [m].
    """

    cameras: tuple[Camera, ...]
    rotations: FloatArray
    translations_m: FloatArray
    points_m: FloatArray

    def cam_from_world(self, photo: int) -> RigidTransform:
        """Return the pose of one photo."""
        return RigidTransform(self.rotations[photo], self.translations_m[photo])

    @property
    def centers_m(self) -> FloatArray:
        """Projection centres in the world frame, shape (p, 3) [m]."""
        return np.asarray(-np.einsum("pji,pj->pi", self.rotations, self.translations_m))

    @classmethod
    def from_poses(
        cls, cameras: Sequence[Camera], poses: Sequence[RigidTransform], points_m: FloatArray
    ) -> "BundleState":
        """Build a state from poses ``cam_from_world`` of p photos and points (n, 3).

        InputError: A point is not finite, or there is no camera or photo.
        """
        if not poses or not cameras:
            raise InputError("bundle: at least one camera and one photo are needed")
        rotations = np.stack([pose.rotation for pose in poses])
        translations = np.stack([pose.translation_m for pose in poses])
        return cls(tuple(cameras), rotations, translations, float_array("points_m", points_m, (None, 3)))


def rotations_from_vectors(vectors_rad: FloatArray) -> FloatArray:
    """Return the rotation matrices of rotation vectors, shape (p, 3) to (p, 3, 3), exact also near zero."""
    angle = np.linalg.norm(vectors_rad, axis=-1)[:, None, None]
    cross = skew(vectors_rad)
    first, second = np.sinc(angle / np.pi), 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    return np.asarray(np.eye(3) + first * cross + second * (cross @ cross))


def turned(rotations: FloatArray, vectors_rad: FloatArray) -> FloatArray:
    """Turn rotations by small rotation vectors from the left and keep them orthonormal to rounding, (p, 3, 3)."""
    matrices = rotations_from_vectors(vectors_rad) @ rotations
    # One step of Newton for the polar factor: a product of rotations is off by 1e-16, its square is nothing.
    return np.asarray(1.5 * matrices - 0.5 * matrices @ np.swapaxes(matrices, 1, 2) @ matrices)
