"""What becomes of edges: by brightness alone, and by how they go on from row to row."""

from enum import IntEnum

import numpy as np

from heliogauge.doubts import Doubt
from heliogauge.validate import BoolArray, FloatArray, IntArray
from observer.photo_edges.reflection_edges import ReflectionEdges

#: An edge of the tube has at least this share of the usual contrast.
_LEAST_CONTRAST = 0.5
#: The tube's edge goes on from row to row; a curve of fewer edges is a cloud's, a glint or a seam.
_LEAST_CURVE = 6
#: The clearest edges of a photo: as clear as this share of them is not.
_CLEAREST = 0.9
#: Contrasts are read to that: a digital number or two of a hundred.
_CONTRAST_READ = 0.01
#: Rounds in which photos with and without the tube are told apart; what changes later is below a thousandth.
_ROUNDS = 50
#: Rows further apart do not show how an edge goes on [m].
_CONTINUED_STEP_M = 0.05
#: From one row to the next an edge moves by at most so many distances of the rows.
_STEEPEST_CURVE = 4.0
#: With more than this share of edges that step the wrong way and go on from row to row there are shadows in the
#: reflection: below 0.1 % under a clear or cloudy sky, 0.5 % in a mirror of steep waves, 2 % with ground in a strip,
#: 2.6 to 3.4 % with the collector's own shadow.
_SHADOWS_SHARE = 0.008
#: Beside an edge of the tube the brightness changes by less than this share of its step, or than so many times what it
#: usually does: where a shadow or a thing on the ground ends beside it the edge is up to 4 mrad off.
_MOST_UNEVEN, _UNEVEN_TIMES_USUAL = 0.2, 5.0


#: With more edges than this that the other side does not confirm it is reported.
_MOST_ONE_SIDED = 0.2


class EdgeFate(IntEnum):
    """What became of an edge."""

    USED = 0
    WRONG_STEP = 1
    FAINT = 2
    BESIDE = 3
    ALONE = 4
    UNEVEN = 5
    ONE_SIDED = 6
    EITHER = 7
    LESSER_STEP = 8
    UNDECIDED = 9

    @property
    def code(self) -> str:
        """As tables have it."""
        return self.name.lower()


FATE_TEXTS = {
    EdgeFate.USED: "used",
    EdgeFate.WRONG_STEP: "brightness steps the other way than at the tube's edge",
    EdgeFate.FAINT: "much less contrast than the tube's edges have",
    EdgeFate.BESIDE: "does not agree with the edges around it",
    EdgeFate.ALONE: "not continued in the neighbouring rows",
    EdgeFate.UNEVEN: "brightness beside it changes, as where a shadow ends",
    EdgeFate.EITHER: "may be the tube's other edge or the rim of its glass: edges of the other side do not confirm it",
    EdgeFate.LESSER_STEP: "a larger step the same way stands beside it: the rim of the glass, or what it throws back",
    EdgeFate.UNDECIDED: "edges of its row and panel contradict each other, and too many of them to tell the false ones",
    EdgeFate.ONE_SIDED: "not confirmed by the tube's other edge, where shadows are about",
}


def first_fate(edges: ReflectionEdges, either_way: BoolArray | None = None) -> IntArray:
    """Judge edges by brightness alone: dark tube before bright sky, or the other way round, whichever most are.

    Shapes: result (m,).
    edges: Candidates of all photos.
    either_way (m,): Those of photos from so far that the tube's edges step either way; none without.

    Weak images in the glass, thin clouds and seams have little contrast; shadows on the ground step the wrong way.
    """
    darker = edges.contrast * edges.side < 0
    size, counts = np.abs(edges.contrast), ~edges.is_lesser
    is_dark = float(size[darker & counts].sum()) > float(size[~darker & counts].sum())
    right = darker == is_dark
    if either_way is not None:
        right |= either_way
    right &= counts
    usual = float(np.median(size[right])) if right.any() else 0.0
    fate = np.where(right, int(EdgeFate.USED), int(EdgeFate.WRONG_STEP))
    fate[(size < _LEAST_CONTRAST * usual) | _shows_no_tube(edges, right)] = int(EdgeFate.FAINT)
    limit = _MOST_UNEVEN
    if right.any():
        limit = max(limit, _UNEVEN_TIMES_USUAL * float(np.median(edges.unevenness[right])))
    fate[right & (edges.unevenness > limit)] = int(EdgeFate.UNEVEN)
    fate[edges.is_lesser] = int(EdgeFate.LESSER_STEP)
    return np.asarray(fate, dtype=np.intp)


