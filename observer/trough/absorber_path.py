"""Where the absorber tube's axis runs along the trough, with its covariance."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, IntArray, float_array
from observer.trough.collector import Collector


@dataclass(frozen=True, slots=True, eq=False)
class AbsorberPath(ShortRepr):
    """Axis of the absorber tube: a polyline through stations along the trough.

    y_m (n,): Ascending stations along the trough [m].
    x_m, z_m (n,): Position of the axis at the stations [m].
    covariance_m2 (2 n, 2 n): Joint covariance of (x_1 .. x_n, z_1 .. z_n) [m^2].
    InputError: Stations that do not ascend, or arrays that do not belong together.
    """

    y_m: FloatArray
    x_m: FloatArray
    z_m: FloatArray
    covariance_m2: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "y_m", float_array("absorber y_m", self.y_m, (None,)))
        n = self.y_m.size
        if n == 0 or (np.diff(self.y_m) <= 0).any():
            raise InputError("absorber y_m: at least one station, and stations that ascend, are needed")
        for name in ("x_m", "z_m"):
            object.__setattr__(self, name, float_array(f"absorber {name}", getattr(self, name), (n,)))
        covariance = float_array("absorber covariance_m2", self.covariance_m2, (2 * n, 2 * n))
        object.__setattr__(self, "covariance_m2", covariance)

    @classmethod
    def straight(cls, x_m: float, z_m: float, half_length_m: float) -> "AbsorberPath":
        """Return an axis parallel to the trough that is known without error.

        Returns: Two stations, covariance zero.
        """
        ends = np.array([-half_length_m, half_length_m])
        return cls(ends, np.full(2, x_m), np.full(2, z_m), np.zeros((4, 4)))

    @classmethod
    def designed(cls, collector: Collector) -> "AbsorberPath":
        """Return the axis in the focal line of the design, as long as the collector, known without error."""
        return cls.straight(0.0, collector.focal_length_m, collector.length_m / 2)

    @property
    def n(self) -> int:
        """Number of stations."""
        return self.y_m.size

    def at(self, y_m: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the axis at any place along the trough; beyond the ends it goes on as at the end.

        Shapes: y_m (...), x_m, z_m (...).
        """
        place = np.asarray(y_m, dtype=np.float64)
        return np.interp(place, self.y_m, self.x_m), np.interp(place, self.y_m, self.z_m)

    def slopes_at(self, y_m: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return by how much the axis leans at any place along the trough, dx/dy and dz/dy; beyond the ends not at all.

        Shapes: y_m (...), slope_x, slope_z (...).

        Differences of neighbouring stations, interpolated between: a tube has no kinks at its stations.
        """
        place = np.asarray(y_m, dtype=np.float64)
        if self.n == 1:
            return np.zeros(place.shape), np.zeros(place.shape)
        inside = (place >= self.y_m[0]) & (place <= self.y_m[-1])
        leans = (np.interp(place, self.y_m, np.gradient(values, self.y_m)) for values in (self.x_m, self.z_m))
        slope_x, slope_z = (np.where(inside, lean, 0.0) for lean in leans)
        return slope_x, slope_z

    def shares(self, y_m: npt.ArrayLike) -> tuple[IntArray, FloatArray]:
        """Return which station lies before each place and the share of the one after it.

        Shapes: before (m,).
        y_m (m,): Places along the trough [m].
        share (m,): Share of the next station, 0 to 1.
        """
        place = np.asarray(y_m, dtype=np.float64)
        if self.n == 1:
            return np.zeros(place.shape, dtype=np.intp), np.zeros(place.shape)
        before = np.clip(np.searchsorted(self.y_m, place, side="right") - 1, 0, self.n - 2)
        share = (place - self.y_m[before]) / (self.y_m[before + 1] - self.y_m[before])
        return before, np.clip(share, 0.0, 1.0)

    def sigma_at(self, y_m: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the standard deviations of x and z at any place along the trough.

        Shapes: y_m (m,), sigma_x_m, sigma_z_m (m,).
        """
        before, share = self.shares(y_m)
        after = np.minimum(before + 1, self.n - 1)
        sigmas = []
        for first in (0, self.n):
            block = self.covariance_m2[first : first + self.n, first : first + self.n]
            variance = (1 - share) ** 2 * block[before, before] + share**2 * block[after, after]
            variance = variance + 2 * share * (1 - share) * block[before, after]
            sigmas.append(np.sqrt(np.maximum(variance, 0.0)))
        return sigmas[0], sigmas[1]
