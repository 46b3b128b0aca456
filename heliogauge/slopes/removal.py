"""Taking tilt, focus or a quadratic out of a slope map by least squares, its common errors included.

Every fit weights the measured nodes equally: the grid is regular, so equal weight is equal projected area.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from heliogauge.errors import EstimationError
from heliogauge.slopes.map import CommonModes, SlopeMap, monomials
from heliogauge.validate import BoolArray, FloatArray

#: 16384 float64 are 128 KiB: the dozen buffers of one block stay in a 2 MiB second-level cache.
_BLOCK = 16384


class Removal(StrEnum):
    """What is taken out of the slope errors before their RMS is formed; each includes the ones before it.

    TILT: the mean slope error. FOCUS: tilt and the focal length of the design. QUADRATIC: tilt, both focal lengths and
    twist. The values are the words of measurement.toml and of ``--remove``.
    """

    NOTHING = "nothing"
    TILT = "tilt"
    FOCUS = "focus"
    QUADRATIC = "quadratic"


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredNodes:
    """The measured nodes as flat arrays.

    valid (ny, nx): Where they are in the map.
    x_m, y_m (n,): Their places [m].
    design, errors (2, n): Slopes of the design, and measured minus design, in x and in y.
    variance (2, n): Random variance of the slopes [rad^2].
    noise_correlation, common: As in `heliogauge.slopes.map.SlopeMap`.
    """

    valid: BoolArray
    x_m: FloatArray
    y_m: FloatArray
    design: FloatArray
    errors: FloatArray
    variance: FloatArray
    noise_correlation: float
    common: CommonModes

    @property
    def count(self) -> int:
        """Number of measured nodes n."""
        return self.x_m.size

    def blocks(self) -> Iterator[slice]:
        """Yield parts of the nodes whose arrays stay in the processor's cache."""
        for start in range(0, self.count, _BLOCK):
            yield slice(start, min(start + _BLOCK, self.count))

    def terms(self, part: slice) -> FloatArray:
        """Return the monomials of the common modes at some nodes, shape (n_terms, b)."""
        (center_x, center_y), scale = self.common.center_m, self.common.scale_m
        return monomials((self.x_m[part] - center_x) / scale, (self.y_m[part] - center_y) / scale, self.common.degree)

    def moments(self, part: slice, vectors: FloatArray) -> FloatArray:
        """Return the sums of vectors (m, 2, b) times the monomials of the common modes, shape (m, 2, n_terms)."""
        return np.asarray(vectors @ self.terms(part).T)

    def modes_times(self, moments: FloatArray) -> FloatArray:
        """Return the inner products of the common modes with vectors of these `moments`, shape (m, k)."""
        return np.asarray(np.tensordot(moments, self.common.coefficients, axes=([1, 2], [1, 2])))


def measured_nodes(slope_map: SlopeMap) -> MeasuredNodes:
    """Collect the measured nodes of a map; EstimationError with fewer than three."""
    valid = slope_map.valid
    count = int(np.count_nonzero(valid))
    if count < 3:
        raise EstimationError(
            f"slope map: {count} of {np.count_nonzero(slope_map.aperture)} nodes have a slope, at least 3 are needed"
        )
    rows, columns = np.nonzero(valid)
    design = np.stack([slope_map.design_slope_x[valid], slope_map.design_slope_y[valid]])
    return MeasuredNodes(
        valid,
        slope_map.x_m[columns],
        slope_map.y_m[rows],
        design,
        np.stack([slope_map.slope_x[valid], slope_map.slope_y[valid]]) - design,
        np.stack([slope_map.sigma_random_x[valid], slope_map.sigma_random_y[valid]]) ** 2,
        slope_map.noise_correlation,
        slope_map.common,
    )


#: Which of `Patterns.at` each removal takes out.
_TAKEN: dict[Removal, list[int]] = {
    Removal.NOTHING: [],
    Removal.TILT: [0, 1],
    Removal.FOCUS: [0, 1, 2],
    Removal.QUADRATIC: [0, 1, 3, 4, 5],
}


