"""The images of one measurement, with all that turns them into display points."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from deflectometry.fringes.known_point import KnownDisplayPoint, counted_positions
from deflectometry.fringes.phase import TURN_RAD, LightResponse
from deflectometry.fringes.screen_map import ScreenMapLimits, measure_screen_map, modulation_image
from deflectometry.setup.patterns import Axis, FringePattern, FringeSet
from deflectometry.sources.display_edge import DisplayEdge, flag_display_edge
from deflectometry.sources.noise_model import NoiseModel
from deflectometry.sources.screen_map import ScreenMap
from deflectometry.sources.source import Remedies
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, Float32Array

FRINGE_REMEDIES = Remedies(
    "use more steps for each period, or a response measured with the same exposure", "the axes of [[pattern.set]]"
)


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

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the images [px]."""
        return int(self.frames.shape[2]), int(self.frames.shape[1])

    def mirror_image(self) -> Float32Array:
        """Return an image in which the mirror is bright: bright minus dark frame, else the fringes' amplitude [DN]."""
        return self.modulation_image() if self.lit is None else self.lit

    def modulation_image(self) -> Float32Array:
        """Return the fringes' mean amplitude, shape (h, w) [DN, or the response's unit]."""
        return modulation_image(self.frames, self.pattern, response=self.response)

    @property
    def remedies(self) -> Remedies:
        """What to do about slopes that contradict themselves."""
        return FRINGE_REMEDIES

    @property
    def mixes_edges(self) -> bool:
        """Whether a sample near an edge shows what is beside the mirror: a pixel does."""
        return True

    def clutter(self) -> None:
        """Fringes are averaged out: nothing in the mirror looks like its edge."""

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

    def display_edge(self, screen_map: ScreenMap, region: BoolArray, margin_px: float) -> DisplayEdge:
        """Flag pixels that see the edge of the display."""
        return flag_display_edge(screen_map, region, margin_px)

    def exchanges(self) -> Iterator[tuple[str, "Observation"]]:
        """Yield what programs and people exchange: sides of the images, sides and axes of the pattern."""
        both = (
            ("left and right of the images are exchanged", (slice(None), slice(None, None, -1))),
            ("top and bottom of the images are exchanged", (slice(None, None, -1), slice(None))),
            ("the images are turned by 180 deg", (slice(None, None, -1), slice(None, None, -1))),
        )
        known, size_px = self.known_point, np.array(self.size_px)
        for words, (rows, columns) in both:
            frames = np.ascontiguousarray(self.frames[:, rows, columns])
            lit = None if self.lit is None else np.ascontiguousarray(self.lit[rows, columns])
            point = None if known is None else known.in_image(np.array([columns.step or 1, rows.step or 1]), size_px)
            yield words, replace(self, frames=frames, lit=lit, known_point=point)
        for words, axes in (
            ("left and right of the displayed pattern are exchanged", (Axis.X,)),
            ("top and bottom of the displayed pattern are exchanged", (Axis.Y,)),
            ("the displayed pattern is turned by 180 deg", (Axis.X, Axis.Y)),
        ):
            sets = tuple(_mirrored(one) if one.axis in axes else one for one in self.pattern.sets)
            point = None if known is None else known.mirrored(axes)
            yield words, replace(self, pattern=FringePattern(sets), known_point=point)
        other = {Axis.X: Axis.Y, Axis.Y: Axis.X}
        exchanged = FringePattern(tuple(replace(one, axis=other[one.axis]) for one in self.pattern.sets))
        words = 'axis = "x" and axis = "y" of [[pattern.set]] are exchanged'
        point = None if known is None else known.exchanged()
        yield words, replace(self, pattern=exchanged, known_point=point)


def _mirrored(one: FringeSet) -> FringeSet:
    """Return a set shown the wrong way round: cos(2 pi P (1 - w) - s) is cos(2 pi P w - (2 pi P - s))."""
    return replace(one, steps_rad=TURN_RAD * one.periods - one.steps_rad)
