"""COLMAP models in and out: a model becomes a measurement folder, a result becomes a model."""

from collections import Counter
from collections.abc import Sequence
from glob import escape
from pathlib import Path
from typing import Any

import numpy as np

from heliogauge.camera.conversion import convert_direction
from heliogauge.camera.distortion import DistortionDirection
from heliogauge.camera.formats import COLMAP_MODELS, to_colmap
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError
from heliogauge.flags import SampleFlag
from heliogauge.measurement.imported import IMPORTED, write_imported
from heliogauge.measurement.writer import write_measurement
from heliogauge.results.folder import (
    PhotoPose,
    PointTable,
    read_cameras_json,
    read_points_csv,
    read_table_csv,
    write_cameras_json,
    write_points_csv,
    write_table_csv,
)
from heliogauge.results.whole_folder import FolderKind, WholeFolder
from heliogauge.validate import FloatArray
from photogrammetry.bundle.state import INTRINSIC_NAMES, intrinsics_of
from photogrammetry.exchange.colmap_files import ColmapImage, ColmapModel, model_files, read_colmap, write_colmap

_COMMENT = """\
Imported from a COLMAP model. Its image points have no sigma: their size comes from the residuals.
Frame and scale are the model's until scale bars or control points say something else."""
#: Beside an exported model: the names of its points, which `import_colmap` takes over again.
NAMES_FILE = "point_names.csv"
_MODEL = FolderKind(content="exported COLMAP models", mark=NAMES_FILE)
#: What COLMAP's names of parameters are here.
_INTRINSIC = {"f": "focal_px", "fx": "focal_px", "fy": "aspect", "cx": "center_x_px", "cy": "center_y_px"}


def import_colmap(model_folder: Path, folder: Path, *, force: bool = False) -> tuple[str, ...]:
    """Write a measurement folder from a COLMAP model.

    model_folder: Folder with cameras, images and points3D, .bin or .txt.
    folder: The measurement folder; must be absent or empty.
    force: Replace a folder that was imported earlier.
    Returns: What was taken over and what not, in lines to print.
    InputError: The model cannot be read (see `photogrammetry.exchange.colmap_files.read_colmap`), or the folder is
        in use.

    The measurement holds all keypoints that show a point of the model, with the points' numbers as names
    (or the names that `export_colmap` wrote beside them). Intrinsics
    start at the model's values, and those are free that its camera model has; poses and points are start values.
    """
    model = read_colmap(model_folder)
    names_of_points = _point_names(model_folder, model)
    columns, doubled = _image_points(model, names_of_points)
    if not columns["image"]:
        raise InputError(f"{model_folder}: no keypoint shows a point; nothing ties the images together")
    names = {number: f"camera {number}" for number in model.cameras}
    poses = {image.name: PhotoPose(names[image.camera], image.cam_from_world) for image in model.images}
    sections = _camera_sections(model)
    content: dict[str, Any] = {
        "kind": "photogrammetry",
        "name": model_folder.resolve().name,
        "camera": sections if len(sections) > 1 else sections[0],
        "image_points": {"file": "image_points.csv", "pixel_origin": "corner"},
        "start": {"cameras": "cameras.json", "points": "points.csv"},
    }
    with WholeFolder(folder, IMPORTED, force=force) as working:
        write_table_csv(working / "image_points.csv", columns)
        write_cameras_json(working / "cameras.json", {names[k]: one for k, one in model.cameras.items()}, poses)
        write_points_csv(working / "points.csv", _point_table(model, names_of_points, columns["target"]))
        write_measurement(working, content, comment=_COMMENT)
        write_imported(working, "colmap", model_files(model_folder))
    said = [f"{len(model.images)} images, {len(model.points_m)} points, {len(columns['image'])} image points"]
    lonely = [one["name"] for one in sections if len(one.get("photos", "many")) == 1]
    if lonely:
        said.append(
            f"{len(lonely)} cameras took one photo each ({lonely[0]}): where they are one camera, match again with "
            "--ImageReader.single_camera 1, or give them one [[camera]] section: one photo hardly determines a camera"
        )
    if doubled:
        said.append(f"{doubled} image points left out: their image shows the same point more than once")
    return (*said, "not taken over: covariances of COLMAP, which are conditional; the adjustment gives joint ones")


