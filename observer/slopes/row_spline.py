"""The mirror's slopes from touching lines of sight: smooth along each row, panel by panel, and what all rows share.

Each row of the map (constant y) has nodes along x. A touching line of sight at x says something about the slopes of the
two nodes beside it. Between them the slope error follows a random walk that is integrated once or twice, estimated from
the data like its roughness: the posterior mean is a smoothing spline, and its variance says honestly how little
is known between samples.
The slope along the trough has a prior instead of a measurement where one pass only has seen the mirror.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from heliogauge.validate import BoolArray, FloatArray, IntArray, freeze
from observer.slopes.banded_cholesky import BandedFactor, factorise

if TYPE_CHECKING:
    from scipy.sparse import csr_array


#: A prior for the slope error across the trough that no mirror violates; it only keeps unmeasured rows solvable [rad].
LARGEST_SLOPE_RAD = 0.05
#: Rows of which the processor keeps all that an evidence takes.
_ROWS_AT_ONCE = 32
#: Weights of neighbouring nodes in the differences that are white noise, by order.
_DIFFERENCES = {2: (1.0, -2.0, 1.0), 3: (-1.0, 3.0, -3.0, 1.0)}


@dataclass(frozen=True, slots=True, eq=False)
class RowGrid:
    """Nodes of all rows.

    x_m (nx,): Equally spaced nodes across the trough, an even number [m].
    joined (nx - 1,): Whether neighbouring nodes lie on one panel.
    y_m (r,): Rows [m]; without, nothing is known of one from another.
    """

    x_m: FloatArray
    joined: BoolArray
    n_rows: int
    y_m: FloatArray | None = None

    def chosen(self, rows: IntArray) -> "RowGrid":
        """Return some of the rows."""
        return replace(self, n_rows=rows.size, y_m=None if self.y_m is None else self.y_m[rows])

    @property
    def step_m(self) -> float:
        """Distance of the nodes [m]."""
        return float(self.x_m[1] - self.x_m[0])


@dataclass(frozen=True, slots=True)
class Likeness:
    """How rows are alike along the trough (`observer.slopes.alike_rows`).

    across, order: As of `Roughness`, of all rows as one random field.
    length_m: Length along the trough over which the bends of rows are alike [m].
    """

    across: float
    order: int
    length_m: float


@dataclass(frozen=True, slots=True)
class Roughness:
    """How slopes may vary along a row.

    across: Spectral density of the derivative of this order of the slope error across the trough [rad^2 / m^(2
        order - 1)].
    along_rad: Standard deviation of the slope error along the trough, about zero or about what slopes across tell of it
        (`observer.slopes.twist`) [rad].
    along_length_m: Length over which the slope along the trough is correlated across the trough [m].
    order: 2: the bend of the mirror is a random walk, as where it has kinks. 3: the change of the bend is one, as
        that of waves; what lies between edges then follows from how the mirror bends beside.
    alike: How rows are alike; None where each is a mirror of its own.
    """

    across: float
    along_rad: float = 2e-3
    along_length_m: float = 0.3
    order: int = 2
    alike: Likeness | None = None


@dataclass(frozen=True, slots=True, eq=False)
class TouchingLines:
    """Linearised observations: ``misfit + d_x ds_x + d_y ds_y + sum d_common dp = noise``.

    row (m,): Row of each.
    x_m (m,): Where on the row [m].
    misfit_rad (m,): Angle by which the line misses the tube's edge with the present slopes [rad].
    d_slope_x, d_slope_y (m,): Its derivatives with respect to the slopes there.
    sigma_rad (m,): Standard deviation of the angle from the image [rad].
    common_index (m, c): Which common unknowns move it.
    d_common (m, c): Derivatives with respect to those.
    """

    row: IntArray
    x_m: FloatArray
    misfit_rad: FloatArray
    d_slope_x: FloatArray
    d_slope_y: FloatArray
    sigma_rad: FloatArray
    common_index: IntArray
    d_common: FloatArray

    def chosen(self, which: BoolArray | IntArray) -> "TouchingLines":
        """Return some of them, by whether they are wanted or by their numbers."""
        return TouchingLines(*(getattr(self, name)[which] for name in self.__slots__))

    def alone(self, misfit_rad: FloatArray, sigma_rad: FloatArray) -> "TouchingLines":
        """Return them with other misfits and sigmas, and without common unknowns."""
        return TouchingLines(
            self.row,
            self.x_m,
            misfit_rad,
            self.d_slope_x,
            self.d_slope_y,
            sigma_rad,
            self.common_index[:, :0],
            self.d_common[:, :0],
        )


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Normal equations of all rows by the lines alone, the unknowns of a row in the order of its nodes.

    place (m,): The first of four unknowns of all rows that move each line: (s_x, s_y) of the node before and of the
        node after.
    weights (m, 4): Derivatives of each line's misfit over its sigma with respect to those.
    normal (r, 2 nx, 4): Columns of the normal matrices from the diagonal downwards.
    """

    grid: RowGrid
    place: IntArray
    weights: FloatArray
    normal: FloatArray

    def right_sides(self, values: FloatArray) -> FloatArray:
        """Return the transposed derivatives, shape (r 2 nx, m), times values of the lines over their sigmas."""
        shape = self.normal.shape[:2]
        sums = np.zeros(shape[0] * shape[1])
        for i in range(4):
            sums += np.bincount(self.place + i, values * self.weights[:, i], sums.size)
        return sums.reshape(shape)

    def derivatives(self) -> "csr_array":
        """Return the derivatives of all lines over their sigmas with respect to all unknowns, shape (m, r 2 nx)."""
        from scipy.sparse import csr_array

        table = (self.weights.ravel(), (self.place[:, None] + np.arange(4)).ravel(), 4 * np.arange(self.place.size + 1))
        return csr_array(table, shape=(self.place.size, self.normal.shape[0] * self.normal.shape[1]))

    def under(self, prior: Roughness) -> "RowSystem":
        """Return the factorised normal equations together with what is known of the slopes beforehand."""
        bands = prior_bands(self.grid, prior)
        factor = _factorised(self.normal, bands)
        count = len(self.normal)
        return RowSystem(factor, bands, count * _log_determinant(bands) - float(factor.log_determinant.sum()))

    def evidence(self, prior: Roughness, pulls: FloatArray) -> float:
        """Return the logarithm of how probable the lines are, slopes integrated out, but for a constant.

        pulls (r, 2 nx): Transposed derivatives times the lines' misfits, both over the sigmas.

        Some rows at a time, which stay in the processor's cache: two thirds of the time of all at once.
        """
        bands = prior_bands(self.grid, prior)
        twice = len(self.normal) * _log_determinant(bands)
        for first in range(0, len(self.normal), _ROWS_AT_ONCE):
            some = slice(first, first + _ROWS_AT_ONCE)
            factor = _factorised(self.normal[some], bands)
            twice += float(factor.squares(pulls[some]).sum() - factor.log_determinant.sum())
        return 0.5 * twice


