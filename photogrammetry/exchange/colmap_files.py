"""COLMAP models on disk, text and binary: cameras, images with their keypoints, points with their tracks."""

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from heliogauge.camera.formats import COLMAP_MODELS, from_colmap, to_colmap
from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.files.faults import explain_faults
from heliogauge.files.regular import read_regular
from heliogauge.files.texts import read_text
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.measurement.writer import write_text
from heliogauge.validate import FloatArray, IntArray, float_array

#: COLMAP's numbers of its camera models in binary files (its src/colmap/sensor/models.h).
_MODEL_IDS: dict[int, str] = {
    0: "SIMPLE_PINHOLE",
    1: "PINHOLE",
    2: "SIMPLE_RADIAL",
    3: "RADIAL",
    4: "OPENCV",
    5: "OPENCV_FISHEYE",
    6: "FULL_OPENCV",
    7: "FOV",
    8: "SIMPLE_RADIAL_FISHEYE",
    9: "RADIAL_FISHEYE",
    10: "THIN_PRISM_FISHEYE",
}
_FILES = ("cameras", "images", "points3D")
#: A keypoint without a point, as binary files write it.
_NO_POINT = 2**64 - 1
# COLMAP draws points in these colours; coordinates measured by us have none.
_GREY = (128, 128, 128)


@dataclass(frozen=True, slots=True, eq=False)
class ColmapImage:
    """One image of a model.

    name: Name of the file.
    cam_from_world: Pose.
    pixels_px (m, 2): Keypoints; the centre of the top-left pixel is (0, 0) [px].
    point_ids (m,): The point that each keypoint shows, -1 for none.
    InputError: Lengths differ.
    """

    name: str
    camera: int
    cam_from_world: RigidTransform
    pixels_px: FloatArray
    point_ids: IntArray

    def __post_init__(self) -> None:
        ids = np.array(self.point_ids, dtype=np.intp)
        ids.setflags(write=False)
        object.__setattr__(self, "pixels_px", float_array(f"keypoints of {self.name}", self.pixels_px, (ids.size, 2)))
        object.__setattr__(self, "point_ids", ids)


@dataclass(frozen=True, slots=True, eq=False)
class ColmapModel:
    """A COLMAP model; its pixel origin is already ours.

    points_m (3,): Points by number, in the model's unit [m].

    The format has no covariance. pycolmap computes some when asked; those are conditional (on the other points, on
    two cameras held fixed), far too small, and not taken over in either direction.
    """

    cameras: dict[int, Camera]
    images: tuple[ColmapImage, ...]
    points_m: dict[int, FloatArray]


def read_colmap(folder: Path) -> ColmapModel:
    """Read a COLMAP model.

    folder: Folder with cameras, images and points3D, all .txt or all .bin; binary is taken where both are there.
    InputError: A missing, cut or unreadable file, a camera model that is not Brown's, an image of a camera or a
        keypoint of a point that is not in the model, or a model without images or points.
    """
    suffix = _suffix(folder)
    with explain_faults(folder, "a model as COLMAP wrote it"):
        model = _read_binary(folder) if suffix == ".bin" else _read_text(folder)
    _check(folder, model)
    return model


def model_files(folder: Path) -> list[Path]:
    """Return the files that `read_colmap` reads.

    InputError: The model is not there whole.
    """
    return [folder / (name + _suffix(folder)) for name in _FILES]


def _suffix(folder: Path) -> str:
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; a COLMAP model is a folder, often called sparse/0")
    missing = {
        end: [name + end for name in _FILES if not (folder / (name + end)).is_file()] for end in (".bin", ".txt")
    }
    for end, absent in missing.items():
        if not absent:
            return end
    fewest = min(missing.values(), key=len)
    deeper = sorted(path.parent.name for path in folder.glob("*/cameras.*"))
    hint = f"; the folder {deeper[0]} in it holds one" if deeper else ""
    raise InputError(f"{folder}: no COLMAP model: {', '.join(fewest)} missing{hint}")


