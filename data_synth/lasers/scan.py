"""Beams or lines of a laser over a trough panel with known slope errors, and where they come back."""

from dataclasses import dataclass

import numpy as np

from data_synth.fringes.presets import rectangle, standard_errors
from data_synth.optics.mirror import Design, SyntheticFacet, reflect
from heliogauge.geometry.rigid import rotation_from_vector
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray

#: Points of a line that are seen: 1 cm apart and less.
_POINTS_OF_LINE = 301


@dataclass(frozen=True, slots=True)
class LaserScene(ShortRepr):
    """A panel, the scan, and how well each number of the instrument is known.

    focal_length_m, width_m, length_m: Of the trough's panel, which is centred on the vertex; curved along x.
    columns, rows: Beams, or lines, across and along.
    distance_of_curvature: Of the laser, over twice the focal length.
    turn_rad: How far the panel is turned about x, y, z, which nobody measures [rad].
    sigma_spot_m, sigma_direction_rad: Noise of each spot and beam.
    others: Standard deviations with which measurement.toml states the rest; the true values differ by as much.
    """

    focal_length_m: float = 1.71
    width_m: float = 2.7
    length_m: float = 1.7
    columns: int = 61
    rows: int = 41
    distance_of_curvature: float = 1.0
    turn_rad: tuple[float, float, float] = (0.003, -0.004, 0.0)
    sigma_spot_m: float = 0.5e-3
    sigma_direction_rad: float = 2e-5
    sigma_distance_m: float = 2e-3
    sigma_offset_m: float = 2e-3
    sigma_laser_place_m: float = 1e-3
    sigma_target_scale: float = 5e-4
    sigma_angle_scale: float = 2e-4
    sigma_roll_rad: float = 1e-3

    @property
    def distance_m(self) -> float:
        """From the laser to the panel's vertex, as it is stated."""
        return 2 * self.focal_length_m * self.distance_of_curvature

    def angles(self, count: int, size_m: float) -> FloatArray:
        """Return angles of so many beams over a tenth more than the panel, shape (count,)."""
        return np.asarray(np.arctan(np.linspace(-0.5, 0.5, count) * 1.1 * size_m / self.distance_m))

    @property
    def mirror(self) -> SyntheticFacet:
        """The panel, with the slope errors of a good one."""
        outline, parameters = rectangle(self.width_m, self.length_m), {"focal_length_m": self.focal_length_m}
        errors = standard_errors(self.width_m, self.length_m)
        return SyntheticFacet("panel", outline, Design("trough", parameters), errors)


@dataclass(frozen=True, slots=True, eq=False)
class TracedScan(ShortRepr):
    """A scan and its truth.

    beams (n, 3): Directions as the instrument knows them, in the laser's frame.
    spots_m (n, 2): Where they were seen to come back [m]; NaN for beams beside the panel.
    points_m (n, 3): Where they met the panel, in its frame [m].
    slope_x, slope_y (n,): Its slopes there.
    place_m (3,): Where the panel's origin really stood, in the laser's frame [m].
    """

    beams: FloatArray
    spots_m: FloatArray
    points_m: FloatArray
    slope_x: FloatArray
    slope_y: FloatArray
    place_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class TracedSweep(ShortRepr):
    """One sweep of lines.

    normals (k, 3): Of the sheets of light as the instrument knows them, in the laser's frame.
    spots_m (k, n, 2): Points of each line in their order, as they were seen [m]; NaN beside the panel.
    """

    normals: FloatArray
    spots_m: FloatArray


