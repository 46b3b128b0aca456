"""Slopes of all rows together with what they have in common: camera positions, absorber and its radius."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from heliogauge.validate import BoolArray, FloatArray, IntArray
from observer.slopes.common_elimination import Beside, Reduced, Reduction, inverse_of, root_of
from observer.slopes.row_spline import Likeness, Roughness, RowGrid, TouchingLines, assemble

#: Rows that suffice to estimate the common unknowns; with all of them the solution would cost as much as all else. With
#: many photos fewer rows do, because each mirror point is seen by more of them.
_MOST_ROWS_FOR_COMMON, _FEWEST_ROWS_FOR_COMMON = 48, 12
_ROWS_TIMES_COMMON = 18000
#: Rows with less than this share of the usual number of lines are no sample of the others.
_FEW_LINES = 0.5
#: Rows that suffice to choose the roughness: it is one number, and each row has some hundred lines.
_ROWS_FOR_ROUGHNESS = 16
#: Photos whose lines suffice for that.
_PHOTOS_FOR_ROUGHNESS = 40
#: Share of the variance that the combinations of common unknowns have which are kept as modes of the whole map, and the
#: part of the rest that may be left out before the strongest are chosen.
_MODES_SHARE = 0.99
_MODES_SLACK = 0.1
#: Columns at which the share of the common unknowns is computed; it is smooth within a panel.
_COLUMNS_FOR_SHARES = 64
#: Decimal exponents of the roughness [rad^2 / m^3, rad^2 / m^5] that are searched, by its order: from a mirror that
#: bends by 0.1 mrad within a metre to a crumpled one.
_EXPONENTS = {2: (-8.0, 1.0), 3: (-6.0, 3.0)}
#: Waves of 0.6 m have so many times the roughness in the next order [1/m^2].
_NEXT_ORDER_PER_M2 = 100.0
#: Lengths along the trough over which rows may be alike: from half their distance, below which they are independent, to
#: so many times their extent, beyond which all are one; how many, and how often roughness and length take turns.
_LONGEST, _LENGTHS, _TIMES = 30.0, 10, 3
#: It is found to such a part of the range.
_INTERVALS = 32


#: From rows and columns of nodes to by how much those unknowns that are apart look like slope there, shape (s, n, l).
LooksLikeSlope = Callable[[IntArray, IntArray], FloatArray]
#: From lines of some of the grid's rows, and these rows, to patterns of the lines with the sigmas of their amounts.
Patterns = Callable[[TouchingLines, IntArray], tuple[FloatArray, FloatArray]]
#: From rows to by what factor sigmas of edges are larger for what is found from these rows together.
Enlarged = Callable[[IntArray], float]


@dataclass(frozen=True, slots=True, eq=False)
class TubeShare:
    """What the common unknowns do to the slope less what the tube's place looks like, which is theta_ra as a slope.

    variance (r, nx): Variance from the common unknowns [rad^2].
    modes (k, s, nx): Change for one standard deviation of each of the strongest independent combinations of them
        [rad].
    """

    variance: FloatArray
    modes: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SlopeErrors:
    """Solution for the rows and for what they share.

    slopes (r, nx, 2): Errors of dz/dx and dz/dy of the mirror at the nodes [rad].
    random (r, nx, 2, 2): Covariance of both at each node from noise and from what lies between samples [rad^2].
    shared (r, nx, 2): Variance from the common unknowns [rad^2].
    common (c,): Estimates of the common unknowns.
    covariance_common (c, c): Their covariance.
    mode_rows (s,): Rows at which the modes are given.
    modes (k, s, nx): Change of dz/dx for one standard deviation of each of the strongest independent combinations
        of the common unknowns [rad].
    modes_apart (l, s, nx): The same of those unknowns that are shown apart, with what the others do along with
        them; `modes` are then what the others do besides.
    to_tube: Common share of the slope against the tube as it is; None where it was not asked for.
    beside: Amounts of the patterns that were asked for.
    """

    slopes: FloatArray
    random: FloatArray
    shared: FloatArray
    common: FloatArray
    covariance_common: FloatArray
    mode_rows: IntArray
    modes: FloatArray
    modes_apart: FloatArray
    to_tube: TubeShare | None = None
    beside: Beside | None = None


class RoughnessEvidence:
    """How probable lines are under some roughness, slopes and common unknowns integrated out: a logarithm.

    lines: Observations, misfits with zero slope error and zero common unknowns.
    covariance (c, c): Prior covariance of the common unknowns.

    Of a sample of rows and photos, gathered once; what was asked before is known.
    """

    def __init__(self, lines: TouchingLines, grid: RowGrid, covariance: FloatArray) -> None:
        some, self.grid = _sampled(lines, grid, sample_rows(lines, grid, _ROWS_FOR_ROUGHNESS))
        some, own_covariance = _fewer_common(some, covariance)
        self._reduction = Reduction(some, self.grid, own_covariance)
        self._known: dict[Roughness, float] = {}

    def __call__(self, trial: Roughness) -> float:
        """Return the evidence of a roughness, but for a constant."""
        if trial not in self._known:
            self._known[trial] = self._reduction.under(trial).evidence
        return self._known[trial]


def find_roughness(
    evidence: RoughnessEvidence, prior: Roughness, *, any_order: bool = False, maybe_alike: bool = False
) -> Roughness:
    """Choose the roughness across the trough under which the lines are most probable.

    evidence: Of the lines.
    prior: The slope along the trough, which is kept.
    any_order: Whether the order of the random walk is chosen as well; otherwise it is the prior's.
    maybe_alike: Whether it is looked for how rows are alike, too.

    The roughness is one of some values evenly spread over its logarithm: the largest evidence among them is enclosed
    from the prior's own, which is near after the first round, and found by bisection.
    """
    alone = _most_probable(replace(prior, alike=None), evidence)
    if not any_order:
        return alone if prior.alike is None else replace(alone, alike=_most_probable(prior, evidence).alike)
    other = 5 - alone.order
    start = alone.across * _NEXT_ORDER_PER_M2 ** (other - alone.order)
    both = alone, _most_probable(replace(alone, across=start, order=other), evidence)
    if not maybe_alike:
        return max(both, key=evidence)
    # Each question is answered by what is most probable for it: a row by itself bends as its own edges say best, what
    # all rows have in common is found from all of them together.
    fields = [_with_likeness(both[0], evidence)]
    # Rows are alike over the same length whatever the order.
    fields.append(_with_likeness(both[1], evidence, fields[0].alike))
    return replace(max(both, key=evidence), alike=max(fields, key=evidence).alike)


def _with_likeness(prior: Roughness, evidence: RoughnessEvidence, near: Likeness | None = None) -> Roughness:
    """Return the most probable likeness of rows; none where independent rows are more probable.

    near: What rows are alike by with another order: where it is looked for.
    """
    grid = evidence.grid
    if grid.y_m is None or grid.n_rows < 2:
        return prior
    extent = float(np.ptp(grid.y_m))
    lengths = np.geomspace(extent / (grid.n_rows - 1) / 2, _LONGEST * extent, _LENGTHS)

    def with_alike(number: int, across: float) -> Roughness:
        return replace(prior, alike=Likeness(across, prior.order, float(lengths[number])))

    def at(number: int, across: float) -> float:
        return evidence(with_alike(number, across))

    place, across = _LENGTHS // 2, prior.across
    if near is not None:
        place = int(np.abs(np.log(lengths / near.length_m)).argmin())
    for _ in range(_TIMES):
        for way in (-1, 1):
            while 0 <= place + way < _LENGTHS and at(place + way, across) > at(place, across):
                place += way
        found = _across_of(_most_probable(with_alike(place, across), evidence))
        if found == across:
            break
        across = found
    alike = with_alike(place, across)
    return alike if evidence(alike) > evidence(prior) else prior


def _most_probable(prior: Roughness, evidence_of: RoughnessEvidence) -> Roughness:
    """Return the roughness of the prior's order that has the largest evidence: of all rows where they are alike."""
    low, high = _EXPONENTS[prior.order if prior.alike is None else prior.alike.order]
    width = (high - low) / _INTERVALS

    def trial(interval: int) -> Roughness:
        across = 10.0 ** (low + (interval + 0.5) * width)
        if prior.alike is not None:
            return replace(prior, alike=replace(prior.alike, across=across))
        return replace(prior, across=across)

    def rises(border: int) -> bool:
        """Return whether the evidence rises at a border between intervals; the first and the last enclose it."""
        if border <= 0 or border >= _INTERVALS:
            return border <= 0
        return evidence_of(trial(border)) > evidence_of(trial(border - 1))

    first = int(np.clip((np.log10(_across_of(prior)) - low) / width, 0, _INTERVALS - 1))
    last, stride = first + 1, 1
    while not rises(first):
        first, last, stride = max(first - stride, 0), first, 2 * stride
    stride = 1
    while rises(last):
        first, last, stride = last, min(last + stride, _INTERVALS), 2 * stride
    while last - first > 1:
        middle = (first + last) // 2
        first, last = (middle, last) if rises(middle) else (first, middle)
    return trial(first)


