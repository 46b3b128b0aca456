"""Centres of round targets with covariance, to hundredths of a pixel.

A `CENTER_OPERATORS` entry takes the pixels around an `Ellipse`; `template_center` is the one that measurements use.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from photogrammetry.centers.centroid import CENTER_OPERATORS as CENTER_OPERATORS
    from photogrammetry.centers.ellipse import Ellipse as Ellipse
    from photogrammetry.centers.ellipse import NamedEllipses as NamedEllipses
    from photogrammetry.centers.ellipse import eccentricity_px as eccentricity_px
    from photogrammetry.centers.template import template_center as template_center

__getattr__, __dir__, __all__ = lazy_face(
    __name__,
    {
        "CENTER_OPERATORS": "photogrammetry.centers.centroid",
        "Ellipse": "photogrammetry.centers.ellipse",
        "NamedEllipses": "photogrammetry.centers.ellipse",
        "eccentricity_px": "photogrammetry.centers.ellipse",
        "template_center": "photogrammetry.centers.template",
    },
)
