"""Where a fixed camera is in the frame of a collector that turns before it, from readings of an inclinometer.

The collector turns about its axis of rotation at (X, Z) by the right hand about +y, as the readings t grow. In its own
frame a camera at distance D that it faces at the reading f then stands at::

    eye = (X, 0, Z) + (D sin a, L, D cos a),   a = g (f - t),

with L the camera's place along the trough and g the scale of the inclinometer, nearly 1.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from heliogauge.validate import FloatArray


class TiltReadings(NamedTuple):
    """Readings of all photos.

    tilt_rad (n,): Turn of the collector about +y as read; NaN where there is no reading [rad].
    sigma_rad (n,): Standard deviation against the other readings [rad].
    """

    tilt_rad: FloatArray
    sigma_rad: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class FarCamera:
    """A fixed camera before a collector that turns.

    facing_rad: Reading at which the collector faces it [rad].
    distance_m: From the axis of rotation [m].
    along_m: Its place along the trough [m].
    axis_x_m, axis_z_m: The axis of rotation in the frame of the trough [m].
    scale: Turn of the collector for one of the readings'.
    """

    facing_rad: float
    distance_m: float
    along_m: float
    axis_x_m: float
    axis_z_m: float
    scale: float = 1.0

    @property
    def unknowns(self) -> FloatArray:
        """All numbers in the order of the fields, shape (6,)."""
        return np.array([getattr(self, name) for name in self.__slots__], dtype=np.float64)

    def direction_rad(self, tilt_rad: FloatArray) -> FloatArray:
        """Return the angle of the camera from the collector's z axis towards +x at each reading, shape (n,) [rad]."""
        return np.asarray(self.scale * (self.facing_rad - tilt_rad))

    def eyes_m(self, tilt_rad: FloatArray) -> FloatArray:
        """Return where the camera is in the frame of the trough at each reading, shape (n, 3) [m]."""
        angle = self.direction_rad(tilt_rad)
        across, along = self.distance_m * np.sin(angle), np.full(angle.shape, self.along_m)
        return np.stack([self.axis_x_m + across, along, self.axis_z_m + self.distance_m * np.cos(angle)], axis=1)

    def tangents_m(self, tilt_rad: FloatArray) -> FloatArray:
        """Return by how much the camera moves with its angle, shape (n, 3) [m/rad]."""
        angle = self.direction_rad(tilt_rad)
        return self.distance_m * np.stack([np.cos(angle), np.zeros_like(angle), -np.sin(angle)], axis=1)

    def derivatives(self, tilt_rad: FloatArray) -> FloatArray:
        """Differentiate `eyes_m` with respect to `unknowns`, shape (n, 3, 6)."""
        angle, tangent = self.direction_rad(tilt_rad), self.tangents_m(tilt_rad)
        found = np.zeros((angle.size, 3, 6))
        found[:, :, 0] = self.scale * tangent
        found[:, 0, 1], found[:, 2, 1] = np.sin(angle), np.cos(angle)
        found[:, 1, 2] = found[:, 0, 3] = found[:, 2, 4] = 1.0
        found[:, :, 5] = (self.facing_rad - tilt_rad)[:, None] * tangent
        return found


@dataclass(frozen=True, slots=True, eq=False)
class KnownFarCamera:
    """A far camera as surveyed.

    camera: As stated.
    sigma (6,): Standard deviations of its unknowns [rad, m, m, m, m, 1].
    """

    camera: FarCamera
    sigma: FloatArray

    def sigma_m(self) -> FloatArray:
        """Return how well the camera's place is known in the frame of the trough, x, y and z, shape (3,) [m]."""
        facing, distance, along, axis_x, axis_z, _ = self.sigma
        across = float(np.hypot(axis_x, self.camera.distance_m * facing))
        return np.array([across, float(along), float(np.hypot(axis_z, distance))])