def _across_of(prior: Roughness) -> float:
    return prior.across if prior.alike is None else prior.alike.across


def _fewer_common(lines: TouchingLines, covariance: FloatArray) -> tuple[TouchingLines, FloatArray]:
    """Keep the lines of some photos, evenly spread, and the common unknowns that move them, numbered anew."""
    if len(covariance) == 0:
        return lines, covariance
    leading = np.unique(lines.common_index[:, 0])
    if leading.size <= _PHOTOS_FOR_ROUGHNESS:
        return lines, covariance
    chosen = leading[np.linspace(0, leading.size - 1, _PHOTOS_FOR_ROUGHNESS).round().astype(np.intp)]
    some = lines.chosen(np.isin(lines.common_index[:, 0], chosen))
    kept, number = np.unique(some.common_index, return_inverse=True)
    index = np.asarray(number.reshape(some.common_index.shape), dtype=np.intp)
    return replace(some, common_index=index), covariance[np.ix_(kept, kept)]


def solve_jointly(
    lines: TouchingLines,
    grid: RowGrid,
    prior: Roughness,
    covariance: FloatArray,
    *,
    with_shares: bool | BoolArray | None = True,
    looks_like: LooksLikeSlope | None = None,
    most_rows: int | None = None,
    enlarged: Enlarged | None = None,
    patterns: Patterns | None = None,
) -> SlopeErrors:
    """Solve for slopes and common unknowns.

    lines: Observations, their misfits with zero slope error and zero common unknowns.
    prior: How slopes may vary.
    covariance (c, c): Prior covariance of the common unknowns about zero.
    with_shares (c,): Whether the share of the common unknowns in the slopes' variance is wanted; without it that
        share is zero and there are no modes, which takes half the time. With an array the unknowns that are not
        chosen are shown apart. With None not even the covariance of the common unknowns is computed; it is empty.
    looks_like: By how much the unknowns that are shown apart look like slope across, for the share of both
        together.
    most_rows: Largest number of rows that the common unknowns are estimated from, where rows are so much alike that
        more of them say nothing new.
    enlarged: By what factor sigmas of edges are larger for the common unknowns, because edges of different rows err
        together (`observer.slopes.edge_likeness`); None where each errs by itself.
    patterns: What is looked for in the lines beside slopes and common unknowns, without influence on either.

    The common unknowns are estimated from a sample of rows, the slopes of all rows with them.
    """
    count = len(covariance)
    rows = common_rows(lines, grid, count) if most_rows is None else sample_rows(lines, grid, most_rows)
    is_shown = with_shares is not None and with_shares is not False
    columns = share_columns(grid) if is_shown else None
    reduced, carried = None, None
    if count or is_shown:
        own, fewer = _sampled(lines, grid, rows)
        factor = 1.0 if enlarged is None else enlarged(rows)
        weaker = replace(own, sigma_rad=factor * own.sigma_rad)
        wanted = None if patterns is None else patterns(weaker, rows)
        reduced = Reduction(weaker, fewer, covariance).under(prior, beside=wanted)
        if columns is not None:
            # Slopes follow the common unknowns as they are solved below: row by row, with the edges' own sigmas.
            carried = Reduction(own, fewer, covariance).carried(prior, columns)
    common = np.zeros(0) if reduced is None else reduced.common
    all_rows = assemble(lines, grid)
    system = all_rows.under(prior)
    moved = lines.misfit_rad + np.einsum("mc,mc->m", lines.d_common, common[lines.common_index])
    slopes = system.factor.solve(all_rows.right_sides(-moved / lines.sigma_rad)).reshape(grid.n_rows, -1, 2)
    random = _of_nodes(system.factor.inverse_blocks(), grid.x_m.size)
    posterior = np.zeros((0, 0)) if with_shares is None or reduced is None else inverse_of(reduced.root)
    nothing = np.zeros((0, rows.size, grid.x_m.size))
    if columns is None or reduced is None or carried is None:
        return SlopeErrors(slopes, random, np.zeros_like(slopes), common, posterior, rows, nothing, nothing)
    apart = np.zeros(count, dtype=bool) if not isinstance(with_shares, np.ndarray) else ~with_shares
    beside = None if looks_like is None else looks_like(rows, columns)
    variance, modes = _shares(reduced, carried, apart, beside)
    shared = _between_rows(_between_columns(variance, columns, grid), rows, grid.n_rows)
    shown = [np.moveaxis(_between_columns(np.moveaxis(one, 0, -1), columns, grid), -1, 0) for one in modes]
    to_tube = None if beside is None else TubeShare(shared[..., 2], shown[2])
    values = slopes, random, shared[..., :2], common, posterior, rows, shown[0], shown[1], to_tube
    return SlopeErrors(*values, None if patterns is None else reduced.beside)


