"""Measurement folders of targets and boards with known truth: photos or image points, measurement.toml, truth.json."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from data_synth.fringes.dataset import SYNTHETIC, TRUTH_FILE
from data_synth.fringes.truth import TRUTH_SCHEMA
from data_synth.optics.mirror import transform_to_json
from data_synth.optics.pinhole import PinholeCamera
from data_synth.optics.prints import DotPrint, RingPrint
from data_synth.optics.sensor import UnsignedArray
from data_synth.optics.sheets import Sheet
from data_synth.targets.scene import ImageTruth, TargetScene, image_truth, render_photo
from heliogauge.errors import InputError
from heliogauge.images.photos import write_image
from heliogauge.measurement.load import MEASUREMENT_FILE
from heliogauge.measurement.writer import dump_toml, write_text
from heliogauge.results.json_file import write_json
from heliogauge.results.tables import write_table_csv
from heliogauge.results.whole_folder import WholeFolder
from heliogauge.running.progress import Progress, SilentProgress

TRUE_POINTS_FILE = "image_points_true.csv"
IMAGE_POINTS_FILE = "image_points.csv"
#: Blue, green and red of white paper under a lamp, as shares of the light.
_WARM_LIGHT = (0.72, 0.9, 1.0)


@dataclass(frozen=True, slots=True)
class PhotoOptions:
    """How a scene becomes a folder.

    seed: Seed of all noise; the same seed gives the same files.
    points_sigma_px: Write image points with this noise instead of photos [px].
    jpeg_quality: Write JPEG files of this quality, 1 to 100, instead of PNG.
    force: Replace an earlier synthetic measurement.
    in_colour: JPEG in colour under warm light, with half the resolution of the colours, as cameras write them.
    InputError: A quality JPEG does not have.
    """

    seed: int = 0
    points_sigma_px: float | None = None
    jpeg_quality: int | None = None
    force: bool = False
    in_colour: bool = False

    def __post_init__(self) -> None:
        if self.jpeg_quality is not None and not 1 <= self.jpeg_quality <= 100:
            raise InputError(f"jpeg_quality: 1 to 100 is needed, not {self.jpeg_quality}")


def write_target_dataset(
    folder: Path,
    scene: TargetScene,
    content: Mapping[str, Any],
    options: PhotoOptions | None = None,
    progress: Progress | None = None,
) -> None:
    """Write a scene as a measurement folder that is whole or not there.

    folder: Where to write; must be absent or empty.
    content: What measurement.toml says beside the images: `photogrammetry_content` or `camera_content`.
    options: Seed, kind of files.
    InputError: The folder holds something, cannot be written to, or the scene cannot be drawn.
    """
    chosen = PhotoOptions() if options is None else options
    progress = SilentProgress() if progress is None else progress
    truths = [image_truth(scene, view) for view in scene.views]
    suffix = ".png" if chosen.jpeg_quality is None else ".jpg"
    names = [view.name + suffix for view in scene.views]
    with WholeFolder(folder, SYNTHETIC, force=chosen.force) as working:
        point_rng, *photo_rngs = np.random.default_rng(chosen.seed).spawn(1 + len(scene.views))
        if chosen.points_sigma_px is None:
            with progress.stage("take photos", len(names)) as stage:
                for name, view, rng in zip(names, scene.views, photo_rngs, strict=True):
                    _write_photo(working / name, render_photo(scene, view, rng), chosen)
                    stage.advance()
            images: dict[str, Any] = {"images": {"photos": "photo_*" + suffix}}
        else:
            table = _measured_points(truths, names, chosen.points_sigma_px, point_rng)
            write_table_csv(working / IMAGE_POINTS_FILE, table)
            images = {"image_points": {"file": IMAGE_POINTS_FILE, "pixel_origin": "center"}}
        write_table_csv(working / TRUE_POINTS_FILE, _true_points(truths, names))
        comment = f"Synthetic measurement, seed {chosen.seed}; see {TRUTH_FILE}."
        write_text(working / MEASUREMENT_FILE, f"# {comment}\n\n" + dump_toml({**content, **images}))
        write_json(working / TRUTH_FILE, {**scene_to_json(scene, names), "seed": chosen.seed})


def photogrammetry_content(scene: TargetScene) -> dict[str, Any]:
    """Return what measurement.toml says of a network of targets, without its images."""
    camera = scene.views[0].camera
    content: dict[str, Any] = {
        "kind": "photogrammetry",
        "name": scene.name,
        "camera": {"width_px": camera.width_px, "height_px": camera.height_px},
    }
    rings = [sheet for sheet in scene.sheets if isinstance(sheet.figure, RingPrint | DotPrint)]
    diameters = {sheet.figure.diameter_m for sheet in rings if isinstance(sheet.figure, RingPrint | DotPrint)}
    targets: dict[str, Any] = {"dictionary": scene.dictionary}
    if len(diameters) == 1:
        targets["diameter_mm"] = round(1e3 * diameters.pop(), 6)
    if rings:
        targets["polarity"] = "white-on-black" if rings[0].ink > rings[0].paper else "black-on-white"
    content["targets"] = targets
    content["scale_bar"] = [
        {"a": bar.a, "b": bar.b, "length_m": round(bar.stated_m, 7), "sigma_mm": 1e3 * bar.sigma_m}
        for bar in scene.lengths
    ]
    return content


def camera_content(scene: TargetScene, board: Mapping[str, object]) -> dict[str, Any]:
    """Return what measurement.toml says of the calibration of a camera, without its images.

    scene: Photos of a board.
    board: The board's own table.
    """
    camera = scene.views[0].camera
    size = {"width_px": camera.width_px, "height_px": camera.height_px}
    return {"kind": "camera", "name": scene.name, "camera": size, "board": dict(board)}


def scene_to_json(scene: TargetScene, photo_names: list[str]) -> dict[str, Any]:
    """Return a scene's truth as plain values.

    Returns: Camera, poses, points with their coordinates in the world, sheets, scale bars.
    """
    return {
        "schema": TRUTH_SCHEMA,
        "kind": "targets",
        "name": scene.name,
        "dictionary": scene.dictionary,
        "camera": _camera_to_json(scene.views[0].camera),
        "photos": {
            name: {"cam_from_world": transform_to_json(view.cam_from_world)}
            for name, view in zip(photo_names, scene.views, strict=True)
        },
        "points_m": {name: point.tolist() for name, point in scene.points_m().items()},
        "sheets": [_sheet_to_json(sheet) for sheet in scene.sheets],
        "scale_bars": [
            {"a": bar.a, "b": bar.b, "length_m": bar.length_m, "stated_m": bar.stated_m, "sigma_m": bar.sigma_m}
            for bar in scene.lengths
        ],
        "blur_sigma_px": scene.conditions.blur_sigma_px,
    }


def _camera_to_json(camera: PinholeCamera) -> dict[str, float]:
    return {name: getattr(camera, name) for name in PinholeCamera.__dataclass_fields__}


def _sheet_to_json(sheet: Sheet) -> dict[str, Any]:
    figure = sheet.figure
    content: dict[str, Any] = {
        "name": sheet.name,
        "print": type(figure).__name__,
        "world_from_sheet": transform_to_json(sheet.world_from_sheet),
        "sheet_from_print": sheet.shape.sheet_from_print.tolist(),
        "bending_per_m": sheet.shape.bending_per_m.tolist(),
        "ripple_per_m2": sheet.shape.ripple_per_m2.tolist(),
    }
    if isinstance(figure, RingPrint):
        content |= {"word": figure.code.word, "n_bits": figure.code.n_bits, "mirrored": figure.mirrored}
    if isinstance(figure, RingPrint | DotPrint):
        content["diameter_m"] = figure.diameter_m
    return content


def _columns(truths: list[ImageTruth], photo_names: list[str]) -> dict[str, list[str]]:
    images = [name for name, truth in zip(photo_names, truths, strict=True) for _ in truth.names]
    return {"image": images, "target": [name for truth in truths for name in truth.names]}


def _true_points(truths: list[ImageTruth], photo_names: list[str]) -> dict[str, Any]:
    pixels = np.concatenate([truth.pixels_px for truth in truths])
    return {
        **_columns(truths, photo_names),
        "x_px": pixels[:, 0],
        "y_px": pixels[:, 1],
        "diameter_px": np.concatenate([truth.diameter_px for truth in truths]),
        "tilt_deg": np.degrees(np.concatenate([truth.tilt_rad for truth in truths])),
        "covered": np.concatenate([truth.covered for truth in truths]).astype(int),
    }


def _measured_points(
    truths: list[ImageTruth], photo_names: list[str], sigma_px: float, rng: np.random.Generator
) -> dict[str, Any]:
    pixels = np.concatenate([truth.pixels_px for truth in truths])
    seen: npt.NDArray[np.float64] = pixels + sigma_px * rng.standard_normal(pixels.shape)
    sigma = np.full(len(seen), sigma_px)
    positions = {"x_px": seen[:, 0], "y_px": seen[:, 1], "sigma_x_px": sigma, "sigma_y_px": sigma}
    return {**_columns(truths, photo_names), **positions}


def _write_photo(path: Path, image: UnsignedArray, options: PhotoOptions) -> None:
    if options.jpeg_quality is None:
        write_image(path, image)
        return
    if image.dtype != np.uint8:
        raise InputError(f"{path.name}: JPEG holds 8 bit; leave jpeg_quality out for 16-bit photos")
    quality = [cv2.IMWRITE_JPEG_QUALITY, options.jpeg_quality]
    if options.in_colour:
        values = np.rint(image[:, :, None] * np.array(_WARM_LIGHT)).astype(np.uint8)
        quality += [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420]
    else:
        values = image
    _, encoded = cv2.imencode(".jpg", values, quality)
    path.write_bytes(encoded.tobytes())
