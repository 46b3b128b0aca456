"""A laser scan: which way each beam went, and where it came back."""

from dataclasses import dataclass, replace

import numpy as np

from heliogauge.validate import BoolArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class LaserScan:
    """Beams of one laser and the spots that they make after the mirror.

    directions (3, n): Unit directions in which the beams leave, in the laser's frame.
    spots_m (3, n): Where they meet the target after the mirror, in the same frame [m]; NaN where no spot was seen.

    The laser's frame: origin where the beams turn, x to the right and y up for somebody who looks from there at the
    mirror, z from the mirror to the laser.
    """

    directions: FloatArray
    spots_m: FloatArray

    @property
    def seen(self) -> BoolArray:
        """Beams whose spot was seen, shape (n,)."""
        return np.asarray(np.isfinite(self.spots_m).all(axis=0))

    def chosen(self, which: BoolArray) -> "LaserScan":
        """Return some of the beams."""
        return LaserScan(self.directions[:, which], self.spots_m[:, which])

    def with_spots(self, spots_m: FloatArray) -> "LaserScan":
        """Return the same beams with other spots."""
        return replace(self, spots_m=spots_m)
