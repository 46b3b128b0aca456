"""Measurement folders of troughs with known truth: photos, measurement.toml, targets.csv, truth.json, truth.npz."""

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from data_synth.fringes.dataset import SYNTHETIC, TRUTH_ARRAYS_FILE, TRUTH_FILE
from data_synth.fringes.truth import TRUTH_SCHEMA
from data_synth.optics.mirror import transform_to_json
from data_synth.optics.sensor import UnsignedArray
from data_synth.optics.surface_errors import SurfaceErrors
from data_synth.targets.dataset import TRUE_POINTS_FILE
from data_synth.troughs.field import single_of
from data_synth.troughs.mirror import SlopeGrid, TroughMirror, corner_points_m
from data_synth.troughs.photo import Photographer, PhotoPoints
from data_synth.troughs.presets import DISTANCE_SIGMA_M, FAR_PIVOT_Z_M, NO_TARGETS, UNCODED
from data_synth.troughs.receiver import TubeAxis
from data_synth.troughs.scene import TroughScene, TroughView
from heliogauge.errors import InputError
from heliogauge.files.arrays import read_arrays
from heliogauge.geometry.geodesy import geodetic_from_enu
from heliogauge.geometry.rigid import rotation_from_vector
from heliogauge.images.photos import write_image
from heliogauge.measurement.load import MEASUREMENT_FILE
from heliogauge.measurement.writer import dump_toml, write_text
from heliogauge.results.json_file import read_json, write_json
from heliogauge.results.slope_map_file import read_slope_map
from heliogauge.results.tables import write_table_csv
from heliogauge.results.whole_folder import WholeFolder
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.validate import FloatArray, positive

TARGETS_FILE = "targets.csv"
#: Names and rough places of targets without a code.
UNCODED_FILE = "uncoded.csv"
#: Step of the maps of the truth.
_MAP_STEP_M = 0.02
#: Truths of several troughs, a folder for each, in its own frame; beside it the first one's in the common frame.
TRUTHS_FOLDER = "truth"
#: The drone's own positions; where on Earth the trough is, and how its rows run: latitude, longitude [deg], altitude
#: [m], azimuth of +y [deg].
POSITIONS_FILE = "positions.csv"
_PLACE_ON_EARTH, _ROW_AZIMUTH_DEG = (37.0913, -2.3584, 494.0), 8.0
#: So far inside its edges a panel's corner is looked at [m]; nobody claims to know it better than this [mm].
_INSIDE_M, _LEAST_SIGMA_MM = 0.01, 0.2
#: Readings of an inclinometer on a trough that turns before a far camera; how well a laser knows the distance [m].
TILTS_FILE, ABSORBER_FILE = "tilts.csv", "absorber_measured.csv"
_DISTANCE_SIGMA_M = 0.05
#: A laser distance meter on the tube reads so well, at so many places along it [m].
_LASER_SIGMA_M, _LASER_PLACES = 1e-3, 9
#: How well the heights of panels on a surveyed frame are known [mm].
_SURVEYED_MM = 0.2
_MAPS = ("slope_error_x", "slope_error_y", "theta_r_rad", "height_error_m")


@dataclass(frozen=True, slots=True)
class TroughOptions:
    """How a scene becomes a folder.

    seed: Seed of all noise; the same seed gives the same files.
    jpeg_quality: Write JPEG files of this quality, 1 to 100, instead of PNG.
    force: Replace an earlier synthetic measurement.
    rtk_sigma_m: Standard deviation of the drone's own positions, east, north and up; None: it writes none [m].
    gimbal_sigma_rad: Standard deviation of the camera's turns as the drone writes them beside its positions, about
        each axis of the camera; None: it writes none [rad].
    tilt_sigma_rad: Standard deviation of the inclinometer's readings on a trough that turns before a camera which
        resolves no targets [rad].
    InputError: A quality JPEG does not have, a standard deviation that is not above 0, or turns without positions.
    """

    seed: int = 0
    jpeg_quality: int | None = None
    force: bool = False
    rtk_sigma_m: float | None = None
    gimbal_sigma_rad: float | None = None
    tilt_sigma_rad: float = 0.2e-3

    def __post_init__(self) -> None:
        positive("tilt_sigma_rad", self.tilt_sigma_rad, "radians")
        if self.gimbal_sigma_rad is not None:
            positive("gimbal_sigma_rad", self.gimbal_sigma_rad, "radians")
            if self.rtk_sigma_m is None:
                raise InputError("gimbal_sigma_rad: turns of the camera stand beside its positions; write them, too")
        if self.rtk_sigma_m is not None:
            positive("rtk_sigma_m", self.rtk_sigma_m, "metres")
        if self.jpeg_quality is not None and not 1 <= self.jpeg_quality <= 100:
            raise InputError(f"jpeg_quality: 1 to 100 is needed, not {self.jpeg_quality}")


