"""The table of a pattern of dots with marks."""

from pathlib import Path

import numpy as np

from deflectometry.dots.marks import DotTable
from heliogauge.errors import InputError
from heliogauge.results.tables import read_table_csv


def read_dot_table(file: Path) -> DotTable:
    """Read a table with the columns column, row, large, and u, v where the dots are displayed.

    InputError: A missing column, or values that cannot be meant.
    """
    columns = read_table_csv(file, ("column", "row", "large"))
    try:
        number = np.array([[int(one) for one in columns[name]] for name in ("column", "row")], dtype=np.intp).T
        large = np.array([int(one) for one in columns["large"]])
        fractions = [
            np.array([float(one) for one in columns[name]]) if name in columns else np.full(len(number), np.nan)
            for name in ("u", "v")
        ]
    except ValueError as error:
        raise InputError(f"{file}: column, row and large must be whole numbers, u and v fractions ({error})") from None
    if not np.isin(large, (0, 1)).all():
        raise InputError(f"{file}: large must be 1 for a large dot and 0 for a small one")
    if len(np.unique(number, axis=0)) < len(number):
        raise InputError(f"{file}: a dot (column, row) is listed twice; remove one")
    return DotTable(number, large.astype(np.bool_), *fractions)
