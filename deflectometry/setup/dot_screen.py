"""A field of dots on a wall or screen: the measured place of each, and in between."""

from dataclasses import dataclass

import numpy as np

from heliogauge.errors import InputError
from heliogauge.validate import AnyFloatArray, BoolArray, FloatArray, IntArray, float_array, freeze

#: Fewer rows or columns than this make no field.
_FEWEST = 4
#: A fraction in single precision is off by less than this of a dot's distance: it means the dot itself.
_WHOLE = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class DotScreen:
    """A screen known at its dots, exactly there and bilinearly in between.

    Display coordinates are fractions of the field: u from its first column to its last, v from its topmost row to its
    lowest.

    xyz_m (rows, columns, 3): Place of each dot in the screen's frame, topmost row first; NaN for a dot that is not
        there [m].
    first: Column number of the first column, row number of the topmost row.
    sigma_m (rows, columns, 3): Standard deviations that are each dot's own; zero without [m].
    """

    xyz_m: FloatArray
    first: tuple[int, int]
    sigma_m: FloatArray | None = None

    def __post_init__(self) -> None:
        xyz = float_array("dots", self.xyz_m, (None, None, 3), finite=False)
        if min(xyz.shape[:2]) < _FEWEST:
            raise InputError(f"dots: {xyz.shape[1]} columns and {xyz.shape[0]} rows; {_FEWEST} of each are needed")
        object.__setattr__(self, "xyz_m", freeze(xyz))

    @classmethod
    def from_table(cls, column: FloatArray, row: FloatArray, xyz_m: FloatArray) -> "DotScreen":
        """Put the rows of a table in their places.

        Shapes: column, row (n,); xyz_m (n, 3).
        column, row: Whole numbers, to the right and upwards.
        InputError: A number that is not whole, or a dot that is listed twice.
        """
        places = np.stack([column, row], axis=1)
        if not np.array_equal(places, np.rint(places)):
            raise InputError("column and row: whole numbers are needed")
        whole = places.astype(np.intp)
        if len(np.unique(whole, axis=0)) < len(whole):
            raise InputError("a dot (column, row) is listed twice; remove one")
        low, high = whole.min(axis=0), whole.max(axis=0)
        columns, rows = high - low + 1
        if columns * rows > 100 * len(whole):
            raise InputError(f"{len(whole)} dots cannot fill {columns} columns and {rows} rows; check their numbers")
        xyz = np.full((rows, columns, 3), np.nan)
        xyz[high[1] - whole[:, 1], whole[:, 0] - low[0]] = xyz_m
        return cls(xyz, (int(low[0]), int(high[1])))

    def sigma_at(self, u: AnyFloatArray, v: AnyFloatArray) -> FloatArray:
        """Return what is the own standard deviation of the dots nearest to fractions, shape (..., 3) [m]."""
        if self.sigma_m is None:
            return np.zeros((*np.shape(u), 3))
        rows, columns = self.shape
        column = np.clip(np.rint(np.asarray(u) * (columns - 1)), 0, columns - 1).astype(np.intp)
        row = np.clip(np.rint(np.asarray(v) * (rows - 1)), 0, rows - 1).astype(np.intp)
        return np.asarray(self.sigma_m[row, column])

    @property
    def spacing_m(self) -> FloatArray:
        """Usual distance of two columns and of two rows, shape (2,) [m]."""
        steps = (np.diff(self.xyz_m, axis=1), np.diff(self.xyz_m, axis=0))
        return np.array([np.nanmedian(np.linalg.norm(one, axis=-1)) for one in steps])

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns."""
        return int(self.xyz_m.shape[0]), int(self.xyz_m.shape[1])

    def fractions(self, column: IntArray, row: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return u and v of dots by their numbers."""
        rows, columns = self.shape
        return (column - self.first[0]) / (columns - 1), (self.first[1] - row) / (rows - 1)

    def has(self, column: IntArray, row: IntArray) -> BoolArray:
        """Return whether dots are in the table, by their numbers."""
        return np.isfinite(self.places_m(column, row)[:, 0])

    def places_m(self, column: IntArray, row: IntArray) -> FloatArray:
        """Return the places of dots by their numbers, shape (n, 3) [m]; NaN for a dot that is not in the table."""
        across, down = column - self.first[0], self.first[1] - row
        rows, columns = self.shape
        there = (across >= 0) & (across < columns) & (down >= 0) & (down < rows)
        places = self.xyz_m[np.where(there, down, 0), np.where(there, across, 0)].copy()
        places[~there] = np.nan
        return places

    def points_m(self, u: AnyFloatArray, v: AnyFloatArray) -> FloatArray:
        """Return the points at fractions (u, v) of the field, shape (..., 3) [m]; NaN beyond it or beside a gap."""
        rows, columns = self.shape
        across = np.asarray(u, dtype=np.float64) * (columns - 1)
        down = np.asarray(v, dtype=np.float64) * (rows - 1)
        across, down = (np.where(np.abs(one - np.rint(one)) < _WHOLE, np.rint(one), one) for one in (across, down))
        inside = (across >= 0) & (across <= columns - 1) & (down >= 0) & (down <= rows - 1)
        across, down = np.where(inside, across, 0.0), np.where(inside, down, 0.0)
        left = np.minimum(across.astype(np.intp), columns - 2)
        top = np.minimum(down.astype(np.intp), rows - 2)
        points = np.zeros((*np.shape(across), 3))
        for right, along in ((0, 1 - (across - left)), (1, across - left)):
            for lower, share in ((0, 1 - (down - top)), (1, down - top)):
                weight = (along * share)[..., None]
                # A dot without weight may be missing.
                points += np.where(weight > 0, weight * self.xyz_m[top + lower, left + right], 0.0)
        points[~inside] = np.nan
        return points

    def describe(self) -> str:
        """Return the screen in words."""
        extent = np.nanmax(self.xyz_m, axis=(0, 1)) - np.nanmin(self.xyz_m, axis=(0, 1))
        count = np.count_nonzero(np.isfinite(self.xyz_m[..., 0]))
        return f"field of {count} dots over {extent[0]:.3f} m x {extent[1]:.3f} m"
