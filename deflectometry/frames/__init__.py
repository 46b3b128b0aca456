"""Faulty frames are named before they spoil the map: repeated, stale, swapped, saturated."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from deflectometry.frames.sequence_checks import check_frames as check_frames
    from deflectometry.frames.set_motion import sets_shifts as sets_shifts

__getattr__, __dir__, __all__ = lazy_face(__name__)
