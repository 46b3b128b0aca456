"""A trough panel scanned by a laser from twice its focal length: scan.csv, measurement.toml and the truth."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from data_synth.fringes.dataset import SYNTHETIC, TRUTH_FILE
from data_synth.fringes.presets import rectangle, standard_errors
from data_synth.optics.mirror import Design, SyntheticFacet, reflect
from heliogauge.geometry.rigid import rotation_from_vector
from heliogauge.measurement.writer import write_measurement
from heliogauge.results.json_file import write_json
from heliogauge.results.tables import write_table_csv
from heliogauge.results.whole_folder import WholeFolder
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray

TRUTH_TABLE = "truth.csv"


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


def write_laser_scan(
    folder: Path,
    scene: LaserScene | None = None,
    seed: int = 0,
    stated: Mapping[str, Any] | None = None,
    *,
    force: bool = False,
) -> None:
    """Scan a panel and write the measurement folder, with truth.json and truth.csv (slopes where beams met it).

    stated: Keys of [scan] that are stated so, whatever the scene is.
    force: Replace an earlier synthetic measurement.
    InputError: The folder holds something or cannot be written to.
    """
    scene, rng = scene or LaserScene(), np.random.default_rng(seed)
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
    scanned = {
        "file": "scan.csv",
        "sigma_spot_mm": 1e3 * scene.sigma_spot_m,
        "sigma_direction_mrad": 1e3 * scene.sigma_direction_rad,
        "sigma_laser_place_mm": 1e3 * scene.sigma_laser_place_m,
        "sigma_target_scale_permille": 1e3 * scene.sigma_target_scale,
        "sigma_angle_scale_permille": 1e3 * scene.sigma_angle_scale,
        "sigma_roll_mrad": 1e3 * scene.sigma_roll_rad,
    } | dict(stated or {})
    content = {
        "kind": "laser-scan",
        "name": "trough panel",
        "notes": "Synthetic: drawn by heliogauge deflectometry synth --preset laser-scan.",
        "scan": scanned,
        "mirror": {
            "design": "trough",
            "focal_length_m": scene.focal_length_m,
            "distance_m": distance_m,
            "sigma_distance_mm": 1e3 * scene.sigma_distance_m,
            "sigma_offset_mm": 1e3 * scene.sigma_offset_m,
        },
    }
    with WholeFolder(folder, SYNTHETIC, force=force) as working:
        columns = dict(zip(("direction_x", "direction_y", "direction_z"), wished.T, strict=True))
        write_table_csv(working / "scan.csv", columns | {"spot_x_m": seen[:, 0], "spot_y_m": seen[:, 1]})
        write_measurement(working, content, comment=f"Synthetic measurement, seed {seed}; see truth.json.")
        truth = {"x_m": points[:, 0], "y_m": points[:, 1], "slope_x": slope_x, "slope_y": slope_y}
        write_table_csv(working / TRUTH_TABLE, truth)
        write_json(working / TRUTH_FILE, {"seed": seed, "place_m": place.tolist(), "turn_rad": list(scene.turn_rad)})


def _beams(x_rad: FloatArray, y_rad: FloatArray) -> FloatArray:
    """Return unit directions of beams turned so far to the right and up, shape (n, 3)."""
    directions = np.stack([np.tan(x_rad), np.tan(y_rad), -np.ones_like(x_rad)], axis=1)
    return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))
