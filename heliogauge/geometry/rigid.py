"""Rigid transforms between named frames, rotation vectors and their derivatives."""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, float_array, positive


@dataclass(frozen=True, slots=True, eq=False)
class RigidTransform(ShortRepr):
    """The transform ``b_from_a``: ``x_b = rotation @ x_a + translation_m``.

    Parameters
    ----------
    rotation : array_like, shape (3, 3)
        Rotation matrix.
    translation_m : array_like, shape (3,)
        Origin of frame a in frame b [m].

    Raises
    ------
    InputError
        The matrix is not a rotation.

    Examples
    --------
    >>> b_from_a = RigidTransform.from_rotation_vector([0, 0, np.pi / 2], [1, 0, 0])
    >>> b_from_a.apply([1.0, 0.0, 0.0]).round(12)
    array([1., 1., 0.])
    """

    rotation: FloatArray
    translation_m: FloatArray

    def __post_init__(self) -> None:
        rotation = float_array("rotation", self.rotation, (3, 3))
        if not _is_rotation(rotation):
            raise InputError("rotation: a right-handed orthonormal matrix is needed (is an axis mirrored?)")
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation_m", float_array("translation_m", self.translation_m, (3,)))

    @classmethod
    def identity(cls) -> Self:
        """Return the transform that changes nothing."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_rotation_vector(cls, rotation_vector_rad: npt.ArrayLike, translation_m: npt.ArrayLike) -> Self:
        """Build the transform from a rotation vector (axis times angle) [rad] and a translation [m]."""
        vector = float_array("rotation_vector_rad", rotation_vector_rad, (3,))
        return cls(rotation_from_vector(vector), float_array("translation_m", translation_m, (3,)))

    @property
    def rotation_vector_rad(self) -> FloatArray:
        """Axis times angle, shape (3,), angle in [0, pi] [rad]."""
        return vector_from_rotation(self.rotation)

    def apply(self, points_m: npt.ArrayLike) -> FloatArray:
        """Transform points, shape (..., 3) [m]."""
        return np.asarray(points_m, dtype=np.float64) @ self.rotation.T + self.translation_m

    def rotate(self, directions: npt.ArrayLike) -> FloatArray:
        """Rotate directions (no translation), shape (..., 3)."""
        return np.asarray(directions, dtype=np.float64) @ self.rotation.T

    def inverse(self) -> "RigidTransform":
        """Return ``a_from_b``."""
        # What was checked needs no check again: where a photo was taken is asked for a dozen times.
        found, translation = object.__new__(RigidTransform), -self.rotation.T @ self.translation_m
        translation.setflags(write=False)
        object.__setattr__(found, "rotation", self.rotation.T)
        object.__setattr__(found, "translation_m", translation)
        return found

    def __matmul__(self, other: "RigidTransform") -> "RigidTransform":
        """Compose: ``c_from_b @ b_from_a`` is ``c_from_a``."""
        return RigidTransform(self.rotation @ other.rotation, self.rotation @ other.translation_m + self.translation_m)

    def moved(self, step: npt.ArrayLike) -> "RigidTransform":
        """Turn and shift this transform a little, in frame b.

        Parameters
        ----------
        step : array_like, shape (6,)
            Rotation vector [rad] and shift [m]: ``x_b`` becomes
            ``R(step[:3]) (rotation @ x_a) + translation_m + step[3:]``. Frame a's origin stays where it is when only
            the rotation part is given.

        Returns
        -------
        RigidTransform
            The moved transform.
        """
        step = float_array("step", step, (6,))
        rotation = nearest_rotation(rotation_from_vector(step[:3]) @ self.rotation)
        return RigidTransform(rotation, self.translation_m + step[3:])

    def origin_covariance(self, covariance: npt.ArrayLike) -> FloatArray:
        """Return how well the origin of frame b is known in frame a: a camera's place, with ``cam_from_world``.

        Parameters
        ----------
        covariance : array_like, shape (6, 6)
            Covariance of the steps of `moved` [rad, m].

        Returns
        -------
        ndarray, shape (3, 3)
            Covariance of the origin, ``-rotation.T @ translation_m`` [m^2].
        """
        given = float_array("covariance", covariance, (6, 6))
        x, y, z = self.translation_m
        # A turn w takes the origin along by R^T (t x w), a shift d by -R^T d.
        by_step = -self.rotation.T @ np.hstack([[[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], np.eye(3)])
        return np.asarray(by_step @ given @ by_step.T)


def _is_rotation(matrix: FloatArray) -> bool:
    """Return whether rows are orthonormal and right-handed; nine numbers are faster one by one than as arrays."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    lengths = (a * a + b * b + c * c, d * d + e * e + f * f, g * g + h * h + i * i)
    products = (a * d + b * e + c * f, a * g + b * h + c * i, d * g + e * h + f * i)
    volume = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    # Lengths to five digits, as they are written in many files; angles to a nanoradian.
    return bool(max(abs(one - 1) for one in lengths) < 1e-5 and max(map(abs, products)) <= 1e-9 and volume > 0)


