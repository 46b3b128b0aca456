"""Rows whose mirror is alike along the trough, solved together: one says of the next how it bends.

Each row's bend is a random walk (`observer.slopes.row_spline`). A sheet of glass twists by a finite angle a metre, so
those of two rows have a correlation that is once differentiable, ``(1 + a) exp(-a)`` with ``a = sqrt(3) distance /
length`` (Matern 1960, order 3/2): with the precision P of one row's walk that of all rows is ``R^-1 (x) P``, R the
correlation. How each row's piece of each panel is turned and bent is not part of P and stays free in every row: panels
are mounted one by one. Were rows that are alike taken to be independent, the smoothness of one mirror would be counted
as often as there are rows: in simulated passes of 18 photos slopes then erred by 2.2 sigma.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from heliogauge.validate import FloatArray
from observer.slopes.banded_cholesky import factorise
from observer.slopes.row_spline import LARGEST_SLOPE_RAD, Roughness, RowGrid, Rows, prior_bands

if TYPE_CHECKING:
    from scipy.sparse import csr_array

#: Blocks whose squares are added up in one product.
_BLOCKS_AT_ONCE = 8
#: Share of a row's bend that no other row has: it keeps the correlation of rows that are alike entirely invertible.
_OWN_SHARE = 1e-3
#: What one row of the smoothest mirror has as precision [1/rad^2]: 20 is the middle of the third differences' square.
#: Differences of rows that are alike may not have more of it, or double precision does not hold what is free besides.
_STIFFEST = 6e15


def rows_correlation(grid: RowGrid, prior: Roughness) -> FloatArray | None:
    """Return the correlation of the rows' bends, shape (r, r); None where they are independent."""
    if grid.y_m is None or prior.alike is None or grid.n_rows < 2:
        return None
    away = np.sqrt(3.0) * np.abs(grid.y_m[:, None] - grid.y_m) / prior.alike.length_m
    stiffness = 20.0 / (prior.alike.across * grid.step_m ** (2 * prior.alike.order - 1))
    own = min(max(_OWN_SHARE, stiffness / _STIFFEST), 0.5)
    return np.asarray((1 - own) * (1 + away) * np.exp(-away) + own * np.eye(grid.n_rows))


@dataclass(frozen=True, slots=True, eq=False)
class AlikeFactor:
    """Block Cholesky root of the normal equations of all rows together.

    Unknowns stand node after node, those of all rows at one node side by side; some neighbouring nodes are a block,
    which is tied to the next block only.

    turned (b, w, w): Inverses of the root's blocks on the diagonal.
    below (b - 1, w, w): Blocks below these.
    n_rows, n_nodes: What the unknowns belong to.
    """

    turned: FloatArray
    below: FloatArray
    n_rows: int
    n_nodes: int

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the normal equations."""
        return float(-2 * np.log(np.diagonal(self.turned, axis1=1, axis2=2)).sum())

    def solve(self, right: FloatArray) -> FloatArray:
        """Solve the system.

        Shapes: result (..., r, n).
        right (..., r, n): Right sides, the unknowns of a row in the order of its nodes.
        """
        n_blocks, width, _ = self.turned.shape
        sides = right.reshape(-1, self.n_rows, self.n_nodes, 2)
        values = np.zeros((n_blocks * width // (2 * self.n_rows), self.n_rows, 2, len(sides)))
        values[: self.n_nodes] = sides.transpose(2, 1, 3, 0)
        blocks = values.reshape(n_blocks, width, -1)
        blocks[0] = self.turned[0] @ blocks[0]
        for i in range(1, n_blocks):
            blocks[i] = self.turned[i] @ (blocks[i] - self.below[i - 1] @ blocks[i - 1])
        blocks[-1] = self.turned[-1].T @ blocks[-1]
        for i in range(n_blocks - 2, -1, -1):
            blocks[i] = self.turned[i].T @ (blocks[i] - self.below[i].T @ blocks[i + 1])
        return np.ascontiguousarray(values[: self.n_nodes].transpose(3, 1, 0, 2)).reshape(right.shape)

    def explained(self, pulls: "csr_array") -> FloatArray:
        """Return ``P A^-1 P^T``, A the normal equations, shape (c, c).

        pulls (n, c): P^T, the unknowns of row after row in the order of their nodes.

        With the root L of A it is the square of ``L^-1 P^T``. An edge's photo touches few nodes, and above the first of
        them its column is zero: columns come into the blocks one after the other.
        """
        n_blocks, width, _ = self.turned.shape
        count = pulls.shape[1]
        number = np.arange(2 * self.n_rows * self.n_nodes).reshape(self.n_rows, self.n_nodes, 2)
        sides = pulls[number.transpose(1, 0, 2).ravel()].tocoo()
        first = np.full(count, n_blocks)
        np.minimum.at(first, sides.col, sides.row // width)
        order = np.argsort(first, kind="stable")
        begun = np.searchsorted(first[order], np.arange(n_blocks), side="right")
        right = sides.tocsr()[:, order]
        found = np.zeros((count, count))
        half = np.zeros((width, 0))
        for start in range(0, n_blocks, _BLOCKS_AT_ONCE):
            own = range(start, min(start + _BLOCKS_AT_ONCE, n_blocks))
            most = begun[own[-1]]
            dense = right[start * width : (own[-1] + 1) * width, :most].toarray()
            table = np.zeros((len(own) * width, most))
            table[: len(dense)] = dense
            for k, i in enumerate(own):
                block = table[k * width : (k + 1) * width, : begun[i]]
                block[:, : half.shape[1]] -= self.below[i - 1] @ half if i else 0.0
                half = self.turned[i] @ block
                block[:] = half
            found[:most, :most] += table.T @ table
        back = np.argsort(order)
        return found[np.ix_(back, back)]


@dataclass(frozen=True, slots=True, eq=False)
class AlikeSystem:
    """Factorised normal equations of all rows together, as `observer.slopes.row_spline.RowSystem`."""

    factor: AlikeFactor
    log_determinant: float


def alike_system(rows: Rows, prior: Roughness, correlation: FloatArray) -> AlikeSystem:
    """Factorise the normal equations of rows that are alike.

    rows: What the lines say.
    prior: How slopes may vary.
    correlation (r, r): Of the rows' bends.
    """
    if prior.alike is not None:
        prior = replace(prior, across=prior.alike.across, order=prior.alike.order)
    bands = prior_bands(rows.grid, prior)
    walk = _walk(rows.grid, prior, bands)
    bands[..., 0] = walk
    bands[0, :, 0] += LARGEST_SLOPE_RAD**-2
    precision = np.linalg.inv(correlation)
    factor = _factorised(rows, bands, walk, 0.5 * (precision + precision.T), prior.order)
    # In combinations of rows that are independent of each other the walk's precision is that of one row over their
    # variance.
    variance = np.linalg.eigvalsh(correlation)
    own = walk.T / variance[:, None, None]
    own[..., 0] += LARGEST_SLOPE_RAD**-2
    along = np.ascontiguousarray(bands[..., 1].T)[None]
    known = float(factorise(own).log_determinant.sum() + rows.grid.n_rows * factorise(along).log_determinant.sum())
    return AlikeSystem(factor, known - factor.log_determinant)


def _walk(grid: RowGrid, prior: Roughness, bands: FloatArray) -> FloatArray:
    """Return the precision of one row's walk as bands, shape (order + 1, nx)."""
    walk = bands[..., 0].copy()
    walk[0] -= LARGEST_SLOPE_RAD**-2
    if prior.order == 2:
        return walk
    # A walk of the third order leaves the change of the bend b free in each row, too, which rows that are alike share.
    # It is remembered over the length l of a panel: b' + b / l = white noise.
    ends = np.flatnonzero(np.concatenate([[True], ~grid.joined, [True]]))
    panel_m = grid.step_m * float(np.diff(ends).max())
    held = prior_bands(grid, replace(prior, across=prior.across * panel_m**2, order=2))[..., 0]
    held[0] -= LARGEST_SLOPE_RAD**-2
    walk[: len(held)] += held
    return walk


