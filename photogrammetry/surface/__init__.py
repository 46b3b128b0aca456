"""Points to surface: fit to the design, slopes, canting, displacement, CAD meshes.

`fit_surface` moves `SurfacePoints` with their joint covariance onto a design from the pose that `find_start` gives.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from photogrammetry.surface.design import DesignSurface as DesignSurface
    from photogrammetry.surface.fit import fit_surface as fit_surface
    from photogrammetry.surface.fitted import FitChoices as FitChoices
    from photogrammetry.surface.fitted import SurfaceFit as SurfaceFit
    from photogrammetry.surface.fitted import SurfacePoints as SurfacePoints
    from photogrammetry.surface.start import find_start as find_start

__getattr__, __dir__, __all__ = lazy_face(__name__)