def skew(vectors: npt.ArrayLike) -> FloatArray:
    """Return the cross-product matrices ``[v]x`` of vectors, shape (..., 3) -> (..., 3, 3)."""
    vector = np.asarray(vectors, dtype=np.float64)
    matrix = np.zeros((*vector.shape, 3))
    matrix[..., 0, 1], matrix[..., 0, 2] = -vector[..., 2], vector[..., 1]
    matrix[..., 1, 0], matrix[..., 1, 2] = vector[..., 2], -vector[..., 0]
    matrix[..., 2, 0], matrix[..., 2, 1] = -vector[..., 1], vector[..., 0]
    return matrix


def rotation_from_vector(rotation_vector_rad: npt.ArrayLike) -> FloatArray:
    """Return the rotation matrix of a rotation vector (Rodrigues), exact to round-off also near zero.

    Shapes: result (3, 3).
    rotation_vector_rad (3,): Axis times angle [rad].
    """
    vector = np.asarray(rotation_vector_rad, dtype=np.float64)
    angle = float(np.linalg.norm(vector))
    cross = skew(vector)
    # np.sinc is sin(pi x) / (pi x): no cancellation, no branch at zero.
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)


def vector_from_rotation(rotation: npt.ArrayLike) -> FloatArray:
    """Return the rotation vector of a rotation matrix, through the quaternion (stable up to an angle of pi).

    Shapes: rotation (3, 3).
    Returns (3,): Axis times angle, angle in [0, pi] [rad].
    """
    matrix = np.asarray(rotation, dtype=np.float64)
    diagonal = np.diag(matrix)
    trace = diagonal.sum()
    # Shepperd: start from the largest of the four squared quaternion parts.
    squares = np.append(1 + 2 * diagonal - trace, 1 + trace)
    largest = int(np.argmax(squares))
    quaternion = np.empty(4)
    if largest == 3:
        quaternion[3] = squares[3]
        quaternion[:3] = (matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1])
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        quaternion[i] = squares[i]
        quaternion[j], quaternion[k] = matrix[j, i] + matrix[i, j], matrix[k, i] + matrix[i, k]
        quaternion[3] = matrix[k, j] - matrix[j, k]
    quaternion /= np.linalg.norm(quaternion) * (1.0 if quaternion[3] >= 0 else -1.0)
    sine = float(np.linalg.norm(quaternion[:3]))
    if sine == 0.0:
        return np.zeros(3)
    return np.asarray(quaternion[:3] / sine * (2 * np.arctan2(sine, quaternion[3])))


def looking_at(center_m: FloatArray, aim_m: FloatArray, up: FloatArray, roll_rad: float = 0.0) -> RigidTransform:
    """Return the pose of a camera that looks at a point.

    center_m, aim_m (3,): Projection centre, and the point in the middle of the image [m].
    up (3,): Direction that is up in the image of an upright camera.
    roll_rad: Turn of the camera about its axis, clockwise seen from behind it [rad].
    InputError: Centre and aim are the same point.

    >>> looking_at(np.array([0.0, 0.0, 2.0]), np.zeros(3), np.array([0.0, 1.0, 0.0])).apply(np.array([[1.0, 0.5, 0.0]]))
    array([[ 1. , -0.5,  2. ]])
    """
    forward = np.asarray(aim_m, dtype=np.float64) - center_m
    positive("distance from a camera to the point it looks at", float(np.linalg.norm(forward)), "metres")
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-6 * np.linalg.norm(up):
        # Straight up or down: any direction is as upright as another.
        right = np.cross(forward, np.roll(up, 1))
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    cosine, sine = np.cos(roll_rad), np.sin(roll_rad)
    rotation = np.stack([cosine * right + sine * down, -sine * right + cosine * down, forward])
    return RigidTransform(rotation, -rotation @ center_m)


