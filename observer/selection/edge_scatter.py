"""How far edges scatter beside their neighbours along the trough: their noise, whatever the mirror does across it."""

import numpy as np

from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.validate import BoolArray, FloatArray
from observer.photo_edges.reflection_edges import ReflectionEdges
from observer.selection.edge_refusal import next_on_curve, row_step_m

#: Third differences of a curve. Of a wave of length L they leave (2 sin(pi step / L))^3, while noise becomes sqrt(20)
#: times as large: of one of 0.5 m 0.016 with rows 20 mm apart, 0.031 with 25 mm, 0.24 with 50 mm.
_THIRD = np.array([-1.0, 3.0, -3.0, 1.0])
#: With rows further apart waves look like noise [m]: up to this a wave of 0.5 m whose amplitude is 50 sigmas, as one of
#: 1 mrad has, adds 0.031 * 50 / sqrt(2 * 20) = 0.24 of the noise to it in square, which is 3 %.
_LARGEST_STEP_M = 0.025
#: A robust scale of so many differences scatters by 0.15, as each edge is in four of them.
_FEWEST = 100


def scatter_along(edges: ReflectionEdges, which: BoolArray, y_m: FloatArray) -> float:
    """Return by what factor of their sigmas edges scatter along their curves.

    Shapes: which (m,), y_m (r,).
    edges: Candidates of all photos.
    which (m,): Those that are looked at.
    Returns: Robust scale of the third differences of a photo's edge over four neighbouring rows, over their sigmas: the
        least that their noise can be, but for what waves of the mirror leave in them; 0 where rows are too far apart
        to tell.

    It needs nothing of the mirror's shape across: where each edge is all that the photos say of its place, what is
    left after slopes were found says nothing of their noise, and noise that is taken to be too small makes the mirror
    look rough. Errors that neighbouring rows share are not in it.
    """
    if row_step_m(y_m) > _LARGEST_STEP_M:
        return 0.0
    chosen = np.flatnonzero(which)
    # What goes on from -1 is -1.
    after = np.append(next_on_curve(edges.chosen(chosen), y_m), -1)
    chain = [np.arange(chosen.size)]
    for _ in range(_THIRD.size - 1):
        chain.append(after[chain[-1]])
    table = np.stack(chain, axis=1)
    table = chosen[table[table[:, -1] >= 0]]
    if len(table) < _FEWEST:
        return 0.0
    differences = edges.points_m[table, 0] @ _THIRD
    return robust_scale(differences / np.sqrt(edges.sigma_x_m[table] ** 2 @ _THIRD**2))
