"""How far edges scatter beside their neighbours along the trough: their noise, whatever the mirror does across it."""

import numpy as np

from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.validate import BoolArray, FloatArray
from observer.photo_edges.reflection_edges import ReflectionEdges
from observer.selection.edge_refusal import CONTINUED_STEP_M, next_on_curve

#: Third differences of a curve: a mirror's wave of 0.5 m and 1 mrad leaves 0.02 mrad in them with rows 20 mm apart.
_THIRD = np.array([-1.0, 3.0, -3.0, 1.0])
#: A robust scale of so many is good to a tenth.
_FEWEST = 100


def scatter_along(edges: ReflectionEdges, which: BoolArray, y_m: FloatArray) -> float:
    """Return by what factor of their sigmas edges scatter along their curves.

    Shapes: which (m,), y_m (r,).
    edges: Candidates of all photos.
    which (m,): Those that are looked at.
    Returns: Robust scale of the third differences of a photo's edge over four neighbouring rows, over their sigmas: the
        least that their noise can be; 0 where rows are too far apart to tell.

    It needs nothing of the mirror's shape across: where each edge is all that the photos say of its place, what is
    left after slopes were found says nothing of their noise, and noise that is taken to be too small makes the mirror
    look rough. Errors that neighbouring rows share are not in it.
    """
    step = float(y_m[1] - y_m[0]) if y_m.size > 1 else np.inf
    if step > CONTINUED_STEP_M:
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
