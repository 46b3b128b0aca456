"""Points, cameras and poses on disk: ``points.csv``, ``camera.json``, ``cameras.json`` and other small tables."""

import operator
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from heliogauge.camera.distortion import BrownDistortion, DistortionDirection
from heliogauge.camera.model import PARAMETER_NAMES, Camera
from heliogauge.errors import InputError
from heliogauge.files.faults import explain_faults
from heliogauge.files.texts import MOST_CSV_BYTES, read_csv, read_text
from heliogauge.formula_cells import guarded_cell, plain_cell
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.results.json_file import read_json, write_json
from heliogauge.validate import FloatArray, covariance_matrix, float_array

CAMERA_SCHEMA = 1
#: Columns of so few different numbers are written from a list of their texts.
_FEW_VALUES = 16
#: Rows of a large table whose cells are held as texts together.
_ROWS_AT_ONCE = 16384

_OWN = ("focal_x_px", "focal_y_px", "center_x_px", "center_y_px")
_LENS = ("k1", "k2", "k3", "p1", "p2")
_OPTIONAL = ("skew", *_LENS, "distortion_direction", "covariance", "schema_version", "parameter_order", "sigma")


@dataclass(frozen=True, slots=True, eq=False)
class PointTable:
    """Measured points, as ``points.csv`` holds them.

    ids length n: Names.
    xyz_m (n, 3): Coordinates [m]; NaN where not determined.
    sigma_m (n, 3): Standard deviations [m].
    n_rays (n,): Rays that determine each point.
    flags (n,): Bits of `heliogauge.flags.SampleFlag`.
    InputError: Lengths differ.
    """

    ids: tuple[str, ...]
    xyz_m: FloatArray
    sigma_m: FloatArray
    n_rays: np.ndarray[Any, np.dtype[np.int64]]
    flags: np.ndarray[Any, np.dtype[np.uint32]]

    def __post_init__(self) -> None:
        object.__setattr__(self, "ids", tuple(self.ids))
        count = len(self.ids)
        for name in ("xyz_m", "sigma_m"):
            object.__setattr__(self, name, float_array(name, getattr(self, name), (count, 3), finite=False))
        for name, dtype in (("n_rays", np.int64), ("flags", np.uint32)):
            array = np.array(getattr(self, name), dtype=dtype)
            if array.shape != (count,):
                raise InputError(f"{name}: shape ({count},) is needed, not {array.shape}")
            array.setflags(write=False)
            object.__setattr__(self, name, array)


@dataclass(frozen=True, slots=True, eq=False)
class PhotoPose:
    """Where a camera stood for one photo.

    camera: Name of the camera.
    cam_from_world: World (mirror, object) frame to camera frame.
    covariance (6, 6): Covariance of the steps of `RigidTransform.moved`: rotation [rad], translation [m].
    residual_rms_px: RMS of the image residuals; None where there are none [px].
    """

    camera: str
    cam_from_world: RigidTransform
    covariance: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))
    residual_rms_px: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "covariance", covariance_matrix("pose covariance", self.covariance, 6))


def write_points_csv(path: Path, points: PointTable, unit: str = "m") -> None:
    """Write ``points.csv``; floats so that reading returns them bit for bit.

    unit: With what the names of columns of lengths end, where these are in another unit than metres.
    """
    columns: dict[str, Sequence[Any]] = {"id": points.ids}
    for index, axis in enumerate("xyz"):
        columns[f"{axis}_{unit}"] = points.xyz_m[:, index].tolist()
    for index, axis in enumerate("xyz"):
        columns[f"sigma_{axis}_{unit}"] = points.sigma_m[:, index].tolist()
    columns |= {"n_rays": points.n_rays.tolist(), "flag": points.flags.tolist()}
    write_table_csv(path, columns)


def read_points_csv(path: Path, unit: str = "m") -> PointTable:
    """Read ``points.csv``.

    unit: With what the names of columns of lengths end.
    """
    places, sigmas = ([f"{start}{axis}_{unit}" for axis in "xyz"] for start in ("", "sigma_"))
    with explain_faults(path, "a points.csv of heliogauge"):
        texts, values = read_columns_csv(path, ("id",), (*places, *sigmas, "n_rays", "flag"))
        return PointTable(
            ids=tuple(texts["id"]),
            xyz_m=np.column_stack([values[name] for name in places]),
            sigma_m=np.column_stack([values[name] for name in sigmas]),
            n_rays=values["n_rays"].astype(np.int64),
            flags=values["flag"].astype(np.uint32),
        )


