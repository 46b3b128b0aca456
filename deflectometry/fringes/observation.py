"""The images of one measurement, with all that turns them into display points."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from deflectometry.fringes.known_point import KnownDisplayPoint, counted_positions
from deflectometry.fringes.phase import LightResponse
from deflectometry.fringes.screen_map import ScreenMapLimits, measure_screen_map, modulation_image
from deflectometry.setup.patterns import FringePattern
from deflectometry.sources.display_edge import DisplayEdge, flag_display_edge
from deflectometry.sources.noise_model import NoiseModel
from deflectometry.sources.screen_map import ScreenMap
from deflectometry.sources.source import Exchange, Remedies
from heliogauge.flags import SampleFlag
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, Float32Array

FRINGE_REMEDIES = Remedies(
    "use more steps for each period, or a response measured with the same exposure", "the axes of [[pattern.set]]"
)

#: What a screen map has of each pixel.
_IMAGES = ("u", "v", "sigma_u", "sigma_v", "modulation_dn", "flags")


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
    seen: The display point of each pixel of the mirror, where the frames were measured already.
    """

    frames: npt.NDArray[Any]
    pattern: FringePattern
    response: LightResponse | None = None
    lit: Float32Array | None = None
    noise: NoiseModel | None = None
    limits: ScreenMapLimits = field(default_factory=ScreenMapLimits)
    known_point: KnownDisplayPoint | None = None
    seen: ScreenMap | None = None

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
        if self.seen is not None:
            flags = np.where(region, self.seen.flags, np.uint32(SampleFlag.OUTSIDE_MIRROR))
            return replace(self.seen, flags=flags)
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

    def exchanges(self, seen: ScreenMap) -> Iterator[Exchange]:
        """Yield what programs and people exchange: sides of the images, sides and axes of the pattern.

        The frames are not measured again: reversed images show the same points in reversed order, and a mirrored
        pattern shows 1 - u for u.
        """
        for words, rows, columns in (
            ("left and right of the images are exchanged", 1, -1),
            ("top and bottom of the images are exchanged", -1, 1),
            ("the images are turned by 180 deg", -1, -1),
        ):
            at = slice(None, None, rows), slice(None, None, columns)
            lit = None if self.lit is None else np.ascontiguousarray(self.lit[at])
            images = {name: getattr(seen, name)[at] for name in _IMAGES}
            turned = replace(self, frames=self.frames[:, *at], lit=lit, seen=replace(seen, **images))
            yield Exchange(words, turned, moves_outline=True)
        mirrored = {"u": np.float32(1) - seen.u, "v": np.float32(1) - seen.v}
        swapped = {"u": seen.v, "v": seen.u, "sigma_u": seen.sigma_v, "sigma_v": seen.sigma_u}
        for words, others in (
            ("left and right of the displayed pattern are exchanged", {"u": mirrored["u"]}),
            ("top and bottom of the displayed pattern are exchanged", {"v": mirrored["v"]}),
            ("the displayed pattern is turned by 180 deg", mirrored),
            ('axis = "x" and axis = "y" of [[pattern.set]] are exchanged', swapped),
        ):
            yield Exchange(words, replace(self, seen=replace(seen, **others)), moves_outline=False)
