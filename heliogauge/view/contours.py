"""Lines along which a quantity on a grid is zero."""

import numpy as np

from heliogauge.errors import InputError
from heliogauge.validate import FloatArray


def zero_lines(x: FloatArray, y: FloatArray, values: FloatArray) -> list[FloatArray]:
    """Return the lines along which values between the nodes of a grid are zero.

    x, y (ny, nx): Places of the nodes.
    values (ny, nx): The quantity; cells with a node that is not finite have no line.
    Returns: Vertices of each line, shape (n, 2); closed ones end where they begin.
    InputError: The shapes differ.
    """
    from skimage.measure import find_contours

    if not x.shape == y.shape == values.shape or values.ndim != 2:
        raise InputError(f"lines of zero: grids of the shapes {x.shape}, {y.shape} and {values.shape}")
    if min(values.shape) < 2:
        return []
    known = np.isfinite(x) & np.isfinite(y) & np.isfinite(values)
    return [_placed(line, x, y) for line in find_contours(np.where(known, values, np.nan), 0.0)]


def _placed(line: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Return where vertices (n, 2), by row and column, lie: each on an edge of a cell, between two nodes."""
    before, after = np.floor(line).astype(np.intp), np.ceil(line).astype(np.intp)
    share = (line - before).sum(axis=1)
    ends = ((one[*before.T], one[*after.T]) for one in (x, y))
    return np.stack([first + share * (second - first) for first, second in ends], axis=1)
