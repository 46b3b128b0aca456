"""Dots of a pattern in a photo: found, centred to hundredths of a pixel, and given their places in a lattice."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.errors import EstimationError
from heliogauge.validate import BoolArray, FloatArray, IntArray
from photogrammetry.centers import Ellipse, TargetCenter, measure_centers
from photogrammetry.detection import SearchLimits, find_candidates
from photogrammetry.targets import Polarity

#: Dots in a mirror are small and may be drawn out: nothing that the finder can see is left out beforehand.
_SMALLEST_PX, _LARGEST_PX, _LEAST_CONTRAST_DN, _MOST_TILT_RAD = 3.0, 60.0, 8.0, 1.3
#: Fewer dots than this have no lattice: a row and a column of five with what is between them.
FEWEST_DOTS = 25
#: Neighbours that may be the next ones of a lattice, and those whose usual steps hold around a dot.
_NEXT, _AROUND = 8, 24
#: Rounds in which the steps follow the lattice found with them; further ones change nothing on the photos tried.
_ROUNDS = 4
#: Right, left, down and up in numbers of columns and rows.
_STEPS = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
_OPPOSITE = (1, 0, 3, 2)


@dataclass(frozen=True, slots=True, eq=False)
class FoundDots:
    """Dots of one photo on one lattice.

    centers_px (n, 2): Their centres (x, y) [px].
    covariance_px2 (n, 2, 2): Covariances of the centres [px^2].
    number (n, 2): Column and row in the lattice, counted from any of its dots; columns run to the right and rows down
        in the image, as nearly as the lattice lets them.
    contrast_dn (n,): Difference of dot and ground [DN].
    residual_dn: Usual noise of a pixel about the fitted dots [DN].
    n_coarse: Dots that no blurred disc fits: the last ones, with the centre of their outline.
    shapes_px2 (n, 2, 2): Shape of each dot's ellipse; None where nobody measured it [px^2].
    """

    centers_px: FloatArray
    covariance_px2: FloatArray
    number: IntArray
    contrast_dn: FloatArray
    residual_dn: float
    n_coarse: int = 0
    shapes_px2: FloatArray | None = None

    @property
    def spacing_px(self) -> float:
        """Usual distance of neighbouring dots [px]."""
        from scipy.spatial import cKDTree

        return float(np.median(cKDTree(self.centers_px).query(self.centers_px, 2)[0][:, 1]))

    @property
    def cell_px2(self) -> float:
        """Usual area of the photo between four dots [px^2]."""
        by_number = {(int(column), int(row)): k for k, (column, row) in enumerate(self.number)}
        areas = []
        for (column, row), k in by_number.items():
            across, down = by_number.get((column + 1, row)), by_number.get((column, row + 1))
            if across is not None and down is not None:
                (x, y), (x1, y1) = (self.centers_px[one] - self.centers_px[k] for one in (across, down))
                areas.append(abs(x * y1 - y * x1))
        return float(np.median(areas))

    def chosen(self, which: IntArray | BoolArray) -> "FoundDots":
        """Return some of the dots."""
        index = np.arange(len(self.number))[which]
        first_coarse = len(self.number) - self.n_coarse
        return FoundDots(
            self.centers_px[index],
            self.covariance_px2[index],
            self.number[index],
            self.contrast_dn[index],
            self.residual_dn,
            int(np.count_nonzero(index >= first_coarse)),
            None if self.shapes_px2 is None else self.shapes_px2[index],
        )

    def renumbered(self, number: IntArray) -> "FoundDots":
        """Return the dots with other columns and rows."""
        return replace(self, number=number)


def find_dots(image_dn: npt.NDArray[Any], region: BoolArray, polarity: Polarity) -> FoundDots:
    """Find the dots that a mirror shows, and their lattice.

    image_dn (h, w): Grey values [DN].
    region (h, w): Pixels that see the mirror.
    EstimationError: Too few dots, or dots that are not in rows and columns.

    Dots that the search leaves out (small, beside dust) are measured where the lattice expects them.
    """
    (dots,) = _find(image_dn, region, polarity, several=False)
    return dots


def find_lattices(image_dn: npt.NDArray[Any], region: BoolArray, polarity: Polarity) -> tuple[FoundDots, ...]:
    """Find the dots that several facets show: every lattice of 25 dots and more, the largest first.

    EstimationError: Too few dots, or dots that are not in rows and columns.

    Shapes are those of `find_dots`. Columns run alike in all of them; each counts from a dot of its own.
    """
    return _find(image_dn, region, polarity, several=True)


def _find(image_dn: npt.NDArray[Any], region: BoolArray, polarity: Polarity, *, several: bool) -> tuple[FoundDots, ...]:
    limits = SearchLimits(_SMALLEST_PX, _LARGEST_PX, _LEAST_CONTRAST_DN, _MOST_TILT_RAD, (polarity,))
    starts = [one.ellipse for one in find_candidates(image_dn, limits) if _sees(region, one.ellipse.center_px)]
    if len(starts) < FEWEST_DOTS:
        raise EstimationError(
            f"the mirror shows {len(starts)} dots, fewer than {FEWEST_DOTS}; check exposure and focus, that the "
            f"pattern is seen in the mirror, and whether its dots are {polarity.value.split('-')[0]}"
        )
    places = np.array([one.center_px for one in starts])
    number, lattice = index_lattices(places)
    of_each = [lattice == one for one in range(lattice.max() + 1)] if several else [_largest(lattice)]
    return tuple(_measured(image_dn, starts, number, each) for each in of_each)


def _largest(lattice: IntArray) -> BoolArray:
    """Return which dots are on the largest lattice.

    EstimationError: It has less than half of the dots.
    """
    largest = lattice == 0
    usual = int(np.count_nonzero(largest))
    if usual < len(lattice) // 2:
        raise EstimationError(
            f"of {len(lattice)} dots only {usual} are in rows and columns of one lattice; check focus and that the "
            "pattern's dots, not other spots, are seen in the mirror"
        )
    return np.asarray(largest)


def _measured(
    image_dn: npt.NDArray[Any], starts: Sequence[Ellipse], number: IntArray, on_lattice: BoolArray
) -> FoundDots:
    """Measure the dots of one lattice, those too that only the lattice expects."""
    places = np.array([one.center_px for one in starts])
    chosen = [one for one, there in zip(starts, on_lattice, strict=True) if there]
    places, number = places[on_lattice], number[on_lattice]
    first = measure_centers(image_dn, chosen)
    good = np.array([isinstance(one, TargetCenter) for one in first])
    fitted = [one for one in first if isinstance(one, TargetCenter)]
    if len(fitted) < FEWEST_DOTS:
        raise EstimationError(
            f"of {len(chosen)} dots only {len(fitted)} have a centre; check focus and exposure: dots need 4 px and more"
        )
    expected, their_number = _expected(places, number)
    more = measure_centers(image_dn, [_like_neighbours(place, places, chosen) for place in expected])
    there = np.array([isinstance(one, TargetCenter) for one in more], dtype=np.bool_)
    fitted += [one for one in more if isinstance(one, TargetCenter)]
    # What no blurred disc fits keeps the centre of its outline, as sure as those of its neighbours are.
    off = np.array([one.center_px for one in first if isinstance(one, TargetCenter)]) - places[good]
    coarse = np.diag([robust_scale(off[:, axis]) ** 2 for axis in (0, 1)])
    n_coarse = int(np.count_nonzero(~good))
    return FoundDots(
        np.concatenate([[one.center_px for one in fitted], places[~good]]),
        np.concatenate([[one.covariance_px2 for one in fitted], np.tile(coarse, (n_coarse, 1, 1))]),
        np.concatenate([number[good], their_number[there], number[~good]]),
        np.concatenate([[abs(one.contrast_dn) for one in fitted], np.full(n_coarse, np.nan)]),
        float(np.median([one.residual_dn for one in fitted])),
        n_coarse,
        np.array(
            [one.ellipse.shape_px2 for one in fitted]
            + [one.shape_px2 for one, fine in zip(chosen, good, strict=True) if not fine]
        ),
    )


def _sees(region: BoolArray, place_px: FloatArray) -> bool:
    column, row = np.rint(place_px).astype(np.intp)
    return bool(0 <= row < region.shape[0] and 0 <= column < region.shape[1] and region[row, column])


#: Column and row of a dot that is on no lattice.
_NO_NUMBER = np.iinfo(np.intp).min


def index_lattice(places_px: FloatArray) -> IntArray:
    """Give dots their columns and rows on the largest connected lattice.

    Shapes: places_px (n, 2).
    Returns (n, 2): Column and row; the smallest whole number where a dot is not on the lattice.
    EstimationError: No lattice with half of the dots.
    """
    number, lattice = index_lattices(places_px)
    return np.where(_largest(lattice)[:, None], number, _NO_NUMBER)


def index_lattices(places_px: FloatArray) -> tuple[IntArray, IntArray]:
    """Give dots their columns and rows on each connected lattice.

    Shapes: places_px (n, 2).
    Returns (n, 2), (n,): Column and row, and the number of the lattice, 0 for the largest; -1 for a dot on none.
    EstimationError: No lattice.

    Two dots are next to each other where each is the other's best for a step: so a missing dot or dust breaks single
    links, never the numbers. The steps are those around each dot, which follow the lattice from place to place; the
    numbers follow from the links, and a dot to which they give two numbers has none.
    """
    from scipy.spatial import cKDTree

    count = len(places_px)
    distances, near = cKDTree(places_px).query(places_px, min(_AROUND, count - 1) + 1)
    distances, near = distances[:, 1:], near[:, 1:]
    apart = places_px[near] - places_px[:, None]
    angles = np.arctan2(apart[:, :4, 1], apart[:, :4, 0])
    turn = float(np.angle(np.mean(np.exp(4j * angles)))) / 4
    across = np.array([np.cos(turn), np.sin(turn)])
    steps = np.tile(np.stack([across, [-across[1], across[0]]]) * float(np.median(distances[:, 0])), (count, 1, 1))
    links = _links(near, apart, steps)
    for _ in range(1, _ROUNDS):
        steps = _steps_around(places_px, near, links, steps)
        links = _links(near, apart, steps)
    return _numbered(links)


def _links(near: IntArray, apart: FloatArray, steps: FloatArray) -> IntArray:
    """Return the next dot to the right, left, below and above, shape (n, 4); -1 where there is none.

    Shapes: near (n, k), apart (n, k, 2).
    steps (n, 2, 2): Step to the right and step down around each dot [px].
    """
    wanted = np.stack([steps[:, 0], -steps[:, 0], steps[:, 1], -steps[:, 1]], axis=1)
    off = np.linalg.norm(apart[:, None, :_NEXT] - wanted[:, :, None], axis=-1)
    best = np.take_along_axis(near[:, :_NEXT], off.argmin(axis=-1), axis=1)
    # Farther off than half a step it is another place of the lattice.
    best = np.where(off.min(axis=-1) < 0.5 * np.linalg.norm(wanted, axis=-1), best, -1)
    mutual = np.stack([best[best[:, k], _OPPOSITE[k]] == np.arange(len(near)) for k in range(4)], axis=1) & (best >= 0)
    return np.where(mutual, best, -1)


def _steps_around(places_px: FloatArray, near: IntArray, links: IntArray, before: FloatArray) -> FloatArray:
    """Return the usual step to the right and step down around each dot: the median of the links there."""
    own = np.full((len(links), 2, 2), np.nan)
    for axis, (onwards, back) in enumerate(((0, 1), (2, 3))):
        both = np.full((len(links), 2, 2), np.nan)
        for side, (link, sign) in enumerate(((onwards, 1.0), (back, -1.0))):
            there = links[:, link] >= 0
            both[there, side] = sign * (places_px[links[there, link]] - places_px[there])
        linked = np.isfinite(both[..., 0]).any(axis=1)
        own[linked, axis] = np.nanmean(both[linked], axis=1)
    around = own[near]
    known = np.isfinite(around[..., 0]).any(axis=1)
    steps = before.copy()
    for axis in range(2):
        steps[known[:, axis], axis] = np.nanmedian(around[known[:, axis], :, axis], axis=1)
    return steps


def _numbered(links: IntArray) -> tuple[IntArray, IntArray]:
    """Give linked dots their numbers, and their lattice; a dot that two ways give two numbers is on none.

    A wrong link closes no cell of four dots, so cells come first: dots of cells that share a link are one patch. The
    links between two patches then vote on how they belong together, the most votes first.
    """
    number, group = _patches(links)
    start, direction = np.nonzero(links >= 0)
    end = links[start, direction]
    while True:
        between = group[start] != group[end]
        if not between.any():
            break
        # The shift that the second patch needs for each link to hold.
        first, second = start[between], end[between]
        shift = number[first] + _STEPS[direction[between]] - number[second]
        votes, counts = np.unique(np.column_stack([group[first], group[second], shift]), axis=0, return_counts=True)
        keep, joined, *by = votes[int(np.argmax(counts))].tolist()
        moved = group == joined
        number[moved] += by
        group[moved] = keep
    holds = (number[end] - number[start] == _STEPS[direction]).all(axis=1)
    agreeing, contradicting = (np.bincount(start[which], minlength=len(links)) for which in (holds, ~holds))
    lattice = np.full(len(links), -1)
    counts = np.bincount(group)
    found = 0
    for one in np.argsort(-counts, kind="stable")[: np.count_nonzero(counts >= FEWEST_DOTS)].tolist():
        on_lattice = (group == one) & (agreeing > contradicting)
        on_lattice &= ~_shared(number, on_lattice)
        if np.count_nonzero(on_lattice) >= FEWEST_DOTS:
            lattice[on_lattice] = found
            found += 1
    if not found:
        raise EstimationError(
            f"of {len(links)} dots only {counts.max()} are in rows and columns of one lattice; check focus and that "
            "the pattern's dots, not other spots, are seen in the mirror"
        )
    return number, lattice


def _patches(links: IntArray) -> tuple[IntArray, IntArray]:
    """Return the numbers of dots within their patch (n, 2), and the patch of each (n,): cells that share links.

    A cell is a dot from which right and down leads to the same dot as down and right.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import breadth_first_order, connected_components

    count = len(links)
    # A dot beyond all others stands for none: it leads to itself.
    padded = np.vstack([np.where(links >= 0, links, count), np.full((1, 4), count)])
    corner = np.arange(count)
    right, down = padded[corner, 0], padded[corner, 2]
    last = padded[right, 2]
    closed = (last < count) & (last == padded[down, 0])
    corner, right, down, last = corner[closed], right[closed], down[closed], last[closed]
    start = np.concatenate([corner, down, corner, right])
    end = np.concatenate([right, last, down, last])
    step = np.repeat(np.array([0, 0, 2, 2]), len(corner))
    graph = coo_matrix((step + 1, (start, end)), shape=(count, count)).tocsr()
    graph.data[:] = 1
    n_groups, group = connected_components(graph, directed=False)
    way = {(a, b): _STEPS[k] for a, b, k in zip(start.tolist(), end.tolist(), step.tolist(), strict=True)}
    number = np.zeros((count, 2), dtype=np.intp)
    roots = np.full(n_groups, count)
    np.minimum.at(roots, group, np.arange(count))
    for root in roots[np.bincount(group) > 1].tolist():
        order, parent = breadth_first_order(graph, root, directed=False)
        for dot in order[1:].tolist():
            before = int(parent[dot])
            forward = way.get((before, dot))
            number[dot] = number[before] + (forward if forward is not None else -way[dot, before])
    return number, group


