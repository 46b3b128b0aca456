"""The synthetic camera: a pinhole with Brown distortion, written apart from the camera model of the estimators."""

from dataclasses import dataclass

import numpy as np

from heliogauge.errors import InputError
from heliogauge.validate import FloatArray, positive

#: Newton needs 4 to 6 steps for a machine-vision lens; a lens that still moves after 50 folds inside the image.
_MOST_STEPS = 50


@dataclass(frozen=True, slots=True, eq=False)
class PinholeCamera:
    """A camera that draws: pixel centre (0, 0) top left, x right, y down, z forward.

    width_px, height_px: Size of the image [px].
    focal_x_px, focal_y_px: Focal lengths [px].
    center_x_px, center_y_px: Principal point [px].
    k1, k2, k3, p1, p2: Brown coefficients from the ideal to the measured image, on coordinates divided by the focal
        length: ``xd = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)`` (the order of OpenCV's p1
        and p2).
    """

    width_px: int
    height_px: int
    focal_x_px: float
    focal_y_px: float
    center_x_px: float
    center_y_px: float
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    def __post_init__(self) -> None:
        for name in ("width_px", "height_px", "focal_x_px", "focal_y_px"):
            positive(f"camera {name}", getattr(self, name), "px")

    def distort(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Move ideal image coordinates to where the lens shows them.

        x, y (...): Ideal coordinates (x/z, y/z).
        """
        square = x * x + y * y
        radial = 1 + square * (self.k1 + square * (self.k2 + square * self.k3))
        xd = x * radial + 2 * self.p1 * x * y + self.p2 * (square + 2 * x * x)
        yd = y * radial + self.p1 * (square + 2 * y * y) + 2 * self.p2 * x * y
        return xd, yd

    def undistort(self, xd: FloatArray, yd: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Invert `distort` by Newton's method to round-off.

        xd, yd (...): Measured coordinates.
        InputError: The lens folds the image over inside the frame: no inverse exists.
        """
        x, y = np.array(xd, dtype=np.float64), np.array(yd, dtype=np.float64)
        if not any((self.k1, self.k2, self.k3, self.p1, self.p2)):
            return x, y
        for _ in range(_MOST_STEPS):
            square = x * x + y * y
            radial = 1 + square * (self.k1 + square * (self.k2 + square * self.k3))
            # d radial / d (r^2); the Jacobian of Brown's model is symmetric.
            slope = self.k1 + square * (2 * self.k2 + 3 * square * self.k3)
            a = radial + 2 * x * x * slope + 2 * self.p1 * y + 6 * self.p2 * x
            b = 2 * x * y * slope + 2 * self.p1 * x + 2 * self.p2 * y
            d = radial + 2 * y * y * slope + 6 * self.p1 * y + 2 * self.p2 * x
            seen_x, seen_y = self.distort(x, y)
            miss_x, miss_y = xd - seen_x, yd - seen_y
            determinant = a * d - b * b
            if np.any(determinant <= 0):
                break
            x += (d * miss_x - b * miss_y) / determinant
            y += (a * miss_y - b * miss_x) / determinant
            if max(float(np.max(np.abs(miss_x), initial=0)), float(np.max(np.abs(miss_y), initial=0))) < 1e-15:
                return x, y
        residual_x, residual_y = self.distort(x, y)
        worst = max(float(np.max(np.abs(residual_x - xd))), float(np.max(np.abs(residual_y - yd))))
        if not worst < 1e-13:
            raise InputError("camera: this distortion folds the image over inside the frame; weaken it")
        return x, y

    def rays(self, x_px: FloatArray, y_px: FloatArray) -> FloatArray:
        """Return the unit directions in which points of the image look.

        Shapes: x_px, y_px (...).
        Returns (..., 3): Unit directions in the camera frame.
        """
        x, y = self.undistort(
            (np.asarray(x_px, dtype=np.float64) - self.center_x_px) / self.focal_x_px,
            (np.asarray(y_px, dtype=np.float64) - self.center_y_px) / self.focal_y_px,
        )
        length = np.sqrt(x * x + y * y + 1)
        return np.stack([x / length, y / length, 1 / length], axis=-1)

    def project(self, points_cam_m: FloatArray) -> FloatArray:
        """Return the image points of points in front of the camera.

        Shapes: points_cam_m (..., 3).
        Returns (..., 2): Image points (x, y); NaN behind the camera [px].
        """
        depth = np.where(points_cam_m[..., 2] > 0, points_cam_m[..., 2], np.nan)
        x, y = self.distort(points_cam_m[..., 0] / depth, points_cam_m[..., 1] / depth)
        return np.stack([x * self.focal_x_px + self.center_x_px, y * self.focal_y_px + self.center_y_px], axis=-1)

    def scaled(self, factor: float) -> "PinholeCamera":
        """Return the same lens on a sensor with finer or coarser pixels.

        factor: Pixels per old pixel.
        Returns: The camera; the corner of the image stays where it is.
        """
        return PinholeCamera(
            round(self.width_px * factor),
            round(self.height_px * factor),
            self.focal_x_px * factor,
            self.focal_y_px * factor,
            (self.center_x_px + 0.5) * factor - 0.5,
            (self.center_y_px + 0.5) * factor - 0.5,
            *(self.k1, self.k2, self.k3, self.p1, self.p2),
        )
