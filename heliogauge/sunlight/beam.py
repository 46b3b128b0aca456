"""What a slope map does to sunlight: the spot on a target by vectorised ray tracing.

The mirror's measured nodes emit; nodes that were not measured emit nothing, and the share that was measured is part of
the result. There is no shading and no blocking, and reflectance is one: flux is per unit of reflected power.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rays import intersect_plane, reflect
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.statistics import FocusDeviation, SlopeStatistics, statistics
from heliogauge.sunlight.rays import Illumination, RayBlock, mirror_heights, reflected_rays
from heliogauge.validate import Float32Array, FloatArray, float_array, positive

__all__ = [
    "Illumination",
    "RayBlock",
    "SpotImage",
    "TargetPlane",
    "direction_to_sun_for",
    "facing_target",
    "reflected_rays",
    "trace",
]

_RADIUS_STEPS = 1000


@dataclass(frozen=True, slots=True, eq=False)
class TargetPlane:
    """A plane that catches the light, and the window of it that becomes an image.

    facet_from_target: Place of the target: its origin is the window's centre, x and y run along the window.
    width_m, height_m: Size of the window along x and y [m].
    columns, rows: Pixels of the image.
    InputError: A size or a number of pixels is not positive.
    """

    facet_from_target: RigidTransform
    width_m: float
    height_m: float
    columns: int = 256
    rows: int = 256

    def __post_init__(self) -> None:
        positive("width_m", self.width_m, "metres")
        positive("height_m", self.height_m, "metres")
        if not (1 <= self.columns <= 4096 and 1 <= self.rows <= 4096):
            raise InputError(f"columns, rows: 1 to 4096 pixels are needed, not {self.columns} x {self.rows}")

    @property
    def distance_m(self) -> float:
        """Distance of the window's centre from the origin of the map's frame [m]."""
        return float(np.linalg.norm(self.facet_from_target.translation_m))


def facing_target(distance_m: float, width_m: float, height_m: float | None = None) -> TargetPlane:
    """Return a target on the mirror's axis, parallel to it, with its x and y along the mirror's.

    distance_m: Distance from the mirror's origin along z [m]; for the sharpest spot its focal length.
    height_m: Height of the window [m]; the width when left out.
    Returns: The target; x and y of the spot image are those of the mirror, so a normal that leans to +x lights +x.
    """
    place = RigidTransform(np.eye(3), np.array([0.0, 0.0, positive("distance_m", distance_m, "metres")]))
    return TargetPlane(place, width_m, width_m if height_m is None else height_m)


def direction_to_sun_for(target: TargetPlane, normal: npt.ArrayLike, point_m: npt.ArrayLike = (0, 0, 0)) -> FloatArray:
    """Return where the sun must stand so that one point of a mirror lights the target's centre.

    Shapes: result (3,).
    normal (3,): The mirror's normal at that point, in the map's frame.
    point_m (3,): The point, by default the frame's origin [m].
    """
    towards = target.facet_from_target.translation_m - float_array("point_m", point_m, (3,))
    sun = -reflect(towards, float_array("normal", normal, (3,)))
    return np.asarray(sun / np.linalg.norm(sun))


@dataclass(frozen=True, slots=True, eq=False)
class SpotImage:
    """The light on a target, with everything that must be said beside it.

    x_m, y_m (nx,): Pixel centres in the target's frame [m].
    flux_per_m2 (ny, nx): Flux density for one unit of power reflected by the measured part of the mirror [1/m^2].
    radius_m, encircled_share (n,): Share of the power within each radius around `center_m`.
    center_m (2,): Where the sun's centre lands on average, without sun shape and scatter [m].
    centroid_m (2,): Mean of all rays that meet the plane, inside the window or not [m].
    sd_x_m, sd_y_m: Standard deviation of the same rays about their centroid [m].
    rays: Number of rays traced.
    share_in_window: Share of them that the image shows.
    slope: SDx and SDy of the traced map.
    distance_m: Distance of the target from the mirror's origin [m].
    design, removed: Design shape of the map and what was removed from its slopes.
    measured_share: Share of the mirror that was measured and emits.
    light: Sun shape and scatter in words.
    """

    x_m: FloatArray
    y_m: FloatArray
    flux_per_m2: FloatArray
    radius_m: FloatArray
    encircled_share: FloatArray
    center_m: FloatArray
    centroid_m: FloatArray
    sd_x_m: float
    sd_y_m: float
    rays: int
    share_in_window: float
    slope: SlopeStatistics
    distance_m: float
    design: str
    removed: str
    measured_share: float
    light: str

    @property
    def focus_deviation_m(self) -> FocusDeviation:
        """``2 d SD`` of the slopes in x, in y and in both, at the target's distance [m]."""
        return self.slope.focus_deviation_m(self.distance_m)

    @property
    def sigma_flux_per_m2(self) -> FloatArray:
        """Standard deviation of the flux from the finite number of rays (Poisson), shape (ny, nx) [1/m^2]."""
        area = self._pixel_m2
        return np.asarray(np.sqrt(self.flux_per_m2 / (self.rays * area)))

    @property
    def _pixel_m2(self) -> float:
        # The flux of all pixels sums to the share in the window.
        total = float(self.flux_per_m2.sum())
        return self.share_in_window / total if total > 0 else 1.0

    def radius_of_share(self, share: float) -> float:
        """Return the radius around `center_m` that holds a share of the power.

        share: Between 0 and 1.
        Returns: Radius [m]; infinite where the window's corner does not reach that far.
        """
        if not 0 <= share <= 1:
            raise InputError(f"share: 0 to 1 is needed, not {share}")
        if share > self.encircled_share[-1]:
            return float("inf")
        # The first ring that reaches it: beyond the last ray the curve is level.
        after = max(int(np.searchsorted(self.encircled_share, share)), 1)
        ring = slice(after - 1, after + 1)
        return float(np.interp(share, self.encircled_share[ring], self.radius_m[ring]))

    def describe(self) -> str:
        """Return what was traced in words: light, design, what was removed, share measured."""
        return (
            f"{self.light}; design: {self.design}; removed: {self.removed}; {100 * self.measured_share:.1f} % of the "
            f"mirror measured; {self.rays} rays on a target at {self.distance_m:.6g} m"
        )