@dataclass(frozen=True, slots=True, eq=False)
class TroughTruth:
    """Truth of a synthetic trough measurement.

    x_m, y_m (nx,): Grid of the maps [m].
    slope_error_x, slope_error_y (ny, nx): True minus design dz/dx and dz/dy, NaN in gaps.
    theta_r_rad (ny, nx): Transverse slope error as an angle, positive where the normal is turned towards +x [rad].
    height_error_m (ny, nx): True minus design height [m].
    absorber_y_m, absorber_x_m, absorber_z_m (n,): Middle of the absorber in the trough's frame [m].
    parameters: The content of truth.json.
    """

    x_m: FloatArray
    y_m: FloatArray
    slope_error_x: FloatArray
    slope_error_y: FloatArray
    theta_r_rad: FloatArray
    height_error_m: FloatArray
    absorber_y_m: FloatArray
    absorber_x_m: FloatArray
    absorber_z_m: FloatArray
    parameters: Mapping[str, Any]


def write_trough_dataset(
    folder: Path, scene: TroughScene, options: TroughOptions | None = None, progress: Progress | None = None
) -> None:
    """Render a scene and write it as a measurement folder that is whole or not there.

    folder: Where to write; must be absent or empty.
    options: Seed, kind of files.
    InputError: The folder holds something, cannot be written to, or the scene cannot be drawn.
    """
    chosen = TroughOptions() if options is None else options
    progress = SilentProgress() if progress is None else progress
    suffix = ".png" if chosen.jpeg_quality is None else ".jpg"
    if chosen.jpeg_quality is not None and scene.optics.sensor.bits != 8:
        raise InputError("JPEG holds 8 bit; leave the quality out for photos of more bits")
    if chosen.rtk_sigma_m is not None and any(view.orientation_deg is not None for view in scene.views):
        raise InputError("rtk_sigma_m: the camera stands still before a trough that turns; leave it out")
    with WholeFolder(folder, SYNTHETIC, force=chosen.force) as working:
        with progress.stage("prepare the scene"):
            photographer = Photographer(scene)
        rngs = np.random.default_rng(chosen.seed).spawn(len(scene.views))

        def shoot(view: TroughView, rng: np.random.Generator) -> None:
            write_photo(working / (view.name + suffix), photographer.take(view, rng), chosen.jpeg_quality)

        # Arrays of 16 000 rays leave the interpreter's lock often enough for two threads to take 0.55 of one's time.
        with progress.stage("take photos", len(rngs)) as stage, ThreadPoolExecutor(os.cpu_count() or 1) as pool:
            for _ in pool.map(shoot, scene.views, rngs):
                stage.advance()
        with progress.stage("write truth"):
            write_knowledge(working, scene, suffix, chosen)
            _write_truth(working, scene, photographer, suffix, chosen.seed)


def read_slope_errors(path: Path) -> SlopeGrid:
    """Read the slope errors of a measured or synthetic map: measured minus design, in gaps those of the nearest node.

    path: A NetCDF file as heliogauge writes slope maps, in the trough's frame.
    """
    slopes = read_slope_map(path)
    return SlopeGrid(slopes.x_m, slopes.y_m, _filled(slopes.slope_error_x, path), _filled(slopes.slope_error_y))