def write_table_csv(path: Path, columns: Mapping[str, Sequence[Any] | npt.NDArray[Any]]) -> None:
    """Write columns of one length as CSV with a header line; NaN becomes an empty cell.

    A text that a spreadsheet would take for a formula stands behind an apostrophe (`guarded_cell`), which
    `read_table_csv` takes away again.

    columns: Columns by name, units in the names.
    InputError: Lengths differ, or the file cannot be written.
    """
    lines = table_lines(path.name, columns)
    try:
        with path.open("w", encoding="utf-8", newline="") as file:
            file.writelines(lines)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error})") from error


def table_lines(name: str, columns: Mapping[str, Sequence[Any] | npt.NDArray[Any]]) -> Iterator[str]:
    """Return the lines of a CSV file of some name, as `write_table_csv` writes them.

    columns: Columns by name, units in the names.
    InputError: Lengths differ.
    """
    lists = [_as_list(column) for column in columns.values()]
    if len({len(column) for column in lists}) > 1:
        sizes = ", ".join(f"{title} {len(column)}" for title, column in zip(columns, lists, strict=True))
        raise InputError(f"{name}: columns of one length are needed, not {sizes}")
    # One format for whole rows: a third of the time that the csv module takes.
    row = ",".join(["%s"] * len(lists)) + "\n"
    header = row % tuple(_csv_cell(str(title)) for title in columns)
    cells = [_csv_cells(column, alone=len(lists) == 1) for column in lists]
    return chain((header,), map(row.__mod__, zip(*cells, strict=True)))


def _as_list(column: Sequence[Any] | npt.NDArray[Any]) -> list[Any]:
    """Return a column with numbers of Python; texts stay as they are."""
    if isinstance(column, list) and set(map(type, column)) == {str}:
        return column
    return list(np.asarray(column).tolist())


def _csv_cells(column: list[Any], *, alone: bool) -> list[Any]:
    """Return cells whose text is what CSV needs; a row is never empty."""
    kinds = set(map(type, column))
    if kinds <= {int}:
        return column
    if kinds == {float}:
        # NaN is the one float that differs from itself; the text of the others is short enough to read them back.
        has_gaps = any(map(operator.ne, column, column))
        cells: list[Any] = ["" if cell != cell else cell for cell in column] if has_gaps else column
        # One sigma for all, as a rule: its text is made once. (Zero has two signs.)
        if len(set(column[:_FEW_VALUES])) == 1 and len(values := set(column)) <= _FEW_VALUES and 0.0 not in values:
            texts = {cell: str(cell) for cell in set(cells)}
            cells = [texts[cell] for cell in cells]
    elif kinds == {str}:
        # Names come many times.
        known = {cell: _csv_cell(cell) for cell in set(column)}
        cells = [known[cell] for cell in column]
    else:
        cells = [_csv_cell("" if cell is None or cell != cell else str(cell)) for cell in column]
    return ['""' if cell == "" else cell for cell in cells] if alone else cells


def _csv_cell(text: str) -> str:
    """Return a text as a cell that no spreadsheet computes, with the quotes that it needs."""
    text = guarded_cell(text)
    if any(mark in text for mark in ',"\r\n'):
        return '"' + text.replace('"', '""') + '"'
    return text


