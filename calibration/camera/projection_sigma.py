"""How well a calibrated camera is known over its image, where it was covered, and how two calibrations differ."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.camera.intrinsics import tilt_and_roll
from heliogauge.camera import Camera
from heliogauge.errors import InputError
from heliogauge.rigid import RigidTransform, skew
from heliogauge.validate import FloatArray

#: Nodes along the longer side of a map; uncertainty is smooth.
_MAP_NODES = 48
#: Cells of the coverage count along x and y.
_CELLS = (10, 8)
#: Photos below which a calibration rests on too little, tilt and spread that decide about focal length and centre.
_FEW_PHOTOS = 6
_LEAST_TILT_RAD = np.radians(20.0)
_LEAST_ROLL_RAD = np.radians(45.0)
_LEAST_DEPTH_RATIO = 1.2
_LEAST_COVERED_SHARE = 0.7
_LEAST_RADIUS_SHARE = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class SigmaMap:
    """Uncertainty over the image.

    Parameters
    ----------
    x_px, y_px : ndarray, shape (nx,), (ny,)
        Nodes, from the first to the last pixel [px].
    sigma_ray_rad : ndarray, shape (ny, nx)
        Standard deviation of the direction of a line of sight, both components in squares, as the intrinsics say it;
        the camera's pose is held [rad].
    sigma_free_rad : ndarray, shape (ny, nx)
        The same after the rotation that fits best was taken out: what is left when a pose is estimated with this
        camera [rad].
    sigma_projection_px : ndarray, shape (ny, nx)
        Standard deviation of the image of a point at the stated distance, both components in squares [px].
    distance_m : float
        That distance from the projection centre; it does not matter as long as the pose is held [m].
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


def _nodes(camera: Camera) -> tuple[FloatArray, FloatArray, FloatArray]:
    longer = max(camera.width_px, camera.height_px)
    x, y = (
        np.linspace(0, size - 1, max(int(np.rint(_MAP_NODES * size / longer)), 3))
        for size in (camera.width_px, camera.height_px)
    )
    return x, y, np.stack(np.meshgrid(x, y), axis=-1)


def _rotation_part(rays: FloatArray) -> FloatArray:
    """Return the derivative of directions by a rotation of the camera, shape (n, 3, 3)."""
    return np.asarray(-skew(rays))


