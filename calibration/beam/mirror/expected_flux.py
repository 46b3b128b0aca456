"""The flux that a mirror sends to a target: each patch lights the sun's picture around where its middle ray lands.

The rays of the sun's centre are traced from every patch; what the sun's disc adds is the same for all patches of a
facet to a thousandth (their distances to the target differ by less), so the landing points of a facet are gathered on a
grid and spread by the sun's picture there. Flux is per unit of direct irradiance and reflectance: the share of the
sun's power per square metre of target, in 1/m^2 times the mirror's projected area.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np

from calibration.beam.mirror.facets import Facet, Mirror
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rays import intersect_plane, reflect
from heliogauge.geometry.target_planes import PlaneTarget, unit_vector
from heliogauge.short_repr import ShortRepr
from heliogauge.sunlight.sun_shapes import SunShape
from heliogauge.validate import FloatArray, float_array, freeze, positive

__all__ = ["FluxGrid", "Scene", "flux_change", "sun_kernel", "whole_flux"]

#: Samples of the sun's picture across a pixel: the edge of the disc falls within pixels.
_FINER = 4
#: Share of the sun's light that its picture must hold.
_HELD = 0.995


@dataclass(frozen=True, slots=True, eq=False)
class FluxGrid:
    """Where flux is wanted on a target: a grid of square pixels.

    x_m (nx,), y_m (ny,): Columns and rows on the target, ascending, evenly spaced [m].
    """

    x_m: FloatArray
    y_m: FloatArray

    @property
    def step_m(self) -> float:
        """Distance of columns [m]."""
        return float(self.x_m[1] - self.x_m[0])

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.y_m.size, self.x_m.size

    @property
    def pixel_m2(self) -> float:
        """Area of a pixel [m^2]."""
        return self.step_m * float(self.y_m[1] - self.y_m[0])


@dataclass(frozen=True, eq=False)
class Scene(ShortRepr):
    """A mirror in the light of the sun before a target.

    position_m (3,): Middle of the mirror in the field [m].
    rotation (3, 3): Axes of the mirror as columns, in the field.
    to_sun (3,): Direction to the sun's centre, in the field.
    target: The target.
    sun: Radiance over the angle from the sun's centre.
    scatter_rad: Scatter of the reflected beam in one direction beyond the surface that is given, 1 sigma [rad].
    """

    position_m: FloatArray
    rotation: FloatArray
    to_sun: FloatArray
    target: PlaneTarget
    sun: SunShape
    scatter_rad: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "position_m", float_array("position_m", self.position_m, (3,)))
        object.__setattr__(self, "rotation", float_array("rotation", self.rotation, (3, 3)))
        object.__setattr__(self, "to_sun", unit_vector("to_sun", self.to_sun))
        if not self.rotation[:, 2] @ self.to_sun > 0:
            raise InputError("to_sun: the sun stands behind the mirror; check time, time zone and place")
        if self.to_sun[2] < 0:
            raise InputError("to_sun: the sun is below the horizon; check time, time zone and place")
        toward = self.position_m - self.target.center_m
        if not self.target.normal @ toward > 0:
            raise InputError(f"target {self.target.name}: the mirror stands behind it; check its corners' order")

    @property
    def distance_m(self) -> float:
        """From the mirror's middle to the target's [m]."""
        return float(np.linalg.norm(self.target.center_m - self.position_m))

    def landings_m(self, facet: Facet) -> tuple[FloatArray, FloatArray]:
        """Return where the sun's centre lands by way of each patch, (n, 2) [m], and the power of each, (n,) [m^2]."""
        points = self.position_m + facet.points_m @ self.rotation.T
        normals = facet.normals @ self.rotation.T
        beams = reflect(np.broadcast_to(-self.to_sun, points.shape), normals)
        lengths = intersect_plane(points, beams, self.target.center_m, self.target.normal)
        if not (lengths > 0).any():
            raise EstimationError(f"target {self.target.name}: the mirror sends no light to it")
        power = facet.area_m2 * np.maximum(normals @ self.to_sun, 0.0) * (lengths > 0)
        # A patch's area is that of the surface; the share of the sun that it catches goes with the cosine.
        return self.target.coordinates(points + lengths[:, None] * beams), power

    @cached_property
    def spread(self) -> FloatArray:
        """Derivative of the landing point by the direction of the beam, shape (2, 2) [m/rad].

        The two directions stand across the middle ray: along the horizon, and up.
        """
        normal = self.rotation[:, 2]
        beam = 2 * (normal @ self.to_sun) * normal - self.to_sun
        first = unit_vector("across the beam", np.cross(beam, [0.0, 0.0, 1.0]))
        second = np.cross(first, beam)
        length = float(intersect_plane(self.position_m, beam, self.target.center_m, self.target.normal))
        slant = float(beam @ self.target.normal)
        parts = [length * (one - beam * (one @ self.target.normal) / slant) for one in (first, second)]
        return np.asarray(np.stack([self.target.axes @ one for one in parts], axis=1))

    def sun_picture(self, step_m: float) -> FloatArray:
        """Return the light of one point of the mirror on the target around its landing, adding up to one.

        step_m: Size of its square pixels [m].
        Returns (m, m): From the lowest row up; m is odd.
        """
        inverse = np.linalg.inv(self.spread)
        reach_rad = _reach(self.sun, self.scatter_rad)
        half_m = reach_rad * float(np.linalg.norm(self.spread, ord=2))
        half = max(1, int(np.ceil(half_m / positive("step_m", step_m, "metres"))))
        size = 2 * half + 1
        side = (np.arange(size * _FINER) + 0.5) / _FINER - 0.5 - half
        # Turned by half a turn the picture is itself: the rows up to the middle one are enough.
        x, y = np.meshgrid(side * step_m, side[: (half + 1) * _FINER] * step_m)
        angle = np.hypot(inverse[0, 0] * x + inverse[0, 1] * y, inverse[1, 0] * x + inverse[1, 1] * y)
        light = np.asarray(_profile(self.sun, self.scatter_rad)(angle), dtype=np.float64)
        lower = light.reshape(half + 1, _FINER, size, _FINER).mean(axis=(1, 3))
        picture = np.concatenate([lower, lower[:-1][::-1, ::-1]])
        return np.asarray(picture / picture.sum())