def _filled(error: FloatArray, path: Path | None = None) -> FloatArray:
    """Fill gaps with the nearest value: zeros would be steps of the slope that no mirror has; all of it by zero."""
    from scipy.ndimage import distance_transform_edt

    missing = ~np.isfinite(error)
    if missing.all():
        if path is not None:
            raise InputError(f"{path}: no node of the map has a slope")
        return np.zeros_like(error)
    nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
    return np.asarray(error[tuple(nearest)])


def read_trough_truth(folder: Path) -> TroughTruth:
    """Read the truth of a synthetic trough measurement.

    Returns: Maps, absorber, parameters.
    """
    parameters = read_json(folder / TRUTH_FILE)
    arrays = folder / TRUTH_ARRAYS_FILE
    names = ("x_m", "y_m", *_MAPS, "absorber_y_m", "absorber_x_m", "absorber_z_m")
    return TroughTruth(**read_arrays(arrays, names), parameters=parameters)


def observer_content(scene: TroughScene, suffix: str) -> dict[str, Any]:
    """Return what measurement.toml says.

    suffix: How the photos' names end.
    """
    purposes = {view.purpose for view in scene.views}
    photos = {purpose: ("photo_*" if purpose == "reflection" else "absorber_*") + suffix for purpose in purposes}
    content: dict[str, Any] = {
        "kind": "observer",
        "name": scene.name,
        "notes": "Synthetic: drawn by heliogauge observer synth.",
        "collector": _collector_content(scene),
        "camera": _camera_content(scene),
        "images": {"photos": photos.get("reflection", photos.get("absorber"))},
    }
    if scene.dictionary == NO_TARGETS:
        content["corners"] = _corners_content(scene)
        if _turns(scene):
            del content["corners"]["azimuth_deg"]
            content["collector"]["orientation_deg"] = round(scene.world.surroundings.orientation_deg)
    else:
        content["targets"] = _targets_content(scene)
    if purposes == {"reflection", "absorber"}:
        content["absorber"] = {"photos": photos["absorber"]}
    if not scene.has_tube_beside:
        content["absorber"] = {"source": "design"}
    if scene.troughs:
        content["module"] = [{"name": one.name, "place_m": one.place_m.tolist()} for one in scene.troughs]
    elif scene.dictionary != NO_TARGETS:
        content["scale_bar"] = _long_distances(scene)
    if not scene.world.mirror.is_shaped:
        # Its normals are turned on the design's surface: heights from its slopes would be of another mirror.
        content["evaluation"] = {"shape_from_slopes": False}
    return content


def _targets_content(scene: TroughScene) -> dict[str, Any]:
    if scene.dictionary.startswith("DICT_") and "+" not in scene.dictionary:
        return {"dictionary": scene.dictionary, "file": TARGETS_FILE}
    kinds = [one for one in scene.dictionary.split("+") if one != UNCODED]
    said = {"square_dictionary" if one.startswith("DICT_") else "dictionary": one for one in kinds}
    kind = said or {"uncoded_file": UNCODED_FILE}
    size = {"diameter_mm": round(1e3 * scene.target_diameter_m, 9), "polarity": "black-on-white"}
    return {**kind, **size, "file": TARGETS_FILE}


def _corners_content(scene: TroughScene) -> dict[str, Any]:
    """Say of the corners what whoever measures knows: how well panels are mounted, and how far corners are off."""
    mirror, design = scene.world.mirror, scene.collector
    shift = np.zeros((1, 2)) if mirror.panels is None or mirror.panels.shift_m is None else mirror.panels.shift_m
    edges_x, edges_y = design.panel_edges_x_m, design.panel_edges_y_m
    inside = [np.r_[edges[:-1] + _INSIDE_M, edges[1:] - _INSIDE_M] for edges in (edges_x, edges_y)]
    height = mirror.deviation(*np.meshgrid(*inside))[0]
    alike = np.nanmean(height, axis=0)
    return {
        "azimuth_deg": _ROW_AZIMUTH_DEG,
        "mounting_sigma_mm": round(max(1e3 * float(shift.std()), _LEAST_SIGMA_MM), 2),
        "corner_sigma_mm": round(max(1e3 * float(np.sqrt(np.nanmean((height - alike) ** 2))), _LEAST_SIGMA_MM), 2),
        "alike_sigma_mm": round(1e3 * float(np.sqrt(np.nanmean(alike**2))), 2),
    }


