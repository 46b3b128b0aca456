"""How much of a small square an edge covers, in closed form: the renderer's only use of an edge is its area."""

from dataclasses import dataclass, field

import numpy as np

from heliogauge.validate import BoolArray, Float32Array, FloatArray, float_array, freeze


@dataclass(frozen=True, slots=True, eq=False)
class Footprint:
    """A square cell of the image, seen on a printed sheet as a parallelogram.

    sheet_from_cell_m (2, 2): Change of the sheet's (x, y) for a step of one cell along image x (first column) and y
        (second) [m].
    reach_m: An edge farther than this from the cell's centre does not cross the cell [m].
    """

    sheet_from_cell_m: FloatArray
    reach_m: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "sheet_from_cell_m", freeze(float_array("footprint", self.sheet_from_cell_m, (2, 2))))
        # Half the diagonal, plus a tenth for footprints that grow over a tile.
        object.__setattr__(self, "reach_m", 0.78 * float(np.linalg.norm(self.sheet_from_cell_m, 2)))

    def covered(self, distance_m: Float32Array, across: Float32Array | float, up: Float32Array | float) -> Float32Array:
        """Return the share of each cell on the inner side of an edge that is straight within the cell.

        distance_m (n,): Distance of the cell's centre from the edge, positive inside [m].
        across, up (n,): The edge's inward normal on the sheet, of unit length.
        Returns (n,): Shares, 0 to 1.
        """
        (a, b), (c, d) = self.sheet_from_cell_m.tolist()
        along_x, along_y = np.abs(across * a + up * c), np.abs(across * b + up * d)
        wide, narrow = np.maximum(along_x, along_y), np.minimum(along_x, along_y)
        narrow = np.maximum(narrow, 1e-6 * wide)
        outer = (wide + narrow) / 2
        size = np.minimum(np.abs(distance_m), outer)
        # The area is linear while the edge cuts two opposite sides, quadratic while it cuts a corner off.
        linear = size / wide
        quadratic = np.float32(0.5) - (outer - size) ** 2 / (2 * wide * narrow)
        half = np.where(size <= (wide - narrow) / 2, linear, quadratic)
        return np.asarray(np.float32(0.5) + np.copysign(half, distance_m), dtype=np.float32)


def disc_coverage(
    x_m: Float32Array, y_m: Float32Array, distance_m: Float32Array, radius_m: float, cell: Footprint
) -> Float32Array:
    """Return the share of each cell inside a circle about the origin.

    Shapes: distance_m (h, w).
    x_m, y_m (h, w): Cell centres on the sheet [m].
    Returns (h, w): Shares, 0 to 1.
    """
    inward = np.float32(radius_m) - distance_m
    share = (inward > 0).astype(np.float32)
    near: BoolArray = np.abs(inward) < cell.reach_m
    scale = np.float32(-1) / np.maximum(distance_m[near], np.float32(1e-12))
    across, up = (np.asarray(part[near] * scale, dtype=np.float32) for part in (x_m, y_m))
    share[near] = cell.covered(inward[near], across, up)
    return share


def strip_coverage(
    position_m: Float32Array, limits_m: tuple[float, float], along_x: bool, cell: Footprint
) -> Float32Array:
    """Return the share of each cell between two parallel lines of the sheet.

    position_m (h, w): The cells' x or y on the sheet [m].
    limits_m: Lower and upper limit [m].
    Returns (h, w): Shares, 0 to 1.
    """
    inward = np.minimum(position_m - np.float32(limits_m[0]), np.float32(limits_m[1]) - position_m)
    share = (inward > 0).astype(np.float32)
    near: BoolArray = np.abs(inward) < cell.reach_m
    share[near] = cell.covered(inward[near], float(along_x), float(not along_x))
    return np.asarray(share)
