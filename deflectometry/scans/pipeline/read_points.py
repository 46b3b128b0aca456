"""Points of scanners: CSV, PLY and E57, with or without normals."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from heliogauge.errors import InputError
from heliogauge.files.e57 import read_e57_columns
from heliogauge.files.ply import read_ply_columns
from heliogauge.results.tables import read_columns_csv, read_table_csv
from heliogauge.validate import FloatArray

PLACES, NORMALS = ("x_m", "y_m", "z_m"), ("normal_x", "normal_y", "normal_z")
#: Facets and panels are smaller; a mirror in millimetres is a thousand times as large [m].
_LARGEST_M = 100.0
_SMALLEST_M = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class ScannedPoints:
    """Points of a surface.

    points_m (n, 3): [m].
    normals (n, 3): Unit normals; None where the file has none.
    repeated: Points that stand in the file again: they count once.
    without_place: Rows of the file that have no place, or no normal among normals.
    """

    points_m: FloatArray
    normals: FloatArray | None
    repeated: int = 0
    without_place: int = 0


def read_points(file: Path, unit: str) -> ScannedPoints:
    """Read the points of a scan.

    unit: "m" or "mm", of PLY and E57; the columns of CSV name theirs.
    InputError: The file cannot be read, has no points, or they are in another unit.
    """
    suffix = file.suffix.lower()
    if suffix == ".csv":
        columns, size = _read_csv(file), 1.0
    elif suffix == ".ply":
        columns, size = read_ply_columns(file), _SIZES[unit]
    elif suffix == ".e57":
        columns, size = read_e57_columns(file), _SIZES[unit]
    else:
        raise InputError(f"{file}: points of CSV, PLY or E57 are needed")
    missing = [name for name in "xyz" if name not in columns]
    if missing:
        raise InputError(f"{file}: its points have no {', '.join(missing)}; x, y and z are needed")
    points = size * np.column_stack([columns[name] for name in "xyz"])
    normals = None
    if all(name in columns for name in ("nx", "ny", "nz")):
        normals = np.column_stack([columns[name] for name in ("nx", "ny", "nz")])
    good = np.isfinite(points).all(axis=1)
    if normals is not None:
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        good &= np.isfinite(normals).all(axis=1) & (length[:, 0] > 0)
        normals = (normals / np.where(length > 0, length, 1.0))[good]
    points = points[good]
    if len(points) == 0:
        raise InputError(f"{file}: there are no points with coordinates")
    reach = float(np.ptp(points, axis=0).max())
    if not _SMALLEST_M < reach < _LARGEST_M:
        words = "in millimetres" if reach >= _LARGEST_M else "in another unit"
        raise InputError(
            f"{file}: the points reach over {reach:.4g} m: are they {words}? Coordinates are in metres; of PLY and E57 "
            'unit = "mm" in [points] says otherwise'
        )
    _, first = np.unique(points if normals is None else np.hstack([points, normals]), axis=0, return_index=True)
    again, without = len(points) - first.size, int(np.count_nonzero(~good))
    return ScannedPoints(points[first], None if normals is None else normals[first], again, without)


_SIZES = {"m": 1.0, "mm": 1e-3}


def _read_csv(file: Path) -> dict[str, FloatArray]:
    known = read_table_csv(file, PLACES)
    names = (*PLACES, *(NORMALS if all(name in known for name in NORMALS) else ()))
    _, table = read_columns_csv(file, (), names)
    return dict(zip(("x", "y", "z", "nx", "ny", "nz"), (table[name] for name in names), strict=False))
