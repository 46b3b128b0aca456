"""Tables of control points, scale bars and coordinates that a photogrammetric measurement.toml names."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from heliogauge.errors import InputError
from heliogauge.measurement.models import Section, repeated
from photogrammetry.keys.measurement import (
    ControlPointSection,
    CoordinateSection,
    PhotogrammetryModel,
    ScaleBarSection,
)

CONTROL_POINT_COLUMNS = ("target", "x_m", "y_m", "z_m")
CONTROL_POINT_SIGMAS = ("sigma_x_mm", "sigma_y_mm", "sigma_z_mm")
SCALE_BAR_COLUMNS = ("a", "b", "length_m", "sigma_mm")
COORDINATE_COLUMNS = ("target", "axis", "value_m", "sigma_mm")

_Cells = dict[str, str]
_Kind = TypeVar("_Kind", bound=Section)


def with_known_files(model: PhotogrammetryModel, folder: Path) -> PhotogrammetryModel:
    """Add the tables of ``[files]`` to the model.

    Returns: The same with the tables' rows appended: ``control_points`` with the columns target, x_m, y_m, z_m and,
        if they are not exact, sigma_x_mm, sigma_y_mm, sigma_z_mm; ``scale_bars`` with a, b, length_m, sigma_mm and,
        if wanted, check_only (0 or 1); ``coordinates`` with target, axis, value_m, sigma_mm.
    InputError: A file that is not there, a missing column, a value that cannot be meant (with its line), or a
        control point that is given twice.
    """
    files = model.files
    more: dict[str, Any] = {}
    if files.control_points is not None:
        path = folder / files.control_points
        more["control_point"] = (
            *model.control_point,
            *_rows(path, CONTROL_POINT_COLUMNS, _control_point, ControlPointSection),
        )
        if (twice := repeated(one.target for one in more["control_point"])) is not None:
            raise InputError(f"{path}: control point {twice} is given twice; keep one")
    if files.scale_bars is not None:
        bars = _rows(folder / files.scale_bars, SCALE_BAR_COLUMNS, _scale_bar, ScaleBarSection)
        more["scale_bar"] = (*model.scale_bar, *bars)
    if files.coordinates is not None:
        known = _rows(folder / files.coordinates, COORDINATE_COLUMNS, _coordinate, CoordinateSection)
        more["constraint"] = (*model.constraint, *known)
    return model.model_copy(update=more)


def _rows(
    path: Path, columns: tuple[str, ...], content: Callable[[_Cells], dict[str, Any]], kind: type[_Kind]
) -> tuple[_Kind, ...]:
    # Most measurements name no tables: numpy and the cameras would double the time of reading the file.
    from heliogauge.results.tables import read_table_csv

    table = read_table_csv(path, columns)
    found = []
    for line, cells in enumerate(zip(*table.values(), strict=True), start=2):
        row = dict(zip(table, cells, strict=True))
        try:
            found.append(kind.model_validate(content(row)))
        except ValidationError as error:
            fault = error.errors(include_url=False)[0]
            place = ".".join(str(part) for part in fault["loc"])
            raise InputError(f"{path}, line {line}: {place}: {fault['msg']}") from None
        except ValueError as error:
            raise InputError(f"{path}, line {line}: {error}; is the decimal sign a point?") from None
    return tuple(found)


def _control_point(row: _Cells) -> dict[str, Any]:
    sigmas = [float(row.get(name) or 0.0) for name in CONTROL_POINT_SIGMAS]
    return {
        "target": row["target"],
        "xyz_m": [float(row[name]) for name in CONTROL_POINT_COLUMNS[1:]],
        "sigma_mm": sigmas,
    }


def _scale_bar(row: _Cells) -> dict[str, Any]:
    words = {"": False, "0": False, "false": False, "1": True, "true": True}
    said = row.get("check_only", "").lower()
    if said not in words:
        raise ValueError(f"check_only = {said!r}: 0 or 1 is needed")
    numbers = {name: float(row[name]) for name in SCALE_BAR_COLUMNS[2:]}
    return {"a": row["a"], "b": row["b"], "check_only": words[said], **numbers}


def _coordinate(row: _Cells) -> dict[str, Any]:
    numbers = {name: float(row[name]) for name in COORDINATE_COLUMNS[2:]}
    return {"kind": "coordinate", "target": row["target"], "axis": row["axis"].lower(), **numbers}
