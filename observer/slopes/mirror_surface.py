"""The mirror's surface as measured: slopes integrated to heights, and mirror points put on it.

A mirror that is 1 mm too high sends the ray of its rim past the tube's axis by ``h sin(beta)``, which looks like
0.2 mrad of slope. Slopes alone say nothing of the mean height of a panel; it is taken as the design's.
"""

import numpy as np

from heliogauge.errors import EstimationError
from heliogauge.slopes.integration import integrate_slopes
from heliogauge.validate import BoolArray, FloatArray, IntArray
from observer.slopes.row_spline import RowGrid, nodes_of
from observer.trough.collector import Collector


def heights(
    slope_errors: FloatArray,
    measured: BoolArray,
    along_known: BoolArray,
    collector: Collector,
    grid: RowGrid,
    y_m: FloatArray,
) -> FloatArray:
    """Integrate slope errors to the height of the mirror over its design.

    Shapes: y_m (r,).
    slope_errors (r, nx, 2): Errors of dz/dx and dz/dy [rad].
    measured (r, nx): Nodes that carry them; elsewhere the panel is taken as straight.
    along_known (r, nx): Nodes at which the slope along the trough was measured, not assumed.
    collector: Its panels: each is integrated by itself.
    grid: Nodes across the trough.
    Returns (r, nx): Height over the design, mean zero on each panel [m].

    Where one pass only was flown the slope along the trough is not known, so each row of a panel is integrated for
    itself and has the mean zero; where it is known on most of a panel, both slopes together give its surface.
    """
    x_nodes, y_nodes = np.meshgrid(grid.x_m, y_m)
    panel = collector.panel_index(x_nodes, y_nodes)
    across = np.where(measured, slope_errors[..., 0], 0.0)
    pieces = np.cumsum(np.concatenate([[0], ~grid.joined]))
    height = np.zeros(across.shape)
    for piece in range(int(pieces[-1]) + 1):
        columns = np.nonzero(pieces == piece)[0]
        part = across[:, columns]
        run = np.zeros(part.shape)
        run[:, 1:] = np.cumsum(0.5 * (part[:, 1:] + part[:, :-1]), axis=1) * grid.step_m
        height[:, columns] = run - run.mean(axis=1, keepdims=True)
    if along_known.any() and y_m.size > 1:
        steps = (grid.step_m, float(y_m[1] - y_m[0]))
        for number in range(int(panel.max()) + 1):
            height = _with_both_slopes(height, slope_errors, (panel == number) & measured, along_known, steps)
    return height


def _with_both_slopes(
    height: FloatArray, slope_errors: FloatArray, inside: BoolArray, along_known: BoolArray, step_m: tuple[float, float]
) -> FloatArray:
    """Replace the height of one panel where both slopes are known on most of it."""
    both = inside & along_known
    if np.count_nonzero(both) < max(0.5 * np.count_nonzero(inside), 16):
        return height
    rows, columns = (np.nonzero(both.any(axis=axis))[0] for axis in (1, 0))
    block = np.ix_(np.arange(rows[0], rows[-1] + 1), np.arange(columns[0], columns[-1] + 1))
    slopes = [np.where(both[block], slope_errors[..., axis][block], np.nan) for axis in (0, 1)]
    try:
        found = integrate_slopes(slopes[0], slopes[1], step_m)
    except EstimationError:
        return height
    result = height.copy()
    result[block] = np.where(np.isfinite(found), found, height[block])
    return result


def on_surface(
    points_m: FloatArray, eyes_m: FloatArray, row: IntArray, height_m: FloatArray, grid: RowGrid, focal_length_m: float
) -> FloatArray:
    """Move points along their lines of sight from the design's surface to the measured one.

    Shapes: points_m, eyes_m (m, 3), row (m,), height_m (r, nx).
    grid: Nodes across the trough.
    Returns (m, 3): Points on the measured surface, to the square of its slope errors [m].
    """
    height = at_points(height_m, row, points_m[:, 0], grid)
    sight = eyes_m - points_m
    rising = sight[:, 2] - points_m[:, 0] / (2 * focal_length_m) * sight[:, 0]
    return np.asarray(points_m + sight * (height / rising)[:, None])


def at_points(values: FloatArray, row: IntArray, x_m: FloatArray, grid: RowGrid) -> FloatArray:
    """Interpolate values of the nodes along their rows.

    Shapes: values (r, nx, ...), row (m,), x_m (m,).
    Returns (m, ...): Values there; nothing is interpolated across a panel's edge.
    """
    before, share = nodes_of(grid, x_m)
    share = share.reshape(-1, *[1] * (values.ndim - 2))
    # Numbers in one line of memory are found in a third of the time of rows and columns.
    flat, place = values.reshape(-1, *values.shape[2:]), row * grid.x_m.size + before
    return np.asarray(flat.take(place, axis=0) * (1 - share) + flat.take(place + 1, axis=0) * share)


def beside_chord(values: FloatArray, row: IntArray, x_m: FloatArray, grid: RowGrid) -> FloatArray:
    """Return by how much the cubic through four nodes of a row departs from the straight line between the middle two.

    Shapes: values (r, nx), row (m,), x_m (m,).
    Returns (m,): What `at_points` lacks; beside a panel's edge that of the parabola through three nodes.

    A wave of 3 mrad and 0.5 m departs from the chord between nodes 20 mm apart by 0.02 mrad, which is more than an
    edge is uncertain by.
    """
    inner = grid.joined[:-1] & grid.joined[1:]
    bend = np.zeros(values.shape)
    bend[:, 1:-1] = np.where(inner, values[:, :-2] - 2 * values[:, 1:-1] + values[:, 2:], 0.0)
    # The first and the last node of a panel bend as their neighbours do.
    known = np.concatenate([[False], inner, [False]])
    starts = np.flatnonzero(~known[:-1] & grid.joined & known[1:])
    ends = np.flatnonzero(known[:-1] & grid.joined & ~known[1:]) + 1
    bend[:, starts], bend[:, ends] = bend[:, starts + 1], bend[:, ends - 1]
    before, share = nodes_of(grid, x_m)
    place = row * grid.x_m.size + before
    first, second = bend.take(place), bend.take(place + 1)
    return np.asarray(-share * (1 - share) / 6 * ((2 - share) * first + (1 + share) * second))