def _collector_content(scene: TroughScene) -> dict[str, Any]:
    design = scene.collector
    content: dict[str, Any] = {
        "aperture_width_m": design.aperture_width_m,
        "length_m": design.length_m,
        "focal_length_m": design.focal_length_m,
        "absorber_diameter_mm": 1e3 * design.absorber_diameter_m,
    }
    if design.glass is not None:
        content |= {
            "glass_outer_diameter_mm": 1e3 * design.glass.outer_diameter_m,
            "glass_inner_diameter_mm": 1e3 * design.glass.inner_diameter_m,
            "glass_index": design.glass.index,
        }
    content |= {
        "panel_edges_x_m": design.panel_edges_x_m.round(6).tolist(),
        "panel_edges_y_m": design.panel_edges_y_m.round(6).tolist(),
        "panel_gap_mm": 1e3 * design.panel_gap_m,
    }
    # Panels of a mirror without stated heights stand as designed: as if their frame had been surveyed.
    content["panel_height_sigma_mm"] = 1e3 * design.panel_height_sigma_m or _SURVEYED_MM
    content["support_y_m"] = design.support_y_m.tolist()
    if len(design.support_y_m):
        content["support_width_m"] = design.support_width_m
    if all(view.orientation_deg is None for view in scene.views):
        content["orientation_deg"] = scene.world.surroundings.orientation_deg
    return {key: round(value, 9) if isinstance(value, float) else value for key, value in content.items()}


def _camera_content(scene: TroughScene) -> dict[str, Any]:
    camera = scene.camera
    content = {
        "width_px": camera.width_px,
        "height_px": camera.height_px,
        "focal_px": camera.focal_x_px,
        "center_x_px": camera.center_x_px,
        "center_y_px": camera.center_y_px,
    }
    return content | {name: value for name in ("k1", "k2", "k3", "p1", "p2") if (value := getattr(camera, name))}


def _long_distances(scene: TroughScene) -> list[dict[str, Any]]:
    """Measure along both rims with a tape, its error drawn."""
    true = scene.points_m()
    bars = []
    rng = np.random.default_rng(len(true))
    for side in (-1, 1):
        names = [one.name for one in scene.targets if one.on_collector and side * one.stated_m[0] > 0]
        names = [name for name in names if name in true]
        if len(names) < 2:
            continue
        length = float(np.linalg.norm(true[names[0]] - true[names[-1]])) + DISTANCE_SIGMA_M * rng.standard_normal()
        bars.append(
            {"a": names[0], "b": names[-1], "length_m": round(float(length), 6), "sigma_mm": 1e3 * DISTANCE_SIGMA_M}
        )
    return bars


def _write_positions(path: Path, scene: TroughScene, suffix: str, options: TroughOptions) -> None:
    """Write where the drone's receiver has the cameras, and how its gimbal has turned them."""
    rng = np.random.default_rng([options.seed, len(scene.views), 1])
    around, turn = scene.world.surroundings, np.radians(_ROW_AZIMUTH_DEG)
    along = np.array([0.0, 1.0, 0.0])
    east = around.horizontal * np.cos(turn) + along * np.sin(turn)
    north = along * np.cos(turn) - around.horizontal * np.sin(turn)
    enu_from_trough = np.stack([east, north, around.up])
    sigma_m = options.rtk_sigma_m or 0.0
    enu = np.array([view.position_m for view in scene.views]) @ enu_from_trough.T
    place = geodetic_from_enu(enu + sigma_m * rng.standard_normal(enu.shape), _PLACE_ON_EARTH)
    columns: dict[str, Any] = {
        "image": [view.name + suffix for view in scene.views],
        "latitude_deg": [f"{value:.9f}" for value in place.latitude_deg],
        "longitude_deg": [f"{value:.9f}" for value in place.longitude_deg],
        "altitude_m": [f"{value:.4f}" for value in place.altitude_m],
    }
    for axis in ("east", "north", "up"):
        columns[f"sigma_{axis}_mm"] = [f"{1e3 * sigma_m:g}"] * len(scene.views)
    if options.gimbal_sigma_rad is not None:
        angles = []
        for view in scene.views:
            error = rotation_from_vector(options.gimbal_sigma_rad * rng.standard_normal(3))
            angles.append(_gimbal_angles_deg(enu_from_trough @ (error @ view.cam_from_trough.rotation).T))
        for name, values in zip(("yaw_deg", "pitch_deg", "roll_deg"), np.array(angles).T, strict=True):
            columns[name] = [f"{value:.2f}" for value in values]
    write_table_csv(path, columns)


