"""What draws: rays, mirrors, prints, sensors. Images integrate over the pixel."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from data_synth.optics.markers import chessboard_print as chessboard_print
    from data_synth.optics.mirror import Design as Design
    from data_synth.optics.mirror import SyntheticFacet as SyntheticFacet
    from data_synth.optics.sheets import Sheet as Sheet
    from data_synth.optics.surface_errors import SurfaceErrors as SurfaceErrors
    from data_synth.optics.wall import Wall as Wall

__getattr__, __dir__, __all__ = lazy_face(__name__)