def trace(
    slope_map: SlopeMap,
    height_m: npt.ArrayLike,
    light: Illumination,
    *,
    target: TargetPlane,
    rays: int,
    rng: np.random.Generator,
) -> SpotImage:
    """Trace sunlight from a slope map to a target plane.

    slope_map: The mirror; its measured slopes reflect.
    height_m (ny, nx): Height of the mirror's surface at the nodes, usually the design's [m].
    light: Sun shape, its direction, and scatter.
    target: Where the light is caught.
    rng: Source of randomness; SFC64 is the fastest.
    Returns: Flux density, encircled energy, centroid and spread, with SDx and SDy of the map, its design, what was
        removed and the share measured.
    EstimationError: No measured node is lit, or no ray meets the plane.
    InputError: No rays, or heights of another shape or missing at a measured node.

    See `reflected_rays` for how rays are spread over the mirror.
    """
    heights = mirror_heights(slope_map, height_m)
    center = _mean_landing(slope_map, heights, light, target)
    catch = _Catch(target, center)
    for block in reflected_rays(slope_map, heights, light, rays=rays, rng=rng):
        catch.add(block)
    if catch.met == 0:
        raise EstimationError(f"target: none of {rays} rays meets the plane {target.distance_m:.6g} m away; turn it")
    centroid = catch.sums / catch.met
    spread = np.sqrt(np.maximum(catch.squares / catch.met - centroid**2, 0))
    pixel_x, pixel_y = target.width_m / target.columns, target.height_m / target.rows
    inside = catch.image[1:-1, 1:-1]
    return SpotImage(
        x_m=_pixel_centers(target.width_m, target.columns),
        y_m=_pixel_centers(target.height_m, target.rows),
        flux_per_m2=inside / (rays * pixel_x * pixel_y),
        radius_m=np.linspace(0, catch.radius_step_m * _RADIUS_STEPS, _RADIUS_STEPS + 1),
        encircled_share=np.concatenate([[0.0], np.cumsum(catch.rings[:-1]) / rays]),
        center_m=center,
        centroid_m=center + centroid,
        sd_x_m=float(spread[0]),
        sd_y_m=float(spread[1]),
        rays=rays,
        share_in_window=float(inside.sum() / rays),
        slope=statistics(slope_map),
        distance_m=target.distance_m,
        design=slope_map.design,
        removed=slope_map.removed,
        measured_share=slope_map.measured_share,
        light=light.describe(),
    )


