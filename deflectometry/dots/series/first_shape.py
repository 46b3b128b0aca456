"""The shape of a facet in the first frame, between its dots: what a turned facet is compared with, place by place.

A mean over the dots of a frame changes as they wander over the waves of the mirror and over its edges, 1.5 urad in a
drawn series where the dots' noise is 0.2. Slopes of both frames at the same places do not.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from deflectometry.dots.series.frame_slopes import FacetMotion
from deflectometry.shape.smooth_shape import tilt_of
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray


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
        """Return that of the first frame."""
        from scipy.interpolate import CloughTocher2DInterpolator
        from scipy.spatial import KDTree

        places, slopes = motion.places_m.T, motion.slopes.T
        kept = motion.rows_columns.sum(axis=1) % 2 == 0
        missed = CloughTocher2DInterpolator(places[kept], slopes[kept])(places[~kept]) - slopes[~kept]
        # Between four dots stands the mean of four, and of that and the dot's own comes the noise.
        rest = np.nanmean(missed**2, axis=0) - 1.25 * motion.noise_rad**2
        between, dots = CloughTocher2DInterpolator(places, slopes), KDTree(places)
        half_step_m = 0.5 * float(np.median(dots.query(places, 2)[0][:, 1]))
        return cls(motion, np.sqrt(np.maximum(rest, 0.0)), half_step_m, between, dots)

    def turn_to(self, motion: FacetMotion) -> tuple[FloatArray, FloatArray]:
        """Return by what a facet is turned against its pose more than in the first frame, with sigma, (2,) [rad].

        EstimationError: Too few dots where the first frame has some.
        """
        places = motion.places_m.T
        turn = tilt_of(motion.facet, motion.places_m, motion.slopes - self._between(places).T)
        noise = motion.dots_share * motion.noise_rad**2 + self.motion.dots_share * self.motion.noise_rad**2
        # Halfway to the next dot the shape is least known.
        away = np.minimum(self._dots.query(places)[0] / self.half_step_m, 1.0)
        return turn, np.sqrt(noise + motion.dots_share * np.mean(away**2) * self.missed_rad**2)