class _Instrument:
    """Laser and target before a panel, with one draw of everything that is not exactly known."""

    def __init__(self, scene: LaserScene, rng: np.random.Generator, directions: tuple[int, ...]) -> None:
        # As it really stands; measurement.toml says (0, 0, distance).
        self.place_m = np.array([0.0, 0.0, -scene.distance_m]) + rng.normal(size=3) * (
            scene.sigma_offset_m,
            scene.sigma_offset_m,
            scene.sigma_distance_m,
        )
        self.scene, self.mirror, self.rng = scene, scene.mirror, rng
        self.turned = rotation_from_vector(scene.turn_rad)
        self.angle_scales = 1 + scene.sigma_angle_scale * rng.normal(size=2)
        self.noise: FloatArray = scene.sigma_direction_rad * rng.normal(size=directions)
        self.roll, self.shift = scene.sigma_roll_rad * rng.normal(), scene.sigma_laser_place_m * rng.normal(size=2)
        self.target_scales = 1 + scene.sigma_target_scale * rng.normal(size=2)

    def send(self, real: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return spots without noise (n, 2), points (n, 3) and slopes (n,) of beams as they really leave (n, 3)."""
        local = real @ self.turned
        points, slope_x, slope_y = self.mirror.intersect(-self.place_m @ self.turned, local)
        back = reflect(local, slope_x, slope_y) @ self.turned.T
        there = points @ self.turned.T + self.place_m
        spots = there - (there[:, 2:] / back[:, 2:]) * back
        turn = np.array([[np.cos(self.roll), np.sin(self.roll)], [-np.sin(self.roll), np.cos(self.roll)]])
        seen = (spots[:, :2] @ turn + self.shift) * self.target_scales
        seen[~self.mirror.contains(points[:, 0], points[:, 1])] = np.nan
        return seen, points, slope_x, slope_y


def trace_scan(scene: LaserScene, seed: int) -> TracedScan:
    """Scan a panel beam by beam."""
    x, y = (
        angle.ravel()
        for angle in np.meshgrid(scene.angles(scene.columns, scene.width_m), scene.angles(scene.rows, scene.length_m))
    )
    instrument = _Instrument(scene, np.random.default_rng(seed), (2, x.size))
    scales, noise = instrument.angle_scales, instrument.noise
    real = _beams(scales[0] * x + noise[0], scales[1] * y + noise[1])
    spots, points, slope_x, slope_y = instrument.send(real)
    spots += scene.sigma_spot_m * instrument.rng.normal(size=spots.shape)
    return TracedScan(_beams(x, y), spots, points, slope_x, slope_y, instrument.place_m)


def trace_lines(scene: LaserScene, seed: int) -> tuple[TracedSweep, TracedSweep]:
    """Sweep a line over a panel, first across (lines along y), then along (lines along x)."""
    counts, sizes = (scene.columns, scene.rows), (scene.width_m, scene.length_m)
    instrument = _Instrument(scene, np.random.default_rng(seed), (sum(counts),))
    noise_of = np.split(instrument.noise, [scene.columns])
    sweeps = []
    for axis, count in enumerate(counts):
        angle, fan = scene.angles(count, sizes[axis]), scene.angles(_POINTS_OF_LINE, sizes[1 - axis])
        real = instrument.angle_scales[axis] * angle + noise_of[axis]
        swept, within = (one.ravel() for one in np.meshgrid(real, fan, indexing="ij"))
        seen = instrument.send(_beams(swept, within) if axis == 0 else _beams(within, swept))[0].reshape(count, -1, 2)
        # A camera finds the middle of a line across it.
        along = np.asarray(np.gradient(seen, axis=1))
        across = np.stack([-along[..., 1], along[..., 0]], axis=-1) / np.linalg.norm(along, axis=-1, keepdims=True)
        seen += scene.sigma_spot_m * instrument.rng.normal(size=seen.shape[:2])[..., None] * across
        normals = np.eye(3)[axis] * np.cos(angle)[:, None] + np.eye(3)[2] * np.sin(angle)[:, None]
        sweeps.append(TracedSweep(normals, seen))
    return sweeps[0], sweeps[1]


def _beams(x_rad: FloatArray, y_rad: FloatArray) -> FloatArray:
    """Return unit directions of beams turned so far to the right and up, shape (n, 3)."""
    directions = np.stack([np.tan(x_rad), np.tan(y_rad), -np.ones_like(x_rad)], axis=1)
    return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))
