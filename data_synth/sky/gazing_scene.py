"""The sun in a heliostat, as cameras near the receiver see it: each pixel a mean over sights that are traced."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from data_synth.sky.heliostat import TABLE_6_MRAD, DrawnHeliostat
from heliogauge.validate import FloatArray, IntArray

#: Sights through each pixel, along each side.
_SIGHTS = 2


def super_gaussian(radius_rad: float, exponent: float) -> Callable[[FloatArray], FloatArray]:
    """Return the radiance ``exp(-(angle / radius)^exponent)`` (spec 003 C-47, eq. 4)."""

    def radiance(angle_rad: FloatArray) -> FloatArray:
        return np.asarray(np.exp(-((angle_rad / radius_rad) ** exponent)))

    return radiance


def heliostat_of_table_6(seed: int, bow_mrad_per_m: float = 0.0) -> DrawnHeliostat:
    """Return ten facets on a sphere of focal length 200 m, with the tilts of Table 6."""
    rng = np.random.default_rng([seed, 6])
    bows = 1e-3 * bow_mrad_per_m * rng.standard_normal((10, 3))
    return DrawnHeliostat(2, 5, 1.5, 1.0, 0.05, 400.0, 400.0, 1e-3 * TABLE_6_MRAD.T, bows)


class GazingKnowledge(NamedTuple):
    """Standard deviations of what the measurement will state, and by which the truth departs from it.

    camera_m, mirror_m: Of each coordinate of places. sun_rad: Of the sun's direction, each way. focal: Of the sun
    camera's focal length, relative. level: Of each camera's level. reflectance: Relative. point_px: Of points.
    """

    camera_m: float = 2e-3
    mirror_m: float = 5e-3
    sun_rad: float = 5e-5
    focal: float = 1e-3
    level: float = 0.01
    reflectance: float = 0.01
    point_px: float = 0.2


def no_errors() -> GazingKnowledge:
    """Return knowledge without errors."""
    return GazingKnowledge(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.01)


@dataclass(frozen=True, slots=True, eq=False)
class GazingScene:
    """Heliostat, sun and cameras.

    distance_m: From the heliostat to the middle of the cameras.
    tilt_rad: Turn of the heliostat's normal from that direction, about the vertical and up (A and H of the spec).
    offsets_m (c, 2): The cameras beside that middle, across and up.
    pixels: Width and height of the images. focal_px: Of the cameras near the receiver; sun_focal_px: On the sun.
    noise_share: Noise of a pixel, whatever its light, over the light of the sun's middle in the mirror.
    pattern_share: Standard deviation of the pixels' response.
    frames: Images of each camera. reflectance: Of the mirror.
    clouds: Share of the light that reaches each camera's frames; 1: no cloud.
    saturated: Cameras whose exposure is four times too long.
    known: What the measurement states.
    """

    heliostat: DrawnHeliostat
    distance_m: float = 200.0
    tilt_rad: tuple[float, float] = (np.pi / 12, np.pi / 12)
    offsets_m: FloatArray = field(default_factory=lambda: square_of(0.4))
    pixels: int = 400
    focal_px: float = 10000.0
    sun_focal_px: float = 16000.0
    radiance: Callable[[FloatArray], FloatArray] = field(
        default_factory=lambda: super_gaussian(np.radians(16 / 60), 4.0)
    )
    noise_share: float = 0.01
    pattern_share: float = 0.01
    frames: int = 1
    reflectance: float = 0.93
    clouds: FloatArray = field(default_factory=lambda: np.ones(8))
    saturated: tuple[int, ...] = ()
    known: GazingKnowledge = field(default_factory=GazingKnowledge)

    def with_spacing(self, spacing_m: float) -> "GazingScene":
        """Return the scene with four cameras in a square of this side."""
        return replace(self, offsets_m=square_of(spacing_m))


def square_of(side_m: float) -> FloatArray:
    """Return four places in a square, shape (4, 2) [m]."""
    return 0.5 * side_m * np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])


class GazingPlaces(NamedTuple):
    """Where all is in the field's frame: east, north, up.

    heliostat_m, aim_m (3,), cameras_m (c, 3), sun (3,): The sun's direction.
    axes (3, 3): Axes of the mirror's frame as columns.
    """

    heliostat_m: FloatArray
    aim_m: FloatArray
    cameras_m: FloatArray
    sun: FloatArray
    axes: FloatArray


def places_of(scene: GazingScene) -> GazingPlaces:
    """Return the true places: the heliostat north of a tower, its normal turned from the sight to it."""
    aim = np.array([0.0, 0.0, 75.0])
    level = np.sqrt(scene.distance_m**2 - aim[2] ** 2)
    heliostat = np.array([0.0, level, 0.0])
    sight = (aim - heliostat) / scene.distance_m
    azimuth, height = np.arctan2(sight[0], sight[1]), np.arcsin(sight[2])
    turned = azimuth + scene.tilt_rad[0], height + scene.tilt_rad[1]
    normal = np.array([np.cos(turned[1]) * np.sin(turned[0]), np.cos(turned[1]) * np.cos(turned[0]), np.sin(turned[1])])
    sun = 2 * (normal @ sight) * normal - sight
    across = np.cross([0.0, 0.0, 1.0], normal)
    across /= np.linalg.norm(across)
    right = np.cross([0.0, 0.0, 1.0], -sight)
    right /= np.linalg.norm(right)
    up = np.cross(right, -sight)
    cameras = aim + scene.offsets_m @ np.stack([right, up])
    return GazingPlaces(heliostat, aim, cameras, sun, np.stack([across, np.cross(normal, across), normal], axis=1))


def look_at(eye_m: FloatArray, at_m: FloatArray) -> FloatArray:
    """Return the axes of a level camera as columns in the field's frame: right, down, forward."""
    forward = (at_m - eye_m) / np.linalg.norm(at_m - eye_m)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward], axis=1)


