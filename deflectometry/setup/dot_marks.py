"""Marks of a field of dots: dots of two sizes, so arranged that a small part of the field tells where it is."""

from dataclasses import dataclass

import numpy as np

from heliogauge.errors import InputError
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, IntArray

#: Radii of small and large dots as shares of the distance of two dots: the large ones have twice the area, and between
#: two of them there is as much ground as they are wide.
_SMALL_SHARE, _LARGE_SHARE = 0.2, 0.28
#: Of the arrangement: a field of so many columns and rows is the same for everyone.
_SEED = 16


def marked_radii(columns: int, rows: int, pitch: float) -> FloatArray:
    """Return the radii of the dots of a marked field, shape (rows, columns), topmost row first.

    pitch: Distance of two dots; radii have its unit.

    Sizes are independent of each other, half of the dots are large: no arrangement tells more with so many dots. Any
    two windows of 8 x 8 dots in a field of 75 x 55, turned and mirrored as you like, differ in 10 dots and more.
    """
    is_large = np.random.default_rng(_SEED).random((rows, columns)) < 0.5
    return pitch * np.where(is_large, _LARGE_SHARE, _SMALL_SHARE)


@dataclass(frozen=True, slots=True, eq=False)
class DotMarks(ShortRepr):
    """The sizes of the dots of a field.

    large (rows, columns): 1 for a large dot, 0 for a small one, -1 where there is none; topmost row first.
    first: Column number of the first column, row number of the topmost row.
    area_step: Logarithm of the area of a large dot over that of a small one.
    """

    large: IntArray
    first: tuple[int, int]
    area_step: float

    @classmethod
    def from_table(cls, column: FloatArray, row: FloatArray, radius_m: FloatArray) -> "DotMarks":
        """Put the rows of a table in their places.

        Shapes: column, row, radius_m (n,).
        column, row: Whole numbers, to the right and upwards.
        InputError: Radii that are not of two sizes.
        """
        middle = 0.5 * (radius_m.min() + radius_m.max())
        large = radius_m > middle
        if radius_m.min() <= 0 or large.all() or not large.any():
            raise InputError("radius_m: dots of two sizes are needed, all of them larger than 0")
        sizes = [float(np.median(radius_m[one])) for one in (~large, large)]
        if max(np.abs(radius_m - np.where(large, sizes[1], sizes[0]))) > 0.25 * (sizes[1] - sizes[0]):
            raise InputError(f"radius_m: dots of two sizes are needed, not from {radius_m.min()} to {radius_m.max()}")
        across, up = column.astype(np.intp), row.astype(np.intp)
        first = int(across.min()), int(up.max())
        field = np.full((first[1] - up.min() + 1, across.max() - first[0] + 1), -1, dtype=np.intp)
        field[first[1] - up, across - first[0]] = large
        return cls(field, first, 2.0 * float(np.log(sizes[1] / sizes[0])))
