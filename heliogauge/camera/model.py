"""Camera: THE one camera model of every package - project points, cast rays, derivatives, uncertainty."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from heliogauge.camera.brown_polynomial import BLOCK, InverseStart
from heliogauge.camera.distortion import BrownDistortion, coordinates
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.rigid import skew as skew_matrices
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, covariance_matrix, float_array, positive

#: Order of the parameters in vectors, Jacobians and covariances.
PARAMETER_NAMES = (
    "focal_x_px",
    "focal_y_px",
    "center_x_px",
    "center_y_px",
    "skew",
    "k1",
    "k2",
    "p1",
    "p2",
    "k3",
)


class PosedProjection(NamedTuple):
    """Image points of points in another frame, with derivatives (see `Camera.project_posed`)."""

    pixels_px: FloatArray
    d_pixel_d_point: FloatArray
    d_pixel_d_pose: FloatArray
    d_pixel_d_parameters: FloatArray


class InvertibleRegion(NamedTuple):
    """Where a lens model is one-to-one (see `Camera.invertible_region`)."""

    whole_image: bool
    radius: float
    radius_px: float
    farthest_corner_px: float
    message: str


class Projection(NamedTuple):
    """Image points with derivatives.

    pixels_px (..., 2): Image points [px].
    d_pixel_d_point (..., 2, 3): Derivative with respect to the point in the camera frame [px/m].
    d_pixel_d_parameters (..., 2, 10): Derivative with respect to `PARAMETER_NAMES`.
    """

    pixels_px: FloatArray
    d_pixel_d_point: FloatArray
    d_pixel_d_parameters: FloatArray


class LinesOfSight(NamedTuple):
    """Lines of sight with derivatives.

    rays (..., 3): Unit directions in the camera frame.
    d_ray_d_pixel (..., 3, 2): Derivative with respect to the image point [1/px].
    d_ray_d_parameters (..., 3, 10): Derivative with respect to `PARAMETER_NAMES`.
    """

    rays: FloatArray
    d_ray_d_pixel: FloatArray
    d_ray_d_parameters: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Camera(ShortRepr):
    """A central camera with Brown distortion.

    Parameters
    ----------
    width_px, height_px : int
        Size of the image [px].
    focal_x_px, focal_y_px : float
        Focal length in columns and in rows [px].
    center_x_px, center_y_px : float
        Principal point; the centre of the top-left pixel is (0, 0) [px].
    skew : float
        Columns that a unit of the measured y/z adds [px].
    distortion : BrownDistortion
        The lens.
    covariance : array_like, shape (10, 10)
        Covariance of `PARAMETER_NAMES`; all zeros says "treated as exact".

    Raises
    ------
    InputError
        A size or focal length that is not positive, a number that is not finite, or no covariance matrix.

    Notes
    -----
    Frame: x right, y down, z forward. ``u = focal_x x + skew y + center_x``, ``v = focal_y y + center_y`` with the
    measured (distorted) coordinates x, y. A pixel or point for which the lens is not one-to-one gives NaN;
    `invertible_region` says whether the image has any.

    Examples
    --------
    >>> camera = Camera(640, 480, 500.0, 500.0, 319.5, 239.5)
    >>> camera.project([0.1, 0.0, 1.0])
    array([369.5, 239.5])
    """

    width_px: int
    height_px: int
    focal_x_px: float
    focal_y_px: float
    center_x_px: float
    center_y_px: float
    skew: float = 0.0
    distortion: BrownDistortion = field(default_factory=BrownDistortion)
    covariance: FloatArray = field(default_factory=lambda: np.zeros((10, 10)))

    def __post_init__(self) -> None:
        for name in ("width_px", "height_px"):
            value = positive(name, getattr(self, name), "pixels")
            if value != int(value):
                raise InputError(f"{name}: a whole number of pixels is needed, not {value}")
            object.__setattr__(self, name, int(value))
        for name in ("focal_x_px", "focal_y_px"):
            object.__setattr__(self, name, positive(name, getattr(self, name), "pixels"))
        for name in ("center_x_px", "center_y_px", "skew"):
            object.__setattr__(self, name, float(float_array(name, getattr(self, name), ())))
        object.__setattr__(self, "covariance", covariance_matrix("camera covariance", self.covariance, 10))

    @property
    def parameters(self) -> FloatArray:
        """The parameters in the order of `PARAMETER_NAMES`, shape (10,)."""
        own = [getattr(self, name) for name in PARAMETER_NAMES[:5]]
        return np.array([*own, *self.distortion.polynomial])

    @property
    def sigma_parameters(self) -> FloatArray:
        """Standard deviations in the order of `PARAMETER_NAMES`, shape (10,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def matrix(self) -> FloatArray:
        """Camera matrix from measured normalised coordinates to pixels, shape (3, 3)."""
        return np.array(
            [[self.focal_x_px, self.skew, self.center_x_px], [0, self.focal_y_px, self.center_y_px], [0, 0, 1]]
        )

    def with_parameters(self, parameters: npt.ArrayLike) -> "Camera":
        """Return the camera with other values of `PARAMETER_NAMES`, shape (10,); the covariance stays."""
        vector = float_array("camera parameters", parameters, (10,))
        own = dict(zip(PARAMETER_NAMES[:5], vector[:5].tolist(), strict=True))
        return replace(self, **own, distortion=self.distortion.with_coefficients(vector[5:]))

    def with_covariance(self, covariance: npt.ArrayLike) -> "Camera":
        """Return the camera with another covariance of `PARAMETER_NAMES`, shape (10, 10)."""
        return replace(self, covariance=covariance_matrix("camera covariance", covariance, 10))

    def project(self, points_m: npt.ArrayLike) -> FloatArray:
        """Project points.

        Parameters
        ----------
        points_m : array_like, shape (..., 3)
            Points in the camera frame [m].

        Returns
        -------
        ndarray, shape (..., 2)
            Image points, also outside the image [px]; NaN behind the camera and where the lens is not one-to-one.

        Raises
        ------
        InputError
            The last axis does not have three elements.
        """
        points = coordinates("points_m", points_m, 3)
        flat = points.reshape(-1, 3)
        pixels = np.empty((flat.shape[0], 2))
        start: InverseStart | None = None
        if not self.distortion.distorts_in_closed_form:
            # The image corners and what lies a little beyond bound what is worth a good start value.
            start = self.distortion.inverse_start(1.5 * self._corner_radius())
        for first in range(0, flat.shape[0], BLOCK):
            rows = slice(first, first + BLOCK)
            x, y = self.distortion.distort_components(*_over_depth(flat[rows]), start)
            pixels[rows, 0] = self.focal_x_px * x + (self.center_x_px + self.skew * y)
            pixels[rows, 1] = self.focal_y_px * y + self.center_y_px
        return pixels.reshape(*points.shape[:-1], 2)

    def cast_rays(self, pixels_px: npt.ArrayLike) -> FloatArray:
        """Cast the lines of sight of image points.

        Parameters
        ----------
        pixels_px : array_like, shape (..., 2)
            Image points [px].

        Returns
        -------
        ndarray, shape (..., 3)
            Unit directions in the camera frame; NaN where the lens is not one-to-one.

        Raises
        ------
        InputError
            The last axis does not have two elements.
        """
        pixels = coordinates("pixels_px", pixels_px, 2)
        flat = pixels.reshape(-1, 2)
        rays = np.empty((flat.shape[0], 3))
        start = self._start_for_image()
        for first in range(0, flat.shape[0], BLOCK):
            rows = slice(first, first + BLOCK)
            self._cast(flat[rows, 0], flat[rows, 1], start, rays[rows])
        return rays.reshape(*pixels.shape[:-1], 3)

    def ray_grid(self, step: int = 1) -> FloatArray:
        """Cast the lines of sight of the image's pixel centres.

        Parameters
        ----------
        step : int, optional
            Take every step-th column and row, from pixel (0, 0) on.

        Returns
        -------
        ndarray, shape (rows, columns, 3)
            Unit directions in the camera frame; NaN where the lens is not one-to-one.

        Raises
        ------
        InputError
            The step is not a positive whole number.
        """
        if step != int(step) or step < 1:
            raise InputError(f"step: a positive whole number of pixels is needed, not {step}")
        columns = np.arange(0, self.width_px, step, dtype=np.float64)
        rows = np.arange(0, self.height_px, step, dtype=np.float64)
        rays = np.empty((rows.size, columns.size, 3))
        start = self._start_for_image()
        at_once = max(1, BLOCK // columns.size)
        for first in range(0, rows.size, at_once):
            some = rows[first : first + at_once]
            target = rays[first : first + at_once].reshape(-1, 3)
            self._cast(np.tile(columns, some.size), np.repeat(some, columns.size), start, target)
        return rays

    def project_with_jacobians(self, points_m: npt.ArrayLike) -> Projection:
        """Project points, with derivatives.

        Parameters
        ----------
        points_m : array_like, shape (..., 3)
            Points in the camera frame [m].

        Returns
        -------
        Projection
            Image points with derivatives.

        Raises
        ------
        InputError
            The last axis does not have three elements.
        """
        points = coordinates("points_m", points_m, 3)
        ideal = np.stack(_over_depth(points), axis=-1)
        measured, d_ideal, d_coefficients = self.distortion.distort_with_jacobians(ideal)
        d_point = np.empty((*points.shape[:-1], 2, 3))
        d_point[..., :2] = self._times_matrix(d_ideal)
        d_point[..., 2] = -(d_point[..., 0] * ideal[..., :1] + d_point[..., 1] * ideal[..., 1:])
        d_point /= np.where(points[..., 2] > 0, points[..., 2], np.nan)[..., None, None]
        d_parameters = np.zeros((*points.shape[:-1], 2, 10))
        d_parameters[..., :5] = _own_derivatives(measured)
        d_parameters[..., 5:] = self._times_matrix(d_coefficients)
        pixels = self._times_matrix(measured[..., None])[..., 0] + [self.center_x_px, self.center_y_px]
        return Projection(pixels, d_point, d_parameters)

    def project_posed(self, points_m: npt.ArrayLike, cam_from_frame: RigidTransform) -> PosedProjection:
        """Project points of another frame, with derivatives also for the pose.

        Parameters
        ----------
        points_m : array_like, shape (..., 3)
            Points in that frame [m].
        cam_from_frame : RigidTransform
            Pose of the frame in the camera's.

        Returns
        -------
        PosedProjection
            ``pixels_px`` (..., 2) [px], ``d_pixel_d_point`` (..., 2, 3) for the point in its own frame,
            ``d_pixel_d_pose`` (..., 2, 6) for the steps of `RigidTransform.moved` (rotation vector [rad], shift [m]),
            ``d_pixel_d_parameters`` (..., 2, 10).

        Raises
        ------
        InputError
            The last axis does not have three elements.
        """
        turned = cam_from_frame.rotate(coordinates("points_m", points_m, 3))
        pixels, d_point, d_parameters = self.project_with_jacobians(turned + cam_from_frame.translation_m)
        d_pose = np.concatenate((-d_point @ skew_matrices(turned), d_point), axis=-1)
        return PosedProjection(pixels, d_point @ cam_from_frame.rotation, d_pose, d_parameters)

    def cast_rays_with_jacobians(self, pixels_px: npt.ArrayLike) -> LinesOfSight:
        """Cast lines of sight, with derivatives.

        Parameters
        ----------
        pixels_px : array_like, shape (..., 2)
            Image points [px].

        Returns
        -------
        LinesOfSight
            Unit directions with derivatives.

        Raises
        ------
        InputError
            The last axis does not have two elements.
        """
        pixels = coordinates("pixels_px", pixels_px, 2)
        measured = np.stack(self._normalised(pixels[..., 0], pixels[..., 1]), axis=-1)
        ideal, d_measured, d_coefficients = self.distortion.undistort_with_jacobians(measured)
        length = np.sqrt(1 + (ideal * ideal).sum(axis=-1))[..., None]
        rays = np.concatenate((ideal / length, 1 / length), axis=-1)
        # d(v/|v|) = (I - ray ray^T) dv / |v|, where v = (x, y, 1) moves in x and y only.
        d_ideal = (np.eye(3)[:, :2] - rays[..., :, None] * rays[..., None, :2]) / length[..., None]
        inverse = np.array(
            [[1 / self.focal_x_px, -self.skew / (self.focal_x_px * self.focal_y_px)], [0, 1 / self.focal_y_px]]
        )
        d_pixel = d_ideal @ (d_measured @ inverse)
        # A parameter that would move the image point by d needs the opposite move to keep the point where it is.
        d_parameters = np.concatenate((-d_pixel @ _own_derivatives(measured), d_ideal @ d_coefficients), axis=-1)
        return LinesOfSight(rays, d_pixel, d_parameters)

    def projection_covariance_px2(self, points_m: npt.ArrayLike) -> FloatArray:
        """Carry the covariance of the parameters to image points.

        Parameters
        ----------
        points_m : array_like, shape (..., 3)
            Points in the camera frame [m], taken as exact.

        Returns
        -------
        ndarray, shape (..., 2, 2)
            Covariance of the image point [px^2]; the roots of its diagonal are the sigma in columns and rows.
        """
        return _propagated(self.project_with_jacobians(points_m)[2], self.covariance)

    def ray_covariance(self, pixels_px: npt.ArrayLike, sigma_pixel_px: float = 0.0) -> FloatArray:
        """Carry the covariance of the parameters, and the noise of an image point, to its line of sight.

        Parameters
        ----------
        pixels_px : array_like, shape (..., 2)
            Image points [px].
        sigma_pixel_px : float, optional
            Standard deviation of each coordinate of the image points [px].

        Returns
        -------
        ndarray, shape (..., 3, 3)
            Covariance of the unit direction [rad^2], without a part along the direction.
        """
        _, d_pixel, d_parameters = self.cast_rays_with_jacobians(pixels_px)
        noise = (sigma_pixel_px**2) * (d_pixel @ np.swapaxes(d_pixel, -1, -2))
        return np.asarray(_propagated(d_parameters, self.covariance) + noise)

    def sigma_ray_rad(self, pixels_px: npt.ArrayLike, sigma_pixel_px: float = 0.0) -> FloatArray:
        """Return the uncertainty of a line of sight's angle, both directions added in squares, shape (...) [rad]."""
        return np.asarray(np.sqrt(np.trace(self.ray_covariance(pixels_px, sigma_pixel_px), axis1=-2, axis2=-1)))

    def invertible_region(self) -> InvertibleRegion:
        """Tell where the lens model is one-to-one, and whether that covers the image.

        Returns
        -------
        InvertibleRegion
            ``whole_image``; ``radius`` in normalised coordinates (ideal ones if the polynomial starts from those, see
            `BrownDistortion.invertible_radius`); ``radius_px``, the smallest distance from the principal point to the
            edge of the region in the image [px]; ``farthest_corner_px``, the distance of the farthest image corner
            [px]; ``message`` in words. Radii are infinite where the model never folds.

        Notes
        -----
        The region has no holes, so it covers the image when it covers the image's border.
        """
        border = self._border_px(64)
        whole = bool(np.isfinite(self.cast_rays(border)).all())
        center = np.array([self.center_x_px, self.center_y_px])
        farthest_px = float(np.hypot(*(self._border_px(1) - center).T).max())
        radius, radius_px = self.distortion.invertible_radius, np.inf
        if np.isfinite(radius):
            angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
            edge = (1 - 1e-12) * radius * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
            measured = self.distortion.distort(edge) if self.distortion.distorts_in_closed_form else edge
            radius_px = float(np.hypot(*self._times_matrix(measured[..., None])[..., 0].T).min())
        limit = "everywhere" if np.isinf(radius_px) else f"up to {radius_px:.1f} px from the principal point"
        reach = "covers the whole image" if whole else "leaves out part of the image"
        message = (
            f"the lens model is one-to-one {limit} (normalised radius {radius:.4f}), which {reach} "
            f"(farthest corner {farthest_px:.1f} px)"
        )
        return InvertibleRegion(whole, radius, radius_px, farthest_px, message)

    def _normalised(self, column_px: FloatArray, row_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        y = (row_px - self.center_y_px) * (1 / self.focal_y_px)
        x = column_px - self.center_x_px
        if self.skew:
            x = x - self.skew * y
        x *= 1 / self.focal_x_px
        return x, y

    def _cast(self, column_px: FloatArray, row_px: FloatArray, start: InverseStart | None, rays: FloatArray) -> None:
        x, y = self.distortion.undistort_components(*self._normalised(column_px, row_px), start)
        scale = x * x
        scale += y * y
        scale += 1.0
        np.sqrt(scale, out=scale)
        np.divide(1.0, scale, out=scale)
        np.multiply(x, scale, out=rays[:, 0])
        np.multiply(y, scale, out=rays[:, 1])
        rays[:, 2] = scale

    def _times_matrix(self, derivative: FloatArray) -> FloatArray:
        """Multiply by the upper-left 2 x 2 of the camera matrix, shape (..., 2, n); its zero stays a true zero."""
        result = derivative * np.array([[self.focal_x_px], [self.focal_y_px]])
        if self.skew:
            result[..., 0, :] += self.skew * derivative[..., 1, :]
        return np.asarray(result)

    def _border_px(self, per_side: int) -> FloatArray:
        """Return points on the outer border of the image, corners included, shape (4 * per_side, 2)."""
        share = np.linspace(0, 1, per_side, endpoint=False)
        corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float64)
        sides = corners[:, None] + share[:, None] * (np.roll(corners, -1, axis=0) - corners)[:, None]
        return np.asarray(sides.reshape(-1, 2) * [self.width_px, self.height_px] - 0.5)

    def _corner_radius(self) -> float:
        corners = self._border_px(1)
        return float(np.hypot(*self._normalised(corners[:, 0], corners[:, 1])).max())

    def _start_for_image(self) -> InverseStart | None:
        if self.distortion.is_zero or not self.distortion.distorts_in_closed_form:
            return None
        return self.distortion.inverse_start(self._corner_radius())


def _over_depth(points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return x/z and y/z, NaN where z is not positive."""
    inverse_depth = np.full(points_m.shape[:-1], np.nan)
    np.divide(1.0, points_m[..., 2], out=inverse_depth, where=points_m[..., 2] > 0)
    return points_m[..., 0] * inverse_depth, points_m[..., 1] * inverse_depth


def _own_derivatives(measured_xy: FloatArray) -> FloatArray:
    """Return the derivative of pixels with respect to the first five parameters, shape (..., 2, 5)."""
    derivative = np.zeros((*measured_xy.shape, 5))
    derivative[..., 0, 0] = measured_xy[..., 0]
    derivative[..., 0, 4] = derivative[..., 1, 1] = measured_xy[..., 1]
    derivative[..., 0, 2] = derivative[..., 1, 3] = 1.0
    return derivative


def _propagated(jacobian: FloatArray, covariance: FloatArray) -> FloatArray:
    return np.asarray((jacobian @ covariance) @ np.swapaxes(jacobian, -1, -2))
