"""The mirror's slopes from touching lines of sight: smooth along each row, panel by panel, and what all rows share.

Each row of the map (constant y) has nodes along x. A touching line of sight at x says something about the slopes of the
two nodes beside it. Between them the slope error follows a random walk that is integrated once or twice, as the data
themselves tell like its roughness: the posterior mean is a smoothing spline, and its variance says honestly how little
is known between samples.
The slope along the trough has a prior instead of a measurement where one pass only has seen the mirror.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliogauge.validate import BoolArray, FloatArray
from observer.block_tridiagonal import BlockFactor, factorise

IntArray = npt.NDArray[np.intp]

#: A prior for the slope error across the trough that no mirror violates; it only keeps unmeasured rows solvable [rad].
_LARGEST_SLOPE_RAD = 0.05
#: Weights of neighbouring nodes in the differences that are white noise, by order.
_DIFFERENCES = {2: (1.0, -2.0, 1.0), 3: (-1.0, 3.0, -3.0, 1.0)}


@dataclass(frozen=True, slots=True, eq=False)
class RowGrid:
    """Nodes of all rows.

    Parameters
    ----------
    x_m : ndarray, shape (nx,)
        Equally spaced nodes across the trough, an even number [m].
    joined : ndarray of bool, shape (nx - 1,)
        Whether neighbouring nodes lie on one panel.
    n_rows : int
        Number of rows.
    """

    x_m: FloatArray
    joined: BoolArray
    n_rows: int

    @property
    def step_m(self) -> float:
        """Distance of the nodes [m]."""
        return float(self.x_m[1] - self.x_m[0])


@dataclass(frozen=True, slots=True)
class Roughness:
    """How slopes may vary along a row.

    Parameters
    ----------
    across : float
        Spectral density of the derivative of this order of the slope error across the trough
        [rad^2 / m^(2 order - 1)].
    along_rad : float
        Standard deviation of the slope error along the trough, about zero [rad].
    along_length_m : float
        Length over which the slope along the trough is correlated across the trough [m].
    order : int, optional
        2: the bend of the mirror is a random walk, as where it has kinks. 3: the change of the bend is one, as that of
        waves; what lies between edges then follows from how the mirror bends beside.
    """

    across: float
    along_rad: float = 2e-3
    along_length_m: float = 0.3
    order: int = 2


@dataclass(frozen=True, slots=True, eq=False)
class TouchingLines:
    """Linearised observations: ``misfit + d_x ds_x + d_y ds_y + sum d_common dp = noise``.

    Parameters
    ----------
    row : ndarray of int, shape (m,)
        Row of each.
    x_m : ndarray, shape (m,)
        Where on the row [m].
    misfit_rad : ndarray, shape (m,)
        Angle by which the line misses the tube's edge with the present slopes [rad].
    d_slope_x, d_slope_y : ndarray, shape (m,)
        Its derivatives with respect to the slopes there.
    sigma_rad : ndarray, shape (m,)
        Standard deviation of the angle from the image [rad].
    common_index : ndarray of int, shape (m, c)
        Which common unknowns move it.
    d_common : ndarray, shape (m, c)
        Derivatives with respect to those.
    """

    row: IntArray
    x_m: FloatArray
    misfit_rad: FloatArray
    d_slope_x: FloatArray
    d_slope_y: FloatArray
    sigma_rad: FloatArray
    common_index: IntArray
    d_common: FloatArray

    def chosen(self, which: npt.NDArray[np.bool_]) -> "TouchingLines":
        """Return some of them."""
        return TouchingLines(*(getattr(self, name)[which] for name in self.__slots__))


@dataclass(frozen=True, slots=True, eq=False)
class RowSystem:
    """Factorised normal equations of all rows; the unknowns of two or three neighbouring nodes form one block.

    Parameters
    ----------
    factor : BlockFactor
        The factorised matrices.
    before : ndarray of int, shape (m,)
        Node before each line.
    weights : ndarray, shape (m, 4)
        Derivatives of each line's misfit with respect to (s_x, s_y) of the node before and of the node after.
    bands : ndarray, shape (order + 1, nx, 2)
        The prior's precision of (s_x, s_y) between a node and itself, the next and those after that.
    log_determinant : float
        Logarithm of the determinant of the prior of all rows minus that of the normal matrices.
    """

    factor: BlockFactor
    before: IntArray
    weights: FloatArray
    bands: FloatArray
    log_determinant: float

    @property
    def width(self) -> int:
        """Number of nodes in a block."""
        return len(self.bands) - 1


def assemble(lines: TouchingLines, grid: RowGrid, prior: Roughness) -> RowSystem:
    """Set up and factorise the normal equations of all rows.

    Parameters
    ----------
    lines : TouchingLines
        Observations.
    grid : RowGrid
        Nodes.
    prior : Roughness
        How slopes may vary.

    Returns
    -------
    RowSystem
        The system.
    """
    before, share = nodes_of(grid, lines.x_m)
    weights = np.stack([lines.d_slope_x, lines.d_slope_y] * 2, axis=1)
    weights *= np.stack([1 - share, 1 - share, share, share], axis=1)
    shape = (grid.n_rows, grid.x_m.size)
    place = lines.row * grid.x_m.size + before
    bands = prior_bands(grid, prior)
    normal = np.zeros((len(bands), *shape, 2, 2))
    inverse_variance = lines.sigma_rad**-2
    # All products are those of both derivatives times those of both shares: nine sums, not sixteen.
    for i, j, product in (
        (0, 0, lines.d_slope_x * lines.d_slope_x),
        (0, 1, lines.d_slope_x * lines.d_slope_y),
        (1, 1, lines.d_slope_y * lines.d_slope_y),
    ):
        product *= inverse_variance
        after = product * share
        own, between, next_one = (
            np.bincount(place, one, shape[0] * shape[1]).reshape(shape)
            for one in ((product - after) * (1 - share), after * (1 - share), after * share)
        )
        own[:, 1:] += next_one[:, :-1]
        normal[0, ..., i, j] = normal[0, ..., j, i] = own
        normal[1, ..., i, j] = normal[1, ..., j, i] = between
    normal[..., 0, 0] += bands[:, None, :, 0]
    normal[..., 1, 1] += bands[:, None, :, 1]
    factor = factorise(*_paired(normal))
    change = grid.n_rows * _log_determinant(bands) - float(factor.log_determinant.sum())
    return RowSystem(factor, before, weights, bands, change)


def nodes_of(grid: RowGrid, x_m: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the node before each place and the share of the node after; no share goes across a panel's edge.

    Parameters
    ----------
    grid : RowGrid
        Nodes.
    x_m : ndarray, shape (m,)
        Places on the rows [m].

    Returns
    -------
    before : ndarray of int, shape (m,)
        Node before.
    share : ndarray, shape (m,)
        Share of the node after.
    """
    position = (x_m - grid.x_m[0]) / grid.step_m
    before = np.clip(np.floor(position).astype(np.intp), 0, grid.x_m.size - 2)
    share = np.clip(position - before, 0.0, 1.0)
    return before, np.where(grid.joined[before], share, np.round(share))


