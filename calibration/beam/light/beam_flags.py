"""Why the picture of a beam is doubtful or useless: one registry for code, files and reports."""

from enum import IntFlag

__all__ = ["BEAM_FLAG_TEXTS", "REJECTED_BEAM", "BeamFlag", "beam_reason"]


class BeamFlag(IntFlag):
    """Reasons, one bit each; a beam with any bit of `REJECTED_BEAM` is to be left out of a fit."""

    NO_BEAM = 1 << 0
    CUT_BY_EDGE = 1 << 1
    TWO_BEAMS = 1 << 2
    NOT_FINITE = 1 << 3
    TARGET_NOT_FOUND = 1 << 4
    SATURATED = 1 << 5
    SUNLIT_TARGET = 1 << 6
    LITTLE_BACKGROUND = 1 << 7
    METHODS_DISAGREE = 1 << 8
    UNREADABLE = 1 << 9
    BACKGROUND_MAY_HOLD_LIGHT = 1 << 10
    UNEVEN_TARGET = 1 << 11
    TARGET_MOVED = 1 << 12


BEAM_FLAG_TEXTS: dict[BeamFlag, str] = {
    BeamFlag.NO_BEAM: "no beam stands out of the target's own brightness",
    BeamFlag.CUT_BY_EDGE: "the beam reaches beyond the edge of the target",
    BeamFlag.TWO_BEAMS: "more than one beam is on the target",
    BeamFlag.NOT_FINITE: "too much of the target is outside the picture or not finite",
    BeamFlag.TARGET_NOT_FOUND: "the target was not found in the picture",
    BeamFlag.SATURATED: "part of the beam is at the end of the grey scale",
    BeamFlag.SUNLIT_TARGET: "the target is much brighter than the beam on it (does the sun shine on it?)",
    BeamFlag.LITTLE_BACKGROUND: "the beam leaves too little of the target free to know its own brightness",
    BeamFlag.METHODS_DISAGREE: "the centroid depends on the method far beyond its uncertainty",
    BeamFlag.UNREADABLE: "the picture cannot be read",
    BeamFlag.BACKGROUND_MAY_HOLD_LIGHT: "light of the beam may be spread over the whole target and count as "
    "background (haze, a dirty mirror, the camera's halo): the sizes are those of the rest",
    BeamFlag.UNEVEN_TARGET: "the target's panels differ and no frame without a beam shows those under it: the centre "
    "may be off by more than its sigma says",
    BeamFlag.TARGET_MOVED: "the target's seams and marks are not where the frames without a beam show them (another "
    "target, or the camera has moved)",
}

#: Bits with which a beam has no value that a fit may use.
REJECTED_BEAM = (
    BeamFlag.NO_BEAM
    | BeamFlag.CUT_BY_EDGE
    | BeamFlag.TWO_BEAMS
    | BeamFlag.NOT_FINITE
    | BeamFlag.TARGET_NOT_FOUND
    | BeamFlag.UNREADABLE
    | BeamFlag.METHODS_DISAGREE
    | BeamFlag.TARGET_MOVED
)


def beam_reason(flags: int) -> str:
    """Put flags into words.

    flags: Bits of `BeamFlag`.
    Returns: The texts, separated by semicolons; empty where no bit is set.

    >>> beam_reason(BeamFlag.NO_BEAM)
    "no beam stands out of the target's own brightness"
    """
    return "; ".join(text for flag, text in BEAM_FLAG_TEXTS.items() if flags & flag)
