"""Several facets in one photo of dots: each surface shows a lattice of its own."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from deflectometry.dots.found_dots import FEWEST_DOTS, FoundDots
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FloatArray, IntArray

#: Distance of two dots, beside a facet, from which a dot is on none: a dot and its blur are smaller.
_BESIDE = 0.35


@dataclass(frozen=True, slots=True, eq=False)
class FacetLattice(ShortRepr):
    """One lattice of dots on one surface.

    dots: Its dots.
    facets: Numbers of the facets that show it, the one with most of them first.
    on_first (n,): Which of the dots the first of them shows.
    """

    dots: FoundDots
    facets: tuple[int, ...]
    on_first: BoolArray

    def shows(self, place_px: FloatArray) -> bool:
        """Return whether a place in the photo is on this lattice: nearer than two distances to one of its dots."""
        apart = np.linalg.norm(self.dots.centers_px - place_px, axis=1)
        return bool(apart.min() < 2.0 * self.dots.spacing_px)


def lattices_of_facets(
    found: Sequence[FoundDots], facet_index: npt.NDArray[np.int16], margin_px: float
) -> tuple[FacetLattice, ...]:
    """Return the lattice of each surface.

    found: All lattices of the photo.
    facet_index (h, w): Facet of each pixel, -1 beside them.
    margin_px: How far the outline of a facet is from those pixels [px].

    Facets are one surface where rows of dots go on from one to the other by dots that are seen between them: a mirror
    that is divided on paper only. Across a true gap the rows of two facets may meet a whole dot off, so they count as
    two lattices however well they meet.
    """
    best: dict[int, tuple[int, int, int]] = {}
    pieces: list[tuple[FoundDots, IntArray, IntArray]] = []
    for number, dots in enumerate(found):
        owner = _owners(facet_index, dots.centers_px, margin_px + _BESIDE * dots.spacing_px)
        pieces.append((dots, owner, _surfaces(dots.number, owner)))
        for facet in np.unique(owner[owner >= 0]).tolist():
            surface, count = np.unique(pieces[-1][2][owner == facet], return_counts=True)
            most = int(np.argmax(count))
            if count[most] >= max(FEWEST_DOTS, best.get(facet, (0, 0, 0))[0]):
                best[facet] = (int(count[most]), number, int(surface[most]))
    lattices = []
    for chosen in sorted({one[1:] for one in best.values()}):
        dots, owner, surfaces = pieces[chosen[0]]
        facets = sorted((facet for facet, one in best.items() if one[1:] == chosen), key=lambda facet: -best[facet][0])
        mine = np.isin(owner, facets) & (surfaces == chosen[1])
        lattices.append(FacetLattice(dots.chosen(mine), tuple(facets), owner[mine] == facets[0]))
    return tuple(lattices)


def _owners(facet_index: npt.NDArray[np.int16], places_px: FloatArray, reach_px: float) -> IntArray:
    """Return the facet of each place (n,): the nearest one within reach, -1 beside all."""
    from scipy.ndimage import distance_transform_edt

    far, (row, column) = distance_transform_edt(facet_index < 0, return_indices=True)
    place = np.clip(np.rint(places_px), 0, np.array(facet_index.shape[::-1]) - 1).astype(np.intp)
    at = place[:, 1], place[:, 0]
    return np.where(far[at] <= reach_px, facet_index[row[at], column[at]], -1).astype(np.intp)


def _surfaces(number: IntArray, owner: IntArray) -> IntArray:
    """Return which surface each dot is on (n,): neighbours are, unless they are on two facets."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    count = len(number)
    at = number - number.min(axis=0)
    grid = np.full(at.max(axis=0) + 1, -1)
    grid[at[:, 0], at[:, 1]] = np.arange(count)
    pairs = [np.stack([one.ravel() for one in two]) for two in ((grid[1:], grid[:-1]), (grid[:, 1:], grid[:, :-1]))]
    first, second = np.concatenate(pairs, axis=1)
    there = (first >= 0) & (second >= 0)
    first, second = first[there], second[there]
    linked = (owner[first] == owner[second]) | (owner[first] < 0) | (owner[second] < 0)
    ones = np.ones(np.count_nonzero(linked))
    graph = coo_matrix((ones, (first[linked], second[linked])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.intp)
