"""The synthetic screen: a wall that may bulge and a projected image that may be keystoned, both in closed form."""

from dataclasses import dataclass

import numpy as np

from heliogauge.errors import InputError
from heliogauge.validate import FloatArray, positive


@dataclass(frozen=True, slots=True, eq=False)
class Wall:
    """A screen: display coordinates (u, v) in fractions of the image, from its left and its TOP edge.

    width_m, height_m: Size of the displayed image [m].
    sag_x_m, sag_y_m: How far the left and right, the top and bottom edges come towards the viewer (parabolic) [m].
    keystone_x, keystone_y: Relative change of the image's width from its middle to twice its lower half, and of its
        height to the right: ``x = W (u - 1/2) (1 + keystone_x (v - 1/2))``, ``y = H (1/2 - v) (1 + keystone_y (u -
        1/2))``.

    Frame: x to the right and y up as a viewer sees the screen, z towards the viewer, origin in the middle.
    """

    width_m: float
    height_m: float
    sag_x_m: float = 0.0
    sag_y_m: float = 0.0
    keystone_x: float = 0.0
    keystone_y: float = 0.0

    def __post_init__(self) -> None:
        positive("screen width_m", self.width_m, "metres")
        positive("screen height_m", self.height_m, "metres")
        if max(abs(self.keystone_x), abs(self.keystone_y)) > 0.5:
            raise InputError("screen keystone: at most 0.5 in size is supported")

    @property
    def is_plain(self) -> bool:
        """Whether it is a flat rectangle with an undistorted image."""
        return not any((self.sag_x_m, self.sag_y_m, self.keystone_x, self.keystone_y))

    def points_m(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Return the points of the wall that show (u, v), shape (..., 3) [m]."""
        right, down = np.asarray(u) - 0.5, np.asarray(v) - 0.5
        x = self.width_m * right * (1 + self.keystone_x * down)
        y = -self.height_m * down * (1 + self.keystone_y * right)
        z = self.sag_x_m * (2 * x / self.width_m) ** 2 + self.sag_y_m * (2 * y / self.height_m) ** 2
        return np.stack([x, y, z], axis=-1)

    def hit(self, origins_m: FloatArray, directions: FloatArray) -> FloatArray:
        """Find where rays meet the wall.

        origins_m, directions (..., 3): Rays in the screen's frame.
        Returns (..., 3): Points on the wall (also beyond its edges); NaN where a ray leaves it or comes from behind
            [m].
        """
        curve = np.array([4 * self.sag_x_m / self.width_m**2, 4 * self.sag_y_m / self.height_m**2])
        # curve . (o + t d)^2 = o_z + t d_z: the root next to the flat wall, without loss of digits.
        a = (curve * directions[..., :2] ** 2).sum(axis=-1)
        b = 2 * (curve * origins_m[..., :2] * directions[..., :2]).sum(axis=-1) - directions[..., 2]
        c = (curve * origins_m[..., :2] ** 2).sum(axis=-1) - origins_m[..., 2]
        with np.errstate(invalid="ignore", divide="ignore"):
            root = np.sqrt(b * b - 4 * a * c)
            path = -2 * c / (b + np.where(b >= 0, root, -root))
        path = np.where((path > 0) & (directions[..., 2] < 0), path, np.nan)
        return origins_m + path[..., None] * directions

    def display_coordinates(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the display coordinates (u, v) that points of the wall show; outside 0..1 beyond the image."""
        wide, high = points_m[..., 0] / self.width_m, -points_m[..., 1] / self.height_m
        right, down = wide, high
        if self.keystone_x or self.keystone_y:
            for _ in range(8):
                miss_wide = right * (1 + self.keystone_x * down) - wide
                miss_high = down * (1 + self.keystone_y * right) - high
                a, b = 1 + self.keystone_x * down, self.keystone_x * right
                c, d = self.keystone_y * down, 1 + self.keystone_y * right
                determinant = a * d - b * c
                right, down = (
                    right - (d * miss_wide - b * miss_high) / determinant,
                    down - (a * miss_high - c * miss_wide) / determinant,
                )
        return right + 0.5, down + 0.5
