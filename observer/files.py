"""Files of a trough's results beside its slope map: angles, the collector, slices and a photo to look at."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.images.photos import read_image
from heliogauge.results.arrays import LabelledArray, read_arrays, write_arrays
from heliogauge.results.folder import write_json
from heliogauge.results.json_file import read_json
from heliogauge.results.tables import read_table_csv
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray
from observer.product.pictures import Overlay, Slices
from observer.product.slope_map import AngleMaps
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector, GlassTube

ANGLES = "angles.nc"
COLLECTOR = "collector.json"
SLICES = "absorber_reflection.nc"
OVERLAY = "reflection_overlay.nc"
OVERLAY_PHOTO = "reflection_overlay.jpg"
#: Cameras and targets, in the form of a photogrammetry measurement; `heliogauge report` makes their report.
NETWORK_FOLDER = "network"
#: Studies of finished measurements: modules side by side, panels aligned, several orientations.
OVERVIEW_TABLE, OVERVIEW_MAPS, OVERVIEW_LOOPS = "overview.csv", "overview.nc", "loops.csv"
OVERVIEW_TURNS = "panels_to_turn.csv"
ALIGNMENT_OVERLAY, ALIGNMENT_MOVES = "overlay.svg", "mounts.svg"
#: Pictures of single photos begin so.
OVERLAY_STEM = "overlay_"
ORIENTATION_PROFILES, ORIENTATION_SAGS, ORIENTATION_CHANGES = "profiles.csv", "sags.csv", "theta_r_change.nc"
CHANGED_NUMBERS, CHANGED_PANELS = "changed_numbers.csv", "changed_panels.csv"
CHANGED_MODULES = "changed_modules.csv"

#: Columns of a table that says where the absorber is.
ABSORBER_COLUMNS = ("y_m", "x_a_m", "z_a_m", "sigma_x_a_m", "sigma_z_a_m")

_SIGN = "theta_ra = theta_r + theta_a; theta_r positive where the normal is turned towards +x"
_X = "across the aperture"
_Y = "along the trough"


def is_field(folder: Path) -> bool:
    """Return whether a folder holds the results of several modules."""
    return (folder / OVERVIEW_TABLE).is_file()


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
    write_arrays(path, [*coordinates, *maps], {"sign": _SIGN, "design": slope_map.design, "frame": slope_map.frame})


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
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: not the design of a trough ({error}); measure it again, or copy the file") from error


def write_slices(path: Path, slices: Slices, eyes_m: FloatArray, names: Sequence[str]) -> None:
    """Write slices of the mirror through all photos.

    Shapes: eyes_m (k, 3).
    """
    # One byte for each sample: more than an eye distinguishes. 0 is what a photo does not show.
    brightest = max(float(np.nanmax(slices.brightness_dn, initial=1.0)), 1.0)
    level = 1 + 254 * np.clip(slices.brightness_dn / brightest, 0, 1)
    stored = np.where(np.isfinite(level), level, 0).round().astype(np.uint8)
    photos = np.arange(len(names), dtype=np.int32)
    cameras = [
        LabelledArray(f"camera_{axis}", ("photo",), eyes_m[:, place], "m", f"camera, {axis}")
        for place, axis in enumerate("xyz")
    ]
    write_arrays(
        path,
        [
            LabelledArray("y", ("y",), slices.y_m, "m", _Y),
            LabelledArray("photo", ("photo",), photos, "1", "number of the photo, see the attribute photos"),
            LabelledArray("x", ("x",), slices.x_m, "m", _X),
            *cameras,
            LabelledArray("brightness", ("y", "photo", "x"), stored, "1", "brightness, 255 the brightest; 0: not seen"),
        ],
        {"photos": list(names), "brightest_dn": brightest},
    )


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
        "beside_design": (
            overlay.beside_design_rad,
            "rad",
            "angle by which the reflected line of sight misses the tube, mirror and tube as designed",
        ),
        "beside_measured": (overlay.beside_measured_rad, "rad", "the same, mirror and tube as measured"),
    }
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


class StoredOverlay(NamedTuple):
    """A photo and where the reflection is expected in it, as read.

    image (height, width): The part of the photo that shows the mirror.
    nodes (ny, nx): ``x_px``, ``y_px``, ``beside_design``, ``beside_measured``.
    photo: The photo's name.
    """

    image: npt.NDArray[Any]
    nodes: dict[str, npt.NDArray[Any]]
    photo: str


def read_overlay(folder: Path) -> StoredOverlay:
    """Read a photo and where the reflection is expected in it.

    InputError: A file is missing or damaged.
    """
    nodes, attributes = read_arrays(folder / OVERLAY, ("x_px", "y_px", "beside_design", "beside_measured"))
    shapes = {name: nodes[name].shape for name in ("x_px", "y_px", "beside_design", "beside_measured")}
    if len(set(shapes.values())) > 1 or nodes["x_px"].ndim != 2:
        raise InputError(f"{folder / OVERLAY}: four fields on one grid are needed, not {shapes}; the file is damaged")
    return StoredOverlay(read_image(folder / OVERLAY_PHOTO), nodes, str(attributes["photo"]))


def number_in_cell(path: Path, line: int, name: str, cell: str) -> float | None:
    """Return the number in a cell of a table; None where it is empty or not finite.

    InputError: It is not a number.
    """
    if cell == "":
        return None
    try:
        value = float(cell)
    except ValueError:
        raise InputError(
            f"{path}, line {line}: {name} = {cell!r} is not a number; is the decimal sign a point?"
        ) from None
    return value if np.isfinite(value) else None


def is_number(cell: str) -> bool:
    """Return whether a cell of a table holds a finite number."""
    try:
        return bool(np.isfinite(float(cell)))
    except ValueError:
        return False


def read_absorber(path: Path) -> AbsorberPath:
    """Read where the absorber is, from the ``absorber.csv`` of a result.

    InputError: Missing columns or cells that are not numbers.
    """
    return absorber_of_table(read_table_csv(path, ABSORBER_COLUMNS), path)


def absorber_of_table(table: Mapping[str, Sequence[str]], path: Path) -> AbsorberPath:
    """Return where the absorber is as a table with `ABSORBER_COLUMNS` says.

    path: Where the table was read, for messages.
    Returns: The axis; its stations are taken as independent of each other.
    InputError: Cells that are not numbers.
    """
    rows: list[list[float]] = []
    for line in range(2, len(table["y_m"]) + 2):
        values = [number_in_cell(path, line, name, table[name][line - 2]) for name in ABSORBER_COLUMNS]
        # A station that was not measured has empty cells.
        if None not in values:
            rows.append([float(value) for value in values if value is not None])
    if not rows:
        raise InputError(f"{path}: no row is complete; the columns {', '.join(ABSORBER_COLUMNS)} are needed")
    columns: FloatArray = np.array(rows).T
    covariance = np.diag(np.square(np.concatenate([columns[3], columns[4]])))
    return AbsorberPath(columns[0], columns[1], columns[2], covariance)


@dataclass(frozen=True, slots=True, eq=False)
class ModuleMap:
    """One module's map.

    x_m, y_m (nx,): Nodes in its own frame [m].
    theta_ra_rad, theta_r_rad (ny, nx): Angles; NaN where not measured [rad].
    """

    name: str
    x_m: FloatArray
    y_m: FloatArray
    theta_ra_rad: FloatArray
    theta_r_rad: FloatArray


def write_maps(path: Path, maps: Sequence[ModuleMap]) -> None:
    """Write the maps of all modules into one file.

    maps: The modules, each with nodes of its own.
    """
    arrays: list[LabelledArray] = []
    for k, one in enumerate(maps):
        axes = (f"y_{k}", f"x_{k}")
        arrays += [
            LabelledArray(axes[0], axes[:1], one.y_m, "m", "along the trough"),
            LabelledArray(axes[1], axes[1:], one.x_m, "m", "across the aperture"),
            LabelledArray(f"theta_ra_{k}", axes, one.theta_ra_rad.astype(np.float32), "rad", f"{one.name}: theta_ra"),
            LabelledArray(f"theta_r_{k}", axes, one.theta_r_rad.astype(np.float32), "rad", f"{one.name}: theta_r"),
        ]
    write_arrays(path, arrays, {"modules": [one.name for one in maps]})


def read_maps(path: Path) -> list[ModuleMap]:
    """Read the maps of all modules."""
    found, attributes = read_arrays(path)
    return [
        ModuleMap(str(name), *(found[f"{key}_{k}"].astype(np.float64) for key in ("x", "y", "theta_ra", "theta_r")))
        for k, name in enumerate(attributes["modules"])
    ]