def _camera_sections(model: ColmapModel) -> list[dict[str, Any]]:
    """Return a section for each camera that took an image; with several, each names its photos."""
    photos: dict[int, list[str]] = {number: [] for number in model.cameras}
    for image in model.images:
        photos[image.camera].append(image.name)
    used = {number: names for number, names in photos.items() if names}
    return [
        {"name": f"camera {number}"}
        | ({"photos": [escape(name) for name in names]} if len(used) > 1 else {})
        | _intrinsics(model.cameras[number])
        for number, names in used.items()
    ]


def _intrinsics(camera: Camera) -> dict[str, Any]:
    parameters = COLMAP_MODELS[to_colmap(camera)[0]]
    free = {_INTRINSIC.get(name, name) for name in parameters} & set(INTRINSIC_NAMES)
    values = dict(zip(INTRINSIC_NAMES, intrinsics_of(camera).tolist(), strict=True))
    section: dict[str, Any] = {"width_px": camera.width_px, "height_px": camera.height_px}
    section |= {name: value for name, value in values.items() if name in free}
    return section | {"free": [name for name in INTRINSIC_NAMES if name in free]}


def _point_names(folder: Path, model: ColmapModel) -> dict[int, str]:
    """Return the name of each point: from the file that `export_colmap` writes beside a model, or its number."""
    names = {number: str(number) for number in model.points_m}
    file = folder / NAMES_FILE
    if file.is_file():
        columns = read_table_csv(file, ("id", "name"))
        given = dict(zip(columns["id"], columns["name"], strict=True))
        names = {number: given.get(name, name) for number, name in names.items()}
        if len(set(names.values())) < len(names):
            raise InputError(f"{file}: two points have one name; is the file of another model? Remove it")
    return names


def _image_points(model: ColmapModel, names: dict[int, str]) -> tuple[dict[str, list[Any]], int]:
    """Return the columns of image_points.csv, origin at the corner as COLMAP has it, and how many are doubled."""
    columns: dict[str, list[Any]] = {name: [] for name in ("image", "target", "x_px", "y_px")}
    doubled = 0
    for image in model.images:
        counts = Counter(image.point_ids.tolist())
        once = [k for k, number in enumerate(image.point_ids.tolist()) if number >= 0 and counts[number] == 1]
        doubled += sum(count for number, count in counts.items() if number >= 0 and count > 1)
        columns["image"] += [image.name] * len(once)
        columns["target"] += [names[number] for number in image.point_ids[once].tolist()]
        for name, values in zip(("x_px", "y_px"), (image.pixels_px[once] + 0.5).T, strict=True):
            columns[name] += values.tolist()
    return columns, doubled


def _point_table(model: ColmapModel, names: dict[int, str], targets: Sequence[str]) -> PointTable:
    rays = Counter(targets)
    unknown = np.full((len(model.points_m), 3), np.nan)
    ids = tuple(names[number] for number in model.points_m)
    counts = np.array([rays[name] for name in ids], dtype=np.int64)
    return PointTable(ids, np.array(list(model.points_m.values())), unknown, counts, np.zeros(len(ids), np.uint32))


