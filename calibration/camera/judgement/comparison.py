"""How two calibrations of one camera differ: the angle between their lines of sight, and whether it means something."""

from dataclasses import dataclass

import numpy as np

from calibration.camera.judgement.projection_sigma import covariance_root, map_nodes, without_rotation
from heliogauge.adjust.chi_square import chi_square_cdf
from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform, nearest_rotation
from heliogauge.validate import FloatArray

#: Combinations of intrinsics that move rays this much less than the most uncertain one are left out of the test: they
#: mean nothing for a line of sight.
_LEAST_SHARE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Two calibrations of one camera, ray by ray.

    x_px, y_px (nx,): Nodes [px].
    angle_rad (ny, nx): Angle between both lines of sight of a pixel after the best rotation [rad].
    sigma_rad (ny, nx): Standard deviation of that difference from both covariances, both components in squares
        [rad].
    raw_angle_rad, raw_sigma_rad (ny, nx): The same without taking out a rotation [rad].
    rotation_rad (3,): That rotation, other camera from this one, as a rotation vector [rad].
    chi_square: Squared differences over their covariance, rotation taken out; NaN where neither camera has a
        covariance.
    freedom: Its degrees of freedom.
    """

    x_px: FloatArray
    y_px: FloatArray
    angle_rad: FloatArray
    sigma_rad: FloatArray
    raw_angle_rad: FloatArray
    raw_sigma_rad: FloatArray
    rotation_rad: FloatArray
    chi_square: float
    freedom: int

    @property
    def rms_rad(self) -> float:
        """RMS of the angle over the image [rad]."""
        return _rms(self.angle_rad)

    @property
    def largest_rad(self) -> float:
        """Largest angle in the image [rad]."""
        return float(np.nanmax(self.angle_rad))

    @property
    def expected_rad(self) -> float:
        """RMS of the angle that both covariances let expect; 0 where neither has one [rad]."""
        return _rms(self.sigma_rad)

    @property
    def raw_rms_rad(self) -> float:
        """RMS of the angle without taking out a rotation [rad]."""
        return _rms(self.raw_angle_rad)

    @property
    def raw_largest_rad(self) -> float:
        """Largest angle without taking out a rotation [rad]."""
        return float(np.nanmax(self.raw_angle_rad))

    @property
    def raw_expected_rad(self) -> float:
        """RMS of the angle that both covariances let expect without taking out a rotation [rad]."""
        return _rms(self.raw_sigma_rad)

    @property
    def chance(self) -> float:
        """Probability of so large a difference if nothing but both uncertainties were at work; NaN: not known."""
        if not np.isfinite(self.chi_square) or self.freedom == 0:
            return float("nan")
        return 1.0 - chi_square_cdf(self.chi_square, self.freedom)


def compare(camera: Camera, other: Camera) -> Comparison:
    """Compare two calibrations by the angle between their lines of sight, with and without the best rotation.

    Parameters
    ----------
    camera, other : Camera
        The calibrations; images of one size.

    Returns
    -------
    Comparison
        The angle over the image with its sigma, and the test whether it is more than chance.

    Raises
    ------
    InputError
        Images of different sizes.

    Notes
    -----
    A rotation common to all rays only renames the camera's pose, so the first question is what is left without it.
    The test takes the rays as linear in the intrinsics midway between both, d being what their difference moves there
    (both components at all nodes, without the rotation) and W what both covariances allow, ``W W^T`` being the
    covariance of d: ``chi^2 = |z|^2`` with the shortest z that solves ``W z = d`` best. Beyond the board a lens is
    extrapolated: there the rays themselves are far from linear, and would contradict intrinsics that agree. The
    calibrations are taken as independent; two runs on the same photos are not, and differ less than the test expects.
    """
    sizes = [(one.width_px, one.height_px) for one in (camera, other)]
    if sizes[0] != sizes[1]:
        raise InputError(
            f"compare: the images have {sizes[0][0]} x {sizes[0][1]} and {sizes[1][0]} x {sizes[1][1]} px; "
            "calibrations of one camera at one resolution are needed"
        )
    x, y, pixels = map_nodes(camera)
    flat, shape = pixels.reshape(-1, 2), pixels.shape[:2]
    own, d_own = _rays_and_moves(camera, flat)
    others, d_others = _rays_and_moves(other, flat)
    moves = np.concatenate([d_own, d_others], axis=2)
    between = camera.with_parameters(0.5 * (camera.parameters + other.parameters))
    d_between = between.cast_rays_with_jacobians(flat)[2]
    good = np.isfinite(own).all(axis=1) & np.isfinite(others).all(axis=1) & np.isfinite(moves).all(axis=(1, 2))
    good &= np.isfinite(d_between).all(axis=(1, 2))
    rotation = nearest_rotation(others[good].T @ own[good])
    turned = own @ rotation.T
    free = np.full_like(moves, np.nan)
    free[good] = without_rotation(own[good], moves[good])[0]
    directions = np.column_stack(
        [covariance_root(camera.covariance), covariance_root(other.covariance), camera.parameters - other.parameters]
    )
    linear = without_rotation(others[good], d_between[good] @ directions)[0]
    chi_square, freedom = _test(others[good], linear[:, :, -1], linear[:, :, :-1])
    return Comparison(
        x,
        y,
        _angles(turned, others).reshape(shape),
        _sigmas(free).reshape(shape),
        _angles(own, others).reshape(shape),
        _sigmas(np.where(good[:, None, None], moves, np.nan)).reshape(shape),
        RigidTransform(rotation, np.zeros(3)).rotation_vector_rad,
        chi_square,
        freedom,
    )


def _rays_and_moves(camera: Camera, pixels_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return rays, shape (n, 3), and their movements by one sigma of each combination of intrinsics, (n, 3, 10)."""
    rays, _, d_parameters = camera.cast_rays_with_jacobians(pixels_px)
    return rays, d_parameters @ covariance_root(camera.covariance)


def _angles(rays: FloatArray, others: FloatArray) -> FloatArray:
    # The chord keeps its digits where an arc cosine has none.
    return np.asarray(2 * np.arcsin(np.clip(0.5 * np.linalg.norm(rays - others, axis=1), 0, 1)))


def _sigmas(moves: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt((moves**2).sum(axis=(1, 2))))


def _test(rays: FloatArray, remainder: FloatArray, moves: FloatArray) -> tuple[float, int]:
    if not moves.any():
        return float("nan"), 0
    # Two components across each ray: along it nothing moves.
    first = np.cross([0.0, 1.0, 0.0], rays)
    first /= np.linalg.norm(first, axis=1)[:, None]
    across = np.stack([first, np.cross(rays, first)], axis=2)
    design = np.einsum("nik,nij->nkj", across, moves).reshape(2 * len(rays), -1)
    right = np.einsum("nik,ni->nk", across, remainder).ravel()
    left, values, _ = np.linalg.svd(design, full_matrices=False)
    kept = values > _LEAST_SHARE * values[0]
    parts = (left[:, kept].T @ right) / values[kept]
    return float(parts @ parts), int(np.count_nonzero(kept))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))
