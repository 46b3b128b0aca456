"""Where mirror and cameras are: the mirror's frame in the field, and the orientation of a camera that stands still."""

from dataclasses import dataclass

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform, nearest_rotation, skew
from heliogauge.validate import FloatArray

#: Gauss-Newton steps of an orientation; from the closed solution three are enough.
_STEPS = 10
#: Whatever the distribution of errors, 10 sigma are exceeded at most once in 100 times (Chebyshev's inequality).
IMPOSSIBLE_SIGMAS = 10.0


def normal_between(place_m: FloatArray, aim_m: FloatArray, sun: FloatArray) -> FloatArray:
    """Return the unit normal that reflects the sun from a place to an aim, all (3,) in the field's frame."""
    to_aim = aim_m - place_m
    distance = float(np.linalg.norm(to_aim))
    if distance == 0:
        raise InputError("mirror.aim_m: it is the mirror's own place")
    half = to_aim / distance + sun
    length = float(np.linalg.norm(half))
    if length < 1e-6:
        raise InputError("mirror.aim_m: the sun stands exactly behind it; no mirror reflects that way")
    return np.asarray(half / length)


def field_from_mirror(place_m: FloatArray, normal: FloatArray) -> RigidTransform:
    """Return where a mirror's frame stands: x level and to the right seen from the front, y up, z along its normal.

    InputError: A normal that points straight up or down, where no direction is level to the right.
    """
    across = np.cross([0.0, 0.0, 1.0], normal)
    length = float(np.linalg.norm(across))
    if length < 1e-6:
        raise InputError("mirror: the nominal normal points straight up, so that right and left are not defined")
    x = across / length
    return RigidTransform(nearest_rotation(np.stack([x, np.cross(normal, x), normal], axis=1)), place_m)


@dataclass(frozen=True, slots=True, eq=False)
class OrientedCamera:
    """A camera before a mirror.

    cam_from_mirror: Its pose to the mirror's frame.
    covariance_turn (3, 3): Of a small turn of the camera about its own axes, its place known [rad^2].
    residual_sigmas (n, 2): What its points leave, over their standard deviations.
    residual_rms_px: The same in pixels, of all points.
    """

    camera: Camera
    cam_from_mirror: RigidTransform
    covariance_turn: FloatArray
    residual_sigmas: FloatArray
    residual_rms_px: float

    @property
    def eye_m(self) -> FloatArray:
        """Its centre of projection in the mirror's frame, shape (3,) [m]."""
        return self.cam_from_mirror.inverse().translation_m


def orient_camera(
    name: str,
    camera: Camera,
    eye_m: FloatArray,
    points_m: FloatArray,
    pixels_px: FloatArray,
    sigma_px: FloatArray,
    *,
    most_sigmas: float = IMPOSSIBLE_SIGMAS,
) -> OrientedCamera:
    """Turn a camera of known place until points of the mirror lie where they were measured.

    eye_m (3,): Its place in the mirror's frame.
    points_m (n, 3), pixels_px (n, 2), sigma_px (n,): The points and their images.
    most_sigmas: How far off a point may be; infinite for a camera that is only tried out elsewhere.
    EstimationError: Points in one direction, or images that are not those of the points.
    """
    from scipy.linalg import orthogonal_procrustes

    sights = points_m - eye_m
    sights = sights / np.linalg.norm(sights, axis=1, keepdims=True)
    rays = camera.cast_rays(pixels_px)
    # Two directions and what is at right angles to both determine a turn, whatever its size.
    across = [np.cross(one[0], one[np.argmax(np.linalg.norm(one - one[0], axis=1))]) for one in (sights, rays)]
    if min(float(np.linalg.norm(one)) for one in across) < 1e-7:
        raise EstimationError(f"camera {name}: its points lie in one direction; give corners that are apart")
    weight = float(np.mean([np.linalg.norm(one) for one in across]))
    stacked = [
        np.vstack([one, other / np.linalg.norm(other) * weight])
        for one, other in zip((sights, rays), across, strict=True)
    ]
    turn = nearest_rotation(orthogonal_procrustes(stacked[0], stacked[1])[0].T)
    pose = RigidTransform(turn, -turn @ eye_m)
    if (points_m @ pose.rotation.T + pose.translation_m)[:, 2].min() <= 0:
        raise EstimationError(f"camera {name}: the mirror would be behind it; are the images of its points right?")
    for _ in range(_STEPS):
        seen = camera.project_with_jacobians(pose.apply(points_m))
        residual = (pixels_px - seen.pixels_px) / sigma_px[:, None]
        moved = pose.rotate(points_m - eye_m)
        design = np.einsum("nij,njk->nik", seen.d_pixel_d_point, -skew(moved)) / sigma_px[:, None, None]
        normal = np.einsum("nij,nik->jk", design, design)
        step = np.linalg.solve(normal, np.einsum("nij,ni->j", design, residual))
        turned = RigidTransform.from_rotation_vector(step, np.zeros(3)).rotation @ pose.rotation
        pose = RigidTransform(nearest_rotation(turned), -nearest_rotation(turned) @ eye_m)
        if np.linalg.norm(step) < 1e-12:
            break
    residual_px = pixels_px - camera.project(pose.apply(points_m))
    worst = float((np.linalg.norm(residual_px, axis=1) / sigma_px).max())
    if not worst < most_sigmas:
        number = int(np.argmax(np.linalg.norm(residual_px, axis=1) / sigma_px))
        off = float(np.linalg.norm(residual_px[number]))
        raise EstimationError(
            f"camera {name}: point {number + 1} was measured {off:.3g} px ({worst:.0f} sigma) from where place and "
            f"calibration put it; check its image_px, the order of the points, and the camera's place_m "
            f"(the mirror is {float(np.linalg.norm(points_m.mean(axis=0) - eye_m)):.4g} m away)"
        )
    covariance = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    over_sigma = residual_px / sigma_px[:, None]
    return OrientedCamera(camera, pose, covariance, over_sigma, float(np.sqrt(np.mean(residual_px**2))))