def _shared(number: IntArray, on_lattice: BoolArray) -> BoolArray:
    """Return which dots have the number of another one."""
    shared = np.zeros(len(number), dtype=np.bool_)
    rows = np.flatnonzero(on_lattice)
    _, inverse, counts = np.unique(number[rows], axis=0, return_inverse=True, return_counts=True)
    shared[rows] = counts[inverse.ravel()] > 1
    return shared


def _expected(places_px: FloatArray, number: IntArray) -> tuple[FloatArray, IntArray]:
    """Return where further dots are expected, between or beside two of a row or column, and their numbers."""
    low = number.min(axis=0) - 1
    columns, rows = number.max(axis=0) - low + 2
    grid = np.full((rows, columns, 2), np.nan)
    column, row = (number - low).T
    grid[row, column] = places_px
    between = np.full((2, rows, columns, 2), np.nan)
    between[0, :, 1:-1] = 0.5 * (grid[:, :-2] + grid[:, 2:])
    between[1, 1:-1] = 0.5 * (grid[:-2] + grid[2:])
    beyond = np.full((4, rows, columns, 2), np.nan)
    beyond[0, :, 2:] = 2 * grid[:, 1:-1] - grid[:, :-2]
    beyond[1, :, :-2] = 2 * grid[:, 1:-1] - grid[:, 2:]
    beyond[2, 2:] = 2 * grid[1:-1] - grid[:-2]
    beyond[3, :-2] = 2 * grid[1:-1] - grid[2:]
    guess = grid.copy()
    for guesses in (between, beyond):
        open_to = np.isnan(guess[..., 0]) & np.isfinite(guesses[..., 0]).any(axis=0)
        guess[open_to] = np.nanmean(guesses[:, open_to], axis=0)
    wanted = np.isfinite(guess[..., 0]) & np.isnan(grid[..., 0])
    row, column = np.nonzero(wanted)
    return guess[wanted], np.stack([column, row], axis=-1) + low


def _like_neighbours(place_px: FloatArray, places_px: FloatArray, shapes: Sequence[Ellipse]) -> Ellipse:
    """Return the outline of a dot at a place, as large as those around it."""
    nearest = np.argsort(np.linalg.norm(places_px - place_px, axis=1))[:4]
    return Ellipse(place_px, np.mean([shapes[k].shape_px2 for k in nearest], axis=0))