def nearest_rotation(matrix: FloatArray) -> FloatArray:
    """Return the rotation R with the largest ``tr(R^T matrix)``, shape (3, 3).

    matrix (3, 3): Something near a rotation, which is thus made one; or the sum of ``b a^T``, for which R turns the
        vectors a onto the vectors b as well as possible (Kabsch, Acta Cryst. A32 (1976) 922).
    """
    left, _, right = np.linalg.svd(matrix)
    if np.linalg.det(left @ right) < 0:
        left = left * [1.0, 1.0, -1.0]
    return np.asarray(left @ right)


def rotation_between(direction_a: npt.ArrayLike, direction_b: npt.ArrayLike) -> FloatArray:
    """Return the smallest rotation that turns one direction into another.

    direction_a, direction_b (3,): Directions of any length.
    Returns (3, 3): Rotation matrix with ``R @ a`` parallel to ``b``.
    InputError: A direction has no length, or the two are opposite (the axis is not determined).
    """
    first = np.asarray(direction_a, dtype=np.float64)
    second = np.asarray(direction_b, dtype=np.float64)
    lengths = np.linalg.norm(first) * np.linalg.norm(second)
    if lengths == 0:
        raise InputError("direction: a vector of length zero has no direction")
    cross, cosine = np.cross(first, second) / lengths, float(first @ second / lengths)
    if cosine < -1 + 1e-12:
        raise InputError("direction_a, direction_b: opposite directions do not determine the axis of rotation")
    matrix = skew(cross)
    return np.asarray(np.eye(3) + matrix + matrix @ matrix / (1 + cosine))


def rotation_from_omega_phi_kappa(omega_rad: float, phi_rad: float, kappa_rad: float) -> FloatArray:
    """Return the photogrammetric rotation ``M = R3(kappa) R2(phi) R1(omega)`` (object to image axes).

    omega_rad, phi_rad, kappa_rad: Angles about X, Y and Z [rad].
    Returns (3, 3): Rotation matrix of Owkes (2012) eq. 5.25; the camera of that convention looks along its own -z.
    """
    (co, cp, ck), (so, sp, sk) = np.cos([omega_rad, phi_rad, kappa_rad]), np.sin([omega_rad, phi_rad, kappa_rad])
    about_x = np.array([[1, 0, 0], [0, co, so], [0, -so, co]])
    about_y = np.array([[cp, 0, -sp], [0, 1, 0], [sp, 0, cp]])
    about_z = np.array([[ck, sk, 0], [-sk, ck, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


class OmegaPhiKappa(NamedTuple):
    """Photogrammetric angles about x, y and z, in this order [rad]."""

    omega_rad: float
    phi_rad: float
    kappa_rad: float


def omega_phi_kappa_from_rotation(rotation: npt.ArrayLike) -> OmegaPhiKappa:
    """Return omega, phi, kappa [rad] of a rotation matrix; at phi = +-pi/2, where only a sum counts, kappa is 0.

    rotation (3, 3): ``M = R3(kappa) R2(phi) R1(omega)``.
    """
    matrix = np.asarray(rotation, dtype=np.float64)
    cosine = float(np.hypot(matrix[0, 0], matrix[1, 0]))
    phi = float(np.arctan2(matrix[2, 0], cosine))
    if cosine < 1e-9:
        sign = np.sign(matrix[2, 0])
        return OmegaPhiKappa(float(np.arctan2(sign * matrix[0, 1], matrix[1, 1])), phi, 0.0)
    kappa = float(np.arctan2(-matrix[1, 0], matrix[0, 0]))
    return OmegaPhiKappa(float(np.arctan2(-matrix[2, 1], matrix[2, 2])), phi, kappa)
