"""Dots of a pattern in a photo: found, centred to hundredths of a pixel, and given their places in a lattice."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.errors import EstimationError
from heliogauge.validate import BoolArray, FloatArray, IntArray
from photogrammetry.centers import (
    Ellipse,
    TargetCenter,
    counted_share,
    has_free_ground,
    light_centers,
    measure_centers,
)
from photogrammetry.detection import SearchLimits, find_outlines
from photogrammetry.targets import Polarity

#: Dots in a mirror are small and may be drawn out: nothing that the finder can see is left out beforehand.
_SMALLEST_PX, _LARGEST_PX, _LEAST_CONTRAST_DN, _MOST_TILT_RAD = 3.0, 60.0, 8.0, 1.3
#: Dots with a smaller semi-axis below this are centred by their light: a template has to tell their size from their
#: blur. On drawn dots with blurs of 0 to 1 px the centre of light errs less up to 3 px and as much at 4 px [px].
_SMALL_PX = 4.0
#: Logarithm of the contrast of a dot that only the lattice expects over that of its neighbours, at most: half or twice.
_LIKE_NEIGHBOURS = np.log(2.0)
#: Share of its neighbours' contrast below which there is no dot: half of the least that one may have.
_NOTHING = 0.25
#: So many of the nearest dots say how large a dot is that only the lattice expects.
LIKE_SO_MANY = 4
#: Dots whose blur and size stand for all: both are known to a tenth from each.
_BLUR_DOTS = 60
#: Standard deviation of a pixel's own width [px].
_PIXEL_PX = 12.0**-0.5
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
    blur_px: Usual blur of a dot's edge, as the standard deviation of a Gaussian, pixel included [px].
    cut (n,): Dots that the mirror's edge cuts: they have a number, but no centre; None: none.
    """

    centers_px: FloatArray
    covariance_px2: FloatArray
    number: IntArray
    contrast_dn: FloatArray
    residual_dn: float
    n_coarse: int = 0
    shapes_px2: FloatArray | None = None
    blur_px: float = 0.0
    cut: BoolArray | None = None

    @property
    def is_cut(self) -> BoolArray:
        """Which dots the mirror's edge cuts, shape (n,)."""
        return np.zeros(len(self.number), dtype=np.bool_) if self.cut is None else self.cut

    @property
    def outlines_px2(self) -> FloatArray:
        """Shape of each dot's ellipse; circles of a quarter of the dots' distance where nobody measured it [px^2]."""
        if self.shapes_px2 is not None:
            return self.shapes_px2
        return np.tile((0.25 * self.spacing_px) ** 2 * np.eye(2), (len(self.number), 1, 1))

    @property
    def spacing_px(self) -> float:
        """Usual distance of neighbouring dots [px]."""
        from scipy.spatial import cKDTree

        some = self.centers_px[:: max(len(self.centers_px) // 500, 1)]
        return float(np.median(cKDTree(self.centers_px).query(some, 2)[0][:, 1]))

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
            self.blur_px,
            None if self.cut is None else self.cut[index],
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
    places, shapes = find_outlines(image_dn, limits)
    inside = _sees(region, places)
    spots = _Spots(places[inside], shapes[inside])
    if len(spots.places_px) < FEWEST_DOTS:
        raise EstimationError(
            f"the mirror shows {len(spots.places_px)} dots, fewer than {FEWEST_DOTS}; check exposure and focus, that "
            f"the pattern is seen in the mirror, and whether its dots are {polarity.value.split('-')[0]}"
        )
    number, lattice = index_lattices(spots.places_px)
    of_each = [lattice == one for one in range(lattice.max() + 1)] if several else [_largest(lattice)]
    return tuple(_measured(image_dn, spots, number, each) for each in of_each)


@dataclass(frozen=True, slots=True, eq=False)
class _Spots:
    """Outlines of spots: centres (n, 2) [px] and shapes (n, 2, 2) [px^2]."""

    places_px: FloatArray
    shapes_px2: FloatArray

    def chosen(self, which: IntArray | BoolArray) -> "_Spots":
        return _Spots(self.places_px[which], self.shapes_px2[which])

    def ellipses(self) -> list[Ellipse]:
        return [Ellipse(place, shape) for place, shape in zip(self.places_px, self.shapes_px2, strict=True)]


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


def _measured(image_dn: npt.NDArray[Any], spots: _Spots, number: IntArray, on_lattice: BoolArray) -> FoundDots:
    """Measure the dots of one lattice, those too that only the lattice expects."""
    chosen, number = spots.chosen(on_lattice), number[on_lattice]
    places = chosen.places_px
    centres = _centres(image_dn, spots, chosen)
    good = centres.settled
    if np.count_nonzero(good) < FEWEST_DOTS:
        raise EstimationError(
            f"of {len(places)} dots only {np.count_nonzero(good)} have a centre; check focus and exposure: dots need "
            "4 px and more"
        )
    expected, their_number = expected_dots(places, number)
    like, usual_dn = _like_neighbours(expected, chosen, centres.contrast_dn)
    more = _centres(image_dn, spots, like, float(np.median(centres.residual_dn[good])), usual_dn)
    with np.errstate(invalid="ignore", divide="ignore"):
        there = more.settled & (np.abs(np.log(more.contrast_dn / usual_dn)) < _LIKE_NEIGHBOURS)
    # What has no centre of its own keeps that of its outline, as sure as those of its neighbours are.
    off = centres.centers_px[good] - places[good]
    coarse = np.diag([robust_scale(off[:, axis]) ** 2 for axis in (0, 1)])
    n_coarse = int(np.count_nonzero(~good))
    blur_px, share = _blur_and_size(image_dn, chosen.chosen(good))
    # An outline is as large as the blur makes the dot: without it the same light is on less area.
    by_outline = np.concatenate([centres.by_light[good], more.by_light[there], np.ones(n_coarse, dtype=np.bool_)])
    size = np.where(by_outline, share, 1.0)
    shapes = np.concatenate([centres.shapes_px2[good], more.shapes_px2[there], chosen.shapes_px2[~good]])
    contrast = np.concatenate([centres.contrast_dn[good], more.contrast_dn[there], np.full(n_coarse, np.nan)])
    outline_px = float(np.median(np.linalg.det(chosen.shapes_px2) ** 0.25))
    counted = counted_share(np.sqrt(share) * outline_px, blur_px, outline_px) if by_outline.any() else 1.0
    return FoundDots(
        np.concatenate([centres.centers_px[good], more.centers_px[there], places[~good]]),
        np.concatenate([centres.covariance_px2[good], more.covariance_px2[there], np.tile(coarse, (n_coarse, 1, 1))]),
        np.concatenate([number[good], their_number[there], number[~good]]),
        contrast / np.where(by_outline, counted * size, 1.0),
        float(np.median(np.concatenate([centres.residual_dn[good], more.residual_dn[there]]))),
        n_coarse,
        shapes * size[:, None, None],
        blur_px,
    )


def _blur_and_size(image_dn: npt.NDArray[Any], dots: _Spots) -> tuple[float, float]:
    """Return the blur of dots' edges, pixel included [px], and how large dots are without it, from some of them.

    Returns: The blur and the share of their outlines' areas; 1 and 1 where no template fits any dot.
    """
    which = np.linspace(0, len(dots.places_px) - 1, _BLUR_DOTS).astype(np.intp)
    fitted = measure_centers(image_dn, dots.chosen(which).ellipses())
    found = [(row, one) for row, one in zip(which.tolist(), fitted, strict=True) if isinstance(one, TargetCenter)]
    if not found:
        return 1.0, 1.0
    share = [(one.ellipse.radius_px / Ellipse(np.zeros(2), dots.shapes_px2[row]).radius_px) ** 2 for row, one in found]
    return float(np.hypot(np.median([one.blur_px for _, one in found]), _PIXEL_PX)), float(np.median(share))


@dataclass(frozen=True, slots=True, eq=False)
class _Centres:
    """Centres of n dots, of those that settled; contrast and residual as in `FoundDots`.

    by_light (n,): Centred by their light: their shapes are those of outlines, and their contrasts go with these.
    """

    centers_px: FloatArray
    covariance_px2: FloatArray
    shapes_px2: FloatArray
    contrast_dn: FloatArray
    residual_dn: FloatArray
    settled: BoolArray
    by_light: BoolArray


def _centres(
    image_dn: npt.NDArray[Any],
    every: _Spots,
    dots: _Spots,
    noise_dn: float | None = None,
    usual_dn: FloatArray | None = None,
) -> _Centres:
    """Measure dots: small ones that have free ground around them by their light, others by a template.

    every: All spots of the photo, which may stand beside the dots.
    noise_dn: Usual noise of a pixel where it is known [DN].
    usual_dn (n,): Usual contrast of dots where there may be none [DN].
    """
    from scipy.spatial import cKDTree

    count = len(dots.places_px)
    trace, determinant = np.einsum("nii->n", every.shapes_px2), np.linalg.det(every.shapes_px2)
    smaller = np.sqrt(np.maximum(0.5 * trace - np.sqrt(np.maximum(0.25 * trace**2 - determinant, 0.0)), 0.0))
    if count and np.median(smaller) < _SMALL_PX:
        # The next spot but itself; a place where none was found has itself to spare.
        apart, near = cKDTree(every.places_px).query(dots.places_px, 2)
        other = np.where(apart[:, 0] < 0.5 * smaller[near[:, 0]], 1, 0)
        rows = np.arange(count)
        free = apart[rows, other] - np.sqrt(0.5 * trace[near[rows, other]]) - 1.0
        if np.median(has_free_ground(dots.shapes_px2, free)) > 0:
            found = light_centers(image_dn, dots.places_px, dots.shapes_px2, free, noise_dn)
            result = _Centres(
                found.centers_px,
                found.covariance_px2,
                dots.shapes_px2.copy(),
                np.abs(found.contrast_dn),
                np.full(count, found.residual_dn),
                found.settled.copy(),
                np.ones(count, dtype=np.bool_),
            )
            # Beside the mirror's edge, or a light: the template leaves out what is no disc. On even ground that shows
            # nothing, as all around the pattern, it would take its most steps to tell the same.
            seen = True if usual_dn is None else ~(np.abs(found.start_contrast_dn) < _NOTHING * usual_dn)
            _by_template(image_dn, dots, np.flatnonzero(~found.settled & seen), result)
            return result
    unknown = np.full(count, np.nan)
    result = _Centres(
        dots.places_px.copy(),
        np.full((count, 2, 2), np.nan),
        dots.shapes_px2.copy(),
        unknown,
        unknown.copy(),
        np.zeros(count, dtype=np.bool_),
        np.zeros(count, dtype=np.bool_),
    )
    _by_template(image_dn, dots, np.arange(count), result)
    return result


def _by_template(image_dn: npt.NDArray[Any], dots: _Spots, rows: IntArray, into: _Centres) -> None:
    """Measure some of the dots by a template, and write what settles."""
    for row, one in zip(rows.tolist(), measure_centers(image_dn, dots.chosen(rows).ellipses()), strict=True):
        if isinstance(one, TargetCenter):
            into.centers_px[row], into.covariance_px2[row] = one.center_px, one.covariance_px2
            into.shapes_px2[row], into.contrast_dn[row] = one.ellipse.shape_px2, abs(one.contrast_dn)
            into.residual_dn[row], into.settled[row], into.by_light[row] = one.residual_dn, True, False


def _sees(region: BoolArray, places_px: FloatArray) -> BoolArray:
    column, row = np.rint(places_px).astype(np.intp).T
    inside = (row >= 0) & (row < region.shape[0]) & (column >= 0) & (column < region.shape[1])
    inside[inside] = region[row[inside], column[inside]]
    return np.asarray(inside)


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
        steps, before = _steps_around(places_px, near, links, steps), links
        links = _links(near, apart, steps)
        if np.array_equal(links, before):
            break
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
        steps[known[:, axis], axis] = _medians(around[known[:, axis], :, axis])
    return steps


def _medians(values: FloatArray) -> FloatArray:
    """Return the medians (n, 2) of (n, k, 2), without NaN: numpy's own masks arrays and takes five times as long."""
    ordered = np.sort(values, axis=1)
    count = np.isfinite(values[..., 0]).sum(axis=1)
    rows = np.arange(len(values))
    return np.asarray(0.5 * (ordered[rows, (count - 1) // 2] + ordered[rows, count // 2]))


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


def expected_dots(places_px: FloatArray, number: IntArray) -> tuple[FloatArray, IntArray]:
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


def _like_neighbours(places_px: FloatArray, dots: _Spots, contrast_dn: FloatArray) -> tuple[_Spots, FloatArray]:
    """Return outlines at places, as large as those around each, and the usual contrast there."""
    from scipy.spatial import cKDTree

    if not len(places_px):
        return _Spots(places_px, np.zeros((0, 2, 2))), np.zeros(0)
    nearest = cKDTree(dots.places_px).query(places_px, LIKE_SO_MANY)[1]
    with np.errstate(invalid="ignore"):
        usual = np.median(np.where(np.isfinite(contrast_dn), contrast_dn, np.nanmedian(contrast_dn))[nearest], axis=1)
    return _Spots(places_px, dots.shapes_px2[nearest].mean(axis=1)), usual


def like_neighbours(places_px: FloatArray, dots_px: FloatArray, shapes_px2: FloatArray) -> list[Ellipse]:
    """Return the outlines of dots at places (n, 2), as large as those around them: at least `LIKE_SO_MANY`."""
    if not len(places_px):
        return []
    spots, _ = _like_neighbours(places_px, _Spots(dots_px, shapes_px2), np.ones(len(dots_px)))
    return spots.ellipses()
