"""Photogrammetry: photos of targets to poses and coordinates with standard deviations.

From photos (`targets`, `detection`, `centers`) or another program's image points (`ImagePoints`) over start values from
nothing (`start_values`, `matching`) to the adjusted network with its covariance (`bundle`) and the surface under the
targets (`surface`). `keys` describe a measurement.toml, `pipeline` does all of it for a measurement folder.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from photogrammetry import bundle as bundle
    from photogrammetry import centers as centers
    from photogrammetry import detection as detection
    from photogrammetry import keys as keys
    from photogrammetry import matching as matching
    from photogrammetry import pipeline as pipeline
    from photogrammetry import start_values as start_values
    from photogrammetry import surface as surface
    from photogrammetry import targets as targets
    from photogrammetry.image_points import ImagePoints as ImagePoints

__getattr__, __dir__, __all__ = lazy_face(__name__)