def export_colmap(result: Path, out: Path, *, binary: bool = False, force: bool = False) -> tuple[str, ...]:
    """Write a COLMAP model from a results folder of photogrammetry.

    out: Folder for cameras, images and points3D; must be absent or empty.
    binary: Write .bin instead of .txt.
    force: Replace a model that was exported earlier.
    Returns: What was written and what the format does not hold, in lines to print.
    InputError: The results cannot be read, do not belong together, or a camera cannot be held by COLMAP (skew); or
        the folder is in use.

    Poses are cam_from_world in both; half a pixel is added for COLMAP's origin. Lenses that correct with their
    polynomial are fitted in the other direction, and the residual of that is said.
    """
    for name in ("cameras.json", "points.csv", "residuals.csv"):
        if not (result / name).is_file():
            raise InputError(
                f"{result}: there is no {name}; a results folder of `heliogauge photogrammetry measure` is needed"
            )
    cameras, poses = read_cameras_json(result / "cameras.json")
    said: list[str] = []
    numbers = {name: number for number, name in enumerate(cameras, 1)}
    lenses = {numbers[name]: _in_colmap_direction(name, camera, said) for name, camera in cameras.items()}
    table = read_points_csv(result / "points.csv")
    known = np.isfinite(table.xyz_m).all(axis=1) & ((table.flags & np.uint32(SampleFlag.NOT_SEEN)) == 0)
    point_ids = _number_targets([name for name, one in zip(table.ids, known, strict=True) if one])
    points = {point_ids[name]: xyz for name, xyz, one in zip(table.ids, table.xyz_m, known, strict=True) if one}
    images = _images(result / "residuals.csv", poses, numbers, point_ids)
    with WholeFolder(out, _MODEL, force=force) as working:
        write_colmap(working, ColmapModel(lenses, images, points), binary=binary)
        write_table_csv(working / NAMES_FILE, {"id": list(point_ids.values()), "name": list(point_ids)})
    said.insert(0, f"{len(images)} images, {len(points)} points, {sum(one.point_ids.size for one in images)} keypoints")
    if any(point_ids[name] != _own_number(name) for name in point_ids):
        said.append(f"COLMAP's points have numbers only: {NAMES_FILE} says which target is which")
    return (*said, "not in this format: any covariance, datum or sigma; they stay in the results folder")


def _in_colmap_direction(name: str, camera: Camera, said: list[str]) -> Camera:
    """Return the camera with the lens in COLMAP's direction."""
    if camera.distortion.is_zero or camera.distortion.distorts_in_closed_form:
        return camera
    try:
        fit = convert_direction(camera, DistortionDirection.IDEAL_TO_MEASURED)
    except EstimationError as error:
        raise InputError(f"{name}: COLMAP distorts with the polynomial, and {error}") from error
    said.append(
        f"{name}: the lens corrects with its polynomial, COLMAP's distorts; refitted, off by at most "
        f"{fit.largest_residual_px:.2g} px in the image"
    )
    return fit.camera


def _own_number(name: str) -> int:
    """Return the number that a name is, or 0; COLMAP's points are numbered from 1."""
    return int(name) if name.isascii() and name.isdecimal() and len(name) < 10 and str(int(name)) == name else 0


def _number_targets(names: Sequence[str]) -> dict[str, int]:
    """Keep numbers that are names already; the others follow the largest."""
    result = {name: _own_number(name) for name in names}
    following = max(result.values(), default=0)
    for name in names:
        if not result[name]:
            following += 1
            result[name] = following
    return result


def _images(
    file: Path, poses: dict[str, PhotoPose], camera_ids: dict[str, int], point_ids: dict[str, int]
) -> tuple[ColmapImage, ...]:
    columns = read_table_csv(file, ("image", "target", "x_px", "y_px"))
    try:
        pixels = np.array([columns["x_px"], columns["y_px"]], dtype=np.float64).T.reshape(-1, 2)
    except ValueError as error:
        raise InputError(f"{file}: x_px and y_px must be numbers ({error})") from error
    rows: dict[str, list[int]] = {name: [] for name in poses}
    for row, (image, target) in enumerate(zip(columns["image"], columns["target"], strict=True)):
        if image not in rows:
            raise InputError(f"{file}, line {row + 2}: image {image} has no pose in cameras.json; files of one run?")
        if target not in point_ids:
            raise InputError(f"{file}, line {row + 2}: target {target} has no coordinates in points.csv")
        rows[image].append(row)
    return tuple(
        ColmapImage(
            name,
            camera_ids[pose.camera],
            pose.cam_from_world,
            _choose(pixels, rows[name]),
            np.array([point_ids[columns["target"][row]] for row in rows[name]], dtype=np.intp),
        )
        for name, pose in poses.items()
    )


def _choose(pixels: FloatArray, rows: list[int]) -> FloatArray:
    return np.asarray(pixels[np.array(rows, dtype=np.intp)])
