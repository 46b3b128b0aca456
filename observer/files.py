"""Files of a trough's results beside its slope map: angles, the collector, slices and a photo to look at."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.images.photos import read_image
from heliogauge.results.arrays import LabelledArray, read_arrays, write_arrays
from heliogauge.results.folder import write_json
from heliogauge.results.json_file import read_json
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray
from observer.pipeline.slices import Overlay, Slices
from observer.product.slope_map import AngleMaps
from observer.trough.collector import Collector, GlassTube

ANGLES = "angles.nc"
COLLECTOR = "collector.json"
SLICES = "absorber_reflection.nc"
OVERLAY = "reflection_overlay.nc"
OVERLAY_PHOTO = "reflection_overlay.jpg"

_SIGN = "theta_ra = theta_r + theta_a; theta_r positive where the normal is turned towards +x"
_X = "across the aperture"
_Y = "along the trough"


def write_angles(path: Path, slope_map: SlopeMap, angles: AngleMaps) -> None:
    """Write the angles in which troughs are spoken of.

    slope_map: Gives the nodes and their sigma.
    """
    axes = ("y", "x")
    # d theta_r / d slope = -1 / (1 + slope^2)
    sigma = slope_map.sigma_slope()[0] / (1 + slope_map.slope_x**2)
    fields = {
        "theta_ra": (angles.theta_ra_rad, "reflector-absorber angle"),
        "theta_r": (angles.theta_r_rad, "slope error across the trough"),
        "theta_a": (angles.theta_a_rad, "what the displaced absorber looks like"),
        "sigma_theta_r": (sigma, "standard deviation of theta_r"),
        "sigma_theta_ra": (angles.sigma_theta_ra_rad, "standard deviation of theta_ra, cameras and absorber included"),
        "sigma_theta_a": (angles.sigma_theta_a_rad, "standard deviation of theta_a"),
    }
    # float32 keeps 0.3 nrad of 5 mrad at half the bytes.
    maps = [
        LabelledArray(name, axes, values.astype(np.float32), "rad", text) for name, (values, text) in fields.items()
    ]
    coordinates = [
        LabelledArray("y", ("y",), slope_map.y_m, "m", _Y),
        LabelledArray("x", ("x",), slope_map.x_m, "m", _X),
    ]
    write_arrays(
        path, [*coordinates, *maps], {"sign": _SIGN, "design": slope_map.design, "frame": slope_map.frame}
    )  # fmt: skip


def write_collector(path: Path, collector: Collector) -> None:
    """Write the design."""
    content: dict[str, Any] = {}
    for name in Collector.__slots__:
        value = getattr(collector, name)
        content[name] = value.tolist() if isinstance(value, np.ndarray) else value
    if collector.glass is not None:
        content["glass"] = {name: getattr(collector.glass, name) for name in GlassTube.__slots__}
    write_json(path, content)


def read_collector(path: Path) -> Collector:
    """Read the design."""
    content = read_json(path)
    try:
        glass = content.pop("glass")
        return Collector(**content, glass=None if glass is None else GlassTube(**glass))
    except (KeyError, TypeError) as error:
        raise InputError(f"{path}: not the design of a trough ({error})") from error


def write_slices(path: Path, slices: Slices, eyes_m: FloatArray, names: Sequence[str]) -> None:
    """Write slices of the mirror through all photos.

    Shapes: eyes_m (k, 3).
    """
    # One byte for each sample: more than an eye tells apart. 0 is what a photo does not show.
    brightest = max(float(np.nanmax(slices.brightness_dn, initial=1.0)), 1.0)
    level = 1 + 254 * np.clip(slices.brightness_dn / brightest, 0, 1)
    stored = np.where(np.isfinite(level), level, 0).round().astype(np.uint8)
    photos = np.arange(len(names), dtype=np.int32)
    cameras = [
        LabelledArray(f"camera_{axis}", ("photo",), eyes_m[:, place], "m", f"camera, {axis}")
        for place, axis in enumerate("xyz")
    ]
    write_arrays(path, [
        LabelledArray("y", ("y",), slices.y_m, "m", _Y),
        LabelledArray("photo", ("photo",), photos, "1", "number of the photo, see the attribute photos"),
        LabelledArray("x", ("x",), slices.x_m, "m", _X),
        *cameras,
        LabelledArray("brightness", ("y", "photo", "x"), stored, "1", "brightness, 255 the brightest; 0: not seen"),
    ], {"photos": list(names), "brightest_dn": brightest})  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class StoredSlices:
    """Slices as read: brightness 255 is the brightest, 0 not seen.

    y_m, x_m: Rows and columns [m].
    eyes_m (k, 3): The cameras [m].
    brightness (s, k, n): By slice, photo, column.
    photos: Their names.
    """

    y_m: FloatArray
    x_m: FloatArray
    eyes_m: FloatArray
    brightness: npt.NDArray[np.uint8]
    photos: list[str]


def read_slices(path: Path) -> StoredSlices:
    """Read slices."""
    found, attributes = read_arrays(path, ("x", "y", "camera_x", "camera_y", "camera_z", "brightness"))
    eyes = np.stack([found[f"camera_{axis}"] for axis in "xyz"], axis=1)
    return StoredSlices(found["y"], found["x"], eyes, found["brightness"], list(attributes["photos"]))


def write_overlay(folder: Path, overlay: Overlay, photo: str) -> None:
    """Write a photo and where the reflection is expected in it.

    folder: Gets a JPEG image and a file with the nodes.
    photo: The photo's name.
    """
    ny, nx = overlay.beside_design_rad.shape
    axes = ("row", "column")
    fields = {
        "x_px": (overlay.pixels[..., 0], "px", "node in the image, from the left"),
        "y_px": (overlay.pixels[..., 1], "px", "node in the image, from the top"),
        "beside_design": (overlay.beside_design_rad, "rad",
                          "angle by which the reflected line of sight misses the tube, mirror and tube as designed"),
        "beside_measured": (overlay.beside_measured_rad, "rad", "the same, mirror and tube as measured"),
    }  # fmt: skip
    nodes = [
        LabelledArray(name, axes, values.astype(np.float32), unit, text)
        for name, (values, unit, text) in fields.items()
    ]
    coordinates = [
        LabelledArray("row", ("row",), np.arange(ny, dtype=np.int32), "1", "row of nodes, along the trough"),
        LabelledArray("column", ("column",), np.arange(nx, dtype=np.int32), "1", "column of nodes, across"),
    ]
    write_arrays(folder / OVERLAY, [*coordinates, *nodes], {"photo": photo})
    image = overlay.image_dn.astype(np.float32)
    brightest = max(float(np.percentile(image, 99.9)), 1.0)
    grey = np.clip(255 * image / brightest, 0, 255).astype(np.uint8)
    _, coded = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, 88])
    try:
        (folder / OVERLAY_PHOTO).write_bytes(coded.tobytes())
    except OSError as error:
        raise InputError(f"{folder / OVERLAY_PHOTO}: cannot be written ({error.strerror or error})") from error


def read_overlay(folder: Path) -> tuple[npt.NDArray[Any], dict[str, npt.NDArray[Any]], str]:
    """Read a photo and where the reflection is expected in it.

    Shapes: image (height, width).
    nodes (ny, nx): ``x_px``, ``y_px``, ``beside_design``, ``beside_measured``.
    """
    nodes, attributes = read_arrays(folder / OVERLAY, ("x_px", "y_px", "beside_design", "beside_measured"))
    return read_image(folder / OVERLAY_PHOTO), nodes, str(attributes["photo"])
