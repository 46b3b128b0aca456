"""Why a sample is missing or doubtful: one registry for code, files and reports."""

from enum import IntFlag

import numpy as np
import numpy.typing as npt

from heliogauge.validate import FlagArray


class SampleFlag(IntFlag):
    """Reasons, one bit each. A sample with any bit of `REJECTED` has no value (NaN)."""

    OUTSIDE_MIRROR = 1 << 0
    MIRROR_EDGE = 1 << 1
    LOW_MODULATION = 1 << 2
    SATURATED = 1 << 3
    FRAMES_DISAGREE = 1 << 4
    FRINGE_ORDER_UNCERTAIN = 1 << 5
    OFF_SCREEN = 1 << 6
    NO_INTERSECTION = 1 << 7
    OUTLIER = 1 << 8
    NOT_SEEN = 1 << 9
    SMOOTHED_GAP = 1 << 10
    INPUT_NOT_FINITE = 1 << 11
    FAR_FROM_POINTS = 1 << 12
    PARTLY_COVERED = 1 << 13
    CUT_BY_BORDER = 1 << 14
    TOO_SMALL = 1 << 15
    CLIPPED = 1 << 16
    BEYOND_TUBE = 1 << 17
    BEHIND_TUBE = 1 << 18
    NOT_COVERED = 1 << 19
    UNCERTAIN = 1 << 20
    COARSE_CENTER = 1 << 21
    BLIND = 1 << 22


FLAG_TEXTS: dict[SampleFlag, str] = {
    SampleFlag.OUTSIDE_MIRROR: "outside the mirror's outline",
    SampleFlag.MIRROR_EDGE: "the pixel mixes the mirror with its surroundings",
    SampleFlag.LOW_MODULATION: "fringe contrast too low against the noise",
    SampleFlag.SATURATED: "at least one frame saturated",
    SampleFlag.FRAMES_DISAGREE: "the frames do not follow one sinusoid within the noise",
    SampleFlag.FRINGE_ORDER_UNCERTAIN: "the fringe order may be wrong",
    SampleFlag.OFF_SCREEN: "the reflected ray misses the screen",
    SampleFlag.NO_INTERSECTION: "the line of sight does not meet the surface",
    SampleFlag.OUTLIER: "far from its neighbours or from the fit",
    SampleFlag.NOT_SEEN: "no image shows this point",
    SampleFlag.SMOOTHED_GAP: "value bridged from neighbours",
    SampleFlag.INPUT_NOT_FINITE: "an input value was not finite",
    SampleFlag.FAR_FROM_POINTS: "no measured point is near enough",
    SampleFlag.PARTLY_COVERED: "the target is partly covered, or no blurred disc",
    SampleFlag.CUT_BY_BORDER: "the target reaches beyond the border of the photo",
    SampleFlag.TOO_SMALL: "the target covers too few pixels",
    SampleFlag.CLIPPED: "grey values of the target are at the end of the scale: its size is uncertain",
    SampleFlag.BEYOND_TUBE: "it reflects what is beyond the absorber's end or at a support",
    SampleFlag.BEHIND_TUBE: "the receiver hides it from all cameras that would see the tube there",
    SampleFlag.NOT_COVERED: "no camera was where it would show the tube's edge",
    SampleFlag.COARSE_CENTER: "no blurred disc: its centre is that of its outline, with a larger sigma",
    SampleFlag.BLIND: "blind zone: the sun looks so even there that its brightness says too little of the slope",
    SampleFlag.UNCERTAIN: "too uncertain: no edge of the reflection near enough",
}

#: Bits that leave a sample without a value.
_USABLE = SampleFlag.SMOOTHED_GAP | SampleFlag.CLIPPED | SampleFlag.COARSE_CENTER
REJECTED = SampleFlag(sum(flag for flag in SampleFlag if flag not in _USABLE))


def count_flags(flags: FlagArray, within: npt.NDArray[np.bool_] | None = None) -> dict[SampleFlag, int]:
    """Count the samples that carry each flag.

    flags: Bit masks of `SampleFlag`.
    within: Count only these samples.

    >>> count_flags(np.array([0, 4, 12], dtype=np.uint32))
    {<SampleFlag.LOW_MODULATION: 4>: 2, <SampleFlag.SATURATED: 8>: 1}
    """
    chosen = flags if within is None else flags[within]
    counts = {flag: int(np.count_nonzero(chosen & np.uint32(flag))) for flag in SampleFlag}
    return {flag: count for flag, count in counts.items() if count}
