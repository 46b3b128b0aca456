"""Beams of a laser over a trough panel with known slope errors, and where they come back."""

from dataclasses import dataclass

import numpy as np

from data_synth.fringes.presets import rectangle, standard_errors
from data_synth.optics.mirror import Design, SyntheticFacet, reflect
from heliogauge.geometry.rigid import rotation_from_vector
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray


@dataclass(frozen=True, slots=True)
class LaserScene(ShortRepr):
    """A panel, the scan, and how well each number of the instrument is known.

    focal_length_m, width_m, length_m: Of the trough's panel, which is centred on the vertex; curved along x.
    columns, rows: Beams across and along.
    turn_rad: How far the panel is turned about x, y, z, which nobody measures [rad].
    sigma_spot_m, sigma_direction_rad: Noise of each spot and beam.
    others: Standard deviations with which measurement.toml states the rest; the true values differ by as much.
    """

    focal_length_m: float = 1.71
    width_m: float = 2.7
    length_m: float = 1.7
    columns: int = 61
    rows: int = 41
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


def trace_scan(scene: LaserScene, seed: int) -> TracedScan:
    """Scan a panel, with one draw of everything that is not exactly known."""
    rng = np.random.default_rng(seed)
    mirror, distance_m = scene.mirror, 2 * scene.focal_length_m
    # As it really stands; measurement.toml says (0, 0, distance).
    place = np.array([0.0, 0.0, -distance_m]) + rng.normal(size=3) * (
        scene.sigma_offset_m,
        scene.sigma_offset_m,
        scene.sigma_distance_m,
    )
    turned = rotation_from_vector(scene.turn_rad)
    x, y = (
        angle.ravel()
        for angle in np.meshgrid(
            np.arctan(np.linspace(-0.5, 0.5, scene.columns) * 1.1 * scene.width_m / distance_m),
            np.arctan(np.linspace(-0.5, 0.5, scene.rows) * 1.1 * scene.length_m / distance_m),
        )
    )
    wished = _beams(x, y)
    scales = 1 + scene.sigma_angle_scale * rng.normal(size=2)
    noise = scene.sigma_direction_rad * rng.normal(size=(2, x.size))
    real = _beams(scales[0] * x + noise[0], scales[1] * y + noise[1])
    local = real @ turned
    points, slope_x, slope_y = mirror.intersect(-place @ turned, local)
    back = reflect(local, slope_x, slope_y) @ turned.T
    there = points @ turned.T + place
    spots = there - (there[:, 2:] / back[:, 2:]) * back
    roll, shift = scene.sigma_roll_rad * rng.normal(), scene.sigma_laser_place_m * rng.normal(size=2)
    seen = spots[:, :2] @ np.array([[np.cos(roll), np.sin(roll)], [-np.sin(roll), np.cos(roll)]])
    seen = (seen + shift) * (1 + scene.sigma_target_scale * rng.normal(size=2))
    seen += scene.sigma_spot_m * rng.normal(size=seen.shape)
    seen[~mirror.contains(points[:, 0], points[:, 1])] = np.nan
    return TracedScan(wished, seen, points, slope_x, slope_y, place)


def _beams(x_rad: FloatArray, y_rad: FloatArray) -> FloatArray:
    """Return unit directions of beams turned so far to the right and up, shape (n, 3)."""
    directions = np.stack([np.tan(x_rad), np.tan(y_rad), -np.ones_like(x_rad)], axis=1)
    return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))
