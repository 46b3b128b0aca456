"""From places on a target to angles of beam and normal: the geometry of a series of beams."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.geometry.rays import reflect
from heliogauge.validate import FloatArray, float_array, freeze


@dataclass(frozen=True, slots=True, eq=False)
class LineOfSight:
    """A heliostat and the target that it aims at.

    heliostat_m (3,): East, north, up [m].
    target_m (3,): Centre of the target [m].
    facing_rad: Azimuth that the target faces, 0 north, clockwise [rad].
    tilt_rad: Elevation of its normal; 0: it stands upright [rad].
    aim_m (2,): Aim on the target from its centre, right and up as seen from the field [m].
    InputError: The heliostat stands in the target or behind it.
    """

    heliostat_m: FloatArray
    target_m: FloatArray
    facing_rad: float
    tilt_rad: float
    aim_m: FloatArray

    def __post_init__(self) -> None:
        for name, size in (("heliostat_m", 3), ("target_m", 3), ("aim_m", 2)):
            object.__setattr__(self, name, float_array(name, getattr(self, name), (size,)))
        away = self.heliostat_m - self.target_m
        if not away @ self._normal > 0:
            raise InputError(
                "target.facing_azimuth_deg: the heliostat stands behind the target or in its plane; 0 is north, 90 east"
            )

    @property
    def _normal(self) -> FloatArray:
        level = np.cos(self.tilt_rad)
        return np.array([level * np.sin(self.facing_rad), level * np.cos(self.facing_rad), np.sin(self.tilt_rad)])

    @property
    def axes(self) -> FloatArray:
        """Right and up on the target as seen from the field, shape (2, 3)."""
        right = np.array([-np.cos(self.facing_rad), np.sin(self.facing_rad), 0.0])
        return np.stack([right, np.cross(self._normal, right)])

    @property
    def slant_range_m(self) -> float:
        """From the heliostat to its aim [m]."""
        return float(np.linalg.norm(self.points(self.aim_m[None])[0] - self.heliostat_m))

    def points(self, places_m: FloatArray) -> FloatArray:
        """Return places on the target (n, 2) in the field's frame (n, 3) [m]."""
        return np.asarray(self.target_m + places_m @ self.axes)

    def beam_angles(self, places_m: npt.ArrayLike) -> FloatArray:
        """Return the angles of beams from the aim, right and up across the line of sight, shape (n, 2) [rad].

        places_m (n, 2): Places on the target from its centre, right and up [m].
        """
        towards = self.points(float_array("places_m", places_m, (None, 2))) - self.heliostat_m
        along = self.points(self.aim_m[None])[0] - self.heliostat_m
        along = along / np.linalg.norm(along)
        right = np.cross(along, [0.0, 0.0, 1.0])
        length = float(np.linalg.norm(right))
        right = right / length if length > 1e-6 else self.axes[0]
        up = np.cross(right, along)
        ahead = towards @ along
        return np.stack([np.arctan2(towards @ right, ahead), np.arctan2(towards @ up, ahead)], axis=1)

    def angle_scale(self) -> FloatArray:
        """Return the angle of beam for each metre on the target, as a matrix (2, 2) from (right, up) to angles."""
        step = 1e-3
        at = self.aim_m + step * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        angles = self.beam_angles(at)
        return np.stack([angles[0] - angles[1], angles[2] - angles[3]], axis=1) / (2 * step)

    def normal_errors(self, places_m: npt.ArrayLike, sun: npt.ArrayLike) -> FloatArray:
        """Return the angle between the normal that the mirror had and the one that aims, shape (n,) [rad].

        places_m (n, 2): Places on the target from its centre [m].
        sun (n, 3): Directions to the sun.

        Half the beam's angle in the plane of incidence, more across it (Malan 2014, 6.3: a factor 2 cos of incidence).
        """
        from calibration.heliostat.diagnosis.backlash import normals_from_spots

        places = float_array("places_m", places_m, (None, 2))
        real = normals_from_spots(self.points(places), sun, self.heliostat_m)
        aimed = normals_from_spots(np.broadcast_to(self.points(self.aim_m[None]), real.shape), sun, self.heliostat_m)
        cross = np.linalg.norm(np.cross(real, aimed), axis=1)
        return freeze(np.arctan2(cross, np.einsum("ij,ij->i", real, aimed)))

    def still_mirror_step(self, sun: npt.ArrayLike, later: npt.ArrayLike) -> FloatArray:
        """Return how far a beam wanders while the mirror stands still and the sun moves on, shape (2,) [rad].

        sun, later (3,): Directions to the sun at the beginning and the end.
        """
        from calibration.heliostat.diagnosis.backlash import normals_from_spots

        aim = self.points(self.aim_m[None])
        normal = normals_from_spots(aim, float_array("sun", sun, (3,))[None], self.heliostat_m)
        beam = reflect(-float_array("later", later, (3,))[None], normal)[0]
        along = aim[0] - self.heliostat_m
        distance = float(along @ self._normal) / float(beam @ self._normal)
        hit = self.heliostat_m + distance * beam - self.target_m
        return np.asarray(self.beam_angles((self.axes @ hit)[None])[0])