def prior_bands(grid: RowGrid, prior: Roughness) -> FloatArray:
    """Return the prior's precision as bands.

    Parameters
    ----------
    grid : RowGrid
        Nodes.
    prior : Roughness
        How slopes may vary.

    Returns
    -------
    ndarray, shape (order + 1, nx, 2)
        Precision of (s_x, s_y) between a node and itself, the next and those after that [1/rad^2].

    Notes
    -----
    Across: differences of the order n within a panel have the variance q h^(2n - 1). Along: the process
    (k^2 - d^2/dx^2) s = white noise with free ends (Whittle 1954), which has the variance ``noise / (4 k^3)`` and the
    correlation length sqrt(3) / k.
    """
    n, step, order = grid.x_m.size, grid.step_m, prior.order
    bands = np.zeros((order + 1, n, 2))
    bands[0, :, 0] = _LARGEST_SLOPE_RAD**-2
    inner = np.lib.stride_tricks.sliding_window_view(grid.joined, order).all(axis=1)
    stiffness = inner / (prior.across * step ** (2 * order - 1))
    for offset, part in enumerate(_DIFFERENCES[order]):
        for reach in range(order + 1 - offset):
            other = _DIFFERENCES[order][offset + reach]
            bands[reach, offset : offset + n - order, 0] += part * other * stiffness
    wave = np.sqrt(3) / prior.along_length_m
    link = grid.joined / step**2
    # Three diagonals of the operator k^2 - d^2/dx^2, and from them those of its square.
    main = np.full(n, wave**2)
    main[:-1] += link
    main[1:] += link
    scale = step / (4 * wave**3 * prior.along_rad**2)
    square = main**2
    square[:-1] += link**2
    square[1:] += link**2
    bands[0, :, 1] = scale * square
    bands[1, :-1, 1] = -scale * link * (main[:-1] + main[1:])
    bands[2, :-2, 1] = scale * link[:-1] * link[1:]
    return bands


