"""Taking tilt, focus or a quadratic out of a slope map by least squares, its common errors included.

Every fit weights the measured nodes equally: the grid is regular, so equal weight is equal projected area.
"""

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from heliogauge.errors import EstimationError
from heliogauge.slopes.map import CommonModes, SlopeMap, monomials
from heliogauge.validate import BoolArray, FloatArray


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
    """The measured nodes as flat arrays: errors stacked as (x of all nodes, y of all nodes)."""

    valid: BoolArray
    x_m: FloatArray
    y_m: FloatArray
    errors: FloatArray
    variance: FloatArray
    noise_correlation: float
    modes: FloatArray

    @property
    def count(self) -> int:
        """Number of measured nodes n."""
        return self.x_m.size


def measured_nodes(slope_map: SlopeMap) -> MeasuredNodes:
    """Collect the measured nodes of a map; EstimationError with fewer than three."""
    valid = slope_map.valid
    count = int(np.count_nonzero(valid))
    if count < 3:
        raise EstimationError(
            f"slope map: {count} of {np.count_nonzero(slope_map.aperture)} nodes have a slope, at least 3 are needed"
        )
    grid_x, grid_y = np.meshgrid(slope_map.x_m, slope_map.y_m)
    x, y = grid_x[valid], grid_y[valid]
    errors = np.concatenate([slope_map.slope_error_x[valid], slope_map.slope_error_y[valid]])
    variance = np.concatenate([slope_map.sigma_random_x[valid], slope_map.sigma_random_y[valid]]) ** 2
    modes = slope_map.common.evaluate(x, y).reshape(len(slope_map.common.sources), 2 * count)
    return MeasuredNodes(valid, x, y, errors, variance, slope_map.noise_correlation, modes)


@dataclass(frozen=True, slots=True, eq=False)
class Projection:
    """Least-squares removal of slope patterns; patterns scaled to unit norm, amounts in the patterns' own scale."""

    columns: FloatArray
    norms: FloatArray
    inverse: FloatArray

    def amounts(self, vectors: FloatArray) -> FloatArray:
        """Return how much of each pattern the vectors, shape (..., m), contain: shape (..., p)."""
        return np.asarray(vectors @ self.columns.T @ self.inverse / self.norms)

    def leave(self, vectors: FloatArray) -> FloatArray:
        """Return the vectors without the patterns, shape (..., m)."""
        return np.asarray(vectors - (vectors @ self.columns.T @ self.inverse) @ self.columns)


def projection_of(columns: FloatArray) -> Projection:
    """Prepare the least-squares removal of slope patterns, shape (p, m); EstimationError if they are dependent."""
    norms = np.linalg.norm(columns, axis=1)
    unit = columns / np.where(norms == 0, 1.0, norms)[:, None]
    normal = unit @ unit.T
    if columns.shape[0] and np.linalg.eigvalsh(normal)[0] < 1e-9:
        raise EstimationError(
            "slope map: the measured nodes lie on a line and do not determine tilt and curvature; "
            "remove less or measure more of the mirror"
        )
    return Projection(unit, norms, np.asarray(np.linalg.inv(normal), dtype=np.float64))


def removal_columns(slope_map: SlopeMap, nodes: MeasuredNodes, removal: Removal) -> FloatArray:
    """Return the slope patterns that a removal takes out, at the measured nodes, shape (p, 2n)."""
    x, y = nodes.x_m - nodes.x_m.mean(), nodes.y_m - nodes.y_m.mean()
    return _patterns(removal, x, y, _focus_pattern(slope_map, nodes)[:, nodes.valid]).reshape(-1, 2 * nodes.count)


def _patterns(removal: Removal, x_m: FloatArray, y_m: FloatArray, focus: FloatArray) -> FloatArray:
    """Return the slope patterns of a removal, shape (p, 2, ...), at places from the middle; that of focus as given."""
    one, zero = np.ones_like(x_m), np.zeros_like(x_m)
    tilt = [(one, zero), (zero, one)]
    if removal is Removal.NOTHING:
        return np.zeros((0, 2, *x_m.shape))
    if removal is Removal.TILT:
        return np.array(tilt)
    if removal is Removal.FOCUS:
        return np.array([*tilt, tuple(focus)])
    return np.array([*tilt, (x_m, zero), (zero, y_m), (y_m, x_m)])


def _focus_pattern(slope_map: SlopeMap, nodes: MeasuredNodes) -> FloatArray:
    """Return how the slopes follow a relative change of 1 / f, on the whole grid, shape (2, ny, nx)."""
    if _is_flat(slope_map, nodes):
        # A flat design has no curvature to scale: there the pattern is that of 1 / f = 1 per metre.
        return 0.5 * np.stack(_grid_about(slope_map, nodes))
    design = slope_map.design_slope_x, slope_map.design_slope_y
    return np.stack([slopes - float(slopes[nodes.valid].mean()) for slopes in design])