def _without_rotation(rays: FloatArray, moves: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Take the rotation that fits best out of changes of directions, shape (n, 3, k); return rest and rotations."""
    turns = _rotation_part(rays)
    normal = np.einsum("nij,nik->jk", turns, turns)
    rotation = np.linalg.solve(normal, np.einsum("nij,nik->jk", turns, moves))
    return moves - turns @ rotation, rotation


def sigma_map(camera: Camera, distance_m: float = 1.0) -> SigmaMap:
    """Map the uncertainty of rays and of projections over the image.

    Parameters
    ----------
    camera : Camera
        With its covariance.
    distance_m : float, optional
        Distance of the points that are projected [m].

    Returns
    -------
    SigmaMap
        The map.

    Raises
    ------
    InputError
        The camera has no covariance.
    """
    if not np.any(camera.covariance):
        raise InputError("sigma map: the camera has no covariance (it is treated as exact)")
    x, y, pixels = _nodes(camera)
    flat = pixels.reshape(-1, 2)
    rays, _, d_parameters = camera.cast_rays_with_jacobians(flat)
    good = np.isfinite(d_parameters).all(axis=(1, 2))
    root = _root(camera.covariance)
    moves = np.full((len(flat), 3, root.shape[1]), np.nan)
    moves[good] = d_parameters[good] @ root
    free = np.full_like(moves, np.nan)
    free[good] = _without_rotation(rays[good], moves[good])[0]
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


def _root(covariance: FloatArray) -> FloatArray:
    """Return R with ``R R^T`` = covariance, also where some parameters are held."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / unit[:, None] / unit)
    return np.asarray(unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


@dataclass(frozen=True, slots=True, eq=False)
class RadialProfile:
    """Distortion against the distance from the principal point.

    Parameters
    ----------
    radius_px : ndarray, shape (n,)
        Distance in the image without distortion, out to the farthest corner [px].
    shift_px : ndarray, shape (n,)
        How far the lens moves points outwards [px].
    sigma_px : ndarray, shape (n,)
        Standard deviation of that, from the radial coefficients [px].
    seen_px : float
        Largest distance at which a point of the board was measured [px].
    """

    radius_px: FloatArray
    shift_px: FloatArray
    sigma_px: FloatArray
    seen_px: float


def radial_profile(camera: Camera, pixels_px: FloatArray, count: int = 60) -> RadialProfile:
    """Compute the radial distortion with its band.

    Parameters
    ----------
    camera : Camera
        With its covariance.
    pixels_px : ndarray, shape (n, 2)
        All measured points, to see how far out the profile rests on measurements [px].
    count : int, optional
        Number of radii.

    Returns
    -------
    RadialProfile
        The profile. Columns and rows are averaged where their focal lengths differ.
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


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Where in the image the board was measured.

    Parameters
    ----------
    counts : ndarray of int, shape (8, 10)
        Points in each cell of the image.
    share : float
        Share of cells with points.
    radius_share : float
        Largest distance of a point from the middle, over that of the image's corners.
    """

    counts: FloatArray
    share: float
    radius_share: float


def coverage(camera: Camera, pixels_px: FloatArray) -> Coverage:
    """Count measured points over the image.

    Parameters
    ----------
    camera : Camera
        For the size of the image.
    pixels_px : ndarray, shape (n, 2)
        All measured points [px].

    Returns
    -------
    Coverage
        Counts in 10 x 8 cells.
    """
    size = np.array([camera.width_px, camera.height_px])
    edges = [np.linspace(-0.5, extent - 0.5, cells + 1) for extent, cells in zip(size, _CELLS, strict=True)]
    counts = np.histogram2d(pixels_px[:, 1], pixels_px[:, 0], bins=(edges[1], edges[0]))[0]
    middle = 0.5 * (size - 1)
    reach = float(np.linalg.norm(pixels_px - middle, axis=1).max() / np.linalg.norm(middle))
    return Coverage(counts, float(np.mean(counts > 0)), reach)


def network_warnings(poses: Sequence[RigidTransform], covered: Coverage) -> tuple[str, ...]:
    """Say what makes a network weak, with the number that says so and the remedy.

    Parameters
    ----------
    poses : sequence of RigidTransform
        ``cam_from_board`` of each photo.
    covered : Coverage
        From `coverage`.

    Returns
    -------
    tuple of str
        Warnings, none for a good network.
    """
    said = []
    angles = np.array([tilt_and_roll(pose) for pose in poses])
    distances = np.array([float(np.linalg.norm(pose.translation_m)) for pose in poses])
    if len(poses) < _FEW_PHOTOS:
        said.append(f"only {len(poses)} photos: errors of single photos are hardly averaged; take 10 or more")
    most = float(angles[:, 0].max())
    if most < _LEAST_TILT_RAD:
        said.append(
            f"flat network: the board is never tilted by more than {np.degrees(most):.0f} deg, so focal length and "
            "distance can hardly be told apart; tilt it by 30 to 45 deg to all sides"
        )
    difference = np.abs(np.angle(np.exp(1j * (angles[:, None, 1] - angles[None, :, 1]))))
    roll = float(np.minimum(difference, np.pi - difference).max())
    half_turns = float(difference.max())
    if max(roll, half_turns) < _LEAST_ROLL_RAD:
        said.append(
            f"no roll: the camera is turned about its axis by {np.degrees(half_turns):.0f} deg at most, so principal "
            "point, tangential distortion and pixel aspect lean on the board's shape; turn it by 90 deg for some photos"
        )
    depth = float(distances.max() / distances.min())
    if depth < _LEAST_DEPTH_RATIO:
        said.append(
            f"no depth: all photos are from nearly one distance (ratio {depth:.2f}); take some from half as far again"
        )
    if covered.share < _LEAST_COVERED_SHARE or covered.radius_share < _LEAST_RADIUS_SHARE:
        said.append(
            f"poor coverage: {covered.share:.0%} of the image has points, out to {covered.radius_share:.0%} of the way "
            "to its corners; beyond, the lens is extrapolated: bring the board into every corner"
        )
    return tuple(said)


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Two calibrations of one camera, ray by ray.

    Parameters
    ----------
    x_px, y_px : ndarray, shape (nx,), (ny,)
        Nodes [px].
    angle_rad : ndarray, shape (ny, nx)
        Angle between both lines of sight of a pixel after the best rotation [rad].
    rotation_rad : ndarray, shape (3,)
        That rotation, other camera from this one, as a rotation vector [rad].
    expected_rad : float
        RMS of the angle that both covariances let expect; 0 where neither has one [rad].
    """

    x_px: FloatArray
    y_px: FloatArray
    angle_rad: FloatArray
    rotation_rad: FloatArray
    expected_rad: float

    @property
    def rms_rad(self) -> float:
        """RMS over the image [rad]."""
        return float(np.sqrt(np.nanmean(self.angle_rad**2)))

    @property
    def largest_rad(self) -> float:
        """Largest in the image [rad]."""
        return float(np.nanmax(self.angle_rad))


def compare(camera: Camera, other: Camera) -> Comparison:
    """Compare two calibrations by the angle between their lines of sight, with the best rotation taken out.

    Parameters
    ----------
    camera, other : Camera
        The calibrations; images of one size.

    Returns
    -------
    Comparison
        The angle over the image.

    Raises
    ------
    InputError
        Images of different sizes.
    """
    sizes = [(one.width_px, one.height_px) for one in (camera, other)]
    if sizes[0] != sizes[1]:
        raise InputError(
            f"compare: the images have {sizes[0][0]} x {sizes[0][1]} and {sizes[1][0]} x {sizes[1][1]} px; "
            "calibrations of one camera at one resolution are needed"
        )
    x, y, pixels = _nodes(camera)
    flat = pixels.reshape(-1, 2)
    own, others = camera.cast_rays(flat), other.cast_rays(flat)
    good = np.isfinite(own).all(axis=1) & np.isfinite(others).all(axis=1)
    left, _, right = np.linalg.svd(others[good].T @ own[good])
    rotation = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    angle = np.full(len(flat), np.nan)
    # The chord keeps its digits where an arc cosine has none.
    angle[good] = 2 * np.arcsin(np.clip(0.5 * np.linalg.norm(own[good] @ rotation.T - others[good], axis=1), 0, 1))
    known = [sigma_map(one).rms_free_rad for one in (camera, other) if np.any(one.covariance)]
    vector = RigidTransform(rotation, np.zeros(3)).rotation_vector_rad
    return Comparison(x, y, angle.reshape(pixels.shape[:2]), vector, float(np.linalg.norm(known)) if known else 0.0)