def sights(size: tuple[int, int], focal_px: float, axes: FloatArray, step: tuple[float, float]) -> FloatArray:
    """Return the sights through all pixels, each a step beside its middle, shape (h * w, 3)."""
    width, height = size
    column, row = np.meshgrid(np.arange(width) + step[0], np.arange(height) + step[1])
    local = np.stack(
        [(column - 0.5 * (width - 1)) / focal_px, (row - 0.5 * (height - 1)) / focal_px, np.ones(column.shape)], axis=-1
    )
    return np.asarray(local.reshape(-1, 3) @ axes.T)


def mirror_light(scene: GazingScene, places: GazingPlaces, camera: int) -> FloatArray:
    """Return the light of each pixel over that of the sun's middle, before reflectance, shape (h, w)."""
    eye = places.cameras_m[camera]
    axes = look_at(eye, places.heliostat_m)
    eye_mirror = (eye - places.heliostat_m) @ places.axes
    sun = places.sun @ places.axes
    total = np.zeros(scene.pixels**2)
    inner = (np.arange(_SIGHTS) + 0.5) / _SIGHTS - 0.5
    for step_x in inner:
        for step_y in inner:
            ray = sights((scene.pixels, scene.pixels), scene.focal_px, axes, (step_x, step_y)) @ places.axes
            after, hit = scene.heliostat.reflect(eye_mirror, ray)
            off = np.linalg.norm(np.cross(after, sun), axis=1)
            ahead = (after @ sun > 0) & (hit >= 0)
            total += np.where(ahead, scene.radiance(off), 0.0)
    return total.reshape(scene.pixels, scene.pixels) / _SIGHTS**2


def sun_light(radiance: Callable[[FloatArray], FloatArray], pixels: int, focal_px: float) -> FloatArray:
    """Return an image of the sun, its middle 1, a little beside the middle of the image, shape (h, w)."""
    total = np.zeros((pixels, pixels))
    inner = (np.arange(3) + 0.5) / 3 - 0.5
    line = np.arange(pixels) - 0.5 * (pixels - 1)
    for step_x in inner:
        for step_y in inner:
            x, y = np.meshgrid(line + step_x - 0.37, line + step_y + 0.21)
            total += radiance(np.arctan(np.hypot(x, y) / focal_px))
    return total / 9


def true_slopes(scene: GazingScene, facet: int, x_m: FloatArray, y_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the true slopes in the facet's frame without its tilt, at points (n,) of that frame."""
    helio = scene.heliostat
    turn = helio.axes(facet, tilted=False).T @ helio.axes(facet)
    # Points of the design's frame are those of the tilted one to a millionth of their distance from the middle.
    slope_x, slope_y = helio.slopes(facet, x_m, y_m)
    normal = turn @ np.stack([-slope_x, -slope_y, np.ones(slope_x.shape)])
    return -normal[0] / normal[2], -normal[1] / normal[2]


def corner_points(scene: GazingScene) -> tuple[FloatArray, IntArray]:
    """Return the outer corners of the mirror in its frame (4, 3) and the facets that they belong to."""
    helio = scene.heliostat
    facets = np.array([0, helio.columns - 1, helio.count - 1, helio.count - helio.columns])
    corners = []
    for number, facet in enumerate(facets.tolist()):
        x, y = helio.outline_m[number]
        r = helio.facet_radius_m
        local = np.array([x, y, r - np.sqrt(r**2 - x**2 - y**2)])
        corners.append(helio.axes(facet, tilted=False) @ local + helio.place_m(facet))
    return np.array(corners), facets
