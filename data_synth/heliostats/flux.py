"""The beam of one heliostat on a plane: the sun's disc through canted, curved facets with slope errors.

Written apart from `heliogauge.sunlight.beam`, which traces rays of measured slope maps; here each point of the plane
looks back at each patch of the mirror and asks how bright the sun is in the direction that it sees there.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calibration.heliostat.kinematic_model import PlaneTarget
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.sunlight.sun_shapes import BuieSun, SunShape
from heliogauge.validate import FloatArray, float_array, positive

#: Gauss nodes along each side of a facet: the sun's disc of 9.3 mrad from 20 m away is as wide as 0.19 m, a node of a
#: facet of 1.6 m stands for 0.2 m; farther away the sum is smoother still.
_NODES = 8
_TABLE = 400
#: Radiance, relative to the centre, below which the aureole is left out.
_FAINTEST = 1e-3


class Patches(NamedTuple):
    """Points (p, 3) [m], unit normals (p, 3) and areas (p,) [m^2] of patches of a mirror, in its frame."""

    points_m: FloatArray
    normals: FloatArray
    area_m2: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Facets:
    """The reflecting surface of a heliostat.

    Frame of the mirror: x along the width and y along the height as seen from the front, z out of the mirror.

    centers_m (k, 3): Middle of each facet [m].
    normals (k, 3): Unit normal of each facet's middle.
    width_m, height_m: Size of each facet [m].
    curvature_1pm (k, 2): Curvature of each facet along x and y, 1 / (2 f) of a focusing one, 0 where it is flat
        [1/m].
    sigma_slope_rad: Random slope error of the normal, one component, smaller than what the patches resolve [rad].
    InputError: Wrong shapes, a size that is not positive, a negative slope error.
    """

    centers_m: FloatArray
    normals: FloatArray
    width_m: float
    height_m: float
    curvature_1pm: FloatArray
    sigma_slope_rad: float

    def __post_init__(self) -> None:
        centers = float_array("facet centers_m", self.centers_m, (None, 3))
        object.__setattr__(self, "centers_m", centers)
        object.__setattr__(self, "normals", float_array("facet normals", self.normals, centers.shape))
        curvature = float_array("facet curvature_1pm", self.curvature_1pm, (len(centers), 2))
        object.__setattr__(self, "curvature_1pm", curvature)
        positive("facet width_m", self.width_m, "metres")
        positive("facet height_m", self.height_m, "metres")
        if not self.sigma_slope_rad >= 0:
            raise InputError(f"sigma_slope_rad: 0 or more is needed, not {self.sigma_slope_rad}")

    @property
    def radius_m(self) -> float:
        """Largest distance of a point of the mirror from the mirror's middle [m]."""
        half = 0.5 * np.hypot(self.width_m, self.height_m)
        return float(np.linalg.norm(self.centers_m[:, :2], axis=1).max() + half)

    def patches(self) -> Patches:
        """Return points, unit normals and areas of the patches that stand for the surface."""
        nodes, weights = np.polynomial.legendre.leggauss(_NODES)
        along_x, along_y = (0.5 * nodes * size for size in (self.width_m, self.height_m))
        x, y = (grid.ravel() for grid in np.meshgrid(along_x, along_y))
        area = np.outer(weights, weights).ravel() * (0.25 * self.width_m * self.height_m)
        flat = np.stack([x, y, np.zeros_like(x)], axis=-1)
        points = (self.centers_m[:, None] + flat).reshape(-1, 3)
        bend = np.stack([x, y], axis=-1)[None] * self.curvature_1pm[:, None]
        normals = np.repeat(self.normals[:, None], len(x), axis=1)
        normals[..., :2] -= bend
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        return Patches(points, normals.reshape(-1, 3), np.tile(area, len(self.centers_m)))


@dataclass(frozen=True, slots=True, eq=False)
class FacetErrors:
    """How far from ideal the facets are, one standard deviation each.

    cant_rad: Tilt of a facet's normal about each of its axes [rad].
    focus: Relative error of a facet's curvature along each axis.
    slope_rad: Random slope error of the normal, one component [rad].
    """

    cant_rad: float = 0.0
    focus: float = 0.0
    slope_rad: float = 1.0e-3


