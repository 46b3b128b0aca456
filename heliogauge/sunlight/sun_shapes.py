"""Sun shapes: how bright the sky is at an angle from the sun's centre, and sunlight drawn from it."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.validate import Float32Array, FloatArray, float_array, positive

#: Half angle of the solar disc in the Buie model and of the usual pillbox [rad].
SOLAR_DISC_RAD = 4.65e-3

# Of the inverse cumulative distribution. At 16384 steps of sqrt(share) the last one holds 1.2e-4 of the power, and the
# float32 table (64 KiB) stays in the second-level cache.
_TABLE_STEPS = 16384
_INTEGRATION_STEPS = 40_000


class SunShape(ABC):
    """Radiance over the angle from the sun's centre, the same in all directions around it."""

    __slots__ = ()

    @property
    @abstractmethod
    def limit_rad(self) -> float:
        """Angle beyond which there is no light [rad]."""

    @abstractmethod
    def radiance(self, theta_rad: npt.ArrayLike) -> FloatArray:
        """Return the radiance relative to the centre.

        theta_rad (...): Angles from the sun's centre [rad].
        Returns (...): 1 at the centre, 0 beyond the limit.
        """

    @abstractmethod
    def describe(self) -> str:
        """Return the shape in words with its numbers."""

    def share_within(self, theta_rad: npt.ArrayLike) -> FloatArray:
        """Return the share of the power that comes from within an angle of the centre.

        theta_rad (...): Angles from the sun's centre [rad].
        Returns (...): Between 0 and 1.
        """
        angles, shares = self._cumulative()
        return np.asarray(np.interp(np.asarray(theta_rad, dtype=np.float64), angles, shares), dtype=np.float64)

    def inverse_table(self) -> Float32Array:
        """Return tan(angle) at equal steps of the square root of the share of power inside, from 0 to 1.

        The square root makes the table straight where the radiance is flat: linear interpolation is exact for a
        pillbox and smooth at the centre for every shape.
        """
        angles, shares = self._cumulative()
        roots = np.linspace(0, 1, _TABLE_STEPS + 1)
        return np.asarray(np.tan(np.interp(roots, np.sqrt(shares), angles)), dtype=np.float32)

    def sample(self, rng: np.random.Generator, count: int) -> FloatArray:
        """Draw directions from the sun.

        Returns (count, 2): Offsets from the sun's centre in the tangent plane of the sky, tan(angle) long.
        """
        table = self.inverse_table().astype(np.float64)
        radius = np.interp(np.sqrt(rng.random(count)) * _TABLE_STEPS, np.arange(table.size), table)
        turn = 2 * np.pi * rng.random(count)
        return np.asarray(radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1), dtype=np.float64)

    def _cumulative(self) -> tuple[FloatArray, FloatArray]:
        edges = self._edges()
        middle = 0.5 * (edges[1:] + edges[:-1])
        # Solid angle cos(a) - cos(b) as a product: the difference would be zero for a sun of 1e-8 rad.
        power = self.radiance(middle) * np.sin(middle) * np.sin(0.5 * np.diff(edges))
        total = np.concatenate([[0.0], np.cumsum(power)])
        return edges, total / total[-1]

    def _edges(self) -> FloatArray:
        return np.linspace(0, self.limit_rad, _INTEGRATION_STEPS + 1)


@dataclass(frozen=True, slots=True, eq=False)
class PillboxSun(SunShape):
    """A disc of even radiance.

    half_angle_rad: Its angular radius [rad].

    >>> PillboxSun().share_within([0.0, 4.65e-3 / 2, 4.65e-3]).round(6).tolist()
    [0.0, 0.25, 1.0]
    """

    half_angle_rad: float = SOLAR_DISC_RAD

    def __post_init__(self) -> None:
        positive("half_angle_rad", self.half_angle_rad, "radians")

    @property
    def limit_rad(self) -> float:
        """Angle beyond which there is no light [rad]."""
        return self.half_angle_rad

    def radiance(self, theta_rad: npt.ArrayLike) -> FloatArray:
        """Return 1 inside the disc and 0 outside, for angles of any shape [rad]."""
        return np.where(np.abs(theta_rad) <= self.half_angle_rad, 1.0, 0.0)

    def describe(self) -> str:
        """Return the shape in words with its numbers."""
        return f"pillbox sun of {1e3 * self.half_angle_rad:.4g} mrad half angle"


@dataclass(frozen=True, slots=True, eq=False)
class GaussianSun(SunShape):
    """A Gaussian, cut at six sigma (1.5e-8 of the power lies beyond).

    sigma_rad: Standard deviation in one direction [rad].
    """

    sigma_rad: float

    def __post_init__(self) -> None:
        positive("sigma_rad", self.sigma_rad, "radians")

    @property
    def limit_rad(self) -> float:
        """Angle beyond which there is no light [rad]."""
        return 6 * self.sigma_rad

    def radiance(self, theta_rad: npt.ArrayLike) -> FloatArray:
        """Return ``exp(-theta^2 / (2 sigma^2))`` for angles of any shape [rad]."""
        theta = np.asarray(theta_rad, dtype=np.float64)
        return np.where(np.abs(theta) <= self.limit_rad, np.exp(-0.5 * (theta / self.sigma_rad) ** 2), 0.0)

    def describe(self) -> str:
        """Return the shape in words with its numbers."""
        return f"Gaussian sun of {1e3 * self.sigma_rad:.4g} mrad (1 sigma in one direction)"


