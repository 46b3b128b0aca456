"""Measurement folders with known truth, also of several poses: images, measurement.toml, truth.json, truth.npz."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from data_synth.fringes.gray_code import render_gray_code
from data_synth.fringes.knowledge import (
    Knowledge,
    camera_section,
    measurement_content,
    response_table,
    screen_section,
    screen_table,
)
from data_synth.fringes.poses import MOST_POSES, posed_scene, with_sag
from data_synth.fringes.scene import FringeScene, SyntheticFringes, render_fringes, scene_to_json, trace_truth
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


def write_gray_code(
    folder: Path, scene: FringeScene, width_px: int, height_px: int, options: DatasetOptions | None = None
) -> None:
    """Draw a scene with a Gray code on its screen, and write it as a measurement folder that is whole or not there.

    options: Seed, what the measurement file states, whether an earlier synthetic measurement may be replaced.
    InputError: The folder holds something, cannot be written to, or the mirror is not in view.
    """
    chosen = DatasetOptions() if options is None else options
    image_rng, knowledge_rng = np.random.default_rng(chosen.seed).spawn(2)
    frames, dark, bright = render_gray_code(scene, width_px, height_px, image_rng)
    names = [f"gray_{index:02d}.png" for index in range(len(frames))]
    truth = trace_truth(scene)
    with WholeFolder(folder, SYNTHETIC, force=chosen.force) as working:
        for name, image in {**dict(zip(names, frames, strict=True)), "dark.png": dark, "bright.png": bright}.items():
            write_image(working / name, image)
        content = measurement_content(scene, names, chosen.knowledge, knowledge_rng) | dict(chosen.stated)
        content["pattern"] = {"gray_code": {"width_px": width_px, "height_px": height_px}}
        write_measurement(working, content, comment=f"Synthetic measurement, seed {chosen.seed}; see truth.json.")
        write_json(working / TRUTH_FILE, {**truth.parameters, "seed": chosen.seed})
        _write_pixels(working / TRUTH_ARRAYS_FILE, truth.pixels)


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


#: Sigmas of camera and screen as a tape, a level and a calibration leave them; of the camera in focal lengths.
_SIGMA_CAMERA = 5e-4
_SIGMA_SAG_MM = 5.0
STANDARD_KNOWLEDGE = Knowledge(
    sigma_distance_mm=2.0,
    sigma_screen_rotation_mrad=1.0,
    sigma_screen_translation_mm=3.0,
    sigma_width_mm=20.0,
    sigma_height_mm=10.0,
)


@dataclass(frozen=True, slots=True)
class PoseOptions(ShortRepr):
    """How a scene becomes a measurement in several poses.

    poses: Number of poses.
    seed: Seed of all errors and noise.
    width_error: Share by which the stated width of the screen is off, beyond what its sigma says.
    force: Replace an earlier synthetic measurement.
    InputError: A number of poses that is not drawn, or a width that is no error.
    """

    poses: int
    seed: int = 0
    width_error: float = 0.0
    force: bool = False

    def __post_init__(self) -> None:
        if not 2 <= self.poses <= MOST_POSES:
            raise InputError(f"poses: 2 to {MOST_POSES} are drawn, not {self.poses}")
        if not abs(self.width_error) < 0.5:
            raise InputError(f"width error: less than 50 % is needed, not {100 * self.width_error:g} %")


def write_poses(folder: Path, scene: FringeScene, options: PoseOptions, progress: Progress | None = None) -> None:
    """Draw a mirror in several poses and write a folder of measurement folders.

    scene: The first pose; its screen must be flat, for its sag is one of the errors that are drawn.
    InputError: The folder holds something, the screen is not flat, or a pose does not see the screen.

    measurement.toml states camera and screen as they are in the scene, with errors of the stated sigmas that are the
    same in all poses; the screen that is drawn has a sag of which the file knows nothing but its sigma.
    """
    if not scene.bench.wall.is_plain:
        raise InputError(f"{scene.name}: its screen is curved; several poses are drawn before a flat one")
    common_rng, *rngs = np.random.default_rng(options.seed).spawn(1 + options.poses)
    sigma_px = _SIGMA_CAMERA * scene.bench.camera.focal_x_px
    knowledge = replace(STANDARD_KNOWLEDGE, sigma_focal_px=sigma_px, sigma_center_px=sigma_px)
    stated = {
        "camera": camera_section(scene, knowledge, common_rng),
        "screen": _stated_screen(scene, knowledge, common_rng, options.width_error),
    }
    scene = with_sag(scene, 1e-3 * _SIGMA_SAG_MM * common_rng.standard_normal(2))
    names = [f"pose_{number}" for number in range(1, options.poses + 1)]
    with WholeFolder(folder, SYNTHETIC, force=options.force) as working:
        for number, (name, rng) in enumerate(zip(names, rngs, strict=True)):
            seed = int(rng.integers(2**31))
            known = replace(knowledge, roll_deg=90.0 * (number % 4))
            write_dataset(working / name, posed_scene(scene, number), DatasetOptions(seed, known, stated), progress)
        content = {
            "kind": "deflectometry-poses",
            "name": scene.name,
            "notes": "Synthetic: drawn by heliogauge deflectometry synth.",
            "pose": [{"folder": name} for name in names],
        }
        write_measurement(working, content, comment=f"Synthetic measurement, seed {options.seed}; see truth.json.")
        write_json(working / TRUTH_FILE, {**scene_to_json(scene), "seed": options.seed, "poses": names})


def _stated_screen(
    scene: FringeScene, knowledge: Knowledge, rng: np.random.Generator, width_error: float
) -> dict[str, Any]:
    section = screen_section(scene, knowledge, rng)
    return {**section, "width_m": section["width_m"] * (1 + width_error), "sigma_sag_mm": _SIGMA_SAG_MM}
