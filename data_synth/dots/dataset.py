"""A measurement folder with one photo of dots and its truth: photo, dots.csv, measurement.toml, truth.json."""

from pathlib import Path
from typing import Any

import numpy as np

from data_synth.dots.photo import DotScene, ToldBy, photo_light, place_dots
from data_synth.fringes.dataset import SYNTHETIC, TRUTH_FILE, DatasetOptions
from data_synth.fringes.knowledge import measurement_content
from data_synth.fringes.scene import scene_to_json
from data_synth.optics.sensor import UnsignedArray
from heliogauge.images.photos import write_image
from heliogauge.measurement.writer import write_measurement
from heliogauge.results.json_file import write_json
from heliogauge.results.tables import write_table_csv
from heliogauge.results.whole_folder import WholeFolder

#: What measurement.toml says of the pattern.
_PATTERNS: dict[ToldBy, dict[str, str]] = {
    "light": {"dots": "dark", "origin": "light"},
    "marked": {"dots": "dark", "origin": "unmarked", "marks_file": "dots.csv"},
    "unmarked": {"dots": "dark", "origin": "unmarked"},
}


def write_dot_dataset(folder: Path, dots: DotScene, options: DatasetOptions | None = None) -> UnsignedArray:
    """Draw a photo of dots and write it as a measurement folder that is whole or not there.

    Returns (h, w): The photo [DN].
    InputError: The folder holds something, or cannot be written to.
    """
    chosen = options or DatasetOptions()
    place_rng, image_rng, knowledge_rng = np.random.default_rng(chosen.seed).spawn(3)
    with WholeFolder(folder, SYNTHETIC, force=chosen.force) as working:
        truth = place_dots(dots, place_rng)
        photo = dots.scene.sensor.expose(photo_light(dots, truth), image_rng)
        write_image(working / "photo.png", photo)
        x, y, z = truth.places_m.T
        numbers = {"column": truth.column.astype(np.intp), "row": truth.row.astype(np.intp)}
        sizes = {"radius_m": truth.radius_m} if dots.told_by == "marked" else {}
        write_table_csv(working / "dots.csv", {**numbers, "x_m": x, "y_m": y, "z_m": z, **sizes})
        content = _content(dots, chosen, knowledge_rng)
        write_measurement(working, content, comment=f"Synthetic measurement, seed {chosen.seed}; see truth.json.")
        shown = {
            "pitch_m": dots.pitch_m,
            "radius_m": dots.radius_m,
            "count": dots.count,
            "origin": dots.origin,
            "told_by": dots.told_by,
        }
        write_json(working / TRUTH_FILE, {**scene_to_json(dots.scene), "dots": shown, "seed": chosen.seed})
    return photo


def _content(dots: DotScene, options: DatasetOptions, rng: np.random.Generator) -> dict[str, Any]:
    """Return the tables of measurement.toml: those of fringes with dots in the place of pattern and images."""
    known = measurement_content(dots.scene, [], options.knowledge, rng)
    screen = {key: one for key, one in known["screen"].items() if key not in ("shape", "width_m", "height_m")}
    return {
        "kind": "deflectometry-dots",
        "name": known["name"],
        "notes": known["notes"],
        "photo": "photo.png",
        "camera": known["camera"],
        "screen": {"shape": "dots"} | {**screen, "file": "dots.csv", "response_file": None},
        "pattern": _PATTERNS[dots.told_by],
        "mirror": known["mirror"],
        "evaluation": known["evaluation"],
    } | dict(options.stated)
