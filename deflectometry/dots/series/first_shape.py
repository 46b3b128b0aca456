"""The shape of a facet in the first frame, between its dots: what a turned facet is compared with, place by place.

A mean over the dots of a frame changes as they wander over the waves of the mirror and over its edges, 1.5 urad in a
drawn series where the dots' noise is 0.2. Slopes of both frames at the same places do not.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from deflectometry.dots.found_dots import FEWEST_DOTS
from deflectometry.dots.series.frame_slopes import FacetMotion
from deflectometry.shape.smooth_shape import sigma_of_tilt, tilt_of
from heliogauge.errors import EstimationError
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class FirstShape(ShortRepr):
    """A facet in the first frame.

    motion: How it stands there.
    missed_rad (2,): By what the slope at a dot differs from that between its neighbours, without noise, RMS [rad].
    half_step_m: Half of the distance from dot to dot [m].
    """

    motion: FacetMotion
    missed_rad: FloatArray
    half_step_m: float
    _between: Any = field(repr=False)
    _dots: Any = field(repr=False)

    @classmethod
    def of(cls, motion: FacetMotion) -> "FirstShape":
        """Return that of the first frame.

        EstimationError: Too few dots, or none between four others: what the shape is not known by there is open.
        """
        from scipy.interpolate import CloughTocher2DInterpolator
        from scipy.spatial import KDTree

        places, slopes = motion.places_m.T, motion.slopes.T
        kept = motion.rows_columns.sum(axis=1) % 2 == 0
        left_out = ~kept & _among_four(motion.rows_columns)
        if motion.count < FEWEST_DOTS or not left_out.any():
            raise EstimationError(
                f"facet {motion.facet.name!r} shows {motion.count} dots in the first frame; {FEWEST_DOTS} in three "
                "rows and columns or more are needed"
            )
        missed = CloughTocher2DInterpolator(places[kept], slopes[kept])(places[left_out]) - slopes[left_out]
        # Between four dots stands the mean of four, and of that and the dot's own comes the noise.
        rest = np.mean(missed**2, axis=0) - 1.25 * motion.noise_rad**2
        between, dots = CloughTocher2DInterpolator(places, slopes), KDTree(places)
        half_step_m = 0.5 * float(np.median(dots.query(places, 2)[0][:, 1]))
        return cls(motion, np.sqrt(np.maximum(rest, 0.0)), half_step_m, between, dots)

    def turn_to(self, motion: FacetMotion) -> tuple[FloatArray, FloatArray]:
        """Return by what a facet is turned against its pose more than in the first frame, with sigma, (2,) [rad].

        EstimationError: Too few dots where the first frame has some, or all on one line.
        """
        before = self._between(motion.places_m.T).T
        common = np.isfinite(before).all(axis=0)
        if np.count_nonzero(common) < FEWEST_DOTS:
            raise EstimationError(
                f"{np.count_nonzero(common)} of {motion.count} dots of facet {motion.facet.name!r} stand where the "
                f"first frame has some, fewer than {FEWEST_DOTS}"
            )
        places = motion.places_m[:, common]
        # Halfway to the next dot the shape is least known.
        away = np.minimum(self._dots.query(places.T)[0] / self.half_step_m, 1.0)
        noise = motion.noise_rad**2 + self.motion.noise_rad**2
        sigma = np.sqrt(noise[:, None] + (self.missed_rad[:, None] * away) ** 2)
        turn = tilt_of(motion.facet, places, (motion.slopes - before)[:, common])
        return turn, sigma_of_tilt(motion.facet, places, sigma)


def _among_four(rows_columns: IntArray) -> BoolArray:
    """Return which dots have one beside them on each of the four sides, (n,)."""
    row, column = rows_columns.T + 1
    seen = np.zeros((row.max() + 2, column.max() + 2), dtype=np.bool_)
    seen[row, column] = True
    return np.asarray(seen[row - 1, column] & seen[row + 1, column] & seen[row, column - 1] & seen[row, column + 1])