def _turns(scene: TroughScene) -> bool:
    return all(view.orientation_deg is not None for view in scene.views)


def _write_tilts(path: Path, scene: TroughScene, suffix: str, options: TroughOptions) -> dict[str, Any]:
    """Write what an inclinometer on the trough reads in each photo; return what else is known of the camera."""
    rng = np.random.default_rng([options.seed, len(scene.views), 2])
    true = np.array([view.orientation_deg for view in scene.views], dtype=np.float64)
    read = true + np.degrees(options.tilt_sigma_rad) * rng.standard_normal(true.size)
    write_table_csv(
        path,
        {"image": [view.name + suffix for view in scene.views], "tilt_deg": [f"{value:.4f}" for value in read]},
    )
    # All photos are taken from one place, the trough turns before it: their distance to its axis is the same.
    distance = float(np.hypot(*(scene.views[0].position_m - [0.0, 0.0, FAR_PIVOT_Z_M])[[0, 2]]))
    return {
        "file": TILTS_FILE,
        "sigma_mrad": round(1e3 * options.tilt_sigma_rad, 6),
        "distance_m": round(distance + _DISTANCE_SIGMA_M * float(rng.standard_normal()), 3),
        "distance_sigma_m": _DISTANCE_SIGMA_M,
        "axis_m": [0.0, FAR_PIVOT_Z_M],
    }


def _write_measured_absorber(path: Path, scene: TroughScene, options: TroughOptions) -> None:
    """Write where a laser distance meter has the tube: from far away it stands before its own reflection."""
    rng = np.random.default_rng([options.seed, len(scene.views), 3])
    half = scene.collector.length_m / 2
    y = np.linspace(-half, half, _LASER_PLACES)
    place = np.stack(scene.world.receiver.position_m(y)) + _LASER_SIGMA_M * rng.standard_normal((2, y.size))
    columns: dict[str, Any] = {"y_m": y.round(6).tolist()}
    for axis, values in zip("xz", place, strict=True):
        columns[f"{axis}_a_m"] = [f"{value:.6f}" for value in values]
    for axis in "xz":
        columns[f"sigma_{axis}_a_m"] = [f"{_LASER_SIGMA_M:g}"] * y.size
    write_table_csv(path, columns)


def _gimbal_angles_deg(enu_from_cam: FloatArray) -> tuple[float, float, float]:
    """Return yaw, pitch and roll of a camera as drones write them: north, east, down; forward, right, down of it."""
    ned_from_body = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]) @ enu_from_cam[:, [2, 0, 1]]
    yaw = np.arctan2(ned_from_body[1, 0], ned_from_body[0, 0])
    pitch = -np.arcsin(np.clip(ned_from_body[2, 0], -1, 1))
    roll = np.arctan2(ned_from_body[2, 1], ned_from_body[2, 2])
    return float(np.degrees(yaw)), float(np.degrees(pitch)), float(np.degrees(roll))


