"""How every picture looks, whatever draws it: colours, limits of colours, and what is drawn of a large map."""

from dataclasses import replace
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from heliogauge.slopes.map import NODE_FIELDS, SlopeMap
from heliogauge.validate import BoolArray, FloatArray

INK = "#1f2a36"
FAINT = "#66717d"
LINE_X = "#1b6ca8"
LINE_Y = "#c8552b"
MISSING = "#c9cdd2"
MISSING_HATCH = "#8f979f"
# More nodes along one side than pixels of the panel only cost time.
MOST_NODES = 400
# Colours end at this percentile of the size of the values, so that a few bad nodes do not hide the map.
ROBUST_PERCENT = 99.0

_STEPS = np.array([1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0])


def nice_ceiling(value: float) -> float:
    """Return the next round number at or above a value (1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8 times a power of ten).

    value: A positive number; zero and NaN give 1.

    >>> nice_ceiling(0.0021)
    0.0025
    """
    if not np.isfinite(value) or value <= 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    step = _STEPS[np.searchsorted(_STEPS, value / power * (1 - 1e-9))]
    return float(f"{step * power:.6g}")


def robust_limit(*fields: npt.NDArray[np.floating[Any]]) -> float:
    """Return a round number that `ROBUST_PERCENT` of the sizes of all values stay below.

    *fields: Values; NaN is left out.
    """
    sizes = np.abs(np.concatenate([field[np.isfinite(field)].ravel() for field in fields]))
    return nice_ceiling(float(np.percentile(sizes, ROBUST_PERCENT))) if sizes.size else 1.0


class MirrorGrid(Protocol):
    """Nodes on a mirror: a slope map, or another map on its grid."""

    @property
    def x_m(self) -> FloatArray:
        """Grid columns, shape (nx,) [m]."""

    @property
    def y_m(self) -> FloatArray:
        """Grid rows, shape (ny,) [m]."""

    @property
    def aperture(self) -> BoolArray:
        """Nodes that belong to the mirror, shape (ny, nx)."""


def extent_of(grid: MirrorGrid) -> tuple[float, float, float, float]:
    """Return left, right, bottom and top edge of the grid's cells [m]."""
    edges: list[float] = []
    for axis in (grid.x_m, grid.y_m):
        half = float(axis[-1] - axis[0]) / max(axis.size - 1, 1) / 2 or 0.5
        edges += [float(axis[0]) - half, float(axis[-1]) + half]
    return edges[0], edges[1], edges[2], edges[3]


def thinned(field: npt.NDArray[Any], most_nodes: int = MOST_NODES) -> npt.NDArray[Any]:
    """Return every n-th node, so that no side has more than a number of nodes.

    field (ny, nx): Values on the grid.
    """
    step_y, step_x = (-(-size // most_nodes) for size in field.shape)
    return field[step_y // 2 :: step_y, step_x // 2 :: step_x]


def thinned_map(slope_map: SlopeMap) -> SlopeMap:
    """Return a map of every n-th node, so that no side has more than `MOST_NODES`; the same map where none has."""
    if max(slope_map.shape) <= MOST_NODES:
        return slope_map
    kept: dict[str, Any] = {name: thinned(getattr(slope_map, name)) for name in NODE_FIELDS}
    axes: dict[str, Any] = {"x_m": thinned(slope_map.x_m[None, :])[0], "y_m": thinned(slope_map.y_m[:, None])[:, 0]}
    return replace(slope_map, **axes, **kept)
