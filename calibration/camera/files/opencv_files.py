"""Cameras that OpenCV wrote (``cv2.FileStorage``: YAML, XML or JSON), and what goes to OpenCV and COLMAP."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from calibration.camera.files.result_folder import colmap_text, opencv_yaml
from heliogauge.camera.formats import from_opencv
from heliogauge.camera.model import PARAMETER_NAMES, Camera
from heliogauge.errors import InputError
from heliogauge.files.texts import read_text
from heliogauge.measurement.imported import IMPORTED, write_imported
from heliogauge.measurement.writer import write_text
from heliogauge.results.tables import read_camera_json, write_cameras_json
from heliogauge.results.whole_folder import WholeFolder
from heliogauge.validate import FloatArray

CAMERAS_FILE = "cameras.json"
#: A camera is a few numbers; larger files are something else.
_MOST_BYTES = 20_000_000
_MATRIX = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "intrinsic_matrix", "K", "M1", "mtx")
_DISTORTION = (
    "distortion_coefficients",
    "Distortion_Coefficients",
    "distCoeffs",
    "dist_coeffs",
    "dist_coeff",
    "distortion",
    "D",
    "D1",
    "dist",
)
_WIDTH, _HEIGHT = ("image_width", "image_Width", "width"), ("image_height", "image_Height", "height")
_SIZE = ("image_size", "imageSize", "img_size", "resolution")
#: Keys that name the model of the lens, and words of those that are not Brown's.
_LENS = ("distortion_model", "distortionModel")
_FISHEYE = ("fisheye", "equidistant", "kannala", "fov", "omni")
#: fx, fy, cx, cy, k1, k2, p1, p2, k3 as of ``cv2.calibrateCameraExtended``.
_SIGMA = ("standard_deviations", "std_deviations_intrinsics", "stdDeviationsIntrinsics")
_SIGMA_NAMES = tuple(name for name in PARAMETER_NAMES if name != "skew")


def read_opencv_camera(file: Path, size_px: tuple[int, int] | None = None) -> Camera:
    """Read a camera that OpenCV, or a program that uses it, wrote.

    file: YAML, XML or JSON with the matrix, the coefficients of distortion and the size of the image.
    size_px: Width and height of the image where the file does not have them [px].
    Returns: The camera; with a covariance where the file has standard deviations.
    InputError: The file cannot be read, is of another model of a lens, or lacks something.
    """
    storage = _open(file)
    try:
        matrix = _numbers(storage, _MATRIX)
        if matrix is None or matrix.size != 9:
            raise InputError(f"{file}: no camera matrix of 3 x 3 numbers; one of {', '.join(_MATRIX)} is needed")
        if _is_fisheye(storage):
            raise InputError(f"{file}: a fisheye lens; calibrate with Brown's model (k1, k2, p1, p2, k3)")
        distortion, sigma = _numbers(storage, _DISTORTION), _numbers(storage, _SIGMA)
        size = size_px or _size(storage)
    finally:
        storage.release()
    if size is None:
        raise InputError(f"{file}: the size of the image is not in the file; give width_px and height_px")
    try:
        camera = from_opencv(matrix.reshape(3, 3), distortion, size)
        return camera if sigma is None else _with_sigma(camera, sigma)
    except InputError as error:
        raise InputError(f"{file}: {error}") from None


def import_opencv(
    files: Sequence[Path], folder: Path, *, size_px: tuple[int, int] | None = None, force: bool = False
) -> tuple[str, ...]:
    """Write a folder with cameras.json from files that OpenCV wrote.

    files: One for each camera; its name is that of the file.
    size_px: Width and height of the images where the files do not have them [px].
    force: Replace a folder that was imported earlier.
    Returns: What was taken over, in lines to print.
    InputError: A file cannot be read, two have one name, or the folder is in use.
    """
    cameras: dict[str, Camera] = {}
    for file in files:
        if file.stem in cameras:
            raise InputError(f"{file}: another file is called {file.stem}, too; each camera needs its own name")
        cameras[file.stem] = read_opencv_camera(file, size_px)
    with WholeFolder(folder, IMPORTED, force=force) as working:
        write_cameras_json(working / CAMERAS_FILE, cameras, {})
        write_imported(working, "opencv", files)
    return tuple(_line(name, camera) for name, camera in cameras.items())


def read_calibrated(path: Path, name: str | None = None) -> Camera:
    """Read a camera from a folder of results, or from cameras.json or camera.json.

    name: Which of several cameras.
    InputError: There is none, or none of that name.
    """
    file = path / CAMERAS_FILE if path.is_dir() else path
    if not file.is_file():
        raise InputError(f"{file}: there is no such file; give results of `heliogauge camera measure`, or cameras.json")
    return read_camera_json(file, name)


def export_camera(result: Path, out: Path, form: str, *, name: str | None = None, force: bool = False) -> None:
    """Write a camera as OpenCV or COLMAP read it.

    result: Folder of results, or cameras.json.
    out: The file.
    form: "opencv" (YAML as of ``cv2.FileStorage``) or "colmap" (cameras.txt).
    name: Which of several cameras.
    force: Replace a file that is there.
    InputError: There is no such camera, that program's model does not hold it, or the file cannot be written.
    """
    text = {"opencv": opencv_yaml, "colmap": colmap_text}[form](read_calibrated(result, name))
    if out.is_dir():
        raise InputError(
            f"{out}: a folder; name a file, such as {out / ('camera.yaml', 'cameras.txt')[form == 'colmap']}"
        )
    if out.exists() and not force:
        raise InputError(f"{out}: the file exists already; choose another name or give force=True to replace it")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out}: no folder can be made there ({error.strerror or error})") from error
    write_text(out, text)


def _open(file: Path) -> Any:
    text = read_text(file, "a file of OpenCV's YAML, XML or JSON", _MOST_BYTES)
    if text.startswith("%YAML 1"):
        # Other programs write a space where OpenCV expects a colon.
        text = text.replace("%YAML 1", "%YAML:1", 1)
    elif not text.lstrip().startswith(("%YAML", "<?xml", "{")):
        text = "%YAML:1.0\n---\n" + text
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        if storage.isOpened():
            return storage
    except (cv2.error, SystemError) as error:
        raise InputError(f"{file}: OpenCV cannot read it; YAML, XML or JSON of cv2.FileStorage is needed") from error
    raise InputError(f"{file}: OpenCV cannot read it; YAML, XML or JSON of cv2.FileStorage is needed")


def _numbers(storage: Any, names: Sequence[str]) -> FloatArray | None:
    """Return the numbers of the first of some keys that is there: a matrix, a list, or lists in a list.

    InputError: Something there is no number.
    """
    for name in names:
        node = storage.getNode(name)
        if node.empty() or node.isNone():
            continue
        values = np.array(list(_leaves(node)), dtype=np.float64)
        if not np.isfinite(values).all():
            raise InputError(f"{name}: something in it is no number; correct it")
        if values.size:
            return values
    return None


def _leaves(node: Any) -> Iterator[float]:
    if node.isMap() and not node.getNode("data").empty():
        yield from _leaves(node.getNode("data"))
    elif node.isSeq():
        for index in range(node.size()):
            yield from _leaves(node.at(index))
    elif node.isReal() or node.isInt():
        yield float(node.real())
    else:
        yield np.nan


def _is_fisheye(storage: Any) -> bool:
    """Whether a flag says so, as OpenCV's programs write it, or a name of the model, as ROS does."""
    flags = [_numbers(storage, [name]) for name in ("fisheye_model", "fisheye")]
    nodes = [storage.getNode(name) for name in _LENS]
    words = " ".join(str(node.string()).casefold() for node in nodes if node.isString())
    return any(one is not None and one.any() for one in flags) or any(word in words for word in _FISHEYE)