def write_knowledge(working: Path, scene: TroughScene, suffix: str, options: TroughOptions) -> None:
    """Write what whoever measures knows: measurement.toml and its tables.

    suffix: How the photos' names end.
    """
    content = observer_content(scene, suffix)
    if options.rtk_sigma_m is not None:
        _write_positions(working / POSITIONS_FILE, scene, suffix, options)
        content["positions"] = {"file": POSITIONS_FILE}
    if scene.dictionary == NO_TARGETS and _turns(scene):
        content["tilts"] = _write_tilts(working / TILTS_FILE, scene, suffix, options)
        _write_measured_absorber(working / ABSORBER_FILE, scene, options)
        content["absorber"] = {"source": "file", "file": ABSORBER_FILE}
    comment = f"Synthetic measurement, seed {options.seed}; see {TRUTH_FILE}."
    write_text(working / MEASUREMENT_FILE, f"# {comment}\n\n" + dump_toml(content))
    if scene.dictionary != NO_TARGETS:
        _write_targets(working, scene)


def _write_targets(working: Path, scene: TroughScene) -> None:
    stated = np.array([target.stated_m for target in scene.targets]).reshape(-1, 3)
    sigma_mm = 1e3 * np.array([target.sigma_m for target in scene.targets]).reshape(-1, 3)
    known = np.isfinite(sigma_mm)
    columns: dict[str, Any] = {"target": [target.name for target in scene.targets]}
    for k, axis in enumerate("xyz"):
        columns[f"{axis}_m"] = [f"{value:.6f}" for value in stated[:, k]]
    for k, axis in enumerate("xyz"):
        column = zip(sigma_mm[:, k], known[:, k], strict=True)
        columns[f"sigma_{axis}_mm"] = [f"{value:g}" if is_known else "" for value, is_known in column]
    columns |= {
        "kind": [target.kind for target in scene.targets],
        "code": [target.code if target.code != target.name else "" for target in scene.targets],
        "diameter_mm": [f"{1e3 * target.diameter_m:g}" if target.diameter_m else "" for target in scene.targets],
    }
    columns["on_collector"] = [int(target.on_collector) for target in scene.targets]
    write_table_csv(working / TARGETS_FILE, columns)
    if scene.dictionary == UNCODED:
        rough = {"id": columns["target"], **{f"{axis}_m": columns[f"{axis}_m"] for axis in "xyz"}}
        write_table_csv(working / UNCODED_FILE, {**rough, "sigma_mm": ["5"] * len(scene.targets)})


def _write_truth(working: Path, scene: TroughScene, photographer: Photographer, suffix: str, seed: int) -> None:
    seen = [photographer.points(view) for view in scene.views]
    write_table_csv(working / TRUE_POINTS_FILE, _true_points(scene, seen, suffix))
    write_json(working / TRUTH_FILE, {**trough_to_json(scene, suffix), "seed": seed})
    arrays: Mapping[str, Any] = truth_arrays(scene)
    np.savez_compressed(working / TRUTH_ARRAYS_FILE, **arrays)
    for trough in scene.troughs:
        folder = working / TRUTHS_FOLDER / trough.name
        folder.mkdir(parents=True)
        own = single_of(scene, trough)
        write_json(folder / TRUTH_FILE, {**trough_to_json(own, suffix), "seed": seed})
        maps: Mapping[str, Any] = truth_arrays(own)
        np.savez_compressed(folder / TRUTH_ARRAYS_FILE, **maps)


def truth_arrays(scene: TroughScene) -> dict[str, FloatArray]:
    """Return the maps of a scene's truth, by the names of `TroughTruth`.

    Returns: Arrays; the grid has a node in every 20 mm, the first half a step inside the aperture.
    """
    mirror, design = scene.world.mirror, scene.collector
    x, y = (
        np.asarray((np.arange(n) + 0.5 - n / 2) * _MAP_STEP_M, dtype=np.float64)
        for n in (round(size / _MAP_STEP_M) for size in (design.aperture_width_m, design.length_m))
    )
    across, along = np.meshgrid(x, y)
    height, slope_x, slope_y = mirror.deviation(across, along)
    absorber_x, absorber_z = scene.world.receiver.position_m(y)
    return {
        "x_m": x,
        "y_m": y,
        "slope_error_x": slope_x,
        "slope_error_y": slope_y,
        "theta_r_rad": mirror.theta_r_rad(across, along),
        "height_error_m": height,
        "absorber_y_m": y,
        "absorber_x_m": absorber_x,
        "absorber_z_m": absorber_z,
    }