def _factorised(normal: FloatArray, bands: FloatArray) -> BandedFactor:
    """Factorise normal equations of rows, shape (r, 2 nx, 4), together with the prior of each."""
    n, count = bands.shape[1], 2 * len(bands) - 1
    known = np.zeros((n, 2, count))
    known[..., 0::2] = np.moveaxis(bands, 0, -1)
    whole = np.broadcast_to(known.reshape(2 * n, count), (len(normal), 2 * n, count)).copy()
    whole[..., : normal.shape[2]] += normal
    return factorise(whole)


@dataclass(frozen=True, slots=True, eq=False)
class RowSystem:
    """Factorised normal equations of all rows.

    factor: The factorised matrices.
    bands (order + 1, nx, 2): The prior's precision of (s_x, s_y) between a node and itself, the next and those
        after that.
    log_determinant: Logarithm of the determinant of the prior of all rows minus that of the normal matrices.
    """

    factor: BandedFactor
    bands: FloatArray
    log_determinant: float


def assemble(lines: TouchingLines, grid: RowGrid) -> Rows:
    """Set up the normal equations of all rows."""
    before, share = nodes_of(grid, lines.x_m)
    by_x, by_y = lines.d_slope_x / lines.sigma_rad, lines.d_slope_y / lines.sigma_rad
    weights = np.stack([by_x * (1 - share), by_y * (1 - share), by_x * share, by_y * share], axis=1)
    shape = (grid.n_rows, grid.x_m.size)
    node = lines.row * grid.x_m.size + before
    normal = np.zeros((*shape, 2, 4))
    shares = (1 - share) ** 2, (1 - share) * share, share * share
    # All products are those of both derivatives times those of both shares: nine sums, not sixteen.
    for product, columns in ((by_x * by_x, ((0, 0),)), (by_x * by_y, ((0, 1), (1, -1))), (by_y * by_y, ((1, 0),))):
        own, between, next_one = (
            np.bincount(node, product * one, shape[0] * shape[1]).reshape(shape) for one in shares
        )
        own[:, 1:] += next_one[:, :-1]
        # The band of a pair is the distance of its unknowns, two of which belong to each node.
        column, band = columns[0]
        normal[..., column, band] = own
        for column, band in columns:
            normal[..., column, band + 2] = between
    return Rows(grid, 2 * node, weights, normal.reshape(shape[0], -1, 4))


