"""A heliostat of canted facets before a bright source, and what a camera beside the source sees in them."""

from dataclasses import dataclass

import cv2
import numpy as np

from heliogauge.geometry.rigid import rotation_from_vector
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, IntArray

#: Waves of each facet: their lengths as shares of a facet's side.
_WAVES = (0.21, 0.27, 0.34, 0.43, 0.21, 0.27, 0.34, 0.43)
#: Samples along a facet for the mean slope of its waves.
_SAMPLES = 61


@dataclass(frozen=True, slots=True)
class ReflectionScene(ShortRepr):
    """A heliostat, a source, cameras.

    columns, rows, side_m, pitch_m: Square facets and the distance of their middles.
    focal_length_m: Of each facet, a paraboloid; normals are canted to the middle of the source.
    distance_m, half_m: Of the source, a square across the heliostat's axis.
    tilt_sigma_rad: Each facet is turned by so much about x and y.
    wave_sigma_rad: RMS slope of each facet's waves, in x and in y.
    cameras_m: Where the photos are taken, in the heliostat's frame.
    focal_px, width_px, height_px: Of the camera, without distortion.
    blur_px, noise_dn: Of the photos; bright_dn, dark_dn: levels.
    subpixels: Rays along the side of a pixel.
    sigma_point_px: Noise of the points of known place.
    sigma_place_m: Error of the surveyed places of cameras and source, of each coordinate.
    """

    columns: int = 3
    rows: int = 3
    side_m: float = 1.2
    pitch_m: float = 1.25
    focal_length_m: float = 60.0
    distance_m: float = 40.0
    half_m: float = 0.3
    tilt_sigma_rad: float = 1.5e-3
    wave_sigma_rad: float = 0.1e-3
    cameras_m: tuple[tuple[float, float, float], ...] = ((0.42, 0.1, 39.9), (-0.4, 0.24, 40.2), (0.05, -0.44, 39.7))
    focal_px: float = 7000.0
    width_px: int = 800
    height_px: int = 800
    blur_px: float = 0.8
    noise_dn: float = 1.0
    bright_dn: float = 170.0
    dark_dn: float = 12.0
    subpixels: int = 4
    sigma_point_px: float = 0.1
    sigma_place_m: float = 0.003

    @property
    def names(self) -> list[str]:
        """Names of the facets, row by row from below."""
        return [f"{row + 1}{column + 1}" for row in range(self.rows) for column in range(self.columns)]

    @property
    def middles_m(self) -> FloatArray:
        """Middles of the facets, shape (k, 2) [m]."""
        grid = np.meshgrid(*(np.arange(count) - 0.5 * (count - 1) for count in (self.columns, self.rows)))
        return self.pitch_m * np.column_stack([one.ravel() for one in grid])

    def rotations(self) -> list[FloatArray]:
        """Return the rotations from the facets to the heliostat as designed: normals point to the source's middle."""
        found = []
        for x, y in self.middles_m:
            normal = np.array([-x, -y, self.distance_m])
            normal /= np.linalg.norm(normal)
            axis = np.cross([0.0, 0.0, 1.0], normal)
            size = np.linalg.norm(axis)
            angle = np.arctan2(size, normal[2])
            found.append(rotation_from_vector(axis / size * angle if size > 0 else np.zeros(3)))
        return found

    def tilts_rad(self, seed: int) -> FloatArray:
        """Return the turns of the mounts, shape (k, 2): positive where a facet rises too much towards +x, +y [rad]."""
        rng = np.random.default_rng([seed, 1])
        return rng.normal(0, self.tilt_sigma_rad, (len(self.middles_m), 2))

    def waves(self, seed: int) -> list["Waves"]:
        """Return the waves of each facet."""
        rng = np.random.default_rng([seed, 2])
        found = []
        for _ in range(len(self.middles_m)):
            directions = rng.uniform(0, 2 * np.pi, len(_WAVES))
            lengths = self.side_m * np.array(_WAVES)
            numbers = 2 * np.pi / lengths * np.stack([np.cos(directions), np.sin(directions)])
            # Amplitude of the slope along each: half of its square is in the mean, shared by x and y.
            amplitude = self.wave_sigma_rad * np.sqrt(4 / len(_WAVES))
            found.append(Waves(numbers, amplitude * lengths / (2 * np.pi), rng.uniform(0, 2 * np.pi, len(_WAVES))))
        return found

    def true_turns_rad(self, seed: int) -> FloatArray:
        """Return mean normals against design, turns of mounts and mean slopes of waves, shape (k, 2) [rad]."""
        line = (np.arange(_SAMPLES) + 0.5) / _SAMPLES * self.side_m - 0.5 * self.side_m
        x, y = (one.ravel() for one in np.meshgrid(line, line))
        means = [np.mean(one.slopes(x, y), axis=1) for one in self.waves(seed)]
        return np.asarray(self.tilts_rad(seed) + np.array(means))