#: Share of each part of `Patterns.basis` in each pattern's slopes in x and in y, shape (6, 2, 5).
PATTERN_SHARES = np.zeros((6, 2, 5))
for _pattern, _axis, _part in ((0, 0, 0), (1, 1, 0), (2, 0, 3), (2, 1, 4), (3, 0, 1), (4, 1, 2), (5, 0, 2), (5, 1, 1)):
    PATTERN_SHARES[_pattern, _axis, _part] = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Patterns:
    """The slope patterns that removals take out: tilt in x and y, focus, curvature in x and y, twist.

    middle_m (2,), middle_design (2,): Means of the measured nodes' places [m] and design slopes.
    is_flat: A flat design has no curvature to scale: its pattern of focus is that of 1 / f = 1 per metre; elsewhere it
        is how the slopes follow a relative change of 1 / f.
    """

    middle_m: FloatArray
    middle_design: FloatArray
    is_flat: bool

    @classmethod
    def of(cls, nodes: MeasuredNodes) -> "Patterns":
        """Return the patterns about the middle of the measured nodes."""
        middle = np.array([nodes.x_m.mean(), nodes.y_m.mean()])
        is_flat = bool((np.ptp(nodes.design, axis=1) < 1e-12).all())
        return cls(middle, nodes.design.mean(axis=1), is_flat)

    def at(self, x_m: FloatArray, y_m: FloatArray, design: FloatArray) -> FloatArray:
        """Return all six patterns at places (...) with design slopes (2, ...), shape (6, 2, ...)."""
        return np.asarray(np.tensordot(PATTERN_SHARES, self.basis(x_m, y_m, design), axes=1))

    def basis(self, x_m: FloatArray, y_m: FloatArray, design: FloatArray) -> FloatArray:
        """Return what the patterns are made of, `PATTERN_SHARES` of each: 1, x, y, and the focus in x and in y.

        Shapes: as in `at`, result (5, ...).
        """
        basis = np.empty((5, *x_m.shape))
        basis[0] = 1.0
        np.subtract(x_m, self.middle_m[0], out=basis[1])
        np.subtract(y_m, self.middle_m[1], out=basis[2])
        for axis in (0, 1):
            if self.is_flat:
                np.multiply(0.5, basis[1 + axis], out=basis[3 + axis])
            else:
                np.subtract(design[axis], self.middle_design[axis], out=basis[3 + axis])
        return basis


@dataclass(frozen=True, slots=True, eq=False)
class RemovalFit:
    """How much of each pattern of a removal the slope errors contain, by least squares.

    taken: Which patterns of `Patterns.at`.
    amounts (p,): Their amounts.
    inverse (p, p): Inverse of the patterns' inner products.
    """

    removal: Removal
    taken: list[int]
    amounts: FloatArray
    inverse: FloatArray

    def change(self, basis: FloatArray) -> FloatArray:
        """Return the slopes that the removal takes out where `Patterns.basis` gives this, shape (2, ...)."""
        return np.asarray(np.tensordot(np.tensordot(self.amounts, PATTERN_SHARES[self.taken], axes=1), basis, axes=1))


def fit_removals(nodes: MeasuredNodes, patterns: Patterns, removals: Iterable[Removal]) -> list[RemovalFit]:
    """Fit the patterns of removals to the slope errors.

    EstimationError: The nodes do not determine the patterns of one of them.
    """
    squares, errors = np.zeros((5, 5)), np.zeros((2, 5))
    for part in nodes.blocks():
        basis = patterns.basis(nodes.x_m[part], nodes.y_m[part], nodes.design[:, part])
        squares += basis @ basis.T
        errors += nodes.errors[:, part] @ basis.T
    products = np.einsum("kci,ij,lcj->kl", PATTERN_SHARES, squares, PATTERN_SHARES)
    contained = np.einsum("kci,ci->k", PATTERN_SHARES, errors)
    return [
        RemovalFit(removal, taken, inverse @ contained[taken], inverse)
        for removal in removals
        for taken in [_TAKEN[removal]]
        for inverse in [inverse_of_products(products[np.ix_(taken, taken)])]
    ]


def inverse_of_products(products: FloatArray) -> FloatArray:
    """Invert the inner products (p, p) of slope patterns; EstimationError if these depend on each other or overflow."""
    norms = np.sqrt(np.diag(products))
    norms = np.where(norms == 0, 1.0, norms)
    unit = products / np.outer(norms, norms)
    if not np.isfinite(unit).all():
        raise EstimationError(
            "slope map: places or design slopes are so large that their squares are beyond the numbers that a program "
            "can hold; metres and dz/dx are needed"
        )
    if len(products) and np.linalg.eigvalsh(unit)[0] < 1e-9:
        raise EstimationError(
            "slope map: the measured nodes lie on a line and do not determine tilt and curvature; "
            "remove less or measure more of the mirror"
        )
    return np.asarray(np.linalg.inv(unit) / np.outer(norms, norms), dtype=np.float64)


