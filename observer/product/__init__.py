"""Slopes of rows become the slope map, panels, figures of merit."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from observer.product.figures_of_merit import flight_figures as flight_figures
    from observer.product.longitudinal import error_of_theta_ra as error_of_theta_ra

__getattr__, __dir__, __all__ = lazy_face(__name__)