def solve_common(lines: TouchingLines, grid: RowGrid, prior: Roughness, covariance: FloatArray) -> FloatArray:
    """Return the common unknowns alone as `solve_jointly` finds them, shape (c,)."""
    own, fewer = _sampled(lines, grid, common_rows(lines, grid, len(covariance)))
    return Reduction(own, fewer, covariance).under(prior).common


def _of_nodes(blocks: FloatArray, n_nodes: int) -> FloatArray:
    """Return the covariance of both slopes of each node, shape (r, nx, 2, 2), from blocks of w nodes."""
    n_rows, n_blocks, size, _ = blocks.shape
    found = np.empty((n_rows, n_blocks, size // 2, 2, 2))
    for i in range(size // 2):
        own = slice(2 * i, 2 * i + 2)
        found[:, :, i] = blocks[..., own, own]
    return found.reshape(n_rows, -1, 2, 2)[:, :n_nodes]


def share_columns(grid: RowGrid) -> IntArray:
    """Return the nodes at which the share of the common unknowns is computed: evenly spread, and beside panel edges.

    Shapes: result (n,).
    """
    n = grid.x_m.size
    even = np.linspace(0, n - 1, min(n, _COLUMNS_FOR_SHARES)).round().astype(np.intp)
    edges = np.nonzero(~grid.joined)[0]
    return np.unique(np.concatenate([even, edges, edges + 1]))


def common_rows(lines: TouchingLines, grid: RowGrid, count: int) -> IntArray:
    """Return the rows that some number of common unknowns are estimated from, shape (s,).

    Shapes: result (s,).
    """
    wanted = _ROWS_TIMES_COMMON // max(count, 1)
    return sample_rows(lines, grid, min(max(wanted, _FEWEST_ROWS_FOR_COMMON), _MOST_ROWS_FOR_COMMON))


def sample_rows(lines: TouchingLines, grid: RowGrid, most: int) -> IntArray:
    """Return rows spread over the part of the mirror that has lines, shape (s,).

    Shapes: result (s,).
    """
    number = np.bincount(lines.row, minlength=grid.n_rows)
    usual = float(np.median(number[number > 0])) if number.any() else 0.0
    # The rows at the ends of the trough have few lines, and shadows may leave most rows without any: these say little
    # of the others.
    told = np.nonzero((number > 0) & (number >= _FEW_LINES * usual))[0]
    return told[np.unique(np.linspace(0, told.size - 1, min(told.size, most)).round().astype(np.intp))]


def _sampled(lines: TouchingLines, grid: RowGrid, rows: IntArray) -> tuple[TouchingLines, RowGrid]:
    """Keep some rows, numbered anew."""
    number = np.full(grid.n_rows, -1)
    number[rows] = np.arange(rows.size)
    some = lines.chosen(number[lines.row] >= 0)
    return replace(some, row=number[some.row]), grid.chosen(rows)


def _shares(
    reduced: Reduced, carried: FloatArray, apart: BoolArray, beside: FloatArray | None
) -> tuple[FloatArray, list[FloatArray]]:
    """Return what the slopes have from the common unknowns.

    carried (r, n, 2, c): By how much they change against each of these.

    That is the variance, shape (r, n, 2), and the strongest independent changes of dz/dx, shape (k, r, n) each, by the
    unknowns that are not apart with the others held, and by these, the former following along. With what those apart
    look like beside there is a third variance, and the strongest changes of that slope.
    """
    from scipy.linalg import blas

    n_rows, n_columns, _, count = carried.shape
    root, carried = reduced.root, carried.reshape(-1, count)
    if apart.any():
        # Those that are apart as the last ones: the root then splits what both do.
        order = np.argsort(apart, kind="stable")
        root, carried = root_of(reduced.normal[np.ix_(order, order)])[0], carried[:, order]
    # In single precision, which is a millionth of a variance; these products are the most expensive of all.
    flat = carried.astype(np.float32).T
    if count:
        flat = np.asarray(blas.strsm(1.0, np.asfortranarray(root, dtype=np.float32), flat, lower=1))
    variance = np.einsum("ck,ck->k", flat, flat).astype(np.float64).reshape(n_rows, n_columns, 2)
    first = int(np.count_nonzero(~apart))
    across = flat.reshape(-1, n_rows * n_columns, 2)[..., 0]
    shown = [across[:first], across[first:]]
    if beside is not None:
        # What only the last unknowns do stays zero before them.
        extra = np.asfortranarray(beside.reshape(n_rows * n_columns, -1).T, dtype=np.float32)
        if first < count:
            extra = blas.strsm(1.0, np.asfortranarray(root[first:, first:], dtype=np.float32), extra, lower=1)
        shown.append(np.concatenate([across[:first], across[first:] + extra]))
        third = np.square(shown[2]).sum(axis=0, dtype=np.float64).reshape(n_rows, n_columns, 1)
        variance = np.concatenate([variance, third], axis=2)
    return variance, [_strongest(one).reshape(-1, n_rows, n_columns) for one in shown]


def _strongest(changes: npt.NDArray[np.float32]) -> FloatArray:
    """Return the principal parts of changes by independent unknowns of unit variance, shapes (c, k) and (s, k).

    As many as hold their share of the variance. They are found from a Cholesky root of the covariance of all places
    that takes the place with the largest variance that is left as the next one: a column of it costs as little as one
    mode, where all eigenvectors of a thousand unknowns would take as long as the slopes.
    """
    left = np.square(changes).sum(axis=0, dtype=np.float64)
    whole = float(left.sum())
    most = min(changes.shape)
    root = np.zeros((most, changes.shape[1]))
    count = 0
    while count < most and left.sum() > _MODES_SLACK * (1 - _MODES_SHARE) * whole:
        place = int(np.argmax(left))
        column = (changes[:, place] @ changes) - root[:count, place] @ root[:count]
        root[count] = column / np.sqrt(left[place])
        left = np.maximum(left - root[count] ** 2, 0.0)
        left[place] = 0.0
        count += 1
    values, vectors = np.linalg.eigh(root[:count] @ root[:count].T)
    enough = np.cumsum(values[::-1]) < _MODES_SHARE * whole
    kept = min(count, int(np.count_nonzero(enough)) + 1)
    return np.asarray(vectors[:, ::-1][:, :kept].T @ root[:count])


def _between_columns(values: FloatArray, columns: IntArray, grid: RowGrid) -> FloatArray:
    """Interpolate values of chosen nodes, shape (s, n, ...), to all nodes, shape (s, nx, ...)."""
    return np.swapaxes(_between_rows(np.swapaxes(values, 0, 1), columns, grid.x_m.size), 0, 1)


def _between_rows(values: FloatArray, rows: IntArray, n_rows: int) -> FloatArray:
    """Interpolate values of sampled rows, shape (s, ...), to all rows; beyond the last they stay."""
    if rows.size == 1:
        return np.repeat(values, n_rows, axis=0)
    place = np.arange(n_rows)
    before = np.clip(np.searchsorted(rows, place, side="right") - 1, 0, rows.size - 2)
    share = np.clip((place - rows[before]) / (rows[before + 1] - rows[before]), 0.0, 1.0)
    share = share.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((1 - share) * values[before] + share * values[before + 1])
