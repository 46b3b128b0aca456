"""Photos of a beam on a tower's calibration target: panels with seams, dark corner marks, tower, sky, ambient light."""

from dataclasses import dataclass, field

import cv2
import numpy as np

from calibration.heliostat.kinematic_model import PlaneTarget
from data_synth.heliostats.flux import Beam
from data_synth.optics.pinhole import PinholeCamera
from data_synth.optics.sensor import Sensor, UnsignedArray
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import BoolArray, Float32Array, FloatArray

#: Sight lines along each side of a pixel where the surface changes; edges are right within 1/4 of a line, 0.06 px.
_LINES = 4
_ROWS_AT_ONCE = 64


@dataclass(frozen=True, slots=True, eq=False)
class TargetSurface:
    """What a calibration target looks like without a beam.

    width_m, height_m: The white rectangle [m].
    mark_arm_m, mark_width_m, mark_inset_m: L-shaped dark marks in the corners: length and width of their arms,
        distance of their outer corner from the target's edges [m].
    seam_columns, seam_rows: Panels along width and height; their seams are dark lines.
    white, mark, seam, tower: Reflectances.
    panel_spread: Standard deviation of the panels' reflectance, relative.
    seed: Of the panels' reflectances.
    """

    width_m: float = 7.0
    height_m: float = 7.0
    mark_arm_m: float = 0.8
    mark_width_m: float = 0.16
    mark_inset_m: float = 0.3
    seam_columns: int = 6
    seam_rows: int = 3
    seam_width_m: float = 0.02
    white: float = 0.85
    mark: float = 0.06
    seam: float = 0.45
    tower: float = 0.35
    panel_spread: float = 0.01
    seed: int = 0

    @property
    def corners_m(self) -> FloatArray:
        """Corners upper left, upper right, lower right, lower left as seen from the field, shape (4, 2) [m]."""
        return 0.5 * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * [self.width_m, self.height_m]

    @property
    def marks_m(self) -> FloatArray:
        """Outer corner of each mark, in the order of `corners_m`, shape (4, 2) [m]."""
        return self.corners_m - self.mark_inset_m * np.sign(self.corners_m)

    def is_on_target(self, x_m: FloatArray, y_m: FloatArray) -> BoolArray:
        """Whether points of the plane belong to the target, for arrays of any shape [m]."""
        return (np.abs(x_m) <= self.width_m / 2) & (np.abs(y_m) <= self.height_m / 2)

    def is_on_tower(self, x_m: FloatArray, y_m: FloatArray) -> BoolArray:
        """Whether points of the plane belong to the tower's face, which is wider than the target and goes down [m]."""
        return (np.abs(x_m) <= 0.72 * self.width_m) & (y_m <= 0.54 * self.height_m)

    def reflectance(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """Return the reflectance of points of the plane.

        x_m, y_m (...): Points, from the target's centre [m].
        Returns (...): 0 where there is sky.
        """
        across = (x_m / self.width_m + 0.5) * self.seam_columns
        down = (0.5 - y_m / self.height_m) * self.seam_rows
        panels = np.random.default_rng(self.seed).standard_normal((self.seam_rows, self.seam_columns))
        column = np.clip(across.astype(np.int64), 0, self.seam_columns - 1)
        row = np.clip(down.astype(np.int64), 0, self.seam_rows - 1)
        surface = self.white * (1 + self.panel_spread * panels)[row, column]
        off_x = np.abs(across - np.rint(across)) * self.width_m / self.seam_columns
        off_y = np.abs(down - np.rint(down)) * self.height_m / self.seam_rows
        surface = np.where(np.minimum(off_x, off_y) < self.seam_width_m / 2, self.seam, surface)
        # Distance inwards from the outer corner of the nearest mark.
        in_x = self.width_m / 2 - self.mark_inset_m - np.abs(x_m)
        in_y = self.height_m / 2 - self.mark_inset_m - np.abs(y_m)
        arm = (np.minimum(in_x, in_y) >= 0) & (np.maximum(in_x, in_y) <= self.mark_arm_m)
        surface = np.where(arm & (np.minimum(in_x, in_y) <= self.mark_width_m), self.mark, surface)
        surface = np.where(self.is_on_target(x_m, y_m), surface, self.tower)
        return np.where(self.is_on_tower(x_m, y_m), surface, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Light:
    """Light on the target, in suns, and how the camera takes it.

    ambient_suns: Light on the target without a beam, as a share of the direct sun.
    gradient: Relative change of it from the middle to the right edge and to the upper edge.
    sky: Brightness of the sky, as white of this irradiance [suns].
    full_scale_suns: Irradiance on white of reflectance 1 that fills the sensor at exposure 1.
    vignetting: Share of the light that is lost in the corners of the photo.
    blur_px: Gaussian blur of the lens [px].
    """

    ambient_suns: float = 0.5
    gradient: tuple[float, float] = (0.06, -0.10)
    sky: float = 0.5
    full_scale_suns: float = 3.0
    vignetting: float = 0.08
    blur_px: float = 0.8


def look_at(camera_m: FloatArray, aim_m: FloatArray, roll_rad: float = 0.0) -> RigidTransform:
    """Return the pose of a camera that looks at a point, turned about its line of sight.

    camera_m, aim_m (3,): Camera and point, in the world (z up) [m].
    """
    forward = np.asarray(aim_m, dtype=np.float64) - camera_m
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    cosine, sine = np.cos(roll_rad), np.sin(roll_rad)
    rotation = np.stack([cosine * right + sine * down, cosine * down - sine * right, forward])
    return RigidTransform(rotation, -rotation @ camera_m)


@dataclass(frozen=True, slots=True, eq=False)
class TargetCamera:
    """A fixed camera before a target; what each pixel sees is computed once.

    camera: The lens.
    cam_from_world: Its pose.
    surface: What it looks like.
    sensor: Noise, bits, black level.
    light: Ambient light and exposure.
    """

    camera: PinholeCamera
    cam_from_world: RigidTransform
    target: PlaneTarget
    surface: TargetSurface = field(default_factory=TargetSurface)
    sensor: Sensor = field(default_factory=Sensor)
    light: Light = field(default_factory=Light)
    x_m: FloatArray = field(init=False, repr=False)
    y_m: FloatArray = field(init=False, repr=False)
    reflectance: Float32Array = field(init=False, repr=False)
    sky: Float32Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        width, height = self.camera.width_px, self.camera.height_px
        columns, rows = np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64)
        x, y = self.seen(*np.meshgrid(columns, rows))
        shares = np.zeros((2, height, width), dtype=np.float32)
        parts = (np.arange(_LINES) + 0.5) / _LINES - 0.5
        for start in range(0, height, _ROWS_AT_ONCE):
            block = slice(start, min(start + _ROWS_AT_ONCE, height))
            for part_y in parts:
                for part_x in parts:
                    seen = self.seen(*np.meshgrid(columns + part_x, rows[block] + part_y))
                    shares[0, block] += self.surface.reflectance(*seen)
                    shares[1, block] += ~self.surface.is_on_tower(*seen)
        shares /= _LINES**2
        for name, value in (("x_m", x), ("y_m", y), ("reflectance", shares[0]), ("sky", shares[1])):
            object.__setattr__(self, name, value)

    def seen(self, x_px: FloatArray, y_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the points of the target's plane that image points show.

        Shapes: x_px, y_px (...).
        Returns: Right and up from the target's centre; 1e9 where the sight line passes by the plane [m].
        """
        world_from_cam = self.cam_from_world.inverse()
        rays = self.camera.rays(x_px, y_px) @ world_from_cam.rotation.T
        offset = world_from_cam.translation_m - self.target.center_m
        approach = rays @ self.target.normal
        travel = np.where(approach < -1e-9, -(offset @ self.target.normal) / np.minimum(approach, -1e-9), 1e9)
        points = offset + travel[..., None] * rays
        return points @ self.target.right, points @ self.target.up

    def image_points(self, points_m: FloatArray) -> FloatArray:
        """Return where points of the plane appear.

        Shapes: result (n, 2).
        points_m (n, 2): Right and up from the target's centre [m].
        """
        return self.camera.project(self.cam_from_world.apply(self.target.points(points_m)))

    def take(self, beam: Beam | None, rng: np.random.Generator, ambient_factor: float = 1.0) -> UnsignedArray:
        """Take a photo.

        Shapes: result (height, width).
        beam: The beam; None for an empty target.
        ambient_factor: How bright the ambient light is at this moment, relative to the usual.
        """
        return self.sensor.expose(self.expected_light(beam, ambient_factor), rng)

    def expected_light(self, beam: Beam | None, ambient_factor: float = 1.0) -> Float32Array:
        """Return the light on the pixels, 1 for the full scale, without noise (see `take`)."""
        light = self.light
        tilt_x, tilt_y = light.gradient
        gradient = 1 + tilt_x * self.x_m / (self.surface.width_m / 2) + tilt_y * self.y_m / (self.surface.height_m / 2)
        total = np.asarray(light.ambient_suns * ambient_factor * np.clip(gradient, 0.3, 2.0), dtype=np.float32)
        if beam is not None:
            total += _interpolated(beam, self.x_m, self.y_m)
        total *= self.reflectance
        rows = np.linspace(1.15, 0.9, len(total), dtype=np.float32)[:, None]
        total += np.float32(light.sky * ambient_factor) * rows * self.sky
        total *= (self._vignette() / light.full_scale_suns).astype(np.float32)
        if light.blur_px > 0:
            total = np.asarray(cv2.GaussianBlur(total, (0, 0), light.blur_px), dtype=np.float32)
        return total

    def _vignette(self) -> FloatArray:
        x = np.linspace(-1, 1, self.camera.width_px)
        y = np.linspace(-1, 1, self.camera.height_px)
        return np.asarray(1 - self.light.vignetting * 0.5 * (x[None, :] ** 2 + y[:, None] ** 2))


def _interpolated(beam: Beam, x_m: FloatArray, y_m: FloatArray) -> Float32Array:
    column = ((x_m - beam.x_m[0]) / (beam.x_m[1] - beam.x_m[0])).astype(np.float32)
    row = ((y_m - beam.y_m[0]) / (beam.y_m[1] - beam.y_m[0])).astype(np.float32)
    suns = beam.suns.astype(np.float32)
    # Cubic between points 5 cm apart on a beam 2 m wide; beyond the window there is no light.
    drawn = cv2.remap(suns, column, row, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT, borderValue=0.0)
    return np.asarray(np.maximum(drawn, 0), dtype=np.float32)
