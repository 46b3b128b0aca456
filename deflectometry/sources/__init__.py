"""What every source of known points gives: which of them each sample of the image sees, and how sure that is.

A source (fringes on a screen, a field of dots) answers to `Source`; what follows it (pose, shape, maps) knows no other.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from deflectometry.sources.sample_grid import LatticeGrid as LatticeGrid
    from deflectometry.sources.sample_grid import PixelGrid as PixelGrid
    from deflectometry.sources.screen_map import ScreenMap as ScreenMap
    from deflectometry.sources.source import Source as Source

__getattr__, __dir__, __all__ = lazy_face(__name__)
