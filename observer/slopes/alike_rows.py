"""Rows whose mirror is alike along the trough, solved together: one says of the next how it bends.

Each row's bend is a random walk (`observer.slopes.row_spline`). A sheet of glass twists by a finite angle a metre, so
those of two rows have a correlation that is once differentiable, ``(1 + a) exp(-a)`` with ``a = sqrt(3) distance /
length`` (Matern 1960, order 3/2): with the precision P of one row's walk that of all rows is ``R^-1 (x) P``, R the
correlation. How each row's piece of each panel is turned and bent is not part of P and stays free in every row: panels
are mounted one by one. Were rows that are alike taken to be independent, the smoothness of one mirror would be counted
as often as there are rows: in simulated passes of 18 photos slopes then erred by 2.2 sigma.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from heliogauge.validate import FloatArray, IntArray
from observer.slopes.banded_cholesky import factorise
from observer.slopes.row_spline import LARGEST_SLOPE_RAD, Roughness, RowGrid, Rows, prior_bands

if TYPE_CHECKING:
    from scipy.sparse import csr_array

#: Nodes whose squares are added up in one product.
_NODES_AT_ONCE = 16
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

    Unknowns stand node after node, those of all rows at one node side by side: a block, which is tied to the next
    few blocks.

    turned (n, w, w): Inverses of the root's blocks on the diagonal.
    below (n, k, w, w): The k blocks below each of these; 0 below the last node of a panel.
    n_rows: What the unknowns of a node belong to.
    ends (n,): The node after the last one of each node's panel: nothing ties one panel across the trough to the next.
    """

    turned: FloatArray
    below: FloatArray
    n_rows: int
    ends: IntArray

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the normal equations."""
        return float(-2 * np.log(np.diagonal(self.turned, axis1=1, axis2=2)).sum())

    def _below(self, node: int) -> FloatArray:
        """Return the blocks below a node's own, one below the other, shape (k w, w)."""
        return self.below[node, : self.ends[node] - 1 - node].reshape(-1, self.turned.shape[1])

    def solve(self, right: FloatArray) -> FloatArray:
        """Solve the system.

        Shapes: result (..., r, n).
        right (..., r, n): Right sides, the unknowns of a row in the order of its nodes.
        """
        n_nodes, width, _ = self.turned.shape
        sides = right.reshape(-1, self.n_rows, n_nodes, 2)
        values = np.ascontiguousarray(sides.transpose(2, 1, 3, 0)).reshape(n_nodes * width, -1)
        for i in range(n_nodes):
            own, below = slice(i * width, (i + 1) * width), self._below(i)
            values[own] = self.turned[i] @ values[own]
            values[own.stop : own.stop + len(below)] -= below @ values[own]
        for i in range(n_nodes - 1, -1, -1):
            own, below = slice(i * width, (i + 1) * width), self._below(i)
            values[own] -= below.T @ values[own.stop : own.stop + len(below)]
            values[own] = self.turned[i].T @ values[own]
        found = values.reshape(n_nodes, self.n_rows, 2, -1).transpose(3, 1, 0, 2)
        return np.ascontiguousarray(found).reshape(right.shape)

    def explained(self, pulls: "csr_array") -> FloatArray:
        """Return ``P A^-1 P^T``, A the normal equations, shape (c, c).

        pulls (n, c): P^T, the unknowns of row after row in the order of their nodes.

        With the root L of A it is the square of ``L^-1 P^T``, panel by panel, as a photo shows some of them. An edge's
        photo touches few nodes, and above the first of them its column is zero: columns come in node after node.
        """
        n_nodes, width, _ = self.turned.shape
        reach, count = self.below.shape[1], pulls.shape[1]
        number = np.arange(2 * self.n_rows * n_nodes).reshape(self.n_rows, n_nodes, 2)
        sides = pulls[number.transpose(1, 0, 2).ravel()]
        found = np.zeros((count, count))
        for border, end in pairwise([0, *np.unique(self.ends).tolist()]):
            entries = sides[border * width : end * width].tocoo()
            first = np.full(count, end)
            np.minimum.at(first, entries.col, border + entries.row // width)
            order = np.argsort(first, kind="stable")
            begun = np.searchsorted(first[order], np.arange(border, end), side="right")
            columns = order[: begun[-1]]
            right = entries.tocsr()[:, columns]
            own_part = np.zeros((columns.size, columns.size))
            carried = np.zeros((0, 0))
            for start in range(border, end, _NODES_AT_ONCE):
                stop = min(start + _NODES_AT_ONCE, end)
                most, size = begun[stop - 1 - border], (stop - start) * width
                # What these nodes take off the next ones stands below them.
                table = np.zeros((size + reach * width, most))
                table[:size] = right[(start - border) * width : (stop - border) * width, :most].toarray()
                table[: len(carried), : carried.shape[1]] += carried
                for i in range(start, stop):
                    own, below, many = (i - start) * width, self._below(i), begun[i - border]
                    half = self.turned[i] @ table[own : own + width, :many]
                    table[own : own + width, :many] = half
                    table[own + width : own + width + len(below), :many] -= below @ half
                own_part[:most, :most] += table[:size].T @ table[:size]
                carried = table[size:]
            found[np.ix_(columns, columns)] += own_part
        return found


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
    from scipy.linalg import blas, lapack

    n_rows, n_nodes = rows.grid.n_rows, rows.grid.x_m.size
    own: FloatArray = np.zeros((n_nodes, n_rows, 2, n_rows, 2))
    below: FloatArray = np.zeros((n_nodes, order, n_rows, 2, n_rows, 2))
    each = np.arange(n_rows)
    own[:, each, 0, each, 0] += LARGEST_SLOPE_RAD**-2
    own[:, each, 1, each, 1] += bands[0, :, 1:]
    own[:, :, 0, :, 0] += walk[0, :, None, None] * precision
    for reach in range(1, min(order, n_nodes - 1) + 1):
        to = below[: n_nodes - reach, reach - 1]
        to[:, :, 0, :, 0] += walk[reach, : n_nodes - reach, None, None] * precision
        to[:, each, 1, each, 1] += bands[reach, : n_nodes - reach, 1:]
    normal = np.moveaxis(rows.normal.reshape(n_rows, n_nodes, 2, 4), 0, 1)
    for component in range(2):
        for offset in range(4):
            step, of = divmod(component + offset, 2)
            at = below[: n_nodes - step, step - 1] if step else own
            at[:, each, of, each, component] += normal[: n_nodes - step, :, component, offset]
    width = 2 * n_rows
    own, below = own.reshape(n_nodes, width, width), below.reshape(n_nodes, order, width, width)
    turned = own
    borders = np.concatenate([[0], np.flatnonzero(~rows.grid.joined) + 1, [n_nodes]])
    ends = np.repeat(borders[1:], np.diff(borders))
    for i in range(n_nodes):
        root, info = lapack.dpotrf(own[i].T, lower=0, clean=1)
        if info != 0:
            raise np.linalg.LinAlgError("the slopes of rows that are alike are not determined")
        turned[i] = lapack.dtrtri(root, lower=0)[0].T
        tied = below[i, : ends[i] - 1 - i]
        if not len(tied):
            continue
        under = blas.dtrmm(1.0, turned[i].T, tied.reshape(-1, width).T, trans_a=1).T
        # Its lower half is what is read.
        squares = blas.dsyrk(1.0, under.T, trans=1).T.reshape(len(tied), width, len(tied), width)
        tied[:] = under.reshape(tied.shape)
        for k in range(len(tied)):
            own[i + 1 + k] -= squares[k, :, k]
            for other in range(k):
                below[i + 1 + other, k - other - 1] -= squares[k, :, other]
    return AlikeFactor(turned, below, n_rows, ends)