def _size(storage: Any) -> tuple[int, int] | None:
    width, height, both = (_numbers(storage, names) for names in (_WIDTH, _HEIGHT, _SIZE))
    if width is not None and height is not None and width.size == height.size == 1:
        return int(width[0]), int(height[0])
    return None if both is None or both.size != 2 else (int(both[0]), int(both[1]))


def _with_sigma(camera: Camera, sigma: FloatArray) -> Camera:
    """Return a camera with the standard deviations of its parameters; OpenCV knows no correlation."""
    from dataclasses import replace

    wanted = len(_SIGMA_NAMES)
    if sigma.size < wanted or (sigma < 0).any():
        raise InputError(f"standard deviations: {wanted} of {', '.join(_SIGMA_NAMES)} are needed, none negative")
    known = dict(zip(_SIGMA_NAMES, sigma[:wanted].tolist(), strict=True))
    return replace(camera, covariance=np.diag([known.get(name, 0.0) ** 2 for name in PARAMETER_NAMES]))


def _line(name: str, camera: Camera) -> str:
    lens = camera.distortion.polynomial._asdict()
    used = ", ".join(f"{term} = {value:.4g}" for term, value in lens.items() if value) or "no distortion"
    return (
        f"{name}: {camera.width_px} x {camera.height_px} px, focal length {camera.focal_x_px:.6g} x "
        f"{camera.focal_y_px:.6g} px, centre ({camera.center_x_px:.6g}, {camera.center_y_px:.6g}) px, {used}"
    )
