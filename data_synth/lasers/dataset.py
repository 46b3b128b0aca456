"""A trough panel scanned by a laser, and a facet whose surface is: tables, measurement.toml and the truth."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from data_synth.fringes.dataset import SYNTHETIC, TRUTH_FILE
from data_synth.lasers.points import PointScene, scan_points
from data_synth.lasers.scan import LaserScene, trace_scan
from heliogauge.measurement.writer import write_measurement
from heliogauge.results.json_file import write_json
from heliogauge.results.tables import write_table_csv
from heliogauge.results.whole_folder import WholeFolder

TRUTH_TABLE = "truth.csv"


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
    scene = scene or LaserScene()
    traced = trace_scan(scene, seed)
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
            "distance_m": 2 * scene.focal_length_m,
            "sigma_distance_mm": 1e3 * scene.sigma_distance_m,
            "sigma_offset_mm": 1e3 * scene.sigma_offset_m,
        },
    }
    with WholeFolder(folder, SYNTHETIC, force=force) as working:
        columns = dict(zip(("direction_x", "direction_y", "direction_z"), traced.beams.T, strict=True))
        write_table_csv(
            working / "scan.csv", columns | {"spot_x_m": traced.spots_m[:, 0], "spot_y_m": traced.spots_m[:, 1]}
        )
        write_measurement(working, content, comment=f"Synthetic measurement, seed {seed}; see truth.json.")
        truth = dict(zip(("x_m", "y_m"), traced.points_m.T, strict=False))
        truth |= {"slope_x": traced.slope_x, "slope_y": traced.slope_y}
        write_table_csv(working / TRUTH_TABLE, truth)
        write_json(
            working / TRUTH_FILE, {"seed": seed, "place_m": traced.place_m.tolist(), "turn_rad": list(scene.turn_rad)}
        )


def write_surface_scan(folder: Path, scene: PointScene | None = None, seed: int = 0, *, force: bool = False) -> None:
    """Scan a facet and write the measurement folder, with truth.json.

    force: Replace an earlier synthetic measurement.
    InputError: The folder holds something or cannot be written to.
    """
    scene = scene or PointScene()
    points = scan_points(scene, seed)
    content = {
        "kind": "surface-scan",
        "name": "facet",
        "notes": "Synthetic: drawn by heliogauge deflectometry synth --preset surface-scan.",
        "points": {"file": "points.csv", "sigma_point_mm": 1e3 * scene.sigma_point_m},
        "mirror": {"design": scene.design} | dict(scene.design_numbers),
    }
    place = scene.scanner_from_mirror
    with WholeFolder(folder, SYNTHETIC, force=force) as working:
        write_table_csv(working / "points.csv", dict(zip(("x_m", "y_m", "z_m"), points.T, strict=True)))
        write_measurement(working, content, comment=f"Synthetic measurement, seed {seed}; see truth.json.")
        write_json(
            working / TRUTH_FILE,
            {
                "seed": seed,
                "scanner_from_mirror_rotation": place.rotation.tolist(),
                "scanner_from_mirror_translation_m": place.translation_m.tolist(),
            },
        )
