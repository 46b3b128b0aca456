"""A slope map seen in another frame of the same plane: turned, shifted, on another grid."""

from dataclasses import dataclass, replace

import numpy as np

from heliogauge.slopes.interpolation import read_map
from heliogauge.slopes.map import CommonModes, SlopeMap, monomials
from heliogauge.validate import BoolArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PlaneMotion:
    """The motion ``x_a = R(turn) x_b + shift`` of one map's plane onto another's.

    turn_rad: Counter-clockwise [rad].
    shift_m (2,): [m].
    """

    turn_rad: float
    shift_m: FloatArray

    @classmethod
    def none(cls) -> "PlaneMotion":
        """Return the motion that leaves all where it is."""
        return cls(0.0, np.zeros(2))

    @property
    def rotation(self) -> FloatArray:
        """R, shape (2, 2)."""
        cosine, sine = np.cos(self.turn_rad), np.sin(self.turn_rad)
        return np.array([[cosine, -sine], [sine, cosine]])

    def b_from_a(self, x_m: FloatArray, y_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where points of a are in b."""
        away = np.stack([x_m - self.shift_m[0], y_m - self.shift_m[1]])
        x_b, y_b = np.tensordot(self.rotation.T, away, axes=1)
        return x_b, y_b


def moved_map(slope_map: SlopeMap, motion: PlaneMotion, x_m: FloatArray, y_m: FloatArray) -> SlopeMap:
    """Return a map in another frame of its plane, on a grid of that frame.

    slope_map: The map, in frame b.
    motion: From b to a.
    x_m (nx,), y_m (ny,): The new grid, in a [m].
    Returns: Slopes turned with the frame; random and common shares likewise. Nodes beyond the old grid are no mirror.
    """
    grid_x, grid_y = np.meshgrid(x_m, y_m)
    old_x, old_y = (one.ravel() for one in motion.b_from_a(grid_x, grid_y))
    reached = _within(slope_map.x_m, old_x) & _within(slope_map.y_m, old_y)
    found = read_map(slope_map, old_x, old_y)
    shape = grid_x.shape
    turn = motion.rotation

    def turned(first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
        # 0 times NaN: a map of one slope keeps it where nothing is turned.
        if motion.turn_rad == 0:
            return first, second
        return turn[0, 0] * first + turn[0, 1] * second, turn[1, 0] * first + turn[1, 1] * second

    def placed(values: FloatArray) -> FloatArray:
        return np.where(reached, values, np.nan).reshape(shape)

    slope_x, slope_y = turned(found.slope_x, found.slope_y)
    design_x, design_y = turned(found.design_slope_x, found.design_slope_y)
    squares = [found.sigma_random_x**2, found.sigma_random_y**2]
    if motion.turn_rad != 0:
        squares = [turn[k, 0] ** 2 * squares[0] + turn[k, 1] ** 2 * squares[1] for k in (0, 1)]
    sigma_x, sigma_y = (placed(np.sqrt(one)) for one in squares)
    column, row = _nearest(slope_map.x_m, old_x), _nearest(slope_map.y_m, old_y)
    aperture = reached & slope_map.aperture[row, column]
    return replace(
        slope_map,
        x_m=x_m,
        y_m=y_m,
        slope_x=placed(slope_x),
        slope_y=placed(slope_y),
        design_slope_x=placed(design_x),
        design_slope_y=placed(design_y),
        sigma_random_x=sigma_x,
        sigma_random_y=sigma_y,
        noise_correlation=_correlation(slope_map, x_m, y_m, np.stack([sigma_x, sigma_y])),
        height_m=placed(found.height_m),
        common=moved_modes(slope_map.common, motion, x_m, y_m),
        flags=np.where(reached, found.flags, 0).astype(np.uint32).reshape(shape),
        aperture=aperture.reshape(shape),
    )


def _within(grid_m: FloatArray, positions_m: FloatArray) -> BoolArray:
    # A node stands for half a step around it.
    half = 0.5 * float(np.ptp(grid_m)) / max(grid_m.size - 1, 1)
    return np.asarray((positions_m >= grid_m[0] - half) & (positions_m <= grid_m[-1] + half))


def _nearest(grid_m: FloatArray, positions_m: FloatArray) -> FloatArray:
    between = 0.5 * (grid_m[1:] + grid_m[:-1])
    return np.asarray(np.searchsorted(between, positions_m))


def _correlation(slope_map: SlopeMap, x_m: FloatArray, y_m: FloatArray, new: FloatArray) -> float:
    """Return the noise correlation with which a mean over an area keeps its variance on the new grid."""
    old = np.stack([slope_map.sigma_random_x, slope_map.sigma_random_y])[:, slope_map.valid]
    means = [np.mean(one[np.isfinite(one)] ** 2) if np.isfinite(one).any() else 0.0 for one in (old, new)]
    if not min(means) > 0:
        return slope_map.noise_correlation
    cells = cell_area_m2(slope_map.x_m, slope_map.y_m) / cell_area_m2(x_m, y_m)
    return max(1.0, float(slope_map.noise_correlation * cells * means[0] / means[1]))


def cell_area_m2(x_m: FloatArray, y_m: FloatArray) -> float:
    """Return the area of a cell of a grid [m^2]."""
    return float(np.prod([np.ptp(grid) / max(grid.size - 1, 1) or 1.0 for grid in (x_m, y_m)]))


def moved_modes(common: CommonModes, motion: PlaneMotion, x_m: FloatArray, y_m: FloatArray) -> CommonModes:
    """Return the modes of a map in another frame of its plane, about the middle of a grid of that frame.

    Shapes: x_m (nx,), y_m (ny,).
    """
    if not common.sources or (motion.turn_rad == 0 and not motion.shift_m.any()):
        return common
    center = np.array([0.5 * (x_m[0] + x_m[-1]), 0.5 * (y_m[0] + y_m[-1])])
    scale = 0.5 * max(float(np.ptp(x_m)), float(np.ptp(y_m))) or 1.0
    # A polynomial is known from its values on a lattice of one more place than its degree each way.
    steps = np.linspace(-1, 1, common.degree + 1)
    u, v = (one.ravel() for one in np.meshgrid(steps, steps))
    values = common.evaluate(*motion.b_from_a(center[0] + scale * u, center[1] + scale * v))
    values = np.einsum("ij,kjn->kin", motion.rotation, values)
    terms = monomials(u, v, common.degree)
    found = np.linalg.lstsq(terms.T, values.reshape(-1, u.size).T, rcond=None)[0].T
    return CommonModes(common.sources, found.reshape(len(common.sources), 2, -1), center, scale)