def trough_to_json(scene: TroughScene, suffix: str) -> dict[str, Any]:
    """Return a scene's truth as plain values.

    suffix: How the photos' names end.
    Returns: Collector, camera, poses, targets, errors of the mirror, receiver, surroundings.
    """
    camera, around = scene.camera, scene.world.surroundings
    receiver = scene.world.receiver
    return {
        "schema": TRUTH_SCHEMA,
        "kind": "trough",
        "name": scene.name,
        "collector": _collector_content(scene),
        "camera": {name: getattr(camera, name) for name in camera.__dataclass_fields__},
        "photos": {view.name + suffix: _view_to_json(view) for view in scene.views},
        "points_m": {name: point.tolist() for name, point in scene.points_m().items()},
        "corners_m": {name: point.tolist() for name, point in corner_points_m(scene.world.mirror).items()},
        "stated_points_m": {target.name: target.stated_m.tolist() for target in scene.targets},
        "mirror": _mirror_to_json(scene.world.mirror),
        "absorber_offset": _axis_to_json(receiver.absorber),
        "glass_offset": None if receiver.glass is None else _axis_to_json(receiver.glass),
        "orientation_deg": around.orientation_deg,
        "sun": around.sun.tolist(),
        "sky": {name: getattr(around.sky, name) for name in around.sky.__dataclass_fields__},
        "ground": {name: getattr(around.ground, name) for name in around.ground.__dataclass_fields__},
        "blur_sigma_px": scene.optics.blur_sigma_px,
    }


def _view_to_json(view: TroughView) -> dict[str, Any]:
    content: dict[str, Any] = {
        "cam_from_trough": transform_to_json(view.cam_from_trough),
        "position_m": view.position_m.tolist(),
        "exposure": view.exposure,
        "purpose": view.purpose,
    }
    if view.orientation_deg is not None:
        content["orientation_deg"] = view.orientation_deg
    if view.shutter is not None:
        content["rolling_shutter"] = {
            "readout_s": view.shutter.readout_s,
            "velocity_m_s": view.shutter.velocity_m_s.tolist(),
            "turn_rad_s": view.shutter.turn_rad_s.tolist(),
        }
    return content


def _mirror_to_json(mirror: TroughMirror) -> dict[str, Any]:
    content: dict[str, Any] = {"is_shaped": mirror.is_shaped}
    for name in ("errors", "transverse", "longitudinal"):
        terms: SurfaceErrors = getattr(mirror, name)
        content[name] = terms.to_json()
    if mirror.panels is not None:
        content["panels"] = {
            name: getattr(mirror.panels, name).tolist() for name in ("tilt_x", "tilt_y", "focal_length_m", "height_m")
        }
        if mirror.panels.shift_m is not None:
            content["panels"]["shift_m"] = mirror.panels.shift_m.tolist()
    return content


def _axis_to_json(axis: TubeAxis) -> dict[str, Any]:
    return {name: getattr(axis, name).tolist() for name in ("y_m", "x_m", "z_m")}


def _true_points(scene: TroughScene, seen: list[PhotoPoints], suffix: str) -> dict[str, Any]:
    pixels = np.concatenate([points.pixels_px for points in seen])
    return {
        "image": [view.name + suffix for view, points in zip(scene.views, seen, strict=True) for _ in points.names],
        "target": [name for points in seen for name in points.names],
        "x_px": pixels[:, 0],
        "y_px": pixels[:, 1],
    }


def write_photo(path: Path, image: UnsignedArray, jpeg_quality: int | None) -> None:
    """Write a photo as JPEG, or without a quality as its name says."""
    if jpeg_quality is None:
        write_image(path, image)
        return
    _, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality])
    path.write_bytes(encoded.tobytes())