def canted_facets(
    counts: tuple[int, int],
    size_m: tuple[float, float],
    distance_m: float,
    errors: FacetErrors,
    rng: np.random.Generator,
    *,
    flat: bool = False,
) -> Facets:
    """Return facets of one paraboloid that focuses at a distance, with drawn errors.

    counts: Facets along the width and along the height.
    size_m: Width and height of the whole mirror; 4 % between facets is gap [m].
    distance_m: Focal length [m].
    flat: Each facet is flat; canted all the same.
    Returns: The mirror; the area-weighted mean of the normals is +z exactly, so that canting errors do not turn the
        beam.
    """
    positive("distance_m", distance_m, "metres")
    pitch = np.array(size_m) / counts
    facet = pitch * (0.98 if max(counts) > 1 else 1.0)
    x = (np.arange(counts[0]) - 0.5 * (counts[0] - 1)) * pitch[0]
    y = (np.arange(counts[1]) - 0.5 * (counts[1] - 1)) * pitch[1]
    centers = np.stack([*(grid.ravel() for grid in np.meshgrid(x, y)), np.zeros(x.size * y.size)], axis=-1)
    tilt = errors.cant_rad * rng.standard_normal((len(centers), 2))
    tilt -= tilt.mean(axis=0)
    slopes = centers[:, :2] / (2 * distance_m) + tilt
    normals = np.concatenate([-slopes, np.ones((len(centers), 1))], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    bend = 0.0 if flat else 1 / (2 * distance_m)
    curvature = bend * (1 + errors.focus * rng.standard_normal((len(centers), 2)))
    return Facets(centers, normals, float(facet[0]), float(facet[1]), curvature, errors.slope_rad)


@dataclass(frozen=True, slots=True, eq=False)
class ReflectedSun:
    """The sun as a point of the mirror scatters it: radiance over the angle from the reflected centre.

    step_rad: Step of the table [rad].
    radiance (n,): Radiance from angle 0 on, such that its integral over solid angle is 1; 0 beyond [1/sr].
    """

    step_rad: float
    radiance: FloatArray

    @property
    def limit_rad(self) -> float:
        """Angle beyond which there is no light [rad]."""
        return self.step_rad * (self.radiance.size - 1)

    def at(self, angle_rad: FloatArray) -> FloatArray:
        """Return the radiance at angles of any shape [rad], straight between the table's entries."""
        place = np.minimum(angle_rad * (1 / self.step_rad), self.radiance.size - 1.001)
        index = place.astype(np.intp)
        below = self.radiance[index]
        value = below + (place - index) * (self.radiance[index + 1] - below)
        return np.where(angle_rad < self.limit_rad, value, 0.0)


def reflected_sun(sun: SunShape, sigma_rad: float) -> ReflectedSun:
    """Convolve a sun shape with a Gaussian of the beam.

    sigma_rad: Standard deviation of the beam's direction, one component [rad].
    Returns: The blurred sun, cut where it is fainter than 0.1 % of its centre.

    ``B(q) = int S(r) r / s^2 exp(-(q - r)^2 / 2 s^2) I0e(q r / s^2) dr``, the convolution of two shapes that are
    round.
    """
    from scipy.special import i0e

    sigma = max(sigma_rad, 1e-5)
    edges = np.linspace(0, sun.limit_rad, 601)
    radius = 0.5 * (edges[1:] + edges[:-1])
    power = sun.radiance(radius) * radius * np.diff(edges)
    angle = np.linspace(0, sun.limit_rad + 5 * sigma, 400)
    kernel = np.exp(-0.5 * ((angle[:, None] - radius) / sigma) ** 2) * i0e(angle[:, None] * radius / sigma**2)
    blurred = kernel @ power / sigma**2
    reach = angle[np.flatnonzero(blurred > _FAINTEST * blurred[0])[-1]]
    table = np.linspace(0, reach, _TABLE)
    radiance = np.interp(table, angle, blurred)
    whole = np.trapezoid(2 * np.pi * table * radiance, table)
    return ReflectedSun(float(table[1]), radiance / whole)


@dataclass(frozen=True, slots=True, eq=False)
class Beam:
    """Irradiance on a grid of a plane that covers the whole beam.

    x_m (nx,): Coordinates along the plane's right [m].
    y_m (ny,): Coordinates along its up [m].
    suns (ny, nx): Irradiance, in multiples of the direct normal irradiance times the reflectance.
    """

    x_m: FloatArray
    y_m: FloatArray
    suns: FloatArray

    @property
    def power_m2(self) -> float:
        """Reflected power, as an area that faces the sun [m^2]."""
        return float(self.suns.sum() * (self.x_m[1] - self.x_m[0]) * (self.y_m[1] - self.y_m[0]))

    @property
    def centroid_m(self) -> FloatArray:
        """Centroid of the whole beam, shape (2,) [m]."""
        whole = self.suns.sum()
        return np.asarray([self.suns.sum(axis=0) @ self.x_m / whole, self.suns.sum(axis=1) @ self.y_m / whole])

    def share_inside(self, width_m: float, height_m: float) -> float:
        """Return the share of the power inside a rectangle about the origin, of this width and height [m]."""
        inside = (np.abs(self.y_m) <= height_m / 2)[:, None] & (np.abs(self.x_m) <= width_m / 2)
        return float(self.suns[inside].sum() / self.suns.sum())


def beam_on_target(
    facets: Facets,
    world_from_mirror: RigidTransform,
    sun_direction: FloatArray,
    target: PlaneTarget,
    *,
    sun: SunShape | None = None,
    pixels: int = 72,
) -> Beam:
    """Compute the irradiance that a heliostat throws on a target.

    world_from_mirror: Pose of the mirror's frame, its origin in the middle of the mirror.
    sun_direction (3,): Unit vector to the sun.
    target: Plane that catches the beam; also what passes its edges is returned.
    sun: The sun; a darkened disc with 2 % circumsolar light without.
    pixels: Points of the grid along each side.
    Returns: The irradiance on a window that holds the whole beam.
    InputError: The sun is behind the mirror, or the beam does not meet the target.

    ``E(P) = sum_k A_k cos(theta_k) B(angle(P - X_k, r_k)) cos(theta_P) / |P - X_k|^2`` over patches k at X_k with the
    reflected direction r_k. The slope error scatters the beam by ``2 sigma`` in the plane of incidence and by
    ``2 sigma cos(theta)`` across it; a round Gaussian of the same mean square is taken. No shading, no blocking.
    """
    points, normals, area = facets.patches()
    origin = world_from_mirror.apply(points)
    normal = world_from_mirror.rotate(normals)
    cosine = normal @ sun_direction
    if (cosine <= 0).any():
        raise InputError("the sun is behind the mirror: no beam")
    reflected = 2 * cosine[:, None] * normal - sun_direction
    approach = reflected @ target.normal
    travel = ((target.center_m - origin) @ target.normal) / approach
    if (approach >= -1e-3).any() or (travel <= 0).any():
        raise InputError("the beam does not meet the target from its front")
    sigma = facets.sigma_slope_rad * np.sqrt(2 * (1 + float(np.mean(cosine)) ** 2))
    shape = reflected_sun(BuieSun(0.02) if sun is None else sun, sigma)
    hits = origin + travel[:, None] * reflected - target.center_m
    axes = []
    for axis in (target.right, target.up):
        along = hits @ axis
        slant = np.sqrt(approach**2 + (reflected @ axis) ** 2) / approach**2
        reach = 1.1 * float(np.max(shape.limit_rad * travel * slant))
        axes.append(np.linspace(along.min() - reach, along.max() + reach, pixels))
    x, y = axes
    suns = _irradiance(target, (x, y), shape, (origin, reflected, area * cosine))
    return Beam(x, y, suns)


def _irradiance(
    target: PlaneTarget,
    axes: tuple[FloatArray, FloatArray],
    shape: ReflectedSun,
    patches: tuple[FloatArray, FloatArray, FloatArray],
) -> FloatArray:
    origin, reflected, power = patches
    x, y = axes[0][None, :], axes[1][:, None]
    offset = target.center_m - origin
    # Seen from a patch, squared distance and length along the reflected ray are sums of one term of x and one of y.
    across, above, ahead = offset @ target.right, offset @ target.up, -offset @ target.normal
    total: FloatArray = np.zeros((y.size, x.size))
    for k in range(len(origin)):
        square = (x + across[k]) ** 2 + ((y + above[k]) ** 2 + ahead[k] ** 2)
        along = x * (reflected[k] @ target.right) + (y * (reflected[k] @ target.up) + offset[k] @ reflected[k])
        distance = np.sqrt(square)
        # 2 (1 - cos) is the square of the angle; of angles near 5 mrad it keeps nine digits.
        angle = np.sqrt(np.maximum(2 - 2 * along / distance, 0.0))
        total += (power[k] * ahead[k]) * shape.at(angle) / (square * distance)
    return total
