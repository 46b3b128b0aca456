"""Sunlight reflected by a slope map, as blocks of rays.

The mirror's measured nodes emit; nodes that were not measured emit nothing. There is no shading and no blocking, and
reflectance is one.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from heliogauge.errors import EstimationError, InputError
from heliogauge.slopes.map import SlopeMap
from heliogauge.sunlight.sun_shapes import SunShape
from heliogauge.validate import Float32Array, FloatArray, IntArray, float_array

# Rays of one block: 64 KiB for each float32 array, so that the two dozen of a block stay in a 2 MiB second-level
# cache.
_BLOCK = 16384


@dataclass(frozen=True, slots=True, eq=False)
class Illumination:
    """The sunlight on a mirror, and how its surface scatters it.

    sun_shape: Radiance over the angle from the sun's centre.
    direction_to_sun (3,): From the mirror to the sun's centre, in the frame of the slope map, of any length.
    specularity_sigma_rad: Gaussian scatter of the reflected *beam* in one direction, 1 sigma, on top of the slopes
        [rad].
    InputError: The sun stands behind the mirror, or the scatter is negative.
    """

    sun_shape: SunShape
    direction_to_sun: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    specularity_sigma_rad: float = 0.0

    def __post_init__(self) -> None:
        direction = float_array("direction_to_sun", self.direction_to_sun, (3,))
        if not direction[2] > 0:
            raise InputError(f"direction_to_sun: {direction.tolist()} is behind the mirror (z out of the mirror)")
        if not 0 <= self.specularity_sigma_rad < 0.3:
            raise InputError(f"specularity_sigma_rad: 0 to 0.3 rad is needed, not {self.specularity_sigma_rad}")
        object.__setattr__(
            self, "direction_to_sun", float_array("direction_to_sun", direction / np.linalg.norm(direction), (3,))
        )

    def describe(self) -> str:
        """Return the light in words with its numbers."""
        words = self.sun_shape.describe()
        if self.specularity_sigma_rad > 0:
            words += f", specularity {1e3 * self.specularity_sigma_rad:.4g} mrad (beam, 1 sigma in one direction)"
        return words


@dataclass(frozen=True, slots=True, eq=False)
class RayBlock:
    """Reflected rays, in the frame of the slope map.

    origins_m (3, n): Points on the mirror [m].
    directions (3, n): Directions of travel, near unit length.
    """

    origins_m: Float32Array
    directions: Float32Array


def reflected_rays(
    slope_map: SlopeMap, height_m: npt.ArrayLike, light: Illumination, *, rays: int, rng: np.random.Generator
) -> Iterator[RayBlock]:
    """Trace sunlight to the mirror and reflect it, block by block.

    height_m (ny, nx): Height of the mirror's surface at the nodes, usually the design's [m].
    rng: Source of randomness; SFC64 is the fastest.
    Returns: At most 16384 rays; the arrays are overwritten by the next block.
    EstimationError: No measured node is lit.
    InputError: No rays, or heights of another shape or missing at a measured node.

    Every node emits from its grid cell in proportion to the sunlight it catches (its area across the sun); positions
    are uniform within the cell. The numbers of rays of the nodes are spread systematically, so they differ from
    proportional by less than one. Within a cell the design's slope follows the position and the slope error is the
    node's: the traced rays then have exactly the map's SDx and SDy. (Interpolating slopes between nodes would average
    them, and with 4/9 of the variance of the noise.)

    Angles are computed in float32: 1e-7 rad, a thousandth of a pixel of any sun image.
    """
    if rays < 1:
        raise InputError(f"rays: at least 1 is needed, not {rays}")
    nodes, weight = _node_table(slope_map, mirror_heights(slope_map, height_m), light)
    ends = np.floor(np.cumsum(weight) / weight.sum() * rays + rng.random()).astype(np.int64)
    ends = np.minimum(ends, rays)
    ends[-1] = rays
    tracer = _Tracer(nodes, light, _half_cells(slope_map))
    for first in range(0, rays, _BLOCK):
        count = min(_BLOCK, rays - first)
        low, high = np.searchsorted(ends, [first, first + count - 1], side="right")
        share = np.diff(np.clip(ends[low : high + 1] - first, 0, count), prepend=0)
        yield tracer.block(np.repeat(np.arange(low, high + 1), share), rng)


def mirror_heights(slope_map: SlopeMap, height_m: npt.ArrayLike) -> FloatArray:
    """Check the heights that rays start from.

    height_m (ny, nx): Height of the surface at its nodes [m].
    Returns (ny, nx): The heights, read-only [m].
    EstimationError: No node was measured.
    InputError: Another shape, or a measured node without a height.
    """
    heights = float_array("height_m", height_m, slope_map.shape, finite=False)
    if slope_map.measured_share == 0:
        raise EstimationError("slope map: no node was measured, so nothing reflects")
    missing = int(np.count_nonzero(np.isnan(heights[slope_map.valid])))
    if missing:
        raise InputError(f"height_m: {missing} measured nodes have no height; give the design's heights")
    return heights


def _half_cells(slope_map: SlopeMap) -> tuple[float, float]:
    spacing = []
    for name, grid in (("x_m", slope_map.x_m), ("y_m", slope_map.y_m)):
        steps = np.diff(grid)
        if grid.size < 2 or np.ptp(steps) > 1e-6 * steps.mean():
            raise InputError(f"{name}: an even grid of at least 2 nodes is needed to trace rays (see resample)")
        spacing.append(float(steps.mean()))
    return 0.5 * spacing[0], 0.5 * spacing[1]


def _node_table(slope_map: SlopeMap, height_m: FloatArray, light: Illumination) -> tuple[Float32Array, FloatArray]:
    """Return what each lit node contributes (x, y, z, p, q, p_x, p_y, q_y), shape (8, n), and its weight."""
    valid = slope_map.valid
    grid_x, grid_y = np.meshgrid(slope_map.x_m, slope_map.y_m)
    p, q = slope_map.slope_x[valid], slope_map.slope_y[valid]
    sun = light.direction_to_sun
    # A cell of the regular grid has the same area across z; across the sun it has n.s of it, with n = (-p, -q, 1).
    weight = np.maximum(sun[2] - p * sun[0] - q * sun[1], 0.0)
    if not weight.any():
        raise EstimationError("slope map: no measured node is lit by the sun")
    bends = [
        np.nan_to_num(np.asarray(np.gradient(slopes, positions, axis=axis))[valid])
        for slopes, positions, axis in (
            (slope_map.design_slope_x, slope_map.x_m, 1),
            (slope_map.design_slope_x, slope_map.y_m, 0),
            (slope_map.design_slope_y, slope_map.y_m, 0),
        )
    ]
    table = np.stack([grid_x[valid], grid_y[valid], height_m[valid], p, q, *bends])
    return table.astype(np.float32), weight


class _Tracer:
    """Reflects blocks of rays; holds the buffers that the blocks share."""

    def __init__(self, nodes: Float32Array, light: Illumination, half_cells: tuple[float, float]) -> None:
        self._nodes = nodes
        self._cells = np.float32(2 * half_cells[0]), np.float32(2 * half_cells[1])
        self._table = light.sun_shape.inverse_table()
        self._scatter = np.float32(light.specularity_sigma_rad)
        sun = light.direction_to_sun
        # Two directions across the sun; the smallest turn from z keeps them along x and y for a sun on the axis.
        across_x = np.array([1 - sun[0] ** 2 / (1 + sun[2]), -sun[0] * sun[1] / (1 + sun[2]), -sun[0]])
        across_y = np.array([-sun[0] * sun[1] / (1 + sun[2]), 1 - sun[1] ** 2 / (1 + sun[2]), -sun[1]])
        self._frame = np.stack([sun, across_x, across_y]).astype(np.float32)
        self._uniform = np.empty((4, _BLOCK), dtype=np.float32)
        self._gathered = np.empty((nodes.shape[0], _BLOCK), dtype=np.float32)
        self._origins = np.empty((3, _BLOCK), dtype=np.float32)
        self._directions = np.empty((3, _BLOCK), dtype=np.float32)

    def block(self, index: IntArray, rng: np.random.Generator) -> RayBlock:
        count = index.size
        uniform = self._uniform[:, :count]
        for row in uniform:
            rng.random(out=row, dtype=np.float32)
        gathered = self._gathered[:, :count]
        for column, values in zip(self._nodes, gathered, strict=True):
            column.take(index, out=values, mode="clip")
        x, y, z, p, q, p_x, p_y, q_y = gathered
        step_x = (uniform[0] - np.float32(0.5)) * self._cells[0]
        step_y = (uniform[1] - np.float32(0.5)) * self._cells[1]
        origins, directions = self._origins[:, :count], self._directions[:, :count]
        np.add(x, step_x, out=origins[0])
        np.add(y, step_y, out=origins[1])
        turn_p, turn_q = p_x * step_x + p_y * step_y, p_y * step_x + q_y * step_y
        # Height along the mean of the node's slope and the point's: exact for a paraboloid, where the node's slope
        # alone misses the focus of a deep dish (f = 1 m, 20 mm cells) by 6 um.
        z += (p + np.float32(0.5) * turn_p) * step_x
        np.add(z, (q + np.float32(0.5) * turn_q) * step_y, out=origins[2])
        p += turn_p
        q += turn_q
        sun_x, sun_y, sun_z = self._sun(uniform[2], uniform[3], rng)
        # r = 2 (n.s) n / (n.n) - s with n = (-p, -q, 1); s needs no unit length, for reflection is linear in it
        twice = np.float32(2) * (sun_z - p * sun_x - q * sun_y) / (np.float32(1) + p * p + q * q)
        np.multiply(twice, p, out=directions[0])
        directions[0] += sun_x
        np.multiply(twice, q, out=directions[1])
        directions[1] += sun_y
        np.negative(directions[:2], out=directions[:2])
        np.subtract(twice, sun_z, out=directions[2])
        return RayBlock(origins, directions)

    def _sun(self, share: Float32Array, turn: Float32Array, rng: np.random.Generator) -> list[Float32Array]:
        """Return x, y and z of directions to points of the sun, not of unit length."""
        position = np.sqrt(share) * np.float32(self._table.size - 1)
        step = position.astype(np.intp)
        radius = self._table.take(step, mode="clip")
        rise = self._table.take(step + 1, mode="clip") - radius
        radius += rise * (position - step.astype(np.float32))
        angle = turn * np.float32(2 * np.pi)
        a, b = radius * np.cos(angle), radius * np.sin(angle)
        if self._scatter > 0:
            # A scatter of the reflected beam is the same as one of the incoming ray: reflection keeps angles.
            a += self._scatter * rng.standard_normal(a.size, dtype=np.float32)
            b += self._scatter * rng.standard_normal(b.size, dtype=np.float32)
        sun, across_x, across_y = self._frame
        return [sun[i] + a * across_x[i] + b * across_y[i] for i in range(3)]
