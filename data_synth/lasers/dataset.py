"""A trough panel scanned by a laser, and a facet whose surface is: tables, measurement.toml and the truth."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from data_synth.fringes.dataset import SYNTHETIC, TRUTH_FILE
from data_synth.lasers.points import PointScene, scan_points
from data_synth.lasers.scan import LaserScene, trace_lines, trace_scan
from data_synth.optics.mirror import SyntheticFacet
from heliogauge.measurement.writer import write_measurement
from heliogauge.results.json_file import write_json
from heliogauge.results.tables import write_table_csv
from heliogauge.results.whole_folder import WholeFolder
from heliogauge.validate import FloatArray

TRUTH_TABLE = "truth.csv"
#: Nodes of the true slopes along each side of a facet.
_TRUE_NODES = 61
_LINE_COLUMNS = ("sweep", "line", "normal_x", "normal_y", "normal_z", "spot_x_m", "spot_y_m")


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
    content = _content(scene, "laser-scan", {"file": "scan.csv"}, stated)
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


def line_scene() -> LaserScene:
    """Return a panel swept by lines from 0.8 of its radius of curvature: at all of it lines would lie on each other."""
    return LaserScene(distance_of_curvature=0.8)


def write_line_sweep(folder: Path, scene: LaserScene | None = None, seed: int = 0, *, force: bool = False) -> None:
    """Sweep a line over a panel both ways and write the measurement folder, with truth.json and truth.csv (slopes).

    force: Replace an earlier synthetic measurement.
    InputError: The folder holds something or cannot be written to.
    """
    scene = scene or line_scene()
    table: dict[str, list[Any]] = {name: [] for name in _LINE_COLUMNS}
    for name, sweep in zip(("across", "along"), trace_lines(scene, seed), strict=True):
        for number, (normal, spots) in enumerate(zip(sweep.normals.tolist(), sweep.spots_m, strict=True), start=1):
            seen = spots[np.isfinite(spots[:, 0])].tolist()
            for column, values in zip(
                _LINE_COLUMNS, zip(*((name, number, *normal, *spot) for spot in seen), strict=True), strict=False
            ):
                table[column].extend(values)
    content = _content(scene, "line-sweep", {"lines_file": "lines.csv"})
    with WholeFolder(folder, SYNTHETIC, force=force) as working:
        write_table_csv(working / "lines.csv", table)
        write_measurement(working, content, comment=f"Synthetic measurement, seed {seed}; see truth.json.")
        write_table_csv(working / TRUTH_TABLE, _true_slopes(scene.mirror))
        write_json(working / TRUTH_FILE, {"seed": seed, "turn_rad": list(scene.turn_rad)})


def _true_slopes(facet: SyntheticFacet) -> dict[str, FloatArray]:
    """Return the slopes of a rectangular facet at nodes of its own frame."""
    low, high = facet.outline_m.min(axis=0), facet.outline_m.max(axis=0)
    x, y = (one.ravel() for one in np.meshgrid(*np.linspace(low, high, _TRUE_NODES).T))
    _, slope_x, slope_y = facet.surface(x, y)
    return {"x_m": x, "y_m": y, "slope_x": slope_x, "slope_y": slope_y}


def _content(
    scene: LaserScene, preset: str, files: Mapping[str, str], stated: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    scanned = {
        **files,
        "sigma_spot_mm": 1e3 * scene.sigma_spot_m,
        "sigma_direction_mrad": 1e3 * scene.sigma_direction_rad,
        "sigma_laser_place_mm": 1e3 * scene.sigma_laser_place_m,
        "sigma_target_scale_permille": 1e3 * scene.sigma_target_scale,
        "sigma_angle_scale_permille": 1e3 * scene.sigma_angle_scale,
        "sigma_roll_mrad": 1e3 * scene.sigma_roll_rad,
    } | dict(stated or {})
    return {
        "kind": "laser-scan",
        "name": "trough panel",
        "notes": f"Synthetic: drawn by heliogauge deflectometry synth --preset {preset}.",
        "scan": scanned,
        "mirror": {
            "design": "trough",
            "focal_length_m": scene.focal_length_m,
            "distance_m": scene.distance_m,
            "sigma_distance_mm": 1e3 * scene.sigma_distance_m,
            "sigma_offset_mm": 1e3 * scene.sigma_offset_m,
        },
    }


def write_surface_scan(folder: Path, scene: PointScene | None = None, seed: int = 0, *, force: bool = False) -> None:
    """Scan a facet and write the measurement folder, with truth.json and truth.csv (slopes in the mirror's frame).

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
        write_table_csv(working / TRUTH_TABLE, _true_slopes(scene.mirror))
        write_json(
            working / TRUTH_FILE,
            {
                "seed": seed,
                "scanner_from_mirror_rotation": place.rotation.tolist(),
                "scanner_from_mirror_translation_m": place.translation_m.tolist(),
            },
        )
