"""What is printed on a sheet: ring codes, dots, markers, chessboards, circle grids, as areas of ink."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from data_synth.optics.coverage import Footprint, disc_coverage, strip_coverage
from heliogauge.errors import InputError
from heliogauge.validate import BoolArray, Float32Array, FloatArray, float_array, freeze, positive
from photogrammetry.targets import RingCode


class Print(Protocol):
    """A figure on a sheet: x right and y up as seen from the front, origin in the middle.

    half_size_m: Half width and half height of the paper, the quiet zone included [m].
    bends_m: Radius of the figure's sharpest curve, which decides how finely it must be sampled [m].
    """

    @property
    def half_size_m(self) -> tuple[float, float]:
        """Half width and half height of the paper [m]."""
        ...

    @property
    def bends_m(self) -> float:
        """Radius of the figure's sharpest curve [m]."""
        ...

    @property
    def points_m(self) -> dict[str, tuple[float, float]]:
        """Points that are measured, by what follows the sheet's name in theirs [m]."""
        ...

    def ink(self, x_m: Float32Array, y_m: Float32Array, cell: Footprint) -> Float32Array:
        """Return the share of ink in each cell."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class RingPrint:
    """A ring-coded target.

    diameter_m: Diameter of the dot [m].
    mirrored: Printed the wrong way round.
    hole_radii: Radius of a hole without ink in the middle of the dot, in radii of the dot.
    cross_radii: Half length of a cross without ink in the middle of the dot, in radii of the dot; its bars are a fifth
        of that wide, to either side.
    """

    code: RingCode
    diameter_m: float
    mirrored: bool = False
    hole_radii: float = 0.0
    cross_radii: float = 0.0

    @property
    def half_size_m(self) -> tuple[float, float]:
        """Half width and half height of the paper [m]."""
        return (self.code.radii.quiet * self.diameter_m / 2,) * 2

    @property
    def bends_m(self) -> float:
        """Radius of the dot [m]."""
        return self.diameter_m / 2

    @property
    def points_m(self) -> dict[str, tuple[float, float]]:
        """The centre, under the sheet's own name [m]."""
        return {"": (0.0, 0.0)}

    def ink(self, x_m: Float32Array, y_m: Float32Array, cell: Footprint) -> Float32Array:
        """Return the share of ink in each cell, shape (h, w)."""
        # The footprint mirrors along, but areas do not care.
        if self.mirrored:
            x_m = -x_m
            cell = Footprint(cell.sheet_from_cell_m * np.array([[-1.0], [1.0]]))
        radius = self.diameter_m / 2
        distance = np.hypot(x_m, y_m)
        share = disc_coverage(x_m, y_m, distance, radius, cell)
        if self.hole_radii:
            share -= disc_coverage(x_m, y_m, distance, self.hole_radii * radius, cell)
        if self.cross_radii:
            share *= 1 - _cross(x_m, y_m, self.cross_radii * radius, cell)
        inner, outer = self.code.radii.inner * radius, self.code.radii.outer * radius
        ring: BoolArray = (distance > inner - cell.reach_m) & (distance < outer + cell.reach_m)
        x, y, at = x_m[ring], y_m[ring], distance[ring]
        band = disc_coverage(x, y, at, outer, cell) - disc_coverage(x, y, at, inner, cell)
        share[ring] += band * self._sectors(x, y, at, cell)
        return share

    def _sectors(self, x: Float32Array, y: Float32Array, distance: Float32Array, cell: Footprint) -> Float32Array:
        n, inked = self.code.n_bits, np.array(self.code.sectors, dtype=np.float32)
        clockwise = np.arctan2(-y, x)
        border = np.rint(clockwise * np.float32(n / (2 * np.pi))).astype(np.int64)
        angle = border.astype(np.float32) * np.float32(2 * np.pi / n)
        past = distance * np.sin(clockwise - angle)
        before, after = inked[(border - 1) % n], inked[border % n]
        share = np.where(past > 0, after, before)
        near = (before != after) & (np.abs(past) < cell.reach_m)
        # Clockwise tangent of the border, y up.
        covered = cell.covered(past[near], -np.sin(angle[near]), -np.cos(angle[near]))
        share[near] = before[near] + (after[near] - before[near]) * covered
        return share