def _grid_about(slope_map: SlopeMap, nodes: MeasuredNodes) -> tuple[FloatArray, FloatArray]:
    """Return x and y of all nodes from the mean of the measured ones, each of shape (ny, nx) [m]."""
    x, y = np.meshgrid(slope_map.x_m - float(nodes.x_m.mean()), slope_map.y_m - float(nodes.y_m.mean()))
    return x, y


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
    projection = projection_of(removal_columns(slope_map, nodes, removal))
    amounts = projection.amounts(nodes.errors)
    patterns = _patterns(removal, *_grid_about(slope_map, nodes), _focus_pattern(slope_map, nodes))
    change_x, change_y = np.tensordot(amounts, patterns, axes=1)
    return replace(
        slope_map,
        slope_x=slope_map.slope_x - change_x,
        slope_y=slope_map.slope_y - change_y,
        height_m=slope_map.height_m - _removed_height(slope_map, nodes, removal, amounts),
        common=_project_modes(slope_map, nodes, projection),
        removed=joined_removals(slope_map.removed, removal_words(slope_map, nodes, removal, amounts)),
    )


def _removed_height(slope_map: SlopeMap, nodes: MeasuredNodes, removal: Removal, amounts: FloatArray) -> FloatArray:
    grid_x, grid_y = _grid_about(slope_map, nodes)
    height = amounts[0] * grid_x + amounts[1] * grid_y
    if removal is Removal.QUADRATIC:
        height += 0.5 * (amounts[2] * grid_x**2 + amounts[3] * grid_y**2) + amounts[4] * grid_x * grid_y
    elif removal is Removal.FOCUS:
        if not _is_flat(slope_map, nodes):
            return np.full_like(grid_x, np.nan)
        height += 0.25 * amounts[2] * (grid_x**2 + grid_y**2)
    return np.asarray(height)


def _project_modes(slope_map: SlopeMap, nodes: MeasuredNodes, projection: Projection) -> CommonModes:
    common = slope_map.common
    if not common.sources:
        return common
    # The patterns are polynomials of degree 1 for every parabolic design; 3 follows a sphere's to 1e-4 of itself.
    degree = max(common.degree, 3)
    values = projection.leave(nodes.modes).reshape(len(common.sources), 2, nodes.count)
    return fit_modes(common, values, nodes.x_m, nodes.y_m, degree)


def fit_modes(common: CommonModes, values: FloatArray, x_m: FloatArray, y_m: FloatArray, degree: int) -> CommonModes:
    """Fit polynomials of a degree to modes given by values at points, shape (k, 2, n)."""
    terms = monomials((x_m - common.center_m[0]) / common.scale_m, (y_m - common.center_m[1]) / common.scale_m, degree)
    stacked = values.reshape(-1, x_m.size)
    coefficients = np.asarray(np.linalg.lstsq(terms.T, stacked.T, rcond=None)[0].T, dtype=np.float64)
    return replace(common, coefficients=coefficients.reshape(values.shape[0], 2, terms.shape[0]))


def removal_words(slope_map: SlopeMap, nodes: MeasuredNodes, removal: Removal, amounts: FloatArray) -> str:
    """Say what a removal took out, with its numbers."""
    if removal is Removal.NOTHING:
        return Removal.NOTHING.value
    words = f"tilt of {1e3 * amounts[0]:.4g} mrad in x and {1e3 * amounts[1]:.4g} mrad in y"
    if removal is Removal.FOCUS:
        if _is_flat(slope_map, nodes):
            return words + f"; curvature of focal length {inverse_length(float(amounts[2])):.6g} m"
        return words + f"; focal length {inverse_length(1 + float(amounts[2])):.6g} times the design's"
    if removal is Removal.QUADRATIC:
        return words + (
            f"; curvature errors {amounts[2]:.4g} 1/m in x, {amounts[3]:.4g} 1/m in y and twist {amounts[4]:.4g} 1/m"
        )
    return words


def reference_words(slope_map: SlopeMap, removal: Removal) -> str:
    """Name the surface that the errors left by a removal refer to."""
    if removal is Removal.FOCUS:
        return f"best-fit focal length of the design shape ({slope_map.design})"
    if removal is Removal.QUADRATIC:
        return f"best-fit quadratic added to the design ({slope_map.design})"
    return f"design: {slope_map.design}"


def _is_flat(slope_map: SlopeMap, nodes: MeasuredNodes) -> bool:
    return all(
        float(np.ptp(slopes[nodes.valid])) < 1e-12 for slopes in (slope_map.design_slope_x, slope_map.design_slope_y)
    )


def joined_removals(before: str, now: str) -> str:
    """Say what was removed before and now in one sentence."""
    if now == Removal.NOTHING.value:
        return before
    return now if before == Removal.NOTHING.value else f"{before}; then {now}"


def inverse_length(value: float) -> float:
    """Return 1 / value, infinite for zero (the focal length of a flat)."""
    return 1 / value if value != 0 else float("inf")
