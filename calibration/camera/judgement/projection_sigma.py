"""How well a calibrated camera is known over its image: rays, projections, radial distortion."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import skew
from heliogauge.validate import FloatArray

#: Nodes along the longer side of a map; uncertainty is smooth.
_MAP_NODES = 48


@dataclass(frozen=True, slots=True, eq=False)
class SigmaMap:
    """Uncertainty over the image.

    x_px, y_px (nx,): Nodes, from the first to the last pixel [px].
    sigma_ray_rad (ny, nx): Standard deviation of the direction of a line of sight, both components in squares, as
        the intrinsics determine it; the camera's pose is held [rad].
    sigma_free_rad (ny, nx): The same after the rotation that fits best was taken out: what is left when a pose is
        estimated with this camera [rad].
    sigma_projection_px (ny, nx): Standard deviation of the image of a point at the stated distance, both components
        in squares [px].
    distance_m: That distance from the projection centre; it does not matter as long as the pose is held [m].
    """

    x_px: FloatArray
    y_px: FloatArray
    sigma_ray_rad: FloatArray
    sigma_free_rad: FloatArray
    sigma_projection_px: FloatArray
    distance_m: float

    @property
    def rms_ray_rad(self) -> float:
        """Root mean square over the image [rad]."""
        return float(np.sqrt(np.nanmean(self.sigma_ray_rad**2)))

    @property
    def rms_free_rad(self) -> float:
        """Root mean square over the image, without the common rotation [rad]."""
        return float(np.sqrt(np.nanmean(self.sigma_free_rad**2)))

    @property
    def worst_projection_px(self) -> float:
        """Largest in the image [px]."""
        return float(np.nanmax(self.sigma_projection_px))


class MapNodes(NamedTuple):
    """Nodes of a map over the image: columns (nx,), rows (ny,), and all of them (ny, nx, 2) [px]."""

    x_px: FloatArray
    y_px: FloatArray
    pixels_px: FloatArray


def map_nodes(camera: Camera) -> MapNodes:
    """Return the nodes of a map."""
    longer = max(camera.width_px, camera.height_px)
    x, y = (
        np.linspace(0, size - 1, max(int(np.rint(_MAP_NODES * size / longer)), 3))
        for size in (camera.width_px, camera.height_px)
    )
    return MapNodes(x, y, np.stack(np.meshgrid(x, y), axis=-1))


def _rotation_part(rays: FloatArray) -> FloatArray:
    """Return the derivative of directions by a rotation of the camera, shape (n, 3, 3)."""
    return np.asarray(-skew(rays))


def without_rotation(rays: FloatArray, moves: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Take the rotation that fits best out of changes of directions, shape (n, 3, k); return rest and rotations."""
    turns = _rotation_part(rays)
    normal = np.einsum("nij,nik->jk", turns, turns)
    rotation = np.linalg.solve(normal, np.einsum("nij,nik->jk", turns, moves))
    return moves - turns @ rotation, rotation


def sigma_map(camera: Camera, distance_m: float = 1.0) -> SigmaMap:
    """Map the uncertainty of rays and of projections over the image.

    distance_m: Distance of the points that are projected [m].
    InputError: The camera has no covariance.
    """
    if not np.any(camera.covariance):
        raise InputError("sigma map: the camera has no covariance (it is treated as exact)")
    x, y, pixels = map_nodes(camera)
    flat = pixels.reshape(-1, 2)
    rays, _, d_parameters = camera.cast_rays_with_jacobians(flat)
    good = np.isfinite(d_parameters).all(axis=(1, 2))
    root = covariance_root(camera.covariance)
    moves = np.full((len(flat), 3, root.shape[1]), np.nan)
    moves[good] = d_parameters[good] @ root
    free = np.full_like(moves, np.nan)
    free[good] = without_rotation(rays[good], moves[good])[0]
    projected = camera.projection_covariance_px2(distance_m * rays)
    shape = pixels.shape[:2]
    return SigmaMap(
        x,
        y,
        np.sqrt((moves**2).sum(axis=(1, 2))).reshape(shape),
        np.sqrt((free**2).sum(axis=(1, 2))).reshape(shape),
        np.sqrt(np.trace(projected, axis1=1, axis2=2)).reshape(shape),
        distance_m,
    )


def covariance_root(covariance: FloatArray) -> FloatArray:
    """Return R with ``R R^T`` = covariance, also where some parameters are held."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / unit[:, None] / unit)
    return np.asarray(unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


@dataclass(frozen=True, slots=True, eq=False)
class RadialProfile:
    """Distortion against the distance from the principal point.

    radius_px (n,): Distance in the image without distortion, out to the farthest corner [px].
    shift_px (n,): How far the lens moves points outwards [px].
    sigma_px (n,): Standard deviation of that, from the radial coefficients [px].
    seen_px: Largest distance at which a point of the board was measured [px].
    """

    radius_px: FloatArray
    shift_px: FloatArray
    sigma_px: FloatArray
    seen_px: float


def radial_profile(camera: Camera, pixels_px: FloatArray, count: int = 60) -> RadialProfile:
    """Compute the radial distortion with its band.

    pixels_px (n, 2): All measured points, to see how far out the profile rests on measurements [px].
    Returns: The profile. Columns and rows are averaged where their focal lengths differ.
    """
    focal = 0.5 * (camera.focal_x_px + camera.focal_y_px)
    center = np.array([camera.center_x_px, camera.center_y_px])
    corners = np.array([[x, y] for x in (0, camera.width_px - 1) for y in (0, camera.height_px - 1)])
    rays = camera.cast_rays(corners)
    reach = np.hypot(rays[:, 0], rays[:, 1]) / rays[:, 2]
    largest = float(np.nanmax(reach)) if np.isfinite(reach).any() else float(np.abs(corners - center).max()) / focal
    ideal = np.linspace(0, largest, count)
    axis = np.stack([ideal, np.zeros(count), np.ones(count)], axis=1)
    _, _, d_parameters = camera.project_with_jacobians(axis)
    lens = camera.distortion.with_coefficients(np.array([*camera.parameters[5:7], 0.0, 0.0, camera.parameters[9]]))
    shift = focal * (lens.distort(axis[:, :2])[:, 0] - ideal)
    chosen = [5, 6, 9]
    slope = d_parameters[:, 0][:, chosen] * (focal / camera.focal_x_px)
    variance = np.einsum("nj,jk,nk->n", slope, camera.covariance[np.ix_(chosen, chosen)], slope)
    seen = float(np.linalg.norm(pixels_px - center, axis=1).max())
    return RadialProfile(ideal * focal, shift, np.sqrt(np.maximum(variance, 0.0)), seen)
