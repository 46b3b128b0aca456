"""A heliostat under test, drawn: how its beam strays, and where that is on the target."""

from dataclasses import dataclass, field

import numpy as np

from heliogauge.geometry.sun import Site, sun_directions
from heliogauge.validate import FloatArray, TimeArray


@dataclass(frozen=True, slots=True)
class TestPlant:
    """A plant with one heliostat and what is wrong with it.

    heliostat_m, target_m: East, north, up [m].
    facing_rad: Azimuth that the upright target faces [rad].
    tilt_rad: The pedestal leans to north and to east by this [rad].
    wobble_rad, memory_s: Slow random motion of the normal, each direction: size and memory [rad, s].
    place_sigma_m: Noise of a measured place [m].
    play_rad: Play of azimuth and of elevation, end to end [rad].
    gust_rad_s_m: What each m/s of wind adds to the motion of the normal, each direction [rad s/m].
    update_s: Interval at which the drives are set [s].
    """

    __test__ = False
    heliostat_m: tuple[float, float, float] = (15.0, 120.0, 4.0)
    target_m: tuple[float, float, float] = (0.0, 0.0, 40.0)
    facing_rad: float = 0.0
    tilt_rad: tuple[float, float] = (0.4e-3, -0.25e-3)
    wobble_rad: float = 0.15e-3
    memory_s: float = 900.0
    place_sigma_m: float = 0.02
    play_rad: tuple[float, float] = (1.6e-3, 0.9e-3)
    gust_rad_s_m: float = 0.06e-3
    update_s: float = 60.0
    site: Site = field(default_factory=lambda: Site(37.09, -2.36, 500.0))

    @property
    def _place(self) -> FloatArray:
        return np.array(self.heliostat_m)

    @property
    def _aim(self) -> FloatArray:
        return np.array(self.target_m)

    def aimed_normals(self, suns: FloatArray) -> FloatArray:
        """Return the normals that aim at the target's centre, shape (n, 3)."""
        along = self._aim - self._place
        middle = suns + along / np.linalg.norm(along)
        return np.asarray(middle / np.linalg.norm(middle, axis=1, keepdims=True))

    def leaned(self, normals: FloatArray) -> FloatArray:
        """Return normals on the leaning pedestal, shape (n, 3)."""
        north, east = self.tilt_rad
        # Leaning north turns about the axis to the west, leaning east about that to the north.
        turn = np.array([-north, east, 0.0])
        return np.asarray(normals + np.cross(turn, normals))

    def places(self, normals: FloatArray, suns: FloatArray) -> FloatArray:
        """Return where beams of normals meet the target, right and up from its centre, shape (n, 2) [m]."""
        unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        beams = 2 * np.sum(suns * unit, axis=1, keepdims=True) * unit - suns
        face = np.array([np.sin(self.facing_rad), np.cos(self.facing_rad), 0.0])
        right = np.array([-np.cos(self.facing_rad), np.sin(self.facing_rad), 0.0])
        length = ((self._aim - self._place) @ face) / (beams @ face)
        hits = self._place + length[:, None] * beams - self._aim
        return np.stack([hits @ right, hits[:, 2]], axis=1)

    def places_of_angles(self, angles_rad: FloatArray) -> FloatArray:
        """Return where beams meet the target that stray by angles from the line to its centre (n, 2) [m].

        angles_rad (n, 2): Tangents across the line of sight, right and up [rad].
        """
        along = self._aim - self._place
        along = along / np.linalg.norm(along)
        level = np.array([along[1], -along[0], 0.0])
        level = level / np.linalg.norm(level)
        upward = np.cross(level, along)
        beams = along + np.tan(angles_rad[:, :1]) * level + np.tan(angles_rad[:, 1:]) * upward
        face = np.array([np.sin(self.facing_rad), np.cos(self.facing_rad), 0.0])
        right = np.array([-np.cos(self.facing_rad), np.sin(self.facing_rad), 0.0])
        length = ((self._aim - self._place) @ face) / (beams @ face)
        hits = self._place + length[:, None] * beams - self._aim
        return np.stack([hits @ right, hits[:, 2]], axis=1)

    def angles(self, places_m: FloatArray) -> FloatArray:
        """Return the angles between the beams to places and the line to the target's centre, shape (n,) [rad]."""
        face = np.array([np.sin(self.facing_rad), np.cos(self.facing_rad), 0.0])
        right = np.cross([0.0, 0.0, 1.0], face)
        points = self._aim + places_m[:, :1] * right + places_m[:, 1:] * np.array([0.0, 0.0, 1.0])
        one = points - self._place
        one = one / np.linalg.norm(one, axis=1, keepdims=True)
        other = (self._aim - self._place) / np.linalg.norm(self._aim - self._place)
        return np.asarray(2 * np.arcsin(np.linalg.norm(one - other, axis=1) / 2))


def daylight(site: Site, day: str, step_s: float, lowest_rad: float) -> TimeArray:
    """Return the moments of a day at which the sun stands high enough, in steps."""
    begin = np.datetime64(day, "ms")
    times = begin + np.arange(0, 86_400, step_s).astype(np.int64) * 1000 * np.timedelta64(1, "ms")
    return np.asarray(times[sun_directions(times, site)[:, 2] > np.sin(lowest_rad)])


def slow_motion(rng: np.random.Generator, times_s: FloatArray, size: float, memory_s: float) -> FloatArray:
    """Draw a motion that forgets itself exponentially, two directions, shape (n, 2)."""
    drawn = np.empty((times_s.size, 2))
    drawn[0] = rng.normal(0, size, 2)
    for row in range(1, times_s.size):
        kept = np.exp(-(times_s[row] - times_s[row - 1]) / memory_s)
        drawn[row] = kept * drawn[row - 1] + size * np.sqrt(1 - kept**2) * rng.normal(0, 1, 2)
    return drawn
