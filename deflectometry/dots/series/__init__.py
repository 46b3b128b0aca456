"""Many photos of a field of dots in one mirror that moves: one measurement for each frame.

The first frame is measured as a photo of its own (`deflectometry.dots.pipeline`); what that finds (pose, numbers of the
dots, turn of the lattice) is known in the others (`frame_slopes`), whose turn is predicted from the frames before
(`motion`).
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from deflectometry.dots.series.keys import load_series as load_series
    from deflectometry.dots.series.pipeline.measure import run as run

__getattr__, __dir__, __all__ = lazy_face(__name__)