class _Profile:
    """The radiance over the angle of a sun blurred by a Gaussian scatter, as a table."""

    def __init__(self, sun: SunShape, scatter_rad: float) -> None:
        reach = _reach(sun, scatter_rad)
        if scatter_rad == 0:
            self._angles: FloatArray = np.linspace(0, reach, 2000)
            self._values: FloatArray = sun.radiance(self._angles)
            return
        # On a plane grid of angles, blurred; the profile is its middle row.
        step = min(scatter_rad / 3, reach / 100)
        count = int(np.ceil(reach / step))
        axis = step * np.arange(-count, count + 1)
        plane = sun.radiance(np.hypot(axis[None, :], axis[:, None]))
        blurred = cv2.GaussianBlur(plane, (0, 0), scatter_rad / step, borderType=cv2.BORDER_CONSTANT)
        self._angles = np.asarray(axis[count:], dtype=np.float64)
        self._values = np.asarray(blurred[count, count:], dtype=np.float64)

    def __call__(self, angle_rad: FloatArray) -> FloatArray:
        return np.asarray(np.interp(angle_rad, self._angles, self._values, right=0.0))


@lru_cache(maxsize=64)
def _profile(sun: SunShape, scatter_rad: float) -> _Profile:
    return _Profile(sun, scatter_rad)


def _reach(sun: SunShape, scatter_rad: float) -> float:
    """Angle within which nearly all of the light is [rad]."""
    return _held_angle(sun) + 4 * scatter_rad


@lru_cache(maxsize=256)
def _held_angle(sun: SunShape) -> float:
    angles = np.linspace(0, sun.limit_rad, 400)
    return float(np.interp(_HELD, sun.share_within(angles), angles))


