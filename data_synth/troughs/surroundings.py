"""What is around a trough: sky with clouds and sun, and ground with the collector's shadow."""

from copy import copy
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import numpy.typing as npt

from data_synth.troughs.mirror import MirrorTable, RayArray, Rays
from heliogauge.errors import InputError
from heliogauge.validate import BoolArray, Float32Array, FloatArray, positive

SUN_RADIUS_RAD = 4.65e-3
#: Radiance of the disc: whatever reflects a hundredth of it saturates.
_SUN_LIGHT = 200.0
_TILE_PX = 1024
_CLOUD_HEIGHT_M = 1500.0
#: Rays so near the sun are looked at closely.
_SUN_REACH_RAD = 0.02


@dataclass(frozen=True, slots=True)
class Sky:
    """The sky.

    zenith, horizon: Brightness of a clear sky; paper has about 0.85.
    aureole: Brightness that the clear sky has more around the sun.
    clouds: Share of the cloud's contrast: 0 clear, 1 broken bright clouds.
    cloud_size_m: Side of the repeating cloud pattern at 1500 m [m].
    sun_elevation_deg, sun_azimuth_deg: The sun over the horizon, and its direction from across (+x of a collector
        at zenith) towards +y [deg].
    """

    zenith: float = 0.60
    horizon: float = 0.88
    aureole: float = 0.25
    clouds: float = 0.0
    cloud_size_m: float = 4000.0
    sun_elevation_deg: float = 48.0
    sun_azimuth_deg: float = 75.0


@dataclass(frozen=True, slots=True)
class Ground:
    """The ground.

    below_m: How far it is below the collector's vertex line [m].
    brightness: Mean brightness in the sun.
    contrast: How busy it is: standard deviation of the brightness over its mean.
    in_shadow: Brightness in shadow over that in the sun.
    size_m: Side of the repeating pattern [m].
    """

    below_m: float = 3.2
    brightness: float = 0.5
    contrast: float = 0.08
    in_shadow: float = 0.4
    size_m: float = 16.0

    def __post_init__(self) -> None:
        for name in ("below_m", "brightness", "size_m"):
            positive(f"ground {name}", getattr(self, name), "metres" if name.endswith("_m") else "")
        if not 0 <= self.contrast <= 1:
            raise InputError(f"ground contrast: 0 to 1 is needed, not {self.contrast}")


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Sky, ground and how the collector is turned.

    orientation_deg: Turn of the collector about +y from zenith, by the right hand [deg].
    seed: Draws clouds and ground.
    """

    sky: Sky = field(default_factory=Sky)
    ground: Ground = field(default_factory=Ground)
    orientation_deg: float = 0.0
    seed: int = 0

    def turned(self, orientation_deg: float) -> "Surroundings":
        """Return the same surroundings around a collector that is turned otherwise."""
        return replace(self, orientation_deg=orientation_deg)

    @property
    def horizontal(self) -> FloatArray:
        """Unit vector across, horizontal, in the trough's frame, shape (3,)."""
        turn = np.radians(self.orientation_deg)
        return np.array([np.cos(turn), 0.0, np.sin(turn)])

    @property
    def up(self) -> FloatArray:
        """Unit vector upwards in the trough's frame, shape (3,)."""
        turn = np.radians(self.orientation_deg)
        return np.array([-np.sin(turn), 0.0, np.cos(turn)])

    @property
    def sun(self) -> FloatArray:
        """Unit vector to the sun in the trough's frame, shape (3,)."""
        height, round_ = np.radians([self.sky.sun_elevation_deg, self.sky.sun_azimuth_deg])
        along = np.array([0.0, np.cos(height) * np.sin(round_), 0.0])
        return np.asarray(np.cos(height) * np.cos(round_) * self.horizontal + along + np.sin(height) * self.up)


