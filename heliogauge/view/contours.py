"""Lines along which a quantity on a grid is zero."""

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.validate import FloatArray

# Edges of a cell: lower, right, upper, left. What each pair of crossed ones joins, by the signs of the corners at the
# lower left, lower right, upper right, upper left (bits 1, 2, 4, 8); of two saddles by the sign in the middle.
_JOINED = {
    1: ((3, 0),), 2: ((0, 1),), 3: ((3, 1),), 4: ((1, 2),), 6: ((0, 2),), 7: ((3, 2),),
    8: ((2, 3),), 9: ((2, 0),), 11: ((2, 1),), 12: ((1, 3),), 13: ((1, 0),), 14: ((0, 3),),
}  # fmt: skip
_SADDLES = {
    (5, True): ((3, 2), (1, 0)),
    (5, False): ((3, 0), (1, 2)),
    (10, True): ((0, 3), (2, 1)),
    (10, False): ((0, 1), (2, 3)),
}


def zero_lines(x: FloatArray, y: FloatArray, values: FloatArray) -> list[FloatArray]:
    """Return the lines along which values between the nodes of a grid are zero.

    x, y (ny, nx): Places of the nodes.
    values (ny, nx): The quantity; cells with a node that is not finite have no line.
    Returns: Vertices of each line, shape (n, 2); closed ones end where they begin.
    InputError: The shapes differ.
    """
    if not x.shape == y.shape == values.shape or values.ndim != 2:
        raise InputError(f"lines of zero: grids of the shapes {x.shape}, {y.shape} and {values.shape}")
    rows, columns = values.shape
    above = values > 0
    corners = [np.s_[:-1, :-1], np.s_[:-1, 1:], np.s_[1:, 1:], np.s_[1:, :-1]]
    known = np.isfinite(x) & np.isfinite(y) & np.isfinite(values)
    whole = np.logical_and.reduce([known[one] for one in corners])
    kind = np.sum([above[one].astype(np.intp) << bit for bit, one in enumerate(corners)], axis=0)
    joins: dict[int, list[int]] = {}
    for row, column in np.argwhere(whole & (kind > 0) & (kind < 15)).tolist():
        # Numbers of the edges: those along the rows first, then those between rows.
        along, up = row * columns + column, rows * columns + row * columns + column
        edges = along, up + 1, along + columns, up
        bits = int(kind[row, column])
        is_high = bits in (5, 10) and float(np.mean(values[row : row + 2, column : column + 2])) > 0
        for a, b in _JOINED[bits] if bits in _JOINED else _SADDLES[bits, is_high]:
            joins.setdefault(edges[a], []).append(edges[b])
            joins.setdefault(edges[b], []).append(edges[a])
    return [_crossings(np.array(path, dtype=np.intp), x, y, values) for path in _chains(joins)]


def _chains(joins: dict[int, list[int]]) -> list[list[int]]:
    """Return paths through a graph whose nodes have one or two neighbours; open ones first."""
    chains, left = [], {node: list(others) for node, others in joins.items()}
    for start in sorted(left, key=lambda node: len(joins[node])):
        path, node = [start], start
        while left[node]:
            following = left[node].pop()
            left[following].remove(node)
            path.append(following)
            node = following
        if len(path) > 1:
            chains.append(path)
    return chains


def _crossings(edges: npt.NDArray[np.intp], x: FloatArray, y: FloatArray, values: FloatArray) -> FloatArray:
    """Return where values are zero on edges of cells, shape (n, 2)."""
    count, columns = values.size, values.shape[1]
    first = edges % count
    second = first + np.where(edges < count, 1, columns)
    before, after = values.ravel()[first], values.ravel()[second]
    share = before / (before - after)
    places = [one.ravel()[first] + share * (one.ravel()[second] - one.ravel()[first]) for one in (x, y)]
    return np.stack(places, axis=1)
