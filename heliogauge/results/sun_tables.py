"""Tables of a sun shape, as instruments write them and SolTrace has them: one reader for all who take one."""

from pathlib import Path

import numpy as np

from heliogauge.errors import InputError
from heliogauge.files.texts import read_text
from heliogauge.results.tables import read_table_csv, write_table_csv
from heliogauge.sunlight.sun_shapes import TabulatedSun
from heliogauge.validate import FloatArray

#: Columns of a sun shape: angle from the sun's centre, half of the disc's, and radiance in any unit.
SUN_COLUMNS = ("angle_mrad", "radiance")
#: Another name of the second: radiance over that of the sun's middle.
_RELATIVE = "relative_radiance"
_SOLTRACE = ".sun"


def read_sun(path: Path) -> TabulatedSun:
    """Read a sun shape.

    path: A table with the columns `SUN_COLUMNS`, or a ``.sun`` of SolTrace: the same without names.
    InputError: A table that cannot be read, lacks a column, or is no radiance over an angle.
    """
    is_relative, texts = (False, _of_soltrace(path)) if path.suffix.lower() == _SOLTRACE else _named(path)
    try:
        angle, radiance = (np.array(column, dtype=np.float64) for column in texts)
    except ValueError as error:
        raise InputError(f"{path}: {error}; is the decimal sign a point?") from None
    if is_relative:
        # Backward gazing has written the noise of the dark sky as it was, below zero too.
        radiance = np.maximum(radiance, 0.0)
    try:
        return TabulatedSun(1e-3 * angle, radiance, path.name)
    except InputError as error:
        raise InputError(f"{path}: no sun shape, radiance over an angle [mrad] ({error})") from None


def write_sun(path: Path, angle_rad: FloatArray, radiance: FloatArray) -> None:
    """Write a measured sun shape as `read_sun` reads it.

    radiance (n,): In any unit. Noise below zero, where the sky is dark, is written as zero: no light is less.
    InputError: The file cannot be written.
    """
    write_table_csv(path, dict(zip(SUN_COLUMNS, (1e3 * angle_rad, np.maximum(radiance, 0.0)), strict=True)))


def _named(path: Path) -> tuple[bool, tuple[list[str], list[str]]]:
    """Return whether the radiance is relative to that of the sun's middle; angles and radiance."""
    angle, radiance = SUN_COLUMNS
    table = read_table_csv(path, (angle,))
    name = _RELATIVE if _RELATIVE in table and radiance not in table else radiance
    if name not in table:
        raise InputError(f"{path}: the column {radiance} is missing; it has {', '.join(table)}")
    return name == _RELATIVE, (table[angle], table[name])


def _of_soltrace(path: Path) -> tuple[list[str], list[str]]:
    rows = [line.split() for line in read_text(path, "a sun shape of SolTrace").splitlines() if line.strip()]
    odd = next((number for number, row in enumerate(rows, start=1) if len(row) != len(SUN_COLUMNS)), None)
    if not rows or odd is not None:
        where = "the file is empty" if odd is None else f"row {odd} has {len(rows[odd - 1])}"
        raise InputError(f"{path}: rows of an angle [mrad] and a radiance are needed, {where}")
    return [row[0] for row in rows], [row[1] for row in rows]
