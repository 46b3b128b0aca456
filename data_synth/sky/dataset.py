"""A backward-gazing measurement as a folder: images of four cameras and of the sun, darks, flats, truth.json."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from data_synth.fringes.dataset import SYNTHETIC, TRUTH_FILE
from data_synth.sky.gazing_scene import (
    GazingPlaces,
    GazingScene,
    corner_points,
    heliostat_of_table_6,
    look_at,
    mirror_light,
    places_of,
    sun_light,
)
from heliogauge.geometry.rigid import vector_from_rotation
from heliogauge.measurement.writer import write_measurement
from heliogauge.results.json_file import write_json
from heliogauge.results.whole_folder import WholeFolder
from heliogauge.validate import FloatArray

#: Light of the sun's middle without a mirror fills so much of 16 bit above the black level.
_FULL_DN, _DARK_DN, _EXPOSURE_MS = 50_000.0, 600.0, 2.0
_DARKS, _FLATS = 5, 8


def write_gazing(folder: Path, scene: GazingScene | None = None, seed: int = 0, *, force: bool = False) -> None:
    """Draw a measurement by backward gazing and write its folder.

    force: Replace an earlier synthetic measurement.
    InputError: The folder holds something or cannot be written to.
    """
    scene = scene or GazingScene(heliostat_of_table_6(seed))
    rng = np.random.default_rng([seed, 47])
    known, places = scene.known, places_of(scene)
    reflectance = scene.reflectance * (1 + known.reflectance * rng.standard_normal())
    levels = 0.8 + 0.4 * rng.random(len(scene.offsets_m))
    stated_levels = levels * (1 + known.level * rng.standard_normal(len(levels)))
    with WholeFolder(folder, SYNTHETIC, force=force) as working:
        cameras = []
        for number in range(len(levels)):
            name = f"camera {number + 1}"
            directory = working / f"camera_{number + 1}"
            directory.mkdir()
            pattern = _pattern(scene, rng)
            flats = [_flat_frame(pattern, rng) for _ in range(_FLATS)]
            bright = scene.clouds[number] * reflectance * levels[number] * mirror_light(scene, places, number)
            longer = 4.0 if number in scene.saturated else 1.0
            _write(directory, "mirror", [_frame(scene, bright * longer, pattern, rng) for _ in range(scene.frames)])
            _write(directory, "dark", [_dark_frame(pattern.shape, rng) for _ in range(_DARKS)])
            _write(directory, "flat", flats)
            disc = stated_levels[number] * sun_light(scene.radiance, scene.pixels, scene.focal_px)
            _write(directory, "sun", [_frame(scene, disc, pattern, rng)])
            cameras.append(_camera_keys(scene, places, number, name, longer, rng))
        directory = working / "sun"
        directory.mkdir()
        side = int(2 * np.ceil(2.2 * 4.65e-3 * scene.sun_focal_px))
        pattern = 1 + scene.pattern_share * rng.standard_normal((side, side))
        disc = sun_light(scene.radiance, side, scene.sun_focal_px)
        _write(directory, "sun", [_frame(scene, disc, pattern, rng)])
        _write(directory, "dark", [_dark_frame(disc.shape, rng) for _ in range(_DARKS)])
        _write(directory, "flat", [_flat_frame(pattern, rng) for _ in range(_FLATS)])
        content = {
            "kind": "backward-gazing",
            "name": "heliostat",
            "notes": "Synthetic: drawn by heliogauge deflectometry synth --preset gazing.",
            "sun": _sun_keys(scene, places, rng),
            "camera": cameras,
            "mirror": _mirror_keys(scene, places, rng),
            "photometry": {
                "reflectance": scene.reflectance,
                "sigma_reflectance_percent": 100 * max(known.reflectance, 1e-4),
                "sigma_level_percent": 100 * max(known.level, 1e-4),
            },
        }
        write_measurement(working, content, comment=f"Synthetic measurement, seed {seed}; see truth.json.")
        helio = scene.heliostat
        write_json(
            working / TRUTH_FILE,
            {
                "seed": seed,
                "tilts_rad": helio.tilts_rad.tolist(),
                "bows_per_m": helio.bows_per_m.tolist(),
                "canting_radius_m": helio.canting_radius_m,
                "facet_radius_m": helio.facet_radius_m,
                "clouds": scene.clouds[: len(levels)].tolist(),
            },
        )


def _pattern(scene: GazingScene, rng: np.random.Generator) -> FloatArray:
    """Return the relative response of all pixels: vignetting of 3 %, and each pixel's own."""
    line = np.linspace(-1, 1, scene.pixels)
    vignetting = 1 - 0.03 * (line[:, None] ** 2 + line**2) / 2
    return np.asarray(vignetting * (1 + scene.pattern_share * rng.standard_normal((scene.pixels, scene.pixels))))