def _factorised(rows: Rows, bands: FloatArray, walk: FloatArray, precision: FloatArray, order: int) -> AlikeFactor:
    """Set up and factorise the blocks."""
    from scipy.linalg import lapack

    n_rows, n_nodes = rows.grid.n_rows, rows.grid.x_m.size
    n_blocks = -(-n_nodes // order)
    shape = (n_blocks, order, n_rows, 2, order, n_rows, 2)
    own, below = np.zeros((2, *shape))
    each = np.arange(n_rows)

    def of_nodes(values: FloatArray, first: int, fill: float = 0.0) -> FloatArray:
        """Return the values of the nodes that are the first, second .. of their block, shape (b, ...)."""
        filled = np.full((n_blocks * order, *values.shape[1:]), fill)
        filled[:n_nodes] = values
        return filled[first::order]

    normal = np.moveaxis(rows.normal.reshape(n_rows, n_nodes, 2, 4), 0, 1)
    for node in range(order):
        # Nodes that are not there are unit rows.
        own[:, node, each, 0, node, each, 0] += of_nodes(np.full((n_nodes, 1), LARGEST_SLOPE_RAD**-2), node, 1.0)
        own[:, node, each, 1, node, each, 1] += of_nodes(bands[0, :, 1:], node, 1.0)
        for reach in range(order + 1):
            other = node + reach
            at, to = (own, other) if other < order else (below, other - order)
            pairs = of_nodes(walk[reach], node)[:, None, None] * precision
            at[:, to, :, 0, node, :, 0] += pairs
            if reach:
                at[:, to, each, 1, node, each, 1] += of_nodes(bands[reach, :, 1:], node)
        for component in range(2):
            for offset in range(4):
                step, of = divmod(component + offset, 2)
                other = node + step
                at, to = (own, other) if other < order else (below, other - order)
                at[:, to, each, of, node, each, component] += of_nodes(normal[:, :, component, offset], node)
    width = 2 * order * n_rows
    own, below = own.reshape(n_blocks, width, width), below.reshape(n_blocks, width, width)[:-1]
    turned = own
    for i in range(n_blocks):
        root, info = lapack.dpotrf(own[i].T, lower=0, clean=1)
        if info != 0:
            raise np.linalg.LinAlgError("the slopes of rows that are alike are not determined")
        turned[i] = lapack.dtrtri(root, lower=0)[0].T
        if i + 1 < n_blocks:
            below[i] = below[i] @ turned[i].T
            own[i + 1] -= below[i] @ below[i].T
    return AlikeFactor(turned, below, n_rows, n_nodes)