@dataclass(frozen=True, slots=True, eq=False)
class Waves:
    """Waves of a facet: ``z = sum h sin(k . x + phase)``.

    numbers (2, n): k [rad/m]. heights_m (n,). phases (n,).
    """

    numbers: FloatArray
    heights_m: FloatArray
    phases: FloatArray

    def slopes(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the slopes at places, shape (2, n)."""
        found = np.zeros((2, x.size))
        for number, height, phase in zip(self.numbers.T, self.heights_m, self.phases, strict=True):
            found += height * number[:, None] * np.cos(number[0] * x + number[1] * y + phase)
        return found


def camera_rotation(camera_m: FloatArray) -> FloatArray:
    """Return the rotation from the heliostat's axes to those of a camera that looks at its middle, its top up."""
    forward = -camera_m / np.linalg.norm(camera_m)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def draw_photo(
    scene: ReflectionScene, camera_m: FloatArray, source_m: FloatArray, seed: int, rng: np.random.Generator
) -> FloatArray:
    """Trace rays of all subpixels to the facets and from these to the source; shape (rows, columns) [DN]."""
    fine = scene.subpixels
    middle_px = 0.5 * np.array([scene.width_px - 1, scene.height_px - 1])
    turned_camera = camera_rotation(camera_m)
    light = np.full((scene.height_px, scene.width_px), 0.25 * scene.dark_dn)
    half = 0.5 * scene.side_m
    corners = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    every = zip(scene.middles_m, scene.rotations(), scene.tilts_rad(seed), scene.waves(seed), strict=True)
    for middle, rotation, tilt, waves in every:
        # Turned in its own frame: about -y by the first, about x by the second.
        turned = rotation @ rotation_from_vector(np.array([tilt[1], -tilt[0], 0.0]))
        around = np.column_stack([corners, np.zeros(4)]) @ turned.T + [*middle, 0.0]
        seen = project(scene, camera_m, around)
        low = np.maximum(np.floor(seen.min(axis=0)).astype(int) - 2, 0)
        high = np.minimum(np.ceil(seen.max(axis=0)).astype(int) + 3, [scene.width_px, scene.height_px])
        place_x, place_y = _ray_places(low, high, fine)
        u, v = ((one - m) / scene.focal_px for one, m in zip((place_x, place_y), middle_px, strict=True))
        rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ turned_camera
        start, along = (camera_m - [*middle, 0.0]) @ turned, rays @ turned
        t = -start[2] / along[..., 2]
        for _ in range(4):
            x, y = start[0] + t * along[..., 0], start[1] + t * along[..., 1]
            t = ((x * x + y * y) / (4 * scene.focal_length_m) - start[2]) / along[..., 2]
        x, y = start[0] + t * along[..., 0], start[1] + t * along[..., 1]
        inside = np.maximum(np.abs(x), np.abs(y)) < half
        x, y, one = x[inside], y[inside], along[inside]
        wave_x, wave_y = waves.slopes(x, y)
        slope_x, slope_y = x / (2 * scene.focal_length_m) + wave_x, y / (2 * scene.focal_length_m) + wave_y
        normal = np.stack([-slope_x, -slope_y, np.ones(x.shape)], axis=-1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        beam = (one - 2 * np.sum(one * normal, axis=-1, keepdims=True) * normal) @ turned.T
        height = (x * x + y * y) / (4 * scene.focal_length_m)
        place = np.column_stack([x, y, height]) @ turned.T + [*middle, 0.0]
        reach = (source_m[2] - place[:, 2]) / beam[:, 2]
        hit = place[:, :2] + reach[:, None] * beam[:, :2] - source_m[:2]
        lit = np.maximum(np.abs(hit[:, 0]), np.abs(hit[:, 1])) < scene.half_m
        patch = np.repeat(np.repeat(light[low[1] : high[1], low[0] : high[0]], fine, axis=0), fine, axis=1)
        patch[inside] = np.where(lit, scene.bright_dn, scene.dark_dn)
        rows, columns = high[1] - low[1], high[0] - low[0]
        light[low[1] : high[1], low[0] : high[0]] = patch.reshape(rows, fine, columns, fine).mean(axis=(1, 3))
    light = cv2.GaussianBlur(light, (0, 0), scene.blur_px)
    return np.asarray(np.clip(np.rint(light + rng.normal(0, scene.noise_dn, light.shape)), 0, 255))


def _ray_places(low: IntArray, high: IntArray, fine: int) -> tuple[FloatArray, FloatArray]:
    """Return the places x and y of all rays of the pixels from low to high, as grids [px].

    Rows are shifted against each other within their width, and columns likewise, so that no two rays of a pixel have
    the same x or the same y: an edge along a row of the photo is placed to 1 / fine^2 of a pixel, not to 1 / fine.
    """
    x, y = np.meshgrid(*(np.arange((b - a) * fine) for a, b in zip(low, high, strict=True)))
    within_x, within_y = (((one % fine) + 0.5) / fine for one in (x, y))
    return (x + within_y) / fine - 0.5 + low[0], (y + within_x) / fine - 0.5 + low[1]


def project(scene: ReflectionScene, camera_m: FloatArray, points_m: FloatArray) -> FloatArray:
    """Return where points are in a photo, shape (n, 2) [px]."""
    seen = (points_m - camera_m) @ camera_rotation(camera_m).T
    middle = 0.5 * np.array([scene.width_px - 1, scene.height_px - 1])
    return np.asarray(scene.focal_px * seen[:, :2] / seen[:, 2:] + middle)
