"""The images of one measurement, with all that turns them into display points."""

from dataclasses import dataclass, field
from typing import Any

import numpy.typing as npt

from deflectometry.fringes.known_point import KnownDisplayPoint, counted_positions
from deflectometry.fringes.phase import LightResponse, NoiseModel
from deflectometry.fringes.screen_map import ScreenMap, ScreenMapLimits, measure_screen_map, modulation_image
from deflectometry.setup.patterns import FringePattern
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, Float32Array


@dataclass(frozen=True, slots=True, eq=False)
class Observation(ShortRepr):
    """The images of one measurement.

    frames (n, h, w): Fringe frames in the order of the pattern [DN].
    pattern: What was shown.
    response: Makes readings linear in the display's level.
    lit (h, w): Bright minus dark frame: shows the mirror against its surroundings [DN].
    noise: Noise of a reading; estimated without it.
    limits: Error probabilities and saturation.
    known_point: From where fringe orders are counted, for fringes without coarser ones.
    """

    frames: npt.NDArray[Any]
    pattern: FringePattern
    response: LightResponse | None = None
    lit: Float32Array | None = None
    noise: NoiseModel | None = None
    limits: ScreenMapLimits = field(default_factory=ScreenMapLimits)
    known_point: KnownDisplayPoint | None = None

    def modulation_image(self) -> Float32Array:
        """Return the fringes' mean amplitude, shape (h, w) [DN, or the response's unit]."""
        return modulation_image(self.frames, self.pattern, response=self.response)

    def screen_map(self, region: BoolArray) -> ScreenMap:
        """Measure the display point that each pixel of a region sees."""
        counted = None
        if self.known_point is not None:
            counted = counted_positions(self.frames, self.pattern, region, self.known_point, self.response)
        return measure_screen_map(
            self.frames,
            self.pattern,
            response=self.response,
            region=region,
            noise=self.noise,
            limits=self.limits,
            counted=counted,
        )
