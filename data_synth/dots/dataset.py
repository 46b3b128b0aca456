"""A measurement folder with one photo of dots and its truth: photo, dots.csv, measurement.toml, truth.json."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from data_synth.dots.photo import DotScene, DotTruth, ToldBy, photo_light, place_dots
from data_synth.fringes.dataset import SYNTHETIC, TRUTH_FILE, DatasetOptions
from data_synth.fringes.knowledge import measurement_content
from data_synth.fringes.scene import scene_to_json
from data_synth.optics.sensor import UnsignedArray
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.images.photos import write_image
from heliogauge.measurement.writer import write_measurement
from heliogauge.results.json_file import write_json
from heliogauge.results.tables import write_table_csv
from heliogauge.results.whole_folder import WholeFolder
from heliogauge.validate import FloatArray

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
        _write_dots(working, dots, truth)
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


def write_dot_series(
    folder: Path, dots: DotScene, turns_rad: FloatArray, rate_hz: float, options: DatasetOptions | None = None
) -> None:
    """Draw a photo for each turn of the mirror and write them as a measurement folder that is whole or not there.

    turns_rad (n, 2): Turns about the mirror's own x and y axes, through its origin [rad].
    rate_hz: Photos in a second [1/s].
    InputError: The folder holds something, or cannot be written to.
    """
    chosen = options or DatasetOptions()
    place_rng, image_rng, knowledge_rng = np.random.default_rng(chosen.seed).spawn(3)
    with WholeFolder(folder, SYNTHETIC, force=chosen.force) as working:
        truth = place_dots(dots, place_rng)
        names = [f"frame_{number:04d}.png" for number in range(len(turns_rad))]
        bench = dots.scene.bench
        for name, turn in zip(names, turns_rad.tolist(), strict=True):
            turned = bench.cam_from_mirror @ RigidTransform.from_rotation_vector([*turn, 0.0], [0.0, 0.0, 0.0])
            one = replace(dots, scene=replace(dots.scene, bench=replace(bench, cam_from_mirror=turned)))
            write_image(working / name, one.scene.sensor.expose(photo_light(one, truth), image_rng))
        _write_dots(working, dots, truth)
        content = _content(dots, chosen, knowledge_rng)
        del content["photo"]
        content |= {"kind": "deflectometry-dots-series"}
        content["frames"] = {"photos": "frame_*.png", "frame_rate_hz": rate_hz}
        write_measurement(working, content, comment=f"Synthetic measurement, seed {chosen.seed}; see truth.json.")
        moved = {"frame": names, "turns_rad": turns_rad.tolist(), "rate_hz": rate_hz}
        write_json(working / TRUTH_FILE, {**scene_to_json(dots.scene), "series": moved, "seed": chosen.seed})


def wind_turns(count: int, rate_hz: float, size_rad: float = 8e-4) -> FloatArray:
    """Return how a mirror sways in wind: two sines, shape (count, 2) [rad]."""
    time_s = np.arange(count) / rate_hz
    return size_rad * np.stack([np.sin(2.0 * np.pi * 0.9 * time_s), 0.6 * np.sin(2.0 * np.pi * 1.4 * time_s)], axis=1)


def _write_dots(folder: Path, dots: DotScene, truth: DotTruth) -> None:
    x, y, z = truth.places_m.T
    numbers = {"column": truth.column.astype(np.intp), "row": truth.row.astype(np.intp)}
    sizes = {"radius_m": truth.radius_m} if dots.told_by == "marked" else {}
    write_table_csv(folder / "dots.csv", {**numbers, "x_m": x, "y_m": y, "z_m": z, **sizes})


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
