"""Edges that the others of their row contradict, however well the solution follows them.

Where an edge is the only one to speak of a place the slopes follow it wherever it is, and next to nothing is left of
it: a dark patch of ground 19 mrad beside the tube kept a residual of 0.1 mrad. What is left has the variance
``sigma^2 (1 - h)``, h the leverage; over its root it is what the edge is off from where the others alone predict it,
over the sigma of that difference (the deletion residual: Belsley, Kuh and Welsch 1980, section 2.1).
"""

from dataclasses import replace

import numpy as np

from heliogauge.validate import BoolArray, FloatArray
from observer.slopes.row_spline import Roughness, RowGrid, TouchingLines, assemble, nodes_of

#: What is left of the variance of an edge that nothing else predicts: rounding.
_LEAST_FREEDOM = 1e-9


def contradicted_edges(lines: TouchingLines, grid: RowGrid, roughness: Roughness, times: float) -> BoolArray:
    """Return which edges the others of their row contradict, shape (m,).

    lines: Edges as observations with their noise, what rows have in common taken off their misfits.
    roughness: How slopes may vary along a row.
    times: Standard deviations beyond which an edge is contradicted.

    A wrong edge pulls its neighbours' prediction, too. So of each row and panel only the worst is refused before the
    row is solved again without it (data snooping: Baarda 1968), until none is left.
    """
    before, _ = nodes_of(grid, lines.x_m)
    piece = np.cumsum(np.concatenate([[0], ~grid.joined]))[before]
    kept, rows = np.ones(lines.row.size, dtype=bool), np.arange(grid.n_rows)
    while rows.size:
        number = np.full(grid.n_rows, -1)
        number[rows] = np.arange(rows.size)
        some = np.flatnonzero(kept & (number[lines.row] >= 0))
        own = replace(lines.chosen(some), row=number[lines.row[some]])
        off = deletion_residuals(own, RowGrid(grid.x_m, grid.joined, rows.size), roughness)
        size = np.abs(off)
        order = np.lexsort((-size, piece[some], own.row))
        is_first = np.ones(order.size, dtype=bool)
        place = np.stack([own.row, piece[some]])[:, order]
        is_first[1:] = (np.diff(place) != 0).any(axis=0)
        worst = order[is_first]
        out = some[worst[size[worst] > times]]
        kept[out] = False
        rows = np.unique(lines.row[out])
    return ~kept


def deletion_residuals(lines: TouchingLines, grid: RowGrid, roughness: Roughness) -> FloatArray:
    """Return how far each line is from what the others of its row predict, over the sigma of that, shape (m,).

    lines: Observations without common unknowns.
    """
    rows = assemble(lines, grid)
    factor = rows.under(roughness).factor
    values = lines.misfit_rad / lines.sigma_rad
    slopes = factor.solve(rows.right_sides(-values)).reshape(-1)
    left = values + (rows.weights * slopes[rows.place[:, None] + np.arange(4)]).sum(axis=1)
    inverse = factor.inverse_bands().reshape(-1, factor.root.shape[2])
    leverage = np.zeros(lines.row.size)
    for i in range(4):
        for j in range(i, 4):
            times = 1.0 if i == j else 2.0
            leverage += times * rows.weights[:, i] * rows.weights[:, j] * inverse[rows.place + i, j - i]
    return np.asarray(left / np.sqrt(np.maximum(1 - leverage, _LEAST_FREEDOM)))