def nodes_of(grid: RowGrid, x_m: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the node before each place and the share of the node after; no share goes across a panel's edge.

    Shapes: before (m,), share (m,).
    x_m (m,): Places on the rows [m].
    """
    position = (x_m - grid.x_m[0]) / grid.step_m
    before = np.clip(np.floor(position).astype(np.intp), 0, grid.x_m.size - 2)
    share = np.clip(position - before, 0.0, 1.0)
    return before, np.where(grid.joined[before], share, np.round(share))


def prior_bands(grid: RowGrid, prior: Roughness) -> FloatArray:
    """Return the prior's precision as bands.

    prior: How slopes may vary.
    Returns (order + 1, nx, 2): Precision of (s_x, s_y) between a node and itself, the next and those after that
        [1/rad^2].

    Across: differences of the order n within a panel have the variance q h^(2n - 1). Along: the process
    (k^2 - d^2/dx^2) s = white noise (Whittle 1954) of the correlation length sqrt(3) / k, on each panel by itself. With
    free ends it varies twice as much there; each node is scaled to the stated standard deviation.
    """
    n, step, order = grid.x_m.size, grid.step_m, prior.order
    bands = np.zeros((order + 1, n, 2))
    bands[0, :, 0] = LARGEST_SLOPE_RAD**-2
    inner = np.lib.stride_tricks.sliding_window_view(grid.joined, order).all(axis=1)
    stiffness = inner / (prior.across * step ** (2 * order - 1))
    for offset, part in enumerate(_DIFFERENCES[order]):
        for reach in range(order + 1 - offset):
            other = _DIFFERENCES[order][offset + reach]
            bands[reach, offset : offset + n - order, 0] += part * other * stiffness
    along = _along_bands(tuple(grid.joined.tolist()), grid.step_m, prior.along_length_m)
    for reach in range(3):
        bands[reach, :, 1] = along[reach] / prior.along_rad**2
    return bands


@lru_cache(maxsize=64)
def _along_bands(joined: tuple[bool, ...], step_m: float, length_m: float) -> FloatArray:
    """Return the precision of slopes along the trough of standard deviation 1, as bands, shape (3, nx).

    joined: Of `RowGrid`.
    """
    link = np.array(joined, dtype=np.float64) / step_m**2
    wave, n = np.sqrt(3) / length_m, link.size + 1
    # Three diagonals of the operator k^2 - d^2/dx^2, and from them those of its square.
    main = np.full(n, wave**2)
    main[:-1] += link
    main[1:] += link
    square = main**2
    square[:-1] += link**2
    square[1:] += link**2
    beside, second = -link * (main[:-1] + main[1:]), link[:-1] * link[1:]
    operator = np.diag(main) - np.diag(link, 1) - np.diag(link, -1)
    inverse = np.linalg.inv(operator)
    deviation = np.sqrt((inverse**2).sum(axis=1))
    bands = np.zeros((3, n))
    bands[0] = deviation**2 * square
    bands[1, :-1] = deviation[:-1] * deviation[1:] * beside
    bands[2, :-2] = deviation[:-2] * deviation[2:] * second
    return freeze(bands)


def _log_determinant(bands: FloatArray) -> float:
    """Return the logarithm of the determinant of the prior of one row."""
    both = np.ascontiguousarray(np.moveaxis(bands, (0, 1, 2), (2, 1, 0)))
    return float(factorise(both).log_determinant.sum())