def _pixel_centers(length_m: float, pixels: int) -> FloatArray:
    edges = np.linspace(-0.5 * length_m, 0.5 * length_m, pixels + 1)
    return np.asarray(0.5 * (edges[1:] + edges[:-1]), dtype=np.float64)


class _Catch:
    """Collects rays on a target: image with a border of one pixel for misses, rings, sums."""

    def __init__(self, target: TargetPlane, center_m: FloatArray) -> None:
        self._axes = target.facet_from_target.rotation.T.astype(np.float32)
        self._origin = target.facet_from_target.translation_m.astype(np.float32)
        self._pixels = np.array([target.columns, target.rows])
        self._size = np.array([target.width_m, target.height_m])
        self._center = center_m.astype(np.float32)
        reach = np.hypot(*(0.5 * self._size + np.abs(center_m)))
        self.radius_step_m = float(reach) / _RADIUS_STEPS
        self.image = np.zeros((target.rows + 2, target.columns + 2))
        self.rings = np.zeros(_RADIUS_STEPS + 1)
        self.sums = np.zeros(2)
        self.squares = np.zeros(2)
        self.met = 0

    def add(self, block: RayBlock) -> None:
        start = block.origins_m - self._origin[:, None]
        # Always three rows; a rotation by the identity costs 1 ns a ray and saves a second code path.
        (start_x, start_y, start_z), (ray_x, ray_y, ray_z) = self._axes @ start, self._axes @ block.directions
        with np.errstate(divide="ignore", invalid="ignore"):
            length = -start_z / ray_z
            x, y = start_x + length * ray_x, start_y + length * ray_y
        if not length.min() > 0:
            # Leaving the plane or along it: such rays count as traced and meet nothing.
            meets = length > 0
            x, y = x[meets], y[meets]
        self._add_image(x, y)
        x -= self._center[0]
        y -= self._center[1]
        self._add_rings(x, y)

    def _add_image(self, x: Float32Array, y: Float32Array) -> None:
        columns, rows = (int(n) for n in self._pixels)
        scale = (self._pixels / self._size).astype(np.float32)
        # One pixel of border: whatever lies outside is clipped into it.
        column = np.clip(x * scale[0] + np.float32(0.5 * columns + 1), 0, np.float32(columns + 1)).astype(np.int32)
        row = np.clip(y * scale[1] + np.float32(0.5 * rows + 1), 0, np.float32(rows + 1)).astype(np.int32)
        row *= np.int32(columns + 2)
        row += column
        self.image += np.bincount(row, minlength=self.image.size).reshape(self.image.shape)

    def _add_rings(self, x: Float32Array, y: Float32Array) -> None:
        x_squared, y_squared = x * x, y * y
        self.met += x.size
        self.sums += (x.sum(), y.sum())
        self.squares += (x_squared.sum(), y_squared.sum())
        x_squared += y_squared
        ring = np.sqrt(x_squared, out=x_squared)
        ring *= np.float32(1 / self.radius_step_m)
        ring = np.minimum(ring, np.float32(_RADIUS_STEPS), out=ring)
        self.rings += np.bincount(ring.astype(np.int32), minlength=self.rings.size)


def _mean_landing(slope_map: SlopeMap, height_m: FloatArray, light: Illumination, target: TargetPlane) -> FloatArray:
    """Return where the sun's centre lands on average, in the target's frame, shape (2,)."""
    valid = slope_map.valid
    grid_x, grid_y = np.meshgrid(slope_map.x_m, slope_map.y_m)
    points = np.stack([grid_x[valid], grid_y[valid], height_m[valid]], axis=-1)
    normals = np.stack([-slope_map.slope_x[valid], -slope_map.slope_y[valid], np.ones(len(points))], axis=-1)
    beams = reflect(-light.direction_to_sun, normals)
    place = target.facet_from_target
    t = intersect_plane(points, beams, place.translation_m, place.rotation[:, 2])
    weight = np.where(t > 0, np.maximum(normals @ light.direction_to_sun, 0.0), 0.0)
    if not weight.any():
        raise EstimationError(f"target: the mirror sends no light to the plane {target.distance_m:.6g} m away; turn it")
    hits = place.inverse().apply(points + np.where(weight > 0, t, 0.0)[:, None] * beams)[:, :2]
    return np.asarray(weight @ hits / weight.sum())
