"""A laser scan: which way each beam went, and where it came back."""

from dataclasses import dataclass, replace

import numpy as np

from heliogauge.validate import BoolArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class LaserScan:
    """Beams of one laser and the spots that they make after the mirror.

    directions (3, n): Unit directions in which the beams leave, in the laser's frame.
    spots_m (3, n): Where they meet the target after the mirror, in the same frame [m]; NaN where no spot was seen.
    direction_steps (2, 3, n): What two independent errors of 1 rad do to each direction.
    spot_steps (2, 3, n): What two independent errors of 1 m do to each spot [m].
    beams_of_one_error: Beams that share one error of direction: those of one line of a sweep.
    repeated: Rows of the table that say again what another says: they are left out.

    The laser's frame: origin where the beams turn, x to the right and y up for somebody who looks from there at the
    mirror, z from the mirror to the laser.
    """

    directions: FloatArray
    spots_m: FloatArray
    direction_steps: FloatArray
    spot_steps: FloatArray
    beams_of_one_error: float = 1.0
    repeated: int = 0

    @property
    def seen(self) -> BoolArray:
        """Beams whose spot was seen, shape (n,)."""
        return np.asarray(np.isfinite(self.spots_m).all(axis=0))

    def chosen(self, which: BoolArray) -> "LaserScan":
        """Return some of the beams."""
        return replace(
            self,
            directions=self.directions[:, which],
            spots_m=self.spots_m[:, which],
            direction_steps=self.direction_steps[..., which],
            spot_steps=self.spot_steps[..., which],
        )

    def with_spots(self, spots_m: FloatArray) -> "LaserScan":
        """Return the same beams with other spots."""
        return replace(self, spots_m=spots_m)

    def with_directions(self, directions: FloatArray) -> "LaserScan":
        """Return the same spots of other beams (3, n), of any length."""
        return replace(self, directions=directions / np.linalg.norm(directions, axis=0))


def single_beams(directions: FloatArray, spots_m: FloatArray) -> LaserScan:
    """Return a scan of beams one by one, each with errors of its own in x and y.

    directions (3, n): Of any length. spots_m (3, n): NaN where no spot was seen [m].
    """
    unit = directions / np.linalg.norm(directions, axis=0)
    across = [np.eye(3)[axis][:, None] - unit[axis] * unit for axis in range(2)]
    steps = np.stack([one / np.linalg.norm(one, axis=0) for one in across])
    same = np.broadcast_to(np.eye(3)[:2, :, None], steps.shape)
    return LaserScan(unit, spots_m, steps, same)