@dataclass(frozen=True, slots=True, eq=False)
class BuieSun(SunShape):
    """The sun shape of Buie, Monger and Dey: a darkened disc and an aureole that follows a power law.

    circumsolar_ratio: The model's chi: share of the power that comes from outside the disc, 0 (disc only) to 0.8.
    InputError: The ratio is outside 0 to 0.8.

    Buie, Monger, Dey, Solar Energy 74 (2003) 113-122, with theta in mrad::

        phi = cos(0.326 theta) / cos(0.308 theta)      theta <= 4.65
        phi = exp(kappa) theta^gamma                   4.65 < theta <= 43.6
        kappa = 0.9 ln(13.5 chi) chi^-0.3
        gamma = 2.2 ln(0.52 chi) chi^0.43 - 0.1

    The equations are a fit: the ratio that they integrate to differs from chi by up to a few hundredths
    (`circumsolar_share` gives it).
    """

    circumsolar_ratio: float

    def __post_init__(self) -> None:
        if not 0 <= self.circumsolar_ratio <= 0.8:
            raise InputError(f"circumsolar_ratio: 0 to 0.8 is needed, not {self.circumsolar_ratio}")

    @property
    def limit_rad(self) -> float:
        """Angle beyond which there is no light [rad]."""
        return 43.6e-3 if self.circumsolar_ratio > 0 else SOLAR_DISC_RAD

    def radiance(self, theta_rad: npt.ArrayLike) -> FloatArray:
        """Return the radiance relative to the centre, for angles of any shape [rad]."""
        theta_mrad = 1e3 * np.abs(np.asarray(theta_rad, dtype=np.float64))
        disc = np.cos(0.326 * np.minimum(theta_mrad, 4.65)) / np.cos(0.308 * np.minimum(theta_mrad, 4.65))
        chi = self.circumsolar_ratio
        if chi == 0:
            return np.where(theta_mrad <= 4.65, disc, 0.0)
        kappa = 0.9 * np.log(13.5 * chi) * chi**-0.3
        gamma = 2.2 * np.log(0.52 * chi) * chi**0.43 - 0.1
        aureole = np.exp(kappa) * np.maximum(theta_mrad, 4.65) ** gamma
        return np.where(theta_mrad <= 4.65, disc, np.where(theta_mrad <= 43.6, aureole, 0.0))

    @classmethod
    def of_share(cls, circumsolar_share: float) -> "BuieSun":
        """Return the shape that really has a given share of its power outside the disc.

        circumsolar_share: Wanted share, 0 to 0.7.
        Returns: The shape, its chi found by bisection to 1e-7.
        InputError: The share is outside 0 to 0.7.
        """
        if not 0 <= circumsolar_share <= 0.7:
            raise InputError(f"circumsolar_share: 0 to 0.7 is needed, not {circumsolar_share}")
        low, high = 0.0, 0.8
        while high - low > 1e-7:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if cls(middle).circumsolar_share < circumsolar_share else (low, middle)
        return cls(high if circumsolar_share > 0 else 0.0)

    @property
    def circumsolar_share(self) -> float:
        """Share of the power from outside the disc, by integration."""
        return 1 - float(self.share_within(SOLAR_DISC_RAD))

    def describe(self) -> str:
        """Return the shape in words with its numbers."""
        return f"Buie sun of circumsolar ratio {self.circumsolar_ratio:.4g}"

    def _edges(self) -> FloatArray:
        # The edge of the disc is a jump: put a step's end on it.
        disc = np.linspace(0, SOLAR_DISC_RAD, _INTEGRATION_STEPS // 2 + 1)
        if self.circumsolar_ratio == 0:
            return disc
        return np.concatenate([disc, np.linspace(SOLAR_DISC_RAD, self.limit_rad, _INTEGRATION_STEPS // 2 + 1)[1:]])


@dataclass(frozen=True, slots=True, eq=False)
class TabulatedSun(SunShape):
    """A measured sun shape, straight between its points.

    angle_rad (n,): Angles from the sun's centre, ascending [rad]; below the first the radiance is that of the
        first.
    radiance_table (n,): Radiance at these angles, in any unit; zero beyond the last.
    name: Where it comes from.
    InputError: Fewer than two points, angles that do not ascend from zero or above, negative or no radiance.
    """

    angle_rad: FloatArray
    radiance_table: FloatArray
    name: str = "tabulated sun"

    def __post_init__(self) -> None:
        angle = float_array("angle_rad", self.angle_rad, (None,))
        table = float_array("radiance_table", self.radiance_table, (angle.size,))
        if angle.size < 2 or (np.diff(angle) <= 0).any() or angle[0] < 0:
            raise InputError(f"angle_rad: at least 2 ascending angles from zero are needed ({angle.size} given)")
        if angle[-1] > 0.3:
            raise InputError(f"angle_rad: a sun that reaches {angle[-1]:.4g} rad cannot be meant (is it in mrad?)")
        if (table < 0).any() or not table[0] > 0:
            raise InputError("radiance_table: radiance above zero at the centre and nowhere below zero is needed")
        object.__setattr__(self, "angle_rad", angle)
        object.__setattr__(self, "radiance_table", table)

    @property
    def limit_rad(self) -> float:
        """Angle beyond which there is no light [rad]."""
        return float(self.angle_rad[-1])

    def radiance(self, theta_rad: npt.ArrayLike) -> FloatArray:
        """Return the radiance relative to the first point, for angles of any shape [rad]."""
        theta = np.abs(np.asarray(theta_rad, dtype=np.float64))
        return np.asarray(np.interp(theta, self.angle_rad, self.radiance_table / self.radiance_table[0], right=0.0))

    def describe(self) -> str:
        """Return the shape in words with its numbers."""
        return f"{self.name} ({self.angle_rad.size} points up to {1e3 * self.limit_rad:.4g} mrad)"