def _check(folder: Path, model: ColmapModel) -> None:
    if not model.images:
        raise InputError(f"{folder}: the model has no images")
    if not model.points_m:
        raise InputError(f"{folder}: the model has no points; nothing ties its images together")
    names: set[str] = set()
    for image in model.images:
        if image.camera not in model.cameras:
            raise InputError(f"{folder}: image {image.name} is of camera {image.camera}, which the model does not have")
        if image.name in names:
            raise InputError(f"{folder}: image {image.name} is there twice")
        names.add(image.name)
        unknown = [number for number in image.point_ids.tolist() if number >= 0 and number not in model.points_m]
        if unknown:
            raise InputError(f"{folder}: image {image.name} shows point {unknown[0]}, which the model does not have")


def _camera(folder: Path, number: int, model: str, size: tuple[int, int], parameters: Sequence[float]) -> Camera:
    try:
        return from_colmap(model, parameters, *size)
    except InputError as error:
        raise InputError(f"{folder}: camera {number}: {error}") from error


def _rotation(quaternion: FloatArray) -> FloatArray:
    """Return the rotation of a quaternion (w, x, y, z) that need not be of unit length."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _quaternion(pose: RigidTransform) -> FloatArray:
    vector = pose.rotation_vector_rad
    angle = float(np.linalg.norm(vector))
    # sinc is sin(pi x) / (pi x): exact also at rest.
    return np.array([np.cos(angle / 2), *(0.5 * np.sinc(angle / (2 * np.pi)) * vector)])


def _image(where: str, name: str, numbers: Sequence[float], camera: int, keypoints: FloatArray) -> ColmapImage:
    quaternion, shift = np.array(numbers[:4]), np.array(numbers[4:])
    if not (np.isfinite(quaternion).all() and quaternion.any() and np.isfinite(shift).all()):
        raise InputError(f"{where}: image {name}: the pose is no rotation and translation")
    pose = RigidTransform(_rotation(quaternion), shift)
    return ColmapImage(name, camera, pose, keypoints[:, :2] - 0.5, keypoints[:, 2].astype(np.intp))


def _rows(file: Path) -> Iterator[tuple[int, str]]:
    """Yield the lines of a text file that are no comments, with their numbers."""
    lines = read_text(file).splitlines()
    yield from ((number, line.strip()) for number, line in enumerate(lines, 1) if not line.startswith("#"))


def _read_text(folder: Path) -> ColmapModel:
    cameras, points = {}, {}
    for place, line in _rows(folder / "cameras.txt"):
        if line:
            number, model, width, height, *rest = _cells(folder / "cameras.txt", place, line, 5)
            values = _floats(folder / "cameras.txt", place, [number, width, height, *rest])
            cameras[int(values[0])] = _camera(
                folder, int(values[0]), model, (int(values[1]), int(values[2])), values[3:]
            )
    for place, line in _rows(folder / "points3D.txt"):
        if line:
            cells = _cells(folder / "points3D.txt", place, line, 8)
            values = _floats(folder / "points3D.txt", place, cells[:4])
            points[int(values[0])] = np.array(values[1:])
    return ColmapModel(cameras, tuple(_text_images(folder / "images.txt")), points)


def _text_images(file: Path) -> Iterator[ColmapImage]:
    # An image without keypoints has an empty second line; empty lines elsewhere mean nothing.
    lines = iter(_rows(file))
    for place, line in lines:
        if not line:
            continue
        cells = _cells(file, place, line, 10)
        values = _floats(file, place, cells[:9])
        below, keypoints = next(lines, (place + 1, ""))
        numbers = _floats(file, below, keypoints.split())
        if len(numbers) % 3:
            raise InputError(f"{file}, line {below}: keypoints are x, y, point; {len(numbers)} numbers are no threes")
        table = np.array(numbers, dtype=np.float64).reshape(-1, 3)
        yield _image(f"{file}, line {place}", " ".join(cells[9:]), values[1:8], int(values[8]), table)


def _cells(file: Path, place: int, line: str, least: int) -> list[str]:
    cells = line.split()
    if len(cells) < least:
        raise InputError(f"{file}, line {place}: {least} or more values are needed, not {len(cells)}; is the file cut?")
    return cells


def _floats(file: Path, place: int, cells: Sequence[str]) -> list[float]:
    try:
        return [float(cell) for cell in cells]
    except ValueError as error:
        raise InputError(f"{file}, line {place}: {error}") from error


class _Bytes:
    """A binary file, read from left to right."""

    def __init__(self, file: Path) -> None:
        self._file, self._content, self._place = file, read_regular(file, "a COLMAP file"), 0

    def take(self, form: str) -> tuple[Any, ...]:
        self._need(struct.calcsize("<" + form))
        values = struct.unpack_from("<" + form, self._content, self._place)
        self._place += struct.calcsize("<" + form)
        return values

    def table(self, dtype: np.dtype[Any], count: int) -> np.ndarray[Any, Any]:
        self._need(dtype.itemsize * count)
        values = np.frombuffer(self._content, dtype, count, self._place)
        self._place += dtype.itemsize * count
        return values

    def name(self) -> str:
        end = self._content.find(b"\0", self._place)
        if end < 0:
            raise InputError(f"{self._file}: the file is cut in a name")
        text = self._content[self._place : end].decode("utf-8", errors="replace")
        self._place = end + 1
        return text

    def _need(self, size: int) -> None:
        if self._place + size > len(self._content):
            raise InputError(f"{self._file}: the file is cut, or no binary COLMAP file ({len(self._content)} bytes)")


_KEYPOINT = np.dtype([("x", "<f8"), ("y", "<f8"), ("point", "<u8")])
_TRACK = np.dtype([("image", "<u4"), ("keypoint", "<u4")])


def _read_binary(folder: Path) -> ColmapModel:
    cameras: dict[int, Camera] = {}
    content = _Bytes(folder / "cameras.bin")
    for _ in range(content.take("Q")[0]):
        number, model_id, width, height = content.take("IiQQ")
        model = _MODEL_IDS.get(model_id, f"number {model_id}")
        # The length of a record follows from the model: nothing after an unknown one could be read.
        count = len(COLMAP_MODELS.get(model, ()))
        cameras[number] = _camera(folder, number, model, (width, height), content.take(f"{count}d"))
    images = []
    content = _Bytes(folder / "images.bin")
    for _ in range(content.take("Q")[0]):
        numbers = content.take("I7dI")
        name, (count,) = content.name(), content.take("Q")
        table = content.table(_KEYPOINT, count)
        ids = np.where(table["point"] == _NO_POINT, -1.0, table["point"].astype(np.float64))
        keypoints = np.column_stack([table["x"], table["y"], ids])
        images.append(_image(f"{folder / 'images.bin'}", name, numbers[1:8], numbers[8], keypoints))
    points = {}
    content = _Bytes(folder / "points3D.bin")
    for _ in range(content.take("Q")[0]):
        number, x, y, z, _r, _g, _b, _error, length = content.take("Q3d3BdQ")
        content.table(_TRACK, length)
        points[number] = np.array([x, y, z])
    return ColmapModel(cameras, tuple(images), points)


class _Lens(NamedTuple):
    """A camera as COLMAP has it: name of its model, and parameters."""

    model: str
    values: FloatArray


def write_colmap(folder: Path, model: ColmapModel, *, binary: bool = False) -> None:
    """Write a COLMAP model into an existing folder; no covariance, the format has none.

    binary: Whether as .bin instead of .txt.
    InputError: A camera that COLMAP cannot hold (see `heliogauge.camera.formats.to_colmap`), a name with white
        space in a text model, or a file that cannot be written.
    """
    tracks, errors = _tracks(model)
    lenses = {number: _Lens(*to_colmap(camera)) for number, camera in model.cameras.items()}
    if binary:
        parts = {
            "cameras.bin": _camera_bytes(model, lenses),
            "images.bin": _image_bytes(model),
            "points3D.bin": _point_bytes(model, tracks, errors),
        }
        for name, content in parts.items():
            try:
                (folder / name).write_bytes(content)
            except OSError as error:
                raise InputError(f"{folder / name}: cannot be written ({error.strerror or error})") from error
        return
    spaced = [image.name for image in model.images if image.name.split() != [image.name]]
    if spaced:
        raise InputError(
            f"{spaced[0]!r}: programs that read text models stop at white space in names; write a binary one"
        )
    write_text(folder / "cameras.txt", _camera_lines(model, lenses))
    write_text(folder / "images.txt", _image_lines(model))
    write_text(folder / "points3D.txt", _point_lines(model, tracks, errors))


def _tracks(model: ColmapModel) -> tuple[dict[int, list[tuple[int, int]]], dict[int, float]]:
    """Return where each point is seen (image number, keypoint) and the mean length of its residuals [px]."""
    tracks: dict[int, list[tuple[int, int]]] = {number: [] for number in model.points_m}
    lengths: dict[int, list[float]] = {number: [] for number in model.points_m}
    for place, image in enumerate(model.images, 1):
        shown = np.nonzero(image.point_ids >= 0)[0]
        if not shown.size:
            continue
        ids = image.point_ids[shown].tolist()
        points = image.cam_from_world.apply(np.array([model.points_m[number] for number in ids]))
        misses = np.hypot(*(model.cameras[image.camera].project(points) - image.pixels_px[shown]).T)
        for number, keypoint, miss in zip(ids, shown.tolist(), misses.tolist(), strict=True):
            tracks[number].append((place, keypoint))
            lengths[number].append(miss)
    return tracks, {number: float(np.mean(own)) if own else -1.0 for number, own in lengths.items()}


def _words(values: Sequence[float] | FloatArray) -> str:
    return " ".join(repr(float(value)) for value in values)


def _camera_lines(model: ColmapModel, lenses: Mapping[int, _Lens]) -> str:
    lines = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    for number, (name, values) in lenses.items():
        camera = model.cameras[number]
        lines.append(f"{number} {name} {camera.width_px} {camera.height_px} {_words(values)}")
    return "\n".join(lines) + "\n"


def _image_lines(model: ColmapModel) -> str:
    lines = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME", "# POINTS2D[] as (X, Y, POINT3D_ID)"]
    for place, image in enumerate(model.images, 1):
        pose = _words([*_quaternion(image.cam_from_world), *image.cam_from_world.translation_m])
        lines.append(f"{place} {pose} {image.camera} {image.name}")
        both = zip(image.pixels_px + 0.5, image.point_ids.tolist(), strict=True)
        lines.append(" ".join(f"{_words(pixel)} {number}" for pixel, number in both))
    return "\n".join(lines) + "\n"


def _point_lines(model: ColmapModel, tracks: Mapping[int, list[tuple[int, int]]], errors: Mapping[int, float]) -> str:
    lines = ["# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)"]
    grey = " ".join(str(value) for value in _GREY)
    for number, point in model.points_m.items():
        track = " ".join(f"{image} {keypoint}" for image, keypoint in tracks[number])
        lines.append(f"{number} {_words(point)} {grey} {errors[number]!r} {track}".rstrip())
    return "\n".join(lines) + "\n"


def _camera_bytes(model: ColmapModel, lenses: Mapping[int, _Lens]) -> bytes:
    ids = {name: number for number, name in _MODEL_IDS.items()}
    parts = [struct.pack("<Q", len(lenses))]
    for number, (name, values) in lenses.items():
        camera = model.cameras[number]
        head = (number, ids[name], camera.width_px, camera.height_px)
        parts.append(struct.pack(f"<IiQQ{len(values)}d", *head, *values))
    return b"".join(parts)


def _image_bytes(model: ColmapModel) -> bytes:
    parts = [struct.pack("<Q", len(model.images))]
    for place, image in enumerate(model.images, 1):
        pose = (*_quaternion(image.cam_from_world), *image.cam_from_world.translation_m)
        parts.append(struct.pack("<I7dI", place, *pose, image.camera))
        parts.append(image.name.encode() + b"\0" + struct.pack("<Q", image.point_ids.size))
        table = np.empty(image.point_ids.size, _KEYPOINT)
        table["x"], table["y"] = (image.pixels_px + 0.5).T
        table["point"] = image.point_ids.astype(np.int64).view(np.uint64)
        parts.append(table.tobytes())
    return b"".join(parts)


def _point_bytes(model: ColmapModel, tracks: Mapping[int, list[tuple[int, int]]], errors: Mapping[int, float]) -> bytes:
    parts = [struct.pack("<Q", len(model.points_m))]
    for number, point in model.points_m.items():
        track = tracks[number]
        parts.append(struct.pack("<Q3d3BdQ", number, *point, *_GREY, errors[number], len(track)))
        parts.append(np.array(track, dtype="<u4").tobytes())
    return b"".join(parts)
