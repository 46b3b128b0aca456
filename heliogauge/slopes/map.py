"""SlopeMap: the common product of every method, with its uncertainty in two shares."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from heliogauge.flags import REJECTED
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FlagArray, FloatArray, float_array

VALUE_FIELDS = (
    "slope_x",
    "slope_y",
    "design_slope_x",
    "design_slope_y",
    "sigma_random_x",
    "sigma_random_y",
    "height_m",
)
#: What a slope map has at each node.
NODE_FIELDS = (*VALUE_FIELDS, "flags", "aperture")


#: Source of the modes of the cells of a code: the random errors beside them are shared by neighbours, too.
CELLS = "cells of the code"


@dataclass(frozen=True, slots=True, eq=False)
class CommonModes:
    """Slope errors that the whole map shares: one smooth mode for one sigma of each independent source.

    sources length k: Where each mode comes from ("mirror pose", "screen pose", "camera", ...); a name may repeat.
    coefficients (k, 2, n_terms): Coefficients of the slope change in x and y for +1 sigma of the source [rad], on
        the monomials ``u**i * v**j`` with ``i + j <= degree``, ``u = (x - center_x) / scale``, ``v = (y - center_y)
        / scale``, ordered by ``i + j`` and then by ``j``.
    center_m (2,): Centre of the polynomials [m].
    scale_m: Length that becomes 1 [m].

    The covariance of all slopes of a map is ``diag(sigma_random**2) + sum_k mode_k mode_k^T``: modes are independent.
    """

    sources: tuple[str, ...]
    coefficients: FloatArray
    center_m: FloatArray
    scale_m: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients", float_array("coefficients", self.coefficients, (None, 2, None)))
        object.__setattr__(self, "center_m", float_array("center_m", self.center_m, (2,)))

    @property
    def degree(self) -> int:
        """Degree of the polynomials."""
        return int((np.sqrt(8 * self.coefficients.shape[2] + 1) - 3) / 2)

    def evaluate(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """Evaluate the modes at points.

        Shapes: x_m, y_m (...).
        Returns (k, 2, ...): Change of slope_x and slope_y for +1 sigma of each source [rad].
        """
        terms = monomials((x_m - self.center_m[0]) / self.scale_m, (y_m - self.center_m[1]) / self.scale_m, self.degree)
        return np.tensordot(self.coefficients, terms, axes=(2, 0))

    def of_sum(self, x_m: FloatArray, y_m: FloatArray, weights: FloatArray) -> FloatArray:
        """Return what the modes do to a weighted sum of slopes, without their values at the points.

        Shapes: x_m, y_m, weights (n,).
        Returns (k, 2): Change of the sums of slope_x and of slope_y for +1 sigma of each source [rad].
        """
        terms = monomials((x_m - self.center_m[0]) / self.scale_m, (y_m - self.center_m[1]) / self.scale_m, self.degree)
        return np.asarray(self.coefficients @ (terms @ weights))

    def on_grid(self, x_m: FloatArray, y_m: FloatArray) -> Iterator[FloatArray]:
        """Yield the modes at the nodes of a grid, one after the other.

        Shapes: x_m (nx,), y_m (ny,).
        Yields (2, ny, nx): Change of slope_x and slope_y for +1 sigma of the source [rad].
        """
        columns, rows = self.powers_on(x_m, y_m)
        for table in self.tables():
            yield rows.T @ (table @ columns)

    def powers_on(self, x_m: FloatArray, y_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the powers of u on the columns and of v on the rows of a grid, shape (degree + 1, nx or ny)."""
        powers = np.arange(self.degree + 1)[:, None]
        u, v = (x_m - self.center_m[0]) / self.scale_m, (y_m - self.center_m[1]) / self.scale_m
        return u**powers, v**powers

    def tables(self) -> Iterator[FloatArray]:
        """Yield the coefficients of the modes, shape (2, degree + 1, degree + 1): of v by rows, of u by columns."""
        powers = np.arange(self.degree + 1)
        # The term j of total power n is u**(n - j) v**j.
        total = np.repeat(powers, powers + 1)
        of_v = np.concatenate([np.arange(n + 1) for n in powers])
        for coefficients in self.coefficients:
            table = np.zeros((2, powers.size, powers.size))
            table[:, of_v, total - of_v] = coefficients
            yield table

    def variance_on_grid(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """Return the variance of both slopes at the nodes of a grid.

        Shapes: x_m (nx,), y_m (ny,).
        Returns (2, ny, nx): Variance of slope_x and slope_y from all sources together [rad^2].
        """
        columns, rows = self.powers_on(x_m, y_m)
        size = self.degree + 1
        # The square of a polynomial is one of twice the degree; so is the sum of all.
        squares = np.zeros((2, 2 * size - 1, 2 * size - 1))
        for table in self.tables():
            for i, j in np.ndindex(size, size):
                squares[:, i : i + size, j : j + size] += table[:, i, j, None, None] * table
        if not self.sources:
            return np.zeros((2, y_m.size, x_m.size))
        more_columns, more_rows = (powers[1] ** np.arange(2 * size - 1)[:, None] for powers in (columns, rows))
        variance = more_rows.T @ (squares @ more_columns)
        return np.asarray(np.maximum(variance, 0.0, out=variance))


def no_common_modes() -> CommonModes:
    """Return the empty set of modes, for maps whose errors are all random."""
    return CommonModes((), np.zeros((0, 2, 1)), np.zeros(2), 1.0)


def monomials(u: FloatArray, v: FloatArray, degree: int) -> FloatArray:
    """Stack the monomials of two variables.

    Shapes: u, v (...).
    degree: Highest total degree.
    Returns (n_terms, ...): ``u**(n - j) * v**j`` for n = 0 .. degree, j = 0 .. n.

    >>> monomials(np.array(2.0), np.array(3.0), 2)
    array([1., 2., 3., 4., 6., 9.])
    """
    powers_u, powers_v = [np.ones(np.shape(u))], [np.ones(np.shape(v))]
    for _ in range(degree):
        powers_u.append(powers_u[-1] * u)
        powers_v.append(powers_v[-1] * v)
    return np.stack([powers_u[n - j] * powers_v[j] for n in range(degree + 1) for j in range(n + 1)])


@dataclass(frozen=True, slots=True, eq=False)
class SlopeMap(ShortRepr):
    """Slopes of a mirror on a regular grid, beside the design's.

    Parameters
    ----------
    x_m : ndarray, shape (nx,)
        Grid columns, ascending, across the facet, to the right seen from the front [m].
    y_m : ndarray, shape (ny,)
        Grid rows, ascending, upwards [m].
    slope_x, slope_y : ndarray, shape (ny, nx)
        Measured dz/dx and dz/dy of the surface; NaN where not measured.
    design_slope_x, design_slope_y : ndarray, shape (ny, nx)
        The design's slopes at the same nodes.
    sigma_random_x, sigma_random_y : ndarray, shape (ny, nx)
        Random share of the uncertainty of each node [rad].
    noise_correlation : float
        Variance of the sum of many neighbouring nodes over the sum of their variances: 1 where nodes are independent,
        above 1 where they share pixels by interpolation. Multiplies the random variance of means and fits.
    common : CommonModes
        Share of the uncertainty that the whole map has in common.
    height_m : ndarray, shape (ny, nx)
        Height of the surface over the plane z = 0 [m]; NaN where not integrated.
    flags : ndarray of uint32, shape (ny, nx)
        Why a node is missing or doubtful, bits of `heliogauge.flags.SampleFlag`.
    aperture : ndarray of bool, shape (ny, nx)
        Nodes that belong to the mirror, measured or not.
    design : str
        The design shape in words with its numbers.
    frame : str
        The frame of x, y, z in words.
    removed : str
        What was taken out of the measured slopes ("nothing", "tilt by rotation about ...").
    fine_share : ndarray, shape (2,)
        Relative standard deviation, in x and in y, of what the slopes have beside the smooth shape that common modes
        hold: blur lowers waviness, a wrong scale stretches it.
    """

    x_m: FloatArray
    y_m: FloatArray
    slope_x: FloatArray
    slope_y: FloatArray
    design_slope_x: FloatArray
    design_slope_y: FloatArray
    sigma_random_x: FloatArray
    sigma_random_y: FloatArray
    noise_correlation: float
    common: CommonModes
    height_m: FloatArray
    flags: FlagArray
    aperture: BoolArray
    design: str
    frame: str
    removed: str
    fine_share: FloatArray = field(default_factory=lambda: np.zeros(2))

    def __post_init__(self) -> None:
        for name in ("x_m", "y_m"):
            object.__setattr__(self, name, float_array(name, getattr(self, name), (None,)))
        object.__setattr__(self, "fine_share", float_array("fine_share", self.fine_share, (2,)))
        shape = self.shape
        for name in VALUE_FIELDS:
            object.__setattr__(self, name, float_array(name, getattr(self, name), shape, finite=False))
        for name, dtype in (("flags", np.uint32), ("aperture", np.bool_)):
            array = np.array(getattr(self, name), dtype=dtype).reshape(shape)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows (y) and columns (x)."""
        return self.y_m.size, self.x_m.size

    @property
    def valid(self) -> BoolArray:
        """Nodes of the mirror that have a measured value, shape (ny, nx)."""
        return np.asarray(self.aperture & np.isfinite(self.slope_x) & ((self.flags & np.uint32(REJECTED)) == 0))

    @property
    def measured_share(self) -> float:
        """Share of the mirror's area that was measured."""
        return int(np.count_nonzero(self.valid)) / max(int(np.count_nonzero(self.aperture)), 1)

    @property
    def slope_error_x(self) -> FloatArray:
        """Measured minus design dz/dx, shape (ny, nx)."""
        return self.slope_x - self.design_slope_x

    @property
    def slope_error_y(self) -> FloatArray:
        """Measured minus design dz/dy, shape (ny, nx)."""
        return self.slope_y - self.design_slope_y

    def with_both_slopes(self) -> "SlopeMap":
        """Return the map with the design's dz/dy where only dz/dx was measured, as of a trough flown in one pass."""
        across_only = self.valid & ~np.isfinite(self.slope_y)
        if not across_only.any():
            return self
        return replace(self, slope_y=np.where(across_only, self.design_slope_y, self.slope_y))

    def common_variance(self) -> FloatArray:
        """Return the variance of slope_x and slope_y from common sources, shape (2, ny, nx) [rad^2]."""
        return self.common.variance_on_grid(self.x_m, self.y_m)

    def sigma_slope(self) -> tuple[FloatArray, FloatArray]:
        """Return the whole standard deviation of slope_x and of slope_y, each of shape (ny, nx) [rad]."""
        variance_x, variance_y = self.common_variance()
        return np.hypot(self.sigma_random_x, np.sqrt(variance_x)), np.hypot(self.sigma_random_y, np.sqrt(variance_y))
