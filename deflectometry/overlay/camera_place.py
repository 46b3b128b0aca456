"""Where a camera stood, from points of known place in its photo."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from heliogauge.adjust.chi_square import chi_square_cdf
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform, skew
from heliogauge.validate import FloatArray

_FEWEST = 4
#: Points that are off by so many pixels RMS and more than twenty sigma are not those of the photo.
_WRONG_SIGMAS = 20.0
#: Steps of a pose, and the one that is none [rad, m].
_STEPS, _STILL = 20, 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Station:
    """A camera before a heliostat, and what places it.

    cam_from_heliostat: Its pose.
    points_m (n, 3), pixels_px (n, 2): Points in the heliostat's frame, and where the photo shows them.
    sigma_px: Standard deviation of each image coordinate, enlarged where the points fit worse than stated [px].
    residual_px: RMS of the points' image coordinates [px].
    probability: How often points with their stated sigma leave so much.
    place_m (3,), sigma_place_m: Its surveyed place; None where there is none.
    """

    cam_from_heliostat: RigidTransform
    points_m: FloatArray
    pixels_px: FloatArray
    sigma_px: float
    residual_px: float
    probability: float
    place_m: FloatArray | None = None
    sigma_place_m: float = 1.0

    def settled(self, camera: Camera) -> "Station":
        """Return it where points and survey together put it: from near the axis points alone leave decimetres."""
        found = self
        for _ in range(_STEPS):
            residual, jacobian = found.equations(camera)
            step = np.linalg.lstsq(jacobian, residual, rcond=None)[0]
            found = replace(found, cam_from_heliostat=found.cam_from_heliostat.moved(step))
            if np.abs(step).max() < _STILL:
                break
        return found

    def is_surveyed_to(self, distance_m: float) -> bool:
        """Return whether its place was surveyed, and as well as that."""
        return self.place_m is not None and self.sigma_place_m < distance_m

    def equations(self, camera: Camera) -> tuple[FloatArray, FloatArray]:
        """Return what points and survey say of a step of the pose: residual (m,) and derivatives (m, 6) over sigma."""
        projected = camera.project_posed(self.points_m, self.cam_from_heliostat)
        residual = [(self.pixels_px - projected.pixels_px).ravel() / self.sigma_px]
        jacobian = [projected.d_pixel_d_pose.reshape(-1, 6) / self.sigma_px]
        if self.place_m is not None:
            pose = self.cam_from_heliostat
            # A turn w takes the camera along by R^T (t x w), a shift d by -R^T d.
            by_step = -pose.rotation.T @ np.hstack([skew(pose.translation_m), np.eye(3)])
            residual.append((self.place_m - pose.inverse().translation_m) / self.sigma_place_m)
            jacobian.append(by_step / self.sigma_place_m)
        return np.concatenate(residual), np.concatenate(jacobian)


def place_camera(camera: Camera, points_m: FloatArray, pixels_px: FloatArray, sigma_px: float, name: str) -> Station:
    """Find the pose of a camera.

    points_m (n, 3), pixels_px (n, 2): Points in the heliostat's frame [m], and where the photo shows them [px].
    name: Of the photo, for messages.
    EstimationError: Too few points, points on a line, or points that are not those of the photo.
    """
    if len(points_m) < _FEWEST:
        raise EstimationError(f"{name}: {len(points_m)} points of known place, at least {_FEWEST} are needed")
    rays = camera.cast_rays(pixels_px)
    flat = np.ascontiguousarray(rays[:, :2] / rays[:, 2:])
    found, vector, shift = cv2.solvePnP(
        np.ascontiguousarray(points_m), flat, np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_SQPNP
    )
    if not found:
        raise EstimationError(f"{name}: its points of known place do not determine where the camera stood")
    pose = RigidTransform.from_rotation_vector(vector.ravel(), shift.ravel())
    for _ in range(_STEPS):
        projected = camera.project_posed(points_m, pose)
        residual = (pixels_px - projected.pixels_px).ravel()
        jacobian = projected.d_pixel_d_pose.reshape(-1, 6)
        products = jacobian.T @ jacobian
        norms = np.sqrt(np.diag(products))
        if not np.isfinite(products).all() or np.linalg.cond(products / np.outer(norms, norms)) > 1e12:
            raise EstimationError(f"{name}: its points of known place lie on a line; the camera's place stays open")
        step = np.linalg.solve(products, jacobian.T @ residual)
        pose = pose.moved(step)
        if np.abs(step).max() < _STILL:
            break
    residual = (pixels_px - camera.project(pose.apply(points_m))).ravel()
    rms = float(np.sqrt(np.mean(residual**2)))
    if rms > max(_WRONG_SIGMAS * sigma_px, 2.0):
        raise EstimationError(
            f"{name}: its points of known place are {rms:.1f} px RMS off in every pose of the camera; are they points "
            "of this photo, in the heliostat's frame, and is this its camera?"
        )
    freedom = residual.size - 6
    square = float(residual @ residual) / sigma_px**2
    probability = 1 - chi_square_cdf(square, freedom) if freedom > 0 else 1.0
    factor = max(1.0, square / freedom) if freedom > 0 and probability < 0.01 else 1.0
    if pose.inverse().translation_m[2] <= 0:
        raise EstimationError(
            f"{name}: by its points the camera stood behind the heliostat; is the photo mirrored, or are x and y of "
            "the points exchanged? x is to the right and y up seen from the front"
        )
    return Station(pose, points_m, pixels_px, float(sigma_px * np.sqrt(factor)), rms, probability)
