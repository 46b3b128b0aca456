"""A measurement folder with photos of a screen and its truth: photos, measurement.toml, targets.csv, truth.json."""

from pathlib import Path
from typing import Any

import numpy as np

from data_synth.fringes.dataset import SYNTHETIC, TRUTH_FILE
from data_synth.screens.photo import take_photo
from data_synth.screens.scene import BENCH, BENCH_PHOTO, DICTIONARY, SURVEY, ScreenChoice, ScreenScene, screen_scene
from heliogauge.images.photos import write_image
from heliogauge.measurement.writer import write_measurement
from heliogauge.results.json_file import write_json
from heliogauge.results.tables import write_table_csv
from heliogauge.results.whole_folder import WholeFolder
from heliogauge.running.progress import Progress, SilentProgress


def write_screen_dataset(
    folder: Path, choice: ScreenChoice, *, force: bool = False, progress: Progress | None = None
) -> ScreenScene:
    """Draw the photos and write them as a measurement folder that is whole or not there.

    Returns: What was drawn.
    InputError: The folder holds something, or cannot be written to.
    """
    drawn, progress = screen_scene(choice), progress or SilentProgress()
    scene = drawn.scene
    with WholeFolder(folder, SYNTHETIC, force=force) as working:
        with progress.stage("take photos", len(scene.views)) as stage:
            rngs = np.random.default_rng(choice.seed).spawn(len(scene.views))
            for view, rng in zip(scene.views, rngs, strict=True):
                photo = take_photo(scene, view, drawn.dots_m, drawn.radii_m, drawn.shape, rng)
                write_image(working / f"{view.name}.png", photo)
                stage.advance()
        comment = f"Synthetic measurement, seed {choice.seed}; see {TRUTH_FILE}."
        write_measurement(working, _content(drawn, choice), comment=comment)
        if choice.show == "rims":
            names = list(drawn.markers)
            fractions = np.array([drawn.markers[one] for one in names]).T
            write_table_csv(working / "targets.csv", {"target": names, "u": fractions[0], "v": fractions[1]})
        bench = scene.views[-1].cam_from_world
        truth = {
            "seed": choice.seed,
            "size_m": drawn.size_m,
            "screen_from_print": "z = a x^2 + b x y + c y^2 + d x^3 + e y^3",
            "bending_per_m": drawn.shape.bending_per_m.tolist(),
            "ripple_per_m2": drawn.shape.ripple_per_m2.tolist(),
            "measuring_camera": {
                "rotation_vector_rad": bench.rotation_vector_rad.tolist(),
                "translation_m": bench.translation_m.tolist(),
            },
        }
        write_json(working / TRUTH_FILE, truth)
    return drawn


def _content(drawn: ScreenScene, choice: ScreenChoice) -> dict[str, Any]:
    """Return what measurement.toml says without its images."""
    content: dict[str, Any] = {
        "kind": "screen-geometry",
        "name": "screen",
        "camera": [
            {"name": "survey", "width_px": SURVEY.width_px, "height_px": SURVEY.height_px},
            {
                "name": "measuring",
                "photos": [f"{BENCH_PHOTO}.png"],
                "width_px": BENCH.width_px,
                "height_px": BENCH.height_px,
                "focal_px": BENCH.focal_y_px,
                "center_x_px": BENCH.center_x_px,
                "center_y_px": BENCH.center_y_px,
            },
        ],
        "images": {"photos": "photo_*.png"},
        "measuring_photo": f"{BENCH_PHOTO}.png",
        "targets": {"dictionary": DICTIONARY},
        "scale_bar": [
            {"a": one.a, "b": one.b, "length_m": round(one.stated_m, 7), "sigma_mm": 1e3 * one.sigma_m}
            for one in drawn.scene.lengths
        ],
    }
    if choice.show == "dots":
        content["dots"] = {"dots": "dark", "origin": "corner"}
    else:
        content["display"] = {"file": "targets.csv"}
    return content