def _shows_no_tube(edges: ReflectionEdges, right: BoolArray) -> BoolArray:
    """Return which edges are of photos whose clearest edges are more probably another thing's than the tube's.

    right (m,): Edges that step as the tube's do.

    Where the reflection of the tube ends just beyond the mirror's rim a photo shows there the rim of the glass alone,
    with two thirds of the tube's contrast: one such curve of 55 edges, the only ones to speak of the outermost 10 cm
    of a mirror, turned these by 1 to 5 mrad. The clearest contrasts of photos with the tube are taken to be normally
    distributed, those of others to be anything up to 1: a mixture of the largest likelihood, by expectation and
    maximisation (Dempster et al. 1977).
    """
    photos, photo = np.unique(edges.photo[right], return_inverse=True)
    if photos.size == 0:
        return np.zeros(right.size, dtype=bool)
    size = np.abs(edges.contrast[right])
    clearest = np.array([np.quantile(size[photo == k], _CLEAREST) for k in range(photos.size)])
    usual, scatter, others = float(np.median(clearest)), float(np.std(clearest)), 0.5 / photos.size
    for _ in range(_ROUNDS):
        scatter = max(scatter, _CONTRAST_READ)
        density = (1 - others) * np.exp(-0.5 * ((clearest - usual) / scatter) ** 2) / (scatter * np.sqrt(2 * np.pi))
        tube = density / (density + others)
        usual = float(np.average(clearest, weights=tube))
        scatter = float(np.sqrt(np.average((clearest - usual) ** 2, weights=tube)))
        others = 1 - float(tube.mean())
    return np.asarray(np.isin(edges.photo, photos[(tube < 0.5) & (clearest < usual)]))


def is_alone(edges: ReflectionEdges, which: BoolArray, y_m: FloatArray) -> BoolArray:
    """Return which edges do not belong to a curve through several rows.

    Shapes: y_m (r,).
    edges: Candidates of all photos.
    which (m,): Those that are looked at.
    Returns (m,): Edges of short curves; none where rows are too far apart to tell.
    """
    alone = np.zeros(which.size, dtype=bool)
    if row_step_m(y_m) > _CONTINUED_STEP_M:
        return alone
    chosen = np.nonzero(which)[0]
    curve = curves_of(edges.chosen(chosen), y_m)
    alone[chosen] = np.bincount(curve)[curve] < _LEAST_CURVE
    return alone


def row_step_m(y_m: FloatArray) -> float:
    """Return the distance of equally spaced rows to a nanometre, infinite for one row [m].

    y_m (r,): Rows [m].

    Rows stated to be 50 mm apart are by rounding up to 1e-16 m further.
    """
    return round(float(y_m[1] - y_m[0]), 9) if y_m.size > 1 else np.inf


