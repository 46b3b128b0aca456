"""Intercept factor by tracing rays from the measured mirror onto the absorber tube: an independent count."""

from dataclasses import dataclass

import numpy as np

from heliogauge.short_repr import ShortRepr
from heliogauge.slopes.map import SlopeMap
from heliogauge.sunlight.rays import Illumination, RayBlock, reflected_rays
from heliogauge.sunlight.sun_shapes import SunShape
from heliogauge.validate import BoolArray, Float32Array, FloatArray
from observer.light.intercept import column_shares
from observer.trough.absorber_path import AbsorberPath

#: Steps of the table of a tube that is not straight along the trough.
_PATH_STEPS = 1024


@dataclass(frozen=True, slots=True)
class Sunlight(ShortRepr):
    """The light on a trough.

    sun: Radiance about the sun's centre.
    specularity_rad: Gaussian scatter of the reflected beam in one direction, 1 sigma [rad].
    tracking_error_rad: Gaussian error of the rotation about the trough's length, 1 sigma [rad].
    offset_rad: Angle by which the sun stands towards +x of the optical axis [rad].
    incidence_rad: Angle between the sun and the plane across the trough, positive towards +y [rad].
    """

    sun: SunShape
    specularity_rad: float = 0.0
    tracking_error_rad: float = 0.0
    offset_rad: float = 0.0
    incidence_rad: float = 0.0

    @property
    def direction_to_sun(self) -> FloatArray:
        """Unit vector to the sun's centre, shape (3,)."""
        along = np.cos(self.incidence_rad)
        return np.array([along * np.sin(self.offset_rad), np.sin(self.incidence_rad), along * np.cos(self.offset_rad)])


@dataclass(frozen=True, slots=True)
class TracedIntercept:
    """What rays say.

    ratio: Share of the rays that meet the tube.
    sampling_sigma: Standard deviation from the number of rays.
    """

    ratio: float
    sampling_sigma: float
    rays: int


def trace_intercept(
    slope_map: SlopeMap,
    absorber: AbsorberPath,
    diameter_m: float,
    light: Sunlight,
    *,
    rays: int,
    rng: np.random.Generator,
) -> TracedIntercept:
    """Count the rays that meet the tube.

    slope_map: The mirror; where heights or slopes along the trough are missing, the design's are taken.
    absorber: The tube's axis; it goes on beyond its ends.
    rng: Source of randomness; SFC64 is the fastest.
    Returns: The share with the sampling error.
    EstimationError: No measured node is lit.
    InputError: No rays.

    The rays are those of `heliogauge.beam_rays`: uniform over each node's cell, the design's slope following the
    place. A tracking error turns the reflected ray about the trough's length, the other way round than it turns the
    sun. Columns of the map with nodes that were not measured count with the whole column's area, as in
    `observer.intercept`. The sampling error is that of independent rays; that each node sends its fixed number makes
    it smaller.
    """
    shares = column_shares(slope_map)
    columns = _Columns(slope_map, _Tube(absorber, diameter_m / 2))
    illumination = Illumination(light.sun, light.direction_to_sun, light.specularity_rad)
    height = _design_height(slope_map)
    for block in reflected_rays(slope_map.with_both_slopes(), height, illumination, rays=rays, rng=rng):
        if light.tracking_error_rad > 0:
            _turn(block, light.tracking_error_rad, rng)
        columns.add(block)
    sent = np.maximum(columns.sent, 1)
    caught = shares * np.where(columns.sent > 0, _caught_by_column(slope_map, light.offset_rad), 0.0)
    caught /= caught.sum()
    ratio = columns.met / sent
    variance = float(caught**2 @ (ratio * (1 - ratio) / sent))
    return TracedIntercept(float(caught @ ratio), float(np.sqrt(variance)), rays)


def _design_height(slope_map: SlopeMap) -> FloatArray:
    """Return the heights, where missing the integral of the design's slope across."""
    slope, x = slope_map.design_slope_x, slope_map.x_m
    rise = np.concatenate([[0.0], np.cumsum(0.5 * (slope[0, 1:] + slope[0, :-1]) * np.diff(x))])
    # The vertex of the trough is where its design is level.
    middle = np.interp(0.0, slope[0], rise)
    return np.where(np.isfinite(slope_map.height_m), slope_map.height_m, (rise - middle)[None, :])


def _caught_by_column(slope_map: SlopeMap, offset_rad: float) -> FloatArray:
    """Return the light that a cell of each column catches, relative to a sun on the axis."""
    return np.asarray(np.maximum(1.0 - slope_map.design_slope_x[0] * np.tan(offset_rad), 0.0))


def _turn(block: RayBlock, sigma_rad: float, rng: np.random.Generator) -> None:
    """Turn rays about the trough's length by Gaussian angles, in place."""
    angle: Float32Array = (
        np.float32(sigma_rad) * rng.standard_normal((1, block.directions.shape[1]), dtype=np.float32)[0]
    )
    across, up = block.directions[0], block.directions[2]
    turned = across + angle * up
    up -= angle * across
    across[:] = turned


class _Tube:
    """Tells which rays meet a tube; in float32, good to a micrometre."""

    def __init__(self, absorber: AbsorberPath, radius_m: float) -> None:
        self._square = np.float32(radius_m**2)
        self._height = np.float32(absorber.z_m.mean())
        self._bent = np.ptp(absorber.x_m) > 0 or np.ptp(absorber.z_m) > 0
        steps = np.linspace(absorber.y_m[0], absorber.y_m[-1], _PATH_STEPS + 1)
        self._first = np.float32(steps[0])
        self._per_m = np.float32(_PATH_STEPS / (steps[-1] - steps[0]) if absorber.n > 1 else 0.0)
        self._x, self._z = (part.astype(np.float32) for part in absorber.at(steps))

    def meets(self, block: RayBlock) -> BoolArray:
        """Return which rays pass the axis at less than the radius, on their way up or to the side."""
        (x, y, z), (ray_x, ray_y, ray_z) = block.origins_m, block.directions
        axis_x: Float32Array | np.float32 = self._x[0]
        axis_z: Float32Array | np.float32 = self._z[0]
        across = ray_x * ray_x + ray_z * ray_z
        if self._bent:
            # Where the ray is nearest to the mean axis; the axis bends by millimetres on a metre.
            mean_x = self._x[_PATH_STEPS // 2]
            passing = y + ((mean_x - x) * ray_x + (self._height - z) * ray_z) / across * ray_y
            place = (passing - self._first) * self._per_m
            step = np.clip(place, 0, _PATH_STEPS).astype(np.int32)
            axis_x, axis_z = self._x.take(step), self._z.take(step)
        to_x, to_z = axis_x - x, axis_z - z
        beside = to_x * ray_z - to_z * ray_x
        return np.asarray((beside * beside < self._square * across) & (to_x * ray_x + to_z * ray_z > 0))


class _Columns:
    """Counts rays and those that meet the tube by column of the map."""

    def __init__(self, slope_map: SlopeMap, tube: _Tube) -> None:
        x = slope_map.x_m
        step = (x[-1] - x[0]) / (x.size - 1)
        self._first, self._per_m = np.float32(x[0] - step / 2), np.float32(1 / step)
        self._tube = tube
        self.sent, self.met = np.zeros(x.size), np.zeros(x.size)

    def add(self, block: RayBlock) -> None:
        place = (block.origins_m[0] - self._first) * self._per_m
        column = np.clip(place, 0, self.sent.size - 1).astype(np.intp)
        self.sent += np.bincount(column, minlength=self.sent.size)
        self.met += np.bincount(column, self._tube.meets(block), self.sent.size)
