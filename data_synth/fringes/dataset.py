"""Measurement folders with known truth: images, measurement.toml, truth.json, truth.npz."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from data_synth.fringes.knowledge import Knowledge, measurement_content, response_table, screen_table
from data_synth.fringes.scene import FringeScene, SyntheticFringes, render_fringes
from data_synth.fringes.truth import PIXEL_ARRAYS, FringeTruth, PixelTruth, facet_from_json
from heliogauge.errors import InputError
from heliogauge.files.arrays import read_arrays
from heliogauge.images.photos import write_image
from heliogauge.measurement.writer import write_measurement
from heliogauge.results.json_file import read_json, write_json
from heliogauge.results.tables import write_table_csv
from heliogauge.results.whole_folder import FolderKind, WholeFolder
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.short_repr import ShortRepr

TRUTH_FILE = "truth.json"
TRUTH_ARRAYS_FILE = "truth.npz"
SYNTHETIC = FolderKind(content="synthetic measurements", mark=TRUTH_FILE)


@dataclass(frozen=True, slots=True, eq=False)
class DatasetOptions(ShortRepr):
    """How a scene becomes a folder.

    seed: Seed of all noise; the same seed gives the same files.
    knowledge: What measurement.toml states, and how well.
    stated: Sections of measurement.toml that are stated so, whatever the scene is.
    force: Replace an earlier synthetic measurement.
    """

    seed: int = 0
    knowledge: Knowledge = field(default_factory=Knowledge)
    stated: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    force: bool = False


def write_dataset(
    folder: Path, scene: FringeScene, options: DatasetOptions | None = None, progress: Progress | None = None
) -> SyntheticFringes:
    """Render a scene and write it as a measurement folder that is whole or not there.

    folder: Where to write; must be absent or empty.
    options: Seed, what the measurement file states, whether an earlier synthetic measurement may be replaced.
    InputError: The folder holds something, cannot be written to, or the scene cannot be drawn.
    """
    chosen = DatasetOptions() if options is None else options
    progress = SilentProgress() if progress is None else progress
    image_rng, knowledge_rng = np.random.default_rng(chosen.seed).spawn(2)
    with WholeFolder(folder, SYNTHETIC, force=chosen.force) as working:
        with progress.stage("render fringes"):
            fringes = render_fringes(scene, image_rng)
        names = {f"fringe_{index:02d}.png": frame for index, frame in enumerate(fringes.frames)}
        with progress.stage("write images", len(names) + 2) as stage:
            for name, image in {**names, "dark.png": fringes.dark, "bright.png": fringes.bright}.items():
                write_image(working / name, image)
                stage.advance()
        with progress.stage("write truth"):
            content = measurement_content(scene, list(names), chosen.knowledge, knowledge_rng) | dict(chosen.stated)
            if "file" in content["screen"]:
                write_table_csv(working / "screen_points.csv", dict(screen_table(scene.bench.wall)))
            if chosen.knowledge.response:
                write_table_csv(working / "response.csv", response_table(scene))
            write_measurement(working, content, comment=f"Synthetic measurement, seed {chosen.seed}; see truth.json.")
            write_json(working / TRUTH_FILE, {**fringes.truth.parameters, "seed": chosen.seed})
            _write_pixels(working / TRUTH_ARRAYS_FILE, fringes.truth.pixels)
    return fringes


def read_truth(folder: Path) -> FringeTruth:
    """Read the truth of a synthetic measurement.

    Returns: Facets with their exact surfaces, pixel arrays, parameters.
    """
    parameters = read_json(folder / TRUTH_FILE)
    arrays = folder / TRUTH_ARRAYS_FILE
    pixels = PixelTruth(*read_arrays(arrays, ("facet_index", *PIXEL_ARRAYS)).values())
    try:
        facets = tuple(facet_from_json(facet) for facet in parameters["facets"])
    except (KeyError, TypeError) as error:
        raise InputError(
            f"{folder}: the truth lacks {error}; write it again with `heliogauge deflectometry synth`"
        ) from error
    return FringeTruth(facets, pixels, parameters)


def _write_pixels(path: Path, pixels: PixelTruth) -> None:
    arrays: Mapping[str, Any] = {name: getattr(pixels, name) for name in ("facet_index", *PIXEL_ARRAYS)}
    np.savez_compressed(path, **arrays)