def _log_determinant(bands: FloatArray) -> float:
    """Return the logarithm of the determinant of the prior of one row."""
    from scipy.linalg import cholesky_banded

    roots = [cholesky_banded(bands[:, :, k], lower=True, check_finite=False)[0] for k in (0, 1)]
    return 2 * float(np.log(roots).sum())


def _paired(bands: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Turn bands, shape (w + 1, r, nx, 2, 2), of symmetric matrices into blocks of w nodes."""
    width, (n_rows, n_nodes) = len(bands) - 1, bands.shape[1:3]
    count = -(-n_nodes // width)
    diagonal = np.zeros((count, n_rows, width, 2, width, 2))
    upper = np.zeros((count - 1, n_rows, width, 2, width, 2))
    for reach in range(width + 1):
        whole = bands[reach]
        if count * width > n_nodes:
            # Nodes that fill the last block are known to be zero.
            filled = np.zeros((n_rows, count * width - n_nodes, 2, 2)) + (np.eye(2) if reach == 0 else 0.0)
            whole = np.concatenate([whole, filled], axis=1)
        for first in range(width):
            part = np.swapaxes(whole[:, first::width], 0, 1)
            second = first + reach
            if second < width:
                diagonal[:, :, first, :, second] = part
                diagonal[:, :, second, :, first] = np.swapaxes(part, 2, 3)
            else:
                upper[:, :, first, :, second - width] = part[:-1]
    size = 2 * width
    return diagonal.reshape(count, n_rows, size, size), upper.reshape(count - 1, n_rows, size, size)


def right_sides(system: RowSystem, lines: TouchingLines, grid: RowGrid, values: FloatArray) -> FloatArray:
    """Return the transposed derivatives times weighted values, one column for each.

    Parameters
    ----------
    system : RowSystem
        The rows.
    lines : TouchingLines
        Observations.
    grid : RowGrid
        Nodes.
    values : ndarray, shape (m,)
        Values of the observations.

    Returns
    -------
    ndarray, shape (b, r, 2 w, 1)
        Sums for each block of w nodes.
    """
    shape = (grid.n_rows, grid.x_m.size)
    place = lines.row * grid.x_m.size + system.before
    weighted = (lines.sigma_rad**-2 * values)[:, None] * system.weights
    sums = np.stack([np.bincount(place, weighted[:, i], shape[0] * shape[1]).reshape(shape) for i in range(4)], axis=2)
    nodes = np.array(sums[..., :2], dtype=np.float64)
    nodes[:, 1:] += sums[:, :-1, 2:]
    return to_blocks(nodes, system.width)


def to_blocks(nodes: FloatArray, width: int) -> FloatArray:
    """Turn values at nodes into right sides.

    Parameters
    ----------
    nodes : ndarray, shape (r, nx, 2)
        Values for (s_x, s_y) of the nodes.
    width : int
        Number of nodes in a block, w.

    Returns
    -------
    ndarray, shape (b, r, 2 w, 1)
        The same in blocks; zeros fill the last one.
    """
    n_rows, n_nodes, _ = nodes.shape
    count = -(-n_nodes // width)
    if count * width > n_nodes:
        nodes = np.concatenate([nodes, np.zeros((n_rows, count * width - n_nodes, 2))], axis=1)
    return np.ascontiguousarray(np.swapaxes(nodes.reshape(n_rows, count, 2 * width), 0, 1))[..., None]


def from_blocks(blocks: FloatArray, n_nodes: int) -> FloatArray:
    """Turn solutions in blocks into values at nodes.

    Parameters
    ----------
    blocks : ndarray, shape (b, r, 2 w)
        Values of the blocks of w nodes.
    n_nodes : int
        Number of nodes of a row.

    Returns
    -------
    ndarray, shape (r, nx, 2)
        (s_x, s_y) at the nodes.
    """
    n_blocks, n_rows, size = blocks.shape
    return np.swapaxes(blocks, 0, 1).reshape(n_rows, n_blocks * size // 2, 2)[:, :n_nodes]


def prior_pull(bands: FloatArray, slopes: FloatArray) -> FloatArray:
    """Return the prior's precision times present slope errors.

    Parameters
    ----------
    bands : ndarray, shape (order + 1, nx, 2)
        From `prior_bands`.
    slopes : ndarray, shape (r, nx, 2)
        Present slope errors [rad].

    Returns
    -------
    ndarray, shape (b, r, 2 order, 1)
        In blocks.
    """
    product: FloatArray = np.array(bands[0] * slopes)
    for reach in range(1, len(bands)):
        product[:, :-reach] += bands[reach, :-reach] * slopes[:, reach:]
        product[:, reach:] += bands[reach, :-reach] * slopes[:, :-reach]
    return to_blocks(product, len(bands) - 1)