def _frame(scene: GazingScene, light: FloatArray, pattern: FloatArray, rng: np.random.Generator) -> FloatArray:
    dn = _FULL_DN * light * pattern + _DARK_DN
    return np.asarray(dn + scene.noise_share * scene.reflectance * _FULL_DN * rng.standard_normal(light.shape))


def _dark_frame(shape: tuple[int, ...], rng: np.random.Generator) -> FloatArray:
    return np.asarray(_DARK_DN + 10.0 * rng.standard_normal(shape))


def _flat_frame(pattern: FloatArray, rng: np.random.Generator) -> FloatArray:
    return np.asarray(0.6 * _FULL_DN * pattern + _DARK_DN + 100.0 * rng.standard_normal(pattern.shape))


def _write(directory: Path, name: str, frames: list[FloatArray]) -> None:
    for number, frame in enumerate(frames, start=1):
        whole = np.clip(np.rint(frame), 0, 65535).astype(np.uint16)
        done, encoded = cv2.imencode(".png", whole, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        if not done:
            raise RuntimeError(f"{name}: the image could not be encoded")
        (directory / f"{name}_{number}.png").write_bytes(encoded.tobytes())


def _sun_keys(scene: GazingScene, places: GazingPlaces, rng: np.random.Generator) -> dict[str, Any]:
    known = scene.known
    across = np.linalg.svd(places.sun[None])[2][1:]
    sun = places.sun + known.sun_rad * rng.standard_normal(2) @ across
    return {
        "frames": "sun/sun_*.png",
        "dark": "sun/dark_*.png",
        "flat": "sun/flat_*.png",
        "exposure_ms": _EXPOSURE_MS,
        "focal_px": scene.sun_focal_px * (1 + known.focal * rng.standard_normal()),
        "sigma_focal_permille": 1e3 * known.focal,
        "azimuth_deg": float(np.degrees(np.arctan2(sun[0], sun[1])) % 360),
        "elevation_deg": float(np.degrees(np.arctan2(sun[2], np.hypot(sun[0], sun[1])))),
        "sigma_direction_mrad": 1e3 * known.sun_rad,
    }


def _camera_keys(
    scene: GazingScene, places: GazingPlaces, number: int, name: str, longer: float, rng: np.random.Generator
) -> dict[str, Any]:
    known, eye = scene.known, places.cameras_m[number]
    axes = look_at(eye, places.heliostat_m)
    points = []
    for corner in corner_points(scene)[0]:
        local = (places.heliostat_m + places.axes @ corner - eye) @ axes
        pixel = 0.5 * (scene.pixels - 1) + scene.focal_px * local[:2] / local[2]
        pixel = pixel + known.point_px * rng.standard_normal(2)
        points.append({"point_m": corner.tolist(), "image_px": pixel.tolist(), "sigma_px": max(known.point_px, 0.05)})
    directory = f"camera_{number + 1}"
    return {
        "name": name,
        "frames": f"{directory}/mirror_*.png",
        "dark": f"{directory}/dark_*.png",
        "flat": f"{directory}/flat_*.png",
        "sun": f"{directory}/sun_*.png",
        "exposure_ms": _EXPOSURE_MS * longer,
        "sun_exposure_ms": _EXPOSURE_MS,
        "place_m": (eye + known.camera_m * rng.standard_normal(3)).tolist(),
        "sigma_place_mm": 1e3 * known.camera_m,
        "camera": {
            "width_px": scene.pixels,
            "height_px": scene.pixels,
            "focal_x_px": scene.focal_px,
            "focal_y_px": scene.focal_px,
            "center_x_px": 0.5 * (scene.pixels - 1),
            "center_y_px": 0.5 * (scene.pixels - 1),
        },
        "point": points,
    }


def _mirror_keys(scene: GazingScene, places: GazingPlaces, rng: np.random.Generator) -> dict[str, Any]:
    known = scene.known
    # The nominal normal is that of the true frame: an aim that departs would only turn the reference.
    return {
        "place_m": (places.heliostat_m + known.mirror_m * rng.standard_normal(3)).tolist(),
        "sigma_place_mm": 1e3 * known.mirror_m,
        "normal": places.axes[:, 2].tolist(),
        **heliostat_keys(scene),
    }


def heliostat_keys(scene: GazingScene) -> dict[str, Any]:
    """Return design and facets as measurement.toml says them."""
    helio = scene.heliostat
    facets = [
        {
            "name": f"facet {number + 1}",
            "outline_m": helio.outline_m.tolist(),
            "position_m": helio.place_m(number).tolist(),
            "rotation_vector_rad": vector_from_rotation(helio.axes(number, tilted=False)).tolist(),
        }
        for number in range(helio.count)
    ]
    return {"design": "sphere", "radius_m": helio.facet_radius_m, "facet": facets}


def gazing_preset(preset: str, seed: int) -> GazingScene:
    """Return the scene of a preset: gazing, or gazing-close with cameras 0.2 m apart."""
    scene = GazingScene(heliostat_of_table_6(seed, bow_mrad_per_m=0.15))
    return scene.with_spacing(0.2) if preset == "gazing-close" else scene