def next_on_curve(edges: ReflectionEdges, y_m: FloatArray) -> IntArray:
    """Return the edge of the next row with which the curve of each edge goes on, shape (m,); -1 where none does.

    y_m (r,): Rows [m].

    Of one photo and side, each the other's nearest: a curve has one edge in a row. Were all within reach linked, what
    stands beside a curve in single rows would go on with it: such edges, 5 mrad off where nothing else was seen, bent
    rows of a rendered mirror by 3 mrad.
    """
    step = float(y_m[1] - y_m[0]) if y_m.size > 1 else 0.0
    # One group for each photo, side and row; x is less than 40 m, so groups stay apart on one axis.
    group = (2 * edges.photo + (edges.side > 0)) * (y_m.size + 1) + edges.row
    place = 100.0 * group + edges.points_m[:, 0]
    order = np.argsort(place, kind="stable")
    place = place[order]
    if place.size == 0:
        return np.zeros(0, dtype=np.intp)
    after, before = (_nearest(place, place + way) for way in (100.0, -100.0))
    own = np.arange(place.size)
    goes_on = (before[after] == own) & (np.abs(place[after] - place - 100.0) < _STEEPEST_CURVE * step)
    found = np.empty(place.size, dtype=np.intp)
    found[order] = np.where(goes_on, order[after], -1)
    return found


def _nearest(ascending: FloatArray, wanted: FloatArray) -> IntArray:
    """Return which of ascending values is nearest to each wanted one."""
    after = np.clip(np.searchsorted(ascending, wanted), 1, max(ascending.size - 1, 1))
    after = np.minimum(after, ascending.size - 1)
    before = np.maximum(after - 1, 0)
    return np.where(wanted - ascending[before] <= ascending[after] - wanted, before, after)


def curves_of(edges: ReflectionEdges, y_m: FloatArray) -> IntArray:
    """Return which curve through neighbouring rows each edge belongs to, shape (m,).

    y_m (r,): Rows [m].
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    after = next_on_curve(edges, y_m)
    first = np.flatnonzero(after >= 0)
    graph = coo_array((np.ones(first.size, dtype=np.int8), (first, after[first])), shape=(after.size, after.size))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.intp)


def has_shadows(edges: ReflectionEdges, fate: IntArray, y_m: FloatArray) -> bool:
    """Return whether shadows as dark as the tube are in the reflection.

    Shapes: fate (m,), y_m (r,).
    edges: Candidates of all photos.

    Where the sky is around the tube next to no edge steps the wrong way; shadows on the ground have as many such
    edges as they have right ones, which nothing in their brightness tells from the tube's. Noise and glints within
    the tube step either way, but do not go on from row to row.
    """
    wrong = fate == EdgeFate.WRONG_STEP
    return _share(wrong & ~is_alone(edges, wrong, y_m), fate) > _SHADOWS_SHARE


def _share(which: BoolArray, fate: IntArray) -> float:
    """Return the share of edges that are of some kind; not counted are lesser steps, which come with another edge."""
    return float(np.mean(which[fate != EdgeFate.LESSER_STEP]))


def unchecked_doubt(fate: IntArray) -> Doubt | None:
    """Say that most edges were refused because photos are too far apart to tell them from those of shadows.

    Shapes: fate (m,).
    """
    lonely = _share(fate == EdgeFate.ONE_SIDED, fate)
    if lonely < _MOST_ONE_SIDED:
        return None
    wrong = _share(fate == EdgeFate.WRONG_STEP, fate)
    return Doubt(
        "edges_unchecked",
        f"{100 * wrong:.0f} % of the edges in the reflection step the other way than the tube's, as those of shadows, "
        f"glass and things on the ground do; {100 * lonely:.0f} % are not confirmed by the tube's other edge and were "
        "refused. Photos nearer to each other confirm them; or turn the trough so that a bright, clear sky is around "
        "the tube",
        {"wrong_step_share": wrong, "one_sided_share": lonely},
    )


def undecided_doubt(fate: IntArray) -> Doubt | None:
    """Say that edges contradict each other and nothing tells which are false.

    Shapes: fate (m,).
    """
    share = _share(fate == EdgeFate.UNDECIDED, fate)
    if share == 0:
        return None
    return Doubt(
        "edges_contradict",
        f"{100 * share:.2g} % of the edges in the reflection are of rows of a panel where at least a third of them "
        "contradict the others: nothing tells a cloud or a thing on the ground from a dent there, and these places are "
        "given as not measured. More photos, or a clear sky around the tube, decide",
        {"undecided_share": share},
    )
