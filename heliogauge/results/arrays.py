"""Arrays with coordinates on disk: NetCDF-4 like slope maps, for results that are neither a map nor a table."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.results.slope_map_file import (
    open_file,
    plain_value,
    stored_values,
    write_global_attributes,
    write_variable,
    written_at_once,
)


@dataclass(frozen=True, slots=True, eq=False)
class LabelledArray:
    """Values with the names of their axes, their unit and what they are.

    name: Name of the variable; one whose only axis has the same name is a coordinate.
    axes: Name of each axis.
    unit: Unit; "1" where there is none.
    meaning: In words.
    """

    name: str
    axes: Sequence[str]
    values: npt.NDArray[Any]
    unit: str
    meaning: str


def write_arrays(path: Path, arrays: Sequence[LabelledArray], attributes: Mapping[str, Any] | None = None) -> None:
    """Write arrays that share their coordinates.

    arrays: Coordinates first: each axis is that of a coordinate.
    InputError: An axis without coordinate or of another length, or the file cannot be written.
    """
    with written_at_once(path) as file:
        write_global_attributes(file, attributes or {})
        scales: dict[str, Any] = {}
        for array in arrays:
            labels = {"units": array.unit, "long_name": array.meaning}
            if tuple(array.axes) == (array.name,):
                scales[array.name] = scale = file.create_dataset(array.name, data=array.values, track_order=True)
                scale.make_scale(array.name)
                for key, text in labels.items():
                    scale.attrs[key] = np.bytes_(text)
                continue
            sizes = tuple(scales[axis].shape[0] if axis in scales else -1 for axis in array.axes)
            if sizes != array.values.shape:
                raise InputError(
                    f"{path}: {array.name} has shape {array.values.shape}, its axes {', '.join(array.axes)} have "
                    f"{sizes}"
                )
            write_variable(file, array.name, array.values, [scales[axis] for axis in array.axes], labels)


def read_arrays(path: Path, needed: Sequence[str] = ()) -> tuple[dict[str, npt.NDArray[Any]], dict[str, Any]]:
    """Read what `write_arrays` wrote.

    needed: Variables that must be there.
    """
    with open_file(path) as file:
        arrays = {name: stored_values(item) for name, item in file.items()}
        attributes = {name: plain_value(value) for name, value in file.attrs.items() if not name.startswith("_")}
    missing = [name for name in needed if name not in arrays]
    if missing:
        raise InputError(f"{path}: the variables {', '.join(missing)} are missing; the file is damaged")
    return arrays, attributes