def sun_kernel(scene: Scene, grid: FluxGrid) -> FloatArray:
    """Return what each landing of the sun's centre lights on a grid: for one scene, again and again.

    Returns (m, m): From the lowest row up.
    """
    return _sharpened(scene.sun_picture(grid.step_m))


def whole_flux(scene: Scene, mirror: Mirror, grid: FluxGrid, kernel: FloatArray | None = None) -> FloatArray:
    """Compute the flux of a mirror on a target.

    kernel (m, m): From `sun_kernel`, where it is known already.
    Returns (ny, nx): For a direct irradiance and reflectance of one: where all of the sun is seen by way of mirrors it
        is the number of suns.
    EstimationError: No ray meets the target's plane.
    """
    light = sun_kernel(scene, grid) if kernel is None else kernel
    return _lit(sum((_gathered(scene, one, light, grid) for one in mirror.facets), np.zeros(())), light, grid)


def flux_change(scene: Scene, mirrors: tuple[Mirror, Mirror], grid: FluxGrid, kernel: FloatArray) -> FloatArray:
    """Return by how much more each facet of the first mirror lights the target than that of the second, (k, ny, nx)."""
    first, second = (one.facets for one in mirrors)
    return np.stack(
        [
            _lit(_gathered(scene, one, kernel, grid) - _gathered(scene, other, kernel, grid), kernel, grid)
            for one, other in zip(first, second, strict=True)
        ]
    )


def _sharpened(picture: FloatArray) -> FloatArray:
    """Take from the sun's picture what sharing landings among four pixels adds to its width.

    A landing at the share w between two columns has the variance w (1 - w), 1/6 on average: as much as a scatter of
    0.4 mrad on a grid of five pixels across the sun's radius. One twelfth of the Laplacian has the variance -1/6.
    """
    wider = np.pad(picture, 1)
    around = cv2.filter2D(
        wider, cv2.CV_64F, np.array([[0.0, 1, 0], [1, -4, 1], [0, 1, 0]]), borderType=cv2.BORDER_CONSTANT
    )
    return np.asarray(wider - around / 12, dtype=np.float64)


def _gathered(scene: Scene, facet: Facet, kernel: FloatArray, grid: FluxGrid) -> FloatArray:
    """Return the power that lands on each pixel of a grid and of the margin from where its light reaches the grid."""
    places, power = scene.landings_m(facet)
    margin = kernel.shape[0] // 2 + 2
    rows, columns = grid.shape[0] + 2 * margin, grid.shape[1] + 2 * margin
    column = (places[:, 0] - grid.x_m[0]) / grid.step_m + margin
    row = (places[:, 1] - grid.y_m[0]) / (grid.y_m[1] - grid.y_m[0]) + margin
    kept = (column >= 0) & (row >= 0) & (column < columns - 1) & (row < rows - 1)
    column, row, power = column[kept], row[kept], power[kept]
    left, low = column.astype(np.intp), row.astype(np.intp)
    across, up = column - left, row - low
    gathered: FloatArray = np.zeros(rows * columns, dtype=np.float64)
    # Each landing is shared among the four pixels around it, so that the picture moves smoothly with the mirror.
    for right, high, share in (
        (0, 0, (1 - across) * (1 - up)),
        (1, 0, across * (1 - up)),
        (0, 1, (1 - across) * up),
        (1, 1, across * up),
    ):
        index = (low + high) * columns + left + right
        gathered += np.asarray(np.bincount(index, power * share, rows * columns), dtype=np.float64)
    return gathered.reshape(rows, columns)


def _lit(gathered: FloatArray, kernel: FloatArray, grid: FluxGrid) -> FloatArray:
    """Spread the power of landings by the sun's picture."""
    margin = kernel.shape[0] // 2 + 2
    # filter2D correlates: the sun's picture is turned, for its middle to stay.
    light = cv2.filter2D(gathered, cv2.CV_64F, kernel[::-1, ::-1], borderType=cv2.BORDER_CONSTANT)
    return np.asarray(freeze(light[margin:-margin, margin:-margin] / grid.pixel_m2))
