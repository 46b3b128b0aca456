"""Faulty frames are named before they spoil the map: repeated, stale, swapped, saturated."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from deflectometry.frames.checks import check_frames as check_frames
    from deflectometry.frames.quality import FaultKind as FaultKind
    from deflectometry.frames.quality import FrameFault as FrameFault

__getattr__, __dir__, __all__ = lazy_face(
    __name__,
    {
        "FaultKind": "deflectometry.frames.quality",
        "FrameFault": "deflectometry.frames.quality",
        "check_frames": "deflectometry.frames.checks",
    },
)