def _cross(x_m: Float32Array, y_m: Float32Array, half_m: float, cell: Footprint) -> Float32Array:
    """Return the share of each cell in an upright cross about the origin."""
    long, narrow = (-half_m, half_m), (-half_m / 5, half_m / 5)
    bars = [
        strip_coverage(x_m, across, True, cell) * strip_coverage(y_m, up, False, cell)
        for across, up in ((long, narrow), (narrow, long))
    ]
    return np.asarray(np.maximum(*bars), dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class DotPrint:
    """A plain dot.

    paper_factor: Side of the square paper, in diameters.
    """

    diameter_m: float
    paper_factor: float = 2.0

    @property
    def half_size_m(self) -> tuple[float, float]:
        """Half width and half height of the paper [m]."""
        return (self.paper_factor * self.diameter_m / 2,) * 2

    @property
    def bends_m(self) -> float:
        """Radius of the dot [m]."""
        return self.diameter_m / 2

    @property
    def points_m(self) -> dict[str, tuple[float, float]]:
        """The centre, under the sheet's own name [m]."""
        return {"": (0.0, 0.0)}

    def ink(self, x_m: Float32Array, y_m: Float32Array, cell: Footprint) -> Float32Array:
        """Return the share of ink in each cell, shape (h, w)."""
        return disc_coverage(x_m, y_m, np.hypot(x_m, y_m), self.diameter_m / 2, cell)


@dataclass(frozen=True, slots=True, eq=False)
class DotGridPrint:
    """A circle grid for camera calibration.

    columns, rows: Circles of a row, and rows; in the asymmetric grid every second row is shifted by half a pitch.
    pitch_m: Distance of neighbours in a row; the rows are half of it apart in the asymmetric grid, all of it
        otherwise [m].
    diameter_m: Diameter of the circles [m].
    asymmetric: Whether every second row is shifted.
    """

    columns: int
    rows: int
    pitch_m: float
    diameter_m: float
    asymmetric: bool = False

    @property
    def centers_m(self) -> FloatArray:
        """Centres, row by row from the top left as OpenCV counts them, shape (rows * columns, 2) [m]."""
        row, column = np.divmod(np.arange(self.rows * self.columns), self.columns)
        if self.asymmetric:
            x, y = (column + 0.5 * (row % 2)) * self.pitch_m, -0.5 * row * self.pitch_m
        else:
            x, y = column * self.pitch_m, -1.0 * row * self.pitch_m
        points = np.stack([x, y], axis=1)
        return np.asarray(points - (points.min(axis=0) + points.max(axis=0)) / 2, dtype=np.float64)

    @property
    def half_size_m(self) -> tuple[float, float]:
        """Half width and half height of the paper [m]."""
        width, height = self.centers_m.max(axis=0) + self.pitch_m
        return float(width), float(height)

    @property
    def bends_m(self) -> float:
        """Radius of the circles [m]."""
        return self.diameter_m / 2

    @property
    def points_m(self) -> dict[str, tuple[float, float]]:
        """The centres by their number from 0, as OpenCV counts them [m]."""
        return {str(number): (float(x), float(y)) for number, (x, y) in enumerate(self.centers_m)}

    def ink(self, x_m: Float32Array, y_m: Float32Array, cell: Footprint) -> Float32Array:
        """Return the share of ink in each cell, shape (h, w)."""
        first = self.centers_m[0].astype(np.float32)
        step = np.float32(self.pitch_m / 2 if self.asymmetric else self.pitch_m)
        row = np.clip(np.rint((first[1] - y_m) / step), 0, self.rows - 1)
        shift = (row % 2) * np.float32(0.5 * self.asymmetric)
        column = np.clip(np.rint((x_m - first[0]) / np.float32(self.pitch_m) - shift), 0, self.columns - 1)
        x = x_m - first[0] - (column + shift) * np.float32(self.pitch_m)
        y = y_m - first[1] + row * step
        return disc_coverage(x, y, np.hypot(x, y), self.diameter_m / 2, cell)


@dataclass(frozen=True, slots=True, eq=False)
class LatticePrint:
    """Rectangular cells of ink or paper: chessboards and square markers.

    x_edges_m (n + 1,): Edges of the columns from left to right [m].
    y_edges_m (m + 1,): Edges of the rows from the top down, decreasing [m].
    cells (m, n): Whether a cell is inked, rows from the top.
    margin_m: Width of the paper around the cells [m].
    points_m: Points that are measured, by what follows the sheet's name in theirs [m].
    """

    x_edges_m: FloatArray
    y_edges_m: FloatArray
    cells: BoolArray
    margin_m: float
    points_m: dict[str, tuple[float, float]] = field(default_factory=dict)
    _padded: Float32Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "x_edges_m", float_array("x_edges_m", self.x_edges_m, (None,)))
        object.__setattr__(self, "y_edges_m", float_array("y_edges_m", self.y_edges_m, (None,)))
        cells = freeze(np.array(self.cells, dtype=np.bool_))
        if cells.shape != (self.y_edges_m.size - 1, self.x_edges_m.size - 1):
            raise InputError(f"lattice: {cells.shape} cells do not fit the edges")
        if np.any(np.diff(self.x_edges_m) <= 0) or np.any(np.diff(self.y_edges_m) >= 0):
            raise InputError("lattice: x edges must increase and y edges decrease (rows from the top)")
        positive("lattice margin_m", self.margin_m, "metres")
        object.__setattr__(self, "cells", cells)
        object.__setattr__(self, "_padded", freeze(np.pad(cells, 1).astype(np.float32)))

    @property
    def half_size_m(self) -> tuple[float, float]:
        """Half width and half height of the paper [m]."""
        return (
            float(np.abs(self.x_edges_m).max()) + self.margin_m,
            float(np.abs(self.y_edges_m).max()) + self.margin_m,
        )

    @property
    def bends_m(self) -> float:
        """Infinite: all edges are straight [m]."""
        return float("inf")

    def ink(self, x_m: Float32Array, y_m: Float32Array, cell: Footprint) -> Float32Array:
        """Return the share of ink in each cell, shape (h, w)."""
        left, beyond_x = _nearest_edge(x_m, self.x_edges_m, cell, along_x=True)
        above, below_y = _nearest_edge(-y_m, -self.y_edges_m, cell, along_x=False)
        ink = self._padded
        upper = ink[above, left] + (ink[above, left + 1] - ink[above, left]) * beyond_x
        lower = ink[above + 1, left] + (ink[above + 1, left + 1] - ink[above + 1, left]) * beyond_x
        return np.asarray(upper + (lower - upper) * below_y, dtype=np.float32)


def _nearest_edge(
    position: Float32Array, edges: FloatArray, cell: Footprint, *, along_x: bool
) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.int64]], Float32Array]:
    """Return the number of the cell before the nearest edge (in the padded lattice) and the share beyond that edge."""
    middles = ((edges[1:] + edges[:-1]) / 2).astype(np.float32)
    nearest = np.searchsorted(middles, position)
    past = position - edges.astype(np.float32)[nearest]
    share = (past > 0).astype(np.float32)
    near: BoolArray = np.abs(past) < cell.reach_m
    share[near] = cell.covered(past[near], float(along_x), float(not along_x))
    return nearest, share


def paper_share(print_: Print, x_m: Float32Array, y_m: Float32Array, cell: Footprint) -> Float32Array:
    """Return the share of each cell that the sheet's paper covers.

    Shapes: x_m, y_m (h, w).
    Returns (h, w): Shares, 0 to 1.
    """
    wide, high = print_.half_size_m
    return strip_coverage(x_m, (-wide, wide), True, cell) * strip_coverage(y_m, (-high, high), False, cell)
