"""Centres of round targets with covariance, to hundredths of a pixel.

`measure_center` fits a blurred disc to the pixels around an `Ellipse`, `measure_centers` many of a photo at once;
`light_centers` are those of dots of a few pixels. `edge_shape` says how edges are blurred.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from photogrammetry.centers.blurred_edges import EdgeShape as EdgeShape
    from photogrammetry.centers.blurred_edges import edge_shape as edge_shape
    from photogrammetry.centers.ellipse import Ellipse as Ellipse
    from photogrammetry.centers.ellipse import NamedEllipses as NamedEllipses
    from photogrammetry.centers.ellipse import eccentricity_px as eccentricity_px
    from photogrammetry.centers.light_moments import counted_share as counted_share
    from photogrammetry.centers.light_moments import has_free_ground as has_free_ground
    from photogrammetry.centers.light_moments import light_centers as light_centers
    from photogrammetry.centers.measured_centers import measure_center as measure_center
    from photogrammetry.centers.measured_centers import measure_centers as measure_centers
    from photogrammetry.centers.target_center import REACH as REACH
    from photogrammetry.centers.target_center import TargetCenter as TargetCenter

__getattr__, __dir__, __all__ = lazy_face(__name__)
