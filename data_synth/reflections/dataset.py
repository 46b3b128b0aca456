"""A measurement folder of an overlay: photos, points, measurement.toml and the truth."""

from pathlib import Path

import numpy as np

from data_synth.fringes.dataset import SYNTHETIC, TRUTH_FILE
from data_synth.reflections.scene import ReflectionScene, draw_photo, project
from heliogauge.geometry.rigid import rotation_from_vector, vector_from_rotation
from heliogauge.images.photos import write_image
from heliogauge.measurement.writer import write_measurement
from heliogauge.results.json_file import write_json
from heliogauge.results.tables import write_table_csv
from heliogauge.results.whole_folder import WholeFolder


def write_overlay(folder: Path, scene: ReflectionScene | None = None, seed: int = 0, *, force: bool = False) -> None:
    """Draw the photos and write the measurement folder, with truth.json.

    force: Replace an earlier synthetic measurement.
    InputError: The folder holds something or cannot be written to.
    """
    scene = scene or ReflectionScene()
    rng = np.random.default_rng(seed)
    half = 0.5 * scene.side_m
    corners = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    solid = np.column_stack([corners, np.sum(corners**2, axis=1) / (4 * scene.focal_length_m)])
    facets = [
        {
            "name": name,
            "outline_m": corners.tolist(),
            "position_m": [float(x), float(y), 0.0],
            "rotation_vector_rad": vector_from_rotation(rotation).tolist(),
            "design": "paraboloid",
            "focal_length_m": scene.focal_length_m,
        }
        for name, (x, y), rotation in zip(scene.names, scene.middles_m, scene.rotations(), strict=True)
    ]
    turned = [
        rotation @ rotation_from_vector(np.array([tilt[1], -tilt[0], 0.0]))
        for rotation, tilt in zip(scene.rotations(), scene.tilts_rad(seed), strict=True)
    ]
    # Known are the corners as designed; the photos show those of the turned facets.
    designed, points = (
        np.concatenate([solid @ one.T + [x, y, 0.0] for (x, y), one in zip(scene.middles_m, rotations, strict=True)])
        for rotations in (scene.rotations(), turned)
    )
    cameras = np.array(scene.cameras_m)
    source = np.array([0.0, 0.0, scene.distance_m])
    # The survey errs: what measurement.toml states differs from where cameras and source stood.
    stood = cameras + rng.normal(0, scene.sigma_place_m, cameras.shape)
    source_stood = source + rng.normal(0, scene.sigma_place_m, 3)
    sigma_mm = 1e3 * scene.sigma_place_m
    photos = [f"photo_{k + 1}.png" for k in range(len(scene.cameras_m))]
    content = {
        "kind": "overlay",
        "name": "heliostat",
        "notes": "Synthetic: drawn by heliogauge deflectometry synth --preset overlay.",
        "camera": {
            "width_px": scene.width_px,
            "height_px": scene.height_px,
            "focal_x_px": scene.focal_px,
            "focal_y_px": scene.focal_px,
            "center_x_px": 0.5 * (scene.width_px - 1),
            "center_y_px": 0.5 * (scene.height_px - 1),
        },
        "source": {
            "shape": "rectangle",
            "width_m": 2 * scene.half_m,
            "height_m": 2 * scene.half_m,
            "center_m": source.tolist(),
            "sigma_center_mm": sigma_mm,
        },
        "points": {"file": "points.csv", "sigma_px": scene.sigma_point_px},
        "photo": [
            {"file": name, "place_m": place.tolist(), "sigma_place_mm": sigma_mm}
            for name, place in zip(photos, cameras, strict=True)
        ],
        "mirror": {"mounts_m": (0.8 * corners).tolist(), "facet": facets},
    }
    with WholeFolder(folder, SYNTHETIC, force=force) as working:
        rows: dict[str, list[object]] = {name: [] for name in ("photo", "x_m", "y_m", "z_m", "x_px", "y_px")}
        for name, camera in zip(photos, stood, strict=True):
            image = draw_photo(scene, camera, source_stood, seed, rng)
            write_image(working / name, image.astype(np.uint8))
            seen = project(scene, camera, points)
            seen = seen + rng.normal(0, scene.sigma_point_px, seen.shape)
            for point, pixel in zip(designed.tolist(), seen.tolist(), strict=True):
                for key, value in zip(rows, (name, *point, *pixel), strict=True):
                    rows[key].append(value)
        write_table_csv(working / "points.csv", rows)
        write_measurement(working, content, comment=f"Synthetic measurement, seed {seed}; see truth.json.")
        truth = {"seed": seed, "facets": scene.names, "turn_rad": scene.true_turns_rad(seed).tolist()}
        write_json(working / TRUTH_FILE, truth)