def read_table_csv(path: Path, needed: Sequence[str] = ()) -> dict[str, list[str]]:
    """Read a CSV file with a header line as columns of text.

    needed: Columns that must be there.
    """
    rows = read_csv(path)
    header = _texts(rows[0][1]) if rows else []
    twice = next((name for name in needed if header.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{path}: the column {twice!r} is there {header.count(twice)} times; keep one")
    missing = [name for name in needed if name not in header]
    if missing:
        other = next((sign for sign in (";", "\t") if len(header) == 1 and sign in header[0]), None)
        raise InputError(
            f"{path}: the columns {', '.join(missing)} are missing; there are: {', '.join(header) or 'none'}"
            + ("" if other is None else f"; cells are parted by {other!r}: save it with commas and decimal points")
        )
    body = [row for _, row in rows[1:]]
    if set(map(len, body)) - {len(header)}:
        number, cells = next((number, len(row)) for number, row in rows[1:] if len(row) != len(header))
        raise InputError(f"{path}, line {number}: {len(header)} cells are needed, not {cells}")
    # Column by column, each in one call: a third of the time of cell by cell.
    columns = zip(*body, strict=True) if body else [()] * len(header)
    return {name: _texts(column) for name, column in zip(header, columns, strict=True)}


def _texts(cells: Sequence[str]) -> list[str]:
    """Return what stands in cells, without blanks around it and without the apostrophe of `guarded_cell`."""
    texts = list(map(str.strip, cells))
    return list(map(plain_cell, texts)) if "'" in ",".join(texts) else texts


def read_number_columns(path: Path, names: tuple[str, ...]) -> FloatArray:
    """Read named columns of numbers from a CSV file.

    Shapes: result (n_names, n_rows).
    InputError: A missing column, or a cell that is not a finite number.
    """
    table = read_table_csv(path, names)
    try:
        values = [[float(cell) for cell in table[name]] for name in names]
    except ValueError as error:
        raise InputError(f"{path}: {', '.join(names)} must hold numbers ({error})") from error
    return float_array(f"{path}", values, (len(names), None))


def read_columns_csv(
    path: Path, texts: Sequence[str], numbers: Sequence[str], *, optional: Sequence[str] = ()
) -> tuple[dict[str, list[str]], dict[str, FloatArray]]:
    """Read some columns of a large table, the numbers as numbers: a quarter of the time of reading all cells as text.

    texts, numbers: Columns that must be there.
    optional: Columns of numbers that may be there.
    Returns: Columns of text, and of numbers with NaN for empty cells.
    """
    quick = _quick_columns(path, texts, numbers, optional)
    if quick is not None:
        return quick
    columns = read_table_csv(path, (*texts, *numbers))
    chosen = (*numbers, *(name for name in optional if name in columns))
    found = {name: _numbers(path, name, columns[name]) for name in chosen}
    return {name: columns[name] for name in texts}, found


def _quick_columns(
    path: Path, texts: Sequence[str], numbers: Sequence[str], optional: Sequence[str]
) -> tuple[dict[str, list[str]], dict[str, FloatArray]] | None:
    """Return columns of a table without quotes and gaps; None where the table is not so plain."""
    text = read_text(path, "a CSV file", MOST_CSV_BYTES)
    header, _, body = text.partition("\n")
    names = header.split(",")
    chosen = (*numbers, *(name for name in optional if name in names))
    wanted = (*texts, *chosen)
    # Apostrophes may guard texts, quotes may hold commas.
    if (
        not body
        or '"' in text
        or "'" in text
        or not set(wanted) <= set(names)
        or any(names.count(name) > 1 for name in wanted)
    ):
        return None
    content = body.rstrip("\n").encode() + b"\n"
    signs = np.frombuffer(content, dtype=np.uint8)
    ends, width = np.nonzero(signs == ord("\n"))[0], len(names)
    commas = np.searchsorted(np.nonzero(signs == ord(","))[0], ends)
    if (np.diff(commas, prepend=0) != width - 1).any():
        return None
    found_texts: dict[str, list[str]] = {name: [] for name in texts}
    found: dict[str, FloatArray] = {name: np.empty(ends.size) for name in chosen}
    # Some rows at a time: the cells of a large table as texts would take several times its memory.
    for first in range(0, ends.size, _ROWS_AT_ONCE):
        last = min(first + _ROWS_AT_ONCE, ends.size)
        begin = 0 if first == 0 else int(ends[first - 1]) + 1
        cells = content[begin : int(ends[last - 1])].decode().replace("\n", ",").split(",")
        for name in texts:
            found_texts[name] += map(str.strip, cells[names.index(name) :: width])
        try:
            for name in chosen:
                found[name][first:last] = list(map(float, cells[names.index(name) :: width]))
        except ValueError:
            # Empty cells, or no number.
            return None
    return found_texts, found


def _numbers(path: Path, name: str, cells: Sequence[str]) -> FloatArray:
    try:
        return np.array([float(cell) if cell else np.nan for cell in cells])
    except ValueError as error:
        raise InputError(f"{path}: column {name} must hold numbers ({error})") from error


def write_camera_json(path: Path, camera: Camera) -> None:
    """Write one camera, to be used as ``camera.json`` of a measurement."""
    write_json(path, {"schema_version": CAMERA_SCHEMA, **_camera_content(camera)})


def write_cameras_json(
    path: Path, cameras: Mapping[str, Camera], poses: Mapping[str, PhotoPose], unit: str = "m"
) -> None:
    """Write cameras and the pose of each photo (``cameras.json``).

    poses: Poses by the name of the photo (or of the facet whose pose was measured).
    unit: With what the names of lengths end, where these are in another unit than metres.
    InputError: A pose of a camera that is not given.
    """
    strangers = sorted({pose.camera for pose in poses.values()} - set(cameras))
    if strangers:
        raise InputError(f"{path.name}: poses of the cameras {', '.join(strangers)}, which are not given")
    content = {
        "schema_version": CAMERA_SCHEMA,
        "cameras": {name: _camera_content(camera) for name, camera in cameras.items()},
        "poses": {name: _pose_content(pose, unit) for name, pose in poses.items()},
    }
    write_json(path, content)


def read_camera_json(path: Path, name: str | None = None) -> Camera:
    """Read a camera from ``camera.json`` or from a ``cameras.json``.

    name: Name of the camera; not needed where the file holds one only.
    """
    with explain_faults(path, "a camera.json or cameras.json of heliogauge"):
        content = read_json(path)
        if "cameras" not in content:
            return _read_camera(path, content)
        cameras = content["cameras"]
        if name is None and len(cameras) != 1:
            raise InputError(f"{path}: holds {len(cameras)} cameras ({', '.join(cameras)}); one must be named")
        chosen = next(iter(cameras)) if name is None else name
        if chosen not in cameras:
            raise InputError(f"{path}: no camera {chosen!r}; there are: {', '.join(cameras)}")
        return _read_camera(path, cameras[chosen])


def read_cameras_json(path: Path, unit: str = "m") -> tuple[dict[str, Camera], dict[str, PhotoPose]]:
    """Read ``cameras.json``.

    unit: With what the names of lengths end.
    Returns: Cameras by name, poses by photo.
    """
    with explain_faults(path, "a cameras.json of heliogauge"):
        content = read_json(path)
        for key in ("cameras", "poses"):
            if key not in content:
                raise InputError(f"{path}: the key {key} is missing; a cameras.json written by heliogauge is needed")
        cameras = {name: _read_camera(path, camera) for name, camera in content["cameras"].items()}
        poses = {name: _read_pose(path, pose, unit) for name, pose in content["poses"].items()}
        for name, pose in poses.items():
            if pose.camera not in cameras:
                raise InputError(f"{path}: the camera {pose.camera!r} of photo {name} is not among the cameras")
        return cameras, poses


def _camera_content(camera: Camera) -> dict[str, Any]:
    lens = camera.distortion
    return {
        "width_px": camera.width_px,
        "height_px": camera.height_px,
        **{name: getattr(camera, name) for name in (*_OWN, "skew")},
        **{name: float(getattr(lens, name)) for name in _LENS},
        "distortion_direction": str(lens.direction),
        "parameter_order": list(PARAMETER_NAMES),
        "sigma": dict(zip(PARAMETER_NAMES, camera.sigma_parameters.tolist(), strict=True)),
        "covariance": camera.covariance.tolist(),
    }


def _read_camera(path: Path, content: Mapping[str, Any]) -> Camera:
    needed = ("width_px", "height_px", *_OWN)
    missing = [key for key in needed if key not in content]
    unknown = [key for key in content if key not in (*needed, *_OPTIONAL)]
    if missing or unknown:
        faults = [f"the keys {', '.join(missing)} are missing"] * bool(missing)
        faults += [f"the keys {', '.join(unknown)} are unknown"] * bool(unknown)
        raise InputError(f"{path}: {'; '.join(faults)}; a camera has {', '.join((*needed, *_OPTIONAL[:8]))}")
    if content.get("parameter_order", list(PARAMETER_NAMES)) != list(PARAMETER_NAMES):
        raise InputError(f"{path}: parameter_order must be {', '.join(PARAMETER_NAMES)} (the order of the covariance)")
    direction = content.get("distortion_direction", "ideal_to_measured")
    if direction not in list(DistortionDirection):
        raise InputError(
            f"{path}: distortion_direction {direction!r}: one of {', '.join(DistortionDirection)} is needed"
        )
    try:
        lens = {name: float(content.get(name, 0.0)) for name in _LENS}
        own = (
            float(content["focal_x_px"]),
            float(content["focal_y_px"]),
            float(content["center_x_px"]),
            float(content["center_y_px"]),
        )
        sizes = (int(content["width_px"]), int(content["height_px"]))
        skew = float(content.get("skew", 0.0))
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: a camera's values must be numbers ({error})") from error
    distortion = BrownDistortion(**lens, direction=DistortionDirection(direction))
    covariance = content.get("covariance", np.zeros((10, 10)))
    return Camera(*sizes, *own, skew, distortion, covariance)


def _pose_content(pose: PhotoPose, unit: str) -> dict[str, Any]:
    sigma = np.sqrt(np.diag(pose.covariance)).tolist()
    transform = pose.cam_from_world
    return {
        "camera": pose.camera,
        "cam_from_world": {
            "rotation_vector_rad": transform.rotation_vector_rad.tolist(),
            f"translation_{unit}": transform.translation_m.tolist(),
        },
        "sigma_rotation_rad": sigma[:3],
        f"sigma_translation_{unit}": sigma[3:],
        f"covariance_rad_{unit}": pose.covariance.tolist(),
        "residual_rms_px": pose.residual_rms_px,
    }


def _read_pose(path: Path, content: Mapping[str, Any], unit: str) -> PhotoPose:
    try:
        transform = content["cam_from_world"]
        cam_from_world = RigidTransform.from_rotation_vector(
            transform["rotation_vector_rad"], transform[f"translation_{unit}"]
        )
        residual = content["residual_rms_px"]
        return PhotoPose(str(content["camera"]), cam_from_world, content[f"covariance_rad_{unit}"], residual)
    except (KeyError, TypeError) as error:
        raise InputError(f"{path}: a pose lacks {error}; a cameras.json written by heliogauge is needed") from error