class SurroundingsTable:
    """The surroundings as rays meet them.

    surroundings: Sky and ground.
    mirror: What throws a shadow.
    dtype: Float type of the rays.
    """

    def __init__(
        self, surroundings: Surroundings, mirror: MirrorTable, dtype: type[np.float32] | type[np.float64] = np.float32
    ) -> None:
        self._dtype = dtype
        self._mirror = mirror
        self._sky, self._ground = surroundings.sky, surroundings.ground
        self._up, self._across, self._sun = _directions(surroundings, dtype)
        cloud_rng, ground_rng = np.random.default_rng([surroundings.seed, 11]).spawn(2)
        self._clouds = _fractal(cloud_rng, 1.7) if self._sky.clouds else None
        self._pattern = _ground_pattern(ground_rng, self._ground)

    def turned(self, surroundings: Surroundings) -> "SurroundingsTable":
        """Return the same sky and ground around a collector that is turned otherwise.

        surroundings: The same surroundings but for the orientation.
        """
        table = copy(self)
        table._up, table._across, table._sun = _directions(surroundings, self._dtype)
        return table

    def light(self, rays: Rays) -> tuple[Float32Array, npt.NDArray[np.int32]]:
        """Return what rays that meet nothing see.

        Returns (n,): Light, and a label: 0 sky, 1 ground, 2 shadow, -1 near the sun.
        """
        rise = rays.dx * self._up[0] + rays.dz * self._up[2]
        size = np.sqrt(rays.dx * rays.dx + rays.dy * rays.dy + rays.dz * rays.dz)
        light, label = np.empty(rise.size, dtype=np.float32), np.zeros(rise.size, dtype=np.int32)
        above = rise > 0
        for mask, look in ((above, self._look_up), (~above, self._look_down)):
            index = np.flatnonzero(mask)
            if index.size:
                light[index], label[index] = look(rays.take(index), rise[index], size[index])
        return light, label

    def _look_up(self, rays: Rays, rise: RayArray, size: RayArray) -> tuple[RayArray, RayArray]:
        sky = self._sky
        low = 1 - rise / size
        light: RayArray = self._dtype(sky.zenith) + self._dtype(sky.horizon - sky.zenith) * low * low * low
        if self._clouds is not None:
            # Near the horizon the layer would be seen edge-on; there haze evens it out.
            far = self._dtype(_CLOUD_HEIGHT_M / sky.cloud_size_m) / np.maximum(rise, self._dtype(1e-3))
            noise = _look_at_tile(self._clouds, self._leftwards(rays) * far, rays.dy * far)
            share = np.clip(self._dtype(0.9) * noise - self._dtype(0.1), 0, 1) * np.clip(rise / size * 4, 0, 1)
            light = light + share * self._dtype(sky.clouds) * (self._dtype(1.0) - light)
        cosine = (rays.dx * self._sun[0] + rays.dy * self._sun[1] + rays.dz * self._sun[2]) / size
        square = np.maximum(2 - 2 * cosine, 0)
        # The aureole of a clear day, wide and faint.
        light = light + self._dtype(sky.aureole) / (1 + square * self._dtype(1 / 0.12**2))
        light = light + self._dtype(_SUN_LIGHT) * (square < self._dtype(SUN_RADIUS_RAD**2))
        return light, np.where(square < self._dtype(_SUN_REACH_RAD**2), -1, 0)

    def _look_down(self, rays: Rays, rise: RayArray, size: RayArray) -> tuple[RayArray, RayArray]:
        ground = self._ground
        height = rays.x * self._up[0] + rays.z * self._up[2] + self._dtype(ground.below_m)
        length = height / np.maximum(-rise, self._dtype(1e-4) * size)
        point = Rays(
            rays.x + length * rays.dx,
            rays.y + length * rays.dy,
            rays.z + length * rays.dz,
            *(np.full_like(rise, part) for part in self._sun),
        )
        tile = self._dtype(1 / ground.size_m)
        across = (point.x * self._across[0] + point.z * self._across[2]) * tile
        pattern: RayArray = _look_at_tile(self._pattern, across, point.y * tile)
        # Far away the pattern is finer than a pixel and only its mean is seen.
        pattern = pattern / (1 + (length * size * self._dtype(1 / 60)) ** 2)
        dark = self._in_shadow(point)
        light = self._dtype(ground.brightness) * (1 + pattern)
        light = np.where(dark, light * self._dtype(ground.in_shadow), light)
        return np.maximum(light, 0), np.where(dark, 2, 1)

    def _in_shadow(self, point: Rays) -> BoolArray:
        length = self._mirror.meet(point)
        with np.errstate(invalid="ignore"):
            dark = self._mirror.within(point.x + length * point.dx, point.y + length * point.dy)
        return dark | self._mirror.meets_back(point)

    def _leftwards(self, rays: Rays) -> RayArray:
        return np.asarray(rays.dx * self._across[0] + rays.dz * self._across[2])


def _directions(surroundings: Surroundings, dtype: type[np.float32] | type[np.float64]) -> tuple[RayArray, ...]:
    """Return the unit vectors upwards, across and to the sun."""
    return tuple(vector.astype(dtype) for vector in (surroundings.up, surroundings.horizontal, surroundings.sun))


def _look_at_tile(tile: Float32Array, x: RayArray, y: RayArray) -> Float32Array:
    """Return a pattern that repeats, at positions in tiles."""
    column, row = ((part - np.floor(part)).astype(np.float32) * np.float32(_TILE_PX) for part in (x, y))
    seen = cv2.remap(tile, column[None], row[None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return np.asarray(seen[0], dtype=np.float32)


def _fractal(rng: np.random.Generator, steepness: float) -> Float32Array:
    """Draw noise that repeats, of unit standard deviation, its amplitude falling with the frequency."""
    frequency = np.fft.fftfreq(_TILE_PX) * _TILE_PX
    radius = np.hypot(frequency[:, None], frequency[None, : _TILE_PX // 2 + 1])
    radius[0, 0] = np.inf
    shape = radius.shape
    spectrum = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) * radius**-steepness
    noise = np.fft.irfft2(spectrum, s=(_TILE_PX, _TILE_PX))
    return np.asarray(noise / noise.std(), dtype=np.float32)


def _ground_pattern(rng: np.random.Generator, ground: Ground) -> Float32Array:
    """Draw gravel and tracks, and where it is busy things that lie about; relative to the mean brightness."""
    pattern = _fractal(rng, 1.1) * np.float32(ground.contrast)
    n_things = round(600 * max(ground.contrast - 0.1, 0))
    for _ in range(n_things):
        middle = rng.integers(0, _TILE_PX, 2).tolist()
        size = float(np.exp(rng.uniform(np.log(4), np.log(60))))
        box = cv2.boxPoints((middle, (size, size * rng.uniform(0.3, 1)), rng.uniform(0, 90)))
        bright = float(ground.contrast * rng.choice([-2.5, -1.5, 1.5, 2.5]))
        cv2.fillPoly(pattern, [np.rint(box).astype(np.int32)], bright, cv2.LINE_8)
    return np.asarray(cv2.GaussianBlur(pattern, (0, 0), 1.0, borderType=cv2.BORDER_REFLECT), dtype=np.float32)