def remove(slope_map: SlopeMap, removal: Removal) -> SlopeMap:
    """Take tilt or a best fit out of a map.

    removal: What to take out of the measured slopes.
    Returns: The map with the measured slopes changed, common modes projected likewise, and `removed` extended by
        what was taken out with its numbers. Heights are changed to match where the pattern has a height (tilt and
        quadratic terms); for FOCUS on a curved design they become NaN.
    EstimationError: The measured nodes do not determine what is to be removed.

    The random share stays as it was: the p amounts taken out lower it by p / 2n of itself only.
    """
    if removal is Removal.NOTHING:
        return slope_map
    nodes = measured_nodes(slope_map)
    patterns = Patterns.of(nodes)
    (fit,) = fit_removals(nodes, patterns, [removal])
    grid = np.meshgrid(slope_map.x_m, slope_map.y_m)
    change_x, change_y = fit.change(
        patterns.basis(grid[0], grid[1], np.stack([slope_map.design_slope_x, slope_map.design_slope_y]))
    )
    return replace(
        slope_map,
        slope_x=slope_map.slope_x - change_x,
        slope_y=slope_map.slope_y - change_y,
        height_m=slope_map.height_m
        - _removed_height(fit, grid[0] - patterns.middle_m[0], grid[1] - patterns.middle_m[1], patterns),
        common=_project_modes(nodes, patterns, fit),
        removed=joined_removals(slope_map.removed, removal_words(fit, patterns)),
    )


def _removed_height(fit: RemovalFit, x_m: FloatArray, y_m: FloatArray, patterns: Patterns) -> FloatArray:
    amounts = fit.amounts
    height = amounts[0] * x_m + amounts[1] * y_m
    if fit.removal is Removal.QUADRATIC:
        height += 0.5 * (amounts[2] * x_m**2 + amounts[3] * y_m**2) + amounts[4] * x_m * y_m
    elif fit.removal is Removal.FOCUS:
        if not patterns.is_flat:
            return np.full_like(x_m, np.nan)
        height += 0.25 * amounts[2] * (x_m**2 + y_m**2)
    return np.asarray(height)


def _project_modes(nodes: MeasuredNodes, patterns: Patterns, fit: RemovalFit) -> CommonModes:
    common = nodes.common
    if not common.sources:
        return common
    # The patterns are polynomials of degree 1 for every parabolic design; 3 follows a sphere's to 1e-4 of itself.
    degree = max(common.degree, 3)
    taken = patterns.at(nodes.x_m, nodes.y_m, nodes.design)[fit.taken].reshape(len(fit.taken), -1)
    modes = common.evaluate(nodes.x_m, nodes.y_m).reshape(len(common.sources), -1)
    values = (modes - (modes @ taken.T @ fit.inverse) @ taken).reshape(len(common.sources), 2, nodes.count)
    return fit_modes(common, values, nodes.x_m, nodes.y_m, degree)


def fit_modes(common: CommonModes, values: FloatArray, x_m: FloatArray, y_m: FloatArray, degree: int) -> CommonModes:
    """Fit polynomials of a degree to modes given by values at points, shape (k, 2, n)."""
    terms = monomials((x_m - common.center_m[0]) / common.scale_m, (y_m - common.center_m[1]) / common.scale_m, degree)
    stacked = values.reshape(-1, x_m.size)
    coefficients = np.asarray(np.linalg.lstsq(terms.T, stacked.T, rcond=None)[0].T, dtype=np.float64)
    return replace(common, coefficients=coefficients.reshape(values.shape[0], 2, terms.shape[0]))


def removal_words(fit: RemovalFit, patterns: Patterns) -> str:
    """Say what a removal took out, with its numbers."""
    removal, amounts = fit.removal, fit.amounts
    if removal is Removal.NOTHING:
        return Removal.NOTHING.value
    words = f"tilt of {1e3 * amounts[0]:z.4f} mrad in x and {1e3 * amounts[1]:z.4f} mrad in y"
    if removal is Removal.FOCUS:
        if patterns.is_flat:
            return words + f"; focus: 1/f = {amounts[2]:.6g} 1/m"
        # In 1/f, which passes through zero where a mirror is flat; the focal length flips its sign there.
        factor = 1 + float(amounts[2])
        flipped = ", of the opposite sign" if factor < 0 else ""
        return words + f"; focus: 1/f is {factor:.6g} times the design's{flipped}"
    if removal is Removal.QUADRATIC:
        return words + (
            f"; curvature errors {amounts[2]:.3g} 1/m in x, {amounts[3]:.3g} 1/m in y and twist {amounts[4]:.3g} 1/m"
        )
    return words


def reference_words(slope_map: SlopeMap, removal: Removal) -> str:
    """Name the surface that the errors left by a removal refer to."""
    if removal is Removal.FOCUS:
        return f"best-fit focal length of the design shape ({slope_map.design})"
    if removal is Removal.QUADRATIC:
        return f"best-fit quadratic added to the design ({slope_map.design})"
    return f"design: {slope_map.design}"


def joined_removals(before: str, now: str) -> str:
    """Say what was removed before and now in one sentence."""
    if now == Removal.NOTHING.value:
        return before
    return now if before == Removal.NOTHING.value else f"{before}; then {now}"


def inverse_length(value: float) -> float:
    """Return 1 / value, infinite for zero (the focal length of a flat)."""
    return 1 / value if value != 0 else float("inf")
